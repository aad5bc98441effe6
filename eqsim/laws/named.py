"""Laws of thresholds that run files call by name. This is where they are listed.

A law is a dataclass of its parameters, which are keys of `[thresholds]`: a length
`x_star`, the unit of the formulas below, and numbers of its own. Kernels draw from a
table of the quantile function (`laws.threshold.Smooth`).
"""

import math
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from typing import Any, ClassVar

import numpy as np
from scipy import special

from eqsim.errors import POSITIVE, InputError, require_number
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.laws.threshold import Delta, Gamma, Smooth, ThresholdLaw
from eqsim.numerics.tables import Array

_CUT_NODES, _CUT_WEIGHTS = special.roots_legendre(12)
_ROOT_2PI = math.sqrt(2.0 * math.pi)


class Named(Smooth):
    """A law in units u = xi/unit: formulas for arrays u of any shape within the `ends`.
    `exceeded(e)` is the u that a share exp(-e) of the contacts exceeds."""

    density: Callable[[Array], Any]
    below: Callable[[Array], Any]  # P(U <= u)
    above: Callable[[Array], Any]  # P(U > u)
    exceeded: Callable[[Array], Any]
    name: ClassVar[str]
    # least and greatest value of each of the `numbers`
    ranges: ClassVar[dict[str, tuple[float, float]]] = {}
    ends: ClassVar[tuple[float, float]] = (0.0, math.inf)
    x_star: float

    def __post_init__(self) -> None:
        require_number("x_star", self.x_star, **POSITIVE)
        for name, (least, most) in self.ranges.items():
            require_number(name, getattr(self, name), least=least, most=most)

    @property
    def unit(self) -> float:
        """The length in units of which the law depends on `numbers` alone."""
        return self.x_star

    @property
    def numbers(self) -> tuple[float, ...]:
        """Dimensionless parameters."""
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return tuple(getattr(self, name) for name in names if name != "x_star")

    @property
    def moments(self) -> tuple[float, float]:
        """<u> and <u^2>."""
        raise NotImplementedError

    @property
    def declared(self) -> tuple[Any, ...]:
        return (self.unit, self.name, *self.numbers)

    @property
    def scale(self) -> float:  # type: ignore[override]
        return self.unit

    @property
    def mean(self) -> float:
        """<xi>."""
        return self.unit * self.moments[0]

    @property
    def rms(self) -> float:
        """sqrt(<xi^2>)."""
        return self.unit * math.sqrt(self.moments[1])

    @property
    def support(self) -> tuple[float, float]:  # type: ignore[override]
        return self.unit * self.ends[0], self.unit * self.ends[1]

    def _inside(self, x: Any) -> Array:
        return np.clip(np.asarray(x, float) / self.unit, *self.ends)

    def pdf(self, x: Any) -> Array:
        u = np.asarray(x, float) / self.unit
        with np.errstate(all="ignore"):  # u = 0 and the tail
            found = self.density(np.clip(u, *self.ends)) / self.unit
        inside = (u >= self.ends[0]) & (u <= self.ends[1])
        return np.where(inside & ~np.isnan(found), found, 0.0)

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        with np.errstate(all="ignore"):  # x = 0 and the tail
            return np.asarray(self.below(self._inside(x)))

    def sf(self, x: Any) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(self.above(self._inside(x)))

    def inverse_survival(self, e: Any) -> Array:
        return np.asarray(self.unit * self.exceeded(np.asarray(e, float)))


@dataclass(frozen=True)
class Lognormal(Named):
    """Thresholds whose logarithm is normal.

    Raises InputError for values out of range.

    Parameters
    ----------
    sigma : float
        Standard deviation of ln xi, from 1e-3 to 2.
    x_star : float
        Median (length), > 0.

    Examples
    --------
    >>> print(f"{Lognormal(sigma=0.5).mean:.3f}")
    1.133
    """

    sigma: float
    x_star: float = 1.0
    name: ClassVar[str] = "lognormal"
    ranges: ClassVar[dict[str, tuple[float, float]]] = {"sigma": (1e-3, 2.0)}

    @property
    def moments(self) -> tuple[float, float]:
        return math.exp(0.5 * self.sigma**2), math.exp(2.0 * self.sigma**2)

    def density(self, u: Array) -> Any:
        z = np.log(u) / self.sigma
        return np.exp(-0.5 * z**2) / (u * self.sigma * _ROOT_2PI)

    def below(self, u: Array) -> Any:
        return special.ndtr(np.log(u) / self.sigma)

    def above(self, u: Array) -> Any:
        return special.ndtr(-np.log(u) / self.sigma)

    def exceeded(self, e: Array) -> Any:
        return np.exp(-self.sigma * special.ndtri_exp(-e))


