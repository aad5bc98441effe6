"""What a fit compares: predictions of the reference at measured points, and their
distance from the measurements.

Free keys are changed in the variables of `Parameter`, in which bounds are a box. What
is measured is linear in the scales of force (and in offset and drift of a record):
given the other parameters, their best values are a linear least-squares problem, so
they cost no solves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.estimate import known
from eqsim.fitting.data import Row, Table
from eqsim.fitting.section import Fit, Parameter, variable
from eqsim.io.runfile import RunFile, at
from eqsim.master.peak import first_peak
from eqsim.master.transient import transient
from eqsim.master.velocities import curve
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

STEP = 1e-4  # of derivatives, in the variables of parameters
STUDENT = 4.0  # degrees of freedom of the robust loss
REFUSED = 1e4  # residual where the reference refuses
AVERAGES = ("friction", "pinned", "break_stretch")  # of `Curve`


class Forward(Protocol):
    """Where predictions come from."""

    @property
    def scaled(self) -> bool:
        """Whether they depend on the scale of force."""

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """Values and errors at unit scale, arrays (measurements,). Raises InputError."""


@dataclass(frozen=True)
class SteadyForward:
    """Steady observables at the rows of a table, all velocities of an ensemble at once."""

    file: RunFile
    rows: Sequence[Row]
    row: Array
    observable: Sequence[str]
    scaled: bool = False

    @cached_property
    def groups(self) -> list[tuple[dict[str, float], float, Array]]:
        """Changes but for the velocity, heat, and which measurements these belong to."""
        found: dict[Any, list[int]] = {}
        for index, row in enumerate(self.row):
            of = self.rows[row]
            rest = tuple(
                change for change in of.changes if change[0] != "drive.velocity"
            )
            found.setdefault((rest, of.heat), []).append(index)
        return [
            (dict(rest), heat, np.array(indices))
            for (rest, heat), indices in found.items()
        ]

    def velocity(self, index: int, file: RunFile) -> float:
        """Of a measurement. Raises InputError."""
        v = dict(self.rows[self.row[index]].changes).get(
            "drive.velocity", file["drive.velocity"]
        )
        if v is None:
            raise InputError(
                "drive.velocity: is required, in the run file or as a column of the data"
            )
        return v

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`. The standard deviation of the force is that of one contact
        over k, at unit scale."""
        value, error = np.empty(self.row.size), np.empty(self.row.size)
        for rest, heat, members in self.groups:
            file = at(self.file, {**changes, **rest})
            if heat != 1.0:
                file = at(file, {"thermal.kT": file["thermal.kT"] * heat})
            ensemble = file.ensemble
            v = np.array([self.velocity(index, file) for index in members])
            names = [self.observable[index] for index in members]
            here = np.array([name in AVERAGES for name in names])
            if here.any():
                known = curve(ensemble, v)
                for name in AVERAGES:
                    mine = np.array([one == name for one in names])
                    value[members[mine]] = getattr(known, name)[mine]
                    error[members[mine]] = getattr(known, f"{name}_error")[mine]
            for i in np.flatnonzero(~here):
                value[members[i]], error[members[i]] = _other(
                    ensemble, float(v[i]), names[i]
                )
        return value, error


def _other(ensemble: Ensemble, velocity: float, name: str) -> tuple[float, float]:
    """An observable that is no average: the standard deviation of a contact's force
    over k, or the static peak of `master.peak`, where it is and how far above the
    steady force. Raises InputError where there is none."""
    if name == "force_std":
        still = transient(
            ensemble, Drive(velocity, start="stationary"), 2, variance=True
        )
        if still.force_variance is None or still.force_variance_error is None:
            raise InputError(
                "force_std: contacts stay in step, so that the force has no steady variance"
            )
        sd = math.sqrt(still.force_variance[0])
        return sd, float(still.force_variance_error[0]) / (2.0 * sd)
    peak = first_peak(ensemble, velocity)
    if name == "peak_X":
        return known(peak.X), peak.X.stderr or 0.0
    steady, height = curve(ensemble, np.array([velocity])), known(peak.force)
    relative = (peak.force.stderr or 0.0) / height + steady.friction_error[
        0
    ] / steady.friction[0]
    return float(height / steady.friction[0]), float(
        height / steady.friction[0] * relative
    )


