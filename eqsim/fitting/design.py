"""Which measurement to make next: the one after which a key is expected to be known
best (Fisher information)."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import InputError, meant, require_integer, require_number
from eqsim.fitting.data import Row
from eqsim.fitting.fit import Prepared, prepare
from eqsim.fitting.model import Problem, SteadyForward
from eqsim.fitting.section import variable
from eqsim.io.runfile import RunFile
from eqsim.numerics.tables import Array

_VELOCITIES, _TEMPERATURES = 41, 7  # candidates
_BEYOND = 10.0  # how far velocities may be beyond those of the data, by default


class Limits(NamedTuple):
    """The smallest and the largest value that may be measured at."""

    low: float
    high: float


class Step(NamedTuple):
    """A measurement of friction: where, and the standard deviation of the key's
    variable that is expected after it and all before it."""

    velocity: float
    temperature: float | None
    sd: float


class Design(NamedTuple):
    """What measurements would do for a key: its expected standard deviation now, after
    repeating all measurements, and after each of some new ones, the best first; and
    what the variable is, such as "ln thermal.kT"."""

    key: str
    variable: str
    now: float
    repeated: float
    steps: list[Step]


def expected(jacobian: Array, index: int) -> float:
    """Standard deviation of a parameter by the inverse of J'J; infinite if it moves
    along a null direction."""
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=True)
    singular = np.concatenate((singular, np.zeros(rows.shape[0] - singular.size)))
    part = rows[:, index] ** 2
    lost = singular <= 1e-12 * singular[0]
    if np.any(part[lost] > 1e-12):
        return math.inf
    return float(np.sqrt(np.sum(part[~lost] / singular[~lost] ** 2)))


def design(
    file: RunFile,
    fitted: Path,
    key: str,
    count: int = 4,
    velocities: Limits | None = None,
    temperatures: Limits | None = None,
) -> Design:
    """The next measurements of friction for a key, one after the other, each the best
    given those before.

    Parameters
    ----------
    file : RunFile
        With the [fit] section that was fitted.
    fitted : Path
        Folder of that fit.
    key : str
        A free key.
    count : int
        How many measurements.
    velocities, temperatures : Limits, optional
        By default velocities up to ten times beyond those of the data, and the
        temperatures of the data.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        If the folder holds no fit of these data, or the key is not free.
    """
    require_integer("next", count, 1, 1000)
    prepared = prepare(file, None, True)
    problem = prepared.problem
    keys = [one.key for one in problem.parameters]
    if key not in keys:
        raise InputError(
            f"--for {key}: is not a free key of this fit; {meant(key, keys) or 'known are ' + ', '.join(keys)}"
        )
    index, u = keys.index(key), _best(fitted, prepared)
    jacobian = problem.jacobian(u)
    v, T = _candidates(prepared, velocities, temperatures)
    rows = _rows(prepared, u, v, T).jacobian(u)[: v.size]
    now, repeated = (
        expected(jacobian, index),
        expected(np.vstack((jacobian, jacobian[: problem.value.size])), index),
    )
    steps = []
    for _ in range(count):
        after = [expected(np.vstack((jacobian, row)), index) for row in rows]
        best = int(np.argmin(after))
        jacobian = np.vstack((jacobian, rows[best]))
        kelvin = float(T[best]) if prepared.fit.temperature is not None else None
        steps.append(Step(float(v[best]), kelvin, after[best]))
    transform = problem.parameters[index].transform
    name = {"log": f"ln {key}", "log1p": f"ln(1 + {key})"}.get(transform, key)
    return Design(key, name, now, repeated, steps)


def _best(fitted: Path, prepared: Prepared) -> Array:
    """The parameters of a fit in a folder. Raises InputError unless it is one of these
    data and keys."""
    path = fitted / "fit.json"
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        values, digest = (
            {key: part["estimate"] for key, part in found["parameters"].items()},
            found["data_sha256"],
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"--fit {fitted}: holds no fit.json of `eqsim fit`") from None
    if digest != prepared.table.sha256:
        raise InputError(
            f"--fit {fitted}: is a fit of other data than fit.data of the run file"
        )
    parameters = prepared.problem.parameters
    if values.keys() != {one.key for one in parameters}:
        raise InputError(
            f"--fit {fitted}: has other free keys than the run file: {', '.join(values)}"
        )
    u = np.array(
        [variable(one.transform, float(values[one.key])) for one in parameters]
    )
    return np.clip(u, prepared.problem.low, prepared.problem.high)


def _candidates(
    prepared: Prepared, velocities: Limits | None, temperatures: Limits | None
) -> tuple[Array, Array]:
    """Velocities and temperatures, arrays (candidates,); the run file's temperature
    without a column of them."""
    table = prepared.table
    measured = [dict(row.changes).get("drive.velocity") for row in table.rows]
    known = np.array([v for v in measured if v is not None])
    if velocities is None:
        if not known.size:
            raise InputError(
                "--velocity: is required, as the data have no column drive.velocity"
            )
        velocities = Limits(float(known.min()) / _BEYOND, float(known.max()) * _BEYOND)
    if temperatures is not None and prepared.fit.temperature is None:
        raise InputError(
            "--temperature: not allowed without fit.temperature, the column of temperatures"
        )
    limits = temperatures or Limits(
        float(table.temperatures.min()), float(table.temperatures.max())
    )
    for name, (low, high) in (("--velocity", velocities), ("--temperature", limits)):
        require_number(name, low, above=0)
        require_number(name, high, above=0)
        if low > high:
            raise InputError(
                f"{name} {low:g},{high:g}: the first must not be larger than the second"
            )
    v = np.geomspace(*velocities, _VELOCITIES if velocities[0] < velocities[1] else 1)
    T = np.linspace(*limits, _TEMPERATURES if limits[0] < limits[1] else 1)
    return np.tile(v, T.size), np.repeat(T, v.size)


def _rows(prepared: Prepared, u: Array, v: Array, T: Array) -> Problem:
    """A problem whose measurements are the candidates, with the relative error of the
    data."""
    problem, table, fit = prepared.problem, prepared.table, prepared.fit
    forward = problem.forward
    assert isinstance(forward, SteadyForward)
    force = np.array(table.observable) == "friction"
    if not force.any():
        raise InputError(
            "fit.data: design needs measurements of friction, whose errors it takes for the next ones"
        )
    relative = float(np.median(table.sigma[force] / np.abs(table.value[force])))
    reference = fit.reference_temperature or 1.0
    rows = [
        Row(
            (("drive.velocity", float(a)),),
            float(b) / reference if fit.temperature is not None else 1.0,
            table.sets[0],
        )
        for a, b in zip(v, T, strict=True)
    ]
    there = SteadyForward(forward.file, rows, np.arange(v.size), ["friction"] * v.size)
    first = int(np.flatnonzero(force)[0])
    free = problem.scale_of[first]
    blank = Problem(
        there, problem.parameters, np.ones(v.size), np.ones(v.size), np.full(v.size, min(free, 0)),
        problem.fixed_scale, np.zeros(v.size, bool), problem.count, problem.stiffness, loss=problem.loss,
    )  # fmt: skip
    return replace(blank, sigma=relative * blank.given(u))
