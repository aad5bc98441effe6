"""Fits: from a run file with a [fit] section to a `FitResult`."""

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from eqsim.errors import InputError, require_integer
from eqsim.fitting import estimate, profiles, record, symmetry
from eqsim.fitting.data import FORCES, Measurements, read_table
from eqsim.fitting.estimate import DEGENERATE, Direction, Minimum, Tasks
from eqsim.fitting.model import (
    DERIVATIVE_STEP,
    STUDENT,
    TOLERANCE,
    Forward,
    Problem,
    SteadyForward,
)
from eqsim.fitting.profiles import WIDE
from eqsim.fitting.record import Correlation, RecordForward
from eqsim.fitting.section import Fit, Parameter, parameters_of, section_of
from eqsim.io import storage
from eqsim.io.content import path_of
from eqsim.io.parameters import keys
from eqsim.io.runfile import RunFile, at, contents_of, opened
from eqsim.laws.barrier import BARRIERS
from eqsim.numerics.tables import Array
from eqsim.numerics.threads import ThreadPool
from eqsim.sweeps.workers import Workers

# p below which a model is rejected.
REJECTED = 1e-3
# Error of the solver over that of a measurement from which on there is a warning.
_NOISE_FLOOR = 0.1
# Half of a 95 % interval over the standard deviation: a smaller one comes of roughness
# of a solver that takes time steps, unless the bounds of other keys end it.
_ROUGH_WIDTH = 0.1
# Distance from a bound, over that of the bounds, at which a parameter is there.
_AT_BOUND = 1e-3
# Rounds of profiles, each from the better fit that the one before has found.
_MOST_FITS = 3
# Rounds in which a record's best fit gives time steps, a correction, and the
# correlation of errors.
_WHITENED = 2

# Status of a key whose profile has not been followed yet.
NOT_PROFILED = "profile to come"

Progress = Callable[[int, float], None]


class Interval(NamedTuple):
    """Result for a key: its best value, the standard deviation of its variable, the
    profile intervals with None for an open side, and a status."""

    key: str
    estimate: float
    transform: str
    sd: float
    intervals: dict[str, tuple[float | None, ...]]
    status: str


class Goodness(NamedTuple):
    """Agreement of a model with data: chi-square (priors included), degrees of freedom,
    the probability of a larger chi-square (None without degrees of freedom), -2 ln L,
    and the criteria of Akaike (corrected) and Bayes."""

    chi2: float
    dof: int
    p: float | None
    deviance: float
    aicc: float | None
    bic: float


