"""Threshold stretches xi of newborn contacts: P_c(xi), its moments, and how a kernel
draws from it.

A smooth law is drawn as xi(e), e ~ Exp(1): the threshold that a fraction exp(-e) of the
contacts exceeds, that is J_c(xi) = exp(-e) (PcP of Braun and Peyrard, 2011). In this
variable rare strong contacts are resolved to 1e-19 of all births and weak ones to
1e-16, and one table serves every law. A law of finitely many thresholds is drawn by its
rank.
"""

import functools
import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import special

from eqsim.errors import POSITIVE, InputError, require_number, shown
from eqsim.laws.kinks import density_kinks
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import gamma_quantile, gauss_legendre
from eqsim.numerics.roots import bisected
from eqsim.numerics.tables import (
    NO_TABLE,
    Array,
    look_up,
    look_up_ranked,
    octave_edges,
    octave_table,
    ranked_table,
)
from eqsim.numerics.vector_math import log

# e from the smallest gap below 1 of a 64-bit uniform up to P(xi > .) = 1e-222
FIRST_OCTAVE = -54
LAST_OCTAVE = 9
NO_STEPS: Array = np.empty(0)

# moments over strong contacts, in e = -ln J_c(xi)
# up to here a tail is integrated; beyond, it is continued as a power law
RAREST = 500.0
_TAIL_STEP = 25.0  # between the three thresholds that tell its power
# the longest panel of Gauss and Legendre: e^(p e/exponent - e) is smooth on this scale
_PANEL = 4.0
# the shortest, next to the lower end of the integral, where integrands may have a kink
_FINEST_PANEL = 2.0**-40
# decay of a moment's tail per e, below which rounding hides whether it diverges
_LEAST_DECAY = 1e-9
_KNOWN_SHARE = 1e-6  # a J_c that is good to 1e-10 even if computed as 1 - P(xi <= x)
_ROUNDED = 1e-13  # relative, of sums and of logarithms of about 500
_TAIL_NODES, _TAIL_WEIGHTS = gauss_legendre(12)


class ThresholdLaw(Protocol):
    """The interface of a law of thresholds; lengths are in the user's unit."""

    def __hash__(self) -> int:
        """Laws are immutable; their tables are cached."""

    @property
    def declared(self) -> tuple[Any, ...]:
        """Name of random streams: a length that was given, then the law's name and
        numbers in units of it; nothing that takes more than products and ratios to
        compute."""

    @property
    def scale(self) -> float:
        """A typical threshold, the unit of length inside the kernels."""

    @property
    def mean(self) -> float:
        """<xi>."""

    @property
    def rms(self) -> float:
        """sqrt(<xi^2>)."""

    @property
    def steps(self) -> Array:
        """Ascending equally likely thresholds of a discrete law; empty for a smooth
        one."""

    @property
    def support(self) -> tuple[float, float]:
        """Least and greatest threshold."""

    @property
    def breakpoints(self) -> Array:
        """Thresholds inside its support where the density of a smooth law jumps."""

    @property
    def kinks(self) -> Array:
        """Ascending thresholds > 0 where the density or its slope jumps or is infinite,
        with the ends of the support; the different thresholds of a discrete law."""

    def pdf(self, x: Any) -> Array:
        """P_c(x) of a smooth law."""

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""

    def sf(self, x: Any) -> Array:
        """J_c(x) = P(xi > x)."""

    def inverse_survival(self, e: Any) -> Array:
        """The threshold that a fraction exp(-e) of the contacts exceeds, e in (0, 512)."""

    @property
    def ranks(self) -> Array:
        """Edges of the cells of `table` where the density jumps; empty for those of
        octaves."""

    def table(self) -> Array:
        """`inverse_survival` in units of `scale` for `threshold_at`; empty for a
        discrete law."""


class Continuous:
    """Properties of laws whose density is smooth at all thresholds > 0."""

    steps: Array = NO_STEPS
    breakpoints: Array = NO_STEPS
    ranks: Array = NO_STEPS
    support: tuple[float, float] = (0.0, math.inf)

    @property
    def kinks(self) -> Array:
        """Thresholds > 0 where the density or its slope jumps: none."""
        return NO_STEPS


