"""Quenched contacts: the stationary joint kinetic equation by quadrature (derived), at
many velocities at once.

Without aging a contact of threshold xi survives to stretch x < xi with S(x|xi) =
exp(-(omega/v) H(x)), H the closed form of `laws.barrier`. The joint density of pinned
contacts is P_c(xi) S(x|xi)/C on 0 <= x < xi, with

    C = E[int_0^xi S dx],      friction * C = E[(k_i/k) int_0^xi x S dx]      (no delay).

Inside, x = xi sin^2(phi) makes the integrand smooth at xi, and Gauss-Legendre panels
end where the integrated hazard passes levels, from the first one of the slowest drive
to the last one of the fastest, so that the drop of S is resolved however sharp.
Outside, panels in ln(-ln J_c(xi)) are halved until the highest Chebyshev coefficients
of the integrands are negligible.

Here and in the other solvers lengths are in units of `law.scale`, and kappa is k_i/k.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import special
from scipy.optimize import elementwise

from eqsim.laws.aging import PooledThresholds
from eqsim.laws.barrier import Barrier
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.threshold import Gamma, ThresholdLaw, means_above, rank_above
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# Levels of ln((omega/v) H) at which inner panels end: some that crowd upwards, where
# hardly a contact is broken yet at the slowest drive, and from the first of the others
# there to the last at the fastest drive as many as are so far apart.
_RARELY_BROKEN = np.array([-40.0, -16.0, -8.0, -4.0])
_FIRST_LEVEL = -2.0
_LAST_LEVEL = 4.0
_APART = 1.0
# The rule of an inner panel, and its relative error.
_INNER = gauss_legendre(14)
_INNER_ERROR = 1e-11
# The share of their time up to a threshold that bonds live, below which stronger ones,
# whose rate is no smaller, do not count.
_SPENT = 1e-10

# The first panels of births in ln(-ln J_c(xi)), from 2^-50 to 500.
BIRTHS = np.array([-34.7, -20.0, -12.0, -7.0, -4.0, -2.0, -0.5, 0.75, 1.75, 2.75,
                    3.75, 5.0, 6.2])  # fmt: skip
# The relative error that ends refinement over births, at one velocity and at many.
CONVERGED = 2e-12
_CONVERGED_CURVE = 1e-9
# The narrowest panel of births.
_NARROWEST_BIRTHS = 1e-4
# How many more panels there may be: laws known with noise never converge.
_MORE_PANELS = 500

# -ln J_c of the rarest contacts that usually count, of the strongest one that is asked
# for, and how far panels beyond the former are apart.
_COMMON = 45.0
_RAREST_THRESHOLD = 510.0
_RARER = 5.0
# Ranks e above that of x where panels of thresholds end: narrow ones next to x, then on
# the scale of the law.
_SHARES_ABOVE = np.array([1e-6, 1e-4, 2e-3, 0.01, 0.05, 0.15, 0.4, 0.8, 1.5, 2.5, 4.0,
                         6.0, 9.0, 13.0, 18.0, 25.0, 35.0])  # fmt: skip
# Ranks of weak contacts where they end, too: the law may rise steeply.
_WEAKEST = 10.0 ** np.arange(-14.0, -6.0)
# Distances from an infinite density over that of the median, or of x.
_TOWARDS = 0.25 ** np.arange(1.0, 16.0)


class LifeMoments(NamedTuple):
    """C = E[x_b], work = E[int_0^{x_b} kappa x dx], and absolute errors of both, arrays
    (velocities,).

    Of contacts born stretched: the travel E[l] = E[x_b - y], work = E[int_y^{x_b} kappa
    x dx], the mean birth E[y]. Square = E[int_y^{x_b} kappa^2 x^2 dx], and its error:
    not a number where nobody asked for it, or where it is unknown.
    """

    stretch: Array
    work: Array
    stretch_error: Array
    work_error: Array
    birth: Array = np.zeros(1)
    square: Array = np.full(1, math.nan)
    square_error: Array = np.zeros(1)


# Moments of births, shape (moments, n), and their errors, which may be a number, from
# -ln J_c over that of the first births, and thresholds, both (n,).
Moments = Callable[[Array, Array], tuple[Array, Array | float]]


def kappa_of(contacts: Reduced, xi: Array) -> Array:
    """k_i/k of contacts of thresholds xi, any shape."""
    return relative_stiffness(contacts.stiffness, xi, contacts.rms)


def ends(contacts: Reduced, xi: Array) -> Array:
    """Stretches at which contacts born with thresholds `xi`, any shape, break
    mechanically: the roots of xi s(x) = x if they age."""
    if contacts.aging.closed:
        return xi
    found = elementwise.find_root(
        lambda x, xi: np.log(xi * contacts.aging.growth_at(x) / x),
        contacts.aging.bracket(xi),
        args=(xi,),
    )
    return np.asarray(found.x)


def different_steps(contacts: Reduced) -> tuple[Array, Array, Array]:
    """The different thresholds of a discrete law, their shares and kappa, each of shape
    (n,)."""
    xi, counts = np.unique(contacts.law.steps / contacts.law.scale, return_counts=True)
    return xi, counts / counts.sum(), kappa_of(contacts, xi)


def life_moments(
    barrier: Barrier, xi: Array, kappa: Array, log_w: Array, powers: int = 2
) -> Array:
    """int_0^xi x^p S dx, p < `powers`, of thresholds xi (n,) at each ln(omega x_*/v),
    shape (powers, velocities, n); the barrier's own does not count."""
    found = np.empty((powers, log_w.size, xi.size))
    if not barrier.thermal:
        for power in range(powers):
            found[power] = xi ** (power + 1) / (power + 1)
        return found
    a, bare = barrier.b * kappa, barrier._replace(log_w=0.0)  # type: ignore[attr-defined]
    first, last = _FIRST_LEVEL - log_w.max(), _LAST_LEVEL - log_w.min()
    even = np.linspace(first, last, math.ceil((last - first) / _APART) + 1)
    levels = np.concatenate((_RARELY_BROKEN - log_w.max(), even))
    at = bare.ends_of_panels(levels, xi, a) / xi[:, None]
    at = np.sort(np.clip(at, 0.0, 1.0), axis=1)
    start = np.zeros((xi.size, 1))
    edges = np.concatenate((start, np.arcsin(np.sqrt(at)), start + 0.5 * math.pi), 1)
    # empty panels lie between levels that a contact does not meet
    contact, panel = np.nonzero(np.diff(edges, axis=1) > 0.0)
    phi, weight = _INNER.between(edges[contact, panel], edges[contact, panel + 1])
    xi, a, sine = xi[contact, None], a[contact, None], np.sin(phi)
    x = np.maximum(xi * sine**2, 1e-200)
    weight *= xi * (2.0 * sine * np.cos(phi))
    with np.errstate(divide="ignore"):
        log_hazard = bare.log_hazard(np.minimum(x, xi), xi, a)
    hazard, alive = np.exp(np.clip(log_hazard, -700.0, 700.0)), np.empty_like(x)
    starts = np.searchsorted(contact, np.arange(found.shape[2])) * phi.shape[1]
    for i, attempts in enumerate(np.exp(log_w).tolist()):
        np.multiply(hazard, -attempts, out=alive)
        np.exp(alive, out=alive)
        alive *= weight
        for power in range(powers):
            found[power, i] = np.add.reduceat(alive.ravel(), starts)
            alive *= x
    return found


