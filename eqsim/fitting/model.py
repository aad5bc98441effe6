"""Predictions of the reference at measured points, and their distance from the
measurements.

Free keys are changed in the variables of `Parameter`, in which bounds are a box. What
is measured is linear in the scales of force (and in offset and drift of a record):
given the other parameters, their best values are a linear least-squares problem, so
they cost no solves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.estimate import known
from eqsim.fitting.data import MeasuredAt
from eqsim.fitting.section import Parameter
from eqsim.io.parameters import keys
from eqsim.io.runfile import RunFile, at
from eqsim.master.peak import first_peak
from eqsim.master.steady import curve
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# Step of derivatives with respect to logarithms.
DERIVATIVE_STEP = 1e-4
# Least size of a linear variable, over the distance of its bounds, for such a step.
_LEAST_SIZE = 1e-3
# Relative changes of chi-square, parameters and gradient at which a search ends.
TOLERANCE = 1e-8
# Degrees of freedom of the robust loss.
STUDENT = 4.0
# Residual where the reference refuses, above any of a prediction.
REFUSED = 1e9
# Contacts of which the shares of populations are not rounded.
MANY = 10**12
# Observables of `Curve`.
AVERAGES = ("friction", "pinned", "break_stretch")


def velocity_of(row: MeasuredAt) -> float | None:
    """The velocity of a row of a table; None if it leaves that to the run file."""
    return dict(row.changes).get("drive.velocity")


def unrounded(file: RunFile) -> Ensemble:
    """The contacts of a run file. Shares of populations are as given, not those of a
    whole number of contacts."""
    ensemble = file.ensemble
    return replace(ensemble, count=MANY) if ensemble.populations else ensemble


class Forward(Protocol):
    """Source of predictions."""

    @property
    def scaled(self) -> bool:
        """True if they depend on the scale of force."""

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """Values and errors at unit scale, (measurements,). Raises InputError."""


@dataclass(frozen=True)
class SteadyForward:
    """Steady observables, one for each row of a table; all velocities of an ensemble
    are solved at once."""

    file: RunFile
    rows: Sequence[MeasuredAt]
    observable: Sequence[str]
    # True if N is unknown, as the scale of force N k is free.
    free_scale: bool = False
    scaled: bool = False

    @cached_property
    def groups(self) -> dict[Any, list[int]]:
        """Measurements by the changes (without velocity) and heat that they share."""
        members: dict[Any, list[int]] = {}
        for index, row in enumerate(self.rows):
            rest = tuple(pair for pair in row.changes if pair[0] != "drive.velocity")
            members.setdefault((rest, row.heat), []).append(index)
        return members

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`. At unit scale the standard deviation of the force is that of
        one contact over k, or if the scale N k is free, over the root of k."""
        predicted = np.empty((len(self.rows), 2))
        for (rest, heat), members in self.groups.items():
            file = at(self.file, {**changes, **dict(rest)})
            if heat != 1.0:
                kT = [key for key in keys(file) if key.endswith("thermal.kT")]
                file = at(file, {key: file[key] * heat for key in kT})
            given = [velocity_of(self.rows[index]) for index in members]
            v = [file["drive.velocity"] if one is None else one for one in given]
            if None in v:
                raise InputError("drive.velocity: is required, in the file or the data")
            names = [self.observable[index] for index in members]
            ensemble = unrounded(file)
            if not set(AVERAGES).isdisjoint(names):
                steady = curve(ensemble, np.array(v))
            for i, (index, name) in enumerate(zip(members, names, strict=True)):
                if name in AVERAGES:
                    pair = getattr(steady, name), getattr(steady, f"{name}_error")
                    predicted[index] = pair[0][i], pair[1][i]
                else:
                    predicted[index] = other_observable(ensemble, v[i], name)
                if name == "force_std" and self.free_scale:
                    predicted[index] *= math.sqrt(ensemble.mean_stiffness)
        value, error = predicted.T
        return value, error


def other_observable(
    ensemble: Ensemble, velocity: float, name: str
) -> tuple[float, float]:
    """The value and error of an observable that is no average: the standard deviation
    of a contact's force over k, or the static peak of `master.peak`, where it is and
    how far above the steady force. Raises InputError where there is none."""
    if name == "force_std":
        drive = Drive(velocity, start="stationary")
        still = transient(ensemble, drive, 2, variance=True)
        if still.force_variance is None or still.force_variance_error is None:
            raise InputError("force_std: no steady variance, contacts stay in step")
        sd = math.sqrt(still.force_variance[0])
        return sd, float(still.force_variance_error[0]) / (2.0 * sd)
    peak = first_peak(ensemble, velocity)
    if name == "peak_X":
        return known(peak.X), peak.X.stderr or 0.0
    steady, height = curve(ensemble, np.array([velocity])), known(peak.force)
    level, level_error = steady.friction[0], steady.friction_error[0]
    ratio = float(height / level)
    return ratio, ratio * ((peak.force.stderr or 0.0) / height + level_error / level)


