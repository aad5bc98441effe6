"""Stability of a slider that a spring pulls: steady sliding or stick-slip (derived).

Two borders in kappa_s, the stiffness of the spring over that of all contacts. On the
way from a fresh start friction overshoots, as contacts that began together break
together, and falls with X: a spring softer than the steepest fall cannot follow, and
the slider slips. In the steady state a small perturbation grows or decays, at a rate
that follows from the characteristic equation (`master.characteristic`). Without heat,
aging and delay it does neither, as friction is the same for any X(t).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_number, under
from eqsim.estimate import Estimate, known
from eqsim.laws.aging import Unaged
from eqsim.laws.barrier import Mechanical
from eqsim.master import characteristic
from eqsim.master.characteristic import (
    NO_VALUE,
    OF_COARSER,
    Loop,
    Mode,
    border_of,
    guesses_of,
    loop_of,
    mode,
    roots_from,
    slowest_first,
)
from eqsim.master.idle import IDLE, shift_by_heat
from eqsim.master.profile import Profile
from eqsim.master.programme import course_of
from eqsim.master.steady import reference, settled
from eqsim.master.transient import after, from_birth, middle_half, renewal_of
from eqsim.model.drive import Drive, Programme, Segment, Stage, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, pull_of, reduced
from eqsim.model.slip import least_slip
from eqsim.numerics.quadrature import extrapolated
from eqsim.numerics.tables import Array
from eqsim.results import Result

NEUTRAL = (
    "no perturbation grows or decays: without heat, aging and delay friction is the "
    "same at any X(t)"
)

# Length of the fresh transient in mean lives.
_MEAN_LIVES = 8.0
# Cells of its coarsest grid between the travels where the middle half of lives end.
_CELLS_PER_WIDTH = 40.0
# Fewest cells of the coarsest grid.
_COARSEST_GRID = 1000
# How many times as many of laws with kinks, next to which slopes of births converge as
# of first order.
_FINER_AT_KINKS = 4
# Largest error of such a slope over the difference of two grids, 1.7 of 120 laws: it
# depends on where in its cell the kink lies.
_BETWEEN_GRIDS = 2.0
# Most cells of the coarsest grid.
_FINEST_GRID = 40_000
# Points in the smallest slip of discrete thresholds.
_PER_SLIP = 100.0
# Lengths of chords that are tried, from the smallest slip to twice its length.
_CHORDS = 60
# Points between three candidates for an extremum: its error is 1e-5 of their
# differences.
_NEAR = 401
# Cells of the coarser grid around an extremum within which two grids are compared.
_COMPARED_CELLS = 4.0
# Error of the place of a steepest fall, in cells, where slopes are all but even.
_EVEN_SLOPE = 0.1
# Panels of a life narrower than this in ln x surround an infinite density of
# thresholds.
_SINGULAR = 1e-6
# Mean thresholds over which heat has to be idle to be left out.
_LIVES_OF_A_CYCLE = 10.0
# Errors by which a rate, or a stiffness, must differ from a border.
_SURE = 2.0
# Difference of a root from that of coarser panels, over its growth or decay, from which
# on it is none if they do not resolve it.
_SAME_ROOT = 0.01
# How many times as many panels of ages as usual resolve a higher frequency.
_FINER_AGES = 4

Found = TypeVar("Found", bound=tuple[Any, complex])


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
        Place of the steepest fall (length); without a value if friction never falls.
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
        Velocity of the stage (length/time), and kappa_s.
    fresh : FreshSlip
    critical_stiffness : Estimate
        Below it steady sliding is unstable; without a value if it was not asked for or
        not found.
    growth, period : Estimate
        Rate (1/time; negative: it decays) and period (time) of the slowest perturbation
        of steady sliding at this kappa_s; the period has no value if it does not
        oscillate, neither has one if none is found: all decay within a fraction of a
        cycle, or not exponentially (heavy-tailed thresholds), or, of contacts that heat
        breaks or that age, behind very stiff springs. `stderr` is the solver's error.
    method : str
        Method by which perturbations were found.
    """

    velocity: float
    stiffness: float
    fresh: FreshSlip
    critical_stiffness: Estimate
    growth: Estimate
    period: Estimate
    method: str

    def estimates(self, *, brief: bool = False) -> dict[str, Estimate]:
        """Estimates by name, those of the fresh start as fresh_critical_stiffness,
        ..."""
        names = ("critical_stiffness", "growth", "period")
        fresh = {f"fresh_{name}": x for name, x in self.fresh.estimates().items()}
        return {name: getattr(self, name) for name in names} | fresh

    @property
    def fresh_slips(self) -> bool:
        """True if the slider slips on the way from a fresh start, as `model.slip`
        defines it."""
        return self.stiffness < known(self.fresh.slip_stiffness)

    @property
    def fresh_verdict(self) -> str:
        """Verdict on the way from a fresh start: "slips", "jumps" by less than a slip,
        "slides", or "undecided" where the errors of the borders are too large."""
        slip, jump = self.fresh.slip_stiffness, self.fresh.critical_stiffness
        for border, below in ((slip, "slips"), (jump, "jumps")):
            apart = self.stiffness - known(border)
            if abs(apart) <= _SURE * (border.stderr or 0.0):
                return "undecided"
            if apart < 0.0:
                return below
            if slip == jump:  # of discrete thresholds, which make steps of any size
                break
        return "slides"

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
        if not self.growth.reliable or abs(self.growth.value) <= _SURE * error:
            return "undecided"
        return "unstable" if self.growth.value > 0.0 else "stable"


