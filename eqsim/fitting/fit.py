"""Fits: from a run file with a [fit] section to what its data decide."""

import hashlib
import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from eqsim.errors import InputError, require_integer
from eqsim.fitting import estimate, profiles, symmetry
from eqsim.fitting.data import Table, read_table
from eqsim.fitting.estimate import DEGENERATE, Direction, Kept, Minimum
from eqsim.fitting.model import STUDENT, Problem, problem_of
from eqsim.fitting.record import (
    Correlation,
    correlated,
    read_record,
    record_problem,
    search,
)
from eqsim.fitting.section import Fit, Parameter, parameters_of, scales_of, section_of
from eqsim.io import storage
from eqsim.io.runfile import RunFile, at, opened, path_of
from eqsim.numerics.tables import Array
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.workers import Workers

REJECTED = 1e-3  # p below which a model is rejected
_FLOOR = 0.1  # of a standard error, what the solver may miss
_ROUGH = 0.1  # of a standard deviation, half of a 95 % interval that data cannot have
_AT_BOUND = 1e-3  # of the distance of bounds
_AGAIN = 3  # times that a profile may find a better fit
_WHITENED = 2  # times that residuals tell the correlation of errors

Progress = Callable[[int, float], None]


class Interval(NamedTuple):
    """What is known of a key: its best value, the profile intervals with None for an
    open side, and a status."""

    key: str
    estimate: float
    transform: str
    sd: float
    intervals: dict[str, tuple[float | None, float | None]]
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
    intervals : tuple of Interval
        Of each free key, and of scales.
    goodness : Goodness
    ladder : tuple of Direction
        Eigenvectors of J'J at the best fit.
    covariance : ndarray, shape (parameters, parameters)
        Of the variables of the parameters.
    minima : tuple of Minimum
        One for each start.
    profiles : dict
        The two sides of each key's profile.
    floor : float
        Largest error of the solver over that of a measurement.
    warnings : tuple of str
    seed : int
    correlation : Correlation or None
        Of the errors of a record.
    """

    file: RunFile
    fit: Fit
    problem: Problem
    table: Table
    best: Minimum
    intervals: tuple[Interval, ...]
    goodness: Goodness
    ladder: tuple[Direction, ...]
    covariance: Array
    minima: tuple[Minimum, ...]
    profiles: dict[str, tuple[profiles.Side, profiles.Side]]
    floor: float
    warnings: tuple[str, ...]
    seed: int
    correlation: Correlation | None = None

    @property
    def folder(self) -> Path:
        """The folder in which paths in the run file start."""
        return self.file.folder

    @property
    def values(self) -> dict[str, float]:
        """The best value of each parameter."""
        return {
            one.key: float(one.value(x))
            for one, x in zip(self.problem.parameters, self.best.u, strict=True)
        }

    def to_pandas(self) -> Any:
        """A DataFrame of the keys, one a row: estimate, ends of the 68 and 95 %
        intervals (None: open) and status."""
        import pandas as pd

        ends = {
            f"{side}_{level}": (level, i)
            for level in ("68", "95")
            for i, side in enumerate(("low", "high"))
        }
        rows = {
            one.key: {
                "estimate": one.estimate,
                **{name: one.intervals[level][i] for name, (level, i) in ends.items()},
                "status": one.status,
            }
            for one in self.intervals
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def plot(self) -> Any:
        """A matplotlib Figure of the data, the fitted curves and their bands, and
        residuals."""
        from eqsim.fitting.pictures import fit_figure

        return fit_figure(self, self.file.title)

    def __repr__(self) -> str:
        found = [f"{one.key} {one.estimate:.4g} {one.status}" for one in self.intervals]
        quality = f"chi-square {self.goodness.chi2:.4g} of {self.goodness.dof} degrees of freedom"
        return (
            f"FitResult({', '.join([*found, quality, *['REJECTED'] * self.rejected])})"
        )

    def _repr_html_(self) -> str:
        shown: str = self.to_pandas().to_html()
        return shown

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
    scales, _ = scales_of(section, table.sets)
    if scales and not any(
        name in ("friction", "force_std") for name in table.observable
    ):
        raise InputError("fit.scale: no force was measured; give a fixed scale = 1.0")
    count, needed = table.value.size, len(free) + max(1, len(scales))
    if count < needed:
        raise InputError(
            f"fit.data: has {count} measurements for {len(free)} free keys; at least {needed} are needed"
        )
    seen = {"record"} if table.time is not None else set(table.observable)
    loose = [one for one in free if one.prior is None]
    warnings = symmetry.check(
        symmetry.refused(file, loose, bool(scales), seen), allow_degenerate
    )
    problem = _problem(file, section, table)
    return Prepared(section, table, problem, warnings)


def _measured(file: RunFile, section: Fit, data: Path | None) -> Table:
    """The measurements. Raises InputError."""
    if section.record is not None:
        return read_record(
            data or path_of("fit.record.file", file.folder, section.record.file),
            section,
        )
    if data is None and section.data is None:
        raise InputError("fit.data: is required, the CSV file of measurements")
    table = read_table(
        data or path_of("fit.data", file.folder, str(section.data)), file, section
    )
    _check_drive(file, table)
    _check_rows(file, table)
    return table


def _problem(file: RunFile, section: Fit, table: Table) -> Problem:
    """Of a table or a record. Raises InputError."""
    free, scales = parameters_of(file, section), scales_of(section, table.sets)
    if table.time is not None:
        return record_problem(file, section, table, free, scales)
    return problem_of(file, section, table, free, *scales)


def _check_drive(file: RunFile, table: Table) -> None:
    """Raise InputError unless every measurement has a velocity, and it is constant."""
    for name in ("programme", "file", "stage"):
        if file[f"drive.{name}"] is not None:
            raise InputError(
                f"drive.{name}: not allowed with fit.data, a table of steady observables"
            )
    if file["drive.velocity"] is None and not all(
        "drive.velocity" in dict(row.changes) for row in table.rows
    ):
        raise InputError(
            "drive.velocity: is required, in the run file or in every line of the data"
        )


def _check_rows(file: RunFile, table: Table) -> None:
    """Raise InputError, with the line, for a row whose values no ensemble or drive can
    have."""
    _ = file.ensemble  # what the run file itself has wrong is not a row's fault
    for changes, line in {
        row.changes: row.line for row in reversed(table.rows)
    }.items():
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
        on from these, and removes them when it is finished.
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
    """
    require_integer("starts", starts, 1, 1000)
    require_integer("workers", workers, 1, 1024)
    file = opened(file, folder)
    prepared = prepare(file, None if data is None else Path(data), allow_degenerate)
    problem = prepared.problem
    every = estimate.starts(problem, starts, file.output.seed)
    estimate.check_starts(problem, every)
    warnings = prepared.warnings + _singular(problem, allow_degenerate)
    with Workers(workers).executor() as executor:
        kept = Kept(
            None
            if keep is None
            else Path(keep) / f".unfinished-{_identity(file, prepared, every)}"
        )
        result = _fitted(
            file,
            prepared._replace(warnings=warnings),
            every,
            (executor, kept),
            progress,
        )
        kept.clear()
        return result


