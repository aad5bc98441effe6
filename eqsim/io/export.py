"""Tables as CSV: comment lines that say what they are, then what `pandas.read_csv(FILE,
comment="#")` reads."""

import json
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from eqsim.errors import InputError
from eqsim.io import csv, labels, storage
from eqsim.io.units import Units

# Columns that sweeps of version 1 of the schema call otherwise: there `force` was no
# length.
RENAMED_COLUMNS = {
    f"force{end}": f"friction_force{end}" for end in ("", "_stderr", "_reference")
}
_UNKNOWN = Units()
# of an exact curve
_RATE = "breaks per contact and displacement, along a programme per contact and time"
# commands whose settings hold more than the run file
_SETTINGS = {"sweep": "sweep", "fluctuations": "run"}


def meaning(
    column: str, units: Units = _UNKNOWN, command: str = "", fractions: bool = False
) -> str:
    """The meaning of a column of a table of a `command`, with its unit, or ""."""
    if command == "sweep":
        column = RENAMED_COLUMNS.get(column, column)
    words, unit = labels.column(column, units, fractions)
    if (command, column) == ("reference", "breaks"):
        words = _RATE
    return f"{words} ({unit})".strip() if unit else words


def tables(path: Path) -> dict[str, list[Path]]:
    """The Parquet files that make up each table of a file, of a sweep's folder (one
    table, finished or not) or of another folder of results, by the name of the table.
    Raises InputError."""
    if path.is_file():
        sweep = sweep_of(path)
        return {path.stem: [path]} if sweep is None else tables(sweep)
    if not path.is_dir():
        raise InputError(f"{path}: is neither a file nor a folder")
    rows = storage.sweep_files(path)
    if rows is not None:
        if not rows:
            raise InputError(f"{path}: is a sweep of which no point is on disk yet")
        return {path.absolute().name: rows}
    found = {one.stem: [one] for one in sorted(path.glob("*.parquet"))}
    if not found:
        raise InputError(f"{path}: has no Parquet files")
    return found


def sweep_of(path: Path) -> Path | None:
    """The folder of the sweep that a Parquet file belongs to, if it does."""
    folder = path.absolute().parent
    inside = folder.name in (storage.SWEEP_PARTS, storage.SWEEP_HIDDEN)
    whole = path.name == storage.SWEEP_TABLE
    for sweep in [folder.parent] * inside + [folder] * whole:
        if (sweep / storage.SWEEP_MANIFEST).exists():
            return sweep
    return None


def as_csv(paths: list[Path]) -> bytes:
    """The rows of Parquet files with the same columns. Raises InputError."""
    import pyarrow

    def read(files: list[Path]) -> tuple[list[Path], Any]:
        parts = [storage.read_parquet(path.read_bytes()) for path in files]
        return files, pyarrow.concat_tables(parts)

    try:
        folder = sweep_of(paths[0]) or paths[0].parent
        paths, table = storage.read_listed(folder, paths, read)
        origin = json.loads((table.schema.metadata or {}).get(b"eqsim", b"{}"))
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{paths[0]}: cannot be read ({why})") from None
    except (pyarrow.ArrowException, ValueError, RecursionError):
        raise InputError(f"{paths[0]}: is not a Parquet file, or is damaged") from None
    origin = origin if isinstance(origin, dict) else {}
    command, settings = str(origin.get("command", "")), _settings(origin)
    fractions = settings.get("newborn", {}).get("of") == "threshold"
    units = _units(settings)
    lines = [*_origin(origin, units), *_unfinished(paths, table.num_rows)]
    for name in table.column_names:
        text = meaning(name, units, command, fractions)
        lines += [f"{' '.join(name.split())}: {text}"] * bool(text)
    rows = zip(*(column.to_pylist() for column in table.columns), strict=True)
    lines = [f"# {line}".rstrip() for line in lines]
    try:
        lines += csv.written(table.column_names, rows)
    except InputError as error:
        raise InputError(f"{paths[0]}: {error}") from None
    return "".join(f"{line}\n" for line in lines).encode()


def _settings(origin: dict[str, Any]) -> dict[str, Any]:
    """The content of the run file of a table, as far as that is known."""
    settings = origin.get("settings")
    key = _SETTINGS.get(str(origin.get("command")))
    if key is not None and isinstance(settings, dict):
        settings = settings.get(key)
    return settings if isinstance(settings, dict) else {}


def _units(settings: dict[str, Any]) -> Units:
    given = settings.get("units")
    with suppress(TypeError, InputError):
        return Units(**given) if isinstance(given, dict) else _UNKNOWN
    return _UNKNOWN


def _unfinished(paths: list[Path], rows: int) -> list[str]:
    """Remarks on a sweep whose rows are not all there."""
    folder = paths[0].parent
    inside = folder.name in (storage.SWEEP_PARTS, storage.SWEEP_HIDDEN)
    planned = storage.planned_points(folder.parent) if inside else None
    return [f"{rows} of {planned} points: the sweep is not finished"] * bool(planned)


def _origin(origin: dict[str, Any], units: Units) -> list[str]:
    """Command that made a table, its units, and the run file."""
    if not isinstance(origin.get("command"), str):
        return []
    versions, run_file = origin.get("versions") or {}, str(origin.get("run_file") or "")
    given = ", ".join(f"{name} {unit}" for name, unit in asdict(units).items() if unit)
    command = f"{origin['command']}, seed {origin.get('seed')}"
    lines = [f"eqsim {versions.get('eqsim', '')}: {command}"]
    if given or run_file:
        free = "lengths, times and energies are in those of the run file"
        lines.append(f"units: {given or free}")
    return lines + [f"| {line}" for line in run_file.splitlines()]