class StretchedExponential(Named):
    """P(xi > x) = exp(-(x/x_*)^shape)."""

    shape: float

    @property
    def moments(self) -> tuple[float, float]:
        return math.gamma(1.0 + 1.0 / self.shape), math.gamma(1.0 + 2.0 / self.shape)

    def density(self, u: Array) -> Any:
        return self.shape * u ** (self.shape - 1.0) * np.exp(-(u**self.shape))

    def below(self, u: Array) -> Any:
        return -np.expm1(-(u**self.shape))

    def above(self, u: Array) -> Any:
        return np.exp(-(u**self.shape))

    def exceeded(self, e: Array) -> Any:
        return e ** (1.0 / self.shape)


@dataclass(frozen=True)
class Weibull(StretchedExponential):
    """Weibull's law, P(xi > x) = exp(-(x/x_*)^shape); shape 2 is `Gamma` with n = 0.

    Raises InputError for values out of range.

    Parameters
    ----------
    shape : float
        From 0.5 to 1000.
    x_star : float
        x_* (length), > 0.

    Examples
    --------
    >>> print(f"{Weibull(shape=3.0).mean:.3f}")
    0.893
    """

    shape: float
    x_star: float = 1.0
    name: ClassVar[str] = "weibull"
    ranges: ClassVar[dict[str, tuple[float, float]]] = {"shape": (0.5, 1000.0)}


@dataclass(frozen=True)
class Exponential(StretchedExponential):
    """Exponential law, P(xi > x) = exp(-x/x_*).

    Parameters
    ----------
    x_star : float
        Mean (length), > 0. Raises InputError for other values.

    Examples
    --------
    >>> Exponential(x_star=2.0).mean
    2.0
    """

    x_star: float = 1.0
    name: ClassVar[str] = "exponential"
    shape: ClassVar[float] = 1.0  # type: ignore[misc]


@dataclass(frozen=True)
class Normal(Named):
    """Normal law cut off at 0: P_c(x) ~ exp(-(x - x_*)^2/(2 std^2)), x > 0.

    Raises InputError for values out of range.

    Parameters
    ----------
    std : float
        Standard deviation of the normal law, before it is cut off at 0 (length), from
        1e-3 to 10 x_*.
    x_star : float
        Its mean, the most likely threshold (length), > 0.

    Examples
    --------
    >>> print(f"{Normal(std=0.3).mean:.4f}")  # of what is left above 0
    1.0005
    """

    std: float
    x_star: float = 1.0
    name: ClassVar[str] = "normal"

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = 1e-3 * self.x_star, 10.0 * self.x_star
        require_number("std", self.std, least=least, most=most)

    @property
    def numbers(self) -> tuple[float, ...]:
        return (self.std / self.x_star,)

    @property
    def _at_cut(self) -> float:
        """Density of (xi - 0)/std at the cut."""
        z = 1.0 / self.numbers[0]
        return math.exp(-0.5 * z * z) / _ROOT_2PI / float(special.ndtr(z))

    @property
    def moments(self) -> tuple[float, float]:
        (s,) = self.numbers
        mean = 1.0 + s * self._at_cut
        return mean, s * s + mean

    def density(self, u: Array) -> Any:
        (s,) = self.numbers
        share = special.ndtr(1.0 / s)
        return np.exp(-0.5 * ((u - 1.0) / s) ** 2) / (s * _ROOT_2PI * share)

    def _near_cut(self, w: Array) -> Any:
        """int_0^w exp(y/s - y^2/2) dy, without the cancellation of two normal integrals
        that are almost the same."""
        y = np.multiply.outer(w, 0.5 + 0.5 * _CUT_NODES)
        return 0.5 * w * (np.exp(y / self.numbers[0] - 0.5 * y * y) @ _CUT_WEIGHTS)

    def below(self, u: Array) -> Any:
        (s,) = self.numbers
        z, nearest = 1.0 / s, 0.5 * min(1.0, s)
        far = (special.ndtr((u - 1.0) / s) - special.ndtr(-z)) / special.ndtr(z)
        near = self._at_cut * self._near_cut(np.minimum(u / s, nearest))
        return np.where(u < s * nearest, near, far)

    def above(self, u: Array) -> Any:
        (s,) = self.numbers
        return special.ndtr((1.0 - u) / s) / special.ndtr(1.0 / s)

    def exceeded(self, e: Array) -> Any:
        (s,) = self.numbers
        z, nearest = 1.0 / s, 0.5 * min(1.0, s)
        far = 1.0 - s * special.ndtri_exp(special.log_ndtr(z) - e)
        with np.errstate(divide="ignore"):  # where the cut is too far away to matter
            wanted = -np.expm1(-e) / self._at_cut
        w = np.minimum(np.log1p(z * wanted) / z, nearest)
        for _ in range(5):  # Newton's method, from a first guess without y^2/2
            step = (self._near_cut(w) - wanted) * np.exp(0.5 * w * w - w * z)
            w = np.minimum(w - step, nearest)
        return np.where(w < nearest, s * w, far)


