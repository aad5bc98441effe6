"""Tables as CSV: comment lines that say what they are, then what `pandas.read_csv(FILE, comment="#")` reads."""

import csv
import io
import json
from pathlib import Path
from typing import Any

from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES

_SWEEP, _PARTS = "_sweep.json", "_parts"  # of a sweep's folder, `eqsim.sweeps.store`
_MEANINGS = {
    "X": "displacement of the slider (length)",
    "t": "time",
    "D": "displacement of the plate (length)",
    "X_stderr": "standard error of X (length)",
    "stage": "displacement of the stage (length)",
    "spring": "force of the stage's spring over N k (length)",
    "force": "<F>/(N k) (length)",
    "segment": "of the programme, from 0",
    "f_k": "F/(N_c k), elastic force per pinned contact (length)",
    **{name: f"energy over N k (length^2), {name}" for name in ("work", "stored", "dissipated", "missing")},
    **{
        name: " ".join(shown.label.split()) + f" ({shown.unit})" * bool(shown.unit)
        for name, shown in OBSERVABLES.items()
    },
}
_SUFFIXES = {  # the longer of two first
    "_reference_error": "bound of the error of the reference",
    "_reference": "exact value",
    "_replica_std": "standard deviation between replicas",
    "_stderr": "statistical standard error",
    "_error": "bound of the error of a numerical solution",
    "_dof": "degrees of freedom of the standard error, none: normal",
    "_reliable": "whether the standard error can be trusted",
    "_z": "difference from the reference in standard errors",
}


def meaning(column: str) -> str:
    """What a column of any table holds; "" where its name says it all, as that of a run file's key."""
    for suffix, text in _SUFFIXES.items():
        if column.endswith(suffix):
            return text
    return _MEANINGS.get(column, "")


def tables(path: Path) -> dict[str, list[Path]]:
    """The Parquet files that make up each table of a file, of a sweep's folder (one table, finished or not) or of
    another folder of results, by the name of the table. Raises InputError."""
    if path.is_file():
        inside = (path.parent / _SWEEP).exists()
        return tables(path.parent) if inside else {path.stem: [path]}
    if not path.is_dir():
        raise InputError(f"{path}: is neither a file nor a folder")
    if (path / _SWEEP).exists():
        rows = [*path.glob("sweep.parquet")] or sorted((path / _PARTS).glob("*.parquet"))
        if not rows:
            raise InputError(f"{path}: is a sweep of which no point is finished")
        return {path.absolute().name: rows}
    found = {one.stem: [one] for one in sorted(path.glob("*.parquet"))}
    if not found:
        raise InputError(f"{path}: has no Parquet files")
    return found


def as_csv(paths: list[Path]) -> bytes:
    """The rows of Parquet files with the same columns. Raises InputError."""
    import pyarrow
    from pyarrow import parquet as pq

    try:
        table = pyarrow.concat_tables([pq.read_table(pyarrow.BufferReader(path.read_bytes())) for path in paths])
        origin = json.loads((table.schema.metadata or {}).get(b"eqsim", b"{}"))
    except OSError as error:
        raise InputError(f"{paths[0]}: cannot be read ({error.strerror or error})") from None
    except (pyarrow.ArrowException, ValueError, RecursionError):
        raise InputError(f"{paths[0]}: is not a Parquet file, or is damaged") from None
    lines = [*_origin(origin if isinstance(origin, dict) else {})]
    lines += [f"{name}: {text}" for name in table.column_names if (text := meaning(name))]
    buffer = io.StringIO()
    for line in lines:
        buffer.write(f"# {line}".rstrip() + "\n")
    buffer.write(",".join(table.column_names) + "\n")
    # text in quotes: no # in it begins a comment
    table.to_pandas().to_csv(buffer, header=False, index=False, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    return buffer.getvalue().encode()


def _origin(origin: dict[str, Any]) -> list[str]:
    """What made a table, and the run file."""
    if not isinstance(origin.get("command"), str):
        return []
    settings, versions = (origin.get(name) or {} for name in ("settings", "versions"))
    units = settings.get("sweep", settings).get("units") or {}
    given = ", ".join(f"{name} {unit}" for name, unit in units.items() if unit)
    lines = [f"eqsim {versions.get('eqsim', '')}: {origin['command']}, seed {origin.get('seed')}"]
    lines.append(f"units: {given}" if given else "units: lengths, times and energies are in those of the run file")
    return lines + [f"| {line}" for line in str(origin.get("run_file") or "").splitlines()]
