"""The [fit] section of a run file: which keys are free, where the measurements are, and
how noisy."""

import math
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    meant,
    require_choice,
    require_number,
    shown,
    under,
)
from eqsim.io.runfile import RunFile, keys, parameters
from eqsim.laws.named import threshold_parameters

TRANSFORMS = ("log", "log1p", "linear")
NUISANCES = {
    "fit.offset": "offset",
    "fit.drift": "drift",
}  # free keys of a record that no contact knows


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Prior(_Section):
    normal: list[float]


class Free(_Section):
    bounds: list[float]
    transform: str = "log"
    prior: Prior | None = None


class Scale(_Section):
    start: float = 1.0
    bounds: list[float]


class Noise(_Section):
    relative: float = 0.0
    absolute: float = 0.0


class Record(_Section):
    file: str
    time: str = "t"
    force: str = "force"
    stderr: str | None = None
    machine_stiffness: float | None = None


class Fit(_Section):
    """Content of [fit], but for `free`."""

    data: str | None = None
    record: Record | None = None
    scale: Scale | float = 1.0
    temperature: str | None = None
    reference_temperature: float | None = None
    noise: Noise = Noise()
    loss: Literal["gaussian", "student"] = "gaussian"
    offset: float = 0.0
    drift: float = 0.0
    area: float | None = None
    normal_stress: float | None = None
    free: dict[str, Free] = Field(default_factory=dict)


class NormalPrior(NamedTuple):
    """Mean and standard deviation of a normal prior of a parameter's variable."""

    mean: float
    sd: float


class Parameter(NamedTuple):
    """What is fitted.

    Attributes
    ----------
    key : str
        A key of the run file, "fit.scale" (of a set: "fit.scale.SET"), "fit.offset" or
        "fit.drift".
    transform : str
        The variable in which it is fitted is ln x ("log"), ln(1 + x) ("log1p") or x
        ("linear").
    low, high : float
        Bounds of it, and `start`, in that variable.
    prior : NormalPrior, optional
        Of that variable.
    linear : bool
        Whether what is measured is linear in it.
    """

    key: str
    transform: str
    low: float
    high: float
    start: float
    prior: NormalPrior | None = None
    linear: bool = False

    def value(self, u: Any) -> Any:
        """The key's value, from the variable, any shape."""
        return (
            np.exp(u)
            if self.transform == "log"
            else np.expm1(u)
            if self.transform == "log1p"
            else u
        )


def variable(transform: str, value: float) -> float:
    """The variable in which a value is fitted."""
    return (
        math.log(value)
        if transform == "log"
        else math.log1p(value)
        if transform == "log1p"
        else value
    )


def section_of(file: RunFile) -> Fit:
    """The [fit] section. Raises InputError with one line that names the field."""
    if not file.fit:
        raise InputError(
            "fit: the run file has no section [fit]; it says which keys are free and where the data are"
        )
    if file.sweep:
        raise InputError("sweep: not allowed with [fit]; a fit chooses its own points")
    given = file.fit
    if isinstance(given.get("free"), dict):
        given = {**given, "free": dict(_flat(given["free"]))}
    try:
        found = Fit.model_validate(given)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None
    if not found.free:
        raise InputError("fit.free: is empty; at least one key must be free")
    with under("fit"):
        require_number("noise.relative", found.noise.relative, **NOT_NEGATIVE)
        require_number("noise.absolute", found.noise.absolute, **NOT_NEGATIVE)
        require_number("offset", found.offset)
        require_number("drift", found.drift)
        if found.record is not None and found.record.machine_stiffness is not None:
            require_number(
                "record.machine_stiffness", found.record.machine_stiffness, **POSITIVE
            )
        for name in ("reference_temperature", "area", "normal_stress"):
            if getattr(found, name) is not None:
                require_number(name, getattr(found, name), **POSITIVE)
    if found.area is None and found.normal_stress is None:
        found = found.model_copy(update=_of_interface(file))
    if found.data is not None and found.record is not None:
        raise InputError(
            "fit.record: not allowed with fit.data; fit a table or a record"
        )
    if (found.temperature is None) != (found.reference_temperature is None):
        missing = (
            "reference_temperature"
            if found.reference_temperature is None
            else "temperature"
        )
        raise InputError(
            f"fit.{missing}: is required; kT of a row is thermal.kT T/reference_temperature"
        )
    return found


def _of_interface(file: RunFile) -> dict[str, float]:
    """The area or the normal stress of the run file's [interface], if only one of them
    is there: with an area what is measured is a force, with a normal stress a
    coefficient."""
    given = {name: getattr(file.interface, name) for name in ("area", "normal_stress")}
    known = {name: value for name, value in given.items() if value is not None}
    return known if len(known) == 1 else {}