@dataclass(frozen=True)
class Uniform(Named):
    """Uniform law: all thresholds between two are equally likely.

    Raises InputError for values out of range.

    Parameters
    ----------
    low, high : float
        Least and greatest threshold (length), 0 <= low <= 0.999 high.

    Examples
    --------
    >>> Uniform(low=0.5, high=1.5).mean
    1.0
    """

    low: float
    high: float
    name: ClassVar[str] = "uniform"

    def __post_init__(self) -> None:
        require_number("high", self.high, **POSITIVE)
        require_number("low", self.low, least=0.0, most=0.999 * self.high)

    @property
    def unit(self) -> float:
        return self.high

    @property
    def numbers(self) -> tuple[float, ...]:
        return (self.low / self.high,)

    @property
    def ends(self) -> tuple[float, float]:  # type: ignore[override]
        return self.low / self.high, 1.0

    @property
    def moments(self) -> tuple[float, float]:
        (r,) = self.numbers
        return 0.5 * (1.0 + r), (1.0 + r + r * r) / 3.0

    def density(self, u: Array) -> Any:
        return np.full(u.shape, 1.0 / (1.0 - self.numbers[0]))

    def below(self, u: Array) -> Any:
        (r,) = self.numbers
        return (u - r) / (1.0 - r)

    def above(self, u: Array) -> Any:
        return (1.0 - u) / (1.0 - self.numbers[0])

    def exceeded(self, e: Array) -> Any:
        (r,) = self.numbers
        return r - (1.0 - r) * np.expm1(-e)


@dataclass(frozen=True)
class Pareto(Named):
    """Power law: P(xi > x) = (x_*/x)^exponent, x > x_*.

    Raises InputError for values out of range.

    Parameters
    ----------
    exponent : float
        From 3.05 to 1000; only above 3 the work of a contact of the sqrt law has a
        mean.
    x_star : float
        Least threshold (length), > 0.

    Examples
    --------
    >>> Pareto(exponent=5.0).mean
    1.25
    """

    exponent: float
    x_star: float = 1.0
    name: ClassVar[str] = "pareto"
    ends: ClassVar[tuple[float, float]] = (1.0, math.inf)
    ranges: ClassVar[dict[str, tuple[float, float]]] = {"exponent": (3.05, 1000.0)}

    @property
    def moments(self) -> tuple[float, float]:
        a = self.exponent
        return a / (a - 1.0), a / (a - 2.0)

    def density(self, u: Array) -> Any:
        return self.exponent * u ** (-self.exponent - 1.0)

    def below(self, u: Array) -> Any:
        return -np.expm1(-self.exponent * np.log(u))

    def above(self, u: Array) -> Any:
        return u**-self.exponent

    def exceeded(self, e: Array) -> Any:
        return np.exp(e / self.exponent)


NAMED: tuple[type[Named], ...] = (
    Lognormal,
    Weibull,
    Exponential,
    Normal,
    Uniform,
    Pareto,
)
THRESHOLDS: dict[str, Any] = {"gamma": Gamma, "delta": Delta, "none": NoThresholds}
THRESHOLDS |= {law.name: law for law in NAMED}


def threshold_parameters(name: str) -> dict[str, float | None]:
    """The parameters of a law and their defaults, None of those that are required;
    empty for a law that has none."""
    known = fields(THRESHOLDS[name]) if name in THRESHOLDS else ()
    return {
        f.name: None if f.default is MISSING else f.default for f in known if f.init
    }


def law_of(name: str, given: dict[str, float | None]) -> ThresholdLaw:
    """A law of the list from its parameters, None if not given. Raises InputError for a
    parameter that is missing."""
    for key, default in threshold_parameters(name).items():
        optional = THRESHOLDS[name] is NoThresholds
        if default is None and given.get(key) is None and not optional:
            raise InputError(f'{key}: is required with law = "{name}"')
    known = {key: value for key, value in given.items() if value is not None}
    law: ThresholdLaw = THRESHOLDS[name](**known)
    return law