def _identity(file: RunFile, prepared: Prepared, every: list[Array]) -> str:
    """A digest of what the numbers of a fit depend on, and of the release of eqsim,
    whose pickled objects are kept."""
    release = storage.versions()["eqsim"]
    parts = [
        release,
        str(RESULTS_VERSION),
        storage.to_json(file.settings),
        prepared.table.sha256,
    ]
    digest = hashlib.sha256(" ".join(parts).encode() + np.array(every).tobytes())
    return digest.hexdigest()[:16]


def _singular(problem: Problem, allowed: bool) -> list[str]:
    """What cannot be told apart at the start, by the eigenvalues of J'J. Raises
    InputError unless it is allowed."""
    u, *_ = problem.solved(problem.start)
    keys = [one.key for one in problem.parameters]
    rungs = estimate.ladder(keys, problem.unitless(problem.jacobian(u)))
    lost = [rung for rung in rungs if rung.ratio < DEGENERATE]
    if lost and not allowed:
        raise InputError(
            f"fit.free: at the start these data do not separate {lost[-1].name} (eigenvalue ratio "
            f"{lost[-1].ratio:.1e} < {DEGENERATE:g}); fix one of these keys (--allow-degenerate fits all the same)"
        )
    return [f"at the start these data do not separate {rung.name}" for rung in lost]