@dataclass(frozen=True, repr=False)
class FitResult:
    """Result of a fit.

    Attributes
    ----------
    file : RunFile
    fit : Fit
        The [fit] section.
    problem : Problem
    table : Measurements
    best : Minimum
    jacobian : ndarray, shape (measurements + priors, parameters)
        J, at the best fit.
    minima : list of Minimum
        One for each start.
    profiles : dict
        The two sides of each key's profile, as far as they have been followed.
    noticed : list of str
        Warnings from before the fit.
    correlation : Correlation or None
        Correlation of the errors of a record.
    """

    file: RunFile
    fit: Fit
    problem: Problem
    table: Measurements
    best: Minimum
    jacobian: Array
    minima: list[Minimum]
    profiles: dict[str, list[profiles.Side]]
    noticed: list[str]
    correlation: Correlation | None = None

    @property
    def values(self) -> dict[str, float]:
        """The best value of each parameter."""
        return self.problem.values(self.best.u)

    @property
    def changes(self) -> dict[str, float]:
        """The best values of the free keys of the run file, and of the stiffness of a
        stage that follows from the scale."""
        best, forward = self.values, self.problem.forward
        keys = {key: x for key, x in best.items() if not key.startswith("fit.")}
        if isinstance(forward, RecordForward):
            keys |= forward.stage_of(best)
        return keys

    @property
    def seed(self) -> int:
        """Seed of starts and posterior."""
        return self.file.output.seed

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the variables of the parameters, shape (parameters,
        parameters)."""
        return estimate.covariance(self.jacobian)

    @cached_property
    def ladder(self) -> list[Direction]:
        """Eigenvectors of J'J, the best determined first."""
        jacobian = self.problem.unitless(self.jacobian)
        return estimate.ladder(self.problem.factors, jacobian)

    @cached_property
    def goodness(self) -> Goodness:
        """Agreement of the best fit with the data."""
        return goodness(self.problem, self.best.u)

    @cached_property
    def floor(self) -> float:
        """Largest error of the solver over that of a measurement."""
        error = self.problem.solved(self.best.u).error
        return float(np.max(error / self.problem.sigma))

    @cached_property
    def intervals(self) -> list[Interval]:
        """Estimate, intervals and status of each free key, and of scales."""
        sd, parameters = np.sqrt(np.diag(self.covariance)), self.problem.parameters
        return [
            interval_of(one, self.values[one.key], error, self.profiles.get(one.key))
            for one, error in zip(parameters, sd.tolist(), strict=True)
        ]

    @property
    def derived(self) -> dict[str, float]:
        """Groups of the best fit: F0 = N k x_* (scale times x_*), v0 = omega x_*, b, v_* of
        annealed contacts, and where the section gives an area or a normal stress, contacts
        per area and their spacing; those that have a scale for each set. Nothing of
        several populations."""
        ensemble = at(self.file, self.changes).ensemble
        if ensemble.populations:
            return {}
        thermal, unit = ensemble.thermal, ensemble.thresholds.scale
        scales, fixed = self.fit.scales(self.table.sets)
        said = [f" of set {one.key.removeprefix('fit.scale.')}" for one in scales]
        known = [self.values[one.key] for one in scales] or [fixed]
        of_set = dict(zip(said if len(scales) > 1 else [""], known, strict=True))
        groups = {f"F0{of} = N k x_*": scale * unit for of, scale in of_set.items()}
        if thermal.kT > 0:
            kelvin = self.file.units.kelvin(thermal.kT)
            if kelvin is not None:
                groups["T of kT (K)"] = kelvin
            groups["v0 = omega x_*"] = thermal.attempt_frequency * unit
            groups["b = k x_*^2/(2 kT)"] = ensemble.b
        elif thermal.active:
            groups[f"b = {BARRIERS[thermal.barrier].b_words}"] = ensemble.b
        if thermal.active and ensemble.disorder == "annealed":
            groups["v_*"] = ensemble.crossover_velocity
        area, stress = self.fit.area, self.fit.normal_stress
        per_area = 1.0 / area if area is not None else stress
        if per_area is not None:
            for of, scale in of_set.items():
                density = scale / ensemble.stiffness * per_area
                groups[f"contacts per area{of}"] = density
                groups[f"spacing of contacts{of}"] = 1.0 / math.sqrt(density)
        return {name: float(value) for name, value in groups.items()}

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings from before the fit, and doubts about its numbers."""
        doubts, rough = [*self.noticed], []
        if self.floor > _NOISE_FLOOR:
            doubts.append(
                f"noise floor: the solver's own error is {self.floor:.2g} of a "
                "measurement's standard error"
            )
        problem, sd = self.problem, np.sqrt(np.diag(self.covariance))
        forward, told = problem.forward, WIDE * problem.unit_of_variables
        steps = isinstance(forward, RecordForward) and len(forward.choices) > 0
        pairs = zip(problem.parameters, self.best.u, sd, sd < told, strict=True)
        for one, x, error, known in pairs:
            for bound in (one.low, one.high):
                if abs(x - bound) < _AT_BOUND * (one.high - one.low):
                    doubts.append(
                        f"{one.key} is at its bound {float(one.value(bound)):g}: "
                        "values and intervals of the other keys depend on this bound"
                    )
            ends = [side.ends["95"] for side in self.profiles.get(one.key, ())]
            nearest = min((abs(u - x) for u in ends if u is not None), default=math.inf)
            # at a bound a covariance says nothing
            inside = one.low < x < one.high
            if steps and known and inside and nearest < _ROUGH_WIDTH * error:
                rough.append(one.key)
        if rough:
            doubts.append(
                f"intervals of {', '.join(rough)} end at roughness of the solver: not "
                "to be trusted"
            )
        return doubts

    def to_pandas(self) -> Any:
        """A DataFrame of the keys, one a row: estimate, ends of the 68 and 95 %
        intervals (None: open) and status."""
        import pandas as pd

        rows = {}
        for one in self.intervals:
            ends = {}
            for level, pair in one.intervals.items():
                ends[f"low_{level}"], ends[f"high_{level}"] = pair
            rows[one.key] = {"estimate": one.estimate, **ends, "status": one.status}
        return pd.DataFrame.from_dict(rows, orient="index")

    def plot(self) -> Any:
        """A matplotlib Figure of the data, the fitted curves and their bands, and
        residuals."""
        from eqsim.fitting.pictures import fit_figure

        return fit_figure(self, self.file.title)

    def __repr__(self) -> str:
        good = self.goodness
        said = [f"{one.key} {one.estimate:.4g} {one.status}" for one in self.intervals]
        said.append(f"chi-square {good.chi2:.4g} of {good.dof} degrees of freedom")
        said += ["REJECTED"] * self.rejected
        return f"{type(self).__name__}({', '.join(said)})"

    def _repr_html_(self) -> str:
        return str(self.to_pandas().to_html())

    @cached_property
    def chi2_as_given(self) -> float:
        """Chi-square with the errors of the data as they are given, taken to be
        independent: at the best fit, or where they were taken so if that is less."""
        problem = replace(self.problem, correlation=None)
        first = min(self.minima, key=lambda one: one.chi2)
        return min(goodness(problem, u).chi2 for u in (self.best.u, first.u))

    @property
    def fixed(self) -> Array:
        """Fixed offset, drift and trend, as they add to a record, (measurements,); of a
        table 0."""
        return self.table.value - self.problem.value

    @property
    def converged(self) -> bool:
        """True if any start converged."""
        return any(one.converged for one in self.minima)

    @property
    def rejected(self) -> bool:
        """True if the best fit is too far from the data for their errors."""
        return self.goodness.p is not None and self.goodness.p < REJECTED


def interval_of(
    one: Parameter, best: float, sd: float, sides: list[profiles.Side] | None
) -> Interval:
    """The result for a parameter, from the two sides of its profile, if these are
    known."""
    if sides is None:
        return Interval(one.key, best, one.transform, sd, {}, NOT_PROFILED)
    ends = {
        level: tuple(
            None if (u := side.ends[level]) is None else float(one.value(u))
            for side in sides
        )
        for level in profiles.LEVELS
    }
    status = profiles.status(sides, one.transform)
    return Interval(one.key, best, one.transform, sd, ends, status)


Estimated = Callable[[FitResult], None]


class Keep(NamedTuple):
    """Folder for results of a fit that may be stopped; and `estimated(result)`, called as
    soon as there are estimates, before profiles, and when those of a key are there.
    Intervals of the other keys are empty till then."""

    folder: Path
    estimated: Estimated = lambda result: None


class Prepared(NamedTuple):
    """A fit before the work: its run file and section, measurements and problem, and
    warnings."""

    file: RunFile
    fit: Fit
    table: Measurements
    problem: Problem
    warnings: list[str]


def prepare(
    file: RunFile,
    data: Path | None,
    allow_degenerate: bool,
    progress: Progress = lambda done, total: None,
) -> Prepared:
    """Read and check what a fit needs. Raises InputError."""
    section = section_of(file)
    free = parameters_of(file, section)
    table = measured(file, section, data, progress)
    scales, _ = section.scales(table.sets)
    if scales and not table.sets:
        raise InputError("fit.scale: no force was measured; give a fixed scale = 1.0")
    count, needed = table.value.size, len(free) + max(1, len(scales))
    if count < needed:
        where = "fit.data" if section.record is None else "fit.record"
        raise InputError(
            f"{where}: has {count} measurements for {len(free)} free keys; "
            f"at least {needed} are needed"
        )
    loose = [one for one in free if one.prior is None]
    reasons = _symmetries(file, table, loose, bool(scales))
    if reasons and not allow_degenerate:
        hint = "--allow-degenerate fits all the same"
        raise InputError(f"fit.free: {reasons[0]} ({hint})")
    return Prepared(file, section, table, problem_of(file, section, table), reasons)


def _symmetries(
    file: RunFile, table: Measurements, free: list[Parameter], scaled: bool
) -> list[str]:
    """Reasons why data cannot determine free keys, those that hold for the keys of every
    row."""
    seen = {"record"} if table.time is not None else set(table.observable)
    rows = dict.fromkeys(
        tuple(pair for pair in row.changes if pair[0] != "drive.velocity")
        for row in table.conditions
    )
    files = [at(file, dict(row)) for row in rows]
    first, *others = [symmetry.refused(one, free, scaled, seen) for one in files]
    return [reason for reason in first if all(reason in one for one in others)]


def measured(
    file: RunFile,
    section: Fit,
    data: Path | None,
    progress: Progress = lambda done, total: None,
) -> Measurements:
    """Read the table or the record of measurements. Raises InputError."""
    field, name = "fit.data", section.data
    if section.record is not None:
        field, name = "fit.record.file", section.record.file
    if data is None and name is None:
        raise InputError("fit.data: is required, the CSV file of measurements")
    path = data or path_of(field, file.folder, str(name))
    field = field if data is None else "data"
    if section.record is not None:
        return record.read_record(path, section, file, progress, field)
    table = read_table(path, file, section, field)
    _check_rows(file, table)
    return table


def problem_of(file: RunFile, section: Fit, table: Measurements) -> Problem:
    """The fit of a table or a record. Raises InputError."""
    (scales, fixed), free = section.scales(table.sets), parameters_of(file, section)
    kT = [key for key in keys(file) if key.endswith("thermal.kT")]
    varied = {*section.free, *table.names}
    if section.temperature and not any(file[key] or key in varied for key in kT):
        raise InputError("fit.temperature: has no effect with thermal.kT = 0")
    rows, value = table.conditions, table.value
    names, nuisance = np.array(table.observable), dict[str, Array]()
    spread = names == "force_std"
    force = np.isin(names, FORCES)
    forward: Forward = SteadyForward(
        file, rows, table.observable, free_scale=bool(scales)
    )
    if section.record is not None and table.time is not None:
        stiffness = section.record.machine_stiffness
        if stiffness is not None and file["drive.stage"] is None:
            raise InputError("drive.stage: is required with machine_stiffness")
        if stiffness is not None and "drive.stage.stiffness" in section.free:
            both = "not allowed with fit.record.machine_stiffness"
            raise InputError(f"fit.free.drive.stage.stiffness: {both}")
        forward = RecordForward(file, table.time, stiffness, fixed)
        value = record.without_fixed(file, section, table)
        known = record.shapes(file, section, table.time).items()
        nuisance = {key: shape for key, shape in known if key in section.free}
    parameters = [one for one in free if one.key not in nuisance]
    first, scale_of = len(parameters), np.full(names.size, -1)
    unit = np.ones(names.size)
    if scales:
        number = {name: i for i, name in enumerate(table.sets[: len(scales)])}
        sets = [number.get(row.set, 0) for row in rows]
        scale_of = np.where(force, first + np.array(sets), -1)
    else:
        root = math.sqrt(file["contacts.count"])
        unit = np.where(spread, fixed / root, np.where(force, fixed, 1.0))
    return Problem(
        forward=forward,
        parameters=[*parameters, *scales, *(p for p in free if p.key in nuisance)],
        value=value,
        sigma=table.sigma,
        scale_of=scale_of,
        unit=unit,
        spread=spread,
        nuisance=nuisance,
        loss=section.loss,
        step=DERIVATIVE_STEP if table.time is None else record.STEP_CHOSEN,
        tolerance=TOLERANCE if table.time is None else record.TOLERANCE,
    )


def _check_rows(file: RunFile, table: Measurements) -> None:
    """Raise InputError, with the line, for a row whose values no ensemble or constant
    drive can have."""
    for name in file.driven_by:
        raise InputError(f"drive.{name}: not allowed with fit.data, steady values")
    _ = file.ensemble  # its own errors must not name a row
    lines: dict[Any, int] = {}
    for one in table.conditions:
        lines.setdefault(one.changes, one.line)
    for changes, line in lines.items():
        try:
            there = at(file, dict(changes))
            _ = there.ensemble, there.constant_drive
        except InputError as error:
            raise InputError(f"fit.data, line {line}: {error}") from None


def fit(
    file: RunFile | Path | str,
    folder: Path | str | None = None,
    *,
    data: Path | str | None = None,
    starts: int = 8,
    allow_degenerate: bool = False,
    workers: int = 1,
    keep: Path | Keep | None = None,
    progress: Progress = lambda done, total: None,
) -> FitResult:
    """Fit free keys of a run file to measurements.

    Parameters
    ----------
    file : RunFile, Path or str
        Run file with a [fit] section, or its path; `output.seed` draws the starts.
    folder : Path, optional
        Folder that paths in the run file are relative to; by default its own.
    data : Path or str, optional
        Measurements, instead of the section's.
    starts : int
        Points from which a least-squares fit begins: the run file's values, and others
        between the bounds.
    allow_degenerate : bool
        True to go on where the data cannot separate free keys.
    workers : int
        Processes; they change speed, never a number.
    keep : Path or Keep, optional
        A folder for finished least-squares fits: the same fit, if it was stopped, goes
        on from these within 30 days, and removes them when it is finished. `Keep` is
        also told the estimates, before profiles.
    progress : callable, optional
        `progress(done, total)` counts least-squares fits.

    Returns
    -------
    FitResult

    Raises
    ------
    InputError
        If the section or the data cannot be used, free keys cannot be told apart
        whatever the data say, or the reference refuses a start.

    Examples
    --------
    >>> from eqsim import fit
    >>> data = "drive.velocity,friction,friction_stderr\\n1,1.8,0.01\\n2,1.79,0.01\\n"
    >>> free = '[fit]\\nscale = 1.0\\nfree."thresholds.x_star".bounds = [0.1, 10.0]\\n'
    >>> law = '[thresholds]\\nlaw = "delta"\\n[drive]\\nvelocity = 1.0\\n'
    >>> _ = Path("data.csv").write_text(data), Path("x.toml").write_text(law + free)
    >>> found = fit("x.toml", data="data.csv", starts=1)
    >>> print(f"{found.values['thresholds.x_star']:.2f}")
    3.59
    """
    require_integer("starts", starts, 1, 1000)
    require_integer("workers", workers, 1, 1024)
    file = opened(file, folder)
    path = None if data is None else Path(data)
    prepared = prepare(file, path, allow_degenerate)
    every = estimate.starts(prepared.problem, starts, file.output.seed)
    estimate.check_starts(prepared.problem, every)
    prepared.warnings.extend(_singular(prepared.problem, allow_degenerate))
    unfinished = None
    if isinstance(keep, str | Path):
        keep = Keep(Path(keep))
    if keep is not None:
        settings, digest = storage.to_json(file.settings), prepared.table.sha256
        parts = settings, digest, np.array(every).tobytes()
        contents = contents_of(file).values()
        unfinished = storage.unfinished(keep.folder, *parts, *contents)
    with Workers(workers).executor() as executor:
        tasks = Tasks(executor, unfinished, workers)
        told = (lambda result: None) if keep is None else keep.estimated
        result = fit_prepared(prepared, every, tasks, progress, told)
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        return result


def _singular(problem: Problem, allowed: bool) -> list[str]:
    """Warnings of directions that the data do not separate at the start, by the
    eigenvalues of J'J. Raises InputError unless these are allowed."""
    jacobian = problem.jacobian(problem.solved(problem.start).u)
    rungs = estimate.ladder(problem.factors, problem.unitless(jacobian))
    lost = [rung for rung in rungs if rung.ratio < DEGENERATE]
    if lost and not allowed:
        raise InputError(
            f"fit.free: at the start these data do not separate {lost[-1].name} "
            f"(eigenvalue ratio {lost[-1].ratio:.1e} < {DEGENERATE:g}); fix one of "
            "these keys (--allow-degenerate fits all the same)"
        )
    return [f"at the start these data do not separate {rung.name}" for rung in lost]


