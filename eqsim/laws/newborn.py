"""Stretches y of newborn contacts: R of the master equation (Q5a of Braun and Peyrard,
2011) in general.

A contact is born at y, is carried to y + s, and breaks at x_b; l = x_b - y is its
travel. y is a length, or a fraction of the contact's own threshold. In the first case a
contact that forms is one that holds: its threshold is drawn given that it is above |y|;
that of an annealed contact given that it is above y, since the master equation has no
mechanical breaking at negative stretch, P(x) = P_c/J_c for x > 0 only. In the second
the threshold is drawn first.

`LAWS` lists the laws. Each is a NamedTuple of its numbers, lengths in units of the
threshold law's scale, with NumPy's formulas as methods and a body of the kernel routine
`birth_draw`.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from eqsim.errors import InputError, require_choice, require_number
from eqsim.laws.law import Law
from eqsim.laws.threshold import (
    Gamma,
    ThresholdLaw,
    Thresholds,
    threshold_at,
    threshold_draw,
)
from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.roots import Bracket, narrowed
from eqsim.numerics.tables import (
    NO_TABLE,
    Array,
    look_up,
    octave_edges,
    octave_table,
    search,
)
from eqsim.numerics.vector_math import log

_NUMBERS = {
    "unstressed": (),
    "delta": ("stretch",),
    "uniform": ("low", "high"),
    "exponential": ("mean",),
    "normal": ("mean", "std"),
}
# largest share of births that may be beyond the greatest threshold
_LOST = 1e-9
_RAREST_THRESHOLD = 470.0  # -ln J_c of a threshold that counts as the greatest
# of stretches over the scale of thresholds; few thresholds are less
_FIRST_OCTAVE = -40


class DeltaBirths(NamedTuple("DeltaNumbers", [("stretch", float)]), Law):
    """All births at `stretch`."""

    __slots__ = ()

    @property
    def mean(self) -> float:
        """E[y], or of fractions E[y/xi]."""
        return self.stretch

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest stretch of all births but a share of 1e-16."""
        return self.stretch, self.stretch

    def pdf(self, y: Array) -> Array:
        """R(y)."""
        raise NotImplementedError("identical births have no density")

    def sf(self, y: float) -> float:
        """Share of births beyond y."""
        return float(self.stretch > y)


class UniformBirths(
    NamedTuple("UniformNumbers", [("low", float), ("high", float)]), Law
):
    """Births from `low` to `high`; methods are those of `DeltaBirths`."""

    __slots__ = ()

    @property
    def mean(self) -> float:
        return 0.5 * (self.low + self.high)

    @property
    def range(self) -> tuple[float, float]:
        return self.low, self.high

    def pdf(self, y: Array) -> Array:
        inside = (y >= self.low) & (y <= self.high)
        return np.where(inside, 1.0 / (self.high - self.low), 0.0)

    def sf(self, y: float) -> float:
        return min(max((self.high - y) / (self.high - self.low), 0.0), 1.0)


class ExponentialBirths(NamedTuple("ExponentialNumbers", [("mean", float)]), Law):
    """Positive births of this mean; methods are those of `DeltaBirths`."""

    __slots__ = ()

    @property
    def range(self) -> tuple[float, float]:
        return 0.0, 36.0 * self.mean

    def pdf(self, y: Array) -> Array:
        density = np.exp(-np.maximum(y, 0.0) / self.mean) / self.mean
        return np.where(y >= 0.0, density, 0.0)

    def sf(self, y: float) -> float:
        return math.exp(-max(y, 0.0) / self.mean)


class NormalBirths(
    NamedTuple("NormalNumbers", [("mean", float), ("std", float), ("table", Array)]),
    Law,
):
    """Births of this mean and standard deviation; methods are those of `DeltaBirths`.
    `table`: |z| of a normal deviate against -ln P(|Z| > |z|)."""

    __slots__ = ()

    @property
    def range(self) -> tuple[float, float]:
        return self.mean - 8.3 * self.std, self.mean + 8.3 * self.std

    def pdf(self, y: Array) -> Array:
        z = (np.asarray(y, float) - self.mean) / self.std
        return np.asarray(np.exp(-0.5 * z**2) / (math.sqrt(2.0 * math.pi) * self.std))

    def sf(self, y: float) -> float:
        return float(special.ndtr((self.mean - y) / self.std))


BirthLaw = DeltaBirths | UniformBirths | ExponentialBirths | NormalBirths


# It has no parameters, and a solve asks for it ten times.
@functools.cache
def _deviates() -> Array:
    """|z| against e = -ln P(|Z| > |z|), for |z| up to 12."""
    first, last = -54, 7
    e = octave_edges(first, last)
    low = special.erfinv(-np.expm1(-e))
    high = special.erfcinv(np.exp(-np.minimum(e, 600.0)))
    z = np.where(e < 1.0, low, high) * math.sqrt(2.0)
    return octave_table(first, z, np.exp(0.5 * z**2 - e) * math.sqrt(0.5 * math.pi))