def _fitted(
    file: RunFile,
    prepared: Prepared,
    every: list[Array],
    computed: tuple[Executor | None, Kept],
    progress: Progress,
) -> FitResult:
    section, table, problem, warnings = prepared
    executor, kept = computed
    parameters = problem.parameters
    total, done = len(every) + 2 * len(parameters), 0

    def count() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    progress(0, total)
    first = estimate.minimise if table.time is None else search
    minima = estimate.together(
        first, [(problem, u) for u in every], executor, count, (kept, "start")
    )
    best, correlation = min(minima, key=lambda one: one.chi2), None
    for again in range(_WHITENED if table.time is not None else 0):
        assert table.time is not None
        problem, correlation = correlated(problem, best.u, table.time)
        (best,) = estimate.together(
            estimate.minimise, [(problem, best.u)], None, kept=(kept, f"white{again}")
        )
    for again in range(_AGAIN):
        jacobian = problem.jacobian(best.u)
        covariance = estimate.covariance(jacobian)
        sd = np.sqrt(np.diag(covariance))
        tasks = [
            (problem, best, i, sign, float(sd[i]))
            for i in range(len(parameters))
            for sign in (-1, 1)
        ]
        done = len(every)
        sides = estimate.together(
            profiles.side, tasks, executor, count, (kept, f"side{again}")
        )
        lower = [
            point
            for one in sides
            if one.better
            for point in one.points[[np.argmin(one.rise)]]
        ]
        if not lower:
            break
        better = estimate.together(
            estimate.minimise,
            [(problem, u) for u in lower],
            executor,
            kept=(kept, f"better{again}"),
        )
        best = min([best, *better], key=lambda one: one.chi2)
    pairs = {
        one.key: (sides[2 * i], sides[2 * i + 1]) for i, one in enumerate(parameters)
    }
    intervals = tuple(
        _interval(one, float(x), float(s), *pairs[one.key])
        for one, x, s in zip(parameters, best.u, sd, strict=True)
    )
    _, _, error = problem.solved(best.u)
    floor = float(np.max(error / problem.sigma))
    if floor > _FLOOR:
        warnings = [
            *warnings,
            f"noise floor: the solver's own error is {floor:.2g} of a measurement's standard error",
        ]
    for one, x in zip(parameters, best.u, strict=True):
        for bound in (one.low, one.high):
            if abs(x - bound) < _AT_BOUND * (one.high - one.low):
                place = f"{one.key} is at its bound {float(one.value(bound)):g}"
                warnings = [
                    *warnings,
                    f"{place}: values and intervals of the other keys depend on this bound",
                ]
    rough = [
        one.key
        for one, x, s in zip(parameters, best.u, sd, strict=True)
        if one.low < x < one.high  # at a bound a covariance says nothing
        and any(
            end is not None and abs(end - x) < _ROUGH * s
            for end in (side.ends["95"] for side in pairs[one.key])
        )
    ]
    if rough:
        warnings = [
            *warnings,
            f"intervals of {', '.join(rough)} end at roughness of the solver: not to be trusted",
        ]
    rungs = tuple(
        estimate.ladder([one.key for one in parameters], problem.unitless(jacobian))
    )
    return FitResult(
        file, section, problem, table, best, intervals, goodness(problem, best.u), rungs, covariance,
        tuple(minima), pairs, floor, tuple(warnings), file.output.seed, correlation,
    )  # fmt: skip