@dataclass(frozen=True)
class Gamma(Continuous):
    """Gamma law of threshold forces, f_s ~ f^n exp(-f/f_*), eqs. (7) and (8) of Braun
    and Peyrard (2011).

    Thresholds have the density P_c(x) ~ x^(1+2n) exp(-x^2/x_*^2): xi^2/x_*^2 follows
    the gamma law of shape n + 1.

    Raises InputError for values out of range.

    Parameters
    ----------
    n : float
        From 0 to 1e6, not necessarily whole.
    x_star : float
        x_* (length), > 0.

    Examples
    --------
    >>> print(f"{Gamma(n=1.0, x_star=2.0).mean:.3f}")
    2.659
    """

    n: float = 1.0
    x_star: float = 1.0

    def __post_init__(self) -> None:
        require_number("n", self.n, least=0, most=1e6)
        require_number("x_star", self.x_star, **POSITIVE)

    @property
    def declared(self) -> tuple[Any, ...]:
        return self.x_star, "gamma", self.n

    @property
    def scale(self) -> float:
        return self.x_star

    @property
    def mean(self) -> float:
        return float(self.x_star * special.poch(self.n + 1.0, 0.5))

    @property
    def rms(self) -> float:
        return self.x_star * math.sqrt(self.n + 1.0)

    def pdf(self, x: Any) -> Array:
        """P_c(x) (1/length)."""
        u = np.asarray(x, float) / self.x_star
        inside = np.where(u > 0, u, 1.0)
        log_pdf = (1 + 2 * self.n) * np.log(inside) - inside**2
        log_pdf -= special.gammaln(self.n + 1.0)
        return np.where(u > 0, 2.0 / self.x_star * np.exp(log_pdf), 0.0)

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        squares = (np.maximum(x, 0.0) / self.x_star) ** 2
        return np.asarray(special.gammainc(self.n + 1.0, squares))

    def sf(self, x: Any) -> Array:
        squares = (np.maximum(x, 0.0) / self.x_star) ** 2
        return np.asarray(special.gammaincc(self.n + 1.0, squares))

    def inverse_survival(self, e: Any) -> Array:
        return np.asarray(self.x_star * np.sqrt(gamma_quantile(self.n + 1.0, e)))

    def table(self) -> Array:
        e = octave_edges(FIRST_OCTAVE, LAST_OCTAVE)
        u = self.inverse_survival(e) / self.x_star
        log_slope = u**2 - e + special.gammaln(self.n + 1.0)
        log_slope -= (2 * self.n + 1) * np.log(u)
        slope = 0.5 * np.exp(log_slope)  # J_c/P_c
        return octave_table(FIRST_OCTAVE, u, slope)


class Discrete:
    """Properties that laws of finitely many equally likely thresholds share."""

    steps: Array
    ranks: Array = NO_STEPS

    @property
    def declared(self) -> tuple[Any, ...]:
        return self.steps[-1], "table", self.steps / self.steps[-1]

    @property
    def mean(self) -> float:
        return float(np.mean(self.steps))

    @property
    def scale(self) -> float:
        return self.mean

    @property
    def rms(self) -> float:
        return self.scale * float(np.sqrt(np.mean((self.steps / self.scale) ** 2)))

    @property
    def support(self) -> tuple[float, float]:
        return float(self.steps[0]), float(self.steps[-1])

    @property
    def breakpoints(self) -> Array:
        return self.steps

    @property
    def kinks(self) -> Array:
        return np.unique(self.steps)

    def pdf(self, x: Any) -> Array:
        raise NotImplementedError("a discrete law of thresholds has no density")

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        return np.searchsorted(self.steps, x, side="right") / self.steps.size

    def sf(self, x: Any) -> Array:
        return 1.0 - self.cdf(x)

    def inverse_survival(self, e: Any) -> Array:
        rank = (np.exp(-np.asarray(e, float)) * self.steps.size).astype(np.int64)
        return self.steps[self.steps.size - 1 - np.minimum(rank, self.steps.size - 1)]

    def table(self) -> Array:
        return NO_TABLE


@dataclass(frozen=True)
class Delta(Discrete):
    """Identical contacts, P_c(x) = delta(x - x_*).

    Parameters
    ----------
    x_star : float
        x_* (length), > 0. Raises InputError for other values.

    Examples
    --------
    >>> Delta(x_star=2.0).rms
    2.0
    """

    x_star: float = 1.0

    def __post_init__(self) -> None:
        require_number("x_star", self.x_star, **POSITIVE)

    @property
    def steps(self) -> Array:  # type: ignore[override]
        return np.array([self.x_star])


