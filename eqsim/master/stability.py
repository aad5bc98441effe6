"""Whether a slider that a spring pulls slides steadily, or sticks and slips (derived).

Two borders in kappa_s, the stiffness of the spring over that of all contacts. On the
way from a fresh start friction overshoots, as contacts that began together break
together, and falls with X: a spring softer than the steepest fall cannot follow, and
the slider slips. In the steady state a small perturbation grows or decays: without
heat, aging and delay neither, as friction is then the same whatever X(t) does; with a
delay by the characteristic equation (`master.characteristic`); else as a kick does in
mean field (`master.kicks`).
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_number, under
from eqsim.estimate import Estimate, known
from eqsim.laws.aging import Unaged
from eqsim.master import characteristic, kicks
from eqsim.master.profile import SmoothLife, profile_of
from eqsim.master.programme import course_of
from eqsim.master.steady import reference, settled
from eqsim.master.transient import convolved, from_birth, means_of, middle_half
from eqsim.model.drive import Drive, Programme, Segment, Stage, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, pull_of, reduced
from eqsim.model.slip import least_slip
from eqsim.numerics.quadrature import extrapolated
from eqsim.numerics.tables import Array
from eqsim.results import Result

NEUTRAL = "no perturbation grows or decays: without heat, aging and delay friction is the same at any X(t)"

# Length of the fresh transient in mean lives; cells of its coarsest grid in the middle
# half of the ends of lives.
_LIVES = 8.0
_PER_WIDTH = 40.0
# Fewest and most cells.
_LEAST = 1000
_MOST = 40_000
# Points in the smallest slip of discrete thresholds, and chords from it to twice its
# length.
_PER_SLIP = 100.0
_CHORDS = 60
# Points between three candidates for an extremum: it is then missed by 1e-5 of what
# these differ by.
_NEAR = 401
# Cells of the coarser grid around an extremum within which two grids are compared.
_AROUND = 4.0
# Error of the place of a steepest fall, in cells, where slopes are all but even.
_FLAT = 0.1
# Panels of a life narrower than this in ln x surround an infinite density of
# thresholds.
_SINGULAR = 1e-6
# Errors by which a rate, or a stiffness, must differ from a border.
_CERTAIN = 2.0


@dataclass(frozen=True, repr=False)
class FreshSlip(Result):
    """The first slip of contacts that start together.

    Attributes
    ----------
    critical_stiffness : Estimate
        Largest -dF/dX of the fresh transient at constant velocity: behind a spring with
        a smaller kappa_s the slider jumps. Exact where F depends on X only (T = 0, no
        delay, no aging) and the slider has neither damping nor mass. `stderr` is the
        error of the solver. 0 where friction never falls, infinite where the density of
        thresholds is. Of discrete thresholds each step is a jump at any stiffness:
        `slip_stiffness`.
    X : Estimate
        Where that is (length); without a value where it is 0.
    peak_ratio : Estimate
        Largest force on the way over steady friction.
    slip_stiffness : Estimate
        Largest (F(X) - F(X + l))/l with l at least `model.slip.least_slip`: behind a
        spring with a smaller kappa_s the slider jumps as far as a slip.
    """

    critical_stiffness: Estimate
    X: Estimate
    peak_ratio: Estimate
    slip_stiffness: Estimate


@dataclass(frozen=True, repr=False)
class Stability(Result):
    """Stability of a slider that a stage pulls at constant velocity.

    Attributes
    ----------
    velocity, stiffness : float
        Of the stage (length/time), and kappa_s.
    fresh : FreshSlip
    critical_stiffness : Estimate
        Below it steady sliding is unstable; without a value if it was not asked for or
        not found.
    growth, period : Estimate
        Of the slowest perturbation of steady sliding at this kappa_s: its rate (1/time;
        negative: it decays) and period (time), the latter without a value if it does
        not oscillate, both if all decay within a fraction of a cycle, or not
        exponentially (heavy-tailed thresholds). `stderr` is the error of the solver.
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
        """Its numbers by name, those of the fresh start as fresh_critical_stiffness,
        ..."""
        names = ("critical_stiffness", "growth", "period")
        fresh = self.fresh.estimates().items()
        return {name: getattr(self, name) for name in names} | {
            f"fresh_{name}": estimate for name, estimate in fresh
        }

    @property
    def fresh_slips(self) -> bool:
        """True if the slider slips on the way from a fresh start, as `model.slip`
        defines it."""
        return self.stiffness < known(self.fresh.slip_stiffness)

    @property
    def fresh_verdict(self) -> str:
        """The way from a fresh start: "slips", "jumps" by less than a slip, "slides",
        or "undecided" where errors of the borders do not tell."""
        if _beyond(self.stiffness, self.fresh.slip_stiffness) is None:
            return "undecided"
        if self.fresh_slips:
            return "slips"
        border = self.fresh.critical_stiffness
        # of discrete thresholds, which make steps of any size
        if self.fresh.slip_stiffness == border:
            return "slides"
        if _beyond(self.stiffness, border) is None:
            return "undecided"
        return "jumps" if self.stiffness < known(border) else "slides"

    @property
    def verdict(self) -> str:
        """Verdict on steady sliding: "stable", "unstable", "neutral", or "undecided"
        where the error is too large."""
        if self.method == NEUTRAL:
            return "neutral"
        if self.growth.value is None:
            border = self.critical_stiffness.value
            unknown = border is not None and self.stiffness < border
            return "undecided" if unknown else "stable"
        error = self.growth.stderr or 0.0
        if not self.growth.reliable or abs(self.growth.value) <= _CERTAIN * error:
            return "undecided"
        return "unstable" if self.growth.value > 0.0 else "stable"


