"""Choice of the next measurement: the one after which a key is expected to be known
best (Fisher information)."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import InputError, meant, require_integer, require_number
from eqsim.fitting.data import MeasuredAt
from eqsim.fitting.estimate import covariance
from eqsim.fitting.fit import Prepared, prepare
from eqsim.fitting.model import Problem, velocity_of
from eqsim.fitting.section import section_of
from eqsim.io import storage
from eqsim.io.content import alternative, of_population
from eqsim.io.parameters import parameters
from eqsim.io.runfile import RunFile, stored
from eqsim.numerics.tables import Array

# Candidates between the limits.
_VELOCITIES = 41
_TEMPERATURES = 7
# Factor by which velocities may be beyond those of the data, by default.
_BEYOND = 10.0


class Limits(NamedTuple):
    """The smallest and the largest velocity or temperature that may be measured at."""

    low: float
    high: float

    def spaced(self, name: str, space: Callable[..., Array], count: int) -> Array:
        """Values between the limits, one if these are equal. Raises InputError unless
        0 < low <= high."""
        for value in self:
            require_number(f"--{name}", value, above=0)
        if self.low > self.high:
            given = f"--{name} {self.low:g},{self.high:g}"
            raise InputError(f"{given}: the first must not be larger")
        return space(*self, count if self.low < self.high else 1)


class NextMeasurement(NamedTuple):
    """A measurement of friction: where, and the standard deviation of the key's
    variable that is expected after it and all before it."""

    velocity: float
    temperature: float | None
    sd: float


class Design(NamedTuple):
    """The expected standard deviation of a key now, after repeating all measurements,
    and after each of some new ones, the best first; the name of its variable, such as
    "ln thermal.kT"; values of the run file at which new ones are made, of keys that are
    columns of the data; and the set of the data that they belong to, if it has any."""

    key: str
    variable: str
    now: float
    repeated: float
    steps: list[NextMeasurement]
    at: dict[str, float]
    set: str


def expected(jacobian: Array, index: int) -> float:
    """Standard deviation of a parameter by the inverse of J'J."""
    return math.sqrt(covariance(jacobian)[index, index])


def design(
    file: RunFile,
    fitted: Path,
    key: str,
    count: int = 4,
    velocities: Limits | None = None,
    temperatures: Limits | None = None,
) -> Design:
    """Choose the next `count` measurements of friction for a free key of the fit in the
    folder `fitted`, one after the other, each the best given those before.

    By default velocities go up to ten times beyond those of the data, and temperatures
    are those of the data; other keys that are columns have the run file's values. They
    are of the set whose scale the key is, else of the first one in the data.
    Raises InputError if the folder holds no fit of these data, or the key is not free.
    """
    require_integer("next", count, 1, 1000)
    prepared = prepare(file, None, True)
    problem = prepared.problem
    if prepared.table.time is not None:
        said = "must be a table of averages; a record has no next measurement"
        raise InputError(f"fit.data: {said}")
    if key not in problem.keys:
        hint = meant(key, problem.keys, "known are ")
        raise InputError(f"--for {key}: is not a free key of this fit; {hint}")
    index, u = problem.keys.index(key), _best(fitted, prepared)
    jacobian = problem.jacobian(u)
    v, T = _candidates(prepared, velocities, temperatures)
    sets, asked = prepared.table.sets, key.removeprefix("fit.scale.")
    chosen = asked if asked in sets else sets[0]
    rows = _measurable(prepared, u, v, T, chosen).jacobian(u)[: v.size]
    again = np.vstack((jacobian, jacobian[: problem.value.size]))
    now, repeated, steps = expected(jacobian, index), expected(again, index), []
    for _ in range(count):
        after = [expected(np.vstack((jacobian, row)), index) for row in rows]
        best = int(np.argmin(after))
        jacobian = np.vstack((jacobian, rows[best]))
        kelvin = float(T[best]) if prepared.fit.temperature is not None else None
        steps.append(NextMeasurement(float(v[best]), kelvin, after[best]))
    name = problem.parameters[index].variable_name
    columns = [one for one in prepared.table.names if one != "drive.velocity"]
    at = {one: file[one] for one in columns if file[one] is not None}
    return Design(key, name, now, repeated, steps, at, chosen)


