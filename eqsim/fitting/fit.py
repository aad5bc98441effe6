"""Fits: from a run file with a [fit] section to what its data decide."""

import hashlib
import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from eqsim.errors import InputError, require_integer
from eqsim.fitting import estimate, profiles, symmetry
from eqsim.fitting.data import Table, read_table
from eqsim.fitting.estimate import DEGENERATE, Direction, Minimum, Tasks
from eqsim.fitting.model import STUDENT, Problem, problem_of
from eqsim.fitting.record import (
    Correlation,
    correlated,
    read_record,
    record_problem,
    search,
)
from eqsim.fitting.section import Fit, parameters_of, section_of
from eqsim.io import storage
from eqsim.io.runfile import RunFile, at, opened, path_of
from eqsim.numerics.tables import Array
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.workers import Workers

# p below which a model is rejected.
REJECTED = 1e-3
# Error of the solver over that of a measurement from which on there is a warning.
_NOISE_FLOOR = 0.1
# Half of a 95 % interval over the standard deviation, which data cannot make smaller.
_NARROW = 0.1
# Distance from a bound, over that of the bounds, at which a parameter is there.
_AT_BOUND = 1e-3
# How often a profile may find a better fit.
_MOST_FITS = 3
# How often residuals tell the correlation of errors.
_WHITENED = 2
# Seconds after which results of a fit that was stopped are removed, 30 days.
_FORGOTTEN = 30 * 86400.0

Progress = Callable[[int, float], None]


class Interval(NamedTuple):
    """What is known of a key: its best value, the profile intervals with None for an
    open side, and a status."""

    key: str
    estimate: float
    transform: str
    sd: float
    intervals: dict[str, tuple[float | None, ...]]
    status: str


class Goodness(NamedTuple):
    """How well a model describes data: chi-square (priors included), degrees of
    freedom, the probability of more (None without degrees of freedom), -2 ln L, and the
    criteria of Akaike (corrected) and Bayes."""

    chi2: float
    dof: int
    p: float | None
    deviance: float
    aicc: float | None
    bic: float


@dataclass(frozen=True, repr=False)
class FitResult:
    """What data say about a model.

    Attributes
    ----------
    file : RunFile
    fit : Fit
        Its [fit] section.
    problem : Problem
    table : Table
    best : Minimum
    jacobian : ndarray, shape (measurements + priors, parameters)
        J, at the best fit.
    minima : list of Minimum
        One for each start.
    profiles : dict
        The two sides of each key's profile.
    noticed : list of str
        Warnings from before the fit.
    correlation : Correlation or None
        Of the errors of a record.
    """

    file: RunFile
    fit: Fit
    problem: Problem
    table: Table
    best: Minimum
    jacobian: Array
    minima: list[Minimum]
    profiles: dict[str, list[profiles.Side]]
    noticed: list[str]
    correlation: Correlation | None = None

    @property
    def folder(self) -> Path:
        """The folder in which paths in the run file start."""
        return self.file.folder

    @property
    def values(self) -> dict[str, float]:
        """The best value of each parameter."""
        return self.problem.values(self.best.u)

    @property
    def changes(self) -> dict[str, float]:
        """The best values of the free keys of the run file."""
        best = self.values.items()
        return {key: value for key, value in best if not key.startswith("fit.")}

    @property
    def seed(self) -> int:
        """What draws starts and posterior."""
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
        return estimate.ladder(self.problem.keys, jacobian)

    @cached_property
    def goodness(self) -> Goodness:
        """How well the best fit describes the data."""
        return goodness(self.problem, self.best.u)

    @cached_property
    def floor(self) -> float:
        """Largest error of the solver over that of a measurement."""
        error = self.problem.solved(self.best.u).error
        return float(np.max(error / self.problem.sigma))

    @cached_property
    def intervals(self) -> list[Interval]:
        """What is known of each free key, and of scales."""
        sd, found = np.sqrt(np.diag(self.covariance)).tolist(), []
        for one, error in zip(self.problem.parameters, sd, strict=True):
            low, high = self.profiles[one.key]
            status = profiles.status(low, high, one.transform)
            ends = {
                name: tuple(one.value_or_none(side.ends[name]) for side in (low, high))
                for name in profiles.LEVELS
            }
            best = self.values[one.key]
            found.append(Interval(one.key, best, one.transform, error, ends, status))
        return found

    @cached_property
    def warnings(self) -> list[str]:
        """What was noticed before the fit, and doubts about its numbers."""
        found, rough = [*self.noticed], []
        if self.floor > _NOISE_FLOOR:
            found.append(
                f"noise floor: the solver's own error is {self.floor:.2g} of a "
                "measurement's standard error"
            )
        for one, x, known in zip(
            self.problem.parameters, self.best.u, self.intervals, strict=True
        ):
            for bound in (one.low, one.high):
                if abs(x - bound) < _AT_BOUND * (one.high - one.low):
                    found.append(
                        f"{one.key} is at its bound {float(one.value(bound)):g}: "
                        "values and intervals of the other keys depend on this bound"
                    )
            ends = [side.ends["95"] for side in self.profiles[one.key]]
            nearest = min((abs(u - x) for u in ends if u is not None), default=math.inf)
            # at a bound a covariance says nothing
            if one.low < x < one.high and nearest < _NARROW * known.sd:
                rough.append(one.key)
        if rough:
            found.append(
                f"intervals of {', '.join(rough)} end at roughness of the solver: not "
                "to be trusted"
            )
        return found

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
        return f"FitResult({', '.join(said)})"

    def _repr_html_(self) -> str:
        return str(self.to_pandas().to_html())

    @property
    def converged(self) -> bool:
        """Whether any start did."""
        return any(one.converged for one in self.minima)

    @property
    def rejected(self) -> bool:
        """Whether the best fit is too far from the data for their errors."""
        return self.goodness.p is not None and self.goodness.p < REJECTED


