"""Whether a slider that a spring pulls slides steadily, or sticks and slips (derived).

Two borders in kappa_s, the stiffness of the spring over that of all contacts. On the way from a fresh start friction
overshoots, as contacts that began together break together, and falls with X: a spring softer than the steepest fall
cannot follow, and the slider slips. In the steady state a small perturbation grows or decays: without heat, aging and
delay neither, as friction is then the same whatever X(t) does; with a delay by the characteristic equation
(`master.characteristic`); else as a kick does in mean field (`master.kicks`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_number, under
from eqsim.estimate import Estimate, known
from eqsim.laws.aging import Unaged
from eqsim.master import characteristic, kicks
from eqsim.master.profile import Profile, profile_of
from eqsim.master.programme import course_of
from eqsim.master.steady import reference, settled
from eqsim.master.transient import means_of, transient
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import pull_of, reduced
from eqsim.numerics.tables import Array
from eqsim.results import Result

NEUTRAL = "no perturbation grows or decays: without heat, aging and delay friction is the same at any X(t)"

_LIVES, _PER_WIDTH, _LEAST, _MOST = 8.0, 40.0, 1000, 40_000  # of the fresh transient: length, cells
_PROFILE_STEP = 0.015  # in ln x, over which a profile may be wrong by its error
_CERTAIN = 2.0  # errors by which a rate must differ from 0


@dataclass(frozen=True, repr=False)
class FreshSlip(Result):
    """The first slip of contacts that start together.

    Attributes
    ----------
    critical_stiffness : Estimate
        Largest -dF/dX of the fresh transient at constant velocity; a spring with a smaller kappa_s slips. Exact where F
        depends on X only (T = 0, no delay, no aging) and the slider has neither damping nor mass. `stderr` is the error
        of the solver. 0 where friction never falls, infinite for discrete thresholds, which break together.
    X : Estimate
        Where that is (length); without a value where it is 0 or infinite.
    peak_ratio : Estimate
        Largest force on the way over steady friction.
    """

    critical_stiffness: Estimate
    X: Estimate
    peak_ratio: Estimate


@dataclass(frozen=True, repr=False)
class Stability(Result):
    """Of a slider that a stage pulls at constant velocity.

    Attributes
    ----------
    velocity, stiffness : float
        Of the stage (length/time), and kappa_s.
    fresh : FreshSlip
    critical_stiffness : Estimate
        Below it steady sliding is unstable; without a value if it was not asked for or not found.
    growth, period : Estimate
        Of the slowest perturbation of steady sliding at this kappa_s: its rate (1/time; negative: it decays) and period
        (time), the latter without a value if it does not oscillate, both if all decay within a fraction of a cycle, or
        not exponentially (heavy-tailed thresholds). `stderr` is the error of the solver.
    method : str
        What was solved.
    """

    velocity: float
    stiffness: float
    fresh: FreshSlip
    critical_stiffness: Estimate
    growth: Estimate
    period: Estimate
    method: str

    def estimates(self, *, brief: bool = False) -> dict[str, Estimate]:
        """Its numbers by name, those of the fresh start as fresh_critical_stiffness, ..."""
        fresh = {f"fresh_{name}": estimate for name, estimate in self.fresh.estimates().items()}
        names = ("critical_stiffness", "growth", "period")
        return {**{name: getattr(self, name) for name in names}, **fresh}

    @property
    def fresh_slips(self) -> bool:
        """Whether the slider slips on the way from a fresh start."""
        return self.stiffness < known(self.fresh.critical_stiffness)

    @property
    def verdict(self) -> str:
        """Of steady sliding: "stable", "unstable", "neutral", or "undecided" where the error is too large."""
        if self.method == NEUTRAL:
            return "neutral"
        if self.growth.value is None:
            border = self.critical_stiffness.value
            return "undecided" if border is not None and self.stiffness < border else "stable"
        if not self.growth.reliable or abs(self.growth.value) <= _CERTAIN * (self.growth.stderr or 0.0):
            return "undecided"
        return "unstable" if self.growth.value > 0.0 else "stable"


class Pulled(NamedTuple):
    """A run that has a stability: what is pulled, how fast, and by what."""

    ensemble: Ensemble
    velocity: float
    stage: Stage

    def programme(self) -> Programme:
        """Some of it."""
        time = self.ensemble.thresholds.mean / self.velocity
        return Programme((Segment(self.velocity, time=time),), stage=self.stage)

    @property
    def method(self) -> str:
        """How perturbations of its steady state are found."""
        s = reduced(self.ensemble, self.velocity)
        if s.barrier.thermal or not isinstance(s.aging, Unaged):
            return kicks.METHOD
        return characteristic.METHOD if s.delay.mean else NEUTRAL

    @property
    def quick(self) -> bool:
        """Whether its critical stiffness takes no mean-field runs."""
        return self.method != kicks.METHOD


def pulled_by(ensemble: Ensemble, drive: Drive | Programme) -> Pulled:
    """Raises InputError unless a stage moves in one direction at constant velocity, and contacts have a mean field."""
    if not isinstance(drive, Programme) or drive.stage is None:
        raise InputError("drive.stage: is required; without a spring the slider moves as it is told")
    if len(drive.segments) != 1 or not drive.segments[0].velocity > 0.0:
        raise InputError("drive.programme: stability is that of a stage at one constant velocity > 0")
    pulled = Pulled(ensemble, drive.segments[0].velocity, drive.stage)
    course_of(ensemble, pulled.programme())
    return pulled


def stability(
    ensemble: Ensemble,
    drive: Programme,
    *,
    critical: bool | None = None,
    progress: Callable[[int, float], None] = lambda *_: None,
) -> Stability:
    """The stability of sliding through a spring (derived).

    Parameters
    ----------
    ensemble : Ensemble
    drive : Programme
        With a stage and one segment; where and how it starts does not matter.
    critical : bool, optional
        Whether to look for the critical stiffness of steady sliding, too; by default where the characteristic equation
        gives it. In mean field it takes up to some minutes.
    progress : callable
        Called with (done, total) meanwhile, of kicks or of stiffnesses tried.

    Returns
    -------
    Stability

    Raises
    ------
    InputError
        Without a stage, for programmes of several segments and holds; for contacts without a mean field (annealed ones
        that age, the rule "langevin"); for identical contacts with a fixed delay, and delays of thousands of lives; and
        for a slider whose damping is too small beside its mass.
    """
    pulled = pulled_by(ensemble, drive)
    mode = _mode(pulled, progress)  # may refuse
    fresh = fresh_slip(ensemble, pulled.velocity)
    border = Estimate(None, None, 0)
    if critical or (critical is None and pulled.quick):
        border = critical_stiffness(pulled, progress)
    return Stability(pulled.velocity, pulled.stage.stiffness, fresh, border, *mode, pulled.method)


def critical_stiffness(pulled: Pulled, progress: Callable[[int, float], None] = lambda *_: None) -> Estimate:
    """kappa_s below which steady sliding is unstable; 0 where it never is. Raises InputError."""
    if pulled.method == NEUTRAL:
        return Estimate(0.0, 0.0, 0)
    if pulled.method == kicks.METHOD:
        return kicks.border_by_kicks(*pulled, progress)
    fine, coarse, scan = _loops(pulled)
    found, rough = characteristic.border_of(fine, scan), characteristic.border_of(coarse, scan)
    if math.isinf(found.stiffness):
        return Estimate(math.inf, 0.0, 0)
    return Estimate(found.stiffness, abs(found.stiffness - rough.stiffness) + 1e-12, 0)


def border(
    pulled: Pulled,
    velocities: Sequence[float],
    *,
    critical: bool = True,
    progress: Callable[[int, float], None] = lambda *_: None,
) -> dict[str, Array]:
    """Critical stiffnesses over velocity.

    Parameters
    ----------
    velocities : sequence of float
        Of the stage (length/time).
    critical : bool
        Whether to look for that of steady sliding, too.
    progress : callable
        Called with (done, total) after each velocity.

    Returns
    -------
    dict of ndarray, shape (velocities,)
        velocity, critical_stiffness and fresh_critical_stiffness, the last two also with _error; NaN where there is
        none.

    Raises
    ------
    InputError
    """
    rows = []
    for done, velocity in enumerate(velocities):
        require_number("velocity", velocity, above=0.0)
        here = pulled._replace(velocity=float(velocity))
        found = critical_stiffness(here) if critical else Estimate(None, None, 0)
        fresh = fresh_slip(here.ensemble, here.velocity).critical_stiffness
        rows.append([velocity, *(_number(part) for one in (found, fresh) for part in (one.value, one.stderr))])
        progress(done + 1, len(velocities))
    names = "velocity", "critical_stiffness", "critical_stiffness_error"
    return dict(zip((*names, *(f"fresh_{name}" for name in names[1:])), np.array(rows, float).T, strict=True))


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _loops(pulled: Pulled) -> list[characteristic.Loop]:
    s = reduced(pulled.ensemble, pulled.velocity)
    with under("drive"):
        pull = pull_of(pulled.ensemble, pulled.programme())
    nodes = characteristic.FINE, characteristic.COARSE, characteristic.SCAN
    return [characteristic.loop_of(s, pull, one) for one in nodes]


def _mode(pulled: Pulled, progress: Callable[[int, float], None]) -> kicks.Mode:
    """The slowest perturbation of steady sliding."""
    nothing = Estimate(None, None, 0)
    if pulled.method == NEUTRAL:
        return kicks.Mode(Estimate(0.0, 0.0, 0), nothing)
    if pulled.method == kicks.METHOD:
        return kicks.mode_of(*pulled, progress)
    fine, coarse, scan = _loops(pulled)
    found = characteristic.root_of(fine, scan, pulled.stage.stiffness)
    if found is None:
        return kicks.Mode(nothing, nothing)
    rough = characteristic.nearest_root(coarse, found, pulled.stage.stiffness)
    rate = pulled.velocity / pulled.ensemble.thresholds.scale
    error = abs(found - rough) + 1e-9 * abs(found)
    growth = Estimate(found.real * rate, error * rate, 0)
    if found.imag <= 1e-9 * abs(found):
        return kicks.Mode(growth, nothing)
    period = 2.0 * math.pi / (found.imag * rate)
    return kicks.Mode(growth, Estimate(period, period * error / found.imag, 0))


def fresh_slip(ensemble: Ensemble, velocity: float) -> FreshSlip:
    """The steepest fall of the fresh transient (derived).

    The renewal equation of `master.transient` on three grids, each with half the cells of the next: differentiated
    splines through values that are extrapolated as of second order, from the finer two, and their difference from those
    of the coarser two as the error.

    Parameters
    ----------
    ensemble : Ensemble
    velocity : float
        Constant, of slider and stage (length/time).

    Returns
    -------
    FreshSlip

    Raises
    ------
    InputError
        As `transient`.
    """
    s, unit = settled(ensemble, velocity), ensemble.thresholds.scale
    steady = reference(ensemble, Drive(velocity))
    friction, error = known(steady.friction), steady.friction.stderr or 0.0
    distance = _LIVES * known(steady.travel) / unit
    if s.law.steps.size:
        way = transient(ensemble, Drive(velocity, distance * unit))
        at = int(np.argmax(way.force))
        ratio = way.force[at] / friction
        missed = way.force_error[at] / friction + ratio * error / friction
        nowhere = Estimate(None, None, 0)
        return FreshSlip(Estimate(math.inf, 0.0, 0), nowhere, Estimate(float(ratio), float(missed), 0))
    profile = profile_of(s)
    forces, x = _on_three_grids(profile, s, distance)
    rough, fine = (4.0 * forces[1][::2] - forces[0]) / 3.0, (4.0 * forces[2][::2] - forces[1]) / 3.0
    fall, X, peak = _steepest(x[::4], rough), _steepest(x[::2], fine), max(rough.max(), fine.max())
    (slope, at_X, highest), level = X, friction / unit
    uncertain = profile.error * peak / (_PROFILE_STEP * max(at_X, x[1]))
    critical = Estimate(max(slope, 0.0), abs(slope - fall[0]) + uncertain, 0)
    place = Estimate(at_X * unit, (abs(at_X - fall[1]) + x[1] * 1e-3) * unit, 0)
    ratio, missed = max(highest, level) / level, abs(highest - fall[2]) / level
    ratio_error = missed + ratio * (profile.error + error / friction)
    return FreshSlip(critical, place if slope > 0.0 else Estimate(None, None, 0), Estimate(ratio, ratio_error, 0))


def _on_three_grids(profile: Profile, s: Any, distance: float) -> tuple[list[Array], Array]:
    """Forces at the edges of three grids, and those of the finest; cells resolve how sharply lives end."""
    quick, slow = (float(profile.x[np.argmax(profile.survive <= share)]) for share in (0.75, 0.25))
    cells = int(min(max(_PER_WIDTH * distance / max(slow - quick, 1e-300), _LEAST), _MOST))
    x = distance / (4 * cells) * np.arange(4 * cells + 1)
    return [means_of(profile, x[::step], s).force for step in (4, 2, 1)], x


def _steepest(x: Array, force: Array) -> tuple[float, float, float]:
    """Largest -dF/dx, where it is, and the largest F."""
    curve = CubicSpline(x, force)
    slope = curve.derivative()
    bends, tops = slope.derivative().roots(extrapolate=False), slope.roots(extrapolate=False)
    bends = bends[np.isfinite(bends)]
    fall = -slope(np.append(bends, x[[0, -1]]))
    at = int(np.argmax(fall))
    highest = max(float(force.max()), float(np.max(curve(tops[np.isfinite(tops)]), initial=0.0)))
    return float(fall[at]), float(np.append(bends, x[[0, -1]])[at]), highest
