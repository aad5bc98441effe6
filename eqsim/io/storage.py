"""Results on disk: Parquet with provenance, JSON without NaN, and folders that are
never half-written."""

import hashlib
import io
import json
import math
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from glob import glob
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from eqsim.errors import InputError
from eqsim.io.signals import undone
from eqsim.lazy import lazily

with lazily():
    from eqsim import results

Result = TypeVar("Result")

# Files in the folder of a sweep (`eqsim.sweeps.store`).
SWEEP_TABLE = "sweep.parquet"  # all rows, in the order of the grid, once all are there
SWEEP_MANIFEST = "_sweep.json"  # settings of the sweep
# Seconds after which what a stopped command has done is removed: 30 days
_FORGOTTEN_SECONDS = 30 * 86400.0
SWEEP_PARTS = "parts"  # finished rows of an unfinished sweep
SWEEP_HIDDEN = "_parts"  # the same, renamed just before the table gets its name


def sweep_parts(folder: Path) -> list[Path]:
    """The files that hold the rows of an unfinished sweep, which may be ending: then it
    renames their folder."""
    folders = [folder / name for name in (SWEEP_PARTS, SWEEP_HIDDEN)]
    # unlike Path.glob, glob passes over a folder that is gone
    listed = [one / name for one in folders for name in glob("*.parquet", root_dir=one)]
    return sorted(path for path in listed if path.exists())


def sweep_files(folder: Path) -> list[Path] | None:
    """The Parquet files that hold the rows of a sweep, finished or at work; none if no
    row is there yet. None for a folder that holds no sweep."""
    if not (folder / SWEEP_MANIFEST).exists():
        return None
    for _ in range(2):  # parts that are renamed meanwhile are seen at the second look
        parts = sweep_parts(folder)  # first: they are removed once the table is there
        if files := [*folder.glob(SWEEP_TABLE)] or parts:
            return files
    return []


def read_listed(
    folder: Path, files: list[Path], read: Callable[[list[Path]], Result]
) -> Result:
    """Read the `files` of a sweep, listed anew where the sweep ends before they are
    read. Raises what `read` does."""
    for _ in range(2):
        try:
            return read(files)
        except FileNotFoundError:
            files = sweep_files(folder) or files
    return read(files)