class Table(Discrete):
    """Measured or computed thresholds, resampled with equal weights as they are (the
    empirical law).

    Raises InputError if there is none, one is not a number from 1e-100 to 1e100, or
    they span over 30 decades.

    Parameters
    ----------
    thresholds : array_like
        Lengths, in any order.

    Examples
    --------
    >>> Table([3.0, 1.0, 2.0]).mean
    2.0
    """

    def __init__(self, thresholds: Any) -> None:
        try:
            steps = np.sort(np.asarray(thresholds, float).ravel())
        except (TypeError, ValueError):
            raise InputError("threshold table: every value must be a number") from None
        if steps.size == 0:
            raise InputError(
                "threshold table: is empty; at least one positive threshold is needed"
            )
        bad = steps[~((steps >= 1e-100) & (steps <= 1e100))]
        if bad.size:
            raise InputError(
                f"threshold table: holds {bad[0]:g}; every threshold must be a number "
                "from 1e-100 to 1e100"
            )
        if steps[-1] > 1e30 * steps[0]:
            span = f"{steps[0]:g} to {steps[-1]:g}"
            raise InputError(f"threshold table: spans {span}; at most 30 decades")
        steps.flags.writeable = False
        self.steps = steps

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Table) and np.array_equal(self.steps, other.steps)

    def __hash__(self) -> int:
        return hash((self.steps.size, self.steps[0], self.steps[-1]))

    def __repr__(self) -> str:
        span = f"{self.steps[0]:g} to {self.steps[-1]:g}"
        return f"Table({self.steps.size} thresholds from {span})"


class Smooth(Continuous):
    """Base of laws with any density, drawn from a table of the quantile function."""

    scale: float
    pdf: Callable[[Any], Array]
    cdf: Callable[[Any], Array]
    sf: Callable[[Any], Array]
    inverse_survival: Callable[[Any], Array]

    @property
    def kinks(self) -> Array:
        """Kinks of a law whose density is smooth between the ends of its support and
        its breakpoints."""
        ends = [end for end in self.support if 0.0 < end < math.inf]
        return np.union1d(self.breakpoints[self.breakpoints > 0.0], ends)

    @functools.cached_property
    def ranks(self) -> Array:  # type: ignore[override]
        """Edges of cells: of octaves, and twice where the ends of a gap meet."""
        return self._nodes[0] if self.breakpoints.size else NO_STEPS

    @functools.cached_property
    def _nodes(self) -> tuple[Array, Array]:
        """Ranks between which the quantile function is smooth, and its values there.
        Raises InputError where it is no quantile function."""
        e = octave_edges(FIRST_OCTAVE, LAST_OCTAVE)
        xi = self.inverse_survival(e)
        if not (np.all(np.isfinite(xi)) and np.all(np.diff(xi) >= 0) and xi[0] >= 0):
            raise InputError(
                "threshold distribution: its ppf and isf must be finite, positive and "
                "monotone"
            )
        if not self.breakpoints.size:
            return e, xi
        share = self.cdf(self.breakpoints)
        with np.errstate(divide="ignore"):
            at = np.where(
                share < 0.5, -np.log1p(-share), -np.log(self.sf(self.breakpoints))
            )
        within = at < e[-1]
        e, xi = np.append(e, at[within]), np.append(xi, self.breakpoints[within])
        order = np.lexsort((xi, e))
        # next to a breakpoint quantiles are rounded
        return e[order], np.maximum.accumulate(xi[order])

    def table(self) -> Array:
        """`inverse_survival` for kernels. Raises InputError where it is no quantile
        function."""
        e, xi = self._nodes
        if not self.ranks.size:
            slope = self._slope(xi, xi, np.gradient(xi, e))
            return octave_table(FIRST_OCTAVE, xi / self.scale, slope / self.scale)
        width = np.diff(e)
        secant = np.diff(xi) / np.where(width > 0.0, width, np.inf)
        begins = self._slope(xi[:-1], xi[:-1] * (1.0 + _ASIDE), secant)
        ends = self._slope(xi[1:], xi[1:] * (1.0 - _ASIDE), secant)
        return ranked_table(e, *(y / self.scale for y in (xi, begins, ends)))

    def _slope(self, xi: Array, beside: Array, secant: Array) -> Array:
        """d xi/de, with the density `beside` xi; the secant where it vanishes: at ends
        of the support, in gaps."""
        with np.errstate(all="ignore"):
            slope = self.sf(xi) / self.pdf(beside)
        return np.where(np.isfinite(slope), slope, secant)

    @functools.cached_property
    def drawn_to(self) -> float:
        """A bound on the relative error of averages over thresholds drawn from `table`,
        up to the work xi^3 of the sqrt law: where the density jumps, and no breakpoint
        says so, a cell of the table is smooth and the law is not."""
        first, third = self._drawn_to(1, 3, rarest=40.0)
        return first + third

    @functools.cached_property
    def squares_drawn_to(self) -> tuple[float, float]:
        """`drawn_to` for mean squares of forces, that is for xi^3 (uniform stiffness)
        and xi^5 (the sqrt law), to which far rarer thresholds contribute."""
        third, fifth = self._drawn_to(3, 5, rarest=RAREST)
        return third, fifth

    def _drawn_to(self, *powers: int, rarest: float) -> list[float]:
        """Mean absolute errors of powers of drawn thresholds, over the means of these
        powers, for e up to `rarest`."""
        edges, t = self._nodes[0], (np.arange(4) + 0.5) / 4
        matter = (edges[:-1] > 1e-6) & (edges[:-1] < rarest)
        e = (edges[:-1, None] + np.diff(edges)[:, None] * t)[matter]
        cells = self.table()[-matter.size :]
        drawn = cells[matter] @ t ** np.arange(4)[:, None]
        exact = self.inverse_survival(e) / self.scale
        share = (np.exp(-edges[:-1]) - np.exp(-edges[1:]))[matter]

        def error(p: int) -> float:
            missed = np.abs(drawn**p - exact**p).sum(1)
            return float(share @ missed / (share @ (exact**p).sum(1)))

        # powers of extreme thresholds may overflow, of laws without such a mean
        with np.errstate(all="ignore"):
            return [error(p) for p in powers]


