"""Lives of contacts that heat breaks, or that age, in steady sliding, and how they
answer to a small perturbation of it (derived).

While X = t + eps e^(pt), contacts of age a are stretched by a + eps e^(pt) (1 -
e^(-pa)). Of those of threshold xi at birth a share S(a) = exp(-H(a)) is pinned up to
the age A at which the stretch is the threshold, with the hazard h(x, a) and H its
integral over age. To first order, dropping eps e^(pt),

    dx = 1 - e^(-pa),     dS = -S dH - S delta(a - A) dx/(1 - xi g'(A)),
    dH = int_0^a (dh/dx)(u) (e^(pu) - 1) e^(-pa) du = h dx - Q,
    Q  = int_0^a [p h + (dh/da) dx](u) e^(-p(a-u)) du,

g being the growth of thresholds. Births at a rate beta (1 + B eps e^(pt)) keep the
number of contacts, detached ones included, which have waited for a delay with D =
E[exp(-p delay)]:

    B = -int dS / (int e^(-pa) S + (1/D - 1)/p)
    Z(p) = beta [int K S dx + int K a dS + B (int e^(-pa) K a S + drag (1/D - 1)/p)]

with K = k_i/k and means over thresholds. Lengths are in units of the law's scale, V =
1. Ages are Gauss-Legendre nodes in panels, between ages that are equally spaced, and
between those at which H reaches given levels: heat may break contacts in a narrow layer
below their thresholds.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.delay import DelayLaw
from eqsim.master.programme import law_tables
from eqsim.master.quenched import ends, kappa_of
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

# ln H beyond which no contact is left: exp(-40) = 4e-18.
_ALL_BROKEN = 3.7
# ln H below which heat has broken none: exp(-30) = 1e-13.
_NONE_BROKEN = -30.0
# Nodes of a panel.
_ORDER = 8
# Cells of the table of a pooled hazard, per panel.
_CELLS = 100
# Relative step of ages for the change of the hazard with age.
_AGE_STEP = 1e-4
# |p| times the width of a panel, beyond which polynomials do not follow exp(p a).
_STEEP = 8.0
# Terms of an integral by parts.
_PARTS = 3
# Rounds in which thresholds of the age at which contacts break are found.
_ROUNDS = 4


def _from_values(of_powers: Callable[[Array, Array], Array], at: Array) -> Array:
    """Matrix that gives numbers of a polynomial `at` points, from its values at the
    nodes of a panel from -1 to 1, those of x^n being `of_powers` (points, n)."""
    powers = np.vander(gauss_legendre(_ORDER).nodes, increasing=True)
    wanted = of_powers(at[:, None], np.arange(_ORDER))
    return np.asarray(np.linalg.solve(powers.T, wanted.T))


_NODES = gauss_legendre(_ORDER).nodes
# From values at the nodes of a panel to integrals up to these, to slopes there, and to
# values at its ends.
_INTEGRALS = _from_values(
    lambda x, n: (x ** (n + 1) - (-1.0) ** (n + 1)) / (n + 1), _NODES
)
_SLOPES = _from_values(lambda x, n: n * x ** np.maximum(n - 1, 0), _NODES)
_ENDS = _from_values(lambda x, n: x**n, np.array([-1.0, 1.0]))


class Lives(NamedTuple):
    """Lives for thresholds (n,), in panels and nodes of ages, arrays (n, panels,
    nodes): age, weight times the threshold's share, hazard, its change with age, the
    pinned share and that times the stiffness; width and beginning of panels, (n,
    panels); and age, share times pinned share over 1 - xi g', and stiffness where a
    contact reaches its threshold, (n,)."""

    age: Array
    weight: Array
    hazard: Array
    ageing: Array
    pinned: Array
    stiff: Array
    width: Array
    begin: Array
    last: Array
    ending: Array
    last_stiff: Array

    @property
    def travel(self) -> float:
        """Mean age at breaking."""
        return float((self.weight * self.pinned).sum())

    @property
    def scatter(self) -> float:
        """Variance of the age at breaking."""
        square = 2.0 * float((self.weight * self.pinned * self.age).sum())
        return max(square - self.travel**2, 0.0)

    @property
    def stiffness(self) -> float:
        """Mean stiffness of pinned contacts."""
        return float((self.weight * self.stiff).sum()) / self.travel

    def fraction(
        self, p: complex, delay: DelayLaw, drag: float
    ) -> tuple[complex, complex]:
        """Z/beta without the viscous force of the mean share of detached contacts, as a
        fraction of two functions without poles."""
        since = self.age - self.begin[..., None]
        faded = np.exp(-p * since)
        decay = faded * np.exp(-p * self.begin)[..., None]
        dx = 1.0 - decay
        rate = p * self.hazard + self.ageing * dx
        dH = self.hazard * dx - self._answer(p, rate, faded)
        weight, aged = self.weight, self.age * self.stiff
        end = -self.ending * -np.expm1(-p * self.last)
        lost = end.sum() - (weight * self.pinned * dH).sum()
        force = (weight * (self.stiff * dx - aged * dH)).sum()
        force += (end * self.last * self.last_stiff).sum()
        away = complex(delay.forgotten(np.array([p]))[0])
        waiting = away / p
        present = (1.0 - away) * (weight * self.pinned * decay).sum() + waiting
        later = (1.0 - away) * (weight * aged * decay).sum() + drag * waiting
        return complex(force * present - lost * later), complex(present)

    def _answer(self, p: complex, rate: Array, faded: Array) -> Array:
        """Q of an integrand `rate`, with e^(-p age) since the panel began, both of
        shape (n, panels, nodes). In steep panels it follows by integration by parts."""
        steep, half = np.abs(p) * self.width > _STEEP, 0.5 * self.width
        fade = np.exp(-p * self.width)
        grown = rate / np.where(steep[..., None], 1.0, faded)
        inner = grown @ _INTEGRALS * half[..., None] * faded
        carried = grown @ gauss_legendre(_ORDER).weights * half * fade
        if steep.any():
            late, term = np.zeros_like(rate[steep]), rate[steep] / p
            for _ in range(_PARTS):
                late += term
                term = -term @ _SLOPES / (half[steep, None] * p)
            first, last = (late @ _ENDS).T
            inner[steep] = late - first[:, None] * faded[steep]
            carried[steep] = last - first * fade[steep]
        before = np.zeros(self.width.shape, complex)
        for k in range(1, self.width.shape[1]):
            before[:, k] = fade[:, k - 1] * before[:, k - 1] + carried[:, k - 1]
        return before[..., None] * faded + inner


def lives_of(contacts: Reduced, xi: Array, share: Array, panels: int) -> Lives:
    """Follow contacts of thresholds `xi`, arrays (n,), at constant velocity, with so
    many panels of equally spaced ages, and twice as many between levels of H."""
    barrier, aging = contacts.barrier, contacts.aging
    stiffens = bool(stiffness_varies(aging, contacts.springs))
    table = law_tables(contacts, _CELLS * panels) if contacts.annealed else None
    last = np.asarray(ends(contacts, xi))

    def stiffness_at(age: Array, xi: Array) -> Array:
        return kappa_of(contacts, xi * aging.growth_at(age) if stiffens else xi)

    def hazard_at(x: Array, age: Array) -> Array:
        if table is not None:
            return np.exp(np.interp(x, table.y, table.log_rate))
        if not barrier.thermal:
            return np.zeros_like(x)
        born = xi.reshape(-1, *[1] * (x.ndim - 1))
        grown = born * aging.growth_at(age)
        a = barrier.b * stiffness_at(age, born)
        log_rate = barrier.log_rate(np.minimum(x, grown), grown, a)
        return np.asarray(np.exp(np.minimum(log_rate + barrier.log_w, 300.0)))

    levels = np.linspace(_NONE_BROKEN, _ALL_BROKEN, 2 * panels + 1)
    inner = np.zeros((xi.size, 0))
    if table is not None:
        y, rate = table.y, np.exp(table.log_rate)
        H = np.append(0.0, np.cumsum(0.5 * np.diff(y) * (rate[1:] + rate[:-1])))
        with np.errstate(divide="ignore"):
            reached = np.interp(levels, np.log(H), y, right=y[-1])
        inner = np.broadcast_to(reached, (xi.size, levels.size))
    elif barrier.thermal:
        grown = last
        for _ in range(_ROUNDS):
            a = barrier.b * stiffness_at(last, xi)
            broken = np.minimum(barrier.stretch_at(levels[-1:], grown, a)[:, 0], last)
            grown = xi * aging.growth_at(broken)
        inner = barrier.ends_of_panels(levels, grown, a)
    gone = last if inner.shape[1] == 0 else np.minimum(last, inner[:, -1])
    even = gone[:, None] * np.linspace(0.0, 1.0, panels + 1)
    edges = np.sort(np.append(even, np.clip(inner, 0.0, gone[:, None]), axis=1), axis=1)
    age, weight = gauss_legendre(_ORDER).between(edges[:, :-1], edges[:, 1:])
    hazard = hazard_at(age, age)
    step = _AGE_STEP * age
    later, sooner = hazard_at(age, age + step), hazard_at(age, age - step)
    ageing = np.zeros_like(age)
    np.divide(later - sooner, 2.0 * step, out=ageing, where=step > 0.0)
    width = np.diff(edges, axis=1)
    whole = (hazard * weight).sum(axis=2)
    before = np.cumsum(whole, axis=1) - whole
    within = hazard @ _INTEGRALS
    H = before[..., None] + within * (0.5 * width[..., None])
    pinned = np.exp(-np.minimum(H, 700.0))
    stiff = stiffness_at(age, xi[:, None, None])
    slower = last * _AGE_STEP
    slope = aging.growth_at(last + slower) - aging.growth_at(last - slower)
    reached = np.exp(-np.minimum(whole.sum(axis=1), 700.0))
    ending = share * reached / (1.0 - xi * slope / (2.0 * slower))
    return Lives(
        age=age,
        weight=weight * share[:, None, None],
        hazard=hazard,
        ageing=ageing,
        pinned=pinned,
        stiff=stiff * pinned,
        width=width,
        begin=edges[:, :-1],
        last=last,
        ending=ending,
        last_stiff=stiffness_at(last, xi),
    )
