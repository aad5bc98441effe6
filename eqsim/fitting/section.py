"""The [fit] section of a run file: free keys, measurements and their noise."""

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pydantic
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    meant,
    require_number,
    shown,
)
from eqsim.io.parameters import keys, parameters
from eqsim.io.runfile import RunFile, population_alone
from eqsim.laws.named import threshold_parameters
from eqsim.sweeps.plan import entries

# Parameters of a record that are no keys of a run file, and their names in [fit].
NUISANCES = ("fit.offset", "fit.drift", "fit.trend")
# Keys of [fit] that say what a column of a table is.
_OF_TABLE = ("fit.temperature", "fit.reference_temperature")
# Keys of [interface] of which the only one holds for data, too: with an area these are
# forces, with a normal stress friction coefficients.
_LOADS = ("area", "normal_stress")
# Examples of sections, for messages.
_EXAMPLES = {
    "free": "{ bounds = [0.1, 10.0] }",
    "prior": "{ normal = [mean, sd] }",
    "scale": "{ start = 1.0, bounds = [0.01, 100.0] }, or a number",
    "noise": "{ relative = 0.05, absolute = 0.0 }",
    "record": '{ file = "step.csv" }',
    "trend": '{ per = "displacement" }, or "time"',
    "blocks": '{ per = "displacement", size = 0.5 }, "auto" or "none"',
}


def _checked(**bounds: float) -> Any:
    """Validate a number as `require_number` does."""

    def check(value: float) -> float:
        require_number("", value, **bounds)
        return value

    return AfterValidator(check)


Finite = Annotated[float, _checked()]
NotNegative = Annotated[float, _checked(**NOT_NEGATIVE)]
Positive = Annotated[float, _checked(**POSITIVE)]


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
    relative: NotNegative = 0.0
    absolute: NotNegative = 0.0


class BlockSize(_Section):
    per: Literal["displacement", "time"]
    size: Positive


class RecordSection(_Section):
    file: str
    time: str = "t"
    displacement: str | None = None
    force: str = "force"
    normal: str | None = None
    stderr: str | None = None
    start: str | float | None = None
    decimal: Literal[".", ","] | None = None
    blocks: Literal["auto", "none"] | BlockSize | None = None
    machine_stiffness: Positive | None = None


class Trend(_Section):
    per: Literal["displacement", "time"]
    value: Finite = 0.0


class Fit(_Section):
    """The content of [fit]."""

    data: str | None = None
    record: RecordSection | None = None
    scale: Scale | float = 1.0
    temperature: str | None = None
    reference_temperature: Positive | None = None
    noise: Noise = Noise()
    loss: Literal["gaussian", "student"] = "gaussian"
    offset: Finite = 0.0
    drift: Finite = 0.0
    trend: Trend | None = None
    area: Positive | None = None
    normal_stress: Positive | None = None
    free: dict[str, Free] = Field(default_factory=dict)

    def nuisance(self, key: str) -> float:
        """The value of "fit.offset", "fit.drift" or "fit.trend". Raises InputError."""
        if key != "fit.trend":
            return float(getattr(self, key.removeprefix("fit.")))
        if self.trend is None:
            raise InputError(f"fit.trend: is required, {_EXAMPLES['trend']}")
        if self.trend.per == "time" and "fit.drift" in self.free:
            raise InputError("fit.free.fit.drift: is a trend per time, as fit.trend is")
        return self.trend.value

    def scales(self, sets: list[str]) -> tuple[list["Parameter"], float]:
        """Free scales of force, one for each set, and 1; or none and the fixed scale.
        Raises InputError."""
        if not isinstance(self.scale, Scale):
            return [], self.scale
        free = Free(bounds=self.scale.bounds)
        scale = _parameter("fit.scale", "fit.scale", self.scale.start, free)
        if len(sets) < 2:
            return [scale], 1.0
        return [scale._replace(key=f"fit.scale.{name}") for name in sets], 1.0


_FIT_SECTIONS: dict[str, type[BaseModel]] = {
    "free": Free,
    "scale": Scale,
    "noise": Noise,
    "record": RecordSection,
    "trend": Trend,
}


class NormalPrior(NamedTuple):
    """Mean and standard deviation of a normal prior of a parameter's variable."""

    mean: float
    sd: float


class _Transform(NamedTuple):
    """The variable of a key, the key from its variable, the variable's name, and the
    number that the key must be greater than."""

    variable: Callable[[float], float]
    value: Callable[[Any], Any]
    name: str
    above: float


