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

# Steps of derivatives: where solves choose their own steps, and where these are given.
STEP_CHOSEN = 2e-2
_STEP_GIVEN = 1e-3
# How often a search chooses the steps of solves anew, as long as chi-square falls by
# more than this share.
_MOST_SEARCHES = 6
_CHI2_FALL = 1e-3
# Size of the steps of `force_of` for a search.
_COARSE_SIZE = 0.7
# Steps of a solve in a search: steady sliding takes some hundred, a slip a thousand.
_MOST_SOLVER_STEPS = 4000
# Correlation of neighbours below which they are independent.
_LEAST_CORRELATION = 0.02


def read_record(path: Path, fit: Fit) -> Measurements:
    """The points of a record, a CSV file with columns of time and force, and of
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
    row_of, names = np.zeros(time.size, int), ["friction"] * time.size
    rows = [MeasuredAt((), 1.0, "")]
    known = rows, row_of, names, value, sigmas, list[str](), np.ones(1), sheet.sha256
    return Measurements(*known, time)


class _Along(NamedTuple):
    """Contacts and drive of a prediction, the grid of instants, and the indices of the
    record's."""

    ensemble: Ensemble
    programme: Programme
    grid: Grid
    points: Array


@dataclass(frozen=True)
class RecordForward:
    """The mean field along a programme at the instants of a record, at unit scale.

    With a stage it is solved with coarse steps: what these miss, relative to the force,
    hardly depends on the parameters, and is the `correction` that was found at some of
    them, with the `error` that is left. A solve that chooses its own steps is a rough
    function of parameters; with `choices` made at some of them it is smooth around.
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
        along = self._along(changes)
        if along.programme.stage is None:
            means = means_along(along.ensemble, along.programme, along.grid)
            return means.force[along.points], means.force_error[along.points]
        force, zero = self._coarse(along), np.zeros(self.time.size)
        correction = zero if self.correction is None else self.correction
        error = zero if self.error is None else self.error
        return force * (1.0 + correction), np.abs(force) * error

    def corrected(self, changes: dict[str, float]) -> "RecordForward":
        """With the correction at these parameters: finer steps, extrapolated as of
        second order; a third of what the last refinement changes is left as the error,
        more than was seen."""
        along = self._along(changes)
        if along.programme.stage is None:
            return self
        coarse, fine = (force_of(*along[:3], size)[along.points] for size in (2, 4))
        correction = (4.0 * fine - coarse) / 3.0 / self._coarse(along) - 1.0
        error = np.abs(fine / coarse - 1.0) / 3.0
        return replace(self, correction=correction, error=error)

    def settle_steps(self, changes: dict[str, float]) -> "RecordForward":
        """Uncorrected, with the steps that a solve at these parameters chooses."""
        along = self._along(changes)
        if along.programme.stage is None:
            return self
        choices = choices_of(*along[:3], _COARSE_SIZE, _MOST_SOLVER_STEPS)
        return replace(self, correction=None, error=None, choices=choices)

    def _coarse(self, along: _Along) -> Array:
        """The force by the steps of a search."""
        force = force_of(*along[:3], _COARSE_SIZE, _MOST_SOLVER_STEPS, self.choices)
        return force[along.points]

    def _along(self, changes: dict[str, float]) -> _Along:
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
        ways = [math.copysign(part.path, part.velocity) for part in programme.segments]
        X = np.interp(t, np.append(0.0, ends), np.append(0.0, np.cumsum(ways)))
        grid = Grid(t, X, segment)
        return _Along(ensemble, programme, grid, np.searchsorted(t, time))


class Correlation(NamedTuple):
    """Correlation time of residuals, and the number of independent points."""

    time: float
    effective: float


def settle_steps(problem: Problem, u: Array) -> Problem:
    """The problem with the steps that a solve at parameters `u` chooses. Raises
    InputError where there is none."""
    assert isinstance(problem.forward, RecordForward)
    forward = problem.forward.settle_steps(problem.changes(u))
    return replace(problem, forward=forward, step=_STEP_GIVEN, central=True)


def search_record(problem: Problem, u: Array) -> Minimum:
    """Least squares from `u`, again and again with the steps that are chosen where they
    ended."""
    found: list[Minimum] = []
    while len(found) < _MOST_SEARCHES:
        if len(found) > 1 and found[-1].chi2 >= (1.0 - _CHI2_FALL) * found[-2].chi2:
            break
        try:
            found.append(minimise(settle_steps(problem, u), u))
        except TooManySteps:
            found.append(minimise(problem, u))
        u = found[-1].u
    best = min(found, key=lambda one: one.chi2)
    return best._replace(solves=sum(one.solves for one in found))


def correlated(problem: Problem, u: Array, t: Array) -> tuple[Problem, Correlation]:
    """The problem with steps and correction at parameters `u`, and the errors'
    correlation that the residuals there have, by maximum likelihood of a Markov process
    of free variance."""
    problem = settle_steps(problem, u)
    assert isinstance(problem.forward, RecordForward)
    problem = replace(problem, forward=problem.forward.corrected(problem.changes(u)))
    r, gap = (problem.value - problem.solved(u).predicted) / problem.sigma, np.diff(t)

    def deviance(log_tau: float) -> float:
        rho = np.exp(-gap * math.exp(-log_tau))
        w = replace(problem, correlation=rho).white(r)
        return float(r.size * math.log(w @ w) + np.sum(np.log1p(-(rho**2))))

    bounds = math.log(0.1 * gap.min()), math.log(0.3 * (t[-1] - t[0]))
    found = optimize.minimize_scalar(deviance, bounds=bounds, method="bounded")
    tau = math.exp(found.x)
    rho = np.exp(-gap / tau)
    if np.median(rho) < _LEAST_CORRELATION:
        return replace(problem, correlation=None), Correlation(0.0, float(t.size))
    effective = 1.0 + float(np.sum((1.0 - rho) / (1.0 + rho)))
    return replace(problem, correlation=rho), Correlation(tau, effective)
