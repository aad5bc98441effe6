"""Run files: TOML in, an Ensemble and a Drive out.

The keys of a section are fields of the model's dataclasses, which have their types,
defaults and limits (`_SECTIONS` says where each key lands). Here names and types are
checked, and whether keys that are given go together.
"""

import functools
import math
import tomllib
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar

import numpy as np
import pydantic
from pydantic import BeforeValidator

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
from eqsim.estimate import Averages, Estimate
from eqsim.io import csv
from eqsim.io.labels import described, of_trajectory
from eqsim.io.units import Interface, Quantity, Row, Units, quantities, rows_of
from eqsim.laws.aging import RULES, Aging
from eqsim.laws.delay import Delay
from eqsim.laws.named import THRESHOLDS, law_of, threshold_parameters
from eqsim.laws.newborn import LAWS, Newborn
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Table, ThresholdLaw
from eqsim.model.drive import Drive, Output, Programme, Segment, Stage, require_drive
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Disorder, Ensemble
from eqsim.results import Listed

Result = TypeVar("Result")
_DEEPEST = 16  # nesting of a sweep; its deepest form takes 5
_LONGEST = 10_000_000  # characters of a run file
# Keys whose text may be any word, also "Infinity".
_FREE_TEXT = ("title", "file", "column")


