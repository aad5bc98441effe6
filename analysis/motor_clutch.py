"""The motor clutch of cells on elastic substrates (Chan and Odde, Science 322, 1687,
2008; Bangasser, Rosenfeld and Odde, Biophys. J. 105, 581, 2013): retrograde flow and
traction against the stiffness of the substrate, by eqsim and by a time-stepped script.

N = 75 myosin motors (stall force 2 pN each, 120 nm/s without a load) pull actin, which N
clutches of stiffness k_c bind to a substrate of stiffness K. Clutches bind at 0.3/s and
let go at 0.1/s e^(f/2 pN). On a soft substrate force builds up slowly, until clutches
fail together; on a stiff one each fails before others bind (`frictional slippage`); in
between is an optimum. Both programs find
means over the second half of a run that begins with all clutches bound, of several
independent cells.

    python -m analysis.motor_clutch

writes motor_clutch.png and motor_clutch.parquet, with the time of both for the same
error. `stepped` is also what tests compare eqsim with.
"""

import math
import time
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.progress import track

from eqsim import (
    Delay,
    Ensemble,
    NoThresholds,
    Programme,
    Segment,
    Stage,
    Thermal,
    trajectory,
)
from eqsim.plots import style

Array = NDArray[Any]
# Stiffness of a clutch, and substrates of the script, pN/nm. Stiff clutches take it
# minutes.
COMPARED = {0.8: (0.1, 1.0, 10.0), 5.0: (10.0,)}
CELLS = 64  # simulated by eqsim
SCRIPT_CELLS = 16  # by the script
# Step of the script over the time in which force builds up by F_b. With 0.2 the force
# of clutches of 0.8 pN/nm on a rigid substrate is 4(1) % too small, with 0.6 that of
# clutches of 5 pN/nm 8.0(7) %.
STEP = 0.05
INSTANTS = 2000  # at which eqsim records the force of the second half


class Clutch(NamedTuple):
    """Motors and clutches: pN, nm and s."""

    count: int = 75  # type: ignore[assignment]  # of motors and of clutches
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


def by_events(
    clutch: Clutch, substrate: float | None, duration: float, cells: int, seed: int
) -> Means:
    """The same by eqsim, event by event. Its forces are over N k, lengths."""
    begin = time.perf_counter()
    bonds = Ensemble(
        NoThresholds(),
        Thermal(
            barrier="bell", off_rate=clutch.off_rate, force_scale=clutch.force_scale
        ),
        Delay(1.0 / clutch.on_rate, "exponential"),
        count=clutch.count,
        stiffness=clutch.stiffness,
        stiffness_law="uniform",
    )
    stage = None
    if substrate is not None:
        stage = Stage(substrate / (clutch.count * clutch.stiffness))
    motors = Programme(
        [Segment(clutch.velocity, time=duration, points=2 * INSTANTS)],
        stage=stage,
        stall_force=clutch.stall / clutch.stiffness,
    )
    run = trajectory(bonds, motors, points=2, replicas=cells, seed=seed)
    assert run.force_replicas is not None  # there are several cells
    force = run.force_replicas[:, -INSTANTS:].mean(axis=1) * clutch.stiffness
    bound = np.full(cells, run.pinned[-INSTANTS:].mean())
    return means_of(np.array((force, bound)), begin)


def means_of(each: Array, begin: float) -> Means:
    """Means of force and bound clutches of cells, shape (2, cells)."""
    value, error = each.mean(axis=1), each.std(axis=1, ddof=1)
    error /= math.sqrt(each.shape[1])
    seconds = time.perf_counter() - begin
    force, bound = zip(value.tolist(), error.tolist(), strict=True)
    return Means(*force, *bound, seconds=seconds)


def duration_on(clutch: Clutch, substrate: float) -> float:
    """Seconds of a run: some ten of the longest cycles, in which motors stretch the
    substrate until they stall."""
    stretch = clutch.count * clutch.stall / substrate
    return max(100.0, 12.0 * stretch / clutch.velocity)


