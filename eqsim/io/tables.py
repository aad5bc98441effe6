"""Tables that a run file names: CSV files of thresholds and of recorded drives."""

import functools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

from eqsim.errors import InputError, under
from eqsim.io import csv
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
        try:
            found = Path(str(args[0])).stat()
            stamp = found.st_mtime_ns, found.st_size
        except (OSError, ValueError):  # `read` says why
            pass
        return cached(stamp, *args, **kwargs)  # type: ignore[arg-type]

    return reader


@remembered
def read_thresholds(path: Path, column: str | None = None, scale: float = 1.0) -> Table:
    """The empirical law of a CSV file, one positive number a row; lines that begin with
    # are comments.

    Parameters
    ----------
    path : Path
    column : str, optional
        Where the thresholds stand. Default: `threshold`, or the only column there is,
        which needs no name.
    scale : float
        What they are multiplied by, such as 1e-9 of nanometres where lengths are in
        metres.

    Raises
    ------
    InputError
        With the line that cannot be used.
    """
    field, values = f"thresholds.file = {path}", []
    for line, text in _column_of_thresholds(csv.read(path, field), column):
        value = csv.value_of(text)
        if not 0 < value < math.inf:
            raise InputError(
                f"{field}, line {line}: {text[:40]!r} must be a finite number > 0"
            )
        values.append(value * scale)
    if not values:
        raise InputError(f"{field}: is empty; at least one threshold is needed")
    try:
        return Table(values)
    except InputError as error:
        raise InputError(f"{field}: {error}") from None


def _column_of_thresholds(
    sheet: csv.Sheet, column: str | None
) -> Iterator[tuple[int, str]]:
    """Lines and cells of a `column`; by default of `threshold`, or of the only one
    there is, which needs no name."""
    index = 0
    if column is None and len(sheet.columns) == 1:
        if sheet.headless:
            yield sheet.first, sheet.columns[0]
    else:
        index = sheet.index(column or "threshold", " (thresholds.column names another)")
    for line, cells in sheet.rows():
        yield line, cells[index]


class _Instant(NamedTuple):
    """A row of a recorded drive."""

    t: float
    X: float


@remembered
def read_drive(path: Path) -> list[Segment]:
    """The segments of a recorded drive: a CSV file with columns `t` and `X`, piecewise
    linear, from 0 and 0 on.

    Raises
    ------
    InputError
        With the line that cannot be used.
    """
    field, segments = f"file = {path}", []
    before: _Instant | None = None
    sheet = csv.read(path, field)
    columns = sheet.index("t"), sheet.index("X")
    for line, cells in sheet.rows():
        texts = [cells[index] for index in columns]
        here = f"{field}, line {line}"
        now = _Instant(*map(csv.value_of, texts))
        if not all(map(math.isfinite, now)):
            given = ", ".join(texts)[:40]
            raise InputError(f"{here}: {given!r} must be finite numbers")
        if before is None:
            if now != (0.0, 0.0):
                said = "the first instant must be t = 0, X = 0"
                raise InputError(f"{here}: t = {now.t:g}, X = {now.X:g}; {said}")
        else:
            elapsed = now.t - before.t
            if not elapsed > 0:
                said = f"must be later than the {before.t:g} before it"
                raise InputError(f"{here}: t = {now.t:g} {said}")
            with under(here):
                segments.append(Segment((now.X - before.X) / elapsed, time=elapsed))
        before = now
    if not segments:
        raise InputError(f"{field}: needs two instants at least")
    return segments