def _whole(value: Any) -> Any:
    """TOML's 1e5 is a float; accept it where a whole number is meant."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _whole_numbers(value: Any) -> Any:
    """One number of blocks, or two."""
    return list(map(_whole, value)) if isinstance(value, list) else _whole(value)


_WHOLE = Annotated[int, BeforeValidator(_whole)]
_BLOCKS = Annotated[Any, BeforeValidator(_whole_numbers)]


def _keys_of(kind: Any, *names: str) -> dict[str, Any]:
    """Keys that are fields of a dataclass, all or some: type and default, as pydantic
    takes them. Choices are texts here: the dataclass refuses others."""
    hints, keys = typing.get_type_hints(kind), {}
    for one in fields(kind):
        if names and one.name not in names:
            continue
        hint = hints[one.name]
        optional = isinstance(hint, types.UnionType) and type(None) in hint.__args__
        first = hint.__args__[0] if isinstance(hint, types.UnionType) else hint
        if typing.get_origin(first) is Literal:
            first = str
        checked: Any = _WHOLE if first is int else first
        default = ... if one.default is MISSING else one.default
        keys[one.name] = (checked | None if optional else checked, default)
    return keys


def _schema(name: str, keys: dict[str, Any]) -> Any:
    """A pydantic model that checks names and types of these keys."""
    config = pydantic.ConfigDict(extra="forbid", strict=True, frozen=True)
    return pydantic.create_model(name, __config__=config, **keys)


_NUMBER = (float | None, None)
_TEXT = (str | None, None)
_STAGE = _keys_of(Stage)
# `hold` is the time of a segment that does not move
_SEGMENT = {"velocity": _NUMBER, "hold": _NUMBER} | _keys_of(
    Segment, "distance", "time", "points"
)
# Where the keys of each section land; `disorder` is a field of Ensemble, too.
_SECTIONS: dict[str, dict[str, Any]] = {
    "contacts": _keys_of(Ensemble, "count", "stiffness", "stiffness_law"),
    # the law of that name (`laws.named.THRESHOLDS`), or a `Table`
    "thresholds": {
        "law": (Literal[(*THRESHOLDS, "table")], "gamma"),
        **{key: _NUMBER for law in THRESHOLDS for key in threshold_parameters(law)},
        "file": _TEXT,
        "column": _TEXT,
        "scale": _NUMBER,
        "quantity": (Literal["stretch", "force"] | None, None),
    },
    # kelvin, instead of kT
    "thermal": {"temperature": _NUMBER, **_keys_of(Thermal)},
    "newborn": _keys_of(Newborn),
    # a run file has to say x_star_final where the rule takes it
    "aging": {**_keys_of(Aging), "x_star_final": _NUMBER},
    "delay": _keys_of(Delay),
    "viscosity": _keys_of(Ensemble, "eta"),
    # a Drive, or a Programme of segments or of a recorded file
    "drive": {
        **_keys_of(Drive, "velocity", "distance", "start"),
        "velocity": _NUMBER,
        "programme": (list[_schema("segment", _SEGMENT)] | None, None),  # type: ignore[misc]
        "file": _TEXT,
        "stage": (_schema("stage", _STAGE) | None, None),
    },
    "elastic": {**_keys_of(Elastic), "blocks": (_BLOCKS, ...)},
    "output": _keys_of(Output),
    "units": _keys_of(Units),
    "interface": _keys_of(Interface),
}


def _content() -> Any:
    """A pydantic model of a whole run file; [elastic] is there or not."""
    keys = {
        "title": (Annotated[str, pydantic.Field(max_length=200)], ""),
        **_keys_of(Ensemble, "disorder"),
    }
    for name, section in _SECTIONS.items():
        schema = _schema(name, section)
        keys[name] = (schema | None, None) if name == "elastic" else (schema, schema())
    return _schema("run file", {**keys, "sweep": _TABLE, "fit": _TABLE})


_TABLE: Any = (dict[str, Any], {})  # read by `sweeps.plan` and by `fitting.section`
CONTENT = _content()


@dataclass(frozen=True)
class RunFile(Listed):
    """A checked run file.

    Attributes
    ----------
    given : dict
        The content of the file, as it would be written again.
    settings : dict
        The same with the default of every key, None where there is none.
    text : str
        What was read, and what was changed then.
    folder : Path
        Where paths in the file start.
    """

    given: dict[str, Any] = field(compare=False)
    settings: dict[str, Any] = field(repr=False)
    text: str = field(default="", repr=False, compare=False)
    folder: Path = field(default=Path(), repr=False, compare=False)
    unlisted: ClassVar[tuple[str, ...]] = (
        *("constant", "constant_drive", "headline", "labels"),
        *("physical", "preferred", "quantities_in", "rows"),
    )

    def __getitem__(self, key: str) -> Any:
        """The value of a "section.key" with its default filled in, None if it has none."""
        return functools.reduce(_part, key.split("."), self.settings)

    @property
    def title(self) -> str:
        """Shown above tables and pictures."""
        return str(self.settings["title"])

    @property
    def sweep(self) -> dict[str, Any]:
        """The content of [sweep]."""
        return dict(self.settings["sweep"])

    @property
    def fit(self) -> dict[str, Any]:
        """The content of [fit]."""
        return dict(self.settings["fit"])

    @cached_property
    def units(self) -> Units:
        """The units of its numbers. Raises InputError."""
        with under("units"):
            return Units(**self.settings["units"])

    @cached_property
    def interface(self) -> Interface:
        """What the contacts stand for. Raises InputError."""
        with under("interface"):
            return Interface(**self.settings["interface"])

    @cached_property
    def output(self) -> Output:
        """How a run is recorded. Raises InputError."""
        with under("output"):
            output = Output(**self.settings["output"])
        for name in ("series", "breaks"):
            if getattr(output, name) and self["elastic"]:
                raise InputError(
                    f"output.{name}: not with [elastic], which writes every block and avalanche"
                )
        if output.breaks and not self.constant:
            raise InputError(
                "output.breaks: breaks are listed at a constant drive.velocity only"
            )
        return output

    @property
    def constant(self) -> bool:
        """Whether it moves at a constant velocity, without a programme, file or stage."""
        drive = self.settings["drive"]
        return all(drive[name] is None for name in ("programme", "file", "stage"))

    @cached_property
    def ensemble(self) -> Ensemble:
        """The contacts. Raises InputError."""
        laws = self._laws()
        with under("contacts"):
            return Ensemble(**laws, **self.settings["contacts"])

    def _laws(self) -> dict[str, Any]:
        """Arguments of `Ensemble` but for those of [contacts]."""
        given, disorder = self.given, self["disorder"]
        with under("thermal"):
            known = self.settings["thermal"]
            thermal = Thermal(
                **{name: known[name] for name in known if name != "temperature"}
            )
        with under("delay"):
            delay = Delay(**self.settings["delay"])
        law = self._threshold_law()
        require_choice("disorder", disorder, typing.get_args(Disorder))
        # contacts that do not age, or are born unstressed, would be a surprise
        _require_law("aging.rule", given, (*RULES, "none"))
        with under("aging"):
            chosen = {k: v for k, v in self.settings["aging"].items() if v is not None}
            aging = Aging(**chosen)
            aging.check_keys(set(given.get("aging", ())))
            aging.check(law, disorder)
            rule = aging.rule
            if (
                "x_star_final" not in chosen
                and rule != "none"
                and "x_star_final" in RULES[rule].keys
            ):
                raise InputError(f'x_star_final: is required with rule = "{rule}"')
        with under("viscosity"):
            require_number("eta", self["viscosity.eta"], **NOT_NEGATIVE)
        _require_law("newborn.law", given, (*LAWS, "unstressed"))
        with under("newborn"):
            newborn = Newborn(**self.settings["newborn"])
            newborn.check(law, disorder, aging.active)
        return {
            "thresholds": law,
            "thermal": thermal,
            "delay": delay,
            "aging": aging,
            "newborn": newborn,
            "disorder": disorder,
            "eta": self["viscosity.eta"],
        }

    def _threshold_law(self) -> ThresholdLaw:
        known = self.settings["thresholds"]
        law, tabled = known["law"], ("file", "column", "scale", "quantity")
        given = {k: v for k, v in known.items() if k != "law" and v is not None}
        allowed = tabled if law == "table" else threshold_parameters(law)
        for key, value in given.items():
            if key not in allowed:
                raise InputError(
                    f'thresholds.{key} = {shown(value)}: not allowed with law = "{law}"'
                )
        if law != "table":
            with under("thresholds"):
                return law_of(law, given)
        if "file" not in given:
            raise InputError('thresholds.file: is required with law = "table"')
        scale = given.get("scale", 1.0)
        require_number("thresholds.scale", scale, **POSITIVE)
        path = path_of("thresholds.file", self.folder, given["file"])
        found = read_thresholds(path, given.get("column"), scale)
        if given.get("quantity") != "force":
            return found
        contacts = self.settings["contacts"]
        require_number("contacts.stiffness", contacts["stiffness"], **POSITIVE)
        force = found.steps  # f = k_i xi, with k_i = k sqrt(f/<f>) under the sqrt law
        uniform = contacts["stiffness_law"] == "uniform"
        stretch = force if uniform else np.sqrt(force * force.mean())
        with under("thresholds"):
            return Table(stretch / contacts["stiffness"])

    @cached_property
    def drive(self) -> Drive | Programme:
        """How the slider moves. Raises InputError."""
        given = self.settings["drive"]
        if not self.constant:
            return self._programme()
        if given["velocity"] is None:
            raise InputError("drive.velocity: is required")
        elastic = None
        if self["elastic"] is not None:
            with under("elastic"):
                elastic = Elastic(**self["elastic"])
        with under("drive"):
            return Drive(given["velocity"], given["distance"], given["start"], elastic)

    @property
    def constant_drive(self) -> Drive:
        """The drive, where only a constant velocity has an answer. Raises InputError."""
        return require_drive(self.drive)

    def _programme(self) -> Programme:
        given = self.settings["drive"]
        programme, file, stage = (
            given[name] for name in ("programme", "file", "stage")
        )
        if self["elastic"] is not None:
            name = next(
                name
                for name in ("programme", "file", "stage")
                if given[name] is not None
            )
            raise InputError(
                f"drive.{name}: not allowed with [elastic], whose plate moves at drive.velocity"
            )
        if programme is not None and file is not None:
            raise InputError("drive.file: not allowed with drive.programme")
        alone = programme is None and file is None
        if given["distance"] is not None and not alone:
            raise InputError(
                f"drive.distance = {given['distance']!r}: not allowed with a programme or file"
            )
        if alone and given["velocity"] is None:
            raise InputError("drive.velocity: is required")
        pulled_by, segments = None, []
        with under("drive"):
            if stage is not None:
                with under("stage"):
                    pulled_by = Stage(**stage)
            if file is not None:
                segments = read_drive(path_of("file", self.folder, file))
            elif alone:
                distance = given["distance"]
                if distance is None:
                    distance = 200.0 * self._threshold_law().mean
                segments = [Segment(given["velocity"], distance)]
            for index, section in enumerate(programme or []):
                with under(f"programme.{index}"):
                    segments.append(_segment(**section))
            return Programme(
                tuple(segments), given["start"], given["velocity"], pulled_by
            )

    def with_changes(self, changes: dict[str, Any]) -> "RunFile":
        """The run file of one point, without [sweep] and [fit].

        Parameters
        ----------
        changes : dict
            Values by "section.key": {"thermal.kT": 0.1}.

        Returns
        -------
        RunFile

        Raises
        ------
        InputError
            For a key that there is not, and a value that has not its type.
        """
        data, known = copied(self.given, without=("sweep", "fit")), keys(self)
        _without_alternatives(data, changes)
        for key, value in changes.items():
            if key not in known:
                first = dict.fromkeys(one.split(".")[0] for one in known)
                hint = meant(key, known) or "there are " + ", ".join(first)
                raise InputError(
                    f"{key}: is not a key that can change from point to point; {hint}"
                )
            *sections, last = key.split(".")
            place: Any = data
            for name in sections:
                listed = isinstance(place, list)
                place = place[int(name)] if listed else place.setdefault(name, {})
            place[last] = value
        return check(data, self.folder)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What friction is as a force, a shear stress and a coefficient, as far as that
        is known."""
        return self.quantities_in()

    def quantities_in(
        self, units: Units | None = None, interface: Interface | None = None
    ) -> tuple[Quantity, ...]:
        """`quantities` in other units, or at another interface."""
        at_interface = interface or self.interface
        return quantities(self.ensemble, units or self.units, at_interface)

    def physical(
        self, friction: Estimate, reference: float | None = None
    ) -> dict[str, Any]:
        """For JSON: friction, and that of the reference, as `quantities` under the key
        "physical", if any is known."""
        found = {one.name: one.as_dict(friction, reference) for one in self.quantities}
        return {"physical": found} if found else {}

    def headline(self, name: str) -> str:
        """The title of a table, or `name` without one, and what is simulated."""
        return f"{self.title or name}: {described(self.ensemble, self.units)}"

    def labels(self, x: str) -> dict[str, str]:
        """Labels of the axes of a picture of the force against `x`, a column of a
        trajectory, in its units."""
        return of_trajectory(x, self.units)

    def preferred(self, friction: Estimate) -> Quantity | None:
        """The one of `quantities` that says most, a coefficient before a stress before a
        force, in a unit fit for `friction`; None if none is known."""
        found = self.quantities
        return found[-1].near(friction.value or 0.0) if found else None

    def rows(self, averages: Averages) -> list[tuple[str, Row]]:
        """Rows of a table of averages (`units.rows_of`)."""
        return rows_of(averages, self.units, self.quantities)


