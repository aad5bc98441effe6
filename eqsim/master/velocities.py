"""Steady averages at many velocities at once, for fits and curves.

Velocity enters the master equations of `master.annealed` and `master.quenched` only
through the number of attempts omega/v: barriers, pooled rates and laws of thresholds
are evaluated once for all velocities, on panels fine enough for each of them. Other
contacts (discrete thresholds, thresholds that age by themselves) are solved one
velocity at a time.

Births of annealed contacts that age, of the law P_c of star1, are a mixture of gamma
laws of scales x_*(s), s ~ Exp(1) (`laws.aging.pooled`). What depends on the scale is a
polynomial in its logarithm; the weights of its nodes depend on the mean stretch at
breaking C, the root of C = int J_c exp(-Delta U) dx (derived), which is found on the
same panels.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

from eqsim.errors import InputError, require_number
from eqsim.laws.aging import Aging
from eqsim.laws.barrier.pooled import pooled_rate
from eqsim.laws.threshold import Gamma, ThresholdLaw
from eqsim.master.quenched import beyond, kappa_of
from eqsim.master.solvers import solver
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, bare, drag_of, reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# The relative error that ends refinement.
_CONVERGED = 1e-9
# The least relative error that is quoted.
_ROUNDING = 1e-11
# Panels at most.
_MOST_PANELS = 1500

# Annealed contacts: -ln J_c where first panels end.
_MARKS = np.array([1e-3, 0.3, 2.5, 10.0, 60.0, 500.0])
# The factor by which the first of them rise.
_RISE = 8.0
# Where a panel is split.
_CUTS = np.array([0.0, 0.12, 0.5, 1.0])
# The narrowest panel, relative to its right end.
_NARROWEST = 1e-13

# Mixtures: nodes in ln x_*, at least and per e-fold.
_FEWEST = 10
_PER_FOLD = 13.0
# ln s of the trapezoidal rule.
_LOG_S = np.arange(-28.0, math.log(700.0), 0.1)
# The relative step towards the fixed point that ends the search, and steps at most.
_SETTLED = 1e-12
_MOST_STEPS = 60

# Quenched contacts: first panels in ln(-ln J_c).
_BIRTHS = np.array([-34.7, -14.0, -7.0, -3.5, -1.0, 0.5, 1.75, 2.75, 3.75, 5.0, 6.2])
# Levels of ln((omega/v) H) at which inner panels end: two below the others, which go
# from the first level of the slowest drive to the last one of the fastest.
_BELOW = np.array([-44.0, -25.0])
_FIRST_LEVEL = -14.0
_LAST_LEVEL = 4.0
# The distance of levels.
_APART = 1.25
# The rule of an inner panel, and its relative error.
_NODES, _WEIGHTS = special.roots_legendre(10)
_INNER = 1e-11
# The narrowest panel of births.
_THINNEST = 1e-4


class Lives(NamedTuple):
    """C = E[x_b] and work = E[int_0^{x_b} kappa x dx] at each velocity, and absolute
    errors of both, arrays (velocities,), in units of the threshold law's scale; of
    contacts born stretched `Moments`, and the mean birth."""

    stretch: Array
    work: Array
    stretch_error: Array
    work_error: Array
    birth: float | Array = 0.0


@dataclass(frozen=True, repr=False)
class Curve(Result):
    """Steady averages over velocity, in the user's units, and their absolute errors,
    arrays (velocities,).

    Attributes
    ----------
    velocity : ndarray
    friction, pinned, break_stretch : ndarray
        Observables of `Averages`: force/(N k), a share, and a length.
    friction_error, pinned_error, break_stretch_error : ndarray
        Error estimates of the solver.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "velocity",
        "friction",
        "friction_error",
        "velocity  v",
        "friction  <F>/(N k)",
        log=True,
    )
    velocity: Array
    friction: Array
    pinned: Array
    break_stretch: Array
    friction_error: Array
    pinned_error: Array
    break_stretch_error: Array