def quenched_moments(every: Sequence[Reduced], *, square: bool = False) -> LifeMoments:
    """Moments of the lives of quenched contacts that do not age, at each of `every`,
    which differ in velocity only; with the mean square of force if asked."""
    contacts, powers = every[0], 3 if square else 2
    law, barrier = contacts.law, contacts.barrier
    log_w = np.array([r.barrier.log_w if r.barrier.thermal else 0.0 for r in every])

    def moments(xi: Array) -> Array:
        kappa = kappa_of(contacts, xi)
        lives = life_moments(barrier, xi, kappa, log_w, powers)
        lives *= kappa ** np.arange(powers)[:, None, None]
        return lives.reshape(-1, xi.size)

    once = log_w.size == 1 or not barrier.thermal
    converged = CONVERGED if once else _CONVERGED_CURVE
    means, _ = over_births(
        contacts, lambda _, xi: (moments(xi), 0.0), converged, _NARROWEST_BIRTHS
    )
    total, error = (part.reshape(powers, -1) for part in means)
    error += _INNER_ERROR * total
    rest = beyond(contacts)[:, None]
    total[:2] += rest
    error[:2] += rest
    if square and not law.steps.size:
        last = np.asarray(law.inverse_survival(np.exp(BIRTHS[-1:]))) / law.scale

        def unbroken(xi: Array) -> Array:
            square = 2.0 * np.log(kappa_of(contacts, xi)) + 3.0 * np.log(xi)
            return np.asarray(square - math.log(3.0))[None]

        far, missed = means_above(law, float(last[0]), unbroken)
        # heat shortens these lives, at most by as much as here
        alive = moments(last)[-log_w.size :, 0] / np.exp(unbroken(last)[0])
        here = ~(barrier.lasting & (alive < _SPENT))
        total[2, here] += far
        error[2, here] += missed + (1.0 - alive[here]) * far
    birth = np.zeros((1, log_w.size))
    rows = np.concatenate((total[:2], error[:2], birth, total[2:], error[2:]))
    return LifeMoments(*rows)