class Solved(NamedTuple):
    """Parameters with the linear ones at their best, predictions and their errors."""

    u: Array
    predicted: Array
    error: Array


@dataclass(frozen=True)
class Problem:
    """A fit: measurements with their errors, the source of predictions, and the free
    parameters. Arrays have the shape (measurements,)."""

    forward: Forward
    parameters: list[Parameter]
    value: Array
    sigma: Array
    # Index of the parameter that is the scale of a measured force, or -1.
    scale_of: Array
    # Fixed factor of predictions.
    unit: Array
    # True of standard deviations of the force, which go as the root of a free scale.
    spread: Array
    # Functions added to predictions, by the key of their linear factor.
    nuisance: dict[str, Array] = field(default_factory=dict)
    loss: str = "gaussian"
    # Correlation of the errors of neighbours, (measurements - 1,), which form a Markov
    # chain; None if they are independent.
    correlation: Array | None = None
    # Step of derivatives with respect to logarithms, and whether those of a search
    # are central: one-sided ones lead it astray in long valleys of a model that is far
    # from the data.
    step: float = DERIVATIVE_STEP
    central: bool = False
    # Relative changes of chi-square, parameters and gradient at which a search ends.
    tolerance: float = TOLERANCE

    @cached_property
    def keys(self) -> list[str]:
        return [one.key for one in self.parameters]

    @cached_property
    def linear(self) -> Array:
        """True of parameters that are found by linear least squares."""
        roots = np.any(self.spread & (self.scale_of >= 0))
        if roots or self.loss != "gaussian":
            return np.zeros(len(self.parameters), bool)
        return np.array([self._exact(p) and not p.prior for p in self.parameters])

    def _exact(self, one: Parameter) -> bool:
        """True if derivatives with respect to a parameter take no further solve."""
        return one.linear and (one.key in self.nuisance or not self.forward.scaled)

    @cached_property
    def low(self) -> Array:
        return np.array([one.low for one in self.parameters])

    @cached_property
    def high(self) -> Array:
        return np.array([one.high for one in self.parameters])

    @cached_property
    def start(self) -> Array:
        return np.array([one.start for one in self.parameters])

    def values(self, u: Array) -> dict[str, float]:
        pairs = zip(self.parameters, u, strict=True)
        return {one.key: float(one.value(x)) for one, x in pairs}

    def changes(self, u: Array) -> dict[str, float]:
        """Values of run-file keys, and of the scale if predictions depend on it."""
        return {
            key: value
            for key, value in self.values(u).items()
            if not key.startswith("fit.")
            or (key == "fit.scale" and self.forward.scaled)
        }

    def _factor(self, values: dict[str, float]) -> Array:
        """The factor of predictions at unit scale. A free scale is N k: the standard
        deviation of the force goes as its root."""
        factor, free = self.unit.copy(), self.scale_of >= 0
        if free.any():
            scale = np.array([values[key] for key in self.keys])[self.scale_of[free]]
            factor[free] *= np.where(self.spread[free], np.sqrt(scale), scale)
        return factor

    def _combined(self, raw: Array, values: dict[str, float]) -> Array:
        """Predictions, from those at unit scale."""
        added = [values[key] * base for key, base in self.nuisance.items()]
        return np.asarray(self._factor(values) * raw + sum(added))

    def given(self, u: Array) -> Array:
        """Predictions with every parameter as given. Raises InputError."""
        return self._combined(self.forward.predict(self.changes(u))[0], self.values(u))

    def solved(self, u: Array, held: int = -1) -> Solved:
        """Solve for the linear parameters, except that of index `held`. Raises
        InputError."""
        raw, error = self.forward.predict(self.changes(u))
        u, values = u.copy(), self.values(u)
        unknown = [i for i in np.flatnonzero(self.linear).tolist() if i != held]
        if unknown:
            chosen = [self.parameters[i] for i in unknown]
            rest = self._combined(raw, values | {one.key: 0.0 for one in chosen})
            columns = [
                self.nuisance.get(one.key, np.where(self.scale_of == i, raw, 0.0))
                for i, one in zip(unknown, chosen, strict=True)
            ]
            best = optimize.lsq_linear(
                self.white(np.array(columns).T / self.sigma[:, None]),
                self.white((self.value - rest) / self.sigma),
                np.array(
                    [one.value(np.array([one.low, one.high])) for one in chosen]
                ).T,
                method="bvls",
            )
            for i, one, x in zip(unknown, chosen, best.x, strict=True):
                values[one.key] = float(x)
                u[i] = min(max(one.variable(float(x)), one.low), one.high)
        return Solved(u, self._combined(raw, values), error * self._factor(values))

    def deviations(self, u: Array, held: int = -1) -> tuple[Array, Array]:
        """Parameters with the linear ones at their best, except that of index `held`, and
        their residuals: numbers whose sum of squares is -2 ln L plus a constant, priors
        included; large where the reference refuses."""
        try:
            u, predicted, _ = self.solved(u, held)
        except InputError:
            return u, np.full(self.value.size + self.priors, REFUSED)
        return u, self._deviates(u, predicted)

    def whitened(self, predicted: Array) -> Array:
        """Independent residuals of predictions, in standard errors."""
        return self.white((self.value - predicted) / self.sigma)

    def _deviates(self, u: Array, predicted: Array) -> Array:
        r = self.whitened(predicted)
        if self.loss == "student":  # normal deviates of the same likelihood
            r = np.sign(r) * np.sqrt((STUDENT + 1.0) * np.log1p(r**2 / STUDENT))
        pairs = zip(self.parameters, u, strict=True)
        priors = [(p.prior.mean - x) / p.prior.sd for p, x in pairs if p.prior]
        return np.concatenate((r, priors))

    def white(self, r: Array) -> Array:
        """Residuals in standard errors, (measurements, ...), as independent ones."""
        if self.correlation is None:
            return r
        rho = self.correlation.reshape(-1, *[1] * (r.ndim - 1))
        return np.concatenate((r[:1], (r[1:] - rho * r[:-1]) / np.sqrt(1.0 - rho**2)))

    @cached_property
    def priors(self) -> int:
        return sum(one.prior is not None for one in self.parameters)

    def jacobian(self, u: Array) -> Array:
        """A root J of the Fisher information J'J, shape (measurements + priors,
        parameters): derivatives of the predictions over their standard errors (and of
        priors) with respect to all parameters, the linear ones too, by central
        differences. Raises InputError."""
        raw, steps = self.forward.predict(self.changes(u))[0], self.steps(u)
        columns, priors = [], []
        for i, one in enumerate(self.parameters):
            unit = np.arange(u.size) == i
            down, up = u - steps * unit, u + steps * unit
            if self._exact(one):
                low, high = (self._combined(raw, self.values(x)) for x in (down, up))
                change = (high - low) / (2.0 * steps[i])
            else:
                down = np.maximum(down, np.minimum(u, self.low))
                up = np.minimum(up, np.maximum(u, self.high))
                change = (self.given(up) - self.given(down)) / (up[i] - down[i])
            columns.append(change / self.sigma)
            if one.prior:
                priors.append(unit / one.prior.sd)
        rows = self.white(np.array(columns).T)
        if self.loss == "student":  # a measurement tells less than with a normal law
            rows *= math.sqrt((STUDENT + 1.0) / (STUDENT + 3.0))
        return np.vstack((rows, *priors))

    def density(self, u: Array) -> float:
        """Logarithm of the posterior density of the parameters' variables, up to a
        constant: prior, flat where the run file has none, times likelihood; -inf beyond
        the bounds and where the reference refuses."""
        if np.any((u < self.low) | (u > self.high)):
            return -math.inf
        try:
            r = self._deviates(u, self.given(u))
        except InputError:
            return -math.inf
        return -0.5 * float(r @ r)

    @cached_property
    def unit_of_variables(self) -> Array:
        """Natural units of the parameters' variables: 1 of a logarithm, the distance of
        the bounds of a linear one, and the smaller of both of ln(1 + x)."""
        units = []
        for one in self.parameters:
            width = one.high - one.low
            kinds = {"log": 1.0, "log1p": min(width, 1.0), "linear": width}
            units.append(kinds[one.transform])
        return np.array(units)

    @property
    def factors(self) -> dict[str, str]:
        """Names of what the parameters' variables in their natural units are the
        logarithms of, by key."""
        names = {}
        for one, unit in zip(self.parameters, self.unit_of_variables, strict=True):
            names[one.key] = one.key
            if one.transform == "log1p":
                power = "" if unit == 1.0 else f"^{1.0 / unit:.3g}"
                names[one.key] = f"(1 + {one.key}){power}"
            elif one.transform == "linear":
                names[one.key] = f"exp({one.key}/{unit:.3g})"
        return names

    def steps(self, u: Array) -> Array:
        """Steps of derivatives with respect to each variable: those of a linear one are
        relative, as those of a logarithm are."""
        unit = self.unit_of_variables
        relative = np.maximum(np.abs(u), _LEAST_SIZE * unit)
        straight = [one.transform == "linear" for one in self.parameters]
        return self.step * np.where(straight, relative, unit)

    def unitless(self, jacobian: Array) -> Array:
        """Derivatives with respect to variables in their natural units."""
        return jacobian * self.unit_of_variables

    def elsewhere(self, index: int, rows: Sequence[MeasuredAt]) -> "Problem":
        """The problem of measurements like the one with an index, made at other `rows`;
        values and errors are 1."""
        forward, same = self.forward, np.full(len(rows), index)
        assert isinstance(forward, SteadyForward)
        names = [forward.observable[index]] * len(rows)
        return replace(
            self,
            forward=replace(forward, rows=rows, observable=names),
            value=np.ones(len(rows)),
            sigma=np.ones(len(rows)),
            scale_of=self.scale_of[same],
            unit=self.unit[same],
            spread=self.spread[same],
        )