class Prepared(NamedTuple):
    """A fit before the work: its section, measurements and problem, and what was
    noticed."""

    fit: Fit
    table: Table
    problem: Problem
    warnings: list[str]


def prepare(file: RunFile, data: Path | None, allow_degenerate: bool) -> Prepared:
    """Read and check what a fit needs. Raises InputError."""
    section = section_of(file)
    free = parameters_of(file, section)
    table = _measured(file, section, data)
    _ = file.ensemble
    scales, _ = section.scales(table.sets)
    if scales and not {"friction", "force_std"} & set(table.observable):
        raise InputError("fit.scale: no force was measured; give a fixed scale = 1.0")
    count, needed = table.value.size, len(free) + max(1, len(scales))
    if count < needed:
        raise InputError(
            f"fit.data: has {count} measurements for {len(free)} free keys; "
            f"at least {needed} are needed"
        )
    seen = {"record"} if table.time is not None else set(table.observable)
    loose = [one for one in free if one.prior is None]
    reasons = symmetry.refused(file, loose, bool(scales), seen)
    warnings = symmetry.check(reasons, allow_degenerate)
    problem = _problem(file, section, table)
    return Prepared(section, table, problem, warnings)


def _measured(file: RunFile, section: Fit, data: Path | None) -> Table:
    """The measurements. Raises InputError."""
    if section.record is not None:
        path = data or path_of("fit.record.file", file.folder, section.record.file)
        return read_record(path, section)
    if data is None and section.data is None:
        raise InputError("fit.data: is required, the CSV file of measurements")
    path = data or path_of("fit.data", file.folder, str(section.data))
    table = read_table(path, file, section)
    _check_rows(file, table)
    return table


def _problem(file: RunFile, section: Fit, table: Table) -> Problem:
    """The fit of a table or a record. Raises InputError."""
    make = problem_of if table.time is None else record_problem
    return make(file, section, table, parameters_of(file, section))


