"""Measurements: tables of steady observables, one row per measurement."""

import csv
import hashlib
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError, meant
from eqsim.fitting.section import Fit
from eqsim.io.runfile import RunFile, keys, require_commas
from eqsim.numerics.tables import Array

# observables, and by which power of the scale of forces what is measured exceeds them; of `force_std` it is another one
MEASURED = {"friction": 1, "pinned": 0, "break_stretch": 0, "force_std": 1, "peak_ratio": 0, "peak_X": 0}
_MOST = 100_000_000  # bytes of a file of data


class Row(NamedTuple):
    """Where a measurement was made: values of run-file keys, kT over that of the run file, and its set."""

    changes: tuple[tuple[str, float], ...]
    heat: float
    set: str


class Table(NamedTuple):
    """Measurements, arrays (measurements,): the row each belongs to, its observable, value and standard error.

    `names` are the columns that are keys, `sha256` the digest of the file.
    """

    rows: list[Row]
    row: Array
    observable: list[str]
    value: Array
    sigma: Array
    names: list[str]
    temperatures: Array
    sha256: str
    time: Array | None = None  # of the points of a record

    @property
    def sets(self) -> list[str]:
        """Names of the sets, as they come."""
        return list(dict.fromkeys(row.set for row in self.rows))


def contents(path: Path, field: str) -> tuple[list[str], list[tuple[int, list[str]]], str]:
    """Header, numbered rows and SHA-256 of a CSV file. Raises InputError with the line that cannot be used."""
    try:
        known, there = path.is_file(), path.exists()
        content = path.read_bytes() if known else b""
    except (OSError, ValueError) as error:
        raise InputError(f"{field} = {str(path)!r}: cannot be read ({getattr(error, 'strerror', error)})") from None
    if not known:
        raise InputError(f"{field} = {str(path)!r}: " + ("is not a file" if there else "there is no such file"))
    if len(content) > _MOST:
        raise InputError(f"{field} = {path}: is longer than {_MOST:.0e} bytes")
    if content.startswith((b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{field} = {path}: begins with a byte-order mark; must be UTF-8 without one")
    try:
        text = content.decode()
        every = list(csv.reader(text.splitlines(), skipinitialspace=True, strict=True))
    except (ValueError, csv.Error):
        raise InputError(f"{field} = {path}: is not a CSV text file in UTF-8") from None
    numbered = [(i + 1, [cell.strip() for cell in row]) for i, row in enumerate(every)]
    numbered = [(line, row) for line, row in numbered if any(row) and not row[0].startswith("#")]
    if not numbered:
        raise InputError(f"{field} = {path}: is empty; its first line must name the columns")
    header = numbered[0][1]
    for name in header:
        if header.count(name) > 1:
            raise InputError(f'{field} = {path}: has {header.count(name)} columns "{name}"')
    require_commas(f"{field} = {path}", header)
    for line, row in numbered[1:]:
        if len(row) > len(header):
            raise InputError(f"{field} = {path}, line {line}: more cells than columns (a decimal comma?)")
    rows = [(line, row + [""] * (len(header) - len(row))) for line, row in numbered[1:]]
    return header, rows, hashlib.sha256(content).hexdigest()


def number(text: str, where: str) -> float:
    """Of a cell. Raises InputError, which says `where`."""
    try:
        value = float(text if "_" not in text else "")
    except ValueError:
        hint = "; decimal commas must be points" if "," in text else ""
        raise InputError(f"{where} = {text[:40]!r}: must be a number{hint}") from None
    if not math.isfinite(value):
        raise InputError(f"{where} = {text[:40]}: must be finite")
    return value


def read_table(path: Path, file: RunFile, fit: Fit) -> Table:
    """The measurements of a CSV file.

    Parameters
    ----------
    path : Path
        Columns are float keys of the run file, the temperature column, observables, each with an optional _stderr, and
        `set`. An empty cell is the run file's value, or was not measured.
    file : RunFile
    fit : Fit

    Returns
    -------
    Table

    Raises
    ------
    InputError
        With the column or line that cannot be used.
    """
    header, lines, digest = contents(path, "fit.data")
    known = [key for key, kind in keys(file).items() if kind is float]
    errors = {f"{name}_stderr": name for name in MEASURED}
    for name in header:
        if name in fit.free:
            raise InputError(f"fit.free.{name}: is a column of the data; a key is either free or given by each row")
        if name not in (*known, *MEASURED, *errors, "set", fit.temperature):
            every = [*known, *MEASURED, *errors, "set"]
            hint = meant(name, every) or (
                "columns are keys such as drive.velocity and " + ", ".join(MEASURED)
                + " (friction may be a force, a stress or a coefficient: fit.scale is its unit)"
            )  # fmt: skip
            raise InputError(f'fit.data: column "{name}" is neither a key nor an observable; {hint}')
    for error, name in errors.items():
        if error in header and name not in header:
            raise InputError(f'fit.data: column "{error}" is there without a column "{name}"')
    if fit.temperature is not None and fit.temperature not in header:
        raise InputError(f'fit.temperature = "{fit.temperature}": the data have no such column')
    if not any(name in header for name in MEASURED):
        raise InputError("fit.data: no column is an observable; known are " + ", ".join(MEASURED))
    names = [name for name in header if name in known]
    rows: list[Row] = []
    temperatures: list[float] = []
    measured: list[tuple[int, str, float, float]] = []
    for line, cells in lines:
        given = dict(zip(header, cells, strict=True))
        where = f"fit.data, line {line}: "
        changes = tuple((name, number(given[name], where + name)) for name in names if given[name])
        heat = 1.0
        if fit.temperature is not None:
            T = number(given[fit.temperature], where + fit.temperature)
            if not T > 0:
                raise InputError(f"{where}{fit.temperature} = {T:g}: must be > 0")
            heat = T / (fit.reference_temperature or 1.0)
        if not any(given.get(name) for name in MEASURED):
            raise InputError(f"{where}no observable has a value; leave the line out, or measure one")
        for name in MEASURED:
            if name in header and given[name]:
                value = number(given[name], where + name)
                measured.append((len(rows), name, value, _sigma(given, name, value, where, fit)))
            elif given.get(f"{name}_stderr"):
                raise InputError(f"{where}{name}_stderr is there without a value of {name}")
        rows.append(Row(changes, heat, given.get("set", "")))
        temperatures.append(heat * (fit.reference_temperature or 1.0))
    if not measured:
        raise InputError("fit.data: there is no measurement in it")
    for name in MEASURED:
        if name in header and all(one[1] != name for one in measured):
            raise InputError(f'fit.data: column "{name}" has no value in any line; leave it out')
    at, values, sigmas = (np.array([one[i] for one in measured]) for i in (0, 2, 3))
    return Table(rows, at, [one[1] for one in measured], values, sigmas, names, np.array(temperatures), digest)


def _sigma(given: dict[str, str], name: str, value: float, where: str, fit: Fit) -> float:
    """The standard error of a measurement."""
    text = given.get(f"{name}_stderr", "")
    if text:
        try:
            sigma = float(text)
        except ValueError:
            sigma = math.nan
        if not 0 < sigma < math.inf:
            raise InputError(f"{where}{name}_stderr = {text[:40]}: must be a finite number > 0")
        return sigma
    noise = fit.noise
    if noise.relative == 0 and noise.absolute == 0:
        raise InputError(f"{where}{name} has no {name}_stderr; give one, or noise = {{ relative = ... }} in [fit]")
    if value <= 0 and noise.absolute == 0:
        raise InputError(f"{where}{name} = {value:g}: must be > 0, as its error is relative; give an absolute one too")
    return math.hypot(noise.relative * value, noise.absolute)
