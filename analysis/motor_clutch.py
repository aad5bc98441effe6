"""The motor clutch of cells on elastic substrates (Chan and Odde, Science 322, 1687,
2008; Bangasser, Rosenfeld and Odde, Biophys. J. 105, 581, 2013): retrograde flow and
traction against the stiffness of the substrate, by eqsim and by a time-stepped script.

N = 75 myosin motors (stall force 2 pN each, 120 nm/s without a load) pull actin, which N
clutches of stiffness k_c bind to a substrate of stiffness K. Clutches bind at 0.3/s and
let go at 0.1/s e^(f/2 pN). On a soft substrate force builds up slowly, until clutches
fail together; on a stiff one each fails before others bind (`frictional slippage`); in
between is an optimum. Both programs find means over the second half of 200 s that begin
with unbound clutches relaxing from all bound ones, of independent cells.

    python -m analysis.motor_clutch

writes motor_clutch.png and motor_clutch.parquet, with the time of both for the same
error. `stepped` is also what tests compare eqsim with.
"""

import time
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.progress import track

Array = NDArray[Any]


class Clutch(NamedTuple):
    """Motors and clutches: pN, nm and s."""

    count: int = 75  # of motors and of clutches
    stall: float = 2.0  # force at which a motor stops
    velocity: float = 120.0  # of the motors without a load
    stiffness: float = 0.8  # of a clutch
    on_rate: float = 0.3
    off_rate: float = 0.1
    force_scale: float = 2.0  # F_b of Bell's law


class Means(NamedTuple):
    """Means over the second half of a run: force of the motors per clutch and number of
    bound clutches over all, with standard errors over cells, and the time it took."""

    force: float
    force_error: float
    bound: float
    bound_error: float
    seconds: float


def stepped(
    clutch: Clutch,
    substrate: float | None,
    duration: float,
    step: float,
    cells: int,
    seed: int,
) -> Means:
    """The usual script: in each step actin moves at the velocity that the load of the
    motors leaves, the substrate (None: rigid) finds its balance, and clutches let go
    and bind with the probabilities of the step."""
    begin = time.perf_counter()
    rng = np.random.default_rng(seed)
    N, k, stall = clutch.count, clutch.stiffness, clutch.count * clutch.stall
    bound = np.ones((cells, N), bool)
    zero = np.zeros((cells, N))  # X where a clutch has bound
    Y, force = np.zeros(cells), np.zeros(cells)
    binds = -np.expm1(-clutch.on_rate * step)
    steps = round(duration / step)
    sums = np.zeros((2, cells))
    for index in range(steps):
        Y += clutch.velocity * (1.0 - force / stall) * step
        number, offset = bound.sum(axis=1), (bound * zero).sum(axis=1)
        X = Y
        if substrate is not None:
            X = (substrate * Y + k * offset) / (substrate + k * number)
        f = k * (X[:, None] - zero)
        u = rng.random((cells, N))
        rate = clutch.off_rate * np.exp(np.minimum(f / clutch.force_scale, 500.0))
        lets_go = bound & (u < -np.expm1(-rate * step))
        joins = ~bound & (u < binds)
        zero = np.where(joins, X[:, None], zero)
        bound = (bound & ~lets_go) | joins
        number, offset = bound.sum(axis=1), (bound * zero).sum(axis=1)
        if substrate is not None:
            X = (substrate * Y + k * offset) / (substrate + k * number)
        force = k * (number * X - offset)
        if index >= steps // 2:
            sums += force, number
    return means_of(sums / (steps - steps // 2) / N, begin)


def means_of(each: Array, begin: float) -> Means:
    """Means of force and bound clutches of cells, shape (2, cells)."""
    value = each.mean(axis=1)
    error = each.std(axis=1, ddof=1) / np.sqrt(each.shape[1])
    seconds = time.perf_counter() - begin
    return Means(value[0], error[0], value[1], error[1], seconds)
