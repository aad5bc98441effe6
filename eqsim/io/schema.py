"""The keys that a run file may hold, with their types and defaults, and messages about
others.

The keys of each section stand in `eqsim.catalogue`. A key is the field of that name of
the section's dataclass in the model, whose type and default are those of the key;
`_OTHERS` lists the keys that are no field, or may be left out where the field has no
default. Limits and choices are those of the dataclasses, which are made later.
"""

import types
import typing
from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, NamedTuple

import pydantic
from pydantic import BeforeValidator

from eqsim import catalogue
from eqsim.errors import InputError, meant, shown
from eqsim.io.tables import DriveRecord
from eqsim.io.units import Interface, Units
from eqsim.laws.aging import RULES, Aging
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.delay import DELAYS, Delay
from eqsim.laws.named import THRESHOLDS
from eqsim.laws.newborn import LAWS, Newborn
from eqsim.laws.thermal import Thermal
from eqsim.laws.viscosity import Viscosity
from eqsim.model.chain import Chain
from eqsim.model.drive import Drive, Output, Segment, Stage
from eqsim.model.ensemble import Ensemble, Population

_DATACLASSES: dict[str, Any] = {
    "": Ensemble,
    "contacts": Ensemble,
    "population": Population,
    "thermal": Thermal,
    "newborn": Newborn,
    "aging": Aging,
    "delay": Delay,
    "viscosity": Viscosity,
    "drive": Drive,
    "drive.programme": Segment,
    "drive.stage": Stage,
    "drive.record": DriveRecord,
    "elastic": Chain,
    "output": Output,
    "units": Units,
    "interface": Interface,
}
# Sections that a population may have, too.
OF_POPULATION = ("thresholds", "thermal", "delay", "aging", "newborn")
# Sections that are there or not.
OPTIONAL = ("elastic", "drive.stage", "drive.record", "thermal.catch", "thermal.slip")
_DEEPEST = 16  # nesting of a sweep; its deepest form takes 5


# What may be chosen, where the type of the field does not say it.
_CHOICES = {
    "thermal.barrier": tuple(BARRIERS),
    "aging.rule": ("none", *RULES),
    "newborn.law": ("unstressed", *LAWS),
    "delay.law": tuple(DELAYS),
}


class Key(NamedTuple):
    """A key: the `kind` of its values, float, int, bool, str or dict, how pydantic
    checks it, and the `choices` of a text that is not free."""

    kind: type
    annotation: Any
    default: Any
    choices: tuple[str, ...] = ()


def _whole(value: Any) -> Any:
    """TOML's 1e5 is a float; accept it where a whole number is meant."""
    if isinstance(value, list):  # the blocks of a sheet
        return list(map(_whole, value))
    return int(value) if isinstance(value, float) and value.is_integer() else value


_WHOLE = Annotated[int, BeforeValidator(_whole)]
_NUMBER = Key(float, float | None, None)
_REQUIRED = Key(float, float, ...)
_TEXT = Key(str, str | None, None)
_TABLE = Key(dict, dict[str, Any], {})  # read by `sweeps.plan` and `fitting.section`
_OTHERS = {
    "title": Key(str, Annotated[str, pydantic.Field(max_length=200)], ""),
    "sweep": _TABLE,
    "fit": _TABLE,
    # a law (`laws.named.THRESHOLDS`), whose parameters are other keys, or a `Table`
    "thresholds.law": Key(str, Literal[(*THRESHOLDS, "table")], "gamma"),
    "thresholds.file": _TEXT,
    "thresholds.column": _TEXT,
    "thresholds.quantity": Key(str, Literal["stretch", "force"] | None, None),
    "thermal.temperature": _NUMBER,  # kelvin, instead of kT
    "viscosity.eta": Key(float, float, Ensemble.eta),
    "thermal.catch.rate": _REQUIRED,
    "thermal.catch.force": _REQUIRED,
    "thermal.slip.rate": _REQUIRED,
    "thermal.slip.force": _REQUIRED,
    "drive.velocity": _NUMBER,
    "drive.force": _NUMBER,
    "drive.force_rate": _NUMBER,
    "drive.time": _NUMBER,
    "drive.stall_force": _NUMBER,
    "drive.rebinding": _TEXT,
    "drive.file": _TEXT,
    "drive.stage.stiffness": _NUMBER,  # or that of the machine
    "drive.stage.machine_stiffness": _TEXT,
    "drive.stage.radiation_damping": _TEXT,
    "drive.record.start": Key(str, str | float | None, None),
    "drive.programme.velocity": _NUMBER,
    "drive.programme.hold": _NUMBER,  # the time of a segment that does not move
    "elastic.blocks": Key(int, Annotated[Any, BeforeValidator(_whole)], ...),
    "elastic.load": Key(list, list[Any] | dict[str, Any] | str | None, None),
}


def _key(name: str) -> Key:
    """The key of this name. Choices are texts here: the dataclass refuses others."""
    section, _, last = name.rpartition(".")
    if name in _OTHERS or section not in _DATACLASSES:
        key = _OTHERS.get(name, _NUMBER)
        return key._replace(choices=_literals(key.annotation))
    kind = _DATACLASSES[section]
    field = {field.name: field for field in fields(kind)}[last]
    hint = typing.get_type_hints(kind)[last]
    union = hint.__args__ if isinstance(hint, types.UnionType) else (hint,)
    choices = _CHOICES.get(name, _literals(hint))
    first = str if typing.get_origin(union[0]) is Literal else union[0]
    checked: Any = _WHOLE if first is int else first
    default = ... if field.default is MISSING else field.default
    if field.metadata.get("no_default_in_files"):
        return Key(first, checked | None, None, choices)
    checked = checked | None if type(None) in union else checked
    return Key(first, checked, default, choices)


