"""Commands that go from measurements to parameters: fit, design."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Exit, Option

from eqsim.cli.options import Changes, Processes, RunFilePath, Shown, cores
from eqsim.errors import require_integer

if TYPE_CHECKING:
    pass

_ALLOW = "Fit also what the data cannot separate, with a warning."
_COMPARE = "Another model of the same data: its chi-square, AICc and BIC beside this one's."


@dataclass(frozen=True)
class FitOptions:
    """How a fit is made."""

    data: Annotated[Path | None, Option(metavar="DATA.csv", help="Measurements, instead of fit.data.")] = None
    starts: Annotated[int, Option(help="Points from which least squares begin.")] = 8
    compare: Annotated[Path | None, Option(metavar="OTHER.toml", help=_COMPARE)] = None
    allow_degenerate: Annotated[bool, Option("--allow-degenerate", help=_ALLOW)] = False


def fit(
    path: RunFilePath,
    out: Annotated[Path, Option(help="Folder for fit.json, tables, pictures and the run file of the best fit.")],
    options: FitOptions,
    changes: Changes,
    workers: Processes = None,
    *,
    shown: Shown,
) -> None:
    """Fit keys of the run file, its [fit] section, to measurements: estimates, intervals, and what stays undecided."""
    file = changes.load(path)
    count = cores() if workers is None else workers
    require_integer("--workers", count, 1, 1024)
    require_integer("--starts", options.starts, 1, 1000)
    from eqsim.fitting import fit as fitting
    from eqsim.fitting import report
    from eqsim.io import storage
    from eqsim.io.runfile import load

    storage.check_folder(out)
    other = None if options.compare is None else load(options.compare)
    with shown.bar("fitting", "fits") as progress:
        found = fitting.fit(
            file, path.parent, data=options.data, starts=options.starts, workers=count,
            allow_degenerate=options.allow_degenerate, progress=progress,
        )  # fmt: skip
        rival = None
        if options.compare is not None and other is not None:
            rival = fitting.compared(found, other, options.compare.parent, options.starts)
    files = report.files(found, out, path.stem)
    storage.publish(out, files)
    data = report.summary(found)
    lines = list(report.remarks(found))
    if rival is not None:
        data["compare"] = {"file": str(options.compare), **rival._asdict()}
        lines.insert(1, report.quality(str(options.compare), rival))
    lines.append(f"{out}/: {', '.join(files)}")
    shown.report(data, title=file.title or path.stem, columns=report.COLUMNS, rows=report.rows(found), notes=lines)
    if found.rejected or not found.converged:
        raise Exit(1)