def table(substrates: Array, script: bool) -> pd.DataFrame:
    """A row for each clutch stiffness, substrate and program."""
    rows = []
    jobs = [(k, K) for k in COMPARED for K in np.union1d(substrates, COMPARED[k])]
    # kernels are compiled outside of the times
    by_events(Clutch(), 1.0, 1.0, 2, 1)
    for seed, (k, K) in enumerate(track(jobs, description="simulating")):
        clutch = Clutch(stiffness=k)
        T = duration_on(clutch, K)
        runs = {"eqsim": by_events(clutch, K, T, CELLS, seed)}
        if script and K in COMPARED[k]:
            step = STEP * clutch.force_scale / (k * clutch.velocity)
            runs["script"] = stepped(clutch, K, T, step, SCRIPT_CELLS, seed)
        for program, means in runs.items():
            flow = clutch.velocity * (1.0 - means.force / clutch.stall)
            flow_error = clutch.velocity * means.force_error / clutch.stall
            rows.append(
                {
                    "clutch_stiffness": k,
                    "substrate_stiffness": K,
                    "program": program,
                    "flow": flow,
                    "flow_error": flow_error,
                    "traction": clutch.count * means.force,
                    "traction_error": clutch.count * means.force_error,
                    "bound": means.bound,
                    "seconds": means.seconds,
                }
            )
    return pd.DataFrame(rows)


def compared_with_script(found: pd.DataFrame) -> pd.DataFrame:
    """Difference of both programs in standard errors, and how much longer the script
    takes for the same error."""
    keys = ["clutch_stiffness", "substrate_stiffness"]
    sides = {name: part.set_index(keys) for name, part in found.groupby("program")}
    ours, script = sides["eqsim"].loc[sides["script"].index], sides["script"]
    error = np.hypot(ours.traction_error, script.traction_error)
    cost = {
        name: side.seconds * side.traction_error**2
        for name, side in (("eqsim", ours), ("script", script))
    }
    columns = {
        "z": (ours.traction - script.traction) / error,
        "times_faster": cost["script"] / cost["eqsim"],
        "relative_error": script.traction_error / script.traction,
    }
    return pd.DataFrame(columns).reset_index()


@style.styled
def draw(found: pd.DataFrame) -> Figure:
    """Retrograde flow and traction against the stiffness of the substrate."""
    figure = Figure(figsize=(10, 4.2))
    panels = figure.subplots(1, 2)
    marks = {"eqsim": {"fmt": "-o", "markersize": 3}, "script": {"fmt": "kx"}}
    labels = {"flow": "retrograde flow [nm/s]", "traction": "traction [pN]"}
    for axes, name in zip(panels, labels, strict=True):
        for (k, program), part in found.groupby(["clutch_stiffness", "program"]):
            label = f"{k:g} pN/nm, eqsim" if program == "eqsim" else None
            if program == "script" and k == found.clutch_stiffness.max():
                label = "time-stepped script"
            axes.errorbar(
                part.substrate_stiffness,
                part[name],
                2 * part[f"{name}_error"],
                label=label,
                **marks[program],
            )
        axes.set(xscale="log", xlabel="substrate [pN/nm]", ylabel=labels[name])
        axes.set_ylim(bottom=0)
    panels[0].legend(title="clutches")
    return figure


def main(
    out: Annotated[Path, typer.Option(help="folder of the results")] = Path(),
    points: Annotated[int, typer.Option(help="substrates in four decades")] = 17,
    script: Annotated[bool, typer.Option(help="run the script, too")] = True,
) -> None:
    """Simulate, compare and draw."""
    out.mkdir(parents=True, exist_ok=True)
    substrates = np.geomspace(1e-2, 1e2, points).round(12)
    found = table(substrates, script)
    found.to_parquet(out / "motor_clutch.parquet")
    draw(found).savefig(out / "motor_clutch.png", dpi=150)
    if script:
        print(compared_with_script(found).to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
