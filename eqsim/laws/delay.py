"""Delay between the breaking of a contact and its re-attachment (section V of Braun and
Peyrard, 2011).

`DELAYS` lists the laws. Each is a NamedTuple of the mean, as a displacement v<tau>,
and of a parameter if it has one, with NumPy's formulas as methods.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_number,
    require_number_or_infinity,
)
from eqsim.laws.law import Law
from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.quadrature import gamma_quantile
from eqsim.numerics.tables import (
    Array,
    hermite,
    look_up,
    octave_edges,
    octave_table,
    search,
)
from eqsim.numerics.vector_math import log

# e = -ln(1 - P) of tables of quantiles: uniforms of 63 bits reach e = 44
_OCTAVES = (-64, 6)
# ln e of the knots of a law: neighbours are a sixtieth of its width apart at the median
_LOG_RANKS = np.linspace(-40.0, 4.2, 2400)
# nodes of the trapezoidal rule for a normal variable
_NODES = np.linspace(-10.0, 10.0, 201)
# sigma from which on the saddle does not serve, and nodes of the rule that does
_BROAD = 1.0
_BROAD_NODES = np.linspace(-10.0, 16.0, 521)
# |p| times the mean delay below which 1 - E[exp(-p delay)] would lose digits
_NEAR_0 = 1e-3
# delay (time) from which on it has no end
_ENDLESS = 1e100
# exponent of a factor from which on a delay of any unit has no end
_MOST_EXPONENT = 700.0


class _Mean(NamedTuple):
    mean: float


class Fixed(_Mean, Law):
    """Every delay is `mean`."""

    __slots__ = ()

    def cdf(self, t: Any) -> Array:
        """P(delay <= t)."""
        return np.where(np.asarray(t) >= self.mean, 1.0, 0.0)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state
        (derived, renewal theory)."""
        if not self.mean:
            return self.cdf(t)
        return np.clip(np.asarray(t) / self.mean, 0.0, 1.0)

    def rest(self, x: Array) -> Array:
        """E[(delay - x)+], x ascending, shape (n,); of delays without end that of one
        beyond all x, whose differences are the same."""
        mean = self.mean if self.mean < math.inf else 2.0 * x[-1]
        return np.maximum(mean - x, 0.0)

    def waiting(self, h: float, cells: int) -> Array:
        """Chance that a contact that breaks anywhere in a cell of width `h` is still
        detached at the end of that cell, and of the next ones, shape (cells,)."""
        return np.clip(self.mean / h - np.arange(cells), 0.0, 1.0)

    @property
    def variance(self) -> float:
        """Var(delay)."""
        return 0.0

    def coherence(self, k: Array) -> Array:
        """|E[exp(i k delay)]|."""
        return np.ones_like(k)

    def forgotten(self, p: Array) -> Array:
        """1 - E[exp(-p delay)], p complex."""
        return np.asarray(-np.expm1(-p * self.mean))

    def sample(self) -> Array:
        """Equally likely delays that stand for the law."""
        return np.full(1, self.mean)

    def for_kernels(self) -> "Waits":
        return Waits(self.mean, 0.0)


class Exponential(_Mean, Law):
    """Delays are exponential with mean `mean`; methods are those of `Fixed`."""

    __slots__ = ()

    def cdf(self, t: Any) -> Array:
        if not self.mean:
            return np.where(np.asarray(t) >= 0, 1.0, 0.0)
        return -np.expm1(-np.maximum(t, 0.0) / self.mean)

    def residual_cdf(self, t: Any) -> Array:
        return self.cdf(t)

    def rest(self, x: Array) -> Array:
        return self.mean * np.exp(-x / self.mean) if self.mean else np.zeros_like(x)

    def waiting(self, h: float, cells: int) -> Array:
        if not self.mean:
            return np.zeros(cells)
        first = -math.expm1(-h / self.mean) * self.mean / h
        return np.asarray(first * np.exp(-h / self.mean * np.arange(cells)))

    @property
    def variance(self) -> float:
        return self.mean**2

    def coherence(self, k: Array) -> Array:
        return np.asarray(1.0 / np.hypot(1.0, k * self.mean))

    def forgotten(self, p: Array) -> Array:
        return np.asarray(p * self.mean / (1.0 + p * self.mean))

    def sample(self) -> Array:
        return self.mean * -np.log((np.arange(16) + 0.5) / 16)

    def for_kernels(self) -> "Waits":
        return Waits(self.mean, self.mean)