def _best(fitted: Path, prepared: Prepared) -> Array:
    """The parameters of a fit in a folder. Raises InputError unless it is one of these
    data, keys and model."""
    from pyarrow import parquet as pq

    try:
        summary = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
        digest, known = summary["data_sha256"], summary["parameters"].items()
        values = {key: float(one["estimate"]) for key, one in known}
        origin = storage.origin_of(pq.read_schema(fitted / "fitted.parquet"))
        settings, folder = origin["settings"], Path(origin["folder"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        said = "holds no fit.json and fitted.parquet of `eqsim fit`"
        raise InputError(f"--fit {fitted}: {said}") from None
    if digest != prepared.table.sha256:
        raise InputError(f"--fit {fitted}: is a fit of other data than fit.data")
    problem = prepared.problem
    if values.keys() != set(problem.keys):
        keys = ", ".join(values)
        raise InputError(f"--fit {fitted}: has other free keys than the file: {keys}")
    made = stored(settings, folder if folder.is_dir() else prepared.file.folder)
    _require_model(fitted, _model(made), prepared)
    u = [one.variable(values[one.key]) for one in problem.parameters]
    return np.clip(u, problem.low, problem.high)


def _require_model(fitted: Path, then: dict[str, Any], prepared: Prepared) -> None:
    """Raise InputError unless a fit was made with these settings, but for keys that are
    free or columns of the data."""
    now, varied = _model(prepared.file), {*prepared.problem.keys, *prepared.table.names}
    varied |= {other for other in map(alternative, varied) if other}
    for key in now | then:
        inherited = of_population(key)[1]
        if then.get(key) == now.get(key) or not varied.isdisjoint((key, inherited)):
            continue
        texts = (json.dumps(one[key]) if key in one else "none" for one in (then, now))
        said = f"was made with {key} = {', not '.join(texts)}"
        raise InputError(f"--fit {fitted}: {said}")


def _model(file: RunFile) -> dict[str, Any]:
    """Settings by key on which steady averages in the unit of the data depend."""
    found, section = parameters(file), section_of(file)
    for key, value in found.items():
        if key.endswith("thresholds.file") and value:
            found[key] = str((file.folder / value).resolve())
    found["fit.reference_temperature"] = section.reference_temperature
    found["fit.scale"] = section.scale if isinstance(section.scale, float) else None
    known = {key: value for key, value in found.items() if value is not None}
    return {k: x for k, x in known.items() if not k.startswith(("drive.", "output."))}


def _candidates(
    prepared: Prepared, velocities: Limits | None, temperatures: Limits | None
) -> tuple[Array, Array]:
    """Velocities and temperatures of candidates, arrays (candidates,); data without a
    column of temperatures have one."""
    table = prepared.table
    known = [v for v in map(velocity_of, table.conditions) if v is not None]
    if velocities is None:
        if not known:
            raise InputError("--velocity: is required without a column drive.velocity")
        velocities = Limits(min(known) / _BEYOND, max(known) * _BEYOND)
    if temperatures is not None and prepared.fit.temperature is None:
        raise InputError("--temperature: not allowed without fit.temperature")
    measured = [one.kelvin for one in table.conditions]
    temperatures = temperatures or Limits(min(measured), max(measured))
    v = velocities.spaced("velocity", np.geomspace, _VELOCITIES)
    T = temperatures.spaced("temperature", np.linspace, _TEMPERATURES)
    return np.tile(v, T.size), np.repeat(T, v.size)


def _measurable(
    prepared: Prepared, u: Array, v: Array, T: Array, chosen: str
) -> Problem:
    """A problem whose measurements are the candidates in a chosen set, with the relative
    error of the data. Raises InputError unless these have a friction there."""
    problem, table, fit = prepared.problem, prepared.table, prepared.fit
    force = np.array(table.observable) == "friction"
    there = force & np.array([row.set == chosen for row in table.conditions])
    if not there.any():
        of = f" of set {chosen}" * bool(chosen)
        raise InputError(f"fit.data: design needs measurements of friction{of}")
    relative = float(np.median(table.sigma[force] / np.abs(table.value[force])))
    heat = T / (fit.reference_temperature or 1.0)
    rows = [
        MeasuredAt((("drive.velocity", speed),), warmth, chosen)
        for speed, warmth in zip(v.tolist(), heat.tolist(), strict=True)
    ]
    blank = problem.elsewhere(int(np.argmax(there)), rows)
    return replace(blank, sigma=relative * blank.given(u))
