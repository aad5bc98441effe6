"""What a fit compares: predictions of the reference at measured points, and their
distance from the measurements.

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
from eqsim.fitting.data import Row, Table
from eqsim.fitting.section import Fit, Parameter
from eqsim.io.runfile import RunFile, at
from eqsim.master.peak import first_peak
from eqsim.master.steady import curve
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

STEP = 1e-4  # of derivatives, in the variables of parameters
STUDENT = 4.0  # degrees of freedom of the robust loss
REFUSED = 1e4  # residual where the reference refuses
AVERAGES = ("friction", "pinned", "break_stretch")  # observables of `Curve`


def velocity_of(row: Row) -> float | None:
    """The velocity of a row of a table; None if it leaves that to the run file."""
    return dict(row.changes).get("drive.velocity")


class Forward(Protocol):
    """Where predictions come from."""

    @property
    def scaled(self) -> bool:
        """Whether they depend on the scale of force."""

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """Values and errors at unit scale, (measurements,). Raises InputError."""


@dataclass(frozen=True)
class SteadyForward:
    """Steady observables, one row of a table each; all velocities of an ensemble at
    once."""

    file: RunFile
    rows: Sequence[Row]
    observable: Sequence[str]
    scaled: bool = False

    @cached_property
    def groups(self) -> dict[Any, list[int]]:
        """Measurements by the changes (without velocity) and heat that they share."""
        found: dict[Any, list[int]] = {}
        for index, row in enumerate(self.rows):
            rest = tuple(part for part in row.changes if part[0] != "drive.velocity")
            found.setdefault((rest, row.heat), []).append(index)
        return found

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`. The standard deviation of the force is that of one contact
        over k, at unit scale."""
        value, error = np.empty((2, len(self.rows)))
        for (rest, heat), members in self.groups.items():
            file = at(self.file, {**changes, **dict(rest)})
            if heat != 1.0:
                file = at(file, {"thermal.kT": file["thermal.kT"] * heat})
            ensemble = file.ensemble
            given = [velocity_of(self.rows[index]) for index in members]
            v = [file["drive.velocity"] if one is None else one for one in given]
            if None in v:
                raise InputError(
                    "drive.velocity: is required, in the run file or as a data column"
                )
            names = [self.observable[index] for index in members]
            steady = None
            if not set(AVERAGES).isdisjoint(names):
                steady = curve(ensemble, np.array(v))
            for place, (index, name) in enumerate(zip(members, names, strict=True)):
                if name in AVERAGES:
                    value[index] = getattr(steady, name)[place]
                    error[index] = getattr(steady, f"{name}_error")[place]
                else:
                    speed = float(v[place] or 0.0)
                    value[index], error[index] = other_observable(ensemble, speed, name)
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
            raise InputError(
                "force_std: contacts stay in step, the force has no steady variance"
            )
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
    """A fit: measurements, what predicts them, and what is free.

    Attributes
    ----------
    forward : Forward
    parameters : list of Parameter
        Free keys first, then what the measurements are linear in.
    value, sigma : ndarray, shape (measurements,)
    scale_of : ndarray of int, shape (measurements,)
        Which parameter is the scale of a measured force; -1 where none is.
    unit : ndarray, shape (measurements,)
        What multiplies predictions besides: the scale of a force if it is fixed.
    spread : ndarray of bool, shape (measurements,)
        Standard deviations of the force, which go as the root of a free scale.
    stiffness : float
        Of a contact, if it is not free.
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
    unit: Array
    spread: Array
    stiffness: float = 1.0
    nuisance: dict[str, Array] = field(default_factory=dict)
    loss: str = "gaussian"
    correlation: Array | None = None
    step: float = STEP
    central: bool = False

    @cached_property
    def keys(self) -> list[str]:
        """The keys of parameters."""
        return [one.key for one in self.parameters]

    @cached_property
    def linear(self) -> Array:
        """Which parameters are found by linear least squares."""
        roots = bool(np.any(self.spread & (self.scale_of >= 0)))
        easy = self.loss == "gaussian" and not roots
        solved = [self._exact(p) and easy and not p.prior for p in self.parameters]
        return np.array(solved, bool)

    def _exact(self, one: Parameter) -> bool:
        """Whether derivatives with respect to a parameter take no other solve."""
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

    def values(self, u: Array) -> dict[str, float]:
        """Values by key."""
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
        """What multiplies predictions at unit scale. A free scale is N k: the standard
        deviation of the force is that of a contact, k times a length, and goes as the
        root of N."""
        factor, free = self.unit.copy(), self.scale_of >= 0
        if free.any():
            scale = np.array([values[key] for key in self.keys])[self.scale_of[free]]
            k = values.get("contacts.stiffness", self.stiffness)
            factor[free] *= np.where(self.spread[free], np.sqrt(scale * k), scale)
        return factor

    def _combined(self, raw: Array, values: dict[str, float]) -> Array:
        """Predictions, from those at unit scale."""
        added = [values[key] * base for key, base in self.nuisance.items()]
        return np.asarray(self._factor(values) * raw + sum(added))

    def _column(self, index: int, raw: Array) -> Array:
        """What a parameter of which predictions are linear is multiplied by."""
        scaled = np.where(self.scale_of == index, raw, 0.0)
        return self.nuisance.get(self.keys[index], scaled)

    def given(self, u: Array) -> Array:
        """Predictions with every parameter as given. Raises InputError."""
        return self._combined(self.forward.predict(self.changes(u))[0], self.values(u))

    def solved(self, u: Array, held: int = -1) -> Solved:
        """Solve for the linear parameters but that of index `held`. Raises
        InputError."""
        raw, error = self.forward.predict(self.changes(u))
        u, values = u.copy(), self.values(u)
        unknown = [i for i in np.flatnonzero(self.linear).tolist() if i != held]
        if unknown:
            chosen = [self.parameters[i] for i in unknown]
            rest = self._combined(raw, values | {one.key: 0.0 for one in chosen})
            columns = [self._column(i, raw) for i in unknown]
            best = _linear_least_squares(
                self.white(np.array(columns).T / self.sigma[:, None]),
                self.white((self.value - rest) / self.sigma),
                np.array([[one.value(one.low), one.value(one.high)] for one in chosen]),
            )
            for i, one, x in zip(unknown, chosen, best, strict=True):
                values[one.key] = float(x)
                u[i] = min(max(one.variable(float(x)), one.low), one.high)
        return Solved(u, self._combined(raw, values), error * self._factor(values))

    def residuals(self, u: Array, held: int = -1) -> Array:
        """Numbers whose sum of squares is -2 ln L but for a constant, priors included;
        large where the reference refuses."""
        try:
            u, predicted, _ = self.solved(u, held)
        except InputError:
            return np.full(self.value.size + self.priors, REFUSED)
        return self._deviates(u, predicted)

    def _deviates(self, u: Array, predicted: Array) -> Array:
        r = self.white((self.value - predicted) / self.sigma)
        if self.loss == "student":  # of a Gaussian with the same likelihood
            r = np.sign(r) * np.sqrt((STUDENT + 1.0) * np.log1p(r**2 / STUDENT))
        pairs = zip(self.parameters, u, strict=True)
        priors = [(x - p.prior.mean) / p.prior.sd for p, x in pairs if p.prior]
        return np.concatenate((r, priors))

    def white(self, r: Array) -> Array:
        """Residuals in standard errors, (measurements, ...), as independent ones."""
        if self.correlation is None:
            return r
        rho = self.correlation.reshape(-1, *[1] * (r.ndim - 1))
        return np.concatenate((r[:1], (r[1:] - rho * r[:-1]) / np.sqrt(1.0 - rho**2)))

    @cached_property
    def priors(self) -> int:
        """How many parameters have one."""
        return sum(one.prior is not None for one in self.parameters)

    def jacobian(self, u: Array) -> Array:
        """Derivatives of the predictions over their standard errors (and of priors)
        with respect to all parameters, the linear ones too, by central differences,
        shape (measurements + priors, parameters). Raises InputError."""
        raw = self.forward.predict(self.changes(u))[0]
        columns = []
        for i, one in enumerate(self.parameters):
            shift = self.step * (np.arange(u.size) == i)
            down, up = u - shift, u + shift
            if self._exact(one):
                low, high = (self._combined(raw, self.values(x)) for x in (down, up))
                slope = float(one.value(up[i]) - one.value(down[i])) / (2.0 * self.step)
                change = (high - low) / (2.0 * self.step)
                change = np.where(self.spread, change, self._column(i, raw) * slope)
                columns.append(change / self.sigma)
            else:
                down = np.maximum(down, np.minimum(u, self.low))
                up = np.minimum(up, np.maximum(u, self.high))
                change = (self.given(up) - self.given(down)) / (up[i] - down[i])
                columns.append(change / self.sigma)
        priors = [
            np.eye(u.size)[i] / one.prior.sd
            for i, one in enumerate(self.parameters)
            if one.prior
        ]
        return np.vstack((self.white(np.array(columns).T), *priors))

    def density(self, u: Array) -> float:
        """Logarithm of the posterior density of the parameters' variables, but for a
        constant: of the prior, which is flat where the run file has none, times the
        likelihood; -inf beyond the bounds and where the reference refuses."""
        if np.any((u < self.low) | (u > self.high)):
            return -math.inf
        try:
            r = self._deviates(u, self.given(u))
        except InputError:
            return -math.inf
        return -0.5 * float(r @ r)

    def unitless(self, jacobian: Array) -> Array:
        """Derivatives with respect to logarithms, and of other variables in units of
        the distance of their bounds."""
        straight = [one.transform == "linear" for one in self.parameters]
        return jacobian * np.where(straight, self.high - self.low, 1.0)

    def elsewhere(self, index: int, rows: Sequence[Row]) -> "Problem":
        """The fit of measurements like that of an index, at other rows of a table;
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