def _search(problem: Problem) -> Callable[..., Minimum]:
    """The function that searches from one start, for a table or for a record."""
    of_record = isinstance(problem.forward, RecordForward)
    return record.search_record if of_record else estimate.search


def fit_prepared(
    prepared: Prepared,
    every: list[Array],
    tasks: Tasks,
    progress: Progress,
    estimated: Estimated = lambda result: None,
) -> FitResult:
    """Least squares from every start, and profiles about the best fit; where a profile
    finds a better one, least squares again from there. `estimated` as in `Keep`."""
    number = len(prepared.problem.parameters)
    total, done = len(every) + 2 * number, 0

    def count(*_: Any) -> None:
        nonlocal done
        done += 1
        progress(done, total)

    progress(0, total)
    result = _estimates(prepared, every, tasks, count)
    for again in range(_MOST_FITS):
        problem, done = result.problem, len(every)
        result = replace(result, jacobian=problem.jacobian(result.best.u), profiles={})
        estimated(result)
        result = _profiled(result, tasks, f"side{again}", count, estimated)
        sides = [side for pair in result.profiles.values() for side in pair]
        lower = [side.points[np.argmin(side.rise)] for side in sides if side.better]
        if not lower:
            break
        if again + 1 == _MOST_FITS:  # `best` stays what its intervals are about
            said = "profiles go on to find better fits: intervals are not reliable"
            return replace(result, noticed=[*result.noticed, said])
        begin = [(problem, u) for u in lower]
        better = tasks.results(f"better{again}", estimate.minimise, begin)
        best = min([result.best, *better], key=lambda one: one.chi2)
        result = replace(result, best=best)
    return result


