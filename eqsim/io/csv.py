"""CSV files, those that users bring and those that `eqsim export` writes: one reader,
one writer.

A line holds cells with commas, semicolons, tabs or blanks between them, and the first
one names the columns, with units or a row of these below, if any. A cell may stand in
double quotes, in which a quote is doubled; it ends on its line. Comments (lines that
begin with # or %, whatever else they hold), Excel's `sep=;`, empty lines, a byte-order
mark, the kind of line ends and blanks around cells do not count. Numbers have a decimal
point or a decimal comma, text is in UTF-8 or Latin-1. Every other line is a row, or is
refused with its number: none can vanish between two quotes.
"""

import functools
import hashlib
import io
import itertools
import math
import re
import stat
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.numerics.tables import Array

MOST_BYTES = 1_000_000_000  # of a file, which is read into memory
# how numbers begin
_LIKE_A_NUMBER = re.compile(r"[+-]?([.,]?\d|(nan|inf|infinity)\Z)", re.IGNORECASE)
# Cells of measurements that there are not, also as Excel writes them.
_EXCEL_ERROR = r"#(?:n/a|div/0!|value!|ref!|num!|null!|name\?)"
GAP = re.compile(rf"(?:nan|na|n/a|null|none|{_EXCEL_ERROR})?", re.IGNORECASE)
_COMMENT = re.compile(rf"(?!{_EXCEL_ERROR})[#%]|sep=.$", re.IGNORECASE)
# Bytes that no text in Latin-1 has.
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
# A number as it stands with commas between thousands, which may be decimal.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
# A cell of a row of units, such as "um/s" or "[1/mm^2]".
_UNIT = re.compile(
    r"[\[(]?(?:(?:[munkMGhcdµμ]?(?:m|g|s|N|Pa|K|V|A|J|W|Hz)|min|h|°?C|bar|psi|deg|rad|"
    r"microns?|sec|Å|angstrom|%|-|1)(?:\^?[-−]?\d|[²³])?[/*· ]?)*[\])]?"
)
# Lines at the beginning of a file that tell what separates its cells.
_TELLING_LINES = 200
# Lines between two calls of `progress`.
_ANNOUNCED_LINES = 50_000
_BETWEEN = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}