@dataclass(frozen=True)
class Problem:
    """A fit: measurements, what predicts them, and what is free.

    Attributes
    ----------
    forward : Forward
    parameters : list of Parameter
        Free keys first, then what the measurements are linear in.
    value, sigma : ndarray, shape (measurements,)
    scale_of : ndarray of int, shape (measurements,)
        Which scale (in the order of their parameters) multiplies a prediction; -1 where
        none does.
    fixed_scale : float
        Where no scale is free.
    spread : ndarray of bool, shape (measurements,)
        Standard deviations of the force, which go as the root of the scale.
    count : float or None
        Of contacts, for these; None if it is what the scale and the stiffness imply.
    nuisance : dict
        What else predictions are linear in: values at unit parameter by key.
    loss : str
        "gaussian" or "student".
    correlation : ndarray or None, shape (measurements - 1,)
        Of the errors of neighbours, which form a Markov chain; None if they are
        independent.
    step : float
        Of derivatives, in the variables of parameters.
    central : bool
        Whether a search takes them to both sides: one-sided ones lead it astray in long
        valleys of a model that is far from the data.
    """

    forward: Forward
    parameters: list[Parameter]
    value: Array
    sigma: Array
    scale_of: Array
    fixed_scale: float
    spread: Array
    count: float | None
    stiffness: float
    nuisance: dict[str, Array] = field(default_factory=dict)
    loss: str = "gaussian"
    correlation: Array | None = None
    step: float = STEP
    central: bool = False

    @cached_property
    def linear(self) -> Array:
        """Which parameters are found by linear least squares."""
        easy = self.loss == "gaussian" and not (
            self.spread.any() and self.count is None
        )
        return np.array(
            [self._exact(one) and easy and one.prior is None for one in self.parameters]
        )

    def _exact(self, one: Parameter) -> bool:
        """Whether predictions are linear in a parameter."""
        return one.linear and (one.key in self.nuisance or not self.forward.scaled)

    @cached_property
    def low(self) -> Array:
        """Lower bounds."""
        return np.array([one.low for one in self.parameters])

    @cached_property
    def high(self) -> Array:
        """Upper bounds."""
        return np.array([one.high for one in self.parameters])

    @cached_property
    def start(self) -> Array:
        """The run file's values."""
        return np.array([one.start for one in self.parameters])

    def changes(self, u: Array) -> dict[str, float]:
        """Values of run-file keys."""
        return {
            one.key: float(one.value(x))
            for one, x in zip(self.parameters, u, strict=True)
            if not one.key.startswith("fit.")
            or (self.forward.scaled and one.key == "fit.scale")
        }

    def parts(self, u: Array) -> tuple[list[Array], Array, Array]:
        """What each linear parameter (in order, of all that are free) multiplies, what
        none does, and the errors of predictions at unit scale. Raises InputError."""
        changes = self.changes(u)
        value, error = self.forward.predict(changes)
        bases, rest = [], np.zeros(value.size)
        scales = [
            one
            for one in self.parameters
            if one.linear and one.key not in self.nuisance
        ]
        for index, _ in enumerate(scales):
            bases.append(np.where((self.scale_of == index) & ~self.spread, value, 0.0))
        for one in self.parameters:
            if one.key in self.nuisance:
                bases.append(self.nuisance[one.key])
        free = (self.scale_of >= 0) & bool(scales)
        rest = np.where(free & ~self.spread, 0.0, value)
        rest = np.where((self.scale_of >= 0) & ~free, self.fixed_scale * rest, rest)
        if self.spread.any():
            factor: Any = self.fixed_scale / math.sqrt(self.count or 1.0)
            if scales:
                values = np.array(
                    [
                        one.value(x)
                        for one, x in zip(self.parameters, u, strict=True)
                        if one in scales
                    ]
                )
                s = values[np.maximum(self.scale_of, 0)]
                k = changes.get("contacts.stiffness", self.stiffness)
                factor = s / np.sqrt(self.count if self.count else s / k)
            rest = np.where(self.spread, factor * value, rest)
        return bases, rest, error

    def solved(self, u: Array, held: int = -1) -> tuple[Array, Array, Array]:
        """Parameters with the linear ones at their best (but that of index `held`),
        predictions and their errors."""
        bases, rest, error = self.parts(u)
        which = [i for i, one in enumerate(self.parameters) if one.linear]
        open_ = [i for i in which if self.linear[i] and i != held]
        u = u.copy()
        coefficients = {i: float(self.parameters[i].value(u[i])) for i in which}
        if open_:
            columns = self.white(
                np.array([bases[which.index(i)] for i in open_]).T / self.sigma[:, None]
            )
            known = rest + sum(
                bases[which.index(i)] * c
                for i, c in coefficients.items()
                if i not in open_
            )
            low = [float(self.parameters[i].value(self.low[i])) for i in open_]
            high = [float(self.parameters[i].value(self.high[i])) for i in open_]
            best = _least(
                columns,
                self.white((self.value - known) / self.sigma),
                np.array(low),
                np.array(high),
            )
            for i, c in zip(open_, best, strict=True):
                coefficients[i] = float(c)
                one = self.parameters[i]
                u[i] = min(max(variable(one.transform, float(c)), one.low), one.high)
        total = rest + sum(bases[which.index(i)] * c for i, c in coefficients.items())
        factor = np.ones(error.size)
        for index, i in enumerate(
            [i for i in which if self.parameters[i].key not in self.nuisance]
        ):
            factor[self.scale_of == index] = coefficients[i]
        if not np.any(
            [one.linear and one.key not in self.nuisance for one in self.parameters]
        ):
            factor[self.scale_of >= 0] = self.fixed_scale
        return u, np.asarray(total), error * factor

    def residuals(self, u: Array, held: int = -1) -> Array:
        """Of which the sum of squares is -2 ln L but for a constant, priors included;
        large where the reference refuses."""
        try:
            u, total, _ = self.solved(u, held)
        except InputError:
            return np.full(self.value.size + self.priors, REFUSED)
        return np.concatenate(
            (
                self.deviate(self.white((self.value - total) / self.sigma)),
                self._prior(u),
            )
        )

    def white(self, r: Array) -> Array:
        """Residuals in standard errors, shape (measurements, ...), as independent ones."""
        if self.correlation is None:
            return r
        rho = self.correlation.reshape(-1, *[1] * (r.ndim - 1))
        return np.concatenate((r[:1], (r[1:] - rho * r[:-1]) / np.sqrt(1.0 - rho**2)))

    def deviate(self, r: Array) -> Array:
        """Residuals in standard errors as those of a Gaussian with the same likelihood."""
        if self.loss == "gaussian":
            return r
        return np.asarray(
            np.sign(r) * np.sqrt((STUDENT + 1.0) * np.log1p(r**2 / STUDENT))
        )

    @cached_property
    def priors(self) -> int:
        """How many parameters have one."""
        return sum(one.prior is not None for one in self.parameters)

    def _prior(self, u: Array) -> Array:
        known = [
            (x - one.prior.mean) / one.prior.sd
            for x, one in zip(u, self.parameters, strict=True)
            if one.prior
        ]
        return np.array(known)

    def jacobian(self, u: Array) -> Array:
        """Of the predictions over their standard errors (and of priors) with respect to
        all parameters, the linear ones too, by central differences, shape (measurements
        + priors, parameters). Raises InputError."""
        columns = []
        for i, one in enumerate(self.parameters):
            up, down = (
                u + sign * self.step * (np.arange(u.size) == i) for sign in (1.0, -1.0)
            )
            if self._exact(one):
                bases, _, _ = self.parts(u)
                which = [j for j, other in enumerate(self.parameters) if other.linear]
                slope = float(one.value(up[i]) - one.value(down[i])) / (2.0 * self.step)
                column = bases[which.index(i)] * slope
                if self.spread.any():
                    column = column + (self.parts(up)[1] - self.parts(down)[1]) / (
                        2.0 * self.step
                    )
            else:
                ends = [
                    min(max(x, self.low[i]), self.high[i]) for x in (down[i], up[i])
                ]
                at_ends = [
                    self.given(np.where(np.arange(u.size) == i, x, u)) for x in ends
                ]
                column = (at_ends[1] - at_ends[0]) / (ends[1] - ends[0])
            columns.append(column / self.sigma)
        matrix = self.white(np.array(columns).T)
        extra = [
            np.eye(u.size)[i] / one.prior.sd
            for i, one in enumerate(self.parameters)
            if one.prior
        ]
        return np.vstack((matrix, *extra)) if extra else matrix

    def given(self, u: Array) -> Array:
        """Predictions with every parameter as given."""
        bases, rest, _ = self.parts(u)
        linear = [
            (one, x) for one, x in zip(self.parameters, u, strict=True) if one.linear
        ]
        return rest + sum(
            base * float(one.value(x))
            for base, (one, x) in zip(bases, linear, strict=True)
        )

    def density(self, u: Array) -> float:
        """Logarithm of the posterior density of the parameters' variables, but for a
        constant: of the prior, which is flat where the run file has none, times the
        likelihood; -inf beyond the bounds and where the reference refuses."""
        if np.any((u < self.low) | (u > self.high)):
            return -math.inf
        try:
            r = self.deviate(self.white((self.value - self.given(u)) / self.sigma))
        except InputError:
            return -math.inf
        return -0.5 * float(r @ r + self._prior(u) @ self._prior(u))

    def unitless(self, jacobian: Array) -> Array:
        """Derivatives with respect to logarithms, and of other variables in units of
        the distance of their bounds."""
        width = np.where(
            [one.transform == "linear" for one in self.parameters],
            self.high - self.low,
            1.0,
        )
        return jacobian * width


def _least(columns: Array, target: Array, low: Array, high: Array) -> Array:
    """Linear least squares within bounds."""
    best = np.linalg.lstsq(columns, target, rcond=None)[0]
    if np.all((best >= low) & (best <= high)):
        return best
    if best.size == 1:
        return np.clip(best, low, high)
    return np.asarray(optimize.lsq_linear(columns, target, (low, high)).x)


def problem_of(
    file: RunFile,
    fit: Fit,
    table: Table,
    free: list[Parameter],
    scales: list[Parameter],
    fixed: float,
) -> Problem:
    """The fit of a table."""
    sets = table.sets
    names = np.array(table.observable)
    force = np.isin(names, ["friction", "force_std"])
    of_set = (
        np.array([sets.index(table.rows[row].set) for row in table.row])
        if len(scales) > 1
        else 0
    )
    spread = names == "force_std"
    return Problem(
        SteadyForward(file, table.rows, table.row, table.observable),
        [*free, *scales],
        table.value,
        table.sigma,
        np.where(force, of_set, -1),
        fixed,
        spread,
        None if scales else float(file["contacts.count"]),
        file["contacts.stiffness"],
        loss=fit.loss,
    )
