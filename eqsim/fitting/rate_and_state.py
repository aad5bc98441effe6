"""Fits of rate-and-state friction to records, with the same errors, intervals and
chi-square as those of contacts."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_integer,
    require_number,
    shown,
)
from eqsim.fitting import estimate, profiles
from eqsim.fitting.data import Measurements
from eqsim.fitting.estimate import Each
from eqsim.fitting.fit import (
    FitResult,
    Interval,
    Prepared,
    Progress,
    fit_prepared,
    interval_of,
    measured,
)
from eqsim.fitting.model import Problem
from eqsim.fitting.record import (
    RecordForward,
    programme_of,
    read_record,
    without_fixed,
)
from eqsim.fitting.section import Fit, Parameter, section_of
from eqsim.io.csv import read
from eqsim.io.runfile import RunFile, check, opened
from eqsim.master.slider import TooManySteps
from eqsim.numerics.tables import Array
from eqsim.rate_and_state import RateAndState, StateLaw, require_programme
from eqsim.sweeps.workers import Workers

LAWS: tuple[StateLaw, ...] = ("slip", "aging")
Trend = Literal["displacement", "time", "none"]
# Parameters that may stand in the place of b, for the sake of their intervals; then that
# of a is the smaller of both, so that no value of the others makes one negative.
DIFFERENCE = "a-b"
CRITICAL = "(b-a)/D_c"
SMALLER = "min(a, b)"
# Error of predictions over a (tests).
_SOLVER_ERROR = 1e-8


@dataclass(frozen=True)
class RateAndStateForward(RecordForward):
    """Rate-and-state friction at the times of a record, but for mu_0. The stiffness of
    the machine, if given, is not free. Nothing depends on steps of a solver."""

    law: StateLaw = "slip"

    def at(self, values: dict[str, float]) -> RateAndState:
        """The law with these parameters. Raises InputError."""
        D_c, k = values["D_c"], self.machine_stiffness or values["k"]
        if SMALLER not in values:
            return RateAndState(values["a"], values["b"], D_c, k, self.law)
        # one of both is 0
        difference = values.get(DIFFERENCE, 0.0) - values.get(CRITICAL, 0.0) * D_c
        a, b = (values[SMALLER] + max(x, 0.0) for x in (difference, -difference))
        return RateAndState(a, b, D_c, k, self.law)

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        law = self.at(changes)
        try:
            force = law.friction(programme_of(self.file), self.time)
        except InputError as error:  # unstable here, but a search may leave
            raise TooManySteps(str(error)) from None
        return force, np.full(force.size, _SOLVER_ERROR * law.a)

    def corrected(
        self, changes: dict[str, float], each: Each = map
    ) -> "RateAndStateForward":
        return self

    def settle_steps(self, changes: dict[str, float]) -> "RateAndStateForward":
        return self


@dataclass(frozen=True, repr=False)
class RateAndStateFit(FitResult):
    """Rate-and-state friction fitted to a record: a `FitResult` for a, b, D_c, k (unless
    the machine's stiffness is given), mu_0 and the trend.

    Attributes
    ----------
    differences : list of Interval
        Of a - b and of the critical stiffness (b - a)/D_c, among the intervals, too.
    """

    differences: list[Interval] = field(default_factory=list)

    @property
    def law(self) -> RateAndState:
        """The law at the best fit, with mu_0."""
        assert isinstance(self.problem.forward, RateAndStateForward)
        law = self.problem.forward.at(self.values)
        return replace(law, mu_0=self.values["mu_0"])

    @property
    def derived(self) -> dict[str, float]:
        """The stiffness of the machine over the critical one, where there is one."""
        k, critical = self.law.stiffness, self.law.critical_stiffness
        return {"k over critical": k / critical} if critical > 0 else {}

    @cached_property
    def intervals(self) -> list[Interval]:
        return [*super().intervals, *self.differences]


def fit_rate_and_state(
    file: RunFile | Path | str,
    law: StateLaw = "slip",
    *,
    data: Path | str | None = None,
    stiffness: float | None = None,
    trend: Trend = "displacement",
    starts: int = 8,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> RateAndStateFit:
    """Fit rate-and-state friction to a record.

    Parameters
    ----------
    file : RunFile, Path or str
        Run file with a section fit.record, or its path: record, errors and programme of
        the load point are taken from it, and nothing else but the stiffness of the
        machine; or what `record_of` makes of a CSV file.
    law : str
        "slip" or "aging".
    data : Path or str, optional
        The record, instead of the run file's.
    stiffness : float, optional
        k of the machine (unit of the record per length), instead of the run file's
        fit.record.machine_stiffness; without both it is free.
    trend : str
        From the first point on friction changes in proportion to the "displacement" of
        the load point, to "time", or not ("none").
    starts, workers, progress
        As in `fit`.

    Returns
    -------
    RateAndStateFit

    Raises
    ------
    InputError
        If the record cannot be used or its programme has no answer.

    Examples
    --------
    >>> from eqsim import Programme, RateAndState, Segment
    >>> step = Programme([Segment(1.0, time=20.0), Segment(10.0, time=30.0)])
    >>> t = np.linspace(0.0, 50.0, 101)
    >>> truth = RateAndState(a=0.01, b=0.015, D_c=10.0, stiffness=0.01, mu_0=0.6)
    >>> lines = [f"{x},{mu},1e-4" for x, mu in zip(t, truth.friction(step, t))]
    >>> _ = Path("step.csv").write_text("\\n".join(["t,mu,error", *lines]))
    >>> record = record_of("step.csv", velocities=[1.0, 10.0], at=[20.0])
    >>> found = fit_rate_and_state(record, starts=1)
    >>> print(f"{found.law.D_c:.2f} {found.law.critical_stiffness:.5f}")
    10.00 0.00050
    """
    require_choice("law", law, LAWS)
    require_choice("trend", trend, get_args(Trend))
    require_integer("starts", starts, 1, 1000)
    require_integer("workers", workers, 1, 1024)
    if stiffness is not None:
        require_number("stiffness", stiffness, **POSITIVE)
    file = opened(file)
    section = section_of(file)
    if section.record is None:
        said = "is required; rate-and-state friction is fitted to a record"
        raise InputError(f"fit.record: {said}")
    table = measured(file, section, None if data is None else Path(data), progress)
    stiffness = stiffness or section.record.machine_stiffness
    trends: dict[str, Trend] = {} if trend == "none" else {"trend": trend}
    problem = problem_of(file, table, law, trends, stiffness)
    prepared = Prepared(file, section, table, problem, [])
    return _solved(prepared, starts, workers, progress)


def beside(file: RunFile, law: StateLaw, data: Path | None) -> RateAndStateFit:
    """Fit rate-and-state friction to a record as the contacts of a run file are fitted:
    less offsets and trends that are fixed, and with those trends that are free.
    Raises InputError."""
    section = section_of(file)
    assert section.record is not None
    table = measured(file, section, data)
    trends: dict[str, Trend] = {}
    if section.trend is not None and "fit.trend" in section.free:
        trends["trend"] = section.trend.per
    if "fit.drift" in section.free:
        trends["drift"] = "time"
    bare = table._replace(value=without_fixed(file, section, table))
    problem = problem_of(file, bare, law, trends, section.record.machine_stiffness)
    return _solved(Prepared(file, section, table, problem, []))


def _solved(
    prepared: Prepared,
    starts: int = 8,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> RateAndStateFit:
    """Least squares from every start, with the loss of the section, and intervals.
    Raises InputError."""
    problem = replace(prepared.problem, loss=prepared.fit.loss)
    prepared = prepared._replace(problem=problem)
    if problem.value.size <= len(problem.parameters):
        count, free = problem.value.size, len(problem.parameters)
        raise InputError(f"fit.record: has {count} points for {free} parameters")
    every = estimate.starts(problem, starts, prepared.file.output.seed)
    estimate.check_starts(problem, every)
    with Workers(workers).executor() as executor:
        tasks = estimate.Tasks(executor)
        found = fit_prepared(prepared, every, tasks, progress)
    differences = [_difference(found, key) for key in (DIFFERENCE, CRITICAL)]
    fields = {one.name: getattr(found, one.name) for one in dataclasses.fields(found)}
    return RateAndStateFit(**fields, differences=differences)


def problem_of(
    file: RunFile,
    table: Measurements,
    law: StateLaw,
    trends: Mapping[str, Trend],
    stiffness: float | None = None,
) -> Problem:
    """The fit of a record, with bounds and starts in its own units; the stiffness of the
    machine is free unless it is given, and so are `trends` by name. Raises
    InputError."""
    programme, t = programme_of(file), table.time
    assert t is not None
    require_programme(programme, t)
    along = {"displacement": programme.position(t), "time": t}
    unit = float(np.abs(table.value).max())
    length = float(np.ptp(along["displacement"]))
    if not unit * length > 0:
        raise InputError("fit.record: nothing moves, or all forces are 0")
    k = unit / length
    parameters = [
        _parameter("a", 1e-5 * unit, unit, 0.01 * unit),
        _parameter("b", 1e-5 * unit, unit, 0.01 * unit),
        _parameter("D_c", 1e-5 * length, 10.0 * length, 0.03 * length),
        *([] if stiffness else [_parameter("k", 1e-2 * k, 1e4 * k, 5.0 * k)]),
        Parameter("mu_0", "linear", -10.0 * unit, 10.0 * unit, unit, linear=True),
    ]
    nuisance = {"mu_0": np.ones(t.size)}
    for name, per in trends.items():
        x = along[per]
        nuisance[name] = x - x[0]
        most = 10.0 * unit / float(np.ptp(x))
        parameters.append(Parameter(name, "linear", -most, most, 0.0, linear=True))
    return Problem(
        forward=RateAndStateForward(file, t, stiffness, 1.0, law=law),
        parameters=parameters,
        value=table.value,
        sigma=table.sigma,
        scale_of=np.full(t.size, -1),
        unit=np.ones(t.size),
        spread=np.zeros(t.size, bool),
        nuisance=nuisance,
    )


def _parameter(key: str, low: float, high: float, start: float) -> Parameter:
    return Parameter(key, "log", math.log(low), math.log(high), math.log(start))


def _difference(found: FitResult, key: str) -> Interval:
    """The profile interval of a - b or (b - a)/D_c, a parameter in the place of b."""
    values, problem, u = found.values, found.problem, found.best.u.copy()
    most = float(np.abs(problem.value).max())
    value = values["a"] - values["b"]
    if key == CRITICAL:
        most, value = most / values["D_c"], -value / values["D_c"]
    first, index = (problem.keys.index(name) for name in "ab")
    one = Parameter(key, "linear", -most, most, value)
    parameters = [*problem.parameters]
    parameters[first] = parameters[first]._replace(key=SMALLER)
    parameters[index] = one
    u[first], u[index] = min(u[first], u[index]), value
    problem = replace(problem, parameters=parameters)
    best, jacobian = found.best._replace(u=u), problem.jacobian(u)
    sd = math.sqrt(estimate.covariance(jacobian)[index, index])
    sides = [profiles.side(problem, best, index, sign, jacobian) for sign in (-1, 1)]
    return interval_of(one, value, sd, sides)


def record_of(
    path: Path | str,
    *,
    velocities: Sequence[float],
    at: Sequence[float] = (),
    columns: Sequence[str] = (),
    noise: float = 0.0,
) -> RunFile:
    """Make the run file of a record from a CSV file alone.

    Parameters
    ----------
    path : Path or str
        CSV file with columns of time, force and, unless there is `noise`, of standard
        errors.
    velocities : sequence of float
        Velocities of the load point, one after the other; 0 is a hold, not at first.
    at : sequence of float
        When it changes from one to the next (time).
    columns : sequence of str
        Names of the two or three columns; by default the first three, and of a file of
        two with `noise` both.
    noise : float
        Standard error of every point, in quadrature to that of the file.

    Raises
    ------
    InputError
        If the file cannot be read, or velocities and times do not belong together.

    Examples
    --------
    >>> _ = Path("step.csv").write_text("t,mu\\n0,0.6\\n1,0.61\\n2,0.6\\n")
    >>> record = record_of("step.csv", velocities=[1, 10], at=[0.5], noise=1e-3)
    >>> record.drive.segments[1].time
    1.5
    """
    require_number("noise", noise, **NOT_NEGATIVE)
    if len(velocities) == 0:
        raise InputError("velocities = []: must hold one velocity at least")
    if not velocities[0] > 0:
        said = "the first must be > 0; rate-and-state friction begins in steady sliding"
        raise InputError(f"velocity = {velocities[0]:g}: {said}")
    path = Path(path)
    given = f"at = {shown(list(at))}"
    if len(velocities) != len(at) + 1:
        said = "one time for each change of the velocity"
        raise InputError(f"{given}: must be {len(velocities) - 1}, {said}")
    sheet, names = read(path, f"record = {path}"), list(columns)
    if not names:
        sheet.require_names()
        names = sheet.columns[:3]
        if noise and len(names) == 3:
            said = f"must be given with noise, as {names[2]} may be an error or not"
            raise InputError(f"columns: {said}")
    if not (len(names) == 3 or (len(names) == 2 and noise)):
        said = "must be those of time, force and, unless there is noise, standard error"
        raise InputError(f"columns = {shown(names)}: {said}")
    for name in names:
        sheet.index(name, f" (columns = {shown(names)})")
    record = dict(zip(("time", "force", "stderr"), names, strict=False))
    section = {
        "record": {"file": path.name, **record},
        "noise": {"absolute": noise},
    }
    time = read_record(path, Fit.model_validate(section), field="record").time
    assert time is not None
    ends = np.array([0.0, *at, time[-1]])
    if not np.all(np.diff(ends) > 0):
        said = f"must ascend between 0 and {time[-1]:g}, the end of the record"
        raise InputError(f"{given}: {said}")
    programme = [
        {"velocity": float(v), "time": duration} if v else {"hold": duration}
        for v, duration in zip(velocities, np.diff(ends).tolist(), strict=True)
    ]
    # a section [fit] has something free; here it is what a contact model would add
    free = {"fit.offset": {"bounds": [-1.0, 1.0]}}
    content = {
        "title": path.stem,
        "drive": {
            "start": "stationary",
            "velocity": float(velocities[0]),
            "programme": programme,
        },
        "fit": {**section, "free": free},
    }
    return check(content, path.parent)
