"""Commands over many points: sweep, plot, figures."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from eqsim.catalogue import LENGTH
from eqsim.cli import options as shared
from eqsim.cli.options import Changes, RunFilePath, Shown, complain, cores
from eqsim.errors import InputError, require_integer
from eqsim.io import signals
from eqsim.lazy import lazily

with lazily():
    from eqsim.io import export, storage, units
    from eqsim.plots import style, sweeps
    from eqsim.sweeps import plan, rows, scheduler, store
    from eqsim.sweeps import workers as pools

COLUMN_ENDS = "Columns end in _stderr, _reference_error and _z."
_MOST_FAILURES = 10  # failed points that are reported
_POINT_ERROR = "Relative standard error of all observables."
_SECOND_HALF = "Second half of the run's distance instead of steady averages."
_NO_EXACT = "No references beside the simulated values."
_CLUSTER = "Scheduler (or its file) of a dask.distributed cluster to compute on."
_DATASET = "Folder of the dataset; the same command continues it."
_THREADS = "Threads per process. Default: cores shared among processes."
_PointLives = Option(help="Refuse points that need more lives.", show_default="1e10")


@dataclass(frozen=True)
class SweepOptions:
    """Options of a sweep: what is computed at each point, and by which processes."""

    rel_error: Annotated[float, Option(help=_POINT_ERROR)] = 1e-2
    transient: Annotated[bool, Option("--transient", help=_SECOND_HALF)] = False
    no_exact: Annotated[bool, Option("--no-exact", help=_NO_EXACT)] = False
    workers: shared.Processes = None
    dask: Annotated[str | None, Option(metavar="ADDRESS", help=_CLUSTER)] = None

    def chosen(self, threads: int | None) -> "pools.Workers":
        """Processes or cluster, each with so many threads. Raises InputError."""
        if self.dask is not None and self.workers is not None:
            raise InputError("--workers: not with --dask, whose cluster has its own")
        each = None if threads is None else cores(threads)
        count = self.workers
        if count is None:
            count = max(1, cores() // (each or 1))
        require_integer("--workers", count, 1, 1024)
        left = 1 if self.dask else max(1, cores() // count)
        return pools.Workers(count, each or left, self.dask)


def sweep(
    path: RunFilePath,
    out: Annotated[Path, Option(help=_DATASET)],
    options: SweepOptions,
    changes: Changes,
    threads: Annotated[int | None, Option(help=_THREADS)] = None,
    max_lives: Annotated[float, _PointLives] = 1e10,
    *,
    shown: Shown,
) -> None:
    """Simulate a grid of points, the [sweep] table of the run file, into a resumable
    Parquet dataset, one row per point."""
    file = changes.load(path)
    workers = options.chosen(threads)
    given = changes.given()
    swept = plan.swept(file)
    for key in sorted(given.keys() & swept.keys()):
        axis = swept[key]
        said = f"the [sweep] table sets {axis} at every point; --set sweep.{axis}=[...] sets other values there"
        raise InputError(f"{given[key][1]}: has no effect, {said}")
    exact = not options.no_exact
    asked = rows.Asked(options.rel_error, max_lives, options.transient, exact)
    stores: list[store.Store] = []
    try:
        points = plan.Plan(file)
        first = points.at(0)
        asked.require_effect(points.runs)
        shown.doubt(first, first.drive)
        with shown.bar("sweeping", "points") as progress:
            found = scheduler.sweep(
                points, out, asked=asked, workers=workers, progress=progress, note=shown.note,
                opened=stores.append,
            )  # fmt: skip
    except KeyboardInterrupt:
        signals.acknowledge()  # let finished rows be written, whatever comes
        kept = stores[0].kept() if stores else "this call has computed nothing"
        raise KeyboardInterrupt(f"{kept}; the same command continues") from None
    failures = found.failures[:_MOST_FAILURES]
    data = {**asdict(found), "failures": failures, "out": str(out)}
    shown.report(data, notes=found.told(out))
    for failure in failures if not shown.json else []:
        values = ", ".join(f"{key} = {x}" for key, x in failure["changes"].items())
        message = shared.typed(failure["message"])
        complain(f"point {failure['point']} ({values}) failed: {message}")
    if (more := found.failed - len(failures)) and not shown.json:
        complain(f"{more} more failed; the column `message` says why")
    if found.failed:
        raise Exit(1)


_FOLDER = "Folder of Parquet files, one point a row."
_PICTURE = "Picture, .png, .pdf or .svg. Default: DIR.png beside DIR, or DIR-Y.png of another column than friction."
_Y = "Column along the y axis, or several, a panel each: mu,force. Default: friction, a force if its unit is known."
_INCH = 0.0254  # metres
_WIDTH = "Width on paper, such as 85mm: text of 7 and 8 points, 600 dpi. Default: for a screen."
_BY = "Column whose values are series; with a second one, the first chooses colours, the second markers."
_AT = "Only points at which a column has this value; repeatable."
_LOG = "Scale of the x axis. Default: logarithmic if x spans more than a factor 30."
_Where = Option(metavar="KEY=VALUE", help=_AT)
_Log = Option("--log-x/--linear-x", help=_LOG, show_default=False)


@dataclass(frozen=True)
class Picture:
    """Options of a picture: where it is written, and how wide it is on paper."""

    out: Annotated[Path | None, Option(metavar="FILE", help=_PICTURE)] = None
    width: Annotated[str | None, Option(metavar="LENGTH", help=_WIDTH)] = None

    def inches(self) -> float | None:
        """The width in inches, if it is given. Raises InputError."""
        given = units.measured(self.width or "")
        if self.width is None:
            return None
        if given is None or given[1] != LENGTH or not 0.05 <= given[0] <= 0.5:
            raise InputError(f"--width {self.width}: must be a length, 50mm to 500mm")
        return given[0] / _INCH


def plot(
    folder: Annotated[Path, Argument(metavar="DIR", help=_FOLDER)],
    x: Annotated[str, Option(help="Column along the x axis.")] = "drive.velocity",
    y: Annotated[str | None, Option(help=_Y, show_default=False)] = None,
    by: Annotated[list[str] | None, Option(help=_BY)] = None,
    where: Annotated[list[str] | None, _Where] = None,
    log_x: Annotated[bool | None, _Log] = None,
    *,
    picture: Picture,
    shown: Shown,
) -> None:
    """Draw a sweep: an observable against a parameter, with error bars and the
    reference."""
    chosen = {}
    for item in where or []:
        key, equals, value = (part.strip() for part in item.partition("="))
        if not key or not equals:
            raise InputError(f"--where {item}: must be KEY=VALUE")
        if key in chosen:
            raise InputError(f"--where {item}: {key} has a value already")
        chosen[key] = value
    name = folder.absolute().name
    ys: list[str] = []
    if y is not None:  # each once
        ys = [*dict.fromkeys(name.strip() for name in y.split(","))]
    which = "" if ys in ([], ["friction"]) else "-" + "-".join(ys)
    inches = picture.inches()
    file = picture.out or folder.absolute().parent / f"{name}{which}.png"
    if file.suffix not in (".png", ".pdf", ".svg"):
        raise InputError(f"--out {file}: must end in .png, .pdf or .svg")
    storage.check_outside(folder, file, file)
    storage.check_folder(file.parent)
    found = sweeps.read_sweep(folder)
    printed = sweeps.PRINTED | export.RENAMED_COLUMNS
    ys = [one if one in found.table else printed.get(one, one) for one in ys]
    points = sweeps.select(found.table, chosen)
    title = sweeps.heading(found, name, chosen)
    columns = [x, *(ys or [found.usual])]
    asked = by, log_x, title, inches
    figure, notes = sweeps.sweep_figure(found, points, columns, *asked)
    settings = style.PAPER if inches else None
    content = style.saved(figure, file.suffix[1:], settings)
    storage.publish(file.parent, {file.name: content})
    law = sweeps.healing_of(points, x, ys[0]) if len(ys) == 1 and not by else None
    data = {"file": str(file), "points": len(points), "notes": notes}
    data |= {"healing": law.as_dict()} if law else {}
    shown.report(data, notes=["; ".join([os.path.relpath(file), *notes])])


_Asked = Argument(metavar="NAME", help="Figures and options, for that command.")


def figures(asked: Annotated[list[str] | None, _Asked] = None) -> None:
    """Say where the figures of Braun and Peyrard (2011) are made: in a clone of the
    repository, by python -m analysis.figures."""
    call = " ".join(["python -m analysis.figures", *(asked or [])])
    raise InputError(f"figures: are made in a clone of the repository, by `{call}`")