LAWS: dict[str, Any] = {
    "delta": DeltaBirths,
    "uniform": UniformBirths,
    "exponential": ExponentialBirths,
    "normal": NormalBirths,
}


@dataclass(frozen=True)
class Newborn:
    """Law of the stretches of newborn contacts, R(x) in eq. (1) of Braun and Peyrard
    (2011).

    Raises InputError for an unknown law, values out of range, parameters of another
    law, and missing ones.

    Parameters
    ----------
    law : str
        "unstressed", "delta", "uniform", "exponential" or "normal".
    of : str
        "length", or "threshold": the numbers are fractions of the contact's own
        threshold, between -1 and 1 ("delta" and "uniform" only).
    stretch : float, optional
        Stretch of "delta" (length, positive in the direction of X, or fraction).
    low, high : float, optional
        Range of "uniform".
    mean : float, optional
        Mean of "exponential", > 0, or "normal".
    std : float, optional
        Standard deviation of "normal", > 0.

    Examples
    --------
    >>> Newborn("uniform", of="threshold", low=0.0, high=0.5).active
    True
    """

    law: str = "unstressed"
    of: str = "length"
    stretch: float | None = None
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    std: float | None = None

    def __post_init__(self) -> None:
        require_choice("law", self.law, tuple(_NUMBERS))
        require_choice("of", self.of, ("length", "threshold"))
        for name in ("stretch", "low", "high", "mean", "std"):
            value = getattr(self, name)
            if name not in _NUMBERS[self.law]:
                if value is not None:
                    taken = " and ".join(_NUMBERS[self.law]) or "no number"
                    raise InputError(
                        f'{name} = {value!r}: not allowed with law = "{self.law}", '
                        f"which takes {taken}"
                    )
            elif value is None:
                raise InputError(f'{name}: is required with law = "{self.law}"')
            elif name == "std" or self.law == "exponential":
                require_number(name, value, above=0.0, least=1e-100, most=1e100)
            else:
                require_number(name, value, least=-1e100, most=1e100)
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise InputError(f"high = {self.high!r}: must be > low = {self.low!r}")
        if self.of == "threshold":
            if self.law in ("exponential", "normal"):
                raise InputError(
                    f'law = "{self.law}": reaches beyond any threshold; of = '
                    '"threshold" takes "delta" or "uniform"'
                )
            if self.stretch is not None and not -1.0 < self.stretch < 1.0:
                raise InputError(
                    f"stretch = {self.stretch!r}: must be > -1 and < 1 with of = "
                    '"threshold"'
                )
            for name in ("low", "high"):
                if self.law == "uniform":
                    require_number(name, getattr(self, name), least=-1.0, most=1.0)

    @property
    def active(self) -> bool:
        """True if any contact is born stretched."""
        return self.law != "unstressed" and self.stretch != 0.0

    @property
    def declared(self) -> tuple[Any, ...]:
        """Name of random streams: texts and numbers as given; lengths are yet to be
        divided by a unit."""
        return self.law, self.of, *(getattr(self, name) for name in _NUMBERS[self.law])

    def reduced(self, unit: float) -> Any:
        """The law of births that are `active`, one of `LAWS`, lengths in units of
        `unit`."""
        scale = 1.0 if self.of == "threshold" else unit
        numbers = [getattr(self, name) / scale for name in _NUMBERS[self.law]]
        if self.law == "normal":
            numbers.append(_deviates())
        return LAWS[self.law](*numbers)

    def check(self, thresholds: ThresholdLaw, disorder: str, ages: bool) -> None:
        """Raise InputError if contacts are born beyond all thresholds, or age."""
        if not self.active:
            return
        if ages:
            raise InputError(
                f'law = "{self.law}": must be "unstressed" for contacts that age, or '
                'take aging.rule = "none"'
            )
        if self.of == "threshold":
            return
        law, unit = self.reduced(thresholds.scale), thresholds.scale
        top, (low, high) = _greatest(thresholds), law.range
        both = disorder == "quenched" or thresholds.steps.size == 1
        below = 1.0 - law.sf(-top) if both else 0.0
        if law.sf(top) + below > _LOST or (high >= top and low == high):
            at = max(abs(low), abs(high)) * unit
            raise InputError(
                f'law = "{self.law}": contacts are born with stretches up to {at:.3g}, '
                f"but no threshold is above {top * unit:.3g}; a contact that forms is "
                "one that holds"
            )


def _greatest(thresholds: ThresholdLaw) -> float:
    """The greatest threshold that counts, in units of the scale."""
    steps = thresholds.steps
    top = steps[-1] if steps.size else thresholds.inverse_survival(_RAREST_THRESHOLD)
    return float(top) / thresholds.scale


# ---- kernels ----


class Unstressed(NamedTuple):
    """Births for kernels where every contact is born at stretch 0."""

    most: float = 0.0

    def reach(self, xi: float) -> float:
        """The greatest |y|, as in `Stretched`."""
        return 0.0