def planned_points(folder: Path) -> int | None:
    """How many points the sweep in a folder has, if that is known."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        return int(json.loads((folder / SWEEP_MANIFEST).read_bytes())["points"])
    return None


def versions() -> dict[str, str]:
    """Versions of Python and the packages that results depend on."""
    packages = ("eqsim", "numpy", "numba", "scipy")
    known = {name: metadata.version(name) for name in packages}
    return {"python": platform.python_version(), **known}


def provenance(
    command: str, settings: Any, run_file: str, seed: int, folder: Path | None = None
) -> dict[str, Any]:
    """Describe a call so that it can be repeated (`eqsim.workflows.replay`): the
    command, the run file as it stood and the folder its paths are relative to, every
    setting in force (an infinite one as "Infinity"), versions."""
    plain = json.loads(json.dumps(settings), parse_constant=str)
    known = {"command": command, "run_file": run_file, "settings": plain, "seed": seed}
    known["versions"] = versions()
    return known if folder is None else {**known, "folder": str(folder.absolute())}


def to_json(data: Any) -> str:
    """JSON of numbers, texts and arrays, with null where a number is not finite."""

    def clean(value: Any) -> Any:
        value = value.tolist() if hasattr(value, "tolist") else value
        if isinstance(value, dict):
            return {key: clean(part) for key, part in value.items()}
        if isinstance(value, (list, tuple)):
            return [clean(part) for part in value]
        if isinstance(value, float) and not math.isfinite(value):
            return None
        return value

    return json.dumps(clean(data), indent=2, allow_nan=False)


def parquet(columns: Any, origin: dict[str, Any]) -> bytes:
    """A Parquet file of a DataFrame or of arrays by name, with `origin` as JSON under
    the metadata key `eqsim`."""
    import pyarrow

    def whole(column: Any) -> Any:
        """Wrap the memory of numbers; pyarrow alone would import pandas to convert
        them, which takes a third of a second."""
        if not isinstance(column, np.ndarray) or column.dtype.kind not in "if":
            return column
        memory = pyarrow.py_buffer(np.ascontiguousarray(column))
        kind = pyarrow.from_numpy_dtype(column.dtype)
        return pyarrow.Array.from_buffers(kind, column.size, [None, memory])

    if isinstance(columns, dict):
        columns = {name: whole(column) for name, column in columns.items()}
    metadata = {"eqsim": to_json(origin)}
    table = pyarrow.table(columns).replace_schema_metadata(metadata)
    return as_parquet(table, checksums=False)


def as_parquet(table: Any, checksums: bool = True) -> bytes:
    """A pyarrow table as a Parquet file, whose pages may carry checksums."""
    from pyarrow import parquet as pq

    buffer = io.BytesIO()
    pq.write_table(table, buffer, write_page_checksum=checksums)
    return buffer.getvalue()


def read_parquet(content: bytes, checksums: bool = False) -> Any:
    """The pyarrow table of a Parquet file, whose checksums are looked at if asked for.
    Raises OSError, pyarrow.ArrowException, or ValueError if two columns have one name.

    No thread is started: pyarrow does not end its own, and a process that ends while
    they start is aborted. So `to_pandas` must have `use_threads=False`, too."""
    import pyarrow
    from pyarrow import parquet as pq

    reader = pyarrow.BufferReader(content)
    file = pq.ParquetFile(reader, page_checksum_verification=checksums)
    table = file.read(use_threads=False)
    if len({*table.column_names}) < table.num_columns:
        raise ValueError("two columns have the same name")
    return table


def origin_of(schema: Any) -> dict[str, Any]:
    """The provenance in the pyarrow schema of a table. Raises KeyError without one, and
    ValueError if it is damaged."""
    found: dict[str, Any] = json.loads((schema.metadata or {})[b"eqsim"])
    return found


def from_parquet(content: bytes) -> Any:
    """The pyarrow table of a Parquet file with checksums; None if it is damaged."""
    from pyarrow import ArrowException

    try:
        return read_parquet(content, checksums=True)
    except (OSError, ArrowException, ValueError, MemoryError):
        return None


def left_over(folder: Path, command: str, written: dict[str, bytes]) -> list[str]:
    """Names of files in a folder that were not `written` again: tables that an earlier
    call of the same command has left there, and pictures and exports of the same names
    in other formats."""
    from pyarrow import ArrowException
    from pyarrow import parquet as pq

    found, stems = [], {Path(name).stem for name in written}
    for path in sorted(folder.iterdir()):
        if path.name in written:
            continue
        if path.suffix in (".csv", ".png", ".pdf", ".svg") and path.stem in stems:
            found.append(path.name)
        if path.suffix != ".parquet":
            continue
        try:
            origin = origin_of(pq.read_schema(path))
            found += [path.name] * (origin["command"] == command)
        except (OSError, ArrowException, ValueError, LookupError):  # none of ours
            continue
    return found


def check_folder(folder: Path, sweep: bool = False) -> None:
    """Raise InputError unless files can be written to `folder`, made by then or not.
    Only those of its own `sweep` can be written to the folder of one."""
    above = Path(os.path.realpath(folder)).parents
    for place in above if sweep else (folder, *above):
        if os.path.exists(place / SWEEP_MANIFEST):
            check_outside(place, folder, folder)
    parents = (folder, *folder.absolute().parents)
    present = next(filter(os.path.lexists, parents))
    if not present.is_dir():
        raise InputError(f"--out {folder}: {present} is not a folder")
    try:
        tempfile.TemporaryFile(dir=present).close()
    except OSError as error:
        why = error.strerror
        raise InputError(f"--out {folder}: cannot be written ({why})") from None


def check_outside(dataset: Path, place: Path, out: Path | None) -> None:
    """Raise InputError if what goes to `out` would be among the points of a dataset."""
    if place.resolve().is_relative_to(dataset.resolve()):
        said = f"must be outside {dataset}, where everything is read as points"
        raise InputError(f"--out {out}: {said}")


def save(path: Path, content: bytes) -> None:
    """Write one file, whole or not at all, whatever dies. Raises InputError."""
    publish(path.parent, {path.name: content}, str(path))


def unfinished(out: Path, *parts: str | bytes) -> Path:
    """The folder for what a command that may be stopped has done, named by a digest of
    all that its numbers depend on and of the release of eqsim. Folders to which nothing
    was added for long are removed."""
    for old in out.glob(".unfinished-*"):
        with suppress(FileNotFoundError):  # another command has just removed it
            if time.time() - old.stat().st_mtime > _FORGOTTEN_SECONDS:
                shutil.rmtree(old, ignore_errors=True)
    digest = hashlib.sha256()
    for part in (versions()["eqsim"], str(results.RESULTS_VERSION), *parts):
        content = part.encode() if isinstance(part, str) else part
        digest.update(hashlib.sha256(content).digest())
    return out / f".unfinished-{digest.hexdigest()[:16]}"


def publish(folder: Path, files: dict[str, bytes], place: str = "") -> None:
    """Write files; they get their names only when all are on disk. Raises InputError,
    which names `place`."""
    place = place or f"--out {folder}"
    for name in files:
        if (folder / name).is_dir():
            raise InputError(f"{place}: {name} is a folder there")
    made = not folder.exists()
    staging: Path | None = None

    def clear() -> None:
        if staging:
            shutil.rmtree(staging, ignore_errors=True)
        if made and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()

    try:
        with undone(clear):
            folder.mkdir(parents=True, exist_ok=True)
            staging = Path(tempfile.mkdtemp(prefix=".eqsim-", dir=folder))
            for name, content in files.items():
                with open(staging / name, "wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            for name in files:
                os.replace(staging / name, folder / name)
            if os.name == "posix":  # the names themselves must reach the disk too
                handle = os.open(folder, os.O_RDONLY)
                try:
                    os.fsync(handle)
                finally:
                    os.close(handle)
    except OSError as error:
        raise InputError(f"{place}: cannot be written ({error.strerror})") from None