def _require_law(key: str, given: dict[str, Any], laws: tuple[str, ...]) -> None:
    """Raise InputError if a section has keys, but not the one that names its law."""
    section, name = key.split(".")
    there = given.get(section) or {}
    if there and name not in there:
        *more, last = (f'"{law}"' for law in laws)
        allowed = ", ".join(more) + f" or {last}"
        raise InputError(f"{key}: is required with {min(there)}; must be {allowed}")


def _segment(velocity: Any, hold: float | None, **more: Any) -> Segment:
    """A segment of a run file. Raises InputError."""
    if (velocity is None) == (hold is None):
        raise InputError(
            "velocity: a segment has either a velocity or a hold, the time for which nothing moves"
        )
    if hold is None:
        return Segment(velocity, **more)
    for name in ("distance", "time"):
        if more[name] is not None:
            raise InputError(
                f"{name} = {shown(more[name])}: not allowed with hold, which is a time"
            )
    require_number("hold", hold, **POSITIVE)
    return Segment(0.0, **{**more, "time": hold})


_PAIRS = (
    ("thermal.temperature", "thermal.kT"),
    ("interface.normal_load", "interface.normal_stress"),
)
_ALTERNATIVES = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}


def _two_temperatures(temperature: float) -> str:
    return f"thermal.temperature = {shown(temperature)}: not allowed with kT; give one of them"