class Loops(NamedTuple):
    """The characteristic equation with fine and with coarse nodes, and for scans."""

    fine: Loop
    coarse: Loop
    scan: Loop


class SteadyPull(NamedTuple):
    """Contacts that a stage pulls at constant velocity (length/time)."""

    ensemble: Ensemble
    velocity: float
    stage: Stage

    def programme(self) -> Programme:
        """A drive over a mean threshold."""
        time = self.ensemble.thresholds.mean / self.velocity
        return Programme((Segment(self.velocity, time=time),), stage=self.stage)

    @property
    def contacts(self) -> Reduced:
        """Dimensionless contacts, without heat where that changes next to nothing over
        some lives."""
        contacts = reduced(self.ensemble, self.velocity)
        typical = contacts.law.mean / contacts.law.scale
        if shift_by_heat(contacts, _LIVES_OF_A_CYCLE * typical) > IDLE * typical:
            return contacts
        return contacts._replace(barrier=Mechanical())

    @property
    def method(self) -> str:
        """Method by which perturbations of the steady state are found."""
        contacts = self.contacts
        still = isinstance(contacts.aging, Unaged) and not contacts.delay.mean
        neutral = still and not contacts.barrier.thermal
        return NEUTRAL if neutral else characteristic.METHOD

    def loops(self, finer: int = 1) -> Loops:
        """Loops with ages in `finer` times as many panels as usual."""
        contacts = self.contacts
        with under("drive"):
            pull = pull_of(self.ensemble, self.programme())
        nodes = characteristic.FINE, characteristic.COARSE, characteristic.SCAN
        return Loops(
            *(loop_of(contacts, pull, x._replace(ages=finer * x.ages)) for x in nodes)
        )

    def resolved(
        self, loops: Loops, find: Callable[[Loops], Found]
    ) -> tuple[Found, Loops]:
        """Find something, [1] of which is a frequency or a rate, with these loops, or
        with finer ones where they do not resolve it; and the loops that were taken."""
        found = find(loops)
        if not loops.fine.resolves(found[1]):
            loops = self.loops(_FINER_AGES)
            found = find(loops)
        return found, loops


def pulled_by(ensemble: Ensemble, drive: Drive | Programme) -> SteadyPull:
    """The pull of a run. Raises InputError unless a stage moves in one direction at
    constant velocity, and contacts have a mean field."""
    if not isinstance(drive, Programme) or drive.stage is None:
        raise InputError(
            "drive.stage: is required; without a spring the motion is prescribed"
        )
    if len(drive.segments) != 1 or not drive.segments[0].velocity > 0.0:
        raise InputError(
            "drive.programme: stability is that of a stage at one constant velocity > 0"
        )
    velocity = drive.segments[0].velocity
    ensemble.require_steady_state(velocity)
    pulled = SteadyPull(ensemble, velocity, drive.stage)
    course_of(ensemble, pulled.programme())
    return pulled