def over_births(
    contacts: Reduced,
    moments: Moments,
    converged: float,
    narrowest: float,
    *,
    origin: float = 0.0,
    edges: Array | None = None,
    scales: Callable[[Array], Array] = np.asarray,
) -> tuple[tuple[Array, Array], Panels]:
    """Means of `moments` over births, and their errors, each of shape (moments,), and
    panels of births. Of a smooth law births count whose -ln J_c is `origin` or more, but
    for the weakest 2^-50 and the strongest exp(-500). Panels begin with `edges` in
    ln(-ln J_c - origin), and are split until they are `narrowest`, or the relative
    errors of the means, or of the `scales` of these, are `converged`."""
    law = contacts.law
    if law.steps.size:
        xi, share, _ = different_steps(contacts)
        found = np.broadcast_arrays(*moments(xi, xi))
        return (found[0] @ share, found[1] @ share), Panels(*np.empty((4, 0)))

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        terms = terms_of_births(law, moments, left, right, origin)
        unresolved = np.abs(terms[:1] @ ClenshawCurtis.tail).sum(axis=3)
        return np.concatenate((terms @ ClenshawCurtis.weights, unresolved))

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        parts, errors, unresolved = panels.values
        mean = parts.sum(axis=1)
        rough = (unresolved > converged * scales(mean)[:, None]).any(axis=0)
        rough &= panels.right - panels.left > narrowest
        return rough, (mean, (errors + unresolved).sum(axis=1))

    if edges is None:
        with np.errstate(divide="ignore"):  # a breakpoint at an end of the support
            kinks = np.log(-np.log(law.sf(law.kinks)))
        inner = kinks[(kinks > BIRTHS[0]) & (kinks < BIRTHS[-1])]
        edges = np.union1d(BIRTHS, inner)
    panels, means = refined(evaluate, judge, edges, most=edges.size + _MORE_PANELS)
    return means, panels


def terms_of_births(
    law: ThresholdLaw, moments: Moments, left: Array, right: Array, origin: float = 0.0
) -> Array:
    """Integrands of means over births, and their errors, at the nodes of panels, shape
    (2, moments, panels, nodes)."""
    half = 0.5 * (right - left)[:, None]
    e = np.exp(left[:, None] + half * (1.0 + ClenshawCurtis.nodes))
    xi = np.asarray(law.inverse_survival(origin + e.ravel())) / law.scale
    values = np.array(np.broadcast_arrays(*moments(e.ravel(), xi)))
    return values.reshape(2, -1, *e.shape) * (half * e * np.exp(-e))