def _without_alternatives(data: dict[str, Any], changes: dict[str, Any]) -> None:
    """Of two keys that say the same, a change of one replaces the other in the content
    of a run file."""
    for key in _ALTERNATIVES.keys() & changes.keys():
        section, name = _ALTERNATIVES[key].split(".")
        if _ALTERNATIVES[key] not in changes and isinstance(data.get(section), dict):
            data[section].pop(name, None)


def copied(data: Any, without: tuple[str, ...] = ()) -> Any:
    """A copy of the content of a run file `without` some of its keys."""
    if isinstance(data, dict):
        return {key: copied(part) for key, part in data.items() if key not in without}
    return [copied(part) for part in data] if isinstance(data, list) else data


def load(path: Path | str, changes: dict[str, Any] | None = None) -> RunFile:
    """Read and check a run file.

    Parameters
    ----------
    path : Path or str
        TOML in UTF-8. It is read once: it may be a pipe.
    changes : dict, optional
        Values by "section.key", put in before anything is checked: {"drive.velocity":
        0.2}.

    Returns
    -------
    RunFile
        `file.ensemble` and `file.drive` are the contacts and the drive, as `steady` and
        `trajectory` take them; `file.output`, `file.units` and `file.interface` are the
        other sections, and `file["thermal.kT"]` is the value of a key.

    Raises
    ------
    InputError
        If the file cannot be read, or holds what is not allowed.

    Examples
    --------
    >>> _ = Path("x.toml").write_text("[thermal]\\nkT = 0.1\\n[drive]\\nvelocity = 0.1\\n")
    >>> file = load("x.toml", {"thermal.kT": 0.2})
    >>> file.ensemble.thermal.kT, file.drive.velocity, file["output.points"]
    (0.2, 0.1, 2001)
    """
    path = Path(path)
    return _changed(*read_toml(path), changes or {}, path.parent)


