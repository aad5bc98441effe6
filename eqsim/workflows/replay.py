"""Repeat the call that made a table, from its provenance alone, and compare the tables
bit by bit."""

import dataclasses
import tempfile
from collections.abc import Callable, Mapping
from math import isnan, nan
from pathlib import Path
from typing import Any

import pyarrow

from eqsim.errors import InputError
from eqsim.io import storage
from eqsim.io.export import RENAMED_COLUMNS
from eqsim.io.runfile import stored
from eqsim.master.chain_modes import chain_modes
from eqsim.master.stability import critical_stiffnesses, pulled_by
from eqsim.model.drive import Programme
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.rows import Asked
from eqsim.sweeps.scheduler import sweep
from eqsim.sweeps.workers import Workers
from eqsim.validation import columns, validate
from eqsim.workflows.curve import curve
from eqsim.workflows.fluctuations import run_fluctuations
from eqsim.workflows.report import Progress
from eqsim.workflows.run import run

_TIMES = ("seconds",)  # columns that no repetition can reproduce
_UNREADABLE = (OSError, KeyError, ValueError, TypeError, RecursionError)
Origin = dict[str, Any]  # the provenance of a table
Table = Any  # a pandas DataFrame, or columns by name
# A function that makes a table again from its provenance, the table, the number of
# threads or processes, and progress.
Repeat = Callable[[Origin, Table, int, Progress], Table]


@dataclasses.dataclass(frozen=True)
class Replay:
    """A table beside its repetition.

    Attributes
    ----------
    command : str
        Name of the command that made the table.
    rows : int
        Number of rows of the table.
    differences : dict
        For each column that is not the same to the last bit, the number of rows that
        differ and the largest difference (None where it is not a number).
    versions : dict
        Versions of packages that differ, as (then, now).
    """

    command: str
    rows: int
    differences: dict[str, tuple[int, float | None]]
    versions: dict[str, tuple[str, str]]

    @property
    def same(self) -> bool:
        """True if no column differs."""
        return not self.differences


def replay(
    path: Path | str,
    *,
    workers: int = 1,
    progress: Progress = lambda *_: None,
    others: Mapping[str, Repeat] | None = None,
) -> Replay:
    """Repeat the call that made a Parquet file, and compare.

    Parameters
    ----------
    path : Path or str
        A file that eqsim wrote. Files that its run file names must be where they were.
    workers : int
        Threads, or processes that repeat a sweep; 1 computes in this process. A script
        that asks for more calls this below `if __name__ == "__main__":`, as processes
        begin by importing it.
    progress : callable, optional
        Called as `progress(done, total)`.
    others : mapping, optional
        Functions that repeat tables of other programs, by the name of the command.

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        If eqsim did not write the file, or the call that did cannot be repeated, as
        where a point of a sweep fails that did not.

    Examples
    --------
    >>> from eqsim import replay, run
    >>> text = "[contacts]\\ncount = 500\\n[drive]\\nvelocity = 0.1\\ndistance = 5.0\\n"
    >>> _ = Path("x.toml").write_text(text)
    >>> files = run("x.toml").files(formats=())
    >>> _ = Path("trajectory.parquet").write_bytes(files["trajectory.parquet"])
    >>> replay("trajectory.parquet").same
    True
    """
    known = {**_REPEAT, **(others or {})}
    path = Path(path)
    table, origin = _replayed_table(path, known)
    import pandas as pd

    try:
        again = pd.DataFrame(known[origin["command"]](origin, table, workers, progress))
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: its provenance is damaged ({what})") from None
    here, then = storage.versions(), origin["versions"]
    pairs = {name: (old, here.get(name, "none")) for name, old in then.items()}
    changed = {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}
    return Replay(origin["command"], len(table), compare(table, again), changed)