_TRANSFORMS = {
    "log": _Transform(math.log, np.exp, "ln {}", 0.0),
    "log1p": _Transform(math.log1p, np.expm1, "ln(1 + {})", -1.0),
    "linear": _Transform(float, np.positive, "{}", -math.inf),
}


class Parameter(NamedTuple):
    """A parameter of a fit: a key of the run file, "fit.scale" (of a set:
    "fit.scale.SET"), "fit.offset", "fit.drift" or "fit.trend"; bounds, start and prior in the
    variable in which it is fitted; and whether what is measured is linear in it."""

    key: str
    transform: str
    low: float
    high: float
    start: float
    prior: NormalPrior | None = None
    linear: bool = False

    def value(self, u: Any) -> Any:
        """The key's value, from the variable, any shape."""
        return _TRANSFORMS[self.transform].value(u)

    def variable(self, value: float) -> float:
        """The variable in which a value is fitted."""
        return _TRANSFORMS[self.transform].variable(value)

    @property
    def variable_name(self) -> str:
        """The name of the variable, such as "ln thermal.kT"."""
        return _TRANSFORMS[self.transform].name.format(self.key)


def section_of(file: RunFile) -> Fit:
    """The [fit] section. Raises InputError with one line that names the field."""
    if not file.fit:
        raise InputError("fit: the run file has no section [fit]; it says what is free")
    if file.sweep:
        raise InputError("sweep: not allowed with [fit]; a fit chooses its own points")
    given = dict(file.fit)
    if isinstance(given.get("free"), dict):
        given["free"] = dict(entries(given["free"], {"bounds"}))
    try:
        fit = Fit.model_validate(given)
    except pydantic.ValidationError as error:
        raise InputError(_explain_section(error)) from None
    if not fit.free:
        raise InputError("fit.free: is empty; at least one key must be free")
    if isinstance(fit.scale, float):
        require_number("fit.scale", fit.scale, **POSITIVE)
    if fit.area is None and fit.normal_stress is None:
        given = {name: getattr(file.interface, name) for name in _LOADS}
        known = {name: value for name, value in given.items() if value is not None}
        fit = fit.model_copy(update=known if len(known) == 1 else {})
    if fit.area is not None and fit.normal_stress is not None:
        raise InputError("fit.normal_stress: not allowed with fit.area; one of both")
    if fit.data is not None and fit.record is not None:
        raise InputError("fit.record: not allowed with fit.data; one of both")
    record = fit.record
    if record and record.displacement and "time" in record.model_fields_set:
        said = "not allowed with fit.record.displacement; one of both"
        raise InputError(f"fit.record.time: {said}")
    unused: tuple[str, ...] = NUISANCES
    said = "only of a record; there is no fit.record"
    if record is not None:
        unused, said = _OF_TABLE, "only of a table; there is fit.record"
    for key in unused:
        if getattr(fit, key.removeprefix("fit.")) not in (None, 0.0):
            raise InputError(f"{key}: {said}")
    if fit.temperature is not None:
        fit = _with_reference(file, fit)
    if (fit.temperature is None) != (fit.reference_temperature is None):
        missing = "temperature" if fit.temperature is None else "reference_temperature"
        said = "kT of a row is thermal.kT temperature/reference_temperature"
        raise InputError(f"fit.{missing}: is required; {said}")
    return fit


def _with_reference(file: RunFile, fit: Fit) -> Fit:
    """The section with the temperature to which a fixed kT of the run file belongs as
    the reference temperature. Raises InputError for another one."""
    for key in keys(file):
        kT = key.replace("thermal.temperature", "thermal.kT")
        free = {kT, "thermal.kT"} & fit.free.keys()
        if kT == key or free or file[key] is None:
            continue
        reference = fit.reference_temperature
        if reference not in (None, file[key]):
            said = f"must be {key}, {file[key]:g}, or left out"
            raise InputError(f"fit.reference_temperature = {reference:g}: {said}")
        fit = fit.model_copy(update={"reference_temperature": file[key]})
    return fit


