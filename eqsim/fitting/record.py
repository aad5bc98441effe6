"""Records: force against time under a programme, with errors that are correlated from
point to point.

What is measured is scale F(t) + offset + drift (t - <t>), F the mean field along the
programme (`master.slider` with a stage, `master.programme` without). The stage's
stiffness is that of the run file, kappa_s = K/(N k), or K is given in the unit of the
measured force over length, so that kappa_s = K/scale.

Errors of neighbours, dt apart, are taken to have the correlation exp(-dt/tau) of a
Markov process, of which the residuals of a first fit tell tau; residuals are then made
independent (whitened).
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.fitting.data import MeasuredAt, Measurements, lines
from eqsim.fitting.estimate import Minimum, minimise
from eqsim.fitting.model import Problem
from eqsim.fitting.section import Fit
from eqsim.io.csv import read
from eqsim.io.runfile import RunFile, at
from eqsim.master.cohorts import NO_CHOICES, Choices
from eqsim.master.programme import means_along
from eqsim.master.slider import TooManySteps, choices_of, force_of
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# Steps of derivatives: where solves choose their own time steps, and with given ones.
STEP_CHOSEN = 2e-2
_STEP_GIVEN = 1e-3
# Searches at most, each with time steps chosen anew, while chi-square falls by more than
# this share.
_MOST_SEARCHES = 6
_CHI2_FALL = 1e-3
# Accuracy `fine` of `force_of` in a search, coarser than 1, its usual one.
_COARSE = 0.7
# Time steps of a solve in a search: steady sliding takes some hundred, a slip a thousand.
_MOST_SOLVER_STEPS = 4000
# Correlation of neighbours below which they are independent.
_LEAST_CORRELATION = 0.02


def read_record(path: Path, fit: Fit) -> Measurements:
    """Read the points of a record, a CSV file with columns of time and force, and of
    standard errors. Errors of the file and of fit.noise add in quadrature. Raises
    InputError with the column or line that cannot be used."""
    record, noise = fit.record, fit.noise
    assert record is not None
    field = f"fit.record.file = {path}"
    sheet, points = read(path, field), list[tuple[float, float, float]]()
    for key in ("time", "force", "stderr"):
        name = getattr(record, key)
        if name not in (None, *sheet.columns):
            given, there = f'fit.record.{key} = "{name}"', ", ".join(sheet.columns)
            raise InputError(f"{given}: no such column; there are {there}")
        if name is not None:
            sheet.index(name)  # refuses a name that is there twice
    for line in lines(sheet, "fit.record.file"):
        t, force = line.value(record.time), line.value(record.force)
        error = 0.0 if record.stderr is None else line.value(record.stderr)
        if error < 0:
            raise InputError(f"{line.where}{record.stderr} = {error:g}: must be >= 0")
        sigma = math.hypot(error, noise.absolute, noise.relative * force)
        if not sigma > 0:
            cure = "give fit.record.stderr or fit.noise"
            raise InputError(f"{line.where}{record.force} has no error; {cure}")
        if points and not t > points[-1][0]:
            given = f"{line.where}{record.time} = {t:g}"
            raise InputError(f"{given}: must be later than {points[-1][0]:g} before it")
        points.append((t, force, sigma))
    if not points or points[0][0] < 0:
        wrong = "begins before time 0" if points else "is empty"
        raise InputError(f"{field}: {wrong}")
    time, value, sigmas = np.array(points).T
    return Measurements(
        rows=[MeasuredAt(changes=(), heat=1.0, set="")],
        row=np.zeros(time.size, int),
        observable=["friction"] * time.size,
        value=value,
        sigma=sigmas,
        names=[],
        temperatures=np.ones(1),
        sha256=sheet.sha256,
        time=time,
    )


class _Course(NamedTuple):
    """Contacts and drive of a prediction, the grid of instants at which it is solved,
    and the indices of the record's instants among these."""

    ensemble: Ensemble
    programme: Programme
    grid: Grid
    points: Array