def curve(ensemble: Ensemble, velocities: Array) -> Curve:
    """Solve for the steady averages at many velocities, the same as those of
    `reference` within the errors of both. Friction is F/(N k), a length.

    Parameters
    ----------
    ensemble : Ensemble
    velocities : array_like, shape (velocities,)
        > 0 (length/time), in any order, of a slider without stage and blocks; by
        default those of a run file's sweep over drive.velocity, or of its drive.

    Returns
    -------
    Curve

    Raises
    ------
    InputError
        For velocities that are not positive, and for contacts that `reference` refuses.

    Examples
    --------
    >>> from eqsim import Ensemble, Thermal, curve
    >>> found = curve(Ensemble(thermal=Thermal(kT=0.1)), [0.01, 0.1, 1.0])
    >>> found.friction.round(4).tolist()
    [0.977, 0.9284, 0.8912]
    """
    v = np.asarray(velocities, float)
    if v.ndim != 1 or not v.size:
        raise InputError("velocities: must be a list of at least one velocity")
    unit = ensemble.thresholds.scale
    lives = lives_of(bare(ensemble), tuple(v.tolist()))
    delay = np.array([delay_of(ensemble, velocity) for velocity in v.tolist()])
    drag = np.array([drag_of(ensemble, velocity) for velocity in v.tolist()])
    time = lives.stretch + delay
    pinned, elastic = lives.stretch / time, lives.work / time
    off = lives.stretch_error / lives.stretch
    pinned_error = pinned * (1.0 - pinned) * off
    friction = elastic + drag * (delay / time)
    friction_error = (
        lives.work_error + np.abs(lives.work) * pinned * off
    ) / time + drag * pinned_error
    return Curve(
        v, friction * unit, pinned, (lives.birth + lives.stretch) * unit,
        friction_error * unit, pinned_error, lives.stretch_error * unit,
    )  # fmt: skip


def delay_of(ensemble: Ensemble, velocity: float) -> float:
    """v<tau>/x_*. Raises InputError."""
    delay = ensemble.delay.reduced(velocity, ensemble.thresholds.scale).mean
    require_number("velocity * delay / threshold", delay, least=0, most=1e100)
    return delay


# It takes 10 ms or more, for contacts of which a fit, or a reference, changes the delay
# or the viscosity alone; 128 of the longest lists of velocities that are fitted are
# below 1 MB.
@functools.lru_cache(maxsize=128)
def lives_of(ensemble: Ensemble, velocities: Sequence[float]) -> Lives:
    """Moments of lives at each velocity, whatever the delay, which only changes how
    often they begin. Raises InputError."""
    law, aging = ensemble.thresholds, ensemble.aging
    mixed = ensemble.disorder == "annealed" and aging.active and isinstance(law, Gamma)
    if ensemble.newborn.active or (aging.active and not mixed):
        return _one_by_one(ensemble, velocities)
    plain = replace(ensemble, aging=Aging()) if mixed else ensemble
    every = [reduced(plain, v) for v in velocities]
    if law.steps.size or any(
        s.barrier.thermal != every[0].barrier.thermal for s in every
    ):
        return _one_by_one(ensemble, velocities)
    if mixed or every[0].annealed:
        decay = np.array(
            [aging.alpha(law.scale, v) if mixed else 0.0 for v in velocities]
        )
        return _annealed(every, decay, aging.final(law.scale) if mixed else 1.0)
    if not every[0].barrier.thermal:  # the same at any velocity
        once = _one_by_one(ensemble, velocities[:1])
        return Lives(*(np.repeat(part, len(velocities)) for part in once))
    return _quenched(every)


def _one_by_one(ensemble: Ensemble, velocities: Sequence[float]) -> Lives:
    every = [reduced(ensemble, velocity) for velocity in velocities]
    return Lives(*np.array([solver(s).stationary(s)[:5] for s in every]).T)