def _beyond(stiffness: float, border: Estimate) -> bool | None:
    """Judge whether a stiffness is beyond a border; None where the error of that does
    not tell."""
    apart = stiffness - known(border)
    return None if abs(apart) <= _CERTAIN * (border.stderr or 0.0) else apart > 0.0


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
        contacts = reduced(self.ensemble, self.velocity)
        if contacts.barrier.thermal or not isinstance(contacts.aging, Unaged):
            return kicks.METHOD
        return characteristic.METHOD if contacts.delay.mean else NEUTRAL

    @property
    def quick(self) -> bool:
        """Whether its critical stiffness takes no mean-field runs."""
        return self.method != kicks.METHOD


def pulled_by(ensemble: Ensemble, drive: Drive | Programme) -> Pulled:
    """Raises InputError unless a stage moves in one direction at constant velocity, and
    contacts have a mean field."""
    if not isinstance(drive, Programme) or drive.stage is None:
        raise InputError(
            "drive.stage: is required; without a spring the slider moves as it is told"
        )
    if len(drive.segments) != 1 or not drive.segments[0].velocity > 0.0:
        raise InputError(
            "drive.programme: stability is that of a stage at one constant velocity > 0"
        )
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
    """Decide whether a slider slides steadily behind a spring (derived).

    Stiffnesses are K/(N k), numbers, for N contacts of stiffness k.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Programme
        With a stage and one segment (velocity in length/time); where and how it starts
        does not matter.
    critical : bool, optional
        Whether to look for the critical stiffness of steady sliding, too; by default
        where the characteristic equation gives it. In mean field it takes up to some
        minutes.
    progress : callable, optional
        `progress(done, total)` counts kicks, or stiffnesses that were tried.

    Returns
    -------
    Stability

    Raises
    ------
    InputError
        Without a stage, for programmes of several segments and holds; for contacts
        without a mean field (annealed ones that age, the rule "langevin"); for
        identical contacts with a fixed delay, and delays of thousands of lives; and for
        a slider whose damping is too small beside its mass.

    Examples
    --------
    >>> from eqsim import Ensemble, Programme, Segment, Stage, stability
    >>> drive = Programme([Segment(0.1, distance=1.0)], stage=Stage(stiffness=0.1))
    >>> found = stability(Ensemble(), drive)
    >>> found.verdict, found.fresh_verdict
    ('neutral', 'slips')
    """
    pulled = pulled_by(ensemble, drive)
    mode = _mode(pulled, progress)  # may refuse
    fresh = fresh_slip(ensemble, Drive(pulled.velocity))
    border = kicks.NO_VALUE
    if critical or (critical is None and pulled.quick):
        border = critical_stiffness(pulled, progress)
    return Stability(
        pulled.velocity, pulled.stage.stiffness, fresh, border, *mode, pulled.method
    )