def _flat(free: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Keys that were not quoted, which TOML takes for sections in sections."""
    for name, content in free.items():
        nested = (
            isinstance(content, dict)
            and content
            and all(isinstance(part, dict) for part in content.values())
        )
        if nested and "prior" not in content:
            yield from _flat(content, f"{above}{name}.")
        else:
            yield f"{above}{name}", content


def _explain(error: pydantic.ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    place = [str(part) for part in first["loc"] if part not in ("Scale", "float")]
    field, value = ".".join(["fit", *place]), shown(first["input"])
    if first["type"] == "extra_forbidden":
        sections: dict[str, type[BaseModel]] = {
            "free": Free,
            "scale": Scale,
            "noise": Noise,
            "record": Record,
        }
        known = list(sections.get(place[0] if place[1:] else "", Fit).model_fields)
        return f"{field}: unknown key; " + (
            meant(place[-1], known) or "known here: " + ", ".join(known)
        )
    if first["type"] in ("model_type", "dict_type"):
        free = ", such as { bounds = [0.1, 10.0] }" if place[:1] == ["free"] else ""
        return f"{field} = {value}: must be a section{free}"
    return f"{field} = {value}: " + first["msg"].replace(
        "Input should be", "must be"
    ).replace("'", '"')


def parameters_of(file: RunFile, fit: Fit) -> list[Parameter]:
    """Free keys of the run file, in its order. Raises InputError."""
    known, values = keys(file), parameters(file)
    found = []
    for key, free in fit.free.items():
        field = f"fit.free.{key}"
        if key in NUISANCES:
            if fit.record is None:
                raise InputError(f"{field}: only of a record")
            value: Any = getattr(fit, NUISANCES[key])
            transform = (
                free.transform if "transform" in free.model_fields_set else "linear"
            )
            free = free.model_copy(update={"transform": transform})
        else:
            if key not in known:
                hint = meant(key, [*known, *NUISANCES]) or "known are " + ", ".join(
                    known
                )
                raise InputError(f"{field}: is not a key of the run file; {hint}")
            if known[key] is not float:
                what = "text" if known[key] is str else "an integer"
                raise InputError(
                    f"{field}: its value is {what}; only numbers with a fraction can be fitted"
                )
            value = values[key]
            _check_effect(file, key, field)
            if value is None:
                raise InputError(
                    f"{field}: has no value in the run file, which is its start"
                )
        found.append(_parameter(key, field, float(value), free, key in NUISANCES))
    return found


def _check_effect(file: RunFile, key: str, field: str) -> None:
    """Raise InputError for a key that the laws of the run file do not know."""
    law, rule = file["thresholds.law"], file["aging.rule"]
    if key == "thermal.temperature":
        raise InputError(f"{field}: must be thermal.kT, to which it is proportional")
    if key.startswith("thresholds.") and key.partition(".")[
        2
    ] not in threshold_parameters(law):
        raise InputError(f'{field}: has no effect with thresholds.law = "{law}"')
    if key.startswith("aging.") and rule == "none":
        raise InputError(
            f'{field}: has no effect with aging.rule = "none", contacts that do not age'
        )


def _parameter(
    key: str, field: str, value: float, free: Free, linear: bool
) -> Parameter:
    require_choice(f"{field}.transform", free.transform, TRANSFORMS)
    low, high = _bounds(field, free.bounds, free.transform)
    if not free.bounds[0] <= value <= free.bounds[1]:
        where = f"[{free.bounds[0]:g}, {free.bounds[1]:g}]"
        raise InputError(
            f"{field}: starts at {value:g}, the run file's value; must be inside its bounds {where}"
        )
    prior = None
    if free.prior is not None:
        normal = free.prior.normal
        if len(normal) != 2 or not all(map(math.isfinite, normal)) or not normal[1] > 0:
            raise InputError(
                f"{field}.prior.normal = {shown(normal)}: must be [mean, sd] with sd > 0"
            )
        prior = NormalPrior(*normal)
    return Parameter(
        key, free.transform, low, high, variable(free.transform, value), prior, linear
    )


def _bounds(field: str, bounds: list[float], transform: str) -> tuple[float, float]:
    """In the variable that is fitted."""
    said = f"{field}.bounds = {shown(bounds)}"
    if len(bounds) != 2 or not all(map(math.isfinite, bounds)):
        raise InputError(f"{said}: must be two finite numbers")
    if not bounds[0] < bounds[1]:
        raise InputError(
            f"{said}: must be [least, greatest], the first smaller than the second"
        )
    least = {"log": 0.0, "log1p": -1.0, "linear": -math.inf}[transform]
    if not bounds[0] > least:
        hint = (
            '; transform = "linear" or "log1p" may begin at 0'
            if transform == "log"
            else ""
        )
        raise InputError(
            f'{said}: must be > {least:g} with transform = "{transform}"{hint}'
        )
    return variable(transform, bounds[0]), variable(transform, bounds[1])


def scales_of(fit: Fit, sets: list[str]) -> tuple[list[Parameter], float]:
    """A free scale per set, or none and the fixed value. Raises InputError."""
    if not isinstance(fit.scale, Scale):
        require_number("fit.scale", fit.scale, **POSITIVE)
        return [], fit.scale
    one = _parameter(
        "fit.scale", "fit.scale", fit.scale.start, Free(bounds=fit.scale.bounds), True
    )
    names = [f"fit.scale.{name}" for name in sets] if len(sets) > 1 else ["fit.scale"]
    return [one._replace(key=name) for name in names], 1.0