def _changed(
    text: str, data: dict[str, Any], changes: dict[str, Any], folder: Path
) -> RunFile:
    """A run file of this text and content with changes. Raises InputError."""
    _without_alternatives(data, changes)
    for key, value in changes.items():
        *sections, last = key.split(".")
        axes, axis = data.get("sweep", {}), key.removeprefix("sweep.")
        first = axis.split(".")[0]
        nested = (
            not isinstance(axes, dict)
            or isinstance(axes.get(first), dict)
            or first in ("zip", "file")
        )
        if axis != key and not nested:  # an axis, its key in quotes
            sections, last = ["sweep"], axis
        place: Any = data
        for name in sections:
            if isinstance(place, list) and name.isdecimal() and int(name) < len(place):
                place = place[int(name)]
            else:
                place = place.setdefault(name, {}) if isinstance(place, dict) else None
            if not isinstance(place, (dict, list)):
                raise InputError(f"{key}: {name} is not a section")
        if isinstance(place, list):
            raise InputError(
                f"{key}: must name a key of a segment, as in drive.programme.0.{last}"
            )
        place[last] = value
    heat = data.get("thermal")
    if (
        isinstance(heat, dict) and {"kT", "temperature"} <= heat.keys()
    ):  # even if kT is 0
        raise InputError(_two_temperatures(heat["temperature"]))
    text += "".join(f"# --set {key}={value!r}\n" for key, value in changes.items())
    return replace(check(data, folder), text=text)


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """The text and the content of a TOML file, which may be a pipe. Raises InputError."""
    text = _read(path)
    try:
        return text, tomllib.loads(text)
    except (
        ValueError,
        RecursionError,
    ) as error:  # also numbers and nesting beyond Python's limits
        raise InputError(f"{path}: is not valid TOML: {error}") from None


