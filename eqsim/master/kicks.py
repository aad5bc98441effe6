"""How steady sliding through a spring answers to a small kick, in mean field (derived).

The slider starts in the stationary state, its spring stretched by a kick more than what
balances friction, and again by as much less. Half the difference of the two
displacements is free of what is even in the kick: of second-order terms, and of what
the solver misses of the balance. It is a sum of damped oscillations about the displaced
balance, whose rates a matrix pencil finds: shifted by one sample, they span the same
space.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from eqsim.estimate import Estimate, known
from eqsim.master.slider import pulled_of
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

METHOD = "mean field"

# The kick, in mean thresholds.
_KICK = 4e-3
# Displacement beyond which an answer is not small, in mean thresholds.
_LARGEST = 3e-2
# Noise of the solver, in mean thresholds.
_LEAST = 1e-5
# Other kicks that are tried, until the answer is small and seen for `_ENOUGH` cycles.
_TRIES = 2
_ENOUGH = 3.0
# Cycles after a kick that are looked at, and instants in them.
_CYCLES = 8.0
_POINTS = 401
# Share of the kick below which there is nothing to follow after a cycle.
_GONE = 0.02
# Where windows begin, in cycles.
_STARTS = (1.0, 0.5, 0.25)
# How far a border is looked for, in octaves of the stiffness, and how closely.
_OCTAVES = 6
_CLOSE = 2e-3

# An estimate of what there is none of.
NO_VALUE = Estimate(None, None, 0)

Progress = Callable[[int, float], None]


class Mode(NamedTuple):
    """A perturbation: rate of growth (1/time, negative: of decay), and period (time),
    without a value if it does not oscillate; neither has one if all decay within a
    cycle. Not `reliable` if seen for less than half a cycle."""

    growth: Estimate
    period: Estimate


class _Answer(NamedTuple):
    """The part of X - V t - kick that is odd in the kick, at intervals dt, and that by
    longer steps of the solver."""

    u: Array
    coarser: Array
    dt: float


def mode_of(
    ensemble: Ensemble,
    velocity: float,
    stage: Stage,
    progress: Progress = lambda *_: None,
) -> Mode:
    """The slowest oscillation after a kick.

    Errors are by how much it differs for a kick twice as large, in another window, with
    half as many oscillations more, and with steps of the solver twice as long.
    `progress(done, total)` counts kicks, of which there may be fewer. Raises InputError
    where there is no mean field.
    """
    most = _TRIES + 2
    progress(0, most)
    exact = reference(ensemble, Drive(velocity))
    typical = ensemble.thresholds.mean
    cycle = known(exact.break_stretch) / velocity + ensemble.delay.time
    longest = max(cycle, 2.0 * math.pi * math.sqrt(stage.mass / stage.stiffness))
    kick, time = _KICK * typical, _CYCLES * longest
    answer = _answer(ensemble, velocity, stage, kick, time)
    for done in range(1, _TRIES + 1):
        progress(done, most)
        last = _end(answer, typical)
        if last * answer.dt >= _ENOUGH * longest:
            break
        grows = float(np.abs(answer.u[last])) > 0.5 * _LARGEST * typical
        kick *= 0.2 if grows else 5.0
        time = min(time, (_ENOUGH + 1.0) * longest)
        answer = _answer(ensemble, velocity, stage, kick, time)
    if float(np.abs(answer.u[round(longest / answer.dt) :]).max()) < _GONE * kick:
        return Mode(NO_VALUE, NO_VALUE)
    last = _end(answer, typical)
    seen = last * answer.dt / longest
    start = next((part for part in _STARTS if seen >= part + 1.0), _STARTS[-1])
    first = min(round(start * longest / answer.dt), max(last - 16, 0))
    found = _rate(answer, first, last, 4)
    progress(most - 1, most)
    twice = _answer(ensemble, velocity, stage, 2.0 * kick, time)
    others = [
        _rate(twice, first, min(last, _end(twice, 2.0 * typical)), 4),
        _rate(answer, first, last, 6),
        _rate(answer, first, first + (3 * (last - first)) // 4, 4),
        _rate(answer._replace(u=answer.coarser), first, last, 4),
    ]
    missed = [
        abs(complex(other.real, abs(other.imag)) - complex(found.real, abs(found.imag)))
        for other in others
    ]
    error, frequency = max(missed), abs(found.imag)
    sure = (last - first) * answer.dt >= 0.5 * longest and error < abs(found)
    growth = Estimate(found.real, error, 0, None, sure)
    if frequency * longest < 1e-3:
        return Mode(growth, Estimate(None, None, 0, None, sure))
    period = 2.0 * math.pi / frequency
    return Mode(growth, Estimate(period, period * error / frequency, 0, None, sure))


def _answer(
    ensemble: Ensemble, velocity: float, stage: Stage, kick: float, time: float
) -> _Answer:
    friction = known(reference(ensemble, Drive(velocity)).friction)
    balance = friction + stage.damping * velocity
    found = []
    segments = (Segment(velocity, time=time),)
    for preload in balance / stage.stiffness + np.array([kick, -kick]):
        pulled = replace(stage, preload=float(preload))
        programme = Programme(segments, "stationary", velocity, pulled)
        found.append(pulled_of(ensemble, programme, programme.grid(_POINTS)))
    more, less = found
    u = 0.5 * (more.X - less.X) - kick
    coarser = 0.5 * (more.coarser_X - less.coarser_X) - kick
    return _Answer(u, coarser, time / (_POINTS - 1))


def _end(answer: _Answer, typical: float) -> int:
    """Up to where the answer is small, and is seen."""
    size = np.abs(answer.u) / typical
    large = np.flatnonzero(size > _LARGEST)
    last = int(large[0]) if large.size else size.size - 1
    seen = np.flatnonzero(size[: last + 1] > _LEAST)
    return max(int(seen[-1]) if seen.size else 0, min(24, size.size - 1))


def _rate(answer: _Answer, first: int, last: int, order: int) -> complex:
    """The rate p of the strongest of `order` exponentials exp(p t) between two samples."""
    u = answer.u[first : last + 1]
    rows = np.lib.stride_tricks.sliding_window_view(u, max(order + 1, u.size // 2))
    basis = linalg.svd(rows, full_matrices=False)[2][:order].T
    z = linalg.eigvals(linalg.lstsq(basis[:-1], basis[1:])[0])
    z = z[np.abs(z) > 1e-12]
    powers = z ** np.arange(u.size)[:, None]
    size = np.abs(linalg.lstsq(powers, u.astype(complex))[0])
    size *= np.sqrt((np.abs(powers) ** 2).mean(axis=0))
    return complex(np.log(z[np.argmax(size)]) / answer.dt)


def border_by_kicks(
    ensemble: Ensemble,
    velocity: float,
    stage: Stage,
    progress: Progress = lambda *_: None,
) -> Estimate:
    """The stiffness at which a kick neither grows nor decays, by the root of its rate;
    0 if it decays at 1/64 of the stage's stiffness, too, with that as the error;
    without a value if it grows up to 64 times it."""
    errors: dict[float, tuple[float, float]] = {}

    def growth(octave: float) -> float:
        if octave not in errors:
            softer = replace(
                stage, stiffness=stage.stiffness * 2.0**octave, preload=None
            )
            found = mode_of(ensemble, velocity, softer).growth
            rate = -velocity / ensemble.thresholds.mean
            rate = rate if found.value is None else found.value
            errors[octave] = rate, found.stderr or 0.0
            progress(len(errors), 2.0 * _OCTAVES)
        return errors[octave][0]

    direction = 1.0 if growth(0.0) > 0.0 else -1.0
    end = 0.0
    while growth(end + direction) * direction > 0.0:
        end += direction
        if abs(end) >= _OCTAVES:
            if direction > 0.0:
                return Estimate(None, None, 0, None, False)
            return Estimate(0.0, stage.stiffness * 2.0**end, 0)
    low, high = sorted((end, end + direction))
    root = float(optimize.brentq(growth, low, high, xtol=_CLOSE, rtol=_CLOSE))
    near = sorted(errors, key=lambda octave: abs(octave - root))[:2]
    slope = abs((errors[near[0]][0] - errors[near[1]][0]) / (near[0] - near[1]))
    error = math.inf
    if slope:
        octaves = max(errors[octave][1] for octave in near) / slope + _CLOSE
        error = octaves * math.log(2.0)
    value = stage.stiffness * 2.0**root
    return Estimate(value, value * error, 0)
