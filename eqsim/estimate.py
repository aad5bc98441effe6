"""Numbers with error bars, and their distances from exact values in standard errors."""

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from scipy import special

from eqsim import catalogue
from eqsim.numerics.tables import Array
from eqsim.results import Result, new_axes

# Student probability below which its logarithm is taken: numbers end at 1e-308.
_LEAST_TAIL = 1e-300


@dataclass(frozen=True, repr=False)
class Estimate:
    """A value and its standard error.

    Attributes
    ----------
    value, stderr : float or None
        None where the sample does not determine it; a value is infinite where the law
        of the contacts has no finite mean.
    n : int
        Lives (or other samples) behind it.
    dof : int or None
        Degrees of freedom of Student's law that (value - truth)/stderr follows, the
        number of independent batches less one from which the error was found; None: the
        normal law.
    reliable : bool
        False where the error bar cannot be trusted.

    Examples
    --------
    >>> print(Estimate(0.9769691, 3.47e-05, n=65536))
    0.976969(35)
    """

    value: float | None
    stderr: float | None
    n: int
    dof: int | None = None
    reliable: bool = True

    @property
    def diverges(self) -> bool:
        """True if the mean is known to be infinite."""
        return self.value is not None and math.isinf(self.value)

    def as_dict(self) -> dict[str, Any]:
        """Fields by name for JSON, which has no infinite numbers: they become None."""
        return {**asdict(self), "value": None if self.diverges else self.value}

    def __str__(self) -> str:
        """Value(error in the last two digits), as physicists write it."""
        if self.value is None:
            return "none seen"
        if self.diverges:
            return "infinite"
        mark = "" if self.reliable else "  unreliable"
        if not self.stderr or not math.isfinite(self.value * self.stderr):
            return f"{self.value:.8g}{mark}"
        exponent = math.floor(math.log10(max(abs(self.value), self.stderr)))
        exponent = 0 if -4 < exponent < 6 or not self.value else exponent
        scale = 10.0**exponent
        digits = max(0, 1 - math.floor(math.log10(float(f"{self.stderr / scale:.1e}"))))
        last = round(self.stderr / scale * 10**digits)
        power = f"e{exponent:+03d}" if exponent else ""
        return f"{self.value / scale:.{digits}f}({last}){power}{mark}"

    def __repr__(self) -> str:
        return f"Estimate({self})"


def mean_of(values: Array, n: int, dof: int | None = None) -> Estimate:
    """Mean of independent values of `n` samples, its error from their scatter."""
    error = float(np.std(values, ddof=1)) / math.sqrt(values.size)
    return Estimate(float(values.mean()), error, n, dof)


def infinite(n: int = 0) -> Estimate:
    """The estimate of a mean that diverges."""
    return Estimate(math.inf, None, n, None, False)


def known(estimate: Estimate) -> float:
    """The value of an estimate. Raises ValueError if it has none."""
    if estimate.value is None:
        raise ValueError("this estimate has no value")
    return estimate.value


