"""Run again what made a table, from its provenance alone, and compare the two bit by bit."""

import dataclasses
import json
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd

from eqsim.io import storage
from eqsim.errors import InputError
from eqsim.io.runfile import RunFile, check

_TIMES = ("seconds",)  # columns that no repetition can reproduce
Progress = Callable[..., None]


@dataclasses.dataclass(frozen=True)
class Replay:
    """A table beside its repetition: `differences` holds, for each column that is not the same to the last bit, in how
    many rows and by how much at most (None where it is not a number); `versions`, those that differ, as (then, now)."""

    command: str
    rows: int
    differences: dict[str, tuple[int, float | None]]
    versions: dict[str, tuple[str, str]]

    @property
    def same(self) -> bool:
        return not self.differences


def replay(path: Path, *, workers: int = 1, progress: Progress = lambda *_: None) -> Replay:
    """Repeat the call whose Parquet file is at `path`, on `workers` threads or processes, and compare.

    Files that a run file names are looked for where they were. Raises InputError if the file is none of eqsim's, or
    what made it cannot be repeated.
    """
    import pyarrow
    from pyarrow import parquet as pq

    if path.exists() and not path.is_file():  # a pipe or a device may never end
        raise InputError(f"{path}: is not a file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        table = pq.read_table(pyarrow.BufferReader(content))
        origin = json.loads((table.schema.metadata or {})[b"eqsim"])
        repeat = _REPEAT[origin["command"]]
        written = isinstance(origin["settings"], dict) and isinstance(origin["versions"], dict)
    except (pyarrow.ArrowException, OSError, KeyError, ValueError, TypeError, RecursionError):
        written = False
    if not written:
        raise InputError(f"{path}: is not a Parquet file that eqsim has written, or is damaged")
    try:
        again = repeat(origin, workers, progress)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: its provenance is damaged ({type(error).__name__}: {error})") from None
    here = storage.versions()
    changed = {name: (then, here.get(name, "none")) for name, then in origin["versions"].items()}
    return Replay(
        origin["command"], len(table), compare(table.to_pandas(), again),
        {name: pair for name, pair in changed.items() if pair[0] != pair[1]},
    )  # fmt: skip


def compare(table: Any, again: Any) -> dict[str, tuple[int, float | None]]:
    """Columns of two DataFrames that differ, as in `Replay`. A column or row that only one of them has differs."""
    found: dict[str, tuple[int, float | None]] = {}
    for name in [*table, *(name for name in again if name not in table)]:
        if name in _TIMES:
            continue
        if name not in table or name not in again or len(table) != len(again):
            found[name] = (max(len(table), len(again)), None)
            continue
        then, now = table[name], again[name]
        other = ~((then == now) | (then.isna() & now.isna()))
        if other.any():
            numbers = pd.api.types.is_numeric_dtype(then) and pd.api.types.is_numeric_dtype(now)
            by = (then - now)[other].abs() if numbers else None
            found[name] = (int(other.sum()), None if by is None or by.isna().any() else float(by.max()))
    return found


def _file(settings: dict[str, Any]) -> RunFile:
    """The run file as it was in force, infinite rates included."""
    return check(json.loads(json.dumps(settings).replace('"Infinity"', "Infinity")))


def _run(origin: dict[str, Any], workers: int, progress: Progress) -> Any:
    from eqsim.engine.trajectory import trajectory

    file = _file(origin["settings"])
    output, contacts = file.output, file.ensemble(Path(origin["folder"]))
    result = trajectory(
        contacts, file.driven(), points=output.points, seed=output.seed, replicas=output.replicas,
        threads=workers, max_lives=float("inf"), progress=progress,
    )  # fmt: skip
    return pd.DataFrame(result.columns())


def _validate(origin: dict[str, Any], workers: int, progress: Progress) -> Any:
    from eqsim.validation.suite import columns, validate

    suite = origin["settings"]["suite"]
    return pd.DataFrame(columns(validate(suite, seed=origin["seed"], threads=workers, progress=progress).scores))


def _sweep(origin: dict[str, Any], workers: int, progress: Progress) -> Any:
    from eqsim.sweep.scheduler import Asked, sweep

    settings = origin["settings"]
    file, folder = _file(settings["sweep"]), Path(origin["folder"])
    asked = Asked(**{field.name: settings[field.name] for field in dataclasses.fields(Asked)})
    with tempfile.TemporaryDirectory() as out:
        sweep(file, folder, Path(out) / "again", asked=asked, workers=workers, progress=progress)
        return pd.read_parquet(Path(out) / "again" / "sweep.parquet")


def _figures(origin: dict[str, Any], workers: int, progress: Progress) -> Any:
    from eqsim.sweep.workers import unbroken

    scripts, settings = import_module("eqsim_figures"), origin["settings"]
    with unbroken(workers, None) as crew:
        name, quick = settings["figure"], settings["quick"]
        return dict(scripts.tabulate([name], quick=quick, executor=crew.pool, progress=progress))[name]


_REPEAT: dict[str, Callable[[dict[str, Any], int, Progress], Any]] = {
    "run": _run,
    "validate": _validate,
    "sweep": _sweep,
    "figures": _figures,
}