def _literals(annotation: Any) -> tuple[str, ...]:
    """The texts that a type allows, if it lists them."""
    if typing.get_origin(annotation) is Literal:
        return typing.get_args(annotation)
    union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    parts = typing.get_args(annotation) if union else ()
    return tuple(choice for part in parts for choice in _literals(part))


KEYS = {name: _key(name) for name in catalogue.KEYS}


def keys_of(section: str) -> dict[str, Key]:
    """The keys of a section by their last names."""
    parts = ((name.rpartition("."), key) for name, key in KEYS.items())
    return {last: key for (above, _, last), key in parts if above == section}


class KeyRow(NamedTuple):
    """Row of a key in the documentation, in Markdown."""

    key: str  # without its section
    default: str
    values: str
    meaning: str


_WORDS = {float: "number", int: "whole number", bool: "`true`, `false`", str: "text"}


def rows_of(section: str) -> list[KeyRow]:
    """The keys of a section as the documentation lists them."""
    rows = []
    for last, key in keys_of(section).items():
        entry = catalogue.KEYS[f"{section}.{last}".removeprefix(".")]
        default = "" if key.default in (None, {}) else f"`{str(key.default).lower()}`"
        if isinstance(key.default, str):
            default = f'`"{key.default}"`'
        default = entry.default or ("required" if key.default is ... else default)
        values = ", ".join(f'`"{choice}"`' for choice in key.choices)
        values = values or entry.values or _WORDS.get(key.kind, "table")
        rows.append(KeyRow(last, default, values, entry.meaning))
    return rows


def _schema(section: str) -> Any:
    """A pydantic model that checks names and types of the keys of a section. [elastic],
    a stage and pathways are there or not; a programme is a list, and so are
    populations, which have sections."""
    keys: dict[str, Any] = {
        name: (key.annotation, key.default) for name, key in keys_of(section).items()
    }
    for name in catalogue.SECTIONS:
        above, _, last = name.rpartition(".")
        if above == section and last:
            below = _schema(name)
            if last in ("programme", "population"):
                keys[last] = list[below] | None, None  # type: ignore[valid-type]
            elif name in OPTIONAL:
                keys[last] = below | None, None
            else:
                keys[last] = below, below()
    for name in OF_POPULATION if section == "population" else ():
        keys[name] = _schema(name), _schema(name)()
    config = pydantic.ConfigDict(extra="forbid", strict=True, frozen=True)
    return pydantic.create_model(section or "run file", __config__=config, **keys)


CONTENT = _schema("")


def validated(data: dict[str, Any]) -> Any:
    """The pydantic model of the content of a run file. Raises InputError, one line that
    names the field."""
    for name in ("sweep", "fit"):
        _check_plain(name, data.get(name))
    try:
        return CONTENT.model_validate(data)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None


def _check_plain(field: str, content: Any) -> None:
    """Refuse what is no number or text of a sweep, wherever it is: dates, huge
    integers, endless nesting."""
    pending = [(field, content, 0)]
    while pending:
        name, value, depth = pending.pop()
        if depth > _DEEPEST:
            raise InputError(f"{name}: is nested too deep")
        if isinstance(value, dict):
            pending += [(f"{name}.{key}", v, depth + 1) for key, v in value.items()]
        elif isinstance(value, list):
            pending += [(name, part, depth + 1) for part in value]
        elif not isinstance(value, (str, float, int, type(None))) or (
            isinstance(value, int) and abs(value) > 10**300
        ):
            raise InputError(f"{name} = {shown(value)}: must be numbers or text")


def _explain(error: pydantic.ValidationError) -> str:
    problems = error.errors(include_url=False)
    first = problems[0]
    location = [str(part) for part in first["loc"]]
    field, value = ".".join(location), shown(first["input"])
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"{field}: unknown key; {_nearest(location)}{more}"
    if first["type"] in ("model_type", "dict_type"):
        return f"{field} = {value}: must be a section, [{field}]{more}"
    if first["type"] == "missing":
        return f"{field}: is required{more}"
    allowed = first["msg"].replace("Input should be", "must be")
    allowed = allowed.replace("String should", "must").replace("'", '"')
    return f"{field} = {value}: {allowed}{more}"


def _nearest(location: list[str]) -> str:
    """A hint which key may have been meant, here or in another section."""
    *sections, last = (part for part in location if not part.isdecimal())
    section = ".".join(sections).removeprefix("population.")
    below = (name.rpartition(".") for name in catalogue.SECTIONS if name)
    here = [*keys_of(section), *(name for above, _, name in below if above == section)]
    elsewhere = [name for name in KEYS if name.count(".") == 1]
    same = [
        name
        for name in (*here, *elsewhere)
        if name.rpartition(".")[2].lower() == last.lower()
        and name.partition(".")[0] not in (section, "elastic")
    ]
    if section in (*OPTIONAL, "drive.programme"):
        same = []
    return meant(last, same) or meant(last, here) or "known here: " + ", ".join(here)