@dataclass(frozen=True, repr=False)
class Averages(Result):
    """Steady averages of an ensemble, the observables. Their meaning and units are in
    `eqsim.catalogue`."""

    friction: Estimate
    pinned: Estimate
    break_stretch: Estimate
    travel: Estimate
    birth_stretch: Estimate
    force_variance: Estimate

    def averages(self) -> dict[str, Estimate]:
        """The estimates by name."""
        return {name: getattr(self, name) for name in OBSERVABLES}

    def estimates(self, *, brief: bool = False) -> dict[str, Any]:
        """All estimates by name, also those that are no observables; if `brief`, without
        observables that are not `shown`."""
        hidden = OBSERVABLES.keys() - set(self.shown) if brief else set()
        every = super().estimates()
        return {name: each for name, each in every.items() if name not in hidden}

    def plot(
        self, axes: Any = None, *, reference: "Averages | None" = None, **style: Any
    ) -> Any:
        """Draw the averages as points with error bars of two standard errors, each
        beside its name and value.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            Axes to draw on; by default those of a new figure.
        reference : Averages, optional
            Draw differences from this, in their standard errors, on a band of two;
            without averages that have no error in both.
        **style
            Passed to `Axes.errorbar`: label, color, ...
        """
        marks, values, errors = [], [], []
        for name in self.shown:
            ours, exact = getattr(self, name), getattr(reference, name, None)
            if ours.value is None or ours.diverges:
                continue
            mark, value, error = f"{ours}", ours.value, 2.0 * (ours.stderr or 0.0)
            if exact is not None:
                value, error = score(ours, exact), 0.0
                if value is None:
                    continue
                mark += f"\nreference {exact.value:.8g}"
            marks.append(f"{name.replace('_', ' ')}\n{mark}")
            values.append(value)
            errors.append(error)
        if axes is None:
            axes = new_axes(figsize=(6.4, 0.9 + 0.75 * len(marks)))
            axes.set_yticks(range(len(marks)), marks)
            axes.set_ylim(max(len(marks), 1) - 0.5, -0.5)
            axes.set_xlabel("value")
            if reference is not None:
                axes.set_xlabel("difference from the reference  [standard errors]")
                axes.axvspan(-2.0, 2.0, color="0.92", zorder=0)
                limit = max([4.0, *(1.1 * abs(z) for z in values)])
                axes.set_xlim(-limit, limit)
        style = {"fmt": "o", "capsize": 3, **style}
        axes.errorbar(values, range(len(marks)), xerr=errors, **style)
        if "label" in style:
            axes.legend()
        return axes

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of the observables that a table shows: no variance that was not computed,
        and neither travel nor stretch at birth if contacts are born unstretched."""
        hidden = {"force_variance"} if self.force_variance.value is None else set()
        if not (self.birth_stretch.value or self.birth_stretch.stderr):
            hidden |= {"travel", "birth_stretch"}
        return tuple(name for name in OBSERVABLES if name not in hidden)


OBSERVABLES = {one.name: catalogue.COLUMNS[one.name] for one in fields(Averages)}


def ratio(numerator: Array, denominator: Array, n: int) -> Estimate:
    """sum(numerator)/sum(denominator) over independent batches, shape (batches,), by
    the delta method."""
    total = float(np.sum(denominator))
    if total == 0.0:
        return Estimate(None, None, n, None, False)
    value = float(np.sum(numerator)) / total
    batches = len(numerator)
    if batches < 2:
        return Estimate(value, None, n, None, False)
    residual = numerator - value * denominator
    square = float(np.sum((residual - residual.mean()) ** 2))
    variance = batches / (batches - 1) * square
    return Estimate(value, math.sqrt(variance) / abs(total), n, batches - 1)


def drifts(numerator: Array, denominator: Array, sigmas: float) -> bool:
    """True if two halves of a record, arrays (batches, 2), have ratios that differ by
    more than `sigmas` errors."""
    total = denominator.sum(axis=0)
    if np.any(total == 0):
        return True
    ratios = numerator.sum(axis=0) / total
    residual = np.diff((numerator - ratios * denominator) / total, axis=1)
    error = math.sqrt(len(residual) * np.var(residual, ddof=1))
    return bool(abs(ratios[1] - ratios[0]) > sigmas * error)


def difference(first: Estimate, second: Estimate) -> float | None:
    """first - second in units of their joint standard error; None if that is 0 or
    unknown."""
    if first.value is None or second.value is None:
        return None
    if first.stderr is None or second.stderr is None:  # an infinite value has none
        return None
    sigma = math.hypot(first.stderr, second.stderr)
    return (first.value - second.value) / sigma if sigma else None


def z_score(
    estimate: Estimate, reference: float, reference_error: float = 0.0
) -> float | None:
    """Find how far an estimate is from a reference: the standard-normal score of their
    difference, both errors in quadrature; None if both errors are 0.

    Parameters
    ----------
    estimate : Estimate
        With `dof` its Student probability is turned into the normal score of the same
        probability.
    reference, reference_error : float
        An exact value and the error of its solver.

    Examples
    --------
    >>> print(f"{z_score(Estimate(0.97, 0.01, n=1000), 1.0):.2f}")
    -3.00
    """
    if math.isinf(reference):
        return None
    return score(estimate, Estimate(reference, reference_error, 0))


def score(first: Estimate, second: Estimate) -> float | None:
    """Find the `z_score` of the difference of two estimates, either of which may have
    an error from few batches; None if both errors are 0, or one is unknown."""
    z, dof = difference(first, second), _joint_dof(first, second)
    if z is None or dof is None:
        return z
    tail = float(special.stdtr(dof, -abs(z)))
    if tail < _LEAST_TAIL:
        return math.copysign(float(-special.ndtri_exp(_log_tail(abs(z), dof))), z)
    return math.copysign(float(-special.ndtri(tail)), z)


def _log_tail(t: float, dof: float) -> float:
    """ln P(T > t) of Student's law far out, without the factor 2F1(1/2, 1; dof/2 + 1;
    -dof/t^2), which lies between 1 - 1/t^2 and 1 (derived). A normal score z is off by
    less than 1/(z t^2) for it: 2e-5 where P underflows, as t > z > 37 there."""
    near = dof * math.log(math.hypot(1.0, t / math.sqrt(dof)))
    beyond = 0.5 * math.log1p(dof / t / t) - math.log(dof)
    return beyond - near - float(special.betaln(0.5 * dof, 0.5))


def _joint_dof(first: Estimate, second: Estimate) -> float | None:
    """Degrees of freedom of the error of a difference: those of the one error that has
    some, or by Welch and Satterthwaite of both."""
    if first.dof is None or second.dof is None:
        return second.dof if first.dof is None else first.dof
    a, b = first.stderr or 0.0, second.stderr or 0.0
    if not (sigma := math.hypot(a, b)):
        return None
    return 1.0 / ((a / sigma) ** 4 / first.dof + (b / sigma) ** 4 / second.dof)