def stability(
    ensemble: Ensemble,
    drive: Programme,
    *,
    critical: bool = True,
) -> Stability:
    """Decide whether a slider slides steadily behind a spring (derived).

    Stiffnesses are K/(N k), numbers, for N contacts of stiffness k.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Programme
        With a stage and one segment (velocity in length/time); where and how it starts
        does not matter.
    critical : bool
        Whether to look for the critical stiffness of steady sliding, too.

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
    >>> result = stability(Ensemble(), drive)
    >>> result.verdict, result.fresh_verdict
    ('neutral', 'slips')
    """
    pulled = pulled_by(ensemble, drive)
    slowest = _mode(pulled)  # may refuse
    fresh = fresh_slip(ensemble, Drive(pulled.velocity))
    border = critical_stiffness(pulled) if critical else NO_VALUE
    return Stability(
        pulled.velocity, pulled.stage.stiffness, fresh, border, *slowest, pulled.method
    )


def critical_stiffness(pulled: SteadyPull) -> Estimate:
    """kappa_s below which steady sliding is unstable; 0 where it never is. Raises
    InputError."""
    if pulled.method == NEUTRAL:
        return Estimate(0.0, 0.0, 0)
    (stiffness, frequency), loops = pulled.resolved(
        pulled.loops(), lambda each: border_of(each.fine, each.scan)
    )
    if math.isinf(stiffness):
        return Estimate(math.inf, 0.0, 0)
    rough = border_of(loops.coarse, loops.scan).stiffness
    error = OF_COARSER * abs(stiffness - rough) + 1e-12
    reliable = loops.fine.resolves(frequency)
    return Estimate(stiffness, error, 0, None, reliable)


