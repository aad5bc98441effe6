"""Commands over many points: sweep, plot, figures."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from eqsim.cli.options import (
    Changes,
    Processes,
    RunFilePath,
    Shown,
    complain,
    cores,
    typed,
)
from eqsim.errors import InputError, require_integer
from eqsim.io import signals

if TYPE_CHECKING:
    from eqsim.sweeps.scheduler import Summary
    from eqsim.sweeps.store import Store

_SECOND_HALF = "Second half of the run's distance instead of steady averages."
_DASK = "Scheduler (or its file) of a dask.distributed cluster to compute on."


@dataclass(frozen=True)
class SweepOptions:
    """What is computed at each point, and who computes."""

    rel_error: Annotated[
        float, Option(help="Relative standard error of all observables.")
    ] = 1e-2
    transient: Annotated[bool, Option("--transient", help=_SECOND_HALF)] = False
    workers: Processes = None
    dask: Annotated[str | None, Option(metavar="ADDRESS", help=_DASK)] = None


def sweep(
    path: RunFilePath,
    out: Annotated[
        Path, Option(help="Folder of the dataset; the same command continues it.")
    ],
    options: SweepOptions,
    changes: Changes,
    threads: Annotated[
        int | None, Option(help="Threads per process. Default: cores that are left.")
    ] = None,
    max_lives: Annotated[
        float, Option(help="Most lives per point.", show_default="1e10")
    ] = 1e10,
    *,
    shown: Shown,
) -> None:
    """A grid of points, the [sweep] table of the run file: a resumable Parquet dataset,
    one row per point."""
    file = changes.load(path)
    if options.dask is not None and options.workers is not None:
        raise InputError("--workers: not with --dask, whose cluster has its own")
    each = None if threads is None else cores(threads)
    count = (
        max(1, cores() // (each or 1)) if options.workers is None else options.workers
    )
    require_integer("--workers", count, 1, 1024)
    from eqsim.sweeps import plan, rows, scheduler, workers

    given = changes.given()
    for key in sorted(given.keys() & plan.swept(file)):
        said = f"the [sweep] table sets {key} at every point; --set sweep.{key}=[...] sets other values there"
        raise InputError(f"{given[key][1]}: has no effect, {said}")
    asked = rows.Asked(options.rel_error, max_lives, options.transient)
    who = workers.Workers(
        count, each or (1 if options.dask else max(1, cores() // count)), options.dask
    )
    stores: list[Store] = []
    try:
        points = plan.Plan(file)
        first = points.at(0)
        shown.doubt(first.ensemble, first.drive)
        with shown.bar("sweeping", "points") as progress:
            found = scheduler.sweep(
                points, out, asked=asked, workers=who, progress=progress, note=shown.note,
                opened=stores.append,
            )  # fmt: skip
    except KeyboardInterrupt:
        signals.acknowledge()  # no further one can break off the writing of what is finished
        kept = stores[0].kept() if stores else "this call has computed nothing"
        raise KeyboardInterrupt(f"{kept}; the same command continues") from None
    failures = found.failures[:10]
    shown.report(
        {**asdict(found), "failures": failures, "out": str(out)},
        notes=_ended(found, out),
    )
    for failure in failures if not shown.json else []:
        values = ", ".join(
            f"{key} = {value}" for key, value in failure["changes"].items()
        )
        complain(
            f"point {failure['point']} ({values}) failed: {typed(failure['message'])}"
        )
    if found.failed:
        raise Exit(1)


def _ended(found: "Summary", out: Path) -> list[str]:
    doubtful = f", {found.unreliable} unreliable" if found.unreliable else ""
    failed = f", {found.failed} FAILED" if found.failed else ""
    notes = [
        f"{out}/: sweep.parquet, {found.points} points: {found.ok} ok{doubtful}{failed}"
    ]
    if found.computed:
        each = f"{found.point_seconds / found.computed * 1e3:.3g} ms of engine and reference each"
        notes.append(f"{found.computed} computed in {found.seconds:.1f} s, {each}")
    return notes


_Where = Option(
    metavar="KEY=VALUE",
    help="Only points at which a column has this value; repeatable.",
)


_By = Option(
    help="Column of which every value is a series; a second one chooses markers, the first then colours."
)
_PICTURE = "Picture, .png, .pdf or .svg. Default: DIR.png beside DIR."


def plot(
    folder: Annotated[
        Path, Argument(metavar="DIR", help="Folder of Parquet files, one point a row.")
    ],
    x: Annotated[str, Option(help="Column along the x axis.")] = "drive.velocity",
    y: Annotated[str, Option(help="Column along the y axis.")] = "friction",
    by: Annotated[list[str] | None, _By] = None,
    where: Annotated[list[str] | None, _Where] = None,
    out: Annotated[Path | None, Option(metavar="FILE", help=_PICTURE)] = None,
    log_x: Annotated[
        bool | None,
        Option(
            "--log-x/--linear-x",
            help="Default: logarithmic above a factor 30.",
            show_default=False,
        ),
    ] = None,
    *,
    shown: Shown,
) -> None:
    """Draw a sweep: an observable against a parameter, with error bars and the
    reference."""
    chosen = {}
    for item in where or []:
        key, equals, value = (part.strip() for part in item.partition("="))
        if not key or not equals:
            raise InputError(f"--where {item}: must be KEY=VALUE")
        chosen[key] = value
    place = folder.absolute()
    file = out or place.parent / f"{place.name}.png"
    if file.suffix not in (".png", ".pdf", ".svg"):
        raise InputError(f"--out {file}: must end in .png, .pdf or .svg")
    if file.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"--out {file}: must be outside {folder}, where everything is read as points"
        )
    from eqsim.io import storage, style, sweep_plots
    from eqsim.io.export import RENAMED_COLUMNS

    storage.check_folder(file.parent)
    found = sweep_plots.read_sweep(folder)
    renamed = RENAMED_COLUMNS if y not in found.table else {}
    if y in renamed:
        complain(f"warning: --y {y} of a sweep is called {renamed[y]}")
    y = renamed.get(y, y)
    points = sweep_plots.select(found.table, chosen)
    title = sweep_plots.heading(found, place.name, chosen)
    figure, notes = sweep_plots.sweep_figure(found, points, (x, y), by, log_x, title)
    storage.publish(file.parent, {file.name: style.saved(figure, file.suffix[1:])})
    data = {"file": str(file), "points": len(points), "notes": notes}
    shown.report(data, notes=["; ".join([os.path.relpath(file), *notes])])


_Asked = Argument(metavar="NAME", help="Figures and options, for that command.")


def figures(asked: Annotated[list[str] | None, _Asked] = None) -> None:
    """Say where the figures of Braun and Peyrard (2011) are made: in a clone of the
    repository, by python -m analysis.figures."""
    call = " ".join(["python -m analysis.figures", *(asked or [])])
    raise InputError(f"figures: are made in a clone of the repository, by `{call}`")
