"""CSV files, those that users bring and those that `eqsim export` writes: one reader,
one writer.

A line holds cells with commas between them, and the first one names the columns. A cell
may stand in double quotes, in which a quote is doubled; it ends on its line. Comments
(lines that begin with #, whatever else they hold), empty lines, a byte-order mark, the
kind of line ends and blanks around cells do not count. Every other line is a row, or is
refused with its number: none can vanish between two quotes.
"""

import hashlib
import io
import math
import re
import stat
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eqsim.errors import InputError

MOST_BYTES = 1_000_000_000  # of a file, which is read into memory
# in quotes, or as it stands
_CELL = re.compile(r'\s*(?:"((?:[^"]|"")*)"\s*|([^",\s][^,]*|))(?:,|\Z)')
_LINE_END = re.compile(rb"\r\n|\r|\n")
# how numbers begin
_LIKE_A_NUMBER = re.compile(r"[+-]?(\.?\d|(nan|inf|infinity)\Z)", re.IGNORECASE)


@dataclass(frozen=True)
class Sheet:
    """The rows of a CSV file.

    Attributes
    ----------
    field : str
        The key that names the file, and its path: how messages begin.
    columns : list of str
        Their names.
    first : int
        Number of the line that holds these.
    text : str
        The whole file.
    sha256 : str
        Its digest.
    """

    field: str
    columns: list[str]
    first: int
    text: str
    sha256: str

    @property
    def headless(self) -> bool:
        """True if the first line begins with a number, so that it is a row and no
        names."""
        return bool(_LIKE_A_NUMBER.match(self.columns[0]))

    def index(self, name: str, hint: str = "") -> int:
        """Number of the column with a name. Raises InputError, to which a `hint` is
        added, unless exactly one has."""
        count = self.columns.count(name)
        if count == 0:
            there = ", ".join(self.columns)[:60] + hint
            needed = f'needs a column "{name}" in its first line'
            raise InputError(f"{self.field}: {needed}; found {there}")
        if count > 1:
            raise InputError(f'{self.field}: has {count} columns "{name}"')
        return self.columns.index(name)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Number of the line and a cell for each column, of every row. Raises
        InputError for a line that is none."""
        width = len(self.columns)
        for number, line in _lines(self.text):
            if number <= self.first:
                continue
            where = f"{self.field}, line {number}"
            cells = _cells(line, where)
            if any(cells[width:]):
                said = "more values than columns (a decimal comma?)"
                raise InputError(f"{where}: {said}")
            if len(cells) < width:
                said = f"has {len(cells)} of {width} cells"
                raise InputError(f"{where}: {said}; an empty one takes its comma, too")
            yield number, cells[:width]


def read(path: Path, field: str) -> Sheet:
    """Read a CSV file, which `field` names in messages.

    Raises
    ------
    InputError
        If it cannot be read, is no text in UTF-8, or has no first line with names and
        commas.
    """
    content = _content(path, field)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{field}: is text in UTF-16; must be in UTF-8")
    try:
        text = content.decode().removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        number = len(_LINE_END.findall(content, 0, error.start)) + 1
        raise InputError(f"{field}, line {number}: is not text in UTF-8") from None
    first, line = next(_lines(text), (0, ""))
    if not first:
        raise InputError(f"{field}: is empty; its first line must name the columns")
    columns = [name.strip() for name in _cells(line, f"{field}, line {first}")]
    while len(columns) > 1 and not columns[-1]:  # commas at the end of every line
        columns.pop()
    if len(columns) == 1 and re.search("[;\t]", columns[0]):
        raise InputError(f"{field}: cells must be separated by commas")
    return Sheet(field, columns, first, text, hashlib.sha256(content).hexdigest())


def _content(path: Path, field: str) -> bytes:
    try:
        there = path.stat()
        if not stat.S_ISREG(there.st_mode):  # a pipe or a device may never end
            raise InputError(f"{field}: is not a file")
        if there.st_size > MOST_BYTES:
            raise InputError(f"{field}: is longer than {MOST_BYTES:.0e} bytes")
        return path.read_bytes()
    except InputError:
        raise
    except (OSError, ValueError) as error:  # of a name that no file can have
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{field}: cannot be read ({why})") from None


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines but for empty ones and comments, numbered from 1."""
    for number, line in enumerate(io.StringIO(text, newline=None), 1):
        begin = line.lstrip()
        if begin and not begin.startswith("#"):
            yield number, line.removesuffix("\n")


def _cells(line: str, where: str) -> list[str]:
    """The cells of a line. Raises InputError, which says `where`, for a quote that is
    not closed."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(",")]
    cells: list[str] = []
    place, more = 0, True
    while more:
        match = _CELL.match(line, place)
        if match is None:
            shown = line[place:].strip()[:40]
            said = "a quote must be closed before the next comma or line end"
            raise InputError(f"{where}: {shown!r} is no cell; {said}")
        quoted, plain = match.groups()
        cells.append(plain.rstrip() if quoted is None else quoted.replace('""', '"'))
        place, more = match.end(), match[0].endswith(",")
    return cells


def value_of(cell: str) -> float:
    """The number in a cell; NaN if it holds none."""
    try:
        # Python's 1_000 is not a number elsewhere
        return float(cell if "_" not in cell else "nan")
    except ValueError:
        return math.nan


def number(cell: str, where: str) -> float:
    """The finite number in a cell. Raises InputError, which says `where`."""
    value = value_of(cell)
    if math.isfinite(value):
        return value
    if math.isinf(value) or cell.strip().lower().lstrip("+-") == "nan":
        raise InputError(f"{where} = {cell[:40]}: must be finite")
    hint = "; decimal commas must be points" if "," in cell else ""
    raise InputError(f"{where} = {cell[:40]!r}: must be a number{hint}")


def written(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Iterator[str]:
    """The lines of a table, names of columns first. Text is in quotes, so that no # in
    it begins a comment; a value that is missing or NaN is an empty cell, and numbers
    are as exact as they are. Raises InputError for text with a line break, which no
    cell can hold."""
    yield ",".join(_name(name) for name in columns)
    for row in rows:
        yield ",".join(map(_cell, row)) or '""'  # an empty line would be none


def _name(name: str) -> str:
    plain = name and name == name.strip() and not re.search('["#,\r\n]', name)
    return name if plain else _quoted(name)


def _quoted(text: str) -> str:
    if "\n" in text or "\r" in text:
        said = "has a line break, which no cell of a CSV file can hold"
        raise InputError(f"{text[:40]!r} {said}")
    return '"' + text.replace('"', '""') + '"'


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    return repr(value) if isinstance(value, (bool, int, float)) else _quoted(str(value))