def opened(
    file: RunFile | Path | str,
    folder: Path | str | None = None,
    changes: dict[str, Any] | None = None,
) -> RunFile:
    """A run file with `changes` by "section.key", read if it is the path of one; paths
    in it start in its own folder or in `folder`. Raises InputError."""
    if not isinstance(file, (RunFile, Path, str)):
        raise InputError(f"file = {shown(file)}: must be a run file or the path of one")
    if not isinstance(file, RunFile):
        file = load(file, changes)
    elif changes:
        file = _changed(file.text, copied(file.given), changes, file.folder)
    return file if folder is None else replace(file, folder=Path(folder))


def _read(path: Path) -> str:
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8") from None
    if len(text) > _LONGEST:  # a device may never end
        raise InputError(
            f"{path}: is longer than {_LONGEST:.0e} characters; a run file is not"
        )
    return text


def keys(file: RunFile | None = None) -> dict[str, type]:
    """Every `section.key` (or top-level key) but `title`, `sweep`, `units` and
    `interface`, and the type of its values: float, int or str. Given a `file`, also
    those that its programme, stage or coupled blocks have, such as
    drive.programme.1.hold."""
    known = dict(_PARAMETERS)
    if file and file["elastic"]:
        known |= {
            f"elastic.{name}": _kind(one) for name, one in _SECTIONS["elastic"].items()
        }
    if file and file["drive.stage"]:
        known |= {f"drive.stage.{name}": float for name in _STAGE}
    for index, segment in enumerate((file["drive.programme"] if file else None) or []):
        known |= {
            f"drive.programme.{index}.{name}": _kind(_SEGMENT[name])
            for name, value in segment.items()
            if value is not None
        }
    return known


def _kind(key: Any) -> type:
    """The type of a key's values; a choice is text."""
    annotation = key[0]
    if annotation is _BLOCKS:
        return int
    parts = (
        typing.get_args(annotation)
        if not isinstance(annotation, type)
        else (annotation,)
    )
    while typing.get_origin(parts[0]) is Annotated:
        parts = typing.get_args(parts[0])
    return parts[0] if isinstance(parts[0], type) else str


# [elastic] is there or not; averages do not depend on units and interface, nor on what
# is written.
_PARAMETERS: dict[str, type] = {"disorder": str} | {
    f"{name}.{key}": _kind(one)
    for name, section in _SECTIONS.items()
    if name not in ("elastic", "units", "interface")
    for key, one in section.items()
    if one[0] is not bool and f"{name}.{key}" not in ("drive.programme", "drive.stage")
}


def parameters(file: RunFile) -> dict[str, Any]:
    """The values of all `keys()`, with the defaults of the threshold law filled in:
    equal settings, equal dicts."""
    found = {key: file[key] for key in keys(file)}
    for key, default in threshold_parameters(file["thresholds.law"]).items():
        if found[f"thresholds.{key}"] is None:
            found[f"thresholds.{key}"] = default
    # no -0.0
    return {k: v + 0.0 if isinstance(v, float) else v for k, v in found.items()}