class Stretched(NamedTuple):
    """Births for kernels."""

    law: Any  # of `LAWS`
    of_threshold: bool  # y is a fraction of the threshold
    two_sided: bool  # thresholds have to be above |y|, not above y only
    most: float  # births beyond it, which hardly occur, are put there
    ranks: Array  # -ln J_c(|y|) against |y|; empty: sought in the thresholds' table
    sign: float = 1.0  # direction of motion along a segment, in which y counts

    def reach(self, xi: float) -> float:
        """The greatest |y| of contacts whose thresholds are at most `xi`."""
        low, high = self.law.range
        if self.of_threshold:
            return xi * max(abs(low), abs(high))
        below = min(-low, self.most) if self.two_sided else -low
        return max(min(high, self.most), below)


def stretched(newborn: Newborn, thresholds: ThresholdLaw, two_sided: bool) -> Stretched:
    """Births for kernels, lengths in units of the thresholds' scale."""
    law, ranks = newborn.reduced(thresholds.scale), NO_TABLE
    if newborn.of == "threshold":
        return Stretched(law, True, two_sided, math.inf, ranks)
    if isinstance(thresholds, Gamma):
        ranks = _ranks(thresholds.n)
    top = math.inf if thresholds.steps.size else _greatest(thresholds)
    return Stretched(law, False, two_sided, top, ranks)


# It takes 0.6 ms, and sweeps ask for it again; 32 tables of 100 kB are 3 MB.
@functools.lru_cache(maxsize=32)
def _ranks(n: float) -> Array:
    """-ln J_c of a gamma law against the stretch."""
    law = Gamma(n)
    last = math.ceil(math.log2(float(law.inverse_survival(_RAREST_THRESHOLD)))) + 1
    x = octave_edges(_FIRST_OCTAVE, last)
    weak = x < float(law.inverse_survival(0.7))
    with np.errstate(divide="ignore", invalid="ignore"):
        e = np.where(weak, -np.log1p(-law.cdf(x)), -np.log(law.sf(x)))
        slope = law.pdf(x) / np.where(weak, 1.0 - law.cdf(x), law.sf(x))
    good = np.isfinite(e) & np.isfinite(slope)  # beyond, no birth
    e, slope = np.where(good, e, e[good].max()), np.where(good, slope, 0.0)
    return octave_table(_FIRST_OCTAVE, e, slope)


@by_law
def birth_draw(law: Any, u: float) -> float:
    """A stretch, or fraction of the threshold, from a uniform u in (0, 1)."""
    raise TypeError("this law has no births")


@birth_draw.register(DeltaBirths)
def _delta(law: DeltaBirths, u: float) -> float:
    return law.stretch


@birth_draw.register(UniformBirths)
def _uniform(law: UniformBirths, u: float) -> float:
    return law.low + (law.high - law.low) * u


@birth_draw.register(ExponentialBirths)
def _exponential(law: ExponentialBirths, u: float) -> float:
    return -law.mean * log(u)


@birth_draw.register(NormalBirths)
def _normal(law: NormalBirths, u: float) -> float:
    z = look_up(law.table, -log(2.0 * min(u, 1.0 - u)))
    return law.mean + law.std * (z if u > 0.5 else -z)


@by_law
def newborn_draw(
    born: Any, thresholds: Thresholds, u: float, v: float
) -> tuple[float, float]:
    """Threshold and stretch of a newborn contact from uniforms u (the share of possible
    thresholds that are greater) and v (its birth)."""
    return threshold_draw(thresholds, u), 0.0


@newborn_draw.register(Stretched)
def _draw(
    born: Stretched, thresholds: Thresholds, u: float, v: float
) -> tuple[float, float]:
    y = birth_draw(born.law, v)
    if born.of_threshold:
        xi = threshold_draw(thresholds, u)
        return xi, xi * y
    y = min(y, born.most)
    if born.two_sided:
        y = max(y, -born.most)
    bound = abs(y) if born.two_sided else max(y, 0.0)
    if bound == 0.0:
        return threshold_draw(thresholds, u), y
    return threshold_above(thresholds, born.ranks, bound, u), y


@routine
def threshold_above(
    thresholds: Thresholds, ranks: Array, bound: float, u: float
) -> float:
    """A threshold given that it is above `bound`."""
    steps = thresholds.steps
    if steps.size > 0:
        above = steps.size - search(steps, bound, True)
        return steps[steps.size - 1 - np.int64(u * above)]
    if ranks.shape[0] > 0:
        e = look_up(ranks, bound)
    else:  # by bisection in ln e
        bracket, log2_e = Bracket(-54.0, 9.0), -22.5
        for _ in range(60):
            excess = threshold_at(thresholds, 2.0**log2_e) - bound
            bracket, log2_e = narrowed(bracket, log2_e, excess, math.nan)
        e = 2.0**bracket.high
    return max(threshold_at(thresholds, e - log(u)), bound)
