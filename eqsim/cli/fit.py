"""Commands about measurements: fit, design."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from eqsim.cli.options import Changes, Processes, RunFilePath, Shown, cores
from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_integer,
    require_number,
    require_package,
)
from eqsim.lazy import lazily

with lazily():
    from eqsim.fitting import design as designing
    from eqsim.fitting import fit as fitting
    from eqsim.fitting import posterior, rate_and_state, report, section
    from eqsim.io import runfile, storage

_FIT_FOLDER = "Folder for fit.json, tables, pictures and the best fit's run file."
_ALLOW = "Fit also what the data cannot separate, with a warning."
_VELOCITY_RANGE = (
    "Limits of velocities. Default: ten times beyond the velocities of the data."
)
_TEMPERATURE = "Limits of temperatures, in kelvin. Default: those of the data."
RIVAL = "rate-and-state"  # in the place of the run file of another model
_COMPARE = (
    "Another model of the same data: its chi-square, AICc and BIC beside this one's. "
    "Of a record also rate-and-state, with both laws of its state."
)
_POSTERIOR = "Draw from the posterior, too: posterior.parquet and a picture. Needs eqsim[posterior]."
_CHECK = "Read and draw the measurements, and say how they were understood; no fit."
_Compare = Option(metavar="OTHER.toml|rate-and-state", help=_COMPARE)
_Data = Option(metavar="DATA.csv", help="Measurements, instead of fit.data.")
_Fitted = Option("--fit", metavar="DIR", help="Folder of the fit.", show_default=False)
_KEY = "The key to be known better."
_Key = Option("--for", metavar="KEY", help=_KEY, show_default=False)
_Range = Option(metavar="LOW,HIGH", help=_VELOCITY_RANGE)
_Kelvin = Option(metavar="LOW,HIGH", help=_TEMPERATURE)
_Next = Option("--next", help="Number of measurements, chosen one after the other.")
_LAW = '"slip" (Ruina), "aging" (Dieterich) or "both" laws of the state.'
_STIFFNESS = (
    "Stiffness of the machine, in the record's unit per length. Default: "
    "fit.record.machine_stiffness, else free."
)
_TREND = 'Friction changes in proportion to the "displacement" of the load point, to "time", or not ("none").'
_VELOCITIES = (
    "Of a CSV file: velocities of the load point, one after the other; 0: a hold, not "
    "at first."
)
_AT = (
    "Of a CSV file: times at which the velocity changes, with commas between them; one "
    "fewer than velocities."
)
_COLUMNS = (
    "Of a CSV file: names of the columns of time, force and, unless --noise is given, "
    "standard error. Default: the first three; with --noise only of a file of two."
)
_NOISE = "Of a CSV file: standard error of every point, in quadrature to the file's."
_RSF_FOLDER = "Folder for rate-and-state.json, its table and its picture of residuals."
_RECORD = "CSV file of a record, or a run file with fit.record."
_Record = Argument(metavar="RECORD", help=_RECORD, show_default=False)
_EXPECTED = "expected by the Fisher information at the best fit, for errors like those of the data"


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit."""

    data: Annotated[Path | None, _Data] = None
    starts: Annotated[int, Option(help="Points from which least squares begin.")] = 8
    compare: Annotated[Path | None, _Compare] = None
    posterior: Annotated[bool, Option("--posterior", help=_POSTERIOR)] = False
    allow_degenerate: Annotated[bool, Option("--allow-degenerate", help=_ALLOW)] = False
    check: Annotated[bool, Option("--check", help=_CHECK)] = False


