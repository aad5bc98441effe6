"""Tables that a run file names: CSV files of thresholds and of recorded drives."""

import functools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

import numpy as np

from eqsim.errors import InputError, under
from eqsim.io import csv
from eqsim.io.series import LEAST_ROWS, broken_line, read_series
from eqsim.io.units import measured
from eqsim.laws.threshold import Table
from eqsim.model.drive import Segment

Result = TypeVar("Result")
More = ParamSpec("More")


def remembered(read: Callable[More, Result]) -> Callable[More, Result]:
    """Keep what `read` makes of the file that its first argument names, until the file
    changes: all points of a sweep share it."""

    @functools.lru_cache(maxsize=8)
    def cached(stamp: object, *args: More.args, **kwargs: More.kwargs) -> Result:
        return read(*args, **kwargs)

    @functools.wraps(read)
    def reader(*args: More.args, **kwargs: More.kwargs) -> Result:
        stamp = None
        with suppress(OSError, ValueError):  # `read` says why
            found = Path(str(args[0])).stat()
            stamp = found.st_mtime_ns, found.st_size
        return cached(stamp, *args, **kwargs)  # type: ignore[arg-type]

    return reader


@remembered
def read_thresholds(
    path: Path, column: str | None = None, scale: float = 1.0, unit: str = ""
) -> Table:
    """The empirical law of a CSV file, one positive number a row, in a `column`, by
    default `threshold` or the only one there is, which needs no name. Thresholds are
    multiplied by `scale`, such as 1e-9 of nanometres where lengths are in metres.
    Raises InputError, with the line that cannot be used, or if the column names another
    known unit than `unit`."""
    field, values = f"thresholds.file = {path}", []
    sheet, hint = csv.read(path, field), " (thresholds.column names another)"
    alone = column is None and len(sheet.columns) == 1
    index = 0 if alone else sheet.index(column or "threshold", hint)
    _require_unit(sheet, index, unit, "; thresholds.scale = {:.6g} converts")
    for line, cells in (sheet.whole if alone else sheet).rows():
        value = csv.value_of(cells[index])
        if not 0 < value < math.inf:
            said = f"{cells[index][:40]!r} must be a finite number > 0"
            raise InputError(f"{field}, line {line}: {said}")
        values.append(value * scale)
    if not values:
        raise InputError(f"{field}: is empty; at least one threshold is needed")
    try:
        return Table(values)
    except InputError as error:
        raise InputError(f"{field}: {error}") from None


def _require_unit(sheet: csv.Sheet, index: int, unit: str, cure: str = "") -> None:
    """Raise InputError, with a `cure` that takes the ratio, if a column names another
    unit than `unit`, and both are known."""
    there = sheet.unit(index)
    found, ours = measured(f"1 {there}"), measured(f"1 {unit}")
    if found and ours and any(found[1]) and any(ours[1]) and found != ours:
        said = f'column "{sheet.columns[index]}" is in {there}, [units] says {unit}'
        said += cure.format(found[0] / ours[0]) * (found[1] == ours[1])
        raise InputError(f"{sheet.field}: {said}")


@dataclass(frozen=True)
class DriveRecord:
    """How a recorded drive is read: its columns, the time on its clock that becomes 0
    ("first row" or a number; also the displacement there), and whether it is smoothed,
    as straight lines that noise hides."""

    time: str = "t"
    displacement: str = "X"
    start: str | float | None = None
    smooth: bool = False


class RecordedDrive(NamedTuple):
    """Segments of a recorded drive, and how its rows were read, in words."""

    segments: list[Segment]
    said: list[str]


@remembered
def read_drive(
    path: Path, record: DriveRecord | None = None, units: Sequence[str] = ("", "")
) -> RecordedDrive:
    """The segments of a recorded drive: a CSV file with times and displacements,
    piecewise linear. Without a `record` the columns are `t` and `X`, from 0 and 0 on,
    and gaps and equal times are refused. Raises InputError, with the line, or if they
    name other known units than `units` of time and length."""
    field, how = f"file = {path}", record or DriveRecord()
    sheet = csv.read(path, field)
    names, strict = [how.time, how.displacement], record is None
    t, values, lines, said = read_series(sheet, names, how.start, strict=strict)
    for name, unit in zip(names, units, strict=True):
        _require_unit(sheet, sheet.index(name), unit)
    X = values[:, 0] - (0.0 if strict else values[0, 0])
    if (t[0], X[0]) != (0.0, 0.0):
        first = f"{field}, line {lines[0]}: {how.time} = {t[0]:g}"
        needed = f"the first instant must be {how.time} = 0, {how.displacement} = 0"
        cure = 'drive.record.start = "first row" shifts both'
        if how.start == "first row":
            cure = "gaps come before; give the time of this line as drive.record.start"
        raise InputError(f"{first}, {how.displacement} = {X[0]:g}: {needed}; {cure}")
    least, said_of = (LEAST_ROWS, " with smooth = true") if how.smooth else (2, "")
    if t.size < least:
        raise InputError(f"{field}: needs {least} instants at least{said_of}")
    velocity = np.diff(X) / np.diff(t)
    if how.smooth:
        t, velocity = broken_line(t, X)
    segments, pairs = [], zip(velocity.tolist(), np.diff(t).tolist(), strict=True)
    for number, (v, elapsed) in enumerate(pairs, 1):
        with under(field if how.smooth else f"{field}, line {lines[number]}"):
            segments.append(Segment(v, time=elapsed))
    smoothed = f"smoothed to {len(segments)} segments" if how.smooth else "not smoothed"
    return RecordedDrive(segments, [f"{lines.size} instants", *said, smoothed])