@dataclass(frozen=True)
class Sheet:
    """The rows of a CSV file."""

    field: str  # the key that names the file, and its path: messages begin with it
    columns: list[str]  # their names
    first: int  # number of the line, with names or units, after which rows begin
    content: bytes  # text in the `encoding`
    encoding: str = "utf-8-sig"
    separator: str = ","  # of cells; " " for any number of blanks
    decimal: str = "."
    units: tuple[str, ...] = ()  # of columns, which the `first` line holds
    guessed: bool = False  # the decimal sign was not given

    @property
    def sha256(self) -> str:
        """Digest of the file."""
        return hashlib.sha256(self.content).hexdigest()

    @property
    def headless(self) -> bool:
        """True if the first line begins with a number: it is a row and no names."""
        return bool(_LIKE_A_NUMBER.match(self.columns[0]))

    @property
    def said(self) -> str:
        """How the file was understood, in words."""
        parts = [f"cells separated by {_BETWEEN[self.separator]}"]
        parts += ["decimal commas"] * (self.decimal == ",")
        parts += ["text in Latin-1, not UTF-8"] * (self.encoding == "latin-1")
        parts += [f"line {self.first} holds units"] * bool(self.units)
        return ", ".join(parts)

    def index(self, name: str, hint: str = "") -> int:
        """Number of the column with a name, before a unit in brackets if need be.
        Raises InputError, to which a `hint` is added, unless exactly one has."""
        bare = [re.sub(r"\s*[(\[][^)\]]*[)\]]$", "", column) for column in self.columns]
        columns = self.columns if name in self.columns else bare
        count = columns.count(name)
        if count == 0:
            there = ", ".join(self.columns)[:60] + hint
            needed = f'needs a column "{name}" in its first line'
            raise InputError(f"{self.field}: {needed}; found {there}")
        if count > 1:
            raise InputError(f'{self.field}: has {count} columns "{name}"')
        return columns.index(name)

    def unit(self, index: int) -> str:
        """The unit of a column, in brackets behind its name or in the row of units; ""
        without one."""
        named = re.search(r"[\[(]([^\])]+)[\])]$", self.columns[index])
        below = "".join(self.units[index : index + 1])
        return named[1] if named else below.strip("[]()-")

    @property
    def whole(self) -> "Sheet":
        """The same with the first line as a row, if that is one: of files whose columns
        need no names."""
        return replace(self, first=self.first - 1) if self.headless else self

    def require_names(self) -> None:
        """Raise InputError if the first line is a row, and there are several columns."""
        if self.headless and len(self.columns) > 1:
            said = "needs names of its columns in its first line"
            raise InputError(f"{self.field}: {said}; found {', '.join(self.columns)}")

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Number of the line and a cell for each column, of every row; numbers have
        decimal points. Raises InputError for a line that is none, and at the end where
        decimal commas may be those between thousands."""
        width, commas = len(self.columns), self.decimal == ","
        watched = _Commas() if commas and self.guessed else None
        for number, line in _lines(self.content, self.encoding):
            if number <= self.first:
                continue
            try:
                cells = _cells(line, self.separator)
                if any(cells[width:]):
                    raise InputError("more values than columns (a decimal comma?)")
                if len(cells) < width:
                    said = f"has {len(cells)} of {width} cells"
                    raise InputError(f"{said}; an empty one takes its comma, too")
            except InputError as error:
                where = f"{self.field}, line {number}"
                raise InputError(f"{where}: {error}") from None
            cells = cells[:width]
            if watched:
                watched.look(number, cells)
            yield number, list(map(_pointed, cells)) if commas else cells
        if watched:
            watched.check(self)


class _Commas:
    """The commas of a file's numbers, which are decimal if one of them cannot stand
    between thousands, or if all numbers of a column have some."""

    def __init__(self) -> None:
        self.decimal = False
        self.plain: set[int] = set()  # columns with numbers that have no comma
        # the first line and cell of those with commas that may be between thousands
        self.doubtful: dict[int, tuple[int, str]] = {}

    def look(self, line: int, cells: list[str]) -> None:
        """Take the cells of a row into account."""
        for column, cell in enumerate(() if self.decimal else cells):
            if _THOUSANDS.fullmatch(cell):
                self.doubtful.setdefault(column, (line, cell))
            elif math.isfinite(value_of(_pointed(cell))):
                self.decimal |= "," in cell
                self.plain.add(column)

    def check(self, sheet: Sheet) -> None:
        """Raise InputError if commas may be those between thousands."""
        doubtful = [] if self.decimal else sorted(self.plain & self.doubtful.keys())
        for column in doubtful:
            line, cell = self.doubtful[column]
            where = f"{sheet.field}, line {line}: {sheet.columns[column]} = {cell!r}"
            either = f"{cell.replace(',', '')} or {cell.replace(',', '.')}"
            raise InputError(f"{where}: must be {either}; other cells have no comma")


def read(path: Path, field: str, decimal: str | None = None) -> Sheet:
    """Read a CSV file, which `field` names in messages; its decimal sign is seen unless
    it is given. Raises InputError if it cannot be read, is no text in UTF-8 or Latin-1,
    or has no first line with names."""
    content, encoding = _content(path, field), "utf-8-sig"
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{field}: is text in UTF-16; must be in UTF-8")
    try:
        content.decode()
    except UnicodeDecodeError as error:
        encoding = "latin-1"
        if _CONTROL.search(content):
            number = content.count(b"\n", 0, error.start) + 1
            raise InputError(f"{field}, line {number}: is not text in UTF-8") from None
    head = list(itertools.islice(_lines(content, encoding), _TELLING_LINES))
    if not head:
        raise InputError(f"{field}: is empty; its first line must name the columns")
    first, lines = head[0][0], [line for _, line in head]
    separator, sign = _dialect(lines, decimal or "")
    if separator != "," and not decimal and not re.search(rb"\d\.\d", content):
        sign = "," if re.search(rb"\d,\d", content) else sign
    try:
        columns = _names(lines[0], separator)
    except InputError as error:
        raise InputError(f"{field}, line {first}: {error}") from None
    sheet = Sheet(
        field, columns, first, content, encoding, separator, sign, guessed=not decimal
    )
    if len(columns) > 1 and sheet.headless:  # as numpy.savetxt writes
        with io.TextIOWrapper(io.BytesIO(content), encoding) as text:
            above = [line for line in itertools.islice(text, first - 1) if line.strip()]
        names = _names("".join(above[-1:]).strip().lstrip("#% \t"), separator)
        if len(names) == len(columns) and not _numbers(names, "."):
            return replace(sheet, columns=names, first=first - 1)
    if len(lines) > 2:
        units, row = (line.replace('"', "").split(separator) for line in lines[1:3])
        units = [unit.strip() for unit in units]
        # dashes alone, or N/A, stand for missing numbers
        named = any(unit.strip("-") and not GAP.fullmatch(unit) for unit in units)
        are_units = named and all(map(_UNIT.fullmatch, units))
        if are_units and not _numbers(units, sign) and _numbers(row, sign):
            return replace(sheet, first=head[1][0], units=tuple(units))
    return sheet


def _dialect(lines: list[str], decimal: str) -> tuple[str, str]:
    """Find what separates cells, and the decimal sign unless it is given: the pair
    with which the largest share of cells are numbers, in rows as wide as the first."""
    best, found = 0.0, ("", "")
    for separator, sign in itertools.product(_BETWEEN, decimal or ".,"):
        good = total = 0
        try:
            width = len(_names(lines[0], separator))
            if width < 2:
                continue
            for line in lines[1:] or lines:
                cells = _cells(line, separator)
                fits = len(cells) >= width and not any(cells[width:])
                good += fits * _numbers(cells[:width], sign)
                total += max(width, len(cells))
        except InputError:
            continue
        if good > best * total:
            best, found = good / total, (separator, sign)
    if found[0]:
        return found
    # names alone, or a single column
    there = [separator for separator in ",;\t" if separator in lines[0]]
    return (there or [","])[0], decimal or "."


def _names(line: str, separator: str) -> list[str]:
    """Names of columns; without empty ones at the end, as spreadsheets write them."""
    if separator == " ":  # "Time (s)" is a single name
        line = re.sub(r"(?<=\S) (?=[(\[])", "\0", line.strip())
        wide = bool(re.search(r"\S(?: {2,}|\t+)\S", line))  # "load point  force"
        names = re.split(r" {2,}|\t+", line) if wide else _cells(line, " ")
        return [name.replace("\0", " ").strip() for name in names]
    names = [name.strip() for name in _cells(line, separator)]
    while len(names) > 1 and not names[-1]:
        names.pop()
    return names


def _numbers(cells: list[str], decimal: str) -> int:
    """How many cells hold a finite number."""
    cells = list(map(_pointed, cells)) if decimal == "," else cells
    return sum(math.isfinite(value_of(cell)) for cell in cells)


def _pointed(cell: str) -> str:
    """A cell with a decimal point for its comma; one that has both is no number."""
    if not _LIKE_A_NUMBER.match(cell):
        return cell
    mixed = " (a point among decimal commas)" * ("." in cell)
    return cell.replace(",", ".") + mixed


class Numbers(NamedTuple):
    """Numbers, shape (rows, columns), their lines, the number of rows that were left
    out for a gap, and the first number of the first column, also of such a row."""

    values: Array
    lines: Array
    gaps: int
    first: float


def numbers(
    sheet: Sheet,
    names: Sequence[str],
    *,
    strict: bool = False,
    progress: Callable[[int, float], None] = lambda done, total: None,
) -> Numbers:
    """Finite numbers in some columns of a file. Rows with an empty cell or NaN in one
    of them are left out and counted, if not `strict`. Raises InputError, with the line,
    for any other cell that holds none."""
    where = [sheet.index(name) for name in names]
    values, lines, gaps, first = array("d"), array("q"), 0, math.nan
    total = sheet.content.count(b"\n")
    for line, cells in sheet.rows():
        texts = [cells[index] for index in where]
        row = list(map(value_of, texts))
        first = row[0] if first != first else first
        if not all(map(math.isfinite, row)):
            for name, text in zip(names, texts, strict=True):
                if strict or not GAP.fullmatch(text):
                    number(text, f"{sheet.field}, line {line}: {name}")
            gaps += 1
            continue
        values.extend(row)
        lines.append(line)
        if not line % _ANNOUNCED_LINES:
            progress(line, total)
    rows = np.array(values).reshape(-1, len(where))
    return Numbers(rows, np.array(lines), gaps, first)


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


def _lines(content: bytes, encoding: str) -> Iterator[tuple[int, str]]:
    """Lines but for empty ones and comments, numbered from 1."""
    with io.TextIOWrapper(io.BytesIO(content), encoding) as text:
        for number, line in enumerate(text, 1):
            begin = line.lstrip()
            if begin and not _COMMENT.match(begin):
                yield number, line.removesuffix("\n")


@functools.cache
def _cell_pattern(separator: str) -> re.Pattern[str]:
    """A cell in quotes, or as it stands, and what separates it from the next."""
    blank = r"[^\S\t]*" if separator == "\t" else r"\s*"
    plain = rf'([^"\s{separator}][^{separator}]*|)'
    return re.compile(rf'{blank}(?:"((?:[^"]|"")*)"{blank}|{plain})(?:{separator}|\Z)')


def _cells(line: str, separator: str) -> list[str]:
    """The cells of a line. Raises InputError for a quote that is not closed."""
    if '"' not in line:
        between = None if separator == " " else separator
        return [cell.strip() for cell in line.split(between)]
    if separator == " ":
        outside, separator = r'[ \t]+(?=(?:[^"]*"[^"]*")*[^"]*$)', "\0"
        line = re.sub(outside, separator, line.strip())
    cells: list[str] = []
    place, more = 0, True
    while more:
        match = _cell_pattern(separator).match(line, place)
        if match is None:
            shown = line[place:].strip()[:40]
            said = "a quote must be closed before the next comma or line end"
            raise InputError(f"{shown!r} is no cell; {said}")
        quoted, plain = match.groups()
        cells.append(plain.rstrip() if quoted is None else quoted.replace('""', '"'))
        place, more = match.end(), match[0].endswith(separator)
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
    it begins a comment; a missing value or NaN is an empty cell, and numbers are exact.
    Raises InputError for text with a line break, which no cell can hold."""
    yield ",".join(_name(name) for name in columns)
    for row in rows:
        yield ",".join(map(_cell, row)) or '""'  # an empty line would be none


def _name(name: str) -> str:
    plain = name and name == name.strip() and not re.search('["#,;\t\r\n]', name)
    # "0 A" alone would be read as a number and another cell
    plain = plain and not (" " in name and re.search(r"\d", name))
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
