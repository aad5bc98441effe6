"""Commands about one ensemble: run, steady, reference, fluctuations, stability."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from eqsim.cli import options as shared
from eqsim.cli.options import Changes, RunFilePath, Shown, Threads, cores
from eqsim.errors import InputError, require_integer, require_number
from eqsim.io import terminal
from eqsim.lazy import lazily

with lazily():
    from eqsim.io import states, storage
    from eqsim.sweeps import workers as pools
    from eqsim.workflows import averages, curve
    from eqsim.workflows import fluctuations as fluctuating
    from eqsim.workflows import run as running
    from eqsim.workflows import stability as solving

F_K = "f_k: F/(N_c k), the elastic force per pinned contact, the f_k of the paper; friction is F/(N k)."
PEAK = "peak_force (or peak_mu, ...), peak_X: the static peak, the first maximum of the force after a fresh start."
_RESULTS = "Results folder. Default: out/NAME beside the run file."
_NO_EXACT = "Particles only: no exact curve beside them."
_WORKERS = "Split the ensemble over so many processes; results are the same."
_SPLIT_DASK = "Split the ensemble over a dask cluster, by its scheduler's address or file; results are the same."
_PRECISION = "Relative standard error of all observables."
_FROM_THE_START = "F(X) and pinned(X) from the run's start."
_CLOSURE = "F(X) of annealed contacts whose pool of thresholds ages from newborn."
_CURVE = "Folder for table and picture of --transient or --closure. Default: out/NAME beside the run file."

_VARIANCE = "Folder for fluctuations.parquet, summary.json and a picture."
_LAG = "Greatest lag. Default: five mean cycles of pinned and detached."
_SAMPLED_LIVES = "Number of lives to simulate, roughly; 0: none."
_BORDERS = "Folder for the borders over velocity: a table, a picture and summary.json."
_CRITICAL = "No effect: the critical stiffness of steady sliding is always looked for."


@dataclass(frozen=True)
class Split:
    """Options that share contacts among processes instead of threads."""

    workers: Annotated[int | None, Option(help=_WORKERS)] = None
    dask: Annotated[str | None, Option(metavar="ADDRESS", help=_SPLIT_DASK)] = None

    def chosen(self) -> "pools.Workers | None":
        if self.workers is not None and self.dask is not None:
            raise InputError("--workers, --dask: only one of them")
        if self.workers is not None:
            require_integer("--workers", self.workers, 1, 1024)
        elif self.dask is None:
            return None
        return pools.Workers(self.workers or 1, dask=self.dask)


@dataclass(frozen=True)
class Work:
    """Options of how much a run computes."""

    max_lives: shared.MaxLives = 1e10
    no_exact: Annotated[bool, Option("--no-exact", help=_NO_EXACT)] = False


def run(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help=_RESULTS)] = None,
    *,
    changes: Changes,
    threads: Threads = None,
    split: Split,
    work: Work,
    format_: shared.Formats = None,
    shown: Shown,
) -> None:
    """Simulate the ensemble contact by contact: friction force against displacement."""
    file = changes.load(path)
    require_number("--max-lives", work.max_lives, above=0)
    folder = shared.results_folder(path, out)
    storage.check_folder(folder)
    count, workers, formats = cores(threads), split.chosen(), shared.pictured(format_)
    with states.kept(file, folder) as keep:  # until results are on disk
        with shown.bar("simulating", "lives") as progress:
            how: dict[str, Any] = {"max_lives": work.max_lives, "progress": progress}
            how |= {"exact": not work.no_exact, "threads": count, "workers": workers}
            found = running.run(file, **how, keep=keep)
        shown.doubt(file, file.drive)
        for line in file.said:
            shown.note(line)
        shown.result(found, path.stem, folder, formats)


def steady(
    path: RunFilePath,
    rel_error: Annotated[float, Option(help=_PRECISION)] = 1e-3,
    *,
    changes: Changes,
    threads: Threads = None,
    max_lives: shared.MaxLives = 1e10,
    shown: Shown,
) -> None:
    """Steady friction, pinned fraction and stretch at breaking, to a requested relative
    error."""
    file = changes.load(path)
    with shown.bar("simulating", "lives") as progress:
        announced = terminal.announcing(progress, shown.note)
        how: dict[str, Any] = {"max_lives": max_lives, "progress": announced}
        found = averages.simulated(
            file, **how, rel_error=rel_error, threads=cores(threads)
        )
    shown.doubt(file)
    if not found.steady.reached and not shown.quiet:
        shared.complain(f"relative error {rel_error:g} was not reached")
    shown.result(found, path.stem)


def reference(
    path: RunFilePath,
    transient: Annotated[bool, Option("--transient", help=_FROM_THE_START)] = False,
    closure: Annotated[bool, Option("--closure", help=_CLOSURE)] = False,
    out: Annotated[Path | None, Option(help=_CURVE)] = None,
    *,
    changes: Changes,
    threads: Threads = None,
    format_: shared.Formats = None,
    shown: Shown,
) -> None:
    """Exact averages from the master equation, without random numbers."""
    if transient and closure:
        raise InputError("--transient, --closure: only one of them")
    for option, given in (("--out", out), ("--format", format_)):
        if given and not (transient or closure):
            said = "is for the table and the picture of --transient or --closure"
            raise InputError(f"{option}: {said}")
    file = changes.load(path)
    cores(threads)
    if not (transient or closure):
        found = averages.exact(file, variance=shown.json)
        shown.doubt(file)
        shown.result(found, path.stem)
        return
    formats = shared.pictured(format_)
    folder = None if shown.json and out is None else shared.results_folder(path, out)
    if folder is not None:
        storage.check_folder(folder)
    shown.result(curve.curve(file, closure=closure), path.stem, folder, formats)


def fluctuations(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help=_VARIANCE)] = None,
    lag: Annotated[float | None, Option(help=_LAG, show_default=False)] = None,
    points: Annotated[int, Option(help="Lags, from 0 on.")] = 101,
    lives: Annotated[float, Option(help=_SAMPLED_LIVES, show_default="1e6")] = 1e6,
    *,
    changes: Changes,
    threads: Threads = None,
    shown: Shown,
) -> None:
    """Variance and autocovariance of the steady force over displacement: exact, and of
    simulated contacts."""
    file, count = changes.load(path), cores(threads)
    require_integer("--points", points, 2, 10_000)
    if out is not None:
        storage.check_folder(out)
    how: dict[str, Any] = {"lag": lag, "points": points, "lives": lives}
    found = fluctuating.run_fluctuations(file, **how, threads=count)
    shown.result(found, path.stem, out)


def stability(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help=_BORDERS)] = None,
    critical: Annotated[bool, Option("--critical", help=_CRITICAL)] = False,
    *,
    changes: Changes,
    threads: Threads = None,
    shown: Shown,
) -> None:
    """Decide whether a slider that a stage pulls through a spring slides steadily, or
    sticks and slips."""
    file = changes.load(path)
    cores(threads)
    if out is not None:
        storage.check_folder(out)
    found = solving.stability(file, borders=out is not None, bar=shown.bar)
    shown.result(found, path.stem, out)
