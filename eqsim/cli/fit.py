"""Commands about measurements: fit, design."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Exit, Option

from eqsim.cli.options import Changes, Processes, RunFilePath, Shown, cores
from eqsim.errors import InputError, require_integer, require_package
from eqsim.io import storage
from eqsim.lazy import lazily

with lazily():
    from eqsim.fitting import design as designing
    from eqsim.fitting import fit as fitting
    from eqsim.fitting import posterior, report
    from eqsim.io import runfile

_FIT_FOLDER = "Folder for fit.json, tables, pictures and the best fit's run file."
_ALLOW = "Fit also what the data cannot separate, with a warning."
_VELOCITY_RANGE = (
    "Limits of velocities. Default: ten times beyond the velocities of the data."
)
_TEMPERATURE = "Limits of temperatures, in kelvin. Default: those of the data."
_COMPARE = (
    "Another model of the same data: its chi-square, AICc and BIC beside this one's."
)
_POSTERIOR = (
    "Draw from the posterior, too: posterior.parquet and a picture. "
    "Needs eqsim[posterior]."
)
_CHECK = "Read and draw the measurements, and say how they were understood; no fit."
_Data = Option(metavar="DATA.csv", help="Measurements, instead of fit.data.")
_Fitted = Option("--fit", metavar="DIR", help="Folder of the fit.", show_default=False)
_KEY = "The key to be known better."
_Key = Option("--for", metavar="KEY", help=_KEY, show_default=False)
_Kelvin = Option(metavar="LOW,HIGH", help=_TEMPERATURE)
_Next = Option("--next", help="Number of measurements, chosen one after the other.")
_EXPECTED = (
    "expected by the Fisher information at the best fit, for errors like those of the "
    "data"
)


@dataclass(frozen=True)
class FitOptions:
    """Options of a fit."""

    data: Annotated[Path | None, _Data] = None
    starts: Annotated[int, Option(help="Points from which least squares begin.")] = 8
    compare: Annotated[Path | None, Option(metavar="OTHER.toml", help=_COMPARE)] = None
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
        with shown.bar("reading", "lines") as progress:
            prepared = fitting.prepare(file, options.data, True, progress)
        name, rows = report.write_check(prepared, out, path.stem), report.understood
        shown.report(
            {"read": prepared.table.said, "warnings": prepared.warnings},
            title=file.title or path.stem,
            columns=report.DATA_COLUMNS,
            rows=rows(prepared),
            notes=[*prepared.table.said, *prepared.warnings, f"{out}/: {name}"],
        )
        return
    if options.posterior:
        require_package("posterior", "emcee", "corner")
    other = None if options.compare is None else runfile.load(options.compare)
    with shown.bar("fitting", "fits") as progress:
        how: dict[str, Any] = {"allow_degenerate": options.allow_degenerate}
        how |= {"workers": count, "keep": out, "progress": progress}
        found = fitting.fit(file, data=options.data, starts=options.starts, **how)
        rival = None
        if other is not None:
            rival = fitting.compared(found, other, options.starts)
    files = report.write(found, out, path.stem)
    lines, sampled = list(report.remarks(found)), None
    if options.posterior:
        with shown.bar("drawing", "steps") as progress:
            sampled = posterior.posterior(found, workers=count, progress=progress)
        files += report.write_posterior(found, sampled, out, path.stem)
        lines += report.drawn(sampled)
    data = report.summary(found, sampled)
    if rival is not None:
        data["compare"] = {"file": str(options.compare), **rival._asdict()}
        lines.insert(1, report.quality(str(options.compare), rival))
    shown.report(
        data,
        title=file.title or path.stem,
        columns=report.KEY_COLUMNS,
        rows=report.rows(found),
        notes=[*lines, f"{out}/: {', '.join(files)}"],
    )
    if found.rejected or not found.converged:
        raise Exit(1)


@dataclass(frozen=True)
class DesignOptions:
    """Options of a search for measurements."""

    fitted: Annotated[Path, _Fitted]
    key: Annotated[str, _Key]
    count: Annotated[int, _Next] = 4
    velocity: Annotated[
        str | None, Option(metavar="LOW,HIGH", help=_VELOCITY_RANGE)
    ] = None
    temperature: Annotated[str | None, _Kelvin] = None

    def limits(self, name: str) -> "designing.Limits | None":
        """The ends of an option that is a range."""
        text = getattr(self, name)
        if text is None:
            return None
        try:
            low, high = (float(part) for part in text.split(","))
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
        notes=[_EXPECTED],
    )


def _steps(found: "designing.Design") -> Iterator[tuple[str, str, str, str]]:
    """The rows of the printed table."""
    yield "now", "", "", f"{found.now:.3g}"
    for number, step in enumerate(found.steps, 1):
        kelvin = "" if step.temperature is None else f"{step.temperature:.4g}"
        yield f"+{number}", f"{step.velocity:.3g}", kelvin, f"{step.sd:.3g}"
    yield "all again", "", "", f"{found.repeated:.3g}"
