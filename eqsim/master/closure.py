"""Transient of aging annealed contacts from a fresh start: the time-dependent closure
of star1 (derived).

Pinned contacts share one law of thresholds P_c(xi; X) and one density of stretches Q(x;
X). Thresholds age by the Smoluchowski operator L (Braun and Peyrard, 2011, L, Bx), D_v
= D/v, and whenever contacts break, newborn ones replace a share of the pool, Gamma_c
being breaks per pinned contact and unit displacement:

    dP_c/dX = D_v L P_c + Gamma_c(X) (P_ci - P_c),    P_c(.; 0) = P_ci
    dQ/dX + dQ/dx = -P_T[P_c] Q,    Q(0; X) = Gamma(X)    (Q5a, Q5aG)
    P_T = P_c/J_c + (omega/v) h[P_c]

with friction = int x Q dx (Q6). Its stationary state is star1; D = 0 gives the
transient of contacts that do not age.

The pair that the paper prints, Q5a with dP_c/dX = D_v L P_c - P_T Q + P_ci Gamma (Q15),
removes a contact that breaks at stretch x as if its threshold were x. It is not
implemented: at T > 0 P_T E_PT != P_c and its stationary state is not star1; at T = 0
contacts of a fresh start outrun every threshold, and the force grows without end.

L maps a gamma law onto gamma laws, so that after aging over a displacement y the
unbroken law P_ci has the scale x_*(y)^2 = x_*f^2 - (x_*f^2 - x_*i^2) exp(-4 D y/(v
x_*f^2)) (derived). P_c is a mixture of ages: exp(-int_0^X Gamma_c) at age X and
Gamma_c(Y) exp(-int_Y^X Gamma_c) at age X - Y. All integrals over it are linear in the
laws, which depend smoothly on ln x_*: a few dozen, at Chebyshev nodes, represent every
age.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import integrate, special
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_integer, require_number
from eqsim.laws.aging import Aging, Flow
from eqsim.laws.aging.base import scale2
from eqsim.laws.barrier import Barrier
from eqsim.laws.barrier.pooled import pooled_rate
from eqsim.laws.threshold import Gamma, ThresholdLaw
from eqsim.master.annealed import mixture_of
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import reduced
from eqsim.numerics.quadrature import extrapolated, gauss_legendre, largest_nearby
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Fewest cells of the coarser grid.
FEWEST_CELLS = 500
# Most cells of the coarser grid.
MOST_CELLS = 2000
# A cell in units of the shortest mean life.
_CELL_PER_LIFE = 0.015
# A cell in units of the displacement in which contacts age.
_CELL_PER_AGING = 0.1
# Multiple of the longest mean life after which a fresh start is forgotten.
_LIVES_TO_REST = 30.0
# Numbers of laws that are tried in turn.
_LAWS = (1, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300)
# Error of interpolation between laws at which their number suffices.
_INTERPOLATION = 1e-11
# Relative error of the pooled rate and its spline.
_RATE_ERROR = 1e-7
# Weight of an age that no longer matters.
_NEGLIGIBLE_WEIGHT = 1e-20
# J below which a sum of weights of both signs is all rounding.
_LEAST_J = 1e-13


@dataclass(frozen=True, repr=False)
class Closure(Result):
    """The transient of annealed contacts whose pool of thresholds ages, from a fresh
    start, arrays of shape (points,). Every contact is pinned at all times.

    Attributes
    ----------
    X : ndarray
        Displacement (length).
    force, force_error : ndarray
        <F>/(N k) and its error estimate (length).
    breaks, breaks_error : ndarray
        Gamma, breaks per contact and unit displacement, and its error estimate
        (1/length).
    mean_threshold, mean_threshold_error : ndarray
        <xi> of the pool of pinned contacts, and its error estimate (length).
    """

    drawn: ClassVar[Drawn] = Drawn(
        "X", "force", "force_error", "displacement  X", "mean friction force  <F>/(N k)"
    )
    X: Array
    force: Array
    breaks: Array
    mean_threshold: Array
    force_error: Array
    breaks_error: Array
    mean_threshold_error: Array


def closure(ensemble: Ensemble, drive: Drive, points: int = 2001) -> Closure:
    """Solve the time-dependent closure of aging (derived): the transient of annealed
    contacts of uniform stiffness without delay, which start fresh, that is unstretched
    and with newborn thresholds. Force is F/(N k), a length.

    Errors are those of the finer of two grids, of at most some 4000 cells, while the
    values are extrapolated from both; after 30 mean lives the values are held.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Constant velocity (length/time) over a distance (length) from a fresh start,
        without stage and blocks.
    points : int
        Number of equidistant displacements from 0 to the drive's distance.

    Returns
    -------
    Closure

    Raises
    ------
    InputError
        For other contacts and drives, and if the laws are too narrow for their change
        of scale.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, closure
    >>> contacts = Ensemble(stiffness_law="uniform", disorder="annealed")
    >>> closure(contacts, Drive(0.1, distance=3.0), points=4).force.round(4).tolist()
    [0.0, 0.7984, 0.7325, 0.7569]
    """
    require_drive(drive)
    law, aging, unit = ensemble.thresholds, ensemble.aging, ensemble.thresholds.scale
    if not isinstance(law, Gamma) or ensemble.disorder != "annealed":
        raise InputError(
            'disorder, thresholds.law: the closure needs "annealed" contacts of '
            'law "gamma"'
        )
    if ensemble.newborn.active:
        raise InputError(
            f'newborn.law = "{ensemble.newborn.law}": the closure is that of contacts '
            "born unstretched"
        )
    plain = ensemble.stiffness_law == "uniform" and ensemble.delay.time == 0
    if not plain or drive.start != "fresh":
        raise InputError(
            'the closure needs contacts.stiffness_law = "uniform", no delay, and '
            'drive.start = "fresh"'
        )
    require_integer("points", points, 2, 10**6)
    reach = drive.over(ensemble) / unit
    require_number("distance / x_star", reach, least=1e-6, most=1e6)
    # the scale of the unbroken law changes as thresholds that flow do
    final2 = (aging.x_star_final / unit) ** 2 if aging.active else 1.0
    flow = Flow(final2, aging.alpha(unit, drive.velocity))
    unaged = reduced(dataclasses.replace(ensemble, aging=Aging()), drive.velocity)
    pool = AgedLaws(law.n, flow, reach, unaged.barrier)

    shortest, longest = pool.lives()
    end = min(reach, _LIVES_TO_REST * longest)
    by_aging = flow.alpha / _CELL_PER_AGING if math.isfinite(flow.alpha) else 0.0
    wanted = end * max(1.0 / (_CELL_PER_LIFE * shortest), by_aging)
    cells = int(min(max(wanted, FEWEST_CELLS), MOST_CELLS))
    coarse, better = (
        march_closure(pool, end / fine, fine) for fine in (cells, 2 * cells)
    )
    # the scheme is of second order; a grid too coarse to show it has the error of its
    # finer member
    missed = largest_nearby(better[:, ::2] - coarse, cells // 20)
    missed *= 1 / 3 if wanted < 2 * cells else 1.0
    best = extrapolated(coarse, better[:, ::2])
    missed += _RATE_ERROR * np.abs(best).max(axis=1, keepdims=True)
    X, edges = np.linspace(0.0, reach, points), np.linspace(0.0, end, cells + 1)
    values = CubicSpline(edges, best, axis=1)(np.minimum(X, end))
    errors = np.array([np.interp(X, edges, error) for error in missed])
    # values held beyond `end` may miss as much as they change in the last tenth before
    errors += np.ptp(best[:, -cells // 10 :], axis=1, keepdims=True) * (end < X)
    units = np.array([[unit], [1.0 / unit], [unit]])
    return Closure(X * unit, *(units * values), *(units * errors))


class _Tables(NamedTuple):
    """J_c, P_c and h of each law of a pool, shape (3, x, laws), and P_c/J_c of its
    widest law, shape (x,)."""

    laws: Array
    least: Array


class AgedLaws:
    """Gamma laws of some scales, which represent thresholds of all ages up to `reach`,
    and the weights of ages in them."""

    def __init__(self, n: float, aging: Flow, reach: float, barrier: Barrier) -> None:
        self.aging, self.barrier = aging, barrier
        low, high = np.sort(self._log_square(np.array([0.0, reach])))
        self.widest = Gamma(n, math.exp(0.5 * high))
        for count in _LAWS:
            self.mixture = mixture_of(Gamma(n), float(low), float(high), count)
            probe = np.linspace(low, high, 3 * count + 1)
            if high == low or (count > 1 and self._missed(probe) < _INTERPOLATION):
                break
        else:
            raise InputError(
                f"x_star_final = {aging.final:g} x_star_initial: too far from it for "
                f"thresholds of n = {n:g}"
            )
        # beyond, nothing survives
        self.top = float(self.widest.inverse_survival(45.0))
        self._rates = [_pooled_rate_of(law, barrier) for law in self.mixture.laws]

    def _log_square(self, age: Array) -> Array:
        """ln x_*^2 after aging over a displacement."""
        alpha = self.aging.alpha
        spent = alpha * age if math.isfinite(alpha) else np.full_like(age, math.inf)
        return np.asarray(np.log(scale2(self.aging.final2, spent)))

    def shares(self, age: Array) -> Array:
        """Weights, shape (..., laws), by which the laws represent the unbroken law at
        any age."""
        return self.mixture.shares(self._log_square(age))

    def _missed(self, probe: Array) -> float:
        """Largest error of J_c and x P_c at scales between the nodes."""
        between = [Gamma(self.widest.n, scale) for scale in np.exp(0.5 * probe)]
        e, every = np.geomspace(1e-3, 10, 7), max(1, len(between) // 12)
        x = np.ravel([law.inverse_survival(e) for law in between[::every]])

        def densities(laws: Sequence[ThresholdLaw]) -> Array:
            return np.array([np.append(law.sf(x), x * law.pdf(x)) for law in laws])

        interpolated = self.mixture.shares(probe) @ densities(self.mixture.laws)
        return float(np.abs(interpolated - densities(between)).max())

    def lives(self) -> tuple[float, float]:
        """Mean lives of the shortest-lived and the longest-lived law, to 1 %."""
        x = np.append(0.0, np.geomspace(1e-12 * self.top, self.top, 2000))
        J, _, h = self.tables(x).laws
        hazard = integrate.cumulative_trapezoid(h, x, axis=0, initial=0.0)
        survival = J * np.exp(-math.exp(self.barrier.log_w) * hazard)
        lives = integrate.trapezoid(survival, x, axis=0)
        return float(lives.min()), float(lives.max())

    def tables(self, x: Array) -> _Tables:
        """The laws at stretches x, ascending from 0."""
        rates = [rate(x) for rate in self._rates]
        above = [law.sf(x) for law in self.mixture.laws]
        density = [law.pdf(x) for law in self.mixture.laws]
        laws: Array = np.array((above, density, rates)).swapaxes(1, 2)
        least = self.widest.pdf(x) / self.widest.sf(x)
        # subnormal numbers would take most of the time
        return _Tables(np.where(laws > 1e-250, laws, 0.0), least)

    def breaking(self, mixture: Array, least: Array) -> Array:
        """P_T at ascending stretches, at each of which a mixture has J_c, P_c and h,
        shape (3, x)."""
        J, P, h = mixture
        hazard = np.where(J > _LEAST_J, P, 0.0) / np.maximum(J, _LEAST_J)
        thermal = math.exp(self.barrier.log_w) * np.maximum(h, 0.0)
        return np.asarray(np.maximum(hazard, least) + thermal)

    def aged(self, h: float, cells: int) -> Array:
        """Shares of contacts whose ages are spread evenly over each cell h, shape
        (cells, laws)."""
        rule, edges = gauss_legendre(3), h * np.arange(cells + 1)
        nodes, weights = rule.between(edges[:-1], edges[1:])
        aged = np.einsum("cq,cql->cl", weights / h, self.shares(nodes))
        # the youngest may age within a fraction of a cell
        pieces = h * 2.0 ** np.append(-np.inf, np.arange(-20.0, 1.0))
        nodes, weights = rule.between(pieces[:-1], pieces[1:])
        aged[0] = np.einsum("pq,pql->l", weights / h, self.shares(nodes))
        return np.asarray(aged)


def _pooled_rate_of(law: ThresholdLaw, barrier: Barrier) -> Callable[[Array], Array]:
    """Pooled rate h of a law (temper11, temper12) as a spline in logarithms."""
    if not barrier.thermal:
        return np.zeros_like
    low, high = 1e-6, float(law.inverse_survival(60.0)) / law.scale
    log_y = np.linspace(math.log(low), math.log(high), 600)
    b = barrier.in_unit(law.scale)
    h = pooled_rate(law, "uniform", barrier, b, np.exp(log_y))
    spline = CubicSpline(log_y, np.log(np.maximum(h, 1e-300)))

    def rate(x: Array) -> Array:
        y = x / law.scale
        return np.where(y < high, np.exp(spline(np.log(np.clip(y, low, high)))), 0.0)

    return rate


def march_closure(pool: AgedLaws, h: float, cells: int) -> Array:
    """Force, breaks per unit displacement and mean threshold, shape (3, cells + 1), on
    a uniform grid of stretches, displacements and ages, of second order in the cell h.

    E[j] is the survival to x_j of a contact born at X_i - x_j, so that E[i] is that of
    the fresh contacts. Births are spread evenly over each cell. Within a cell E is
    taken as exponential, which is exact for lives of any length if only young contacts
    break. Births of the last cell follow from the conserved number of contacts.
    """
    x = h * np.arange(min(cells, math.ceil(pool.top / h)) + 1)
    table, edges = pool.tables(x), h * np.arange(cells + 1)
    fresh, aged = pool.shares(edges), pool.aged(h, cells)
    scales = np.array([law.mean for law in pool.mixture.laws])
    young = table.laws @ aged[0]

    force, births, threshold = np.zeros(cells + 1), np.zeros(cells), np.zeros(cells + 1)
    threshold[0] = scales @ fresh[0]
    unbroken, weight, first = 1.0, np.zeros(cells), 0
    log_E = np.zeros(1)
    P_T = pool.breaking(table.laws[:, :1] @ fresh[0], table.least[:1])
    broken = 0.0  # Gamma_c h of the last cell
    for i in range(1, cells + 1):
        top = min(i, x.size - 1)
        # the pool after aging, before the breaks of this cell
        share = weight[first : i - 1] @ aged[i - 1 - first : 0 : -1]
        share += unbroken * fresh[i]
        old, new = table.laws[:, : top + 1] @ share, young[:, : top + 1]
        least, earlier = table.least[: top + 1], births[i - top : i - 1][::-1]
        # the pool at the end of the cell depends on the breaks in it: iterate
        for _ in range(2 if i > 1 else 4):
            stay = math.exp(-broken)
            now = pool.breaking(stay * old + (1.0 - stay) * new, least)
            log_next = np.append(0.0, log_E[:top] - 0.5 * h * (P_T[:top] + now[1:]))
            # int E dt and int t E dt over each cell, 0 < t < 1
            E, z = np.exp(log_next[:-1]), log_next[:-1] - log_next[1:]
            mean, small = special.exprel(-z), np.abs(z) < 1e-3
            safe = np.where(small, 1.0, z)
            rest = (mean - np.exp(-safe)) / safe
            moment = np.where(small, 0.5 - z / 3 + z**2 / 8, rest)
            mean, moment = E * mean, E * moment
            atom = math.exp(log_next[i]) if i < x.size else 0.0
            births[i - 1] = (1.0 - atom - h * (earlier @ mean[1:])) / (h * mean[0])
            broken = h * births[i - 1]
        cohorts = births[i - top : i][::-1]
        force[i] = x[top] * atom + h * (cohorts @ (x[:top] * mean + h * moment))
        stay = math.exp(-broken)
        log_E, P_T = log_next, pool.breaking(stay * old + (1.0 - stay) * new, least)
        threshold[i] = scales @ (stay * share + (1.0 - stay) * aged[0])
        unbroken *= stay
        weight[first : i - 1] *= stay
        weight[i - 1] = 1.0 - stay
        if weight[first] < _NEGLIGIBLE_WEIGHT:
            first += 1
    count = CubicSpline(edges, h * np.append(0.0, np.cumsum(births)))
    return np.array([force, count(edges, 1), threshold])