# how far beside a breakpoint its densities are, relative
_ASIDE = 1e-12
# kinks closer to a known one, over the scale, are none of their own: next to an
# infinite end densities are rounded
_SAME = 1e-6
# Points between which the bins of a histogram are sought, in equal steps and in equal
# shares.
_SEEN = 4097


def _bins(histogram: Any) -> Array:
    """Find where the density of an `rv_histogram` jumps, to the last bit, and the ends
    of its support. SciPy does not tell its bins: they are found by bisection between
    points whose densities differ. Only bins that are both narrower and less likely than
    1/4096 may be missed."""
    low, high = histogram.support()
    shares = histogram.ppf(np.linspace(0.0, 1.0, _SEEN))
    x = np.append(np.linspace(low, high, _SEEN), shares)
    x = np.unique(np.append(x, np.nextafter(low, -np.inf)))
    left, right = x[:-1], x[1:]
    while True:
        differ = histogram.pdf(left) != histogram.pdf(right)
        left, right = left[differ], right[differ]
        apart = np.nextafter(left, np.inf) < right
        if not apart.any():
            return np.union1d(right, [low, high])
        middle = np.where(apart, left + 0.5 * (right - left), right)
        left, right = np.append(left, middle), np.append(middle, right)


class Distribution(Smooth):
    """Any continuous `scipy.stats` distribution of positive thresholds.

    Raises InputError if the argument is something else.

    Parameters
    ----------
    frozen : scipy.stats frozen distribution
        Its mean cube (the work of a contact under the sqrt law) has to be finite.
    breakpoints : array_like, optional
        Points inside the support where its density jumps (those of an `rv_histogram`
        are found). Where others jump draws are interpolated: up to half a percent of
        all thresholds would be drawn within a gap, which error bars of `steady`
        include and the scatter of runs does not.

    Examples
    --------
    >>> from scipy import stats
    >>> print(f"{Distribution(stats.gamma(3.0)).mean:.1f}")
    3.0
    """

    def __init__(self, frozen: Any, breakpoints: Any = None) -> None:
        # takes long to import, but who has a distribution has imported it
        from scipy import stats

        try:
            least, scalar = frozen.ppf(0.0), np.ndim(frozen.pdf(1.0)) == 0
        except (AttributeError, TypeError):
            scalar = False
        if not scalar:
            raise InputError(
                f"threshold distribution = {frozen!r}: must be a frozen continuous "
                "scipy.stats one"
            )
        self.frozen = frozen
        if not least >= 0.0:
            raise InputError(
                f"threshold distribution: its support begins at {least:g}; must be >= 0"
            )
        with warnings.catch_warnings():
            # a divergent integral is refused below
            warnings.simplefilter("ignore")
            third = float(frozen.moment(3))
            second, self.mean = float(frozen.moment(2)), float(frozen.mean())
        low, high = frozen.support()
        self.support, self.scale = (float(low), float(high)), 1.0
        # where it diverges SciPy may give a finite number
        if self._third_diverges():
            third = math.inf
        require_number("threshold distribution: <xi^3>", third, above=0)
        self.scale, self.rms = self.mean, math.sqrt(second)
        if breakpoints is None:
            law = getattr(frozen, "dist", frozen)
            binned = isinstance(law, stats.rv_histogram)
            breakpoints = _bins(frozen) if binned else NO_STEPS
        try:
            self.breakpoints = np.unique(np.asarray(breakpoints, float))
        except (TypeError, ValueError):
            self.breakpoints = np.full(1, np.nan)
        if not np.all(np.isfinite(self.breakpoints)):
            said = "must be finite numbers"
            raise InputError(f"breakpoints = {shown(breakpoints)}: {said}")

    def _third_diverges(self) -> bool:
        """True if <xi^3> diverges, as far as SciPy knows the tail: an isf that fails is
        refused where it is needed."""
        try:
            return diverges(self, 3)
        except InputError:
            return False

    def __repr__(self) -> str:
        return f"Distribution({self._name}, mean {self.mean:g}, rms {self.rms:g})"

    @property
    def _name(self) -> str:
        return str(getattr(self.frozen, "dist", self.frozen).name)

    @property
    def declared(self) -> tuple[Any, ...]:
        named = sorted(getattr(self.frozen, "kwds", {}).items())
        flat: list[Any] = []
        for part in (*getattr(self.frozen, "args", ()), *named):
            flat += part if isinstance(part, tuple) else (part,)
        # a histogram has no other parameters
        return (1.0, self._name, *flat, self.breakpoints, self.cdf(self.breakpoints))

    # SciPy divides by 0 and overflows far out in the tails of some laws.

    @np.errstate(all="ignore")
    def pdf(self, x: Any) -> Array:
        """P_c(x)."""
        return np.asarray(self.frozen.pdf(x))

    @np.errstate(all="ignore")
    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        return np.asarray(self.frozen.cdf(x))

    @np.errstate(all="ignore")
    def sf(self, x: Any) -> Array:
        return np.asarray(self.frozen.sf(x))

    @functools.cached_property
    def kinks(self) -> Array:
        """Kinks as in `ThresholdLaw`: SciPy does not tell those inside, which are
        sought in the density."""
        few = 10.0 ** np.arange(-9.0, -2.5, 0.25)
        share = np.concatenate((few, np.arange(0.005, 0.5, 0.005)))
        e = np.concatenate((-np.log1p(-share), [math.log(2.0)], -np.log(share[::-1])))
        x = np.unique(self.inverse_survival(e))
        between = x[:-1] + np.multiply.outer(np.arange(3) / 3.0, np.diff(x))
        inside = density_kinks(self.pdf, np.append(np.sort(between.ravel()), x[-1]))
        known = np.union1d(super().kinks, self.support)
        new = np.abs(inside[:, None] - known).min(axis=1) > _SAME * self.scale
        return np.union1d(super().kinks, inside[new])

    @np.errstate(all="ignore")
    def inverse_survival(self, e: Any) -> Array:
        """The quantile function of `ThresholdLaw`. Raises InputError where SciPy's isf
        fails far out in the tail: where it is not finite, or beyond all that the
        density and the survival function know."""
        e = np.asarray(e, float)
        law = self.frozen
        xi = np.where(e < 0.7, law.ppf(-np.expm1(-e)), law.isf(np.exp(-e)))
        nothing = law.pdf(xi) + law.sf(xi) == 0.0
        lost = ~np.isfinite(xi) | ((xi < self.support[1]) & nothing)
        if np.any(lost):
            share = math.exp(-np.min(e[lost]))
            raise InputError(
                f"threshold distribution: isf of SciPy's {self._name} fails at "
                f"{share:.1e}, and must be right down to 1e-222; give another law, or "
                "a sample of this one as a Table"
            )
        return xi