def _profiled(
    result: FitResult,
    tasks: Tasks,
    name: str,
    count: Callable[[], None],
    estimated: Estimated,
) -> FitResult:
    """Follow the profiles of all parameters, and report each that is complete."""
    problem, sides = result.problem, dict[int, profiles.Side]()

    def known() -> FitResult:
        pairs = {
            key: [sides[2 * i], sides[2 * i + 1]]
            for i, key in enumerate(problem.keys)
            if {2 * i, 2 * i + 1} <= sides.keys()
        }
        return replace(result, profiles=pairs)

    def keep(index: int, side: profiles.Side) -> None:
        sides[index] = side
        count()
        better = any(one.better for one in sides.values())
        if index ^ 1 in sides and not better:
            estimated(known())

    numbers = range(len(problem.parameters))
    ways = [(i, sign, result.jacobian) for i in numbers for sign in (-1, 1)]
    sought = [(problem, result.best, *way) for way in ways]
    tasks.results(name, profiles.side, sought, keep)
    return known()


def _estimates(
    prepared: Prepared, every: list[Array], tasks: Tasks, count: Callable[..., None]
) -> FitResult:
    """Least squares from every start, and, of a record, again with errors of the
    correlation that residuals show. A search that is alone takes threads."""
    file, section, table, problem, warnings = prepared
    alone, begin = replace(tasks, executor=None), [(problem, u) for u in every]
    with ThreadPool(tasks.threads) as threads:
        each = threads.map if tasks.threads > 1 else map
        search: Callable[..., Minimum] = partial(_search(problem), each=each)
        if len(every) > 1:
            minima = tasks.results("start", _search(problem), begin, count)
        else:
            minima = alone.results("start", search, begin, count)
        best, correlation = min(minima, key=lambda one: one.chi2), None
        for again in range(_WHITENED if table.time is not None else 0):
            assert table.time is not None
            found = partial(record.correlated, t=table.time, each=each)
            begin = [(problem, best.u)]
            ((problem, correlation),) = alone.results(f"errors{again}", found, begin)
            search = partial(estimate.minimise, each=each)
            (best,) = alone.results(f"white{again}", search, [(problem, best.u)])
    return FitResult(
        file=file,
        fit=section,
        problem=problem,
        table=table,
        best=best,
        jacobian=np.empty((0, len(problem.parameters))),
        minima=minima,
        profiles={},
        noticed=warnings,
        correlation=correlation,
    )


