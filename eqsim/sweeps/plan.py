"""The points of a sweep: from a run file's [sweep] table to checked run files, each
with an identity and a seed."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
import pyarrow

from eqsim.errors import InputError, require_integer, require_number, shown, under
from eqsim.io.content import alternative, of_blocks, path_of
from eqsim.io.course import require_use
from eqsim.io.parameters import keys, naming
from eqsim.io.runfile import RunFile, at
from eqsim.io.schema import OPTIONAL
from eqsim.io.storage import read_parquet
from eqsim.laws.threshold import Table
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.rows import Run, Task, run_of

MOST_POINTS = 1_000_000
# Beginnings of keys that only some run files have.
_IN_FILES = ("drive.programme", "population", *OPTIONAL)


class Plan:
    """All points of a run file's [sweep] table, in the order of the grid, the last axis
    fastest. Their identities, of which seeds are made, are digests of parameters and
    `RESULTS_VERSION`, or `ids` from an earlier plan, whose points are not checked again.
    `runs` are what the points compute. Raises InputError for a table, or a point of it,
    that cannot be used."""

    def __init__(self, file: RunFile, ids: list[str] | None = None) -> None:
        self.file, self.axes = file, _axes(file)
        if file["drive.file"] is not None or "drive.file" in self.changed:
            raise InputError("drive.file: not allowed with [sweep]")
        self.size = math.prod(len(axis) for axis in self.axes)
        if self.size > MOST_POINTS:
            raise InputError(f"sweep: has {self.size} points; at most {MOST_POINTS}")
        self.runs = set[Run]()
        known = ids if ids and len(ids) == self.size else None
        self.ids = known or [self._checked(index) for index in range(self.size)]
        self.checked = not known
        if known:
            self.runs = {run_of(self.at(index).drive) for index in range(self.size)}
        seen: dict[str, int] = {}
        for index, point_id in enumerate(self.ids):
            if (first := seen.setdefault(point_id, index)) != index:
                pairs = self.changes(index).items()
                same = ", ".join(f"{key} = {shown(value)}" for key, value in pairs)
                both = f"points {first + 1} and {index + 1}"
                raise InputError(f"sweep: {both} are the same ({same})")

    @property
    def changed(self) -> set[str]:
        """The keys that are set at any point."""
        return set[str]().union(*(row for axis in self.axes for row in axis))

    @property
    def files(self) -> set[str]:
        """Names of the files of points, thresholds and loads that axes are made of."""
        pairs = (pair for axis in self.axes for row in axis for pair in row.items())
        of_files = (x for key, x in pairs if key.endswith((".file", "elastic.load")))
        files = {name for name in of_files if isinstance(name, str)}
        return files | {x for key, x in self.file.sweep.items() if key == "file"}

    def _checked(self, index: int) -> str:
        """Check that a point can be computed, and return its identity."""
        try:
            point = self.at(index)
            if "drive.velocity" in self.changes(index):
                require_use(point)
            ensemble, drive = point.ensemble, point.drive
            blocks = point["elastic.blocks"] if point["elastic"] else None
            if isinstance(blocks, list):
                given = f"elastic.blocks = {shown(blocks)}"
                raise InputError(f"{given}: a sweep has a column for chains only")
        except InputError as error:
            raise InputError(f"{self._place(index)}: {error}") from None
        self.runs.add(run_of(drive))
        return identity(point, ensemble)

    def _place(self, index: int) -> str:
        """The words with which a message on a point begins."""
        return f"sweep, point {index + 1} of {self.size}"

    def changes(self, index: int) -> dict[str, Any]:
        """Keys and values in which a point differs from the run file."""
        numbers = np.unravel_index(index, [len(axis) for axis in self.axes])
        rows = (axis[number] for axis, number in zip(self.axes, numbers, strict=True))
        return {key: value for row in rows for key, value in row.items()}

    def at(self, index: int) -> RunFile:
        """The run file of a point."""
        return at(self.file, self.changes(index))

    def task(self, index: int) -> Task:
        """The point for a worker. Raises InputError if a file that the point was made
        of has changed since it was checked."""
        point, seed = self.at(index), seed_of(self.ids[index])
        ensemble = point.ensemble
        if self.checked and identity(point, ensemble) != self.ids[index]:
            said = "a file that the run file names has changed since the sweep began"
            raise InputError(
                f"{self._place(index)}: {said}; finished points are on disk"
            )
        points, replicas = point.output.points, point.output.replicas
        return Task(seed, ensemble, point.drive, points, replicas)


def _axes(file: RunFile) -> list[list[dict[str, Any]]]:
    """The axes of a [sweep] table: lists of changed keys and values. Raises InputError."""
    axes = []
    for key, spec in entries(file.sweep):
        if key == "file":
            axes.append(_points_file(spec, file))
        elif key == "zip":
            groups = spec if isinstance(spec, list) else [spec]
            axes += [_zipped(group, file) for group in groups]
        else:
            axes.append([{key: value} for value in _axis(key, spec, file)])
    if not axes:
        example = '"drive.velocity" = [0.1, 1.0]'
        raise InputError(f"sweep: needs a [sweep] table, for example {example}")
    known = Counter(key for axis in axes for key in set[str]().union(*axis))
    if several := sorted(key for key, count in known.items() if count > 1):
        raise InputError(f"sweep.{several[0]}: is in two axes; must be in one")
    return axes


def _zipped(group: Any, file: RunFile) -> list[dict[str, Any]]:
    """One axis of several keys that advance together."""
    if not isinstance(group, dict) or not group:
        example = 'zip = [{ "KEY" = [...], ... }]'
        raise InputError(
            f"sweep.zip: must be tables of axes of equal length, {example}"
        )
    values = {name: _axis(name, spec, file) for name, spec in entries(group)}
    if len({len(axis) for axis in values.values()}) > 1:
        lengths = ", ".join(f"{name} {len(axis)}" for name, axis in values.items())
        raise InputError(f"sweep.zip: axes must have equal lengths; found {lengths}")
    rows = zip(*values.values(), strict=True)
    return [dict(zip(values, row, strict=True)) for row in rows]


def swept(file: RunFile) -> dict[str, str]:
    """The keys that a [sweep] table sets at every point, and those that say the same,
    as a kT beside a temperature; each with its axis. Raises InputError."""
    found = {
        key: key for axis in _axes(file) for key in set.intersection(*map(set, axis))
    }
    others = {alternative(key): key for key in found}
    return {other: key for other, key in others.items() if other} | found


def entries(
    table: dict[str, Any], leaves: Collection[str] = ("log", "linear")
) -> Iterator[tuple[str, Any]]:
    """Keys and values of a table, also those of unquoted keys such as drive.velocity,
    which TOML reads as tables; a table is a value if it has one of the `leaves`."""
    above = {"fit", *(key.split(".")[0] for key in keys() if "." in key)}
    for key, value in table.items():
        nested = key in above or key.startswith(_IN_FILES)
        if nested and isinstance(value, dict) and not set(leaves) & value.keys():
            named = {f"{key}.{name}": part for name, part in value.items()}
            yield from entries(named, leaves)
        else:
            yield key, value


def _refuse_unknown(key: str, file: RunFile) -> None:
    """Raise InputError, with the nearest key, unless a run file has this key."""
    if key not in keys(file):
        at(file, {key: 0})


def _axis(key: str, spec: Any, file: RunFile) -> list[Any]:
    """The values of one key: a list, { log = [first, last, count] } or { linear =
    [first, last, count] }."""
    with under("sweep"):
        _refuse_unknown(key, file)
    if isinstance(spec, list) and spec:
        return spec
    form = next(iter(spec), "") if isinstance(spec, dict) and len(spec) == 1 else ""
    if form not in ("log", "linear"):
        raise InputError(
            f"sweep.{key} = {shown(spec)}: must be a list of values, "
            "{ log = [first, last, count] } or { linear = [first, last, count] }"
        )
    name, ends = f"sweep.{key}.{form}", spec[form]
    if not isinstance(ends, list) or len(ends) != 3:
        raise InputError(f"{name} = {shown(ends)}: must be [first, last, count]")
    if keys(file)[key] is str:
        raise InputError(f"{name}: this key holds text; must be a list of values")
    first, last, count = ends
    lower = {"above": 0.0} if form == "log" else {"least": -1e100}
    for value in (first, last):
        require_number(name, value, **lower, most=1e100)
    whole = int(count) if isinstance(count, float) and count.is_integer() else count
    require_integer(f"{name}, count", whole, 2, MOST_POINTS)
    spaced = np.geomspace if form == "log" else np.linspace
    inner = spaced(float(first), float(last), whole)[1:-1]
    # Twelve digits: 0.1 is 0.1, on any grid and any machine.
    values = [first, *(float(f"{x:.12g}") for x in inner), last]
    return [round(x) for x in values] if keys(file)[key] is int else values


def _points_file(name: Any, file: RunFile) -> list[dict[str, Any]]:
    """Explicit points, one per row of a Parquet file; null is the run file's value.
    Raises InputError."""
    wanted = "a Parquet file whose columns are keys"
    if not isinstance(name, str):
        raise InputError(f"sweep.file = {shown(name)}: must be the name of {wanted}")
    path = path_of("sweep.file", file.folder, name)
    if not path.is_file():
        raise InputError(f"sweep.file = {path}: is not a file; must be {wanted}")
    try:
        rows = read_parquet(path.read_bytes()).to_pylist()
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise InputError(
            f"sweep.file = {path}: cannot be read as Parquet ({str(error)[:100]})"
        ) from None
    if not rows:
        raise InputError(f"sweep.file = {path}: has no rows; must have one a point")
    for key in rows[0]:
        with under(f"sweep.file = {name}, column"):
            _refuse_unknown(key, file)
    return [{of_blocks(k): x for k, x in row.items() if x is not None} for row in rows]


def identity(point: RunFile, ensemble: Ensemble) -> str:
    """Hexadecimal SHA-256 of the sorted parameters of a point, its seed and the results
    version. A table of thresholds enters with its values, not with the name of its
    file."""
    values = naming(point)
    seed = values.pop("output.seed")
    laws = {"": ensemble.thresholds}
    for index, population in enumerate(ensemble.populations):
        laws[f"population.{index}."] = population.thresholds or ensemble.thresholds
    for above, law in laws.items():
        if isinstance(law, Table):
            digest = hashlib.sha256(law.steps.tobytes()).hexdigest()
            values[f"{above}thresholds.file"] = digest
        for name in ("column", "scale", "quantity"):
            values.pop(f"{above}thresholds.{name}", None)
    text = json.dumps([values, seed, RESULTS_VERSION], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def seed_of(point_id: str) -> int:
    """The random seed of a point, below 2^63."""
    return int(point_id[:16], 16) >> 1
