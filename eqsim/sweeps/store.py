"""The folder of a sweep.

It holds `sweep.parquet`, the rows in the order of the grid with the columns of
`schema` (null where one does not apply), and `_sweep.json`, what was asked for. While a
sweep runs its rows are in `parts/`, in files named by a digest of their content; when
all are there, that folder becomes `_parts` just before the table gets its name. Names
that begin with "_" are not part of the dataset, so `pandas.read_parquet(FOLDER)` reads
each finished row once. The metadata key `eqsim` holds the run file, the settings,
versions and the version of the schema.
"""

import hashlib
import json
import os
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow as pa

from eqsim.engine.records import OF_SEGMENT, OF_STEP
from eqsim.errors import InputError
from eqsim.estimate import OBSERVABLES
from eqsim.io import storage
from eqsim.io.parameters import keys, naming, parameters
from eqsim.io.runfile import RunFile, contents_of
from eqsim.io.storage import SWEEP_HIDDEN, SWEEP_MANIFEST, SWEEP_PARTS, SWEEP_TABLE
from eqsim.io.units import quantities
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Plan, entries, seed_of, swept
from eqsim.sweeps.rows import Asked

try:
    import fcntl
except ImportError:  # a system without locks
    fcntl = None  # type: ignore[assignment]

# Version of the columns.
SCHEMA = 2
_LOCK = "_lock"
# In messages of points at which workers died: the machine's fault, not the point's.
WORKERS_DIED = "workers died at this point"
# Key of a manifest for the version of results.
_VERSION = "results version"
# Beginning of keys of a manifest for the contents of files.
_CONTENT = "content of "
# Characters of a value in a message.
_SHOWN = 80
# Rows that are written at once.
_FLUSH_ROWS = 256


def schema(plan: Plan) -> Any:
    """The pyarrow schema of the dataset of a sweep: the columns that any of its points
    fills."""
    file, runs = plan.file, plan.runs
    number, integer, text = pa.float64(), pa.int64(), pa.string()
    others = {"dof": integer, "reliable": pa.bool_()}
    exact = ("reference", "reference_error", "z")

    def columns(name: str, *ends: str) -> dict[str, Any]:
        return {name: number} | {
            f"{name}_{end}": others.get(end, number) for end in ("stderr", *ends)
        }

    types = {float: number, int: integer, str: text}
    named = naming(file).keys() | plan.changed
    known = {key: types[kind] for key, kind in keys(file).items() if key in named}
    fields = {"id": text, **known}
    fields |= {"kind": text, "status": text, "message": text}
    for name in OBSERVABLES:
        fields |= columns(name, "dof", "reliable", *exact)
    converted = quantities(Ensemble(), file.units, file.interface)
    stalls = "drive.stall_force" in plan.changed or file["drive.stall_force"]
    of_replicas = "pulled" in runs and (stalls or file["elastic"])
    for one in converted if runs & {"averages", "blocks"} or of_replicas else ():
        fields |= columns(one.column, "reference")
    for name in ("size", "single") if file["elastic"] else ():
        fields |= columns(name, "reference", "z")
    if "forced" in runs:
        for name in ("lifetime", "strength"):
            fields |= columns(name, "dof", *exact)
    if "pulled" in runs:
        fields |= {"slips": integer, **columns("period"), **columns("drop")}
    segmented = file["drive.programme"] or "programme" in runs
    for name, is_force in _of_segments(file).items() if segmented else ():
        sure = ("reliable",) * name.endswith(("_healing", "_drop"))
        fields |= columns(name, *sure, *exact)
        for one in converted if is_force else ():
            fields |= columns(f"{name}_{one.column}", "reference")
    fields |= {"reference_method": text, "lives": integer, "seed": integer}
    fields |= {"seconds": number, "eqsim_version": text}
    return pa.schema(list(fields.items()))


def _of_segments(file: RunFile) -> dict[str, bool]:
    """Columns of observables of segments, one without a programme, and whether each is
    a force."""
    return {
        f"segment_{index}_{name}": name not in ("at", "memory")
        for index in range(len(file["drive.programme"] or [file["drive"]]))
        for name in (*OF_SEGMENT, *OF_STEP)
    }


def physical(file: RunFile, row: dict[str, Any]) -> dict[str, float]:
    """Columns of the forces of a point, friction or those of segments, in laboratory
    quantities; none of a point that failed."""
    forces = {"friction": ""}
    forces |= {
        name: f"{name}_" for name, is_force in _of_segments(file).items() if is_force
    }
    known = [name for name in forces if row.get(name) is not None]
    if not known:
        return {}
    return {
        forces[name] + one.column + end: row[name + end] * one.factor
        for one in quantities(file.ensemble, file.units, file.interface)
        for name in known
        for end in ("", "_stderr", "_reference")
        if row.get(name + end) is not None
    }


