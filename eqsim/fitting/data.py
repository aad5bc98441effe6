"""Measurements: tables of steady observables, one row per measurement."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError, meant
from eqsim.fitting.section import Fit
from eqsim.io import csv
from eqsim.io.runfile import RunFile, keys
from eqsim.numerics.tables import Array

# observables, and by which power of the scale of forces what is measured exceeds them;
# of `force_std` it is another one
MEASURED = {
    "friction": 1,
    "pinned": 0,
    "break_stretch": 0,
    "force_std": 1,
    "peak_ratio": 0,
    "peak_X": 0,
}


class Row(NamedTuple):
    """Where a measurement was made: values of run-file keys, kT over that of the run
    file, its set, and in which line of the file it stands."""

    changes: tuple[tuple[str, float], ...]
    heat: float
    set: str
    line: int = 0


class Table(NamedTuple):
    """Measurements, arrays (measurements,): the row each belongs to, its observable,
    value and standard error.

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


def read_table(path: Path, file: RunFile, fit: Fit) -> Table:
    """The measurements of a CSV file.

    Parameters
    ----------
    path : Path
        Columns are float keys of the run file, the temperature column, observables,
        each with an optional _stderr, and `set`. An empty cell is the run file's value,
        or was not measured.
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
    sheet = csv.read(path, f"fit.data = {path}")
    header = sheet.columns
    known = [key for key, kind in keys(file).items() if kind is float]
    errors = {f"{name}_stderr": name for name in MEASURED}
    for name in header:
        sheet.index(name)  # of a name that is there twice
        if name in fit.free:
            raise InputError(
                f"fit.free.{name}: is a column of the data; a key is either free or given by each row"
            )
        if name not in (*known, *MEASURED, *errors, "set", fit.temperature):
            every = [*known, *MEASURED, *errors, "set"]
            hint = meant(name, every) or (
                "columns are keys such as drive.velocity and " + ", ".join(MEASURED)
                + " (friction may be a force, a stress or a coefficient: fit.scale is its unit)"
            )  # fmt: skip
            raise InputError(
                f'fit.data: column "{name}" is neither a key nor an observable; {hint}'
            )
    for error, name in errors.items():
        if error in header and name not in header:
            raise InputError(
                f'fit.data: column "{error}" is there without a column "{name}"'
            )
    if fit.temperature is not None and fit.temperature not in header:
        raise InputError(
            f'fit.temperature = "{fit.temperature}": the data have no such column'
        )
    if not any(name in header for name in MEASURED):
        raise InputError(
            "fit.data: no column is an observable; known are " + ", ".join(MEASURED)
        )
    names = [name for name in header if name in known]
    rows: list[Row] = []
    temperatures: list[float] = []
    measured: list[tuple[int, str, float, float]] = []
    for line, cells in sheet.rows():
        if not any(cells):  # a spreadsheet's last lines
            continue
        given = dict(zip(header, cells, strict=True))
        where = f"fit.data, line {line}: "
        changes = tuple(
            (name, csv.number(given[name], where + name))
            for name in names
            if given[name]
        )
        heat = 1.0
        if fit.temperature is not None:
            T = csv.number(given[fit.temperature], where + fit.temperature)
            if not T > 0:
                raise InputError(f"{where}{fit.temperature} = {T:g}: must be > 0")
            heat = T / (fit.reference_temperature or 1.0)
        if not any(given.get(name) for name in MEASURED):
            raise InputError(
                f"{where}no observable has a value; leave the line out, or measure one"
            )
        for name in MEASURED:
            if name in header and given[name]:
                value = csv.number(given[name], where + name)
                measured.append(
                    (len(rows), name, value, _sigma(given, name, value, where, fit))
                )
            elif given.get(f"{name}_stderr"):
                raise InputError(
                    f"{where}{name}_stderr is there without a value of {name}"
                )
        rows.append(Row(changes, heat, given.get("set", "").strip(), line))
        temperatures.append(heat * (fit.reference_temperature or 1.0))
    if not measured:
        raise InputError("fit.data: there is no measurement in it")
    for name in MEASURED:
        if name in header and all(one[1] != name for one in measured):
            raise InputError(
                f'fit.data: column "{name}" has no value in any line; leave it out'
            )
    at, values, sigmas = (np.array([one[i] for one in measured]) for i in (0, 2, 3))
    return Table(
        rows,
        at,
        [one[1] for one in measured],
        values,
        sigmas,
        names,
        np.array(temperatures),
        sheet.sha256,
    )


def _sigma(
    given: dict[str, str], name: str, value: float, where: str, fit: Fit
) -> float:
    """The standard error of a measurement."""
    text = given.get(f"{name}_stderr", "")
    if text:
        sigma = csv.value_of(text)
        if not 0 < sigma < math.inf:
            raise InputError(
                f"{where}{name}_stderr = {text[:40]}: must be a finite number > 0"
            )
        return sigma
    noise = fit.noise
    if noise.relative == 0 and noise.absolute == 0:
        raise InputError(
            f"{where}{name} has no {name}_stderr; give one, or noise = {{ relative = ... }} in [fit]"
        )
    if value <= 0 and noise.absolute == 0:
        raise InputError(
            f"{where}{name} = {value:g}: must be > 0, as its error is relative; give an absolute one too"
        )
    return math.hypot(noise.relative * value, noise.absolute)