def critical_stiffness(
    pulled: Pulled, progress: Callable[[int, float], None] = lambda *_: None
) -> Estimate:
    """kappa_s below which steady sliding is unstable; 0 where it never is. Raises
    InputError."""
    if pulled.method == NEUTRAL:
        return Estimate(0.0, 0.0, 0)
    if pulled.method == kicks.METHOD:
        return kicks.border_by_kicks(*pulled, progress)
    fine, coarse, scan = _loops(pulled)
    found = characteristic.border_of(fine, scan).stiffness
    if math.isinf(found):
        return Estimate(math.inf, 0.0, 0)
    rough = characteristic.border_of(coarse, scan).stiffness
    return Estimate(found, abs(found - rough) + 1e-12, 0)


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
        velocity, critical_stiffness and fresh_critical_stiffness, the last two also
        with _error; NaN where there is none.

    Raises
    ------
    InputError
    """
    names = "critical_stiffness", "critical_stiffness_error"
    table = {name: np.empty(len(velocities)) for name in ("velocity", *names)}
    table |= {f"fresh_{name}": np.empty(len(velocities)) for name in names}
    for row, velocity in enumerate(velocities):
        require_number("velocity", velocity, above=0.0)
        here = pulled._replace(velocity=float(velocity))
        found = critical_stiffness(here) if critical else kicks.NO_VALUE
        fresh = fresh_slip(here.ensemble, Drive(velocity)).critical_stiffness
        values = velocity, found.value, found.stderr, fresh.value, fresh.stderr
        for column, value in zip(table.values(), values, strict=True):
            column[row] = math.nan if value is None else value
        progress(row + 1, len(velocities))
    return table


def _loops(pulled: Pulled) -> list[characteristic.Loop]:
    contacts = reduced(pulled.ensemble, pulled.velocity)
    with under("drive"):
        pull = pull_of(pulled.ensemble, pulled.programme())
    nodes = characteristic.FINE, characteristic.COARSE, characteristic.SCAN
    return [characteristic.loop_of(contacts, pull, number) for number in nodes]


def _mode(pulled: Pulled, progress: Callable[[int, float], None]) -> kicks.Mode:
    """The slowest perturbation of steady sliding."""
    if pulled.method == NEUTRAL:
        return kicks.Mode(Estimate(0.0, 0.0, 0), kicks.NO_VALUE)
    if pulled.method == kicks.METHOD:
        return kicks.mode_of(*pulled, progress)
    fine, coarse, scan = _loops(pulled)
    found = characteristic.root_of(fine, scan, pulled.stage.stiffness)
    if found is None:
        return kicks.Mode(kicks.NO_VALUE, kicks.NO_VALUE)
    rough = characteristic.nearest_root(coarse, found, pulled.stage.stiffness)
    rate = pulled.velocity / pulled.ensemble.thresholds.scale
    error = abs(found - rough) + 1e-9 * abs(found)
    growth = Estimate(found.real * rate, error * rate, 0)
    if found.imag <= 1e-9 * abs(found):
        return kicks.Mode(growth, kicks.NO_VALUE)
    period = 2.0 * math.pi / (found.imag * rate)
    return kicks.Mode(growth, Estimate(period, period * error / found.imag, 0))


def fresh_slip(ensemble: Ensemble, drive: Drive | Programme) -> FreshSlip:
    """Solve for the steepest fall of friction on the way from a fresh start, which a
    spring must follow (derived). Stiffnesses are K/(N k), numbers.

    The renewal equation of `master.transient` on three grids, each with half the cells
    of the next, extrapolated as of second order from the finer two; the difference from
    the coarser two is the error. What survives of the contacts that started together is
    exact on both sides of every kink; the rest has a continuous slope between them.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive or Programme
        Constant velocity of slider and stage (length/time); of a stage only the
        velocity matters here. Coupled blocks are refused.

    Returns
    -------
    FreshSlip

    Raises
    ------
    InputError
        For other drives, and for contacts that `transient` refuses.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, fresh_slip
    >>> found = fresh_slip(Ensemble(stiffness_law="uniform"), Drive(velocity=0.1))
    >>> print(f"{found.critical_stiffness.value:.4f}")  # kappa_s = K/(N k)
    0.1742
    """
    if isinstance(drive, (int, float)):
        said = "fresh_slip: a velocity is deprecated; give Drive(velocity)"
        warnings.warn(said, DeprecationWarning, stacklevel=3)
        drive = Drive(drive)
    if isinstance(drive, Programme):
        drive = Drive(pulled_by(ensemble, drive).velocity)
    require_drive(drive)
    contacts, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    steady = reference(ensemble, drive)
    friction, error = known(steady.friction), steady.friction.stderr or 0.0
    distance = _LIVES * known(steady.travel) / unit
    least, level = least_slip(ensemble.thresholds) / unit, friction / unit
    profile = profile_of(contacts)
    if profile.jumps or not isinstance(profile, SmoothLife):
        return _of_steps(contacts, distance, least, level, unit)
    ways = _on_three_grids(profile, contacts, distance)
    rough, fine = _between_grids(*ways[:2]), _between_grids(*ways[1:])
    fall, fall_X, unknown = _steepest(fine, contacts)
    other, other_X, _ = _steepest(rough, contacts)
    highest, highest_X = _highest(fine)
    critical = Estimate(math.inf, 0.0, 0)
    if math.isfinite(fall):
        beside = _apart(rough.x, rough.later_slope, fine.later_slope, fall_X)
        missed = max(abs(fall - other), beside) + unknown
        missed += profile.error * max(highest, fall)
        critical = Estimate(max(fall, 0.0), missed, 0)
    place = abs(fall_X - other_X) + _FLAT * fine.x[1]
    X = Estimate(fall_X * unit, place * unit, 0)
    ratio = max(highest, level) / level
    beside = _apart(rough.x, rough.later, fine.later, highest_X)
    missed = max(abs(highest - _highest(rough)[0]), beside) / level
    missed += ratio * (profile.error + error / friction)
    slip, _ = _chord([rough, fine], least, profile.error * highest)
    X = X if fall > 0.0 else kicks.NO_VALUE
    return FreshSlip(critical, X, Estimate(ratio, missed, 0), slip)


def _of_steps(
    contacts: Reduced, distance: float, least: float, level: float, unit: float
) -> FreshSlip:
    """`fresh_slip` of contacts that break together; lengths in units of `unit`, which
    force and X are told in."""
    cells = 4 * int(min(max(0.25 * _PER_SLIP * distance / least, _LEAST), _MOST))
    x = distance * np.linspace(0.0, 1.0, cells + 1)
    profile = profile_of(contacts, x)
    grids = x[::2], x
    courses = [_Course(x, means_of(profile, x, contacts).force) for x in grids]
    rough, highest = (float(course.force.max()) for course in courses)
    slip, X = _chord(courses, least, profile.error * highest)
    # between two points a force rises by no more than the contacts are stiff
    missed = abs(highest - rough) + profile.error * highest
    missed += float(x[1] * np.abs(profile.at(x[1:2])[1]).max())
    ratio = Estimate(max(highest, level) / level, missed / level, 0)
    place = Estimate(X * unit, 2.0 * float(x[1]) * unit, 0)
    return FreshSlip(slip, place if known(slip) > 0.0 else kicks.NO_VALUE, ratio, slip)


class _Course(NamedTuple):
    """A force over equidistant displacements."""

    x: Array
    force: Array


def _chord(
    courses: Sequence["_Course | _Way"], least: float, missed: float
) -> tuple[Estimate, float]:
    """The steepest fall of a force over a displacement of `least` or more, and where it
    begins.

    A chord of twice that length or more has a half that is as steep. Where a jump is
    between points its chord may be longer or shorter by one of them.

    Parameters
    ----------
    courses : two _Course or _Way
        On two grids, the finer one last.
    missed : float
        What forces may miss besides the difference of the grids.
    """
    falls, places = [], []
    for course in courses:
        x, F = course.x, course.force
        first = math.ceil(least / x[1] * (1.0 - 1e-9))
        last = min(2 * first, x.size - 1)
        shifts = np.append(first + 1, np.linspace(first, last, _CHORDS)).astype(int)
        slopes = [(F[:-n] - F[n:]) / (n * x[1]) for n in np.unique(shifts)]
        falls.append(np.array([slope.max() for slope in slopes]))
        # the first of equal ones, as contacts in step have
        steepest = slopes[int(np.argmax(falls[-1]))]
        places.append(float(x[np.argmax(steepest >= (1.0 - 1e-6) * steepest.max())]))
    best, rough = float(falls[-1].max()), float(falls[0].max())
    beside = abs(float(falls[-1][0] - falls[-1][1]))
    error = abs(best - rough) + 2.0 * beside + 2.0 * missed / least
    return Estimate(max(best, 0.0), error, 0), places[-1]


class _Way(NamedTuple):
    """A fresh transient on a uniform grid of edges x, arrays (cells + 1,): the force,
    and the force that contacts born on the way carry, with its slope."""

    profile: SmoothLife
    x: Array
    force: Array
    later: Array
    later_slope: Array


def _on_three_grids(
    profile: SmoothLife, contacts: Reduced, distance: float
) -> list[_Way]:
    """Ever finer ones; cells resolve how sharply lives end."""
    quick, slow = middle_half(profile)
    wanted = _PER_WIDTH * distance / max(slow - quick, 1e-300)
    cells = int(min(max(wanted, _LEAST), _MOST))
    x = distance / (4 * cells) * np.arange(4 * cells + 1)
    return [_way(profile, x[::step], contacts) for step in (4, 2, 1)]


def _way(profile: SmoothLife, x: Array, contacts: Reduced) -> _Way:
    means = means_of(profile, x, contacts)
    births = means.breaks + np.diff(means.pinned) / x[1]
    first = from_birth(profile, contacts, x, 1)
    survive = np.append(1.0, profile.at(x[1:])[0])
    carried = first - _drag_before_birth(contacts) * survive
    at_edges = 0.5 * (np.append(births[0], births) + np.append(births, births[-1]))
    slope = np.append(0.0, convolved(births, np.diff(carried))[: x.size - 1])
    slope += carried[0] * at_edges
    return _Way(profile, x, means.force, means.force - first, slope)


def _drag_before_birth(contacts: Reduced) -> float:
    """The viscous force that a contact loses when it is pinned again."""
    return contacts.drag if contacts.delay.mean else 0.0


def _between_grids(coarse: _Way, better: _Way) -> _Way:
    """At the edges of the coarser grid, extrapolated as of second order."""
    pairs = zip(coarse[2:], better[2:], strict=True)
    columns = [extrapolated(a, b[::2]) for a, b in pairs]
    return _Way(coarse.profile, coarse.x, *columns)


def _steepest(way: _Way, contacts: Reduced) -> tuple[float, float, float]:
    """Largest -dF/dx, infinite where a density of thresholds is, where it is, and what
    the life's panels may miss."""
    profile, drag = way.profile, _drag_before_birth(contacts)
    later = CubicSpline(way.x, way.later_slope)

    def falls(at: Array) -> Array:
        slope = profile.slope(at, 1).value[1]
        if drag:
            slope = slope - drag * profile.slope(at).value[0]
        return np.asarray(-(slope + later(at)))

    steepest, X, edge = _greatest(falls, way)
    here = profile.slope(np.array([edge]), 1)
    if here.width[0] < _SINGULAR:
        return math.inf, X, 0.0
    return steepest, X, float(here.missed[1, 0])


