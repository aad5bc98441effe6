"""Aging of pinned contacts: thresholds that move from the newborn law P_ci (scale x_*i) to the final law P_cf (x_*f).

The Smoluchowski equation of Braun and Peyrard (2011, section IV) with thresholds xi^2/x_*^2 ~ Gamma(n+1) is solved by
the norm of a (2n+2)-dimensional Ornstein-Uhlenbeck process of rate 2D/x_*f^2 and variance x_*f^2/2 per component
(derived). So, for contacts of age t that have not broken,

    transition    xi'^2 = (xi e + s Z)^2 + s^2 chi^2(2n+1),   e = exp(-2Dt/x_*f^2),   s^2 = x_*f^2 (1 - e^2)/2
    one-time law  Gamma(n, x_*(t)),   x_*(t)^2 = x_*f^2 - (x_*f^2 - x_*i^2) exp(-4Dt/x_*f^2)

with Z normal. Rules: `langevin` contacts follow that process; `flow` contacts follow xi(t) = xi(0) x_*(t)/x_*i, which
has the same one-time laws and no fluctuations. The annealed (published) ensemble draws frozen thresholds from the
pooled law P_c = int_0^inf ds exp(-s) Gamma(n, x_*(s C/v)), the solution of star1 (derived), under either rule.

Inside the kernels lengths are in units of x_*i and ages are displacements: `final2` is (x_*f/x_*i)^2, `alpha` is
4 D x_*i/(v x_*f^2), so that x_*(x)^2 = final2 - (final2 - 1) exp(-alpha x), and D_v = alpha final2/4.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import interpolate

from eqsim.compiled import inlined, routine
from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_choice, require_number
from eqsim.laws.octaves import Array, look_up, octave_edges, octave_table
from eqsim.laws.stiffness import kappa
from eqsim.laws.thermal import MECHANICAL, SOFT, STIFF
from eqsim.laws.threshold import FIRST_OCTAVE, LAST_OCTAVE, NO_STEPS, Gamma

AgingRule = Literal["none", "langevin", "flow"]
UNAGED, FLOW, LANGEVIN = range(3)  # how thresholds move, for the kernels
_MOST_N = 1000.0  # of a pooled law: its tables resolve the width of the newborn law


@dataclass(frozen=True)
class Aging:
    """How thresholds age while pinned: `rule`, `rate` D (length^2/time; may be infinite for "flow" and for annealed
    contacts) and `x_star_final`, scale x_*f of the final law (length). Raises InputError."""

    rule: AgingRule = "none"
    rate: float = 0.0
    x_star_final: float = 1.0

    def __post_init__(self) -> None:
        require_choice("rule", self.rule, ("none", "langevin", "flow"))
        if self.rate != math.inf:
            require_number("rate", self.rate, **NOT_NEGATIVE)
        require_number("x_star_final", self.x_star_final, **POSITIVE)

    @property
    def active(self) -> bool:
        """Whether thresholds move at all."""
        return self.rule != "none" and self.rate > 0

    def check(self, law: Any, disorder: str) -> None:
        """Raise InputError unless contacts with these newborn thresholds can age so."""
        if self.rule == "none":
            return
        if not isinstance(law, Gamma):
            raise InputError(f'rule = "{self.rule}": needs thresholds of law "gamma"')
        if self.rate == math.inf and self.rule == "langevin" and disorder == "quenched":
            raise InputError('rate = inf: must be finite with rule = "langevin" and quenched disorder')
        ratio = self.x_star_final / law.x_star
        if not 1e-3 <= ratio <= 1e3:
            raise InputError(f"x_star_final = {self.x_star_final!r}: must be within a factor 1000 of x_star")
        if disorder == "annealed" and self.active and law.n > _MOST_N:
            raise InputError(f"rule: annealed contacts can age for n <= {_MOST_N:g}; n is {law.n:g}")

    def alpha(self, x_star: float, velocity: float) -> float:
        """4 D x_*i/(v x_*f^2), decay of x_*(t)^2 per x_*i of displacement. Raises InputError beyond 1e100."""
        if not self.active or self.rate == math.inf:
            return math.inf if self.active else 0.0
        alpha = 4.0 * self.rate / self.x_star_final * (x_star / self.x_star_final) / velocity
        require_number("aging rate * x_star / (velocity * x_star_final^2)", alpha, least=0, most=1e100)
        return alpha


class Pooled:
    """Thresholds of annealed contacts that age: Gamma(n, x_*(s)) with s ~ Exp(1) mean pinned times, that is

        x_*(s)^2 = x_*f^2 - (x_*f^2 - x_*i^2) exp(-decay s),   decay = 4 D C/(v x_*f^2),   C/v the mean pinned time

    (the resolvent that solves star1, derived); infinite `decay` gives the final law. A threshold law like those of
    `laws.threshold`, except that `scale` and `rms` remain those of `newborn`, where the sqrt law has k_i = k.

    The mixture is summed over ln s by the trapezoidal rule and kept as splines of ln(-ln J_c) and ln P_c over ln xi,
    whose error is below 2e-9 for -ln J_c up to 100 (of P_c 2e-8, of the quantile 5e-8; beyond, J_c is good to 3e-2 at
    exp(-500)) and P(xi < x) down to 1e-16 absolute.
    """

    def __init__(self, newborn: Gamma, x_star_final: float, decay: float) -> None:
        self.newborn, self.final, self.decay = newborn, x_star_final / newborn.x_star, decay
        self.scale, self.rms, self.steps = newborn.scale, newborn.rms, NO_STEPS
        self.support, self.breakpoints = (0.0, math.inf), NO_STEPS
        n, unit = newborn.n, Gamma(newborn.n, 1.0)
        width = 1.0 / math.sqrt(newborn.n + 1.0)
        log_s = np.arange(-39.0, math.log(700.0), min(0.05, 0.2 * width))
        s = np.exp(log_s)
        share = s * np.exp(-s)
        share /= share.sum()  # of births
        age = np.exp(-decay * s) if math.isfinite(decay) else np.zeros(s.size)
        square = self.final**2 - (self.final**2 - 1.0) * age
        use = share > 1e-300
        share, square = share[use], square[use]
        reach = np.array([unit.exceeded_by(2.0**-56), unit.exceeded_by(520.0)]) * [
            min(1, self.final),
            max(1, self.final),
        ]
        log_x = np.arange(math.log(max(reach[0], 1e-18)), math.log(reach[1]), 0.02 * max(width, 1e-3))
        log_share = np.log(share) - (n + 1) * np.log(square)

        def log_density(log_x: Array) -> Array:
            """Of ln xi."""
            found = np.empty(log_x.size)
            for i in range(0, log_x.size, 256):
                y = log_x[i : i + 256, None]
                terms = log_share - np.exp(2 * y) / square
                most = terms.max(axis=1)
                found[i : i + 256] = most + np.log(np.exp(terms - most[:, None]).sum(axis=1))
            return math.log(2.0) + 2 * (n + 1) * log_x + found - math.lgamma(n + 1.0)

        log_p = log_density(log_x)
        there = log_p > -560.0
        log_x, log_p = log_x[there], log_p[there]
        nodes, weights = np.polynomial.legendre.leggauss(7)
        half = 0.5 * np.diff(log_x)[:, None]
        inner = log_x[:-1, None] + half * (1.0 + nodes)
        cells = (half * weights * np.exp(log_density(inner.ravel()).reshape(inner.shape))).sum(axis=1)
        below = np.exp(log_p[0]) / (2 * (n + 1)) + np.append(0.0, np.cumsum(cells))  # a power of xi below the grid
        above = np.exp(log_p[-1]) * (log_x[-1] - log_x[-2]) / (log_p[-2] - log_p[-1]) + np.append(
            np.cumsum(cells[::-1])[::-1], 0.0
        )
        log_e = np.log(np.where(below < 0.5, -np.log1p(-np.minimum(below, 0.5)), -np.log(above)))
        self._log_e = _spline(log_x, log_e)
        self._log_x = _spline(log_e, log_x)
        self._log_pdf = _spline(log_x, log_p - log_x)
        self._range, self._ranks = (log_x[0], log_x[-1]), (log_e[0], log_e[-1])
        self.mean = float(newborn.mean * (share @ np.sqrt(square)))

    def __repr__(self) -> str:
        return f"Pooled({self.newborn}, x_star_final={self.final * self.scale:g}, decay={self.decay:g})"

    @property
    def declared(self) -> tuple[Any, ...]:
        return *self.newborn.declared, "pooled", self.final  # `decay` is an estimate, which no stream may depend on

    def _log(self, x: Any) -> tuple[Array, Array]:
        """ln(x/scale) clipped to the splines, and by how much it was below."""
        with np.errstate(divide="ignore"):
            log_x = np.log(np.maximum(np.asarray(x, float), 0.0) / self.scale)
        inside = np.clip(log_x, *self._range)
        return inside, np.minimum(log_x - inside, 0.0)

    def pdf(self, x: Any) -> Array:
        """P_c(x) (star1)."""
        inside, below = self._log(x)
        power = 2 * self.newborn.n + 1
        lowered = power * below if power else np.zeros_like(below)
        return np.asarray(np.exp(self._log_pdf(inside) + lowered) / self.scale)

    def _e(self, x: Any) -> Array:
        """-ln J_c(x)."""
        inside, below = self._log(x)
        return np.asarray(np.exp(self._log_e(inside) + 2 * (self.newborn.n + 1) * below))

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        return -np.expm1(-self._e(x))

    def sf(self, x: Any) -> Array:
        """J_c(x) = P(xi > x)."""
        return np.exp(-self._e(x))

    def exceeded_by(self, e: Any) -> Array:
        """The threshold that a fraction exp(-e) of the contacts exceeds, e in (0, 512)."""
        log_e = np.log(np.asarray(e, float))
        inside = np.clip(log_e, *self._ranks)
        below = np.minimum(log_e - inside, 0.0) / (2 * (self.newborn.n + 1))  # a power of xi
        return np.asarray(self.scale * np.exp(self._log_x(inside) + below))

    def table(self) -> Array:
        """`exceeded_by` in units of `scale` for `threshold_draw`."""
        e = octave_edges(FIRST_OCTAVE, LAST_OCTAVE)
        xi = self.exceeded_by(e)
        return octave_table(FIRST_OCTAVE, xi / self.scale, np.exp(-e) / self.pdf(xi) / self.scale)


def _spline(x: Array, y: Array) -> Any:
    """Of degree 5, as polynomials, which are evaluated twice as fast."""
    return interpolate.PPoly.from_spline(interpolate.make_interp_spline(x, y, k=5))


# -------------------------------------------------------------------------------------------------- flow, kernels


def flow_work_table(final2: float) -> Array:
    """By how much the mean of x_*(y)/x_*i, weighted with y, over 0 < y < x differs from 1, up to the sign, over
    2 and of alpha x: it rises, from a line through the origin to a constant, over which the table may be continued."""
    first, last = -60, 30
    t = octave_edges(first, last)
    half = 0.5 * np.diff(np.append(0.0, t))[:, None]
    y = t[:, None] - half + half * _NODES

    def excess(t: Array) -> Array:
        """|x_*/x_*i - 1|."""
        change = (1.0 - final2) * np.expm1(-t)
        return np.asarray(np.abs(change) / (1.0 + np.sqrt(1.0 + change)))

    mean = np.cumsum((half * _WEIGHTS * y * excess(y)).sum(axis=1)) / t**2
    return octave_table(first, mean, (excess(t) - 2.0 * mean) / t)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_RANGE, _GROWN, _NEGLIGIBLE, _DEEPEST = 4.0, 1.5, 37.0, 60


@inlined
def growth(final2: float, alpha: float, x: float) -> float:
    """x_*(x)/x_*i."""
    return math.sqrt(1.0 - (final2 - 1.0) * math.expm1(-alpha * x))


@inlined
def flow_work(table: Array, final2: float, alpha: float, x: float) -> float:
    """int_0^x y x_*(y)/x_*i dy, the work of a contact whose stiffness follows its threshold (sqrt law)."""
    excess = look_up(table, alpha * x)
    return x * x * (0.5 + excess if final2 > 1.0 else 0.5 - excess)


@routine
def flow_end(final2: float, alpha: float, xi: float) -> float:
    """Where a threshold born as `xi` meets the stretch, by Newton's method kept inside a shrinking bracket."""
    low, high = xi * min(1.0, math.sqrt(final2)), xi * max(1.0, math.sqrt(final2))
    x = high
    for _ in range(200):
        decay = math.exp(-alpha * x)
        excess = xi * xi * (final2 - (final2 - 1.0) * decay) - x * x
        if excess >= 0.0:
            low = x
        if excess <= 0.0:
            high = x
        slope = xi * xi * (final2 - 1.0) * alpha * decay - 2.0 * x
        step = x - excess / slope if slope < 0.0 else low
        if not low <= step <= high:
            step = 0.5 * (low + high)
        if abs(step - x) <= 2e-16 * x:
            return step
        x = step
    return x