def tail_exponent(law: ThresholdLaw) -> float:
    """Exponent a of the power law J_c ~ x^-a that a law follows where it is 1e-206 to
    1e-217: E[xi^p] is finite for p < a only. Infinite for thresholds that are bounded,
    large (above 15) for named laws but `Pareto`."""
    if law.steps.size or law.support[1] < math.inf:
        return math.inf
    ranks = np.array([RAREST - _TAIL_STEP, RAREST])
    nearer, further = np.log(law.inverse_survival(ranks) / law.scale)
    return float(_TAIL_STEP / (further - nearer)) if further > nearer else math.inf


def diverges(law: ThresholdLaw, power: int) -> bool:
    """True if E[xi^power] is infinite, or so nearly that double precision cannot tell."""
    return power / tail_exponent(law) >= 1.0 - _LEAST_DECAY


def rank_above(law: ThresholdLaw, x: float) -> float:
    """-ln J_c(x) of a smooth law, x in units of the scale; from the quantiles where
    SciPy's survival functions, which may be 1 less the distribution, are rounded to 0.
    """
    share = float(law.sf(x * law.scale))
    if share > _KNOWN_SHARE:
        return -math.log(share)

    def below(e: Array) -> Array:
        return np.asarray(law.inverse_survival(e) < x * law.scale)

    low, high = np.array(-math.log(_KNOWN_SHARE)), np.array(RAREST)
    return float(bisected(below, low, high, 60)[0])