def _part(data: Any, name: str) -> Any:
    """The content of a section, or of a segment by its number."""
    return data[int(name)] if isinstance(data, list) else data[name]


at = RunFile.with_changes


def stored(settings: dict[str, Any], folder: Path | str = "") -> RunFile:
    """A run file as it was in force, from the provenance of a table, infinite rates
    included. Raises InputError."""

    def restored(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            return {key: restored(content, key) for key, content in value.items()}
        if isinstance(value, list):
            return [restored(content, name) for content in value]
        return math.inf if value == "Infinity" and name not in _FREE_TEXT else value

    return check(restored(settings), Path(folder))


def check(data: dict[str, Any], folder: Path = Path()) -> RunFile:
    """A run file from its content; paths in it start in `folder`. Raises InputError with
    one line that names the field."""
    for name in ("sweep", "fit"):
        _check_plain(name, data.get(name))
    try:
        content = CONTENT.model_validate(data)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None
    given = content.model_dump(exclude_unset=True, exclude_none=True)
    given |= {name: data[name] for name in ("sweep", "fit") if data.get(name)}
    file = RunFile(given, content.model_dump(), folder=folder)
    _heat(file)
    _ = file.units, file.interface, file.output
    return file


def _heat(file: RunFile) -> None:
    """Put in the kT that belongs to thermal.temperature, if that is given: it is not
    itself given, and follows where the temperature changes. Raises InputError."""
    thermal = file.settings["thermal"]
    if thermal["temperature"] is None:
        return
    with under("thermal"):
        kT = file.units.energy(thermal["temperature"])
    if thermal["kT"] and not math.isclose(
        thermal["kT"], kT, rel_tol=1e-12, abs_tol=0.0
    ):
        raise InputError(_two_temperatures(thermal["temperature"]))
    thermal["kT"] = kT
    file.given["thermal"].pop("kT", None)


def _check_plain(field: str, content: Any) -> None:
    """Refuse what is no number or text of a sweep, wherever it is: dates, huge
    integers, endless nesting."""
    pending = [(field, content, 0)]
    while pending:
        name, value, depth = pending.pop()
        if depth > _DEEPEST:
            raise InputError(f"{name}: is nested too deep")
        if isinstance(value, dict):
            pending += [
                (f"{name}.{key}", part, depth + 1) for key, part in value.items()
            ]
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
    allowed = (
        first["msg"]
        .replace("Input should be", "must be")
        .replace("String should", "must")
        .replace("'", '"')
    )
    return f"{field} = {value}: {allowed}{more}"


def _nearest(location: list[str]) -> str:
    """Which key may have been meant, here or in another section."""
    *sections, last = location
    inside = {
        "drive.programme": _SEGMENT,
        "drive.stage": _STAGE,
        "elastic": _SECTIONS["elastic"],
    }
    here = list(inside.get(".".join(sections[:2]), ()))
    if here:
        return meant(last, here) or "known here: " + ", ".join(here)
    known = CONTENT.model_fields if not sections else _SECTIONS.get(sections[0], ())
    here = list(known)
    elsewhere = [
        f"{name}.{key}"
        for name, section in _SECTIONS.items()
        if [name] != sections and name != "elastic"
        for key in section
    ]
    same = [
        key
        for key in here + elsewhere
        if key.rpartition(".")[2].lower() == last.lower()
    ]
    return meant(last, same) or meant(last, here) or "known here: " + ", ".join(here)


def path_of(field: str, folder: Path, name: str) -> Path:
    """The path of a file that a key names, relative to `folder`. Raises InputError for
    an empty name."""
    if not name.strip():
        raise InputError(f"{field} = {shown(name)}: must be the name of a file")
    return folder / name


def read_thresholds(path: Path, column: str | None = None, scale: float = 1.0) -> Table:
    """The empirical law of a CSV file, one positive number a row; lines that begin with
    # are comments.

    Parameters
    ----------
    path : Path
    column : str, optional
        Where the thresholds stand. Default: `threshold`, or the only column there is,
        which needs no name.
    scale : float
        What they are multiplied by, such as 1e-9 of nanometres where lengths are in
        metres.

    Raises
    ------
    InputError
        With the line that cannot be used.
    """
    read = functools.partial(_thresholds, column=column, scale=scale)
    return _of_file(read, f"thresholds.file = {path}", path)


def read_drive(path: Path) -> list[Segment]:
    """The segments of a recorded drive: a CSV file with columns `t` and `X`, piecewise
    linear, from 0 and 0 on.

    Raises
    ------
    InputError
        With the line that cannot be used.
    """
    return _of_file(_recorded, f"file = {path}", path)


class _Stamp(NamedTuple):
    """What tells whether a file has changed."""

    modified: int
    size: int


def _of_file(
    read: Callable[[Path, str, _Stamp | None], Result], field: str, path: Path
) -> Result:
    """What a reader makes of a file, remembered for as long as that stays as it is."""
    try:
        found = path.stat()
        stamp = _Stamp(found.st_mtime_ns, found.st_size)
    except (OSError, ValueError):  # the reader says why
        stamp = None
    return read(path, field, stamp)


@functools.lru_cache(maxsize=8)
def _thresholds(
    path: Path,
    field: str,
    stamp: _Stamp | None,
    column: str | None = None,
    scale: float = 1.0,
) -> Table:
    """All points of a sweep share it."""
    values = []
    for line, text in _column_of_thresholds(csv.read(path, field), column):
        value = csv.value_of(text)
        if not 0 < value < math.inf:
            raise InputError(
                f"{field}, line {line}: {text[:40]!r} must be a finite number > 0"
            )
        values.append(value * scale)
    if not values:
        raise InputError(f"{field}: is empty; at least one threshold is needed")
    try:
        return Table(values)
    except InputError as error:
        raise InputError(f"{field}: {error}") from None


def _column_of_thresholds(
    sheet: csv.Sheet, column: str | None
) -> Iterator[tuple[int, str]]:
    """Lines and cells of a `column`; by default of `threshold`, or of the only one
    there is, which needs no name."""
    index = 0
    if column is None and len(sheet.columns) == 1:
        if sheet.headless:
            yield sheet.first, sheet.columns[0]
    else:
        index = sheet.index(column or "threshold", " (thresholds.column names another)")
    for line, cells in sheet.rows():
        yield line, cells[index]


class _Instant(NamedTuple):
    """A row of a recorded drive."""

    t: float
    X: float


@functools.lru_cache(maxsize=8)
def _recorded(path: Path, field: str, stamp: _Stamp | None) -> list[Segment]:
    """Segments between the instants of a recorded drive. Raises InputError."""
    segments: list[Segment] = []
    before: _Instant | None = None
    sheet = csv.read(path, field)
    columns = sheet.index("t"), sheet.index("X")
    for line, cells in sheet.rows():
        texts = [cells[index] for index in columns]
        here = f"{field}, line {line}"
        now = _Instant(*map(csv.value_of, texts))
        if not all(map(math.isfinite, now)):
            raise InputError(
                f"{here}: {', '.join(texts)[:40]!r} must be finite numbers"
            )
        if before is None:
            if now != (0.0, 0.0):
                raise InputError(
                    f"{here}: t = {now.t:g}, X = {now.X:g}; the first instant must be t = 0, X = 0"
                )
        else:
            elapsed = now.t - before.t
            if not elapsed > 0:
                raise InputError(
                    f"{here}: t = {now.t:g} must be later than the {before.t:g} before it"
                )
            with under(here):
                segments.append(Segment((now.X - before.X) / elapsed, time=elapsed))
        before = now
    if not segments:
        raise InputError(f"{field}: needs two instants at least")
    return segments