class _Shaped(NamedTuple):
    mean: float
    shape: float


class _Drawn:
    """Base of laws that kernels draw from tables. Each gives functions of u = delay/mean,
    arrays: P(u' > u), `above`; its integral from 0 to u, `begun`, which is P(rest <= u)
    in the stationary state; and the u that a share exp(-e) exceeds, `exceeded`. All
    else is that of `Fixed`."""

    __slots__ = ()
    mean: float
    shape: float
    above: Callable[[Array], Array]
    begun: Callable[[Array], Array]
    exceeded: Callable[[Array], Array]
    forgotten: Callable[[Array], Array]

    def cdf(self, t: Any) -> Array:
        return np.asarray(1.0 - self.above(np.maximum(t, 0.0) / self.mean))

    def residual_cdf(self, t: Any) -> Array:
        return self.begun(np.clip(np.asarray(t) / self.mean, 0.0, _ENDLESS))

    def rest(self, x: Array) -> Array:
        return self.mean * (1.0 - self.begun(x / self.mean))

    def waiting(self, h: float, cells: int) -> Array:
        edges = h / self.mean * np.arange(cells + 1)
        return np.asarray(np.diff(self.begun(edges)) * (self.mean / h))

    def coherence(self, k: Array) -> Array:
        return np.abs(1.0 - self.forgotten(1j * k))

    def sample(self) -> Array:
        return self.mean * self.exceeded(-np.log((np.arange(16) + 0.5) / 16))

    def for_kernels(self) -> "DrawnWaits":
        return DrawnWaits(self.mean, self.mean, *_tables(type(self), self.shape))  # type: ignore[arg-type]


class GammaDelay(_Drawn, _Shaped, Law):
    """Delays are sums of `shape` exponential steps, if that is a whole number: their
    density is that of the gamma law."""

    __slots__ = ()

    @property
    def variance(self) -> float:
        return self.mean**2 / self.shape

    def above(self, u: Array) -> Array:
        return np.asarray(special.gammaincc(self.shape, self.shape * u))

    def begun(self, u: Array) -> Array:
        k = self.shape
        return np.asarray(special.gammainc(k + 1.0, k * u) + u * self.above(u))

    def exceeded(self, e: Array) -> Array:
        return gamma_quantile(self.shape, e) / self.shape

    def forgotten(self, p: Array) -> Array:
        k = self.shape
        return np.asarray(-np.expm1(-k * np.log1p(p * (self.mean / k))))


class LognormalDelay(_Drawn, _Shaped, Law):
    """The logarithm of a delay is normal, with standard deviation sigma, here
    `shape`."""

    __slots__ = ()

    @property
    def variance(self) -> float:
        return self.mean**2 * math.expm1(self.shape**2)

    def _z(self, u: Array) -> Array:
        """The normal variable of a delay."""
        with np.errstate(divide="ignore"):  # u = 0
            return np.asarray(np.log(u) / self.shape + 0.5 * self.shape)

    def above(self, u: Array) -> Array:
        return np.asarray(special.ndtr(-self._z(u)))

    def begun(self, u: Array) -> Array:
        z = self._z(u)
        return np.asarray(special.ndtr(z - self.shape) + u * special.ndtr(-z))

    def exceeded(self, e: Array) -> Array:
        low = special.ndtri(-np.expm1(-e))
        z = np.where(e < 0.7, low, -special.ndtri_exp(-e))
        return np.asarray(np.exp(self.shape * (z - 0.5 * self.shape)))

    def forgotten(self, p: Array) -> Array:
        """Transform by the trapezoidal rule, along a line of complex ln(delay) through the saddle
        point, which is Lambert's function W (Asmussen, Jensen and Rojas-Nandayapa,
        Methodol. Comput. Appl. Probab. 18, 441, 2016); near p = 0 along the real line;
        and of broad laws along one on which p times the delay is real."""
        sigma, u = self.shape, np.asarray(p * self.mean, complex)
        if sigma >= _BROAD:
            # nothing oscillates there
            off, total = np.angle(u) / sigma, np.zeros_like(u)
            for s in _BROAD_NODES:
                share = np.exp(-0.5 * (s - 1j * off) ** 2) / math.sqrt(2.0 * math.pi)
                total -= share * np.expm1(
                    -np.abs(u) * np.exp(sigma * (s - 0.5 * sigma))
                )
            return total * (_BROAD_NODES[1] - _BROAD_NODES[0])
        weights = np.exp(-0.5 * _NODES**2)
        weights /= weights.sum()
        w = special.lambertw(u * math.exp(-0.5 * sigma**2) * sigma**2)
        near, far = np.zeros_like(u), np.zeros_like(u)
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            for s, weight in zip(_NODES, weights, strict=True):
                delay = math.exp(sigma * (s - 0.5 * sigma))
                near -= weight * np.expm1(-u * delay)
                steep = w / sigma**2 * (math.exp(sigma * s) - sigma * s)
                far += weight * np.exp(-steep - 0.5 * (w / sigma) ** 2)
        return np.where(np.abs(u) < _NEAR_0, near, 1.0 - far)