# ------------------------------------------------------------------------------------------------------------
# annealed


class _Mixture(NamedTuple):
    """Laws at nodes of ln x_*, and the Chebyshev coefficients that values there have,
    shape (nodes, nodes)."""

    laws: list[ThresholdLaw]
    low: float
    high: float
    coefficients: Array

    def weights(self, decay: Array, final: float) -> tuple[Array, Array]:
        """Weights of the laws in star1, given 4 D C/(v x_*f^2), shape (velocities,
        laws), also without the highest two coefficients."""
        if len(self.laws) == 1:
            one = np.ones((decay.size, 1))
            return one, one
        share = np.exp(_LOG_S - np.exp(_LOG_S))
        share /= share.sum()
        square = final**2 - (final**2 - 1.0) * np.exp(-decay[:, None] * np.exp(_LOG_S))
        t = np.clip(
            (2.0 * np.log(square) - self.low - self.high) / (self.high - self.low),
            -1.0,
            1.0,
        )
        before, now, twice = np.ones_like(t), t, 2.0 * t
        means = np.empty((len(self.laws), decay.size))
        for k in range(len(self.laws)):  # of Chebyshev polynomials
            means[k] = before @ share
            before, now = now, twice * now - before
        means = means.T
        fewer = means.copy()
        fewer[:, -2:] = 0.0
        return means @ self.coefficients, fewer @ self.coefficients


def _mixture(contacts: Reduced, decay: Array, final: float) -> _Mixture:
    law = contacts.law
    if (
        not isinstance(law, Gamma)
        or not decay.any()
        or final == 1.0
        or np.isinf(decay).all()
    ):
        at_once = isinstance(law, Gamma) and decay.any()
        only: ThresholdLaw = (
            Gamma(law.n, law.x_star * final)
            if at_once and isinstance(law, Gamma)
            else law
        )
        return _Mixture([only], 0.0, 0.0, np.ones((1, 1)))
    low, high = sorted((0.0, 2.0 * math.log(final)))
    n = _FEWEST + math.ceil(
        _PER_FOLD * 0.5 * (high - low) * math.sqrt(1.0 + law.n / 2.0)
    )
    t = np.cos(math.pi * (np.arange(n) + 0.5) / n)
    scales = np.exp(0.25 * (low + high + (high - low) * t))
    laws: list[ThresholdLaw] = [
        Gamma(law.n, law.x_star * float(scale)) for scale in scales
    ]
    return _Mixture(laws, low, high, np.linalg.inv(chebyshev.chebvander(t, n - 1)))


def _rate_of(
    contacts: Reduced, law: ThresholdLaw, y: Array, *, finer: bool = False
) -> Array:
    """h(y) of contacts whose thresholds follow another `law`, lengths in units of the
    scale of `contacts`. Their stiffness is relative to the rms threshold of `contacts`.
    """
    barrier = contacts.barrier
    if not barrier.thermal:
        return np.zeros(y.size)
    unit = law.scale / contacts.law.scale
    b = barrier.b * unit**2
    if contacts.stiffness == "sqrt":
        b *= law.rms / contacts.law.rms
    return pooled_rate(
        law, contacts.stiffness, type(barrier), b, y / unit, barrier.log_w, finer=finer
    )


class _Integrals(NamedTuple):
    """Integrals at each velocity, shapes (velocities, panels): what panels add to C and
    to work, and their errors."""

    stretch: Array
    work: Array
    stretch_error: Array
    work_error: Array
    alive: Array