def _highest(way: _Way) -> tuple[float, float]:
    """The largest force, also at kinks between edges, and where it is."""
    later = CubicSpline(way.x, way.later)
    return _greatest(lambda x: way.profile.at(x, 1)[1] + later(x), way)[:2]


def _greatest(
    function: Callable[[Array], Array], way: _Way
) -> tuple[float, float, float]:
    """The largest value of a function of displacement, where it is, and the nearest
    edge or kink: of these all, and of points between the neighbours of the largest."""
    lives = way.profile.x
    kinks = lives[(lives > 1e-6 * way.x[-1]) & (lives < way.x[-1])]
    at = np.union1d(kinks, way.x[1:])
    values = function(at)
    i = int(np.argmax(values))
    near = np.linspace(at[max(i - 1, 0)], at[min(i + 1, at.size - 1)], _NEAR)
    closer = function(near)
    j = int(np.argmax(closer))
    if closer[j] > values[i]:
        return float(closer[j]), float(near[j]), float(at[i])
    return float(values[i]), float(at[i]), float(at[i])


def _apart(x: Array, rough: Array, fine: Array, X: float) -> float:
    """Find how far splines through values at edges `x` of one grid and at every one of
    another, finer one differ around X: next to a kink by several times what the finer
    one misses, though not everywhere."""
    near = np.clip(X + _AROUND * x[1] * np.linspace(-1.0, 1.0, 33), 0.0, x[-1])
    edges = np.linspace(0.0, x[-1], fine.size)
    return float(
        np.abs(CubicSpline(edges, fine)(near) - CubicSpline(x, rough)(near)).max()
    )