def means_above(
    law: ThresholdLaw, x: float, log_values: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Means E[value(xi); xi > x] of a smooth law and bounds of their errors, shape
    (values,), x and xi in units of the scale; `log_values` gives logarithms of shape
    (values, n) of thresholds (n,). Infinite if one diverges.

    In e = -ln J_c(xi) they are integrals of value exp(-e). Panels reach e = 500, and
    beyond the integrands fall as exp(-e decay), decay = 1 - power/exponent if the value
    is a power of xi and the tail one of x. How the decay changes from e = 450 to 500
    says how far this continuation may be off.
    """
    first = rank_above(law, x)
    with np.errstate(divide="ignore"):  # a breakpoint at an end of the support
        kinks = -np.log(law.sf(law.breakpoints))

    def log_terms(e: Array) -> Array:
        xi = np.asarray(law.inverse_survival(e)) / law.scale
        return np.asarray(log_values(xi) - e)

    end = max(RAREST, first + _PANEL)
    growing = np.exp2(np.arange(math.log2(_FINEST_PANEL), math.log2(_PANEL) + 1.0))
    even = np.arange(first + 2.0 * _PANEL, end, _PANEL)
    edges = np.concatenate((first + growing, even, kinks))
    inside = edges[(edges > first) & (edges < end)]
    edges = np.unique(np.concatenate(([first, end], inside)))
    half = 0.5 * np.diff(edges)
    nodes = edges[:-1, None] + half[:, None] * (1.0 + _TAIL_NODES)
    # a value may vanish at x, or overflow where its mean diverges
    with np.errstate(all="ignore"):
        terms = np.exp(log_terms(nodes.ravel())).reshape(-1, *nodes.shape)
        total = np.asarray(terms @ _TAIL_WEIGHTS @ half)
        error = _ROUNDED * total
        if law.support[1] < math.inf:
            return total, error
        steps = log_terms(end - _TAIL_STEP * np.array([2.0, 1.0, 0.0]))
        before, decay = -np.diff(steps).T / _TAIL_STEP
        rest = np.exp(steps[:, 2]) / decay
        # a decay d(e) changes the rest by its derivative over d^2; logarithms of about
        # 500 are rounded by 1e-13
        change = np.abs(decay - before) / _TAIL_STEP
        error += rest * (change / decay**2 + _ROUNDED / decay)
    negligible, lost = steps[:, 2] == -math.inf, ~(decay > _LEAST_DECAY)
    total = np.where(negligible, total, np.where(lost, math.inf, total + rest))
    error = np.where(lost, math.inf, error)
    return total, np.where(negligible, _ROUNDED * total, error)


# Ranks e above that of x where panels end: narrow ones next to x, then on the scale
# of the law.
RANKS_ABOVE = np.array([
    1e-6, 1e-4, 2e-3, 0.01, 0.05, 0.15, 0.4, 0.8, 1.5,
    2.5, 4.0, 6.0, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0,
])  # fmt: skip
# The same for what grows exponentially with the threshold, about as far apart as
# thresholds of a normal tail.
FAR_RANKS_ABOVE = np.append(RANKS_ABOVE, np.arange(8.0, 22.5) ** 2)
# Where panels end next to an infinite density at an end of the support: distances from
# it over that of the median, or of the panels' own beginning.
_TOWARDS_INFINITE = 0.25 ** np.arange(1.0, 16.0)


def panels_above(
    law: ThresholdLaw,
    x: Array,
    layer: Array | None = None,
    ranks: Array = RANKS_ABOVE,
) -> Array:
    """Edges of panels, shape (n, panels + 1), from x (n,) to where no threshold of a
    smooth law is left: on the scale of the law itself, at `ranks` above that of x, and
    of a boundary layer above x whose edges `layer`, shape (n, any), are merged in.
    Lengths in units of `law.scale`.
    """
    low, high = (edge / law.scale for edge in law.support)
    left = np.maximum(x, low)[:, None]
    # only panels depend on this table
    e = np.exp(np.linspace(-36.0, math.log(min(2.0 * ranks[-1], 700.0)), 400))
    xi = np.asarray(law.inverse_survival(e)) / law.scale
    rank = np.interp(left, xi, e)
    edges = np.minimum(np.maximum(np.interp(rank + ranks, e, xi), left), high)
    inside = [np.broadcast_to(law.kinks / law.scale, (left.size, law.kinks.size))]
    inside += [] if layer is None else [layer]
    with np.errstate(divide="ignore"):
        if math.isfinite(high) and np.isinf(law.pdf(law.support[1])):
            inside.append(high - (high - left) * _TOWARDS_INFINITE)
        if np.isinf(law.pdf(law.support[0])):
            above = (np.interp(math.log(2.0), e, xi) - low) * _TOWARDS_INFINITE
            inside.append(low + above + np.zeros_like(left))
    parts = [np.clip(part, left, edges[:, -1:]) for part in inside]
    edges = np.sort(np.concatenate((edges, *parts), axis=1))
    return np.concatenate((left, edges), axis=1)


class Thresholds(NamedTuple):
    """A law of thresholds for kernels, lengths in units of its scale: a quantile
    `table`, or equally likely `steps`, or if `exponentials` is 1 or 2 xi^2/x_*^2 is the
    sum of so many exponential variables (gamma with n = 0 or 1)."""

    table: Array
    steps: Array
    exponentials: int
    ranks: Array  # edges of the cells of `table` if these are not those of octaves


# It takes 2 ms, of SciPy's laws up to seconds; 32 tables of 130 kB are 4 MB.
@functools.lru_cache(maxsize=32)
def for_kernels(law: ThresholdLaw) -> Thresholds:
    """The law for kernels, cached: sweeps over velocity and temperature share it."""
    exponentials = 0
    if isinstance(law, Gamma) and law.n in (0.0, 1.0):
        exponentials = int(law.n) + 1
    return Thresholds(law.table(), law.steps / law.scale, exponentials, law.ranks)


@routine(inline=True)
def exponential_threshold(p: float) -> float:
    """xi/x_* of a gamma law with n = 0 or 1 from the product of n + 1 uniforms, without
    a table: -ln p is the sum of as many exponential variables."""
    return math.sqrt(-log(p))


@routine(inline=True)
def threshold_draw(law: Thresholds, u: float) -> float:
    """A threshold from a uniform u in (0, 1), the fraction of contacts that exceed it."""
    if law.steps.size > 0:
        return law.steps[law.steps.size - 1 - np.int64(u * law.steps.size)]
    return threshold_at(law, -log(u))


@routine(inline=True)
def threshold_at(law: Thresholds, e: float) -> float:
    """The threshold of a smooth law that a fraction exp(-e) of contacts exceeds."""
    if law.ranks.size > 0:
        return look_up_ranked(law.ranks, law.table, e)
    return look_up(law.table, e)