def _check_rows(file: RunFile, table: Table) -> None:
    """Raise InputError, with the line, for a row whose values no ensemble or constant
    drive can have."""
    for name in ("programme", "file", "stage"):
        if file[f"drive.{name}"] is not None:
            raise InputError(
                f"drive.{name}: not allowed with fit.data, a table of steady values"
            )
    _ = file.ensemble  # what the run file itself has wrong is not a row's fault
    lines = {row.changes: row.line for row in reversed(table.rows)}
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
    keep: Path | None = None,
    progress: Progress = lambda done, total: None,
) -> FitResult:
    """Fit free keys of a run file to measurements.

    Parameters
    ----------
    file : RunFile, Path or str
        With a [fit] section, or the path of one; `output.seed` draws the starts.
    folder : Path, optional
        That paths in the run file are relative to; by default its own folder.
    data : Path or str, optional
        Measurements, instead of the section's.
    starts : int
        Points from which a least-squares fit begins: the run file's values, and others
        between the bounds.
    allow_degenerate : bool
        Whether to go on where the data cannot separate free keys.
    workers : int
        Processes; they change speed, never a number.
    keep : Path, optional
        A folder for finished least-squares fits: the same fit, if it was stopped, goes
        on from these within 30 days, and removes them when it is finished.
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
    if keep is not None:
        unfinished = _unfinished(Path(keep), _identity(file, prepared, every))
    with Workers(workers).executor() as executor:
        tasks = Tasks(executor, unfinished)
        result = _fitted(file, prepared, every, tasks, progress)
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        return result


def _identity(file: RunFile, prepared: Prepared, every: list[Array]) -> str:
    """A digest of what the numbers of a fit depend on, and of the release of eqsim,
    whose pickled objects are kept."""
    release, digest = storage.versions()["eqsim"], prepared.table.sha256
    parts = [release, str(RESULTS_VERSION), storage.to_json(file.settings), digest]
    content = " ".join(parts).encode() + np.array(every).tobytes()
    return hashlib.sha256(content).hexdigest()[:16]


def _unfinished(out: Path, identity: str) -> Path:
    """The folder for results of a fit that may be stopped. Those that no fit has added
    to for long are removed."""
    for old in out.glob(".unfinished-*"):
        if time.time() - old.stat().st_mtime > _FORGOTTEN:
            shutil.rmtree(old, ignore_errors=True)
    return out / f".unfinished-{identity}"


def _singular(problem: Problem, allowed: bool) -> list[str]:
    """What cannot be told apart at the start, by the eigenvalues of J'J. Raises
    InputError unless it is allowed."""
    jacobian = problem.jacobian(problem.solved(problem.start).u)
    rungs = estimate.ladder(problem.keys, problem.unitless(jacobian))
    lost = [rung for rung in rungs if rung.ratio < DEGENERATE]
    if lost and not allowed:
        raise InputError(
            f"fit.free: at the start these data do not separate {lost[-1].name} "
            f"(eigenvalue ratio {lost[-1].ratio:.1e} < {DEGENERATE:g}); fix one of "
            "these keys (--allow-degenerate fits all the same)"
        )
    return [f"at the start these data do not separate {rung.name}" for rung in lost]


def _fitted(
    file: RunFile,
    prepared: Prepared,
    every: list[Array],
    tasks: Tasks,
    progress: Progress,
) -> FitResult:
    """Least squares from every start, and profiles about the best one, which is sought
    again from where a profile finds a better one."""
    section, table, problem, warnings = prepared
    number = len(problem.parameters)
    total, done = len(every) + 2 * number, 0

    def count() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    progress(0, total)
    first = estimate.minimise if table.time is None else search
    minima = tasks.results("start", first, [(problem, u) for u in every], count)
    best, correlation = min(minima, key=lambda one: one.chi2), None
    alone = replace(tasks, executor=None)
    for again in range(_WHITENED if table.time is not None else 0):
        assert table.time is not None
        problem, correlation = correlated(problem, best.u, table.time)
        begin = [(problem, best.u)]
        (best,) = alone.results(f"white{again}", estimate.minimise, begin)
    for again in range(_MOST_FITS):
        jacobian = problem.jacobian(best.u)
        sd = np.sqrt(np.diag(estimate.covariance(jacobian))).tolist()
        ways = [(i, sign) for i in range(number) for sign in (-1, 1)]
        sought = [(problem, best, i, sign, sd[i]) for i, sign in ways]
        done = len(every)
        sides = tasks.results(f"side{again}", profiles.side, sought, count)
        lower = [one.points[np.argmin(one.rise)] for one in sides if one.better]
        if not lower:
            break
        begin = [(problem, u) for u in lower]
        better = tasks.results(f"better{again}", estimate.minimise, begin)
        best = min([best, *better], key=lambda one: one.chi2)
    return FitResult(
        file=file,
        fit=section,
        problem=problem,
        table=table,
        best=best,
        jacobian=jacobian,
        minima=minima,
        profiles={key: sides[2 * i :][:2] for i, key in enumerate(problem.keys)},
        noticed=warnings,
        correlation=correlation,
    )


def goodness(problem: Problem, u: Array) -> Goodness:
    """How well a fit with parameters `u` describes its data."""
    predicted = problem.solved(u).predicted
    r = problem.white((problem.value - predicted) / problem.sigma)
    n, k = problem.value.size, len(problem.parameters)
    priors = problem.residuals(u)[n:]
    dof = n + problem.priors - k
    normal, log_density = r, stats.norm.logpdf(r)
    if problem.loss == "student":
        normal = -stats.norm.ppf(stats.t.sf(r, STUDENT))
        log_density = stats.t.logpdf(r, STUDENT)
    chi2 = float(normal @ normal + priors @ priors)
    deviance = -2.0 * np.sum(log_density - np.log(problem.sigma)) + priors @ priors
    if problem.correlation is not None:
        deviance += np.sum(np.log1p(-(problem.correlation**2)))
    deviance = float(deviance)
    aicc = deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else None
    p = float(stats.chi2.sf(chi2, dof)) if dof > 0 else None
    return Goodness(chi2, dof, p, deviance, aicc, deviance + k * math.log(n))


def derived(result: FitResult) -> dict[str, float]:
    """Groups that the best fit implies: F0 = N k x_* (scale times x_*), v0 = omega x_*,
    b, v_* of annealed contacts, and where the section gives an area or a normal stress,
    contacts per area and their spacing."""
    ensemble = at(result.file, result.changes).ensemble
    thermal, unit = ensemble.thermal, ensemble.thresholds.scale
    scales, scale = result.fit.scales(result.table.sets)
    if scales:
        scale = result.values[scales[0].key]
    found = {"F0 = N k x_*": scale * unit}
    if thermal.kT > 0:
        kelvin = result.file.units.kelvin(thermal.kT)
        if kelvin is not None:
            found["T of kT (K)"] = kelvin
        found["v0 = omega x_*"] = thermal.attempt_frequency * unit
        found["b = k x_*^2/(2 kT)"] = ensemble.b
        if ensemble.disorder == "annealed":
            found["v_*"] = ensemble.crossover_velocity
    area, stress = result.fit.area, result.fit.normal_stress
    per_area = 1.0 / area if area is not None else stress
    if per_area is not None:
        density = scale / ensemble.stiffness * per_area
        found["contacts per area"] = density
        found["spacing of contacts"] = 1.0 / math.sqrt(density)
    return {name: float(value) for name, value in found.items()}


def compared(result: FitResult, other: RunFile, starts: int) -> Goodness:
    """How well another model describes the same measurements with the same errors.
    Raises InputError."""
    section = section_of(other)
    if (section.record is None) != (result.table.time is None):
        raise InputError("--compare: one run file fits a table and the other a record")
    section = section.model_copy(update={"loss": result.fit.loss})
    problem = _problem(other, section, result.table)
    problem = replace(problem, correlation=result.problem.correlation)
    every = estimate.starts(problem, starts, other.output.seed)
    estimate.check_starts(problem, every)
    first = estimate.minimise if result.table.time is None else search
    minima = [first(problem, u) for u in every]
    return goodness(problem, min(minima, key=lambda one: one.chi2).u)
