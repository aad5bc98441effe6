"""Quenched contacts: the stationary joint kinetic equation by quadrature (derived).

Without aging a contact of threshold xi survives to stretch x < xi with S(x|xi) =
exp(-(omega/v) H(x)), H the closed form of `laws.barrier`. The joint density of pinned
contacts is P_c(xi) S(x|xi)/C on 0 <= x < xi, with

    C = E[int_0^xi S dx],        friction * C = E[(k_i/k) int_0^xi x S dx]        (no delay).

Inside, x = xi sin^2(phi) makes the integrand smooth at xi, and Gauss-Legendre panels
end where the integrated hazard passes fixed levels, so that the drop of S is resolved
however sharp. Outside, panels in ln(-ln J_c(xi)) are halved until the highest Chebyshev
coefficients of the integrands are negligible.

Here and in the other solvers lengths are in units of `law.scale`, and kappa is k_i/k.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import special
from scipy.optimize import elementwise

from eqsim.laws.aging import PooledThresholds
from eqsim.laws.barrier import Barrier
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.threshold import (
    Gamma,
    ThresholdLaw,
    means_above,
    panels_above,
    rank_above,
)
from eqsim.model.reduced import Reduced
from eqsim.numerics.panels import ClenshawCurtis, Panels, refined
from eqsim.numerics.tables import Array

METHOD = "joint kinetic equation"

_LEVELS = np.array(
    [-48.0, -24.0, -12.0, -6.0, -3.0, -1.5, -0.5, 0.25, 1.0, 1.75, 2.5, 3.25, 4.0]
)  # of ln Lambda
_NODES, _WEIGHTS = special.roots_legendre(14)
_FEW_NODES, _FEW_WEIGHTS = special.roots_legendre(8)

# The first panels of births in ln(-ln J_c(xi)), from 2^-50 to 500.
_BIRTHS = np.array(
    [-34.7, -20.0, -12.0, -7.0, -4.0, -2.0, -0.5, 0.75, 1.75, 2.75, 3.75, 5.0, 6.2]
)
# The relative error that ends refinement over births.
_CONVERGED = 2e-12
# The narrowest panel of births.
_NARROWEST = 1e-4
# How many more panels there may be: laws known with noise never converge.
_MORE_PANELS = 500
# The relative error of `life_moments`.
_PANELS = 1e-11

# -ln J_c up to which lives hardly differ enough to count, and the distance of panels
# beyond.
_COMMON = 45.0
_RARER = 5.0
# ln(xi/x - 1) from where levels are sought, and in how many bisections.
_SHALLOWEST = -44.0
_BISECTIONS = 13


class Moments(NamedTuple):
    """C = E[x_b], work = E[int_0^{x_b} kappa x dx], and absolute errors of both.

    Of contacts born stretched: the travel E[l] = E[x_b - y], work = E[int_y^{x_b} kappa
    x dx], the mean birth E[y], and square = E[int_y^{x_b} kappa^2 x^2 dx] and its
    error; None where nobody asked for it.
    """

    stretch: float
    work: float
    stretch_error: float
    work_error: float
    birth: float = 0.0
    square: float | None = None
    square_error: float = 0.0


def kappa_of(contacts: Reduced, xi: Array) -> Array:
    """k_i/k of contacts of thresholds xi, any shape."""
    return relative_stiffness(contacts.stiffness, xi, contacts.rms)


def ends(contacts: Reduced, xi: Array) -> Array:
    """Where contacts born with thresholds `xi`, any shape, break mechanically: the root
    of xi s(x) = x if they age."""
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


def survival(barrier: Barrier, x: Array, xi: Array, kappa: Array) -> Array:
    """S(x|xi) for x > 0, arrays that broadcast."""
    if not barrier.thermal:
        return np.where(x < xi, 1.0, 0.0)
    log_lambda = (
        barrier.log_hazard(np.minimum(x, xi), xi, barrier.b * kappa) + barrier.log_w
    )
    return np.where(x < xi, np.exp(-np.exp(np.minimum(log_lambda, 7.0))), 0.0)


def life_moments(barrier: Barrier, xi: Array, kappa: Array) -> Array:
    """int_0^xi x^p S dx, p from 0 to 2, shape (3, n)."""
    if not barrier.thermal:
        return np.array([xi, xi**2 / 2.0, xi**3 / 3.0])
    levels = barrier.stretch_at(_LEVELS, xi, barrier.b * kappa) / xi[:, None]
    phi = np.arcsin(np.sqrt(np.clip(levels, 0.0, 1.0)))
    edges = np.concatenate(
        (np.zeros((xi.size, 1)), phi, np.full((xi.size, 1), 0.5 * math.pi)), axis=1
    )
    half = 0.5 * np.diff(edges, axis=1)
    contact, panel = np.nonzero(
        half
    )  # the others are empty: levels that this contact does not meet
    h, own = half[contact, panel][:, None], xi[contact, None]
    phi = edges[contact, panel][:, None] + h * (1.0 + _NODES)
    x = np.maximum(own * np.sin(phi) ** 2, 1e-200)
    found = (
        h
        * _WEIGHTS
        * own
        * np.sin(2 * phi)
        * survival(barrier, x, own, kappa[contact, None])
    )
    terms = np.zeros((3, *half.shape))
    for power in range(3):
        terms[power, contact, panel] = found.sum(axis=1)
        found *= x
    return np.asarray(terms.sum(axis=2))


def stationary(contacts: Reduced) -> Moments:
    """Moments of the lives of quenched contacts that do not age."""

    def moments(xi: Array) -> Array:
        kappa = kappa_of(contacts, xi)
        zeroth, first, _ = life_moments(contacts.barrier, xi, kappa)
        return np.array([zeroth, kappa * first])

    if contacts.law.steps.size:
        xi, share, _ = different_steps(contacts)
        mean = moments(xi) @ share
        return Moments(mean[0], mean[1], *(1e-11 * mean))
    total, error = over_births(
        contacts.law,
        lambda xi: (moments(xi), np.zeros((2, xi.size))),
        _CONVERGED,
        _NARROWEST,
    )
    rarest = beyond(contacts)
    return Moments(
        *(total + rarest).tolist(), *(error + _PANELS * total + rarest).tolist()
    )


def squares(contacts: Reduced) -> tuple[float, float]:
    """E[int_0^{x_b} kappa^2 x^2 dx] of quenched contacts that do not age, and a bound
    of its error."""

    def moments(xi: Array) -> Array:
        kappa = kappa_of(contacts, xi)
        return (kappa**2 * life_moments(contacts.barrier, xi, kappa)[2])[None]

    if contacts.law.steps.size:
        xi, share, _ = different_steps(contacts)
        mean = float((moments(xi) @ share)[0])
        return mean, 1e-11 * mean
    total, error = over_births(
        contacts.law,
        lambda xi: (moments(xi), np.zeros((1, xi.size))),
        _CONVERGED,
        _NARROWEST,
    )
    last = (
        np.asarray(contacts.law.inverse_survival(np.array([math.exp(_BIRTHS[-1])])))
        / contacts.law.scale
    )
    rest, missed = means_above(
        contacts.law,
        float(last[0]),
        lambda xi: np.log(kappa_of(contacts, xi) ** 2 * xi**3 / 3.0)[None],
    )
    shortened = 1.0 - float(
        moments(last)[0, 0] / (kappa_of(contacts, last) ** 2 * last**3 / 3.0)[0]
    )  # by heat, at most
    total, error = total + rest, error + missed + shortened * rest
    return float(total[0]), float(error[0] + _PANELS * total[0])


def over_births(
    law: ThresholdLaw,
    moments: Callable[[Array], tuple[Array, Array]],
    converged: float,
    narrowest: float,
) -> tuple[Array, Array]:
    """Means over the births of a smooth law, but for the weakest 2^-50 and the
    strongest exp(-500).

    Parameters
    ----------
    moments : callable
        From thresholds, shape (n,), to moments and their errors, each of shape
        (moments, n).
    converged, narrowest : float
        The relative error and the width, in ln(-ln J_c), at which panels are not split
        any more.

    Returns
    -------
    mean, error : ndarray, shape (moments,)
    """

    def evaluate(left: Array, right: Array, _: Array) -> Array:
        half = 0.5 * (right - left)[:, None]
        e = np.exp(left[:, None] + half * (1.0 + ClenshawCurtis.nodes))
        found = np.array(
            moments(np.asarray(law.inverse_survival(e.ravel())) / law.scale)
        ).reshape(2, -1, *e.shape)
        terms = found * (half * e * np.exp(-e))
        return np.concatenate(
            (
                terms @ ClenshawCurtis.weights,
                np.abs(terms[:1] @ ClenshawCurtis.tail).sum(axis=3),
            )
        )

    def judge(panels: Panels) -> tuple[Array, tuple[Array, Array]]:
        parts, errors, unresolved = panels.values
        mean = parts.sum(axis=1)
        rough = (unresolved > converged * mean[:, None]).any(axis=0) & (
            panels.right - panels.left > narrowest
        )
        return rough, (mean, (errors + unresolved).sum(axis=1))

    with np.errstate(divide="ignore"):  # a breakpoint at an end of the support
        kinks = np.log(-np.log(law.sf(law.kinks)))
    edges = np.union1d(_BIRTHS, kinks[(kinks > _BIRTHS[0]) & (kinks < _BIRTHS[-1])])
    _, found = refined(evaluate, judge, edges, most=edges.size + _MORE_PANELS)
    return found


def beyond(contacts: Reduced) -> Array:
    """C and work of the contacts beyond the last panel, shape (2,), not negligible
    where x^3 P_c is barely integrable: at T = 0, and as of a power law (derived)."""
    e = np.array([0.95, 1.0]) * math.exp(_BIRTHS[-1])
    xi = np.asarray(contacts.law.inverse_survival(e)) / contacts.law.scale
    end = ends(contacts, xi)
    early, late = (
        np.array(
            [
                end,
                0.5
                * kappa_of(contacts, end if contacts.aging.stiffens else xi)
                * end**2,
            ]
        )
        * np.exp(-e)
    ).T
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = late * np.diff(e) / np.log(early / late)
    return np.where(late > 0, np.where(early > late, rest, np.inf), 0.0)


def integrals_beyond(contacts: Reduced, x: float, alive: float) -> tuple[Array, Array]:
    """int_x^inf y^p E[kappa^j; x_b > y] dy of contacts born unstretched, and bounds of
    the errors, p and j from 0 to 2, each of shape (3, 3). Of a power law this is not
    negligible, however large x.

    No heat breaks contacts that far: what reaches x, the fraction `alive`, survives to
    its threshold. Pooled attempts are over before (derived: their number beyond x is
    less than (omega/v) E[xi - x; xi > x]); those on a contact's barrier may still
    shorten lives, at most by the fraction by which they have done so at x.
    """
    if contacts.law.steps.size or isinstance(contacts.law, (Gamma, PooledThresholds)):
        return np.zeros((3, 3)), np.zeros(
            (3, 3)
        )  # rarer than exp(-45), and no power law
    least = x / float(contacts.aging.growth_at(np.array([x]))[0])
    left = math.exp(-rank_above(contacts.law, least))

    def log_values(xi: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            log_end, log_kappa = (
                np.log(np.maximum(ends(contacts, xi) / x, 1.0)),
                np.log(kappa_of(contacts, xi)),
            )
            powers = [
                np.log(np.expm1((p + 1) * log_end) / (p + 1)) + (p + 1) * math.log(x)
                for p in range(3)
            ]
        return np.array([power + j * log_kappa for power in powers for j in range(3)])

    share = min(max(alive / left, 0.0), 1.0)
    found, error = (
        share * part.reshape(3, 3)
        for part in means_above(contacts.law, least, log_values)
    )
    return (
        found,
        error
        if contacts.annealed or not contacts.barrier.thermal
        else error + (1.0 - share) * found,
    )


def survivors_at(contacts: Reduced, x: Array) -> Array:
    """S(x) = P(x_b > x), E[kappa; x_b > x] and E[kappa^2; x_b > x] at x > 0 of shape
    (n,), shape (3, n).

    Over xi > x by panels that end at fixed shares of the stronger contacts and where
    the hazard passes fixed levels.
    """
    law = contacts.law
    if law.steps.size:
        total = np.zeros((3, x.size))
        for xi, share, kappa in zip(*different_steps(contacts), strict=True):
            total += (
                share
                * kappa ** np.arange(3)[:, None]
                * survival(contacts.barrier, x, xi, kappa)
            )
        return total
    layer = weakest(law) + np.zeros((x.size, 1))
    if contacts.barrier.thermal:
        layer = np.concatenate((layer, _thresholds_at(contacts, x)), axis=1)
    edges = births_above(law, x, layer, rarest_that_counts(contacts.barrier))
    half = 0.5 * np.diff(edges, axis=1)[:, :, None]
    xi = edges[:, :-1, None] + half * (1.0 + _FEW_NODES)
    kappa = kappa_of(contacts, xi)
    with np.errstate(invalid="ignore"):
        terms = half * _FEW_WEIGHTS * law.pdf(xi * law.scale) * law.scale
        terms *= survival(contacts.barrier, x[:, None, None], xi, kappa)
    terms = np.where((half > 0) & np.isfinite(terms), terms, 0.0)
    found = np.array([(terms * kappa**power).sum(axis=(1, 2)) for power in range(3)])
    if (
        not contacts.barrier.thermal
    ):  # the law knows its share of stronger contacts better than the panels
        found *= np.where(
            found[0] > 0.0, law.sf(x * law.scale) / np.maximum(found[0], 1e-300), 0.0
        )
    return found


def rarest_that_counts(barrier: Barrier) -> float:
    """-ln J_c up to which contacts count: where lives are as short as exp(-log_w), ones
    as rare as its square do."""
    return _COMMON + min(max(2.0 * barrier.log_w, 0.0), 455.0)


def births_above(
    law: ThresholdLaw, x: Array, layer: Array | None, rarest: float
) -> Array:
    """`panels_above` up to the threshold that a fraction exp(-rarest) of the contacts
    exceeds."""
    edges = panels_above(law, x, layer)
    if rarest <= _COMMON:
        return edges
    beyond = law.inverse_survival(
        np.arange(_COMMON, rarest, _RARER)
    ) / law.scale + np.zeros((x.size, 1))
    if layer is not None:
        beyond = np.concatenate((layer, beyond), axis=1)
    return np.concatenate(
        (edges, np.sort(np.maximum(beyond, edges[:, -1:]), axis=1)), axis=1
    )


def weakest(law: ThresholdLaw) -> Array:
    """Thresholds that 1e-14 to 1e-7 of the contacts stay below: edges of panels where
    the law rises steeply."""
    return np.asarray(law.inverse_survival(10.0 ** np.arange(-14.0, -6.0))) / law.scale


def _thresholds_at(contacts: Reduced, x: Array) -> Array:
    """Roughly the threshold whose ln((omega/v) H(x)) passes each level, shape (n,
    levels): only panels depend on it.

    By bisection, as stronger contacts are safer; where attempts hardly need energy that
    may fail, but nothing is steep.
    """
    x = x[:, None]
    low = np.full((x.size, _LEVELS.size), _SHALLOWEST)
    high = np.log1p(
        float(contacts.law.inverse_survival(500.0)) / contacts.law.scale / x
    ) + np.zeros_like(low)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        xi = x * (1.0 + np.exp(middle))
        weak = (
            contacts.barrier.log_hazard(
                x, xi, contacts.barrier.b * kappa_of(contacts, xi)
            )
            + contacts.barrier.log_w
            > _LEVELS
        )
        low, high = np.where(weak, middle, low), np.where(weak, high, middle)
    return np.asarray(x * (1.0 + np.exp(high)))


def panels_between_steps(contacts: Reduced) -> Array:
    """Ascending stretches between which what happens to contacts of a discrete law is
    smooth: they crowd towards every stretch where contacts break from below and, down
    to a small part of it, from above, and towards 0."""
    xi, _, kappa = different_steps(contacts)
    xi = ends(contacts, xi)
    rate = 2.0 * (contacts.barrier.b if contacts.barrier.thermal else 0.0) * kappa * xi
    edges = [xi[0] * 2.0 ** -np.arange(1.0, 340.0)]
    for low, high, scale in zip(np.append(0.0, xi[:-1]), xi, rate, strict=True):
        depth = 6 + math.ceil(math.log2(max(scale * (high - low), 1.0)))
        edges.append(
            high - (high - low) * np.append(2.0 ** -(np.arange(2 * depth) / 2), 0.0)
        )
        if low and high - low > low / 64:
            edges.append(
                low
                + (high - low)
                * 2.0 ** -np.arange(1.0, math.log2(64 * (high / low - 1.0)) + 1.0)
            )
    return np.unique(np.concatenate(edges))