@inlined
def barrier_of(barrier: int, xi: float, x: float, a: float) -> float:
    """Barrier over 2 kT, the exponent of the rates of `laws.thermal`, at threshold xi >= x."""
    gap = max(xi - x, 0.0)
    if barrier == SOFT:
        return a * gap * (xi + x)
    return a * gap * math.sqrt(gap * xi)


@routine
def flow_stretch(
    final2: float,
    alpha: float,
    barrier: int,
    slope: float,
    constant: float,
    b: float,
    log_w: float,
    xi: float,
    clock: float,
) -> tuple[float, float]:
    """Where a contact with threshold `xi` at birth breaks whose clock shows `clock`, and the hazard it has spent.

    The hazard along xi s(x) has no closed form. It is integrated over z, x = end z (2 - z), which makes it smooth where
    a stiff barrier vanishes, by 10 Gauss-Legendre nodes in dyadic cells. A cell is halved unless the barrier and the
    aging vary little in it, or nothing happens in it: the barrier first rises, then falls (derived, for rising
    thresholds; for falling ones it falls), so its least value in a cell is at an end. Error 5e-9 of the hazard.
    """
    end = flow_end(final2, alpha, xi)
    if barrier == MECHANICAL:
        return end, 0.0
    floor = math.log(min(clock, 100.0)) - _NEGLIGIBLE
    spent, level, index, left = 0.0, 0, 0, barrier_of(barrier, xi, 0.0, b * kappa(slope, constant, xi))
    while True:
        width = 0.5**level
        z = index * width
        x0, x1 = end * z * (2.0 - z), end * (z + width) * (2.0 - z - width)
        now = xi * growth(final2, alpha, x1)
        right = barrier_of(barrier, now, x1, b * kappa(slope, constant, now))
        seen = log_w + math.log(2.0 * end * width) - min(left, right) > floor
        last = level >= _DEEPEST or x1 - x0 <= 4e-16 * x1  # rounding is all that still varies, times b perhaps a lot
        fine = last or (
            abs(right - left) <= _RANGE
            and (alpha * (x1 - x0) <= 1.0 or alpha * x0 > 40.0 or final2 == 1.0)
            and now <= _GROWN * xi * growth(final2, alpha, x0)  # x_*(x)^2 vanishes at some x < 0, perhaps nearby
        )
        if seen and fine and not last:
            for quarter in range(1, 4):  # the barrier may rise and fall inside
                part = z + 0.25 * quarter * width
                inner = end * part * (2.0 - part)
                now = xi * growth(final2, alpha, inner)
                middle = barrier_of(barrier, now, inner, b * kappa(slope, constant, now))
                fine = fine and max(abs(middle - left), abs(middle - right)) <= _RANGE
        if seen and not fine:
            level, index = level + 1, 2 * index
            continue
        if seen:
            whole = _hazard_in(final2, alpha, barrier, slope, constant, b, log_w, xi, end, z, width)
            if spent + whole >= clock:
                # Newton for the hazard in part of the cell, in a bracket
                low, high, part = 0.0, width, width * (clock - spent) / whole
                for _ in range(60):
                    found = _hazard_in(final2, alpha, barrier, slope, constant, b, log_w, xi, end, z, part)
                    excess = spent + found - clock
                    if excess > 0.0:
                        high = part
                    else:
                        low = part
                    rate = _rate(final2, alpha, barrier, slope, constant, b, log_w, xi, end, z + part)
                    step = part - excess / rate if rate > 0.0 else 0.5 * (low + high)
                    if not low <= step <= high:
                        step = 0.5 * (low + high)
                    if abs(step - part) <= 1e-13 * part or abs(excess) <= 1e-14 * clock:
                        part = step
                        break
                    part = step
                z += part
                return end * z * (2.0 - z), clock
            spent += whole
        left, index = right, index + 1
        while index % 2 == 0 and level > 0:
            level, index = level - 1, index // 2
        if level == 0 and index == 1:
            return end, spent


@inlined
def _rate(
    final2: float, alpha: float, barrier: int, slope: float, constant: float, b: float, log_w: float,
    xi: float, end: float, z: float,
) -> float:  # fmt: skip
    """Hazard per unit z."""
    x = end * z * (2.0 - z)
    now = max(xi * growth(final2, alpha, x), x)
    rate = math.exp(log_w - barrier_of(barrier, now, x, b * kappa(slope, constant, now))) * 2.0 * end * (1.0 - z)
    return rate * math.sqrt((now - x) / now) if barrier == STIFF else rate


@routine
def _hazard_in(
    final2: float, alpha: float, barrier: int, slope: float, constant: float, b: float, log_w: float,
    xi: float, end: float, z: float, width: float,
) -> float:  # fmt: skip
    total = 0.0
    for i in range(_NODES.size):
        at = z + 0.5 * width * (1.0 + _NODES[i])
        total += _WEIGHTS[i] * _rate(final2, alpha, barrier, slope, constant, b, log_w, xi, end, at)
    return 0.5 * width * total