def goodness(problem: Problem, u: Array) -> Goodness:
    """Agreement of a problem's data with its parameters `u`."""
    r = problem.whitened(problem.solved(u).predicted)
    n, k = problem.value.size, len(problem.parameters)
    priors = problem.deviations(u)[1][n:]
    dof = n + problem.priors - k
    normal, log_density = r, stats.norm.logpdf(r)
    if problem.loss == "student":
        normal = stats.norm.isf(stats.t.sf(np.abs(r), STUDENT))
        log_density = stats.t.logpdf(r, STUDENT)
    chi2 = float(normal @ normal + priors @ priors)
    deviance = -2.0 * np.sum(log_density - np.log(problem.sigma)) + priors @ priors
    if problem.correlation is not None:
        deviance += np.sum(np.log1p(-(problem.correlation**2)))
    deviance = float(deviance)
    aicc = deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else None
    p = float(stats.chi2.sf(chi2, dof)) if dof > 0 else None
    return Goodness(chi2, dof, p, deviance, aicc, deviance + k * math.log(n))


def rival_of(
    section: Fit, table: Measurements, other: RunFile, starts: int
) -> tuple[Problem, list[Array]]:
    """The fit of another model to the measurements of a section, and its starts. Raises
    InputError."""
    theirs = section_of(other)
    if (theirs.record is None) != (table.time is None):
        raise InputError("--compare: one run file fits a table and the other a record")
    if theirs.temperature != section.temperature:
        raise InputError(
            "--compare: fit.temperature must be the same in both run files"
        )
    for name in table.names:
        if name in theirs.free:
            raise InputError(f"fit.free.{name}: is a column of the data, so not free")
    unit = theirs.reference_temperature or 1.0
    rows = [one._replace(heat=one.kelvin / unit) for one in table.conditions]
    theirs = theirs.model_copy(update={"loss": section.loss})
    if table.time is None:
        _check_rows(other, table)
    problem = problem_of(other, theirs, table._replace(conditions=rows))
    every = estimate.starts(problem, starts, other.output.seed)
    estimate.check_starts(problem, every)
    return problem, every


def compared(result: FitResult, rival: Problem, every: list[Array]) -> Goodness:
    """Agreement of another model, fitted from its starts, with the same measurements
    and errors; of a record on time steps and with a correction of its own."""
    minima = [_search(rival)(rival, u) for u in every]
    best = min(minima, key=lambda one: one.chi2)
    problem = replace(rival, correlation=result.problem.correlation)
    for _ in range(_WHITENED if result.table.time is not None else 0):
        problem = record.corrected(problem, best.u)
        best = estimate.minimise(problem, best.u)
    return goodness(problem, best.u)