def _integrals(half: Array, x: Array, rate: Array, J: Array, rms: float) -> _Integrals:
    """C = int J_c exp(-Delta U) dx and int x exp(-Delta U) E[kappa; xi > x] dx (nt13;
    sqrt law: derived) by panels of half width `half`, (panels,), with nodes x, (panels,
    17); rate (omega/v) h and J_c at them of shape (velocities, panels, 17), and the rms
    threshold, 0 if stiffness is uniform."""
    rule, h = ClenshawCurtis, half[:, None]
    hazard = rate * h
    gained = np.maximum(hazard @ rule.weights, 0.0)
    before = np.cumsum(gained, axis=1) - gained
    inside = np.exp(-np.maximum(hazard @ rule.cumulative, 0.0)) * h
    alive = np.exp(-before)[:, :, None]
    stiff = J
    if rms:
        heavy = J * h
        whole = heavy @ rule.weights
        later = whole[:, ::-1].cumsum(axis=1)[:, ::-1]
        stiff = (
            x * J + np.maximum(later[:, :, None] - heavy @ rule.cumulative, 0.0)
        ) / rms
    integrands = np.stack((inside * J, inside * x * stiff)) * alive
    parts = integrands @ rule.weights
    onward = parts[:, :, ::-1].cumsum(axis=2)[:, :, ::-1]
    errors = (
        np.abs(integrands @ rule.tail).sum(axis=3)
        + np.abs(hazard @ rule.tail).sum(axis=2) * onward
    )
    if rms:  # heavier thresholds of later panels count in all before
        lever = np.cumsum((inside * x * alive) @ rule.weights, axis=1) / rms
        errors[1] += np.abs(heavy @ rule.tail).sum(axis=2) * lever
    return _Integrals(parts[0], parts[1], errors[0], errors[1], alive[:, :, 0])


