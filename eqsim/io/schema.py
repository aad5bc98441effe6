"""The keys that a run file may hold, with their types and defaults, and messages about
others.

The keys of each section stand in `eqsim.catalogue`. A key is the field of that name of
the section's dataclass in the model, whose type and default are those of the key;
`_OTHERS` lists the keys that are no field, or may be left out where the field has no
default. Limits and choices are those of the dataclasses, which are made later.
"""

import itertools
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

_NAMED_AS_SECTIONS: tuple[Any, ...] = (
    *(Population, Thermal, Newborn, Aging, Delay, Viscosity),
    *(Drive, Output, Units, Interface),
)
_DATACLASSES: dict[str, Any] = {
    **{kind.__name__.lower(): kind for kind in _NAMED_AS_SECTIONS},
    **{"": Ensemble, "contacts": Ensemble, "elastic": Chain},
    **{"drive.programme": Segment, "drive.stage": Stage, "drive.record": DriveRecord},
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
    """A key: the `kind` of its values, float, int, bool, str, list or dict, how
    pydantic checks it, and the `choices` of a text that is not free."""

    kind: type
    annotation: Any
    default: Any
    choices: tuple[str, ...] = ()


def _whole(value: Any) -> Any:
    """TOML's 1e5 is a float; accept it where a whole number is meant."""
    if isinstance(value, list):  # the blocks of a sheet
        return list(map(_whole, value))
    return int(value) if isinstance(value, float) and value.is_integer() else value


_WHOLE = BeforeValidator(_whole)
_TEXT = str | None, None
_TABLE: Any = (dict[str, Any], {})  # read by `sweeps.plan` and `fitting.section`
_NUMBER, _REQUIRED = (float | None, None), (float, ...)
_PATHWAYS = ("catch.rate", "catch.force", "slip.rate", "slip.force")
# Type and default; numbers that may be given are no fields and not here.
_OTHERS: dict[str, tuple[Any, Any]] = {
    "title": (Annotated[str, pydantic.Field(max_length=200)], ""),
    **dict.fromkeys(("sweep", "fit"), _TABLE),
    # a law (`laws.named.THRESHOLDS`), whose parameters are other keys, or a `Table`
    "thresholds.law": (Literal[(*THRESHOLDS, "table")], "gamma"),
    **dict.fromkeys(("thresholds.file", "thresholds.column"), _TEXT),
    "thresholds.quantity": (Literal["stretch", "force"] | None, None),
    "viscosity.eta": (float, Ensemble.eta),
    **{f"thermal.{name}": _REQUIRED for name in _PATHWAYS},
    "drive.velocity": _NUMBER,
    "drive.rebinding": (Literal["unstretched", "shared"] | None, None),
    "drive.file": _TEXT,
    "drive.stage.stiffness": _NUMBER,  # or that of the machine
    "drive.stage.machine_stiffness": _TEXT,
    "drive.stage.radiation_damping": _TEXT,
    "drive.record.start": (str | float | None, None),
    "drive.programme.velocity": _NUMBER,  # or a hold
    "elastic.blocks": (int | Any, ...),  # a number, or two
    "elastic.load": (list[Any] | dict[str, Any] | str | None, None),
}


def _key(name: str) -> Key:
    """The key of this name. Choices of fields are left to the dataclass."""
    section, _, last = name.rpartition(".")
    owner = _DATACLASSES.get(section)
    field = owner and {field.name: field for field in fields(owner)}.get(last)
    if name in _OTHERS or field is None:
        hint, default = _OTHERS.get(name, _NUMBER)
        checked = hint
    else:
        hint = typing.get_type_hints(owner)[last]
        default = ... if field.default is MISSING else field.default
        if field.metadata.get("no_default_in_files"):
            default = None
        checked = _kind(hint) | None if default is None else _kind(hint)
    kind, choices = _kind(hint), _CHOICES.get(name, _literals(hint))
    checked = Annotated[checked, _WHOLE] if kind is int else checked
    return Key(kind, checked, default, choices)


def _kind(hint: Any) -> Any:
    """The type of a value, of several the first one."""
    origin = typing.get_origin(hint) or hint
    if origin in (typing.Union, types.UnionType, Annotated):
        return _kind(typing.get_args(hint)[0])
    return str if origin is Literal else origin


def _literals(hint: Any) -> tuple[str, ...]:
    """The texts that a type allows, if it lists them."""
    if typing.get_origin(hint) is Literal:
        return typing.get_args(hint)
    parts = map(_literals, typing.get_args(hint))
    return tuple(itertools.chain.from_iterable(parts))


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
    """A pydantic model of the keys of a section. [elastic], a stage and pathways are
    there or not; a programme is a list, and so are populations, which have sections."""
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
    """The pydantic model of a run file. Raises InputError, which names the field."""
    for name in ("sweep", "fit"):
        _check_plain(name, data.get(name))
    try:
        return CONTENT.model_validate(data)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None


def _check_plain(field: str, content: Any) -> None:
    """Refuse what is no number or text in a sweep: dates, huge or nested ones."""
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