@dataclass(frozen=True)
class RecordForward:
    """The mean field along a programme at the times of a record, at unit scale.

    With a stage it is solved with coarse time steps. What these miss, relative to the
    force, hardly depends on the parameters: it is found once, as the `correction`, with
    its relative `error`. A solve that chooses its own time steps is a rough function of
    parameters; with the `choices` made at some parameters it is smooth near these.
    """

    file: RunFile
    time: Array
    machine_stiffness: float | None
    fixed_scale: float
    correction: Array | None = None
    error: Array | None = None
    choices: Choices = NO_CHOICES

    @property
    def scaled(self) -> bool:
        """See `Forward`."""
        return self.machine_stiffness is not None

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`."""
        course = self._course(changes)
        if not course.programme.pulled:
            means = means_along(course.ensemble, course.programme, course.grid)
            return means.force[course.points], means.force_error[course.points]
        force = self._coarse(course)
        correction = 0.0 if self.correction is None else self.correction
        error = 0.0 if self.error is None else self.error
        return force * (1.0 + correction), np.abs(force) * error

    def corrected(self, changes: dict[str, float]) -> "RecordForward":
        """Find the correction at these parameters, by Richardson extrapolation of
        solves with finer time steps, taken to be of second order. Its error is a third
        of what the last refinement changes, more than tests have seen."""
        course = self._course(changes)
        if not course.programme.pulled:
            return self
        middle, finest = (force_of(*course[:3], fine)[course.points] for fine in (2, 4))
        correction = (4.0 * finest - middle) / 3.0 / self._coarse(course) - 1.0
        error = np.abs(finest / middle - 1.0) / 3.0
        return replace(self, correction=correction, error=error)

    def settle_steps(self, changes: dict[str, float]) -> "RecordForward":
        """Take the time steps that a solve at these parameters chooses; uncorrected."""
        course = self._course(changes)
        if not course.programme.pulled:
            return self
        choices = choices_of(*course[:3], _COARSE, _MOST_SOLVER_STEPS)
        return replace(self, correction=None, error=None, choices=choices)

    def _coarse(self, course: _Course) -> Array:
        """The force, uncorrected, with the coarse time steps of a search."""
        force = force_of(*course[:3], _COARSE, _MOST_SOLVER_STEPS, self.choices)
        return force[course.points]

    def _course(self, changes: dict[str, float]) -> _Course:
        """Contacts, drive and grid at these parameters. Raises InputError."""
        keys = {key: x for key, x in changes.items() if not key.startswith("fit.")}
        file = at(self.file, keys)
        ensemble, programme = file.ensemble, file.drive
        if not isinstance(programme, Programme):
            raise InputError("drive.programme: is required with fit.record")
        if self.machine_stiffness is not None:
            if programme.stage is None:
                raise InputError("drive.stage: is required with machine_stiffness")
            scale = changes.get("fit.scale", self.fixed_scale)
            stage = replace(programme.stage, stiffness=self.machine_stiffness / scale)
            programme = replace(programme, stage=stage)
        ends = np.cumsum([segment.duration for segment in programme.segments])
        if self.time[-1] > ends[-1] * (1.0 + 1e-9):
            end = f"fit.record: ends at {self.time[-1]:g}"
            raise InputError(f"{end}, after the programme, which takes {ends[-1]:g}")
        time = np.minimum(self.time, ends[-1])
        t = np.unique(np.concatenate(([0.0], time, ends)))
        segment = np.minimum(np.searchsorted(ends, t * (1.0 - 1e-12)), ends.size - 1)
        moved = [math.copysign(each.path, each.velocity) for each in programme.segments]
        X = np.interp(t, np.append(0.0, ends), np.append(0.0, np.cumsum(moved)))
        grid = Grid(t, X, segment)
        return _Course(ensemble, programme, grid, np.searchsorted(t, time))


class Correlation(NamedTuple):
    """Correlation time of residuals, 0 if they are independent, and the `effective`
    number of independent points."""

    time: float
    effective: float


def settle_steps(problem: Problem, u: Array) -> Problem:
    """The problem with the time steps that a solve at parameters `u` chooses. Raises
    InputError where there is none."""
    assert isinstance(problem.forward, RecordForward)
    forward = problem.forward.settle_steps(problem.changes(u))
    return replace(problem, forward=forward, step=_STEP_GIVEN, central=True)


def search_record(problem: Problem, u: Array) -> Minimum:
    """Repeat least squares from `u`, each search from where the last one ended and with
    the time steps that a solve there chooses."""
    ends: list[Minimum] = []
    while len(ends) < _MOST_SEARCHES:
        if len(ends) > 1 and ends[-1].chi2 >= (1.0 - _CHI2_FALL) * ends[-2].chi2:
            break
        try:
            ends.append(minimise(settle_steps(problem, u), u))
        except TooManySteps:
            ends.append(minimise(problem, u))
        u = ends[-1].u
    best = min(ends, key=lambda end: end.chi2)
    return best._replace(solves=sum(end.solves for end in ends))


def correlated(problem: Problem, u: Array, t: Array) -> tuple[Problem, Correlation]:
    """The problem with time steps and correction at parameters `u`, and the correlation
    of its errors: that of the residuals there, at times `t`, by maximum likelihood
    of a Markov process of free variance."""
    problem = settle_steps(problem, u)
    assert isinstance(problem.forward, RecordForward)
    problem = replace(problem, forward=problem.forward.corrected(problem.changes(u)))
    r, gap = (problem.value - problem.solved(u).predicted) / problem.sigma, np.diff(t)

    def deviance(log_tau: float) -> float:
        rho = np.exp(-gap * math.exp(-log_tau))
        w = replace(problem, correlation=rho).white(r)
        return float(r.size * math.log(w @ w) + np.sum(np.log1p(-(rho**2))))

    bounds = math.log(0.1 * gap.min()), math.log(0.3 * (t[-1] - t[0]))
    least = optimize.minimize_scalar(deviance, bounds=bounds, method="bounded")
    tau = math.exp(least.x)
    rho = np.exp(-gap / tau)
    if np.median(rho) < _LEAST_CORRELATION:
        return replace(problem, correlation=None), Correlation(0.0, float(t.size))
    effective = 1.0 + float(np.sum((1.0 - rho) / (1.0 + rho)))
    return replace(problem, correlation=rho), Correlation(tau, effective)
