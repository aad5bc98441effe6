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
    require_number,
    shown,
    under,
)
from eqsim.io.runfile import RunFile, keys, parameters
from eqsim.laws.named import threshold_parameters

# Free keys of a record that no contact knows, and their names in [fit].
NUISANCES = {"fit.offset": "offset", "fit.drift": "drift"}


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Prior(_Section):
    normal: list[float]


class Free(_Section):
    bounds: list[float]
    transform: Literal["log", "log1p", "linear"] = "log"
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
    """The content of [fit]."""

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

    def scales(self, sets: list[str]) -> tuple[list["Parameter"], float]:
        """A free scale of force for each set, or none and the fixed value. Raises
        InputError."""
        if not isinstance(self.scale, Scale):
            require_number("fit.scale", self.scale, **POSITIVE)
            return [], self.scale
        free = Free(bounds=self.scale.bounds)
        one = _parameter("fit.scale", "fit.scale", self.scale.start, free)
        if len(sets) < 2:
            return [one], 1.0
        return [one._replace(key=f"fit.scale.{name}") for name in sets], 1.0


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
        return {"log": np.exp, "log1p": np.expm1}.get(self.transform, lambda x: x)(u)

    def value_or_none(self, u: float | None) -> float | None:
        """The key's value; None if there is none."""
        return None if u is None else float(self.value(u))

    def variable(self, value: float) -> float:
        """The variable in which a value is fitted."""
        return _variable(self.transform, value)

    @property
    def variable_name(self) -> str:
        """What the variable is, such as "ln thermal.kT"."""
        names = {"log": "ln {}", "log1p": "ln(1 + {})", "linear": "{}"}
        return names[self.transform].format(self.key)


def _variable(transform: str, value: float) -> float:
    return {"log": math.log, "log1p": math.log1p}.get(transform, float)(value)


def section_of(file: RunFile) -> Fit:
    """The [fit] section. Raises InputError with one line that names the field."""
    if not file.fit:
        raise InputError(
            "fit: the run file has no section [fit]; it says which keys are free and "
            "where the data are"
        )
    if file.sweep:
        raise InputError("sweep: not allowed with [fit]; a fit chooses its own points")
    given = dict(file.fit)
    if isinstance(given.get("free"), dict):
        given["free"] = dict(_flat(given["free"]))
    try:
        found = Fit.model_validate(given)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None
    if not found.free:
        raise InputError("fit.free: is empty; at least one key must be free")
    with under("fit"):
        _check_numbers(found)
    if found.area is None and found.normal_stress is None:
        found = found.model_copy(update=_of_interface(file))
    if found.data is not None and found.record is not None:
        raise InputError(
            "fit.record: not allowed with fit.data; a fit takes one of both"
        )
    pair = ("temperature", "reference_temperature")
    missing = [name for name in pair if getattr(found, name) is None]
    if len(missing) == 1:
        raise InputError(
            f"fit.{missing[0]}: is required; kT of a row is thermal.kT "
            "T/reference_temperature"
        )
    return found


def _check_numbers(fit: Fit) -> None:
    """Raise InputError for a number that is out of its range."""
    stiffness = fit.record.machine_stiffness if fit.record is not None else None
    for name, value, bounds in (
        ("noise.relative", fit.noise.relative, NOT_NEGATIVE),
        ("noise.absolute", fit.noise.absolute, NOT_NEGATIVE),
        ("offset", fit.offset, {}),
        ("drift", fit.drift, {}),
        ("record.machine_stiffness", stiffness, POSITIVE),
        ("reference_temperature", fit.reference_temperature, POSITIVE),
        ("area", fit.area, POSITIVE),
        ("normal_stress", fit.normal_stress, POSITIVE),
    ):
        if value is not None:
            require_number(name, value, **bounds)


def _of_interface(file: RunFile) -> dict[str, float]:
    """The area or the normal stress of the run file's [interface], if only one of them
    is there: with an area what is measured is a force, with a normal stress a
    coefficient."""
    given = {name: getattr(file.interface, name) for name in ("area", "normal_stress")}
    known = {name: value for name, value in given.items() if value is not None}
    return known if len(known) == 1 else {}