def fit(
    path: RunFilePath,
    out: Annotated[Path, Option(help=_FIT_FOLDER)],
    options: FitOptions,
    changes: Changes,
    workers: Processes = None,
    *,
    shown: Shown,
) -> None:
    """Fit keys of the run file, its [fit] section, to measurements: estimates,
    intervals, and what stays undecided.

    The same command goes on with a fit that was stopped."""
    file = changes.load(path)
    count = cores() if workers is None else workers
    require_integer("--workers", count, 1, 1024)
    require_integer("--starts", options.starts, 1, 1000)
    storage.check_folder(out)
    if options.check:
        _show_data(file, options.data, out, path.stem, shown)
        return
    if options.posterior:
        require_package("posterior", "emcee", "corner")
    other, rivals = None, dict[str, Any]()
    if options.compare == Path(RIVAL):
        rivals = _both_laws(file, options.data)
    elif options.compare is not None:
        theirs = runfile.load(options.compare)
        ours = fitting.prepare(file, options.data, options.allow_degenerate)
        other = fitting.rival_of(ours.fit, ours.table, theirs, options.starts)
    keep = fitting.Keep(out, partial(_tell_estimates, out, shown))
    with shown.bar("fitting", "fits") as progress:
        how: dict[str, Any] = {"allow_degenerate": options.allow_degenerate}
        how |= {"workers": count, "progress": progress, "keep": keep}
        found = fitting.fit(file, data=options.data, starts=options.starts, **how)
        rival = fitting.compared(found, *other) if other else None
    files = report.write(found, out, path.stem)
    lines, sampled = list(report.remarks(found)), None
    if options.posterior:
        with shown.bar("drawing", "steps") as progress:
            sampled = posterior.posterior(found, workers=count, progress=progress)
        files += report.write_posterior(found, sampled, out, path.stem)
        lines += report.drawn(sampled)
    data, cells = report.summary(found, sampled), report.rows(found)
    columns: tuple[str, ...] = report.KEY_COLUMNS
    if rival is not None:
        data["compare"] = {"file": str(options.compare), **rival._asdict()}
        lines.insert(1, report.quality(str(options.compare), rival))
    elif rivals:
        models = {"contacts": found, **rivals}
        data["compare"] = report.summaries(models)
        lines[1:1] = report.model_remarks(models)
        files += report.write_compared(models, out, file.title or path.stem)
        columns, cells = ("model", *columns), report.model_rows(models)
    title, lines = file.title or path.stem, [*lines, f"{out}/: {', '.join(files)}"]
    shown.report(data, title=title, columns=columns, rows=cells, notes=lines)
    if found.rejected or not found.converged:
        raise Exit(1)


def _tell_estimates(out: Path, shown: Shown, result: "fitting.FitResult") -> None:
    """Write the estimates, and, before any profile tells intervals, say them."""
    report.write(result, out, final=False)
    if result.profiles:
        return
    for one in result.intervals:
        shown.note(f"{one.key} = {one.estimate:.4g} ({one.transform}: sd {one.sd:.2g})")
    shown.note(report.quality("this model", result.goodness))
    shown.note(f"{out}/fit.json has these; intervals come with the profiles")


def _show_data(
    file: "runfile.RunFile", data: Path | None, out: Path, name: str, shown: Any
) -> None:
    """Read and draw the measurements, and say how they were understood."""
    with shown.bar("reading", "lines") as progress:
        prepared = fitting.prepare(file, data, True, progress)
    picture = report.write_check(prepared, out, name)
    shown.report(
        {"read": prepared.table.said, "warnings": prepared.warnings},
        title=file.title or name,
        columns=report.DATA_COLUMNS,
        rows=report.understood(prepared),
        notes=[*prepared.table.said, *prepared.warnings, f"{out}/: {picture}"],
    )


def _both_laws(
    file: "runfile.RunFile", data: Path | None
) -> "dict[str, fitting.FitResult]":
    """Rate-and-state friction with both laws of its state, fitted to the record of a
    run file. Raises InputError."""
    if section.section_of(file).record is None:
        raise InputError(f"--compare {RIVAL}: must be of a record, fit.record")
    laws = rate_and_state.LAWS
    return {f"{law} law": rate_and_state.beside(file, law, data) for law in laws}


@dataclass(frozen=True)
class RecordOptions:
    """Options of a record of friction, and of what is fitted to it."""

    law: Annotated[str, Option(help=_LAW)] = "both"
    stiffness: Annotated[float | None, Option(help=_STIFFNESS)] = None
    trend: Annotated[str, Option(help=_TREND)] = "displacement"
    starts: Annotated[int, Option(help="Points from which least squares begin.")] = 8
    velocity: Annotated[str | None, Option(metavar="V,V", help=_VELOCITIES)] = None
    at: Annotated[str | None, Option(metavar="T,...", help=_AT)] = None
    columns: Annotated[str | None, Option(metavar="TIME,FORCE", help=_COLUMNS)] = None
    noise: Annotated[float, Option(help=_NOISE)] = 0.0

    def record(self, path: Path, changes: Changes) -> "runfile.RunFile":
        """The run file of a record, which may be a CSV file. Raises InputError."""
        if path.suffix.lower() == ".toml":
            said = "only of a CSV file; a run file says it itself"
            for name in ("velocity", "at", "columns"):
                if (value := getattr(self, name)) is not None:
                    raise InputError(f"--{name} {value}: {said}")
            if self.noise:
                raise InputError(f"--noise {self.noise:g}: {said}")
            return changes.load(path)
        require_number("--noise", self.noise, **NOT_NEGATIVE)
        if changes.given():
            raise InputError("--set, --seed: change a run file, and this is a record")
        if self.velocity is None:
            said = "is required with a CSV file: velocities of the load point, 3,10"
            raise InputError(f"--velocity: {said}")
        names = self.columns.split(",") if self.columns else ()
        return rate_and_state.record_of(
            path,
            velocities=_numbers("--velocity", self.velocity),
            at=_numbers("--at", self.at) if self.at else (),
            columns=[name.strip() for name in names],
            noise=self.noise,
        )


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        said = "must be numbers with commas between them"
        raise InputError(f"{option} {text}: {said}") from None


