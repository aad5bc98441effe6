"""Response of steady sliding to a small kick of the spring, in mean field (derived): a
second way to the roots of the characteristic equation.

The slider starts in the stationary state, its spring stretched by a kick more than what
balances friction, and again by as much less. Half the difference of the two
displacements is free of terms that are even in the kick: those of second order, and the
error of the balance. It is a sum of damped oscillations about the displaced balance,
whose rates a matrix pencil finds: shifted by one sample, they span the same space.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from eqsim.estimate import Estimate, known
from eqsim.master.characteristic import NO_VALUE, Mode, mode
from eqsim.master.slider import solutions_of
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

METHOD = "mean field"

# The kick, in mean thresholds.
_KICK = 4e-3
# Displacement beyond which a response is not small, in mean thresholds.
_NOT_SMALL = 3e-2
# Noise of the solver, in mean thresholds.
_SOLVER_NOISE = 1e-5
# Most other kicks that are tried.
_OTHER_KICKS = 2
# Cycles over which a response has to be small and above the noise.
_SEEN_CYCLES = 3.0
# Cycles after a kick that are solved for.
_CYCLES_AFTER = 8.0
# Instants in these cycles.
_INSTANTS = 401
# Share of the kick below which a response after a cycle has no rate.
_GONE = 0.02
# Beginnings of windows, in cycles.
_STARTS = (1.0, 0.5, 0.25)
# Most octaves of the stiffness over which a border is sought.
_MOST_OCTAVES = 6
# Accuracy of a border in octaves.
_CLOSENESS = 2e-3

# Called with (done, total).
Told = Callable[[int, float], None]


class _Response(NamedTuple):
    """Part of X - V t - kick that is odd in the kick, at intervals dt, and the same by
    longer steps of the solver."""

    u: Array
    coarser: Array
    dt: float

    def end(self, typical: float) -> int:
        """Last sample at which the response is small, and above the noise."""
        size = np.abs(self.u) / typical
        small = size[: int(np.argmax(np.append(size, math.inf) > _NOT_SMALL)) + 1]
        seen = np.flatnonzero(small > _SOLVER_NOISE).max(initial=0)
        return max(int(seen), min(24, size.size - 1))

    def rate(self, first: int, last: int, order: int) -> complex:
        """Rate p, Im p >= 0, of the strongest of `order` exponentials exp(p t) between
        two samples."""
        u = self.u[first : last + 1]
        rows = np.lib.stride_tricks.sliding_window_view(u, max(order + 1, u.size // 2))
        basis = linalg.svd(rows, full_matrices=False)[2][:order].T
        z = linalg.eigvals(linalg.lstsq(basis[:-1], basis[1:])[0])
        z = z[np.abs(z) > 1e-12]
        powers = z ** np.arange(u.size)[:, None]
        size = np.abs(linalg.lstsq(powers, u.astype(complex))[0])
        size *= np.sqrt((np.abs(powers) ** 2).mean(axis=0))
        p = np.log(z[np.argmax(size)]) / self.dt
        return complex(p.real, abs(p.imag))


def mode_of(
    ensemble: Ensemble, velocity: float, stage: Stage, progress: Told = lambda *_: None
) -> Mode:
    """The slowest oscillation after a kick; not `reliable` if seen for less than half a
    cycle.

    The error is the largest change by a kick twice as large, by a shorter window, by
    half as many exponentials more, and by steps of the solver twice as long.
    `progress(done, total)` counts kicks, of which there may be fewer. Raises InputError
    where there is no mean field.
    """
    most = _OTHER_KICKS + 2
    progress(0, most)
    exact, typical = reference(ensemble, Drive(velocity)), ensemble.thresholds.mean
    cycle = known(exact.break_stretch) / velocity + ensemble.delay_time(velocity)
    longest = max(cycle, 2.0 * math.pi * math.sqrt(stage.mass / stage.stiffness))
    kick, time = _KICK * typical, _CYCLES_AFTER * longest
    balance = known(exact.friction) + stage.damping * velocity
    response = _response(ensemble, velocity, stage, balance, kick, time)
    for done in range(1, _OTHER_KICKS + 1):
        progress(done, most)
        last = response.end(typical)
        if last * response.dt >= _SEEN_CYCLES * longest:
            break
        grows = float(np.abs(response.u[last])) > 0.5 * _NOT_SMALL * typical
        kick *= 0.2 if grows else 5.0
        time = min(time, (_SEEN_CYCLES + 1.0) * longest)
        response = _response(ensemble, velocity, stage, balance, kick, time)
    if float(np.abs(response.u[round(longest / response.dt) :]).max()) < _GONE * kick:
        return Mode(NO_VALUE, NO_VALUE)
    last = response.end(typical)
    seen = last * response.dt / longest
    start = next((cycles for cycles in _STARTS if seen >= cycles + 1.0), _STARTS[-1])
    first = min(round(start * longest / response.dt), max(last - 16, 0))
    p = response.rate(first, last, 4)
    progress(most - 1, most)
    twice = _response(ensemble, velocity, stage, balance, 2.0 * kick, time)
    others = [
        twice.rate(first, min(last, twice.end(2.0 * typical)), 4),
        response.rate(first, last, 6),
        response.rate(first, first + (3 * (last - first)) // 4, 4),
        response._replace(u=response.coarser).rate(first, last, 4),
    ]
    error = max(abs(other - p) for other in others)
    sure = (last - first) * response.dt >= 0.5 * longest and error < abs(p)
    return mode(p, error, 1e-3 / longest, sure)


def _response(
    ensemble: Ensemble,
    velocity: float,
    stage: Stage,
    balance: float,
    kick: float,
    time: float,
) -> _Response:
    """Response to a kick of the spring that carries the force `balance` before."""
    X = []
    for stretch in (kick, -kick):
        pulled = replace(stage, preload=balance / stage.stiffness + stretch)
        segments = (Segment(velocity, time=time),)
        programme = Programme(segments, "stationary", velocity, pulled)
        best, coarser, _ = solutions_of(ensemble, programme, programme.grid(_INSTANTS))
        X.append(np.array([best.X, coarser.X]) * ensemble.thresholds.scale)
    u, coarser = 0.5 * (X[0] - X[1]) - kick
    return _Response(u, coarser, time / (_INSTANTS - 1))


def border_by_kicks(
    ensemble: Ensemble, velocity: float, stage: Stage, progress: Told = lambda *_: None
) -> Estimate:
    """Find the stiffness at which a kick neither grows nor decays. It is 0 if a kick
    decays even at 1/64 of the stage's stiffness, which is then the error; without a
    value if it grows even at 64 times that stiffness."""
    errors: dict[float, tuple[float, float]] = {}
    most = 2 * _MOST_OCTAVES + 1

    def growth(octave: float) -> float:
        if octave not in errors:
            stiffness = stage.stiffness * 2.0**octave
            other = replace(stage, stiffness=stiffness, preload=None)
            rate = mode_of(ensemble, velocity, other).growth
            decay = -velocity / ensemble.thresholds.mean
            value = decay if rate.value is None else rate.value
            errors[octave] = value, rate.stderr or 0.0
            progress(min(len(errors), most - 1), most)
        return errors[octave][0]

    direction, end = 1.0 if growth(0.0) > 0.0 else -1.0, 0.0
    while growth(end + direction) * direction > 0.0:
        end += direction
        if abs(end) >= _MOST_OCTAVES:
            if direction > 0.0:
                return Estimate(None, None, 0, None, False)
            return Estimate(0.0, stage.stiffness * 2.0**end, 0)
    low, high = sorted((end, end + direction))
    root = float(optimize.brentq(growth, low, high, xtol=_CLOSENESS, rtol=_CLOSENESS))
    near = sorted(errors, key=lambda octave: abs(octave - root))[:2]
    slope = abs((errors[near[0]][0] - errors[near[1]][0]) / (near[0] - near[1]))
    error = math.inf
    if slope:
        octaves = max(errors[octave][1] for octave in near) / slope + _CLOSENESS
        error = octaves * math.log(2.0)
    value = stage.stiffness * 2.0**root
    return Estimate(value, value * error, 0)