def critical_stiffnesses(
    pulled: SteadyPull,
    velocities: Sequence[float],
    *,
    critical: bool = True,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> dict[str, Array]:
    """Critical stiffnesses at velocities of the stage, of steady sliding only if
    `critical`, and of a fresh start, by column, with errors; NaN where there is none.
    `progress(done, total)` counts velocities. Raises InputError."""
    stiffness = "critical_stiffness", "critical_stiffness_error"
    names = "velocity", *stiffness, *(f"fresh_{name}" for name in stiffness)
    rows = []
    for velocity in velocities:
        require_number("velocity", velocity, above=0.0)
        other = pulled._replace(velocity=float(velocity))
        steady = critical_stiffness(other) if critical else NO_VALUE
        fresh = fresh_slip(other.ensemble, Drive(other.velocity)).critical_stiffness
        rows.append((velocity, steady.value, steady.stderr, fresh.value, fresh.stderr))
        progress(len(rows), len(velocities))
    # None becomes NaN
    return dict(zip(names, np.array(rows, float).reshape(-1, 5).T, strict=True))


def _mode(pulled: SteadyPull) -> Mode:
    """The slowest perturbation of steady sliding."""
    if pulled.method == NEUTRAL:
        return Mode(Estimate(0.0, 0.0, 0), NO_VALUE)
    stiffness, usual = pulled.stage.stiffness, pulled.loops()
    guesses = guesses_of(usual.scan, stiffness)

    def find(loops: Loops) -> tuple[list[complex], complex]:
        roots = slowest_first(loops.fine, guesses, stiffness)
        return roots, roots[0] if roots else 0.0

    (roots, _), loops = pulled.resolved(usual, find)
    rate, sure = pulled.velocity / pulled.ensemble.thresholds.scale, True
    for p in roots:
        near = roots_from(loops.coarse, np.array([p]), stiffness)
        missed = min(map(abs, (p - near).tolist()), default=math.inf)
        if loops.fine.resolves(p) or missed < _SAME_ROOT * abs(p.real):
            least = 1e-9 * abs(p) * rate
            return mode(p * rate, OF_COARSER * missed * rate + least, least, sure)
        # coarser panels do not have this root, so that it is none
        sure = sure and p.real < 0.0
    return Mode(NO_VALUE, NO_VALUE)


def fresh_slip(ensemble: Ensemble, drive: Drive | Programme) -> FreshSlip:
    """Solve for the steepest fall of friction on the way from a fresh start, which a
    spring must follow (derived). Stiffnesses are K/(N k), numbers.

    The renewal equation of `master.transient` on three grids, each with half the cells
    of the next, extrapolated as of second order from the finer two; the difference from
    the coarser two is the error, twice that of slopes where the law has kinks. What
    survives of the contacts that started together is exact on both sides of every kink;
    the rest has a continuous slope between them.

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
    >>> result = fresh_slip(Ensemble(stiffness_law="uniform"), Drive(velocity=0.1))
    >>> print(f"{result.critical_stiffness.value:.4f}")  # kappa_s = K/(N k)
    0.1742
    """
    if isinstance(drive, Programme):
        drive = Drive(pulled_by(ensemble, drive).velocity)
    require_drive(drive)
    contacts, unit = settled(ensemble, drive.velocity), ensemble.thresholds.scale
    steady = reference(ensemble, drive)
    friction, error = known(steady.friction), steady.friction.stderr or 0.0
    distance = _MEAN_LIVES * known(steady.travel) / unit
    least, level = least_slip(ensemble.thresholds) / unit, friction / unit
    profile = Profile(contacts)
    # cells resolve the middle half of the ends of lives, or slips
    quick, slow = middle_half(profile)
    wanted = _CELLS_PER_WIDTH * distance / max(slow - quick, 1e-300)
    if profile.jumps:
        wanted = 0.25 * _PER_SLIP * distance / least
    has_kinks = bool(ensemble.thresholds.kinks.size) and not profile.jumps
    least_cells = _COARSEST_GRID * (_FINER_AT_KINKS if has_kinks else 1)
    cells = 4 * int(min(max(wanted, least_cells), _FINEST_GRID))
    x = distance / cells * np.arange(cells + 1)
    if profile.jumps:
        forces = [renewal_of(profile, edges, contacts).force for edges in (x[::2], x)]
        other, highest = (float(force.max()) for force in forces)
        # between points it rises by no more than the stiffness times their distance
        beside = float(x[1] * np.abs(profile.at(x[1:2])[1]).max())
        missed = abs(highest - other) + beside
    else:
        grids = [_fresh_transient(profile, x[::n], contacts) for n in (4, 2, 1)]
        rough, fine = grids[0].refined(grids[1]), grids[1].refined(grids[2])
        forces = [rough.force, fine.force]
        highest, highest_X = fine.highest()
        beside = _apart(rough.x, rough.later, fine.later, highest_X)
        missed = max(abs(highest - rough.highest()[0]), beside)
    slip, X = _chord(forces, distance, least, profile.error * highest)
    critical, X_error = slip, 2.0 * float(x[1])
    if not profile.jumps:
        critical, (fall, X, unknown) = Estimate(math.inf, 0.0, 0), fine.steepest()
        other, other_X, _ = rough.steepest()
        X_error = abs(X - other_X) + _EVEN_SLOPE * fine.x[1]
        if math.isfinite(fall):
            beside = _apart(rough.x, rough.later_slope, fine.later_slope, X)
            if has_kinks:
                beside *= _BETWEEN_GRIDS
            off = max(abs(fall - other), beside) + unknown
            off += profile.error * max(highest, fall)
            critical = Estimate(max(fall, 0.0), off, 0)
    place = Estimate(X * unit, X_error * unit, 0) if known(critical) > 0 else NO_VALUE
    ratio = max(highest, level) / level
    off = missed / level + ratio * (profile.error + error / friction)
    return FreshSlip(critical, place, Estimate(ratio, off, 0), slip)


def _chord(
    forces: Sequence[Array], distance: float, least: float, missed: float
) -> tuple[Estimate, float]:
    """The steepest fall of a force over a displacement of `least` or more, and where it
    begins, from two grids, the finer one last; `missed` is the error of the forces
    besides the difference of the grids.

    Chords of up to twice that length suffice: of a longer one a half is as steep. The
    chord of a jump between points may be longer or shorter by one cell.
    """
    (rough, _), (falls, X) = (
        _steepest_falls(force, distance, least) for force in forces
    )
    best, beside = float(falls.max()), abs(float(falls[0] - falls[1]))
    error = abs(best - float(rough.max())) + 2.0 * beside + 2.0 * missed / least
    return Estimate(max(best, 0.0), error, 0), X


def _steepest_falls(force: Array, distance: float, least: float) -> tuple[Array, float]:
    """The steepest fall over each of a range of displacements from `least` on, and
    where the steepest of all begins."""
    h = distance / (force.size - 1)
    first = math.ceil(least / h * (1.0 - 1e-9))
    if first >= force.size:  # the force is level from its end on
        level, highest = float(force[-1]), int(np.argmax(force))
        return np.full(2, (float(force[highest]) - level) / least), h * highest
    last = min(2 * first, force.size - 1)
    shifts = np.append(first + 1, np.linspace(first, last, _CHORDS)).astype(int)
    slopes = [(force[:-n] - force[n:]) / (n * h) for n in np.unique(shifts)]
    falls = np.array([slope.max() for slope in slopes])
    # the first of equal ones, as contacts in step have
    steepest = slopes[int(np.argmax(falls))]
    return falls, h * float(np.argmax(steepest >= (1.0 - 1e-6) * steepest.max()))


class _FreshTransient(NamedTuple):
    """Transient from a fresh start on a uniform grid of edges x: profile of a life, the
    viscous force that a contact loses when it is pinned again, and, arrays (cells +
    1,), the force, and the force of contacts born on the way, with its slope."""

    profile: Profile
    drag: float
    x: Array
    force: Array
    later: Array
    later_slope: Array

    def refined(self, better: "_FreshTransient") -> "_FreshTransient":
        """Values extrapolated as of second order with those of half the cell."""
        pairs = zip(self[3:], better[3:], strict=True)
        columns = [extrapolated(a, b[::2]) for a, b in pairs]
        return _FreshTransient(self.profile, self.drag, self.x, *columns)

    def steepest(self) -> tuple[float, float, float]:
        """Largest -dF/dx, infinite where the density of thresholds is, its place, and
        the error of the panels of a life."""
        later = CubicSpline(self.x, self.later_slope)

        def falls(at: Array) -> Array:
            slope = self.profile.slope(at, 1).value[1]
            if self.drag:
                slope = slope - self.drag * self.profile.slope(at).value[0]
            return np.asarray(-(slope + later(at)))

        fall, X, edge = self._greatest(falls)
        near = self.profile.slope(np.array([edge]), 1)
        if near.width[0] < _SINGULAR:
            return math.inf, X, 0.0
        return fall, X, float(near.missed[1, 0])

    def highest(self) -> tuple[float, float]:
        """Largest force, also at kinks between edges, and its place."""
        later = CubicSpline(self.x, self.later)
        return self._greatest(lambda x: self.profile.at(x, 1)[1] + later(x))[:2]

    def _greatest(
        self, function: Callable[[Array], Array]
    ) -> tuple[float, float, float]:
        """Largest value of a function of displacement, its place, and the nearest edge
        or kink; tried are all edges and kinks, and points next to the best of them."""
        lives = self.profile.x
        kinks = lives[(lives > 1e-6 * self.x[-1]) & (lives < self.x[-1])]
        edges = np.union1d(kinks, self.x[1:])
        i = int(np.argmax(function(edges)))
        low, high = edges[max(i - 1, 0)], edges[min(i + 1, edges.size - 1)]
        near = np.append(edges[i], np.linspace(low, high, _NEAR))
        values = function(near)
        j = int(np.argmax(values))
        return float(values[j]), float(near[j]), float(edges[i])


def _fresh_transient(profile: Profile, x: Array, contacts: Reduced) -> _FreshTransient:
    renewal, drag = renewal_of(profile, x, contacts), 0.0
    if contacts.delay.mean:
        drag = contacts.drag
    births = renewal.births
    first = from_birth(profile, contacts, x, 1)
    carried = first - drag * np.append(1.0, profile.at(x[1:])[0])
    at_edges = 0.5 * (np.append(births[0], births) + np.append(births, births[-1]))
    slope = after(births, np.diff(carried)) + carried[0] * at_edges
    return _FreshTransient(
        profile, drag, x, renewal.force, renewal.force - first, slope
    )


def _apart(x: Array, rough: Array, fine: Array, X: float) -> float:
    """Largest difference around X of two splines, through values at edges `x` and at
    those of a finer grid: where the law has kinks, it depends on their places in cells
    and may be less than the error at X."""
    near = np.clip(X + _COMPARED_CELLS * x[1] * np.linspace(-1.0, 1.0, 33), 0.0, x[-1])
    edges = np.linspace(0.0, x[-1], fine.size)
    apart = CubicSpline(edges, fine)(near) - CubicSpline(x, rough)(near)
    return float(np.abs(apart).max())