def rsf(
    path: Annotated[Path, _Record],
    options: RecordOptions,
    changes: Changes,
    out: Annotated[Path | None, Option(help=_RSF_FOLDER)] = None,
    workers: Processes = None,
    *,
    shown: Shown,
) -> None:
    """Fit rate-and-state friction to a record: a, b, a - b, D_c and the stiffness of the
    machine, with intervals, beside the critical stiffness."""
    file, title = options.record(path, changes), f"{path.stem}: rate-and-state friction"
    count = cores() if workers is None else workers
    if out is not None:
        storage.check_folder(out)
    if options.stiffness is not None:
        require_number("--stiffness", options.stiffness, **POSITIVE)
    require_choice("--law", options.law, ("both", *rate_and_state.LAWS))
    laws = [law for law in rate_and_state.LAWS if options.law in ("both", law)]
    how: dict[str, Any] = {"stiffness": options.stiffness, "trend": options.trend}
    how |= {"starts": options.starts, "workers": count}
    solve: Any = partial(rate_and_state.fit_rate_and_state, file, **how)
    models: dict[str, fitting.FitResult] = {}
    for law in laws:
        with shown.bar(f"{law} law", "fits") as progress:
            found = models[f"{law} law"] = solve(law, progress=progress)
    notes = [*report.model_remarks(models), f"data: {'; '.join(found.table.said)}"]
    if out is not None:
        files = report.write_compared(models, out, title)
        notes.append(f"{out}/: {', '.join(files)}")
    data, rows = report.summaries(models), report.model_rows(models)
    columns = ("law", *report.KEY_COLUMNS)
    shown.report(data, title=title, columns=columns, rows=rows, notes=notes)
    if not all(one.converged and not one.rejected for one in models.values()):
        raise Exit(1)


@dataclass(frozen=True)
class DesignOptions:
    """Options of a search for measurements."""

    fitted: Annotated[Path, _Fitted]
    key: Annotated[str, _Key]
    count: Annotated[int, _Next] = 4
    velocity: Annotated[str | None, _Range] = None
    temperature: Annotated[str | None, _Kelvin] = None

    def limits(self, name: str) -> "designing.Limits | None":
        """The ends of an option that is a range."""
        text = getattr(self, name)
        if text is None:
            return None
        try:
            low, high = map(float, text.split(","))
        except ValueError:
            said = "must be two numbers, LOW,HIGH"
            raise InputError(f"--{name} {text}: {said}") from None
        return designing.Limits(low, high)


def design(
    path: RunFilePath, options: DesignOptions, changes: Changes, *, shown: Shown
) -> None:
    """Propose the next measurements for a key of a fit: velocities and temperatures, and
    how well the key would be known after them."""
    file = changes.load(path)
    require_integer("--next", options.count, 1, 1000)
    limits = options.limits("velocity"), options.limits("temperature")
    found = designing.design(file, options.fitted, options.key, options.count, *limits)
    name = file.title or path.stem
    shown.report(
        {**found._asdict(), "steps": [step._asdict() for step in found.steps]},
        title=f"{name}: the next measurements of friction for {options.key}",
        columns=("", "velocity", "temperature", f"expected sd of {found.variable}"),
        rows=_steps(found),
        notes=_made_at(found),
    )


def _made_at(found: "designing.Design") -> Iterator[str]:
    """The printed lines on what is expected, of which set of the data and at which
    values of other keys."""
    yield _EXPECTED
    if found.set:
        yield f"of set {found.set}"
    if found.at:
        at = ", ".join(f"{key} = {value}" for key, value in found.at.items())
        yield f"at {at} of the run file; --set {next(iter(found.at))}=... for others"


def _steps(found: "designing.Design") -> Iterator[tuple[str, str, str, str]]:
    """The rows of the printed table."""
    yield "now", "", "", f"{found.now:.3g}"
    for number, step in enumerate(found.steps, 1):
        kelvin = "" if step.temperature is None else f"{step.temperature:.4g}"
        yield f"+{number}", f"{step.velocity:.3g}", kelvin, f"{step.sd:.3g}"
    yield "all again", "", "", f"{found.repeated:.3g}"