def _flat(free: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Join keys that were not quoted, which TOML takes for sections in sections."""
    for name, content in free.items():
        nested = isinstance(content, dict) and content and "prior" not in content
        if nested and all(isinstance(part, dict) for part in content.values()):
            yield from _flat(content, f"{above}{name}.")
        else:
            yield f"{above}{name}", content


def _explain(error: pydantic.ValidationError) -> str:
    """One line about the first thing that is wrong."""
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
        hint = meant(place[-1], known) or "known here: " + ", ".join(known)
        return f"{field}: unknown key; {hint}"
    if first["type"] in ("model_type", "dict_type"):
        free = ", such as { bounds = [0.1, 10.0] }" if place[:1] == ["free"] else ""
        return f"{field} = {value}: must be a section{free}"
    allowed = first["msg"].replace("Input should be", "must be").replace("'", '"')
    return f"{field} = {value}: {allowed}"


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
            if "transform" not in free.model_fields_set:
                free = free.model_copy(update={"transform": "linear"})
        else:
            if key not in known:
                hint = meant(key, [*known, *NUISANCES])
                hint = hint or "known are " + ", ".join(known)
                raise InputError(f"{field}: is not a key of the run file; {hint}")
            if known[key] is not float:
                kind = "text" if known[key] is str else "an integer"
                raise InputError(
                    f"{field}: its value is {kind}; only numbers with a fraction can "
                    "be fitted"
                )
            value = values[key]
            _check_effect(file, key, field)
            if value is None:
                raise InputError(f"{field}: has no value in the run file, its start")
        found.append(_parameter(key, field, float(value), free))
    return found


def _check_effect(file: RunFile, key: str, field: str) -> None:
    """Raise InputError for a key that the laws of the run file do not know."""
    law, (section, _, name) = file["thresholds.law"], key.partition(".")
    if key == "thermal.temperature":
        raise InputError(f"{field}: must be thermal.kT, to which it is proportional")
    if section == "thresholds" and name not in threshold_parameters(law):
        raise InputError(f'{field}: has no effect with thresholds.law = "{law}"')
    if section == "aging" and file["aging.rule"] == "none":
        raise InputError(
            f'{field}: has no effect with aging.rule = "none", contacts that do not age'
        )


def _parameter(key: str, field: str, value: float, free: Free) -> Parameter:
    """The variable, bounds and start of a free key. Raises InputError."""
    low, high = _bounds(field, free.bounds, free.transform)
    if not free.bounds[0] <= value <= free.bounds[1]:
        where = f"[{free.bounds[0]:g}, {free.bounds[1]:g}]"
        raise InputError(
            f"{field}: starts at {value:g}, the run file's value; must be inside its "
            f"bounds {where}"
        )
    prior = None
    if free.prior is not None:
        normal = free.prior.normal
        if len(normal) != 2 or not all(map(math.isfinite, normal)) or not normal[1] > 0:
            given = f"{field}.prior.normal = {shown(normal)}"
            raise InputError(f"{given}: must be [mean, sd] with sd > 0")
        prior = NormalPrior(*normal)
    start, linear = _variable(free.transform, value), key.startswith("fit.")
    return Parameter(key, free.transform, low, high, start, prior, linear)


def _bounds(field: str, bounds: list[float], transform: str) -> tuple[float, float]:
    """Bounds in the variable that is fitted. Raises InputError."""
    given = f"{field}.bounds = {shown(bounds)}"
    if len(bounds) != 2 or not all(map(math.isfinite, bounds)):
        raise InputError(f"{given}: must be two finite numbers")
    low, high = bounds
    if not low < high:
        raise InputError(
            f"{given}: must be [least, greatest], the first smaller than the second"
        )
    least = {"log": 0.0, "log1p": -1.0, "linear": -math.inf}[transform]
    if not low > least:
        other = '; transform = "linear" or "log1p" may begin at 0'
        raise InputError(
            f'{given}: must be > {least:g} with transform = "{transform}"'
            f"{other if transform == 'log' else ''}"
        )
    return _variable(transform, low), _variable(transform, high)