def _interval(
    one: Parameter, u: float, sd: float, low: profiles.Side, high: profiles.Side
) -> Interval:
    def ends(name: str) -> tuple[float | None, float | None]:
        left, right = low.ends[name], high.ends[name]
        return (
            None if left is None else float(one.value(left)),
            None if right is None else float(one.value(right)),
        )

    intervals = {name: ends(name) for name in profiles.LEVELS}
    return Interval(
        one.key,
        float(one.value(u)),
        one.transform,
        sd,
        intervals,
        profiles.status(low, high, one.transform),
    )


def goodness(problem: Problem, u: Array) -> Goodness:
    """Of a fit with parameters `u`."""
    _, predicted, _ = problem.solved(u)
    r = problem.white((problem.value - predicted) / problem.sigma)
    residuals = problem.residuals(u)
    n, k = problem.value.size, len(problem.parameters)
    dof = n + problem.priors - k
    normal = (
        r if problem.loss == "gaussian" else -stats.norm.ppf(stats.t.sf(r, STUDENT))
    )
    tested = float(normal @ normal + residuals[n:] @ residuals[n:])
    law = (
        stats.norm.logpdf
        if problem.loss == "gaussian"
        else lambda x: stats.t.logpdf(x, STUDENT)
    )
    deviance = float(
        -2.0 * np.sum(law(r) - np.log(problem.sigma)) + residuals[n:] @ residuals[n:]
    )
    if problem.correlation is not None:
        deviance += float(np.sum(np.log1p(-(problem.correlation**2))))
    aicc = deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else None
    p = float(stats.chi2.sf(tested, dof)) if dof > 0 else None
    return Goodness(tested, dof, p, deviance, aicc, deviance + k * math.log(n))


def derived(result: FitResult) -> dict[str, float]:
    """Groups that the best fit implies: F0 = N k x_* (scale times x_*), v0 = omega x_*,
    b, v_* of annealed contacts, and where the section gives an area or a normal stress,
    contacts per area and their spacing."""
    values = result.values
    changes = {
        key: value for key, value in values.items() if not key.startswith("fit.")
    }
    ensemble = at(result.file, changes).ensemble
    scale = next(
        (value for key, value in values.items() if key.startswith("fit.scale")),
        result.problem.fixed_scale,
    )
    unit = ensemble.thresholds.scale
    found = {"F0 = N k x_*": scale * unit}
    if ensemble.thermal.kT > 0:
        kelvin = result.file.units.kelvin(ensemble.thermal.kT)
        if kelvin is not None:
            found["T of kT (K)"] = kelvin
        found |= {
            "v0 = omega x_*": ensemble.thermal.attempt_frequency * unit,
            "b = k x_*^2/(2 kT)": ensemble.b,
        }
        if ensemble.disorder == "annealed":
            found["v_*"] = ensemble.crossover_velocity
    density = None
    if result.fit.area is not None:
        density = scale / ensemble.stiffness / result.fit.area
    elif result.fit.normal_stress is not None:
        density = scale * result.fit.normal_stress / ensemble.stiffness
    if density is not None:
        found |= {
            "contacts per area": density,
            "spacing of contacts": 1.0 / math.sqrt(density),
        }
    return {name: float(value) for name, value in found.items()}


def compared(result: FitResult, other: RunFile, starts: int) -> Goodness:
    """How well another model describes the same measurements with the same errors.
    Raises InputError."""
    section = section_of(other)
    if (section.record is None) != (result.table.time is None):
        raise InputError(
            "--compare: one of the run files fits a table and the other a record"
        )
    problem = _problem(
        other,
        section.model_copy(update={"loss": result.fit.loss}),
        result.table,
    )
    problem = replace(problem, correlation=result.problem.correlation)
    every = estimate.starts(problem, starts, other.output.seed)
    estimate.check_starts(problem, every)
    minima = [
        (estimate.minimise if result.table.time is None else search)(problem, u)
        for u in every
    ]
    return goodness(problem, min(minima, key=lambda one: one.chi2).u)