def beyond(contacts: Reduced) -> Array:
    """C and work of the contacts beyond the last panel, shape (2,), not negligible
    where x^3 P_c is barely integrable: at T = 0, and as of a power law (derived)."""
    e = np.array([0.95, 1.0]) * math.exp(BIRTHS[-1])
    xi = np.asarray(contacts.law.inverse_survival(e)) / contacts.law.scale
    end = ends(contacts, xi)
    kappa = kappa_of(contacts, end if contacts.aging.stiffens else xi)
    early, late = (np.array([end, 0.5 * kappa * end**2]) * np.exp(-e)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = late * np.diff(e) / np.log(early / late)
    return np.where(late > 0, np.where(early > late, rest, np.inf), 0.0)


def integrals_beyond(contacts: Reduced, x: float, alive: float) -> tuple[Array, Array]:
    """int_x^inf y^p E[kappa^j; x_b > y] dy of contacts born unstretched, and bounds of
    the errors, p and j from 0 to 2, each of shape (3, 3). Of a power law this is not
    negligible, however large x.

    No heat breaks contacts that far: what reaches x, the fraction `alive`, survives to
    its threshold. Bonds whose rate stays as large with their strength are gone. Pooled
    attempts are over before (derived: their number beyond x is less than (omega/v) E[xi
    - x; xi > x]); those on a contact's barrier may still shorten lives, at most by the
    fraction by which they have done so at x.
    """
    if contacts.law.steps.size or isinstance(contacts.law, (Gamma, PooledThresholds)):
        # rarer than exp(-45), and no power law
        return np.zeros((3, 3)), np.zeros((3, 3))
    least = x / float(contacts.aging.growth_at(np.array([x]))[0])
    left = math.exp(-rank_above(contacts.law, least))

    def log_values(xi: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            log_end = np.log(np.maximum(ends(contacts, xi) / x, 1.0))
            log_kappa = np.log(kappa_of(contacts, xi))
            powers = [
                np.log(np.expm1((p + 1) * log_end) / (p + 1)) + (p + 1) * math.log(x)
                for p in range(3)
            ]
        return np.array([power + j * log_kappa for power in powers for j in range(3)])

    share = min(max(alive / left, 0.0), 1.0)
    if contacts.barrier.lasting and share < _SPENT:
        return np.zeros((3, 3)), np.zeros((3, 3))
    means = means_above(contacts.law, least, log_values)
    found, error = (share * part.reshape(3, 3) for part in means)
    if contacts.barrier.thermal and not contacts.annealed:
        error = error + (1.0 - share) * found
    return found, error


def rarest_that_counts(barrier: Barrier) -> float:
    """-ln J_c up to which contacts count: where lives are as short as exp(-log_w), ones
    as rare as its square do."""
    return _COMMON + min(max(2.0 * barrier.log_w, 0.0), 455.0)


# It takes 1 ms, or 2 s where SciPy finds quantiles numerically, and a transient asks
# for it 30 times.
@functools.lru_cache(maxsize=8)
def _ranks_of(law: ThresholdLaw) -> tuple[Array, Array]:
    """-ln J_c and the thresholds that have it: only panels depend on this table."""
    e = np.exp(np.linspace(-36.0, math.log(_RAREST_THRESHOLD), 700))
    xi, which = np.unique(
        np.asarray(law.inverse_survival(e)) / law.scale, return_index=True
    )
    return e[which], xi


def greatest_of(law: ThresholdLaw) -> float:
    """A threshold that 1e-221 of the contacts of a smooth law exceed."""
    return float(_ranks_of(law)[1][-1])


def thresholds_above(
    law: ThresholdLaw, x: Array, layer: Array, rarest: float = _COMMON
) -> Array:
    """Edges of panels, shape (n, any), from x (n,) to thresholds of a smooth law that
    exp(-rarest) of the stronger contacts exceed: on the scale of the law itself, next
    to infinite densities, where it has kinks or rises from next to nothing, and at the
    edges of a boundary `layer`, shape (n, any)."""
    low, high = (edge / law.scale for edge in law.support)
    left, (e, xi) = np.maximum(x, low)[:, None], _ranks_of(law)
    shares = np.append(_SHARES_ABOVE, np.arange(40.0, rarest + 8.0, _RARER))
    top = np.minimum(np.interp(left, xi, e) + shares, _RAREST_THRESHOLD)
    weakest = np.asarray(law.inverse_survival(_WEAKEST)) / law.scale
    fixed = [law.kinks / law.scale, weakest]
    with np.errstate(divide="ignore"):
        if np.isinf(law.pdf(law.support[0])):
            fixed.append(low + (np.interp(math.log(2.0), e, xi) - low) * _TOWARDS)
        near = math.isfinite(high) and np.isinf(law.pdf(law.support[1]))
    inside = [np.broadcast_to(at, (left.size, at.size)) for at in fixed]
    inside += [high - (high - left) * _TOWARDS] if near else []
    edges = np.concatenate((left, np.interp(top, e, xi), layer, *inside), axis=1)
    return np.sort(np.clip(edges, left, min(high, xi[-1])), axis=1)


def stiffness_of_survivors(contacts: Reduced, x: Array) -> tuple[Array, Array]:
    """E[kappa | xi > x] and E[kappa^2 | xi > x] at x > 0, (n,); of a discrete law those
    of the strongest beyond all."""
    if contacts.stiffness == "uniform":
        return np.ones_like(x), np.ones_like(x)
    law = contacts.law
    if law.steps.size:
        xi, share, kappa = different_steps(contacts)
        ahead = np.minimum(np.searchsorted(xi, x, side="right"), xi.size - 1)
        parts = share * kappa ** np.arange(3)[:, None]
        total, mean, square = parts[:, ::-1].cumsum(axis=1)[:, ::-1][:, ahead]
        return mean / total, square / total
    if isinstance(law, Gamma):
        shape, u = law.n + 1.0, x**2
        J = special.gammaincc(shape, u)
        mean, square = (
            special.gammaincc(shape + p, u) / J * special.poch(shape, p)
            for p in (0.5, 1.0)
        )
        return mean / contacts.rms, square / contacts.rms**2
    edges = thresholds_above(law, x, np.empty((x.size, 0)))
    xi, weights = gauss_legendre(12).between(edges[:, :-1], edges[:, 1:])
    kappa = kappa_of(contacts, xi)
    terms = weights * law.pdf(xi * law.scale)
    terms[~np.isfinite(terms)] = 0.0  # the density may be infinite at an end
    total, *sums = ((terms * kappa**power).sum(axis=(1, 2)) for power in range(3))
    last = kappa_of(contacts, x)  # where hardly a threshold is above
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, square = (
            np.where(total > 0, part / total, last**p) for p, part in enumerate(sums, 1)
        )
    return mean, square