DelayLaw = Fixed | Exponential | GammaDelay | LognormalDelay
DELAYS: dict[str, type[DelayLaw]] = {
    "fixed": Fixed,
    "exponential": Exponential,
    "gamma": GammaDelay,
    "lognormal": LognormalDelay,
}
# The parameter of a law beside its mean, with its limits.
PARAMETERS = {"gamma": ("shape", 0.1, 1000.0), "lognormal": ("sigma", 0.03, 2.0)}


@dataclass(frozen=True)
class Delay:
    """Time for which a contact stays detached after it has broken.

    Raises InputError for a value out of range, an unknown law, and a parameter that the
    law lacks or does not have. With an infinite time a contact never forms again, as in
    a fibre bundle.

    The mean at a temperature and a velocity is

        tau = time exp(activation/kT) (v/reference_velocity)^velocity_exponent

    (Arrhenius; the power is a definition). Laws of delays change transients, but no
    steady average.

    Parameters
    ----------
    time : float
        Mean delay tau (time), or math.inf.
    law : str
        One of `DELAYS`.
    shape : float, optional
        Of the gamma law, from 0.1 to 1000: the mean over the standard deviation,
        squared.
    sigma : float, optional
        Of the lognormal law, from 0.03 to 2: standard deviation of ln(delay).
    activation : float
        Barrier to the formation of a contact (energy). At kT = 0 none forms.
    velocity_exponent : float
        p of tau ~ v^p, from -10 to 10. Other than 0 only at one speed, without holds.
    reference_velocity : float
        Velocity (length/time) at which tau is that without an exponent.

    Examples
    --------
    >>> print(f"{Delay(2.0, 'exponential').cdf(2.0):.3f}")  # P(delay <= 2)
    0.632
    >>> print(f"{Delay(2.0, 'gamma', shape=4.0).cdf(2.0):.3f}")
    0.567
    """

    time: float = 0.0
    law: str = "fixed"
    shape: float | None = None
    sigma: float | None = None
    activation: float = 0.0
    velocity_exponent: float = 0.0
    reference_velocity: float = 1.0

    def __post_init__(self) -> None:
        require_number_or_infinity("time", self.time, **NOT_NEGATIVE)
        require_choice("law", self.law, tuple(DELAYS))
        require_number("activation", self.activation, **NOT_NEGATIVE)
        require_number("velocity_exponent", self.velocity_exponent, least=-10, most=10)
        require_number("reference_velocity", self.reference_velocity, **POSITIVE)
        for law, (name, least, most) in PARAMETERS.items():
            value = getattr(self, name)
            if law != self.law and value is not None:
                raise InputError(f'{name}: not allowed with law = "{self.law}"')
            if law == self.law and value is None:
                raise InputError(f'{name}: is required with law = "{law}"')
            if value is not None:
                require_number(name, value, least=least, most=most)

    @property
    def parameters(self) -> tuple[float, ...]:
        """The parameter of the law beside its mean, if it has one."""
        name = PARAMETERS.get(self.law, ("",))[0]
        return (getattr(self, name),) if name else ()

    def at(self, kT: float, velocity: float) -> "Delay":
        """The delay at a temperature and a velocity, which depends on neither; infinite
        if it would be 1e100 or longer."""
        time, exponent = self.time, 0.0
        if self.activation:
            exponent = self.activation / kT if kT else math.inf
        if self.velocity_exponent:
            logs = math.log(velocity) - math.log(self.reference_velocity)
            exponent += self.velocity_exponent * logs
        if exponent and time:
            time *= math.exp(min(exponent, _MOST_EXPONENT))
            if exponent > _MOST_EXPONENT or time >= _ENDLESS:
                time = math.inf
        return Delay(time, self.law, self.shape, self.sigma)

    def reduced(self, velocity: float = 1.0, unit: float = 1.0) -> DelayLaw:
        """The law of v tau in units of `unit` (length), of a delay that depends on
        neither temperature nor velocity."""
        if self.time in (0.0, math.inf):
            return Fixed(self.time)  # all laws are alike
        return DELAYS[self.law](velocity * self.time / unit, *self.parameters)

    def cdf(self, t: Any) -> Array:
        """P(delay <= t), t a time, of a delay that depends on neither temperature nor
        velocity (see `at`)."""
        return self.reduced().cdf(t)

    def residual_cdf(self, t: Any) -> Array:
        """P(rest of the delay <= t) of a contact found detached in the stationary state
        (derived, renewal theory); else as `cdf`."""
        return self.reduced().residual_cdf(t)