def _replayed_table(path: Path, repeat: Mapping[str, Repeat]) -> tuple[Table, Origin]:
    """The table of a file, and its provenance."""
    if path.exists() and not path.is_file():  # a pipe or a device may never end
        raise InputError(f"{path}: is not a file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    known = ", ".join(f"`eqsim {name}`" for name in repeat)
    origin: Any = {}
    try:
        table = storage.read_parquet(content)
        origin = storage.origin_of(table.schema)
        parts = origin["settings"], origin["versions"]
        command = origin["command"] if all(isinstance(x, dict) for x in parts) else None
        if command in repeat:
            return table.to_pandas(use_threads=False), origin
    except (*_UNREADABLE, pyarrow.ArrowException):
        command = None
    problem = "is not a Parquet file that eqsim has written, or is damaged"
    if command == "figures":
        again = "`python -m analysis.figures --replay` makes it again"
        problem = f"holds a figure of the paper; {again}"
    elif isinstance(command, str):
        only = f"only tables of {known} can be replayed"
        problem = f"was written by `eqsim {command}`; {only}"
    raise InputError(f"{path}: {problem}")


def compare(table: Table, again: Table) -> dict[str, tuple[int, float | None]]:
    """Columns that differ, as in `Replay`; also those in one table alone."""
    differences: dict[str, tuple[int, float | None]] = {}
    for name in [*table, *(name for name in again if name not in table)]:
        if name in _TIMES:
            continue
        if name not in table or name not in again or len(table) != len(again):
            differences[name] = (max(len(table), len(again)), None)
            continue
        then, now = table[name], again[name]
        other = ~((then == now) | (then.isna() & now.isna()))
        if other.any():
            numbers = then.dtype.kind in "iuf" and now.dtype.kind in "iuf"
            by = float((then - now)[other].abs().max(skipna=False)) if numbers else nan
            differences[name] = (int(other.sum()), None if isnan(by) else by)
    return differences


def _run(origin: Origin, table: Table, workers: int, progress: Progress) -> Table:
    file = stored(origin["settings"], origin["folder"])
    result = run(file, threads=workers, max_lives=1e300, progress=progress)
    names = set(table)
    return max(result.tables().values(), key=lambda columns: len(names & set(columns)))


def _reference(origin: Origin, table: Table, _: int, progress: Progress) -> Table:
    file = stored(origin["settings"], origin["folder"])
    return curve(file, closure="mean_threshold" in table).columns


def _fluctuations(origin: Origin, _: Table, workers: int, progress: Progress) -> Table:
    asked = origin["settings"]
    file = stored(asked["run"], origin["folder"])
    how = {name: asked[name] for name in ("lag", "points", "lives")}
    return run_fluctuations(file, threads=workers, **how).columns()


def _stability(origin: Origin, table: Table, _: int, progress: Progress) -> Table:
    file = stored(origin["settings"], origin["folder"])
    if isinstance(file.drive, Programme) and file.drive.chain:
        return chain_modes(file.ensemble, file.drive).columns()
    pulled = pulled_by(file.ensemble, file.drive)
    critical = bool(table["critical_stiffness"].notna().any())
    velocities = table["velocity"].tolist()
    return critical_stiffnesses(
        pulled, velocities, critical=critical, progress=progress
    )


def _validate(origin: Origin, _: Table, workers: int, progress: Progress) -> Table:
    suite, seed = origin["settings"]["suite"], origin["seed"]
    found = validate(suite, seed=seed, threads=workers, progress=progress)
    return columns(found.scores)


def _sweep(origin: Origin, table: Table, workers: int, progress: Progress) -> Table:
    """Repeat a sweep with the stored identities of its points: seeds are made of them,
    and they change with the version of results."""
    settings = origin["settings"]
    plan = Plan(stored(settings["sweep"], origin["folder"]), table["id"].tolist())
    if len(table) != plan.size:
        of = f"{len(table)} of the {plan.size} points of a sweep that was not finished"
        only = "only the table of a finished one, sweep.parquet, can be replayed"
        raise InputError(f"the table holds {of}; {only}")
    names = [field.name for field in dataclasses.fields(Asked)]
    asked = Asked(**{name: settings[name] for name in names if name in settings})
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "again"
        count = workers if workers > 1 else 0  # one worker is this process
        done = sweep(plan, out, asked=asked, workers=Workers(count), progress=progress)
        failed = {*table["id"][table["status"] == "failed"]}
        for failure in done.failures:
            if failure["id"] not in failed:
                said = f"point {failure['point']} fails when it is repeated"
                raise InputError(f"{said}: {failure['message']}")
        found = storage.read_parquet((out / storage.SWEEP_TABLE).read_bytes())
        again = found.to_pandas(use_threads=False)
    old = {name: other for name, other in RENAMED_COLUMNS.items() if name in table}
    return again.rename(columns={other: name for name, other in old.items()})


_REPEATING = (_run, _fluctuations, _reference, _stability, _validate, _sweep)
_REPEAT: dict[str, Repeat] = {one.__name__.lstrip("_"): one for one in _REPEATING}