def _annealed(every: list[Reduced], decay: Array, final: float) -> Lives:
    """Annealed contacts (nt13, star1); `decay` is 4 D x_*/(v x_*f^2) and `final`
    x_*f/x_* if they age."""
    attempts = np.exp(
        [r.barrier.log_w if r.barrier.thermal else -math.inf for r in every]
    )[:, None, None]
    s = every[int(np.argmax(attempts))]  # the slowest, at which most attempts count
    mixture, rms = _mixture(s, decay, final), s.rms if s.stiffness == "sqrt" else 0.0
    ages = len(mixture.laws) > 1
    stretch = np.full(decay.size, s.law.mean / s.law.scale)

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        x = left[:, None] + 0.5 * (right - left)[:, None] * (1.0 + ClenshawCurtis.nodes)
        y = x.ravel()
        rates = [_rate_of(s, law, y).reshape(x.shape) for law in mixture.laws]
        survivals = [law.sf(x * s.law.scale) for law in mixture.laws]
        return np.moveaxis(np.array([rates, survivals]), 2, -1)  # (2, laws, 17, panels)

    def solved(panels: Panels, weights: Array) -> _Integrals:
        half = 0.5 * (panels.right - panels.left)
        x = panels.left[:, None] + half[:, None] * (1.0 + ClenshawCurtis.nodes)
        rate, J = np.moveaxis(
            np.tensordot(weights, panels.values, axes=(1, 1)), (1, 3), (0, 2)
        )
        return _integrals(half, x, attempts * np.maximum(rate, 0.0), J, rms)

    def settle(panels: Panels) -> None:
        """The fixed point of C, by the secant rule at each velocity."""

        def excess(log_C: Array) -> Array:
            C = solved(
                panels, mixture.weights(decay * np.exp(log_C), final)[0]
            ).stretch.sum(axis=1)
            return np.asarray(np.log(C) - log_C)

        old = np.log(stretch)
        off = excess(old)
        new = old + off
        for _ in range(_MOST_STEPS):
            fresh = excess(new)
            if np.max(np.abs(new - old)) < _SETTLED:
                break
            with np.errstate(divide="ignore", invalid="ignore"):
                step = -fresh * (new - old) / (fresh - off)
            step = np.where(np.isfinite(step) & (np.abs(step) < 2.0), step, fresh)
            old, off, new = new, fresh, new + step
        stretch[:] = np.exp(new)

    def judge(panels: Panels) -> tuple[Array, _Integrals]:
        if ages:
            settle(panels)
        of = solved(panels, mixture.weights(decay * stretch, final)[0])
        total = of.stretch.sum(axis=1)[:, None], of.work.sum(axis=1)[:, None]
        rough = (of.stretch_error > _CONVERGED * total[0]) | (
            of.work_error > _CONVERGED * total[1]
        )
        return rough.any(axis=0) & (
            panels.right - panels.left > _NARROWEST * panels.right
        ), of

    marks = [
        law.inverse_survival(_MARKS) / s.law.scale
        for law in (mixture.laws[0], mixture.laws[-1])
    ]
    p, of = refined(
        evaluate,
        judge,
        _edges(s, marks, float(attempts.max())),
        pieces=_CUTS,
        most=_MOST_PANELS,
    )
    # errors of the pooled rate, from a finer rule in the middle of panels (which may
    # not be the worst place), and of the polynomials in ln x_*
    weights, fewer = mixture.weights(decay * stretch, final)
    middle = 0.5 * (p.left + p.right)
    finer = np.array([_rate_of(s, law, middle, finer=True) for law in mixture.laws])
    missed = np.abs(
        weights @ (finer - p.values[0, :, ClenshawCurtis.nodes.size // 2])
    ) * (p.right - p.left)
    onward = [
        np.cumsum(part[:, ::-1], axis=1)[:, ::-1] for part in (of.stretch, of.work)
    ]
    by_rate = [
        (np.minimum(8.0 * attempts[:, 0] * missed, 1.0) * part).sum(axis=1)
        for part in onward
    ]
    total = [part.sum(axis=1) for part in (of.stretch, of.work)]
    errors = [
        of.stretch_error.sum(axis=1) + by_rate[0],
        of.work_error.sum(axis=1) + by_rate[1],
    ]
    sensitivity = np.ones(decay.size)
    if ages:
        other = solved(p, fewer)
        errors = [
            e + np.abs(t - o.sum(axis=1))
            for e, t, o in zip(errors, total, other[:2], strict=True)
        ]
        step = 1e-4
        moved = solved(
            p, mixture.weights(decay * stretch * math.exp(step), final)[0]
        ).stretch.sum(axis=1)
        sensitivity = 1.0 / np.maximum(1.0 - np.log(moved / total[0]) / step, 1e-3)
    rarest = _rarest(s, mixture.laws)[:, None] * of.alive[:, -1]
    totals = [t + r for t, r in zip(total, rarest, strict=True)]
    quoted = [
        sensitivity * (e + _ROUNDING * t + r)
        for e, t, r in zip(errors, total, rarest, strict=True)
    ]
    return Lives(totals[0], totals[1], quoted[0], quoted[1])


def _rarest(contacts: Reduced, laws: list[ThresholdLaw]) -> Array:
    """C and work beyond the last panel, shape (2,): nothing of a gamma law."""
    return np.zeros(2) if isinstance(laws[0], Gamma) else beyond(contacts)


def _edges(contacts: Reduced, marks: list[Array], attempts: float) -> Array:
    """Ends of the first panels: from the shortest lives to where no threshold is left."""
    law = contacts.law
    known = np.concatenate((*marks, law.breakpoints / law.scale))
    known = known[(known > 0) & np.isfinite(known)]
    least, greatest = (edge / law.scale for edge in law.support)
    top = min(greatest, float(known.max()))
    newborn = attempts * float(_rate_of(contacts, law, np.zeros(1))[0])
    root = math.sqrt(contacts.barrier.b) if contacts.barrier.thermal else 0.0
    first = 0.5 / (1.0 / known.min() + newborn + root)
    rising = first * _RISE ** np.arange(math.ceil(math.log(top / first, _RISE)))
    edges = np.unique(np.concatenate(([0.0, least, top], known, rising)))
    return edges[edges <= top]


# ------------------------------------------------------------------------------------------------------------
# quenched


def _quenched(every: list[Reduced]) -> Lives:
    """Quenched contacts that do not age (the joint kinetic equation of
    `master.quenched`)."""
    s = every[0]
    log_w = np.array([r.barrier.log_w for r in every])
    v = log_w.size

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        half = 0.5 * (right - left)[:, None]
        e = np.exp(left[:, None] + half * (1.0 + ClenshawCurtis.nodes))
        xi = np.asarray(s.law.inverse_survival(e.ravel())) / s.law.scale
        terms = _life_moments(s, xi, log_w).reshape(2, v, *e.shape) * (
            half * e * np.exp(-e)
        )
        return np.stack(
            (
                terms @ ClenshawCurtis.weights,
                np.abs(terms @ ClenshawCurtis.tail).sum(axis=-1),
            )
        )

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        parts, errors = panels.values
        total = parts.sum(axis=2)
        rough = (errors > _CONVERGED * total[:, :, None]).any(axis=(0, 1)) & (
            panels.right - panels.left > _THINNEST
        )
        return rough, (total, errors.sum(axis=2))

    with np.errstate(divide="ignore"):  # a breakpoint at an end of the support
        kinks = np.log(-np.log(s.law.sf(s.law.breakpoints)))
    edges = np.union1d(_BIRTHS, kinks[(kinks > _BIRTHS[0]) & (kinks < _BIRTHS[-1])])
    _, (total, error) = refined(evaluate, judge, edges, most=edges.size + 500)
    rarest = beyond(s)[:, None]
    return Lives(*(total + rarest), *(error + _INNER * total + rarest))


def _life_moments(contacts: Reduced, xi: Array, log_w: Array) -> Array:
    """int_0^xi S dx and int_0^xi kappa x S dx at each velocity, shape (2, velocities,
    n), of thresholds xi, (n,)."""
    kappa = kappa_of(contacts, xi)
    a = contacts.barrier.b * kappa
    barrier = contacts.barrier._replace(log_w=0.0)  # type: ignore[attr-defined]
    first, last = _FIRST_LEVEL - log_w.max(), _LAST_LEVEL - log_w.min()
    levels = np.concatenate(
        (
            _BELOW - log_w.max(),
            np.linspace(first, last, math.ceil((last - first) / _APART) + 1),
        )
    )
    at = np.clip(barrier.stretch_at(levels, xi, a) / xi[:, None], 0.0, 1.0)
    phi = np.arcsin(np.sqrt(at))
    edges = np.concatenate(
        (np.zeros((xi.size, 1)), phi, np.full((xi.size, 1), 0.5 * math.pi)), axis=1
    )
    half = 0.5 * np.diff(edges, axis=1)
    some, panel = np.nonzero(half > 0.0)
    h = half[some, panel][:, None]
    phi = edges[some, panel][:, None] + h * (1.0 + _NODES)
    own, end = xi[some, None], a[some, None]
    sine = np.sin(phi)
    x = np.maximum(own * sine**2, 1e-200)
    weight = h * _WEIGHTS * own * (2.0 * sine * np.cos(phi))
    with np.errstate(divide="ignore"):
        hazard = np.exp(
            np.clip(barrier.log_hazard(np.minimum(x, own), own, end), -700.0, 700.0)
        )
    found, alive = np.empty((2, log_w.size, xi.size)), np.empty_like(x)
    starts = np.searchsorted(some, np.arange(xi.size)) * _NODES.size
    for i, attempts in enumerate(np.exp(log_w).tolist()):
        np.multiply(hazard, -attempts, out=alive)
        np.exp(alive, out=alive)
        alive *= weight
        found[0, i] = np.add.reduceat(alive.ravel(), starts)
        alive *= x
        found[1, i] = np.add.reduceat(alive.ravel(), starts) * kappa
    return found
