"""Measurements: tables of steady observables, one row per measurement."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eqsim.errors import InputError, meant
from eqsim.fitting.section import Fit
from eqsim.io import csv
from eqsim.io.parameters import keys
from eqsim.io.runfile import RunFile
from eqsim.numerics.tables import Array

# Observables that data may hold.
MEASURED = (
    "friction",
    "pinned",
    "break_stretch",
    "force_std",
    "peak_ratio",
    "peak_X",
)
# Those that have a scale of force.
FORCES = ("friction", "force_std")
_KNOWN_COLUMNS = (
    f"columns are keys such as drive.velocity and {', '.join(MEASURED)} (friction may "
    "be a force, a stress or a coefficient: fit.scale is its unit)"
)


class MeasuredAt(NamedTuple):
    """Conditions of a measurement: values of run-file keys, kT over the run file's, its
    set (measurements with one scale of force), its line in the file, and its
    temperature (kelvin), if there is a column of these."""

    changes: tuple[tuple[str, float], ...] = ()
    heat: float = 1.0
    set: str = ""
    line: int = 0
    kelvin: float = 1.0


class Measurements(NamedTuple):
    """Measurements: where each was made, its observable, value and standard error.

    `names` are the columns that are keys, `sha256` is the digest of the file, and a
    record has the `time` of its points. `said` is what was done to the rows of the
    file, and `read` those of a record before block means, their time and force.
    """

    conditions: list[MeasuredAt]
    observable: list[str]
    value: Array
    sigma: Array
    names: list[str]
    sha256: str
    time: Array | None = None
    said: tuple[str, ...] = ()
    read: tuple[Array, Array] | None = None

    @property
    def sets(self) -> list[str]:
        """Names of the sets in which a force was measured, as they come."""
        pairs = zip(self.conditions, self.observable, strict=True)
        return list(dict.fromkeys(one.set for one, name in pairs if name in FORCES))


def read_table(
    path: Path, file: RunFile, fit: Fit, field: str = "fit.data"
) -> Measurements:
    """Read the measurements of a CSV file.

    Columns are float keys of the run file, the temperature column, observables, each
    with an optional _stderr, and `set`. An empty cell is the run file's value, or was
    not measured. Raises InputError with the column or line that cannot be used.
    """
    sheet = csv.read(path, f"{field} = {path}")
    names, observables = _checked_columns(sheet, file, fit)
    of_heat = [] if fit.temperature is None else [fit.temperature]
    measured, count = list[tuple[MeasuredAt, str, float, float]](), 0
    for number, texts in sheet.rows():
        if not any(texts):  # spreadsheets append such lines
            continue
        where = f"fit.data, line {number}: "
        cells = dict(zip(sheet.columns, texts, strict=True))
        given = {
            name: csv.number(cells[name], where + name)
            for name in (*names, *of_heat, *observables)
            if cells[name] or name in of_heat
        }
        changes = tuple((name, given[name]) for name in names if name in given)
        kelvin = unit = fit.reference_temperature or 1.0
        for name in of_heat:
            if not (kelvin := given[name]) > 0:
                raise InputError(f"{where}{name} = {kelvin:g}: must be > 0")
        if not any(cells[name] for name in observables):
            raise InputError(
                f"{where}no observable has a value; leave the line out, or measure one"
            )
        name_of_set = cells.get("set", "").strip()
        if measured and bool(name_of_set) != bool(measured[0][0].set):
            raise InputError(f"{where}set: must have a name in all rows, or in none")
        here = MeasuredAt(changes, kelvin / unit, name_of_set, number, kelvin)
        for name in observables:
            stderr = cells.get(f"{name}_stderr")
            if name in given:
                sigma = _sigma(where + name, given[name], stderr, fit)
                measured.append((here, name, given[name], sigma))
            elif stderr:
                raise InputError(f"{where}{name}_stderr has no {name} beside it")
        count += 1
    if not measured:
        raise InputError("fit.data: there is no measurement in it")
    conditions, observable, values, sigmas = zip(*measured, strict=True)
    for name in observables:
        if name not in observable:
            raise InputError(f'fit.data: column "{name}" is empty; leave it out')
    return Measurements(
        conditions=list(conditions),
        observable=list(observable),
        value=np.array(values),
        sigma=np.array(sigmas),
        names=names,
        sha256=sheet.sha256,
        said=(f"{count} rows", sheet.said),
    )


def _checked_columns(
    sheet: csv.Sheet, file: RunFile, fit: Fit
) -> tuple[list[str], list[str]]:
    """Names of the columns that are keys, and of those that are observables. Raises
    InputError."""
    header = sheet.columns
    known = [key for key, kind in keys(file).items() if kind is float]
    errors = [f"{name}_stderr" for name in MEASURED]
    for name in header:
        sheet.index(name)  # refuses a name that is there twice
        if name in fit.free:
            raise InputError(f"fit.free.{name}: is a column of the data, so not free")
        allowed = [*known, *MEASURED, *errors, "set"]
        if name not in (*allowed, fit.temperature):
            raise InputError(
                f'fit.data: column "{name}" is neither a key nor an observable; '
                f"{meant(name, allowed) or _KNOWN_COLUMNS}"
            )
        if name in errors and name.removesuffix("_stderr") not in header:
            raise InputError(f'fit.data: column "{name}" has no observable beside it')
    if fit.temperature not in (None, *header):
        given = f'fit.temperature = "{fit.temperature}"'
        raise InputError(f"{given}: no such column; there are {', '.join(header)}")
    twice = [name for name in header if name.endswith("thermal.temperature")]
    if fit.temperature is not None and twice:
        raise InputError(f"fit.temperature: not allowed with a column {twice[0]}")
    observables = [name for name in MEASURED if name in header]
    if not observables:
        raise InputError(f"fit.data: needs an observable: {', '.join(MEASURED)}")
    return [name for name in header if name in known], observables


def _sigma(field: str, value: float, stderr: str | None, fit: Fit) -> float:
    """The standard error of a measurement, by its cell if that holds one. Raises
    InputError."""
    if stderr:
        sigma = csv.value_of(stderr)
        if not 0 < sigma < math.inf:
            given = f"{field}_stderr = {stderr[:40]}"
            raise InputError(f"{given}: must be finite and > 0")
        return sigma
    noise, name = fit.noise, field.rpartition(" ")[2]
    if noise.relative == 0 and noise.absolute == 0:
        raise InputError(f"{field} has no {name}_stderr; give one, or fit.noise")
    if value <= 0 and noise.absolute == 0:
        said = "must be > 0 without fit.noise.absolute"
        raise InputError(f"{field} = {value:g}: {said}")
    return math.hypot(noise.relative * value, noise.absolute)