class Store:
    """The folder `out` of a sweep, held by a lock that dies with its process:
    identities of the points that are `done`, and files that were found `damaged`.
    Raises InputError if it is in use, holds something else, or cannot be written.
    """

    def __init__(self, out: Path, plan: Plan, asked: Asked) -> None:
        storage.check_folder(out, sweep=True)
        self.out, self.plan, file = out, plan, plan.file
        self.transient = asked.transient
        files = [path for path in out.glob("[!._]*") if path.name != SWEEP_PARTS]
        files += storage.sweep_parts(out)
        # All files of the folder are read as one table. Without a manifest they are not
        # of a sweep, or of one whose manifest is lost.
        if files and not (out / SWEEP_MANIFEST).exists():
            other = f"holds files of another origin, {files[0].name}"
            raise InputError(f"--out {out}: {other}; must be a folder of its own")
        out.mkdir(parents=True, exist_ok=True)
        self.lock = self._locked()
        try:
            self._agree(asked)
            (out / SWEEP_PARTS).mkdir(exist_ok=True)
            for path in (*out.glob(".eqsim-*"), *out.glob("*parts/.eqsim-*")):
                shutil.rmtree(path) if path.is_dir() else path.unlink()  # unfinished
            settings = {"sweep": file.sweep_settings(), **asked.settings()}
            where = file.text, file.output.seed, file.folder
            origin = storage.provenance("sweep", settings, *where)
            origin |= {"schema": SCHEMA, "results_version": RESULTS_VERSION}
            self.version = origin["versions"]["eqsim"]
            metadata = {"eqsim": storage.to_json(origin)}
            self.schema = schema(plan).with_metadata(metadata)
            self.rows: list[dict[str, Any]] = []
            self.tables: list[Any] = []
            self.damaged: list[str] = []
            self._load()
        except BaseException:
            self.close()
            raise
        self.flushed = time.monotonic()

    def _locked(self) -> int:
        # Permissions modulo umask: the folder may be a group's.
        handle = os.open(self.out / _LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            said = "another sweep is at work in this folder"
            raise InputError(f"--out {self.out}: {said}") from None
        except OSError:  # a file system without locks
            pass
        return handle

    def close(self) -> None:
        """Release the folder."""
        os.close(self.lock)

    def _asked(self, asked: Asked) -> dict[str, str]:
        """All that the rows depend on, by name."""
        file = self.plan.file
        values = {**naming(file), **asked.settings()}
        for section in ("units", "interface"):
            pairs = file.settings[section].items()
            values |= {f"{section}.{key}": value for key, value in pairs if value}
        values |= {f"sweep.{key}": value for key, value in entries(file.sweep)}
        values["order of axes"] = [key for key, _ in entries(file.sweep)]
        texts = {key: repr(value) for key, value in values.items()}
        for name, content in contents_of(file, self.plan.files).items():
            texts[_CONTENT + name] = _digest(content)
        return texts | {"schema": str(SCHEMA), _VERSION: str(RESULTS_VERSION)}

    def _agree(self, asked: Asked) -> None:
        """Write the manifest, or check that it asks for the same. Raises InputError."""
        plan, path, now = self.plan, self.out / SWEEP_MANIFEST, self._asked(asked)
        if not path.exists():
            manifest = {"asked": now, "points": plan.size, "run_file": plan.file.text}
            storage.save(path, json.dumps(manifest, indent=2).encode())
            return
        try:
            before = json.loads(path.read_bytes())["asked"]
            # whatever the values of keys are that the points set
            known = {*now, *before}.difference(swept(plan.file))
            # earlier releases do not know the contents of files that an axis names
            known -= {key for key in now.keys() - before if key.startswith(_CONTENT)}
            changed = [key for key in sorted(known) if now.get(key) != before.get(key)]
        except (ValueError, KeyError, TypeError, AttributeError):
            said = "is damaged; this folder cannot be continued"
            raise InputError(f"{path}: {said}") from None
        if _VERSION in changed:
            raise InputError(
                f"--out {self.out}: was begun by another version of eqsim (results "
                f"version {before.get(_VERSION)}, not {RESULTS_VERSION}); finish it "
                "with that one, or use another folder, in which all points are "
                "computed anew; `eqsim export` and `eqsim plot` read this one as it is"
            )
        if changed:
            listed = "; ".join(_difference(key, before, now) for key in changed)
            other = f"holds another sweep, use another folder: {listed}"
            raise InputError(f"--out {self.out}: {other}")

    def _load(self) -> None:
        """Read the rows on disk; list and remove damaged files. Raises InputError for
        rows with other columns."""
        final = self.out / SWEEP_TABLE
        for path in [final] * final.exists() + storage.sweep_parts(self.out):
            content = path.read_bytes()
            whole = path == final or path.stem == f"part-{_digest(content)}"
            table = storage.from_parquet(content) if whole else None
            if table is None:
                self.damaged.append(str(path))
            elif not table.schema.equals(self.schema):
                other = "has other columns than this version of eqsim writes"
                raise InputError(f"{path}: {other}; use another folder")
            else:
                self._keep(path, table)
        for path in map(Path, self.damaged):
            path.unlink()
        self.parts, self.complete = storage.sweep_parts(self.out), final.exists()
        self.done = self._on_disk()

    def _keep(self, path: Path, table: Any) -> None:
        """Keep the rows of a file, but for those of points at which workers died, which
        are computed again: a file of the others takes its place."""
        said = enumerate(table["message"].to_pylist())
        kept = [row for row, message in said if WORKERS_DIED not in (message or "")]
        if len(kept) == table.num_rows:
            self.tables.append(table)
            return
        if kept:
            self.tables.append(table.take(kept))
            self._write(self.tables[-1])
        path.unlink()

    def _write(self, table: Any) -> Path:
        """Write rows to a file named by its content."""
        content = storage.as_parquet(table)
        path = self.out / SWEEP_PARTS / f"part-{_digest(content)}.parquet"
        storage.save(path, content)
        return path

    def _on_disk(self) -> set[str]:
        names = (table["id"].to_pylist() for table in self.tables)
        return set().union(*names) & set(self.plan.ids)

    def add(self, index: int, row: dict[str, Any]) -> None:
        """Keep the row of a point; it reaches the disk with `flush`."""
        point_id, point = self.plan.ids[index], self.plan.at(index)
        row = {**parameters(point), **row, **physical(point, row)}
        row |= {"id": point_id, "seed": seed_of(point_id)}
        row["kind"] = self._kind(point.drive)
        self.rows.append(row | {"eqsim_version": self.version})
        self.done.add(point_id)
        if len(self.rows) >= _FLUSH_ROWS:
            self.flush()

    def _kind(self, drive: Drive | Programme) -> str:
        """Say over what the observables of a point are averaged."""
        if isinstance(drive, Programme):
            return "programme"
        return "transient" if self.transient or drive.elastic else "steady"

    def flush(self, older: float = 0.0) -> None:
        """Write the rows at hand to a file if the last one is `older` seconds old."""
        if not self.rows or time.monotonic() - self.flushed < older:
            return
        table = pa.Table.from_pylist(self.rows, self.schema)
        self.parts.append(self._write(table))
        self.tables.append(table)
        self.rows, self.flushed = [], time.monotonic()

    def kept(self) -> str:
        """Write the rows at hand, also those of a `flush` that was broken off, and say
        how many points are on disk."""
        self.flush()
        return f"{len(self._on_disk())} of {self.plan.size} points are on disk"

    def compact(self) -> Any:
        """Write all rows to one file, in the order of the grid, each once, and return
        them as a pyarrow table. A process that dies meanwhile loses and doubles none."""
        self.flush()
        table = pa.concat_tables(self.tables)
        rows = reversed([*enumerate(table["id"].to_pylist())])
        first = {point_id: row for row, point_id in rows}
        table = table.take([first[name] for name in self.plan.ids]).combine_chunks()
        if self.parts or not self.complete:
            metadata = {"eqsim": storage.to_json(self._origin())}
            table = table.replace_schema_metadata(metadata)
            content = storage.as_parquet(table)
            shown, hidden = self.out / SWEEP_PARTS, self.out / SWEEP_HIDDEN
            if hidden.exists():  # of a `compact` that was broken off
                for path in shown.glob("*.parquet"):
                    path.replace(hidden / path.name)
            else:  # one rename takes them all out of the dataset
                shown.replace(hidden)
            storage.save(self.out / SWEEP_TABLE, content)
        for path in storage.sweep_parts(self.out):
            path.unlink()
        for name in (SWEEP_PARTS, SWEEP_HIDDEN):
            with suppress(OSError):
                (self.out / name).rmdir()
        return table

    def _origin(self) -> dict[str, Any]:
        """The provenance of the first rows, with the versions that any rows were
        computed with."""
        every = [storage.origin_of(table.schema) for table in self.tables]
        used = {
            name: sorted({origin["versions"][name] for origin in every})
            for name in every[0]["versions"]
        }
        versions = {name: ", ".join(known) for name, known in used.items()}
        return {**every[0], "versions": versions}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _difference(key: str, before: dict[str, str], now: dict[str, str]) -> str:
    """Say how an entry of a manifest differs; of a long one from the first element of a
    list on that does."""
    old, new = str(before.get(key, "absent")), now.get(key, "absent")
    pairs = enumerate(zip(old, new, strict=False))
    same = next((i for i, (a, b) in pairs if a != b), min(len(old), len(new)))
    if same >= _SHOWN // 2:
        first = max(new.rfind(", ", 0, same) + 2, same - _SHOWN // 2)
        old, new = f"...{old[first:]}", f"...{new[first:]}"
    return f"{key} was {old[:_SHOWN]}, is {new[:_SHOWN]}"
