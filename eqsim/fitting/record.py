"""Records: force against time under a programme, with errors that are correlated from
point to point.

What is measured is scale F(t) + offset + drift (t - <t>) + trend X (or trend t), with X
the displacement of the load point, and F the mean field along the programme
(`master.slider` with a stage, `master.programme` without). The stage's stiffness is
that of the run file, kappa_s = K/(N k), or K is given in the unit of the measured force
over length, so that kappa_s = K/scale.

Errors of neighbours, dt apart, are taken to have the correlation exp(-dt/tau) of a
Markov process, of which the residuals of a first fit tell tau; residuals are then made
independent (whitened).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.fitting.data import MeasuredAt, Measurements
from eqsim.fitting.estimate import Each, Minimum, search
from eqsim.fitting.model import Problem, unrounded
from eqsim.fitting.section import BlockSize, Fit, RecordSection
from eqsim.io.csv import read
from eqsim.io.runfile import RunFile, at
from eqsim.io.series import Blocks, RowErrors, blocks_of, means, read_series
from eqsim.master.cohorts import Choices
from eqsim.master.programme import means_along
from eqsim.master.slider import TooManySteps, choices_of, force_of
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.model.mixture import summed
from eqsim.numerics.tables import Array

# Steps of derivatives: where solves choose their own time steps, and with given ones.
STEP_CHOSEN = 2e-2
_STEP_GIVEN = 1e-3
# Where a search ends: a record's chi-square is known to about 1, as the error of its
# correction.
TOLERANCE = 1e-5
# Searches at most, each with time steps chosen anew, while chi-square falls by more than
# this share.
_MOST_SEARCHES = 6
_CHI2_FALL = 1e-3
# Accuracy `fine` of `force_of` in a search, coarser than 1, its usual one.
_COARSE = 0.7
# Time steps of a solve in a search: steady sliding takes some hundred, a slip a thousand.
_MOST_SOLVER_STEPS = 4000
# Rows of a record from which on it is read as block means, unless told otherwise.
_MOST_ROWS = 2000
# Independent points that a point is worth, from which on all are independent: that of
# neighbours with a correlation of .02.
_INDEPENDENT = 0.98 / 1.02


def programme_of(file: RunFile) -> Programme:
    """The programme of a record. Raises InputError."""
    programme = file.drive
    if not isinstance(programme, Programme):
        raise InputError("drive.programme: is required with fit.record")
    return programme


def _check_end(programme: Programme, time: float) -> None:
    """Raise InputError for a record that ends after the programme."""
    end = programme.corners[0][-1]
    if time > end * (1.0 + 1e-9):
        said = f"ends at {time:g}, after the programme, which takes {end:g}"
        cure = "fit.record.start is the time of the clock at which it begins"
        raise InputError(f"fit.record: {said}; {cure}")


def _segment(programme: Programme, t: Array) -> Array:
    """The segment that each instant belongs to, or ends."""
    ends = programme.corners[0][1:]
    inside = np.searchsorted(ends, t * (1.0 - 1e-12))
    return np.asarray(np.minimum(inside, ends.size - 1))


def read_record(
    path: Path,
    fit: Fit,
    file: RunFile | None = None,
    progress: Callable[[int, float], None] = lambda done, total: None,
    field: str = "fit.record.file",
) -> Measurements:
    """Read the points of a record, a CSV file with columns of time (or displacement of
    the load point) and force (or shear stress, beside normal stress), and of standard
    errors; long ones as block means. Errors of the file and of fit.noise add in
    quadrature. Raises InputError with the column or line that cannot be used."""
    record, noise = fit.record, fit.noise
    assert record is not None
    programme = None if file is None else programme_of(file)
    sheet = read(path, f"{field} = {path}", record.decimal)
    for key in ("time", "displacement", "force", "normal", "stderr"):
        name = getattr(record, key)
        if name is not None and (key, record.displacement is None) != ("time", False):
            sheet.index(name, f" (fit.record.{key} names another)")
    clock = record.displacement or record.time
    names = [clock, record.force, *([record.normal] if record.normal else [])]
    found = read_series(sheet, names, record.start, record.stderr, progress=progress)
    t, force, said = found.t, found.values[:, 0], [f"{found.t.size} rows", *found.said]
    errors = np.zeros(t.size) if record.stderr is None else found.values[:, -1]
    if record.normal is not None:
        normal = found.values[:, 1]
        if (wrong := np.flatnonzero(normal <= 0)).size:
            given = f"{record.normal} = {normal[wrong[0]]:g}: must be > 0"
            raise InputError(f"{sheet.field}, line {found.lines[wrong[0]]}: {given}")
        force, errors = force / normal, errors / normal
    if record.displacement is not None:
        if programme is None or any(one.velocity <= 0 for one in programme.segments):
            said_of = "in which the load point always moves on; give fit.record.time"
            raise InputError(f"fit.record.displacement: needs a programme {said_of}")
        ends, X = programme.corners
        t = np.interp(t, X, ends) * np.maximum(t / X[-1], 1.0)
    if programme is not None:
        _check_end(programme, float(t[-1]))
    points, lines = (t, force, errors), found.lines
    long = record.blocks is None and t.size > _MOST_ROWS
    if programme is not None and (long or record.blocks not in (None, "none")):
        common = math.hypot(noise.absolute, noise.relative * float(np.median(force)))
        blocks = _blocks(record, programme, (t, force), RowErrors(errors, common))
        points = means(t, blocks), means(force, blocks), blocks.error
        lines = lines[blocks.first]
        said.append(_words_of(blocks, t))
    time, value, error = points
    sigma = np.hypot(error, np.hypot(noise.absolute, noise.relative * value))
    if (wrong := np.flatnonzero(~(sigma > 0))).size:
        cure = "fit.record.stderr or fit.noise" if file else "columns and noise"
        where = f"{sheet.field}, line {lines[wrong[0]]}"
        raise InputError(f"{where}: {record.force} has no error; give {cure}")
    return Measurements(
        conditions=[MeasuredAt()] * time.size,
        observable=["friction"] * time.size,
        value=value,
        sigma=sigma,
        names=[],
        sha256=sheet.sha256,
        time=time,
        said=tuple(said),
        read=(t, force),
    )


def _blocks(
    record: RecordSection,
    programme: Programme,
    points: tuple[Array, Array],
    errors: RowErrors,
) -> Blocks:
    """The blocks of a record's rows, none of them beyond a segment of the programme.
    Raises InputError."""
    (t, force), given = points, None
    if isinstance(record.blocks, BlockSize):
        ends, X = programme.corners
        path = np.append(0.0, np.cumsum(np.abs(np.diff(X))))
        moves = record.blocks.per == "displacement"
        if moves and np.any(np.diff(path) == 0):
            said = "a hold has none; it must be per time"
            raise InputError(f'fit.record.blocks: per = "displacement": {said}')
        along = np.interp(t, ends, path) if moves else t
        given = np.floor(along / record.blocks.size).astype(int)
    return blocks_of(force, _segment(programme, t), errors, given)


def _words_of(blocks: Blocks, t: Array) -> str:
    """Say what was averaged, and how much of it is smeared."""
    rows, longest = blocks.rows, np.max(np.diff(t[blocks.first], append=t[-1]))
    said = f"{rows.size} block means of {rows.min()} to {rows.max()} rows"
    smeared = int(np.sum(~blocks.straight))
    some = f"{smeared} of them may smear what the record shows, make them smaller"
    some = some if smeared else "no feature is smeared"
    return f"{said}, at most {longest:.3g} long in time: {some}"


class Course(NamedTuple):
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
    largest force, hardly depends on the parameters (relative to the force itself it
    does, where that passes 0): it is found once, as the `correction`, with its relative
    `error`. A solve that chooses its own time steps is a rough function of
    parameters; with the `choices` made at some parameters it is smooth near these.
    """

    file: RunFile
    time: Array
    machine_stiffness: float | None
    fixed_scale: float
    correction: Array | float = 0.0
    error: Array | float = 0.0
    choices: Sequence[Choices] = ()

    @property
    def scaled(self) -> bool:
        """See `Forward`."""
        return self.machine_stiffness is not None

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`."""
        course = self.course(changes)
        if not course.programme.pulled:
            kinds, drive = course.ensemble.kinds, course[1:3]
            means = summed(kinds, [means_along(one.contacts, *drive) for one in kinds])
            return means.force[course.points], means.force_error[course.points]
        force = self._coarse(course)
        largest = np.full(force.size, np.abs(force).max())
        return force + self.correction * largest, self.error * largest

    def corrected(self, changes: dict[str, float], each: Each = map) -> "RecordForward":
        """Find the correction at these parameters, by Richardson extrapolation of
        solves with finer time steps, taken to be of second order. Its error is a third
        of what the last refinement changes, more than tests have seen."""
        course = self.course(changes)
        if not course.programme.pulled:
            return self
        forces = each(lambda fine: force_of(*course[:3], fine)[course.points], (2, 4))
        middle, finest = forces
        coarse = self._coarse(course)
        largest = np.abs(coarse).max()
        missed = (4.0 * finest - middle) / 3.0 - coarse
        error = np.abs(finest - middle) / 3.0
        return replace(self, correction=missed / largest, error=error / largest)

    def settle_steps(self, changes: dict[str, float]) -> "RecordForward":
        """Take the time steps that a solve at these parameters chooses; uncorrected."""
        course = self.course(changes)
        if not course.programme.pulled:
            return self
        choices = choices_of(*course[:3], _COARSE, _MOST_SOLVER_STEPS)
        return replace(self, correction=0.0, error=0.0, choices=choices)

    def _coarse(self, course: Course) -> Array:
        """The force, uncorrected, with the coarse time steps of a search."""
        force = force_of(*course[:3], _COARSE, _MOST_SOLVER_STEPS, self.choices)
        return force[course.points]

    def stage_of(self, changes: dict[str, float]) -> dict[str, float]:
        """The stiffness of the stage by its key, if it follows from the scale."""
        if self.machine_stiffness is None:
            return {}
        scale = changes.get("fit.scale", self.fixed_scale)
        return {"drive.stage.stiffness": self.machine_stiffness / scale}

    def course(self, changes: dict[str, float]) -> Course:
        """Contacts, drive and grid at these parameters. Raises InputError."""
        keys = {key: x for key, x in changes.items() if not key.startswith("fit.")}
        file = at(self.file, keys | self.stage_of(changes))
        ensemble, programme = unrounded(file), programme_of(file)
        _check_end(programme, self.time[-1])
        ends = programme.corners[0]
        time = np.minimum(self.time, ends[-1])
        t = np.unique(np.concatenate((ends, time)))
        grid = Grid(t, programme.position(t), _segment(programme, t))
        return Course(ensemble, programme, grid, np.searchsorted(t, time))


def shapes(file: RunFile, fit: Fit, t: Array) -> dict[str, Array]:
    """Shapes of "fit.offset", "fit.drift" and "fit.trend" in a record at times `t`, where
    they are 1. Raises InputError."""
    found = {"fit.offset": np.ones(t.size), "fit.drift": t - t.mean()}
    if fit.trend is not None:
        along = fit.trend.per == "displacement"
        found["fit.trend"] = programme_of(file).position(t) if along else t
    return found


def without_fixed(file: RunFile, fit: Fit, table: Measurements) -> Array:
    """Values of a record less its offset, drift and trend, as far as these are fixed.
    Raises InputError."""
    assert table.time is not None
    value = table.value
    for key, shape in shapes(file, fit, table.time).items():
        if key not in fit.free:
            value = value - fit.nuisance(key) * shape
    return value


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


def search_record(problem: Problem, u: Array, each: Each = map) -> Minimum:
    """Repeat least squares from `u`, each search from where the last one ended and with
    the time steps that a solve there chooses; `each` as in `minimise`."""
    ends: list[Minimum] = []
    while len(ends) < _MOST_SEARCHES:
        if len(ends) > 1 and ends[-1].chi2 >= (1.0 - _CHI2_FALL) * ends[-2].chi2:
            break
        try:
            ends.append(search(settle_steps(problem, u), u, each=each))
        except TooManySteps:
            ends.append(search(problem, u, each=each))
        u = ends[-1].u
    best = min(ends, key=lambda end: end.chi2)
    return best._replace(solves=sum(end.solves for end in ends))


def corrected(problem: Problem, u: Array, each: Each = map) -> Problem:
    """The problem with time steps and correction at parameters `u`. Raises InputError
    where there is no solve."""
    problem = settle_steps(problem, u)
    assert isinstance(problem.forward, RecordForward)
    forward = problem.forward.corrected(problem.changes(u), each)
    return replace(problem, forward=forward)


def correlated(
    problem: Problem, u: Array, t: Array, each: Each = map
) -> tuple[Problem, Correlation]:
    """The problem as `corrected`, and the correlation of its errors: that of the
    residuals there, at times `t`, by maximum likelihood of a Markov process of free
    variance."""
    problem = corrected(problem, u, each)
    r, gap = (problem.value - problem.solved(u).predicted) / problem.sigma, np.diff(t)

    def deviance(log_tau: float) -> float:
        rho = np.exp(-gap * math.exp(-log_tau))
        w = replace(problem, correlation=rho).white(r)
        return float(r.size * math.log(w @ w) + np.sum(np.log1p(-(rho**2))))

    bounds = math.log(0.1 * gap.min()), math.log(0.3 * (t[-1] - t[0]))
    least = optimize.minimize_scalar(deviance, bounds=bounds, method="bounded")
    tau = math.exp(least.x)
    rho = np.exp(-gap / tau)
    worth = (1.0 - rho) / (1.0 + rho)
    if worth.mean() > _INDEPENDENT:
        return replace(problem, correlation=None), Correlation(0.0, float(t.size))
    effective = 1.0 + float(np.sum(worth))
    return replace(problem, correlation=rho), Correlation(tau, effective)