class Waits(NamedTuple):
    """A fixed or exponential law of delays for kernels: the part `random` of the `mean`
    is exponentially distributed, the rest fixed."""

    mean: float
    random: float

    @property
    def law(self) -> Fixed | Exponential:
        """The law itself."""
        return Exponential(self.mean) if self.random else Fixed(self.mean)


class DrawnWaits(NamedTuple):
    """A law of delays with a density for kernels: its `mean`, all of which is `random`;
    an octave table of `exceeded`; `begun` and `above` at `knots`, delays over the mean
    from 0 on; and the number of the law in `DELAYS` with its parameter."""

    mean: float
    random: float
    quantile: Array
    knots: Array
    begun: Array
    above: Array
    number: int
    shape: float

    @property
    def law(self) -> GammaDelay | LognormalDelay:
        """The law itself."""
        made: Any = list(DELAYS.values())[self.number]
        return made(self.mean, self.shape)


@functools.lru_cache(maxsize=16)  # takes 0.1 s
def _tables(kind: Any, shape: float) -> tuple[Any, ...]:
    """The fields of `DrawnWaits` after `random`."""
    law, e = kind(1.0, shape), octave_edges(*_OCTAVES)
    u = law.exceeded(e)
    table = octave_table(_OCTAVES[0], u, u / e * np.gradient(np.log(u), np.log(e)))
    knots = np.unique(np.append(0.0, law.exceeded(np.exp(_LOG_RANKS))))
    at_knots = knots, law.begun(knots), law.above(knots)
    return table, *at_knots, list(DELAYS.values()).index(kind), shape


@by_law
def delay_draw(law: Any, u: float) -> float:
    """A delay from a uniform u in (0, 1)."""
    return law.mean - law.random - law.random * log(u)


@delay_draw.register(DrawnWaits)
def _delay_from_table(law: DrawnWaits, u: float) -> float:
    return law.mean * look_up(law.quantile, -log(u))


@routine(inline=True)
def begun_at(law: DrawnWaits, u: float, i: int) -> tuple[float, int]:
    """`begun` at u >= 0, and the knot below; `i` is one below that."""
    knots, y, slope = law.knots, law.begun, law.above
    while i + 2 < knots.size and knots[i + 1] < u:
        i += 1
    width = knots[i + 1] - knots[i]
    t = min((u - knots[i]) / width, 1.0)
    rise = y[i + 1] - y[i]
    left, right = slope[i] * width, slope[i + 1] * width
    return hermite(t, y[i], rise, left, right), i


@by_law
def residual_delay_draw(law: Any, u: float) -> float:
    """The rest of a delay in the stationary state, all of it random or none, from a
    uniform u in (0, 1)."""
    return (law.mean - law.random) * u - law.random * math.log(u)


@residual_delay_draw.register(DrawnWaits)
def _residual_from_knots(law: DrawnWaits, u: float) -> float:
    y, knots, share = law.begun, law.knots, 1.0 - u
    i = max(search(y, share, False), 1) - 1
    rest = (share - y[i]) / (y[i + 1] - y[i])
    x = knots[i] + rest * (knots[i + 1] - knots[i])
    slope = law.above[i] + rest * (law.above[i + 1] - law.above[i])
    # one step of Newton's method from a straight line between knots
    return law.mean * max(x - (begun_at(law, x, i)[0] - share) / slope, 0.0)