def _linear_least_squares(columns: Array, target: Array, bounds: Array) -> Array:
    """Linear least squares within `bounds`, shape (columns, 2)."""
    low, high = bounds.T
    best = np.linalg.lstsq(columns, target, rcond=None)[0]
    if np.all((best >= low) & (best <= high)):
        return best
    if best.size == 1:
        return np.clip(best, low, high)
    return np.asarray(optimize.lsq_linear(columns, target, (low, high)).x)


def problem_of(file: RunFile, fit: Fit, table: Table, free: list[Parameter]) -> Problem:
    """The fit of a table."""
    scales, fixed = fit.scales(table.sets)
    rows = [table.rows[row] for row in table.row]
    names = np.array(table.observable)
    spread, unit = names == "force_std", np.ones(names.size)
    scale_of = np.full(names.size, -1)
    force = spread | (names == "friction")
    if scales:
        sets = [
            len(free) + table.sets.index(row.set) * (len(scales) > 1) for row in rows
        ]
        scale_of[force] = np.array(sets)[force]
    else:
        root = math.sqrt(file["contacts.count"])
        unit = np.where(spread, fixed / root, np.where(force, fixed, 1.0))
    return Problem(
        SteadyForward(file, rows, table.observable),
        [*free, *scales],
        table.value,
        table.sigma,
        scale_of,
        unit,
        spread,
        file["contacts.stiffness"],
        loss=fit.loss,
    )