def _explain_section(error: pydantic.ValidationError) -> str:
    """The message about the first error, one line."""
    every = error.errors(include_url=False)
    here = [one for one in every if one["loc"][:2] == every[0]["loc"][:2]]
    first = max(here, key=lambda one: len(one["loc"]))  # of a choice, what fits best
    kinds = "Scale", "float", "BlockSize", "literal['auto','none']"
    path = [str(name) for name in first["loc"] if name not in kinds]
    field, value = ".".join(["fit", *path]), shown(first["input"])
    if first["type"] == "extra_forbidden":
        section = _FIT_SECTIONS[path[0]] if path[1:] else Fit
        hint = meant(path[-1], section.model_fields, "known here: ")
        return f"{field}: unknown key; {hint}"
    if first["type"] == "missing":
        return f"{field}: is required"
    if first["type"] in ("model_type", "dict_type"):
        example = _EXAMPLES[path[-1] if path[-1] in _EXAMPLES else path[0]]
        return f"{field} = {value}: must be a section, such as {example}"
    allowed = first["msg"].replace("Input should be", "must be").replace("'", '"')
    if first["type"] == "value_error":  # of `require_number`
        allowed = allowed.partition(": ")[2]
    return f"{field} = {value}: {allowed.replace('a valid string', 'text')}"


def parameters_of(file: RunFile, fit: Fit) -> list[Parameter]:
    """Free keys of the run file, in its order. Raises InputError."""
    known, values, found = keys(file), parameters(file), []
    for key, free in fit.free.items():
        field = f"fit.free.{key}"
        if key in NUISANCES:
            if fit.record is None:
                raise InputError(f"{field}: only of a record; there is no fit.record")
            value: Any = fit.nuisance(key)
            if "transform" not in free.model_fields_set:
                free = free.model_copy(update={"transform": "linear"})
        elif key not in known:
            hint = meant(key, [*known, *NUISANCES], "known are ")
            raise InputError(f"{field}: is not a key of the run file; {hint}")
        else:
            _check_effect(file, key, known[key])
            value = values[key]
            if value is None:
                raise InputError(f"{field}: has no value in the run file, its start")
        found.append(_parameter(key, field, float(value), free))
    return found


def _check_effect(file: RunFile, key: str, kind: type) -> None:
    """Raise InputError for a key that holds no number with a fraction, or has no effect
    with the laws of the run file."""
    field = f"fit.free.{key}"
    if key.startswith("population.") and key.count(".") == 3:
        _, index, key = key.split(".", 2)
        file = population_alone(file, int(index))
    law, (section, _, name) = file["thresholds.law"], key.partition(".")
    wrong = ""
    if kind is not float:
        text = "text" if kind is str else "an integer"
        wrong = f"its value is {text}; only numbers with a fraction can be fitted"
    elif key == "thermal.temperature":
        wrong = "must be thermal.kT, to which it is proportional"
    elif key == "thresholds.scale":
        wrong = "cannot be fitted; give thresholds in the unit of length"
    elif section == "thresholds" and name not in threshold_parameters(law):
        wrong = f'has no effect with thresholds.law = "{law}"'
    elif section == "aging" and file["aging.rule"] == "none":
        wrong = 'has no effect with aging.rule = "none", contacts that do not age'
    if wrong:
        raise InputError(f"{field}: {wrong}")


def _parameter(key: str, field: str, value: float, free: Free) -> Parameter:
    """The variable, bounds and start of a free key. Raises InputError."""
    given, transform = f"{field}.bounds = {shown(free.bounds)}", free.transform
    variable, _, _, above = _TRANSFORMS[transform]
    if len(free.bounds) != 2 or not all(map(math.isfinite, free.bounds)):
        raise InputError(f"{given}: must be two finite numbers")
    low, high = free.bounds
    if not low < high:
        raise InputError(f"{given}: must be [least, greatest], the first smaller")
    if not low > above:
        other = '; transform = "linear" or "log1p" may begin at 0'
        other = other if transform == "log" else ""
        raise InputError(
            f'{given}: must be > {above:g} with transform = "{transform}"{other}'
        )
    if not low <= value <= high:
        inside = f"must be inside its bounds [{low:g}, {high:g}]"
        raise InputError(f"{field}: starts at {value:g}, the file's value; {inside}")
    prior = None
    if free.prior is not None:
        normal = free.prior.normal
        if len(normal) != 2 or not all(map(math.isfinite, normal)) or not normal[1] > 0:
            given = f"{field}.prior.normal = {shown(normal)}"
            raise InputError(f"{given}: must be [mean, sd] with sd > 0")
        prior = NormalPrior(*normal)
    ends = variable(low), variable(high), variable(value)
    return Parameter(key, transform, *ends, prior, key.startswith("fit."))
