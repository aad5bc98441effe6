"""Run files: TOML in, checked, turned into an Ensemble and a Drive.

Structure and types are checked here; what a value may be is known to the law it belongs
to. `workflows.run` simulates what comes out, and `model.reduced` makes it
dimensionless.
"""

import functools
import math
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr
from pydantic.fields import FieldInfo

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
from eqsim.model.drive import (
    MOST_SERIES,
    Drive,
    Programme,
    Segment,
    Stage,
    check_output,
    require_drive,
)
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble


def _whole(value: Any) -> Any:
    """TOML's 1e5 is a float; accept it where a whole number is meant."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


Result = TypeVar("Result")
Whole = Annotated[int, BeforeValidator(_whole)]
_DEEPEST = 16  # nesting of a sweep; its deepest form takes 5
_FREE_TEXT = (
    "title",
    "file",
    "column",
)  # keys whose text may be any word, also "Infinity"
_LONGEST = 10_000_000  # characters of a run file


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Contacts(_Section):
    count: Whole = 100_000
    stiffness: float = 1.0
    stiffness_law: str = "sqrt"


if TYPE_CHECKING:
    LawName = str
else:
    LawName = Literal[(*THRESHOLDS, "table")]


class Thresholds(_Section):
    law: LawName = "gamma"
    n: float | None = None
    x_star: float | None = None
    sigma: float | None = None
    shape: float | None = None
    std: float | None = None
    low: float | None = None
    high: float | None = None
    exponent: float | None = None
    file: str | None = None
    column: str | None = None
    scale: float | None = None
    quantity: Literal["stretch", "force"] | None = None


class ThermalSection(_Section):
    temperature: Annotated[
        float | None, Field(description="kelvin, instead of kT; takes [units] of SI")
    ] = None
    kT: float = 0.0  # b = k x_*^2/(2 kT): `Ensemble.b`; field b of a barrier
    # log_w: `model.reduced._barrier`; field log_w of a barrier
    attempt_frequency: float = 1.0
    barrier: str = "soft"


class AgingSection(_Section):
    rule: str = "none"
    # 4 D x_*i/(v x_*f^2): `Aging.alpha`; field alpha of a law of aging
    rate: float = 0.0
    x_star_final: float | None = None
    beta: float | None = None
    cutoff_time: float | None = None


class NewbornSection(_Section):
    law: str = "unstressed"
    of: str = "length"
    stretch: float | None = None
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    std: float | None = None


class DelaySection(_Section):
    time: float = 0.0  # v tau/x_*: `Delay.reduced`; `laws.delay.Waits.mean` in kernels
    law: str = "fixed"


class Viscosity(_Section):
    eta: float = 0.0


class SegmentSection(_Section):
    velocity: float | None = None
    hold: float | None = None
    distance: float | None = None
    time: float | None = None
    points: Whole | None = None

    def segment(self) -> Segment:
        """Raises InputError."""
        if (self.velocity is None) == (self.hold is None):
            raise InputError(
                "velocity: a segment has either a velocity or a hold, the time for which nothing moves"
            )
        if self.hold is not None:
            for name in ("distance", "time"):
                if getattr(self, name) is not None:
                    raise InputError(
                        f"{name} = {shown(getattr(self, name))}: not allowed with hold, which is a time"
                    )
            require_number("hold", self.hold, **POSITIVE)
        return Segment(
            self.velocity or 0.0,
            self.distance,
            self.time if self.hold is None else self.hold,
            self.points,
        )


class StageSection(_Section):
    stiffness: float
    damping: float = 0.0
    mass: float = 0.0
    preload: float | None = None
    tolerance: float = 1e-4


class DriveSection(_Section):
    velocity: float | None = None
    distance: float | None = None
    start: str = "fresh"
    programme: list[SegmentSection] | None = None
    file: str | None = None
    stage: StageSection | None = None


def _whole_numbers(value: Any) -> Any:
    """One number of blocks, or two."""
    return (
        [_whole(part) for part in value] if isinstance(value, list) else _whole(value)
    )


class ElasticSection(_Section):
    blocks: Annotated[Any, BeforeValidator(_whole_numbers)]
    coupling: float
    drive_stiffness: float
    edges: str = "open"


class Output(_Section):
    points: Whole = 2001
    # `numerics.streams.key`; words of every draw, `numerics.streams.philox`
    seed: Whole = 1
    replicas: Whole = 1
    series: bool = False
    breaks: bool = False


class UnitsSection(_Section):
    length: Annotated[
        str,
        Field(
            description='"nm", "um", ...: known units of SI, or any label, such as "x_*"'
        ),
    ] = ""
    time: Annotated[str, Field(description='"s", "ms", "min", ..., or any label')] = ""
    force: Annotated[
        str,
        Field(
            description='"N", "nN", ..., or any label; kT is in units of force times length'
        ),
    ] = ""


class InterfaceSection(_Section):
    area: Annotated[float | None, Field(description="apparent area (length^2)")] = None
    contacts_per_area: Annotated[
        float | None,
        Field(
            description="1/length^2; with an area the interface has their product of contacts, else contacts.count"
        ),
    ] = None
    normal_load: Annotated[
        float | None, Field(description="force on all contacts of the interface")
    ] = None
    normal_stress: Annotated[
        float | None,
        Field(
            description="force/length^2, instead of normal_load; takes an area or contacts_per_area"
        ),
    ] = None


class RunFile(_Section):
    """A checked run file; the defaults are the contract. `text` is what was read, and
    what was changed then."""

    title: Annotated[str, Field(max_length=200)] = ""
    disorder: str = "quenched"
    contacts: Contacts = Contacts()
    thresholds: Thresholds = Thresholds()
    thermal: ThermalSection = ThermalSection()
    newborn: NewbornSection = NewbornSection()
    aging: AgingSection = AgingSection()
    delay: DelaySection = DelaySection()
    viscosity: Viscosity = Viscosity()
    drive: DriveSection = DriveSection()
    elastic: ElasticSection | None = None
    output: Output = Output()
    units: UnitsSection = UnitsSection()
    interface: InterfaceSection = InterfaceSection()
    sweep: dict[str, Any] = {}
    fit: dict[str, Any] = {}  # `fitting.section`
    _text: str = PrivateAttr("")
    _folder: Path = PrivateAttr(Path())

    @property
    def text(self) -> str:
        return self._text

    def in_units(self) -> Units:
        """The units of its numbers. Raises InputError."""
        with under("units"):
            return Units(**self.units.model_dump())

    def of_interface(self) -> Interface:
        """What the contacts stand for. Raises InputError."""
        with under("interface"):
            return Interface(**self.interface.model_dump())

    def quantities(self, ensemble: Ensemble) -> tuple[Quantity, ...]:
        """What friction is as a force, a shear stress and a coefficient, as far as that
        is known."""
        return quantities(ensemble, self.in_units(), self.of_interface())

    def physical(
        self, ensemble: Ensemble, friction: Estimate, reference: float | None = None
    ) -> dict[str, Any]:
        """For JSON: friction, and that of the reference, as `quantities` under the key
        "physical", if any is known."""
        found = {
            one.name: one.as_dict(friction, reference)
            for one in self.quantities(ensemble)
        }
        return {"physical": found} if found else {}

    def headline(self, ensemble: Ensemble, name: str) -> str:
        """Of a table: the title, or `name` without one, and what is simulated."""
        return f"{self.title or name}: {described(ensemble, self.in_units())}"

    def labels(self, x: str) -> dict[str, str]:
        """Labels of the axes of a picture of the force against `x`, a column of a
        trajectory, in its units."""
        return of_trajectory(x, self.in_units())

    def preferred(self, ensemble: Ensemble, friction: Estimate) -> Quantity | None:
        """That of `quantities` which says most, a coefficient before a stress before a
        force, in a unit fit for `friction`; None if none is known."""
        found = self.quantities(ensemble)
        return found[-1].near(friction.value or 0.0) if found else None

    def rows(self, ensemble: Ensemble, averages: Averages) -> list[tuple[str, Row]]:
        """As in `units.rows_of`."""
        return rows_of(averages, self.in_units(), self.quantities(ensemble))

    def heated(self) -> "RunFile":
        """With the kT that belongs to thermal.temperature, if that is given. Raises
        InputError."""
        given = self.thermal
        if given.temperature is None:
            return self
        with under("thermal"):
            kT = self.in_units().energy(given.temperature)
            if given.kT and not math.isclose(given.kT, kT, rel_tol=1e-12, abs_tol=0.0):
                raise InputError(_two_temperatures(given.temperature))
        warm = given.model_copy(update={"kT": kT})
        warm.model_fields_set.discard(
            "kT"
        )  # it follows, also where the temperature changes
        return self.model_copy(update={"thermal": warm})

    @property
    def folder(self) -> Path:
        """Where it was read from, and the paths in it start."""
        return self._folder

    def ensemble(self, folder: Path | None = None) -> Ensemble:
        """The contacts; the path of a threshold table is relative to `folder`, by
        default that of the run file. Raises InputError."""
        folder = self.folder if folder is None else folder
        with under("thermal"):
            thermal = Thermal(
                self.thermal.kT, self.thermal.attempt_frequency, self.thermal.barrier
            )
        with under("delay"):
            delay = Delay(self.delay.time, self.delay.law)
        law = self._threshold_law(folder)
        require_choice("disorder", self.disorder, ("quenched", "annealed"))
        given, final = self.aging.model_fields_set, self.aging.x_star_final
        if (
            given and "rule" not in given
        ):  # contacts that do not age would be a surprise
            rules = ", ".join(f'"{rule}"' for rule in RULES)
            raise InputError(
                f'aging.rule: is required with {min(given)}; must be {rules} or "none"'
            )
        with under("aging"):
            rule, beta, cutoff_time = (
                self.aging.rule,
                self.aging.beta,
                self.aging.cutoff_time,
            )
            aging = Aging(
                rule,
                self.aging.rate,
                1.0 if final is None else final,
                beta,
                cutoff_time,
            )
            aging.check_keys(
                {key for key in given if getattr(self.aging, key) is not None}
            )
            aging.check(law, self.disorder)
            if final is None and rule != "none" and "x_star_final" in RULES[rule].keys:
                raise InputError(
                    f'x_star_final: is required with rule = "{aging.rule}"'
                )
        with under("viscosity"):
            require_number("eta", self.viscosity.eta, **NOT_NEGATIVE)
        given = self.newborn.model_fields_set
        if given and "law" not in given:  # contacts born unstressed would be a surprise
            laws = ", ".join(f'"{law}"' for law in LAWS)
            raise InputError(
                f'newborn.law: is required with {min(given)}; must be {laws} or "unstressed"'
            )
        with under("newborn"):
            newborn = Newborn(**self.newborn.model_dump())
            newborn.check(law, self.disorder, aging.active)
        many = self.contacts
        with under("contacts"):
            return Ensemble(
                count=many.count,
                stiffness=many.stiffness,
                stiffness_law=many.stiffness_law,  # type: ignore[arg-type]  # checked there
                thresholds=law,
                thermal=thermal,
                delay=delay,
                aging=aging,
                disorder=self.disorder,  # type: ignore[arg-type]
                eta=self.viscosity.eta,
                newborn=newborn,
            )

    def _threshold_law(self, folder: Path) -> ThresholdLaw:
        law, tabled = self.thresholds.law, ("file", "column", "scale", "quantity")
        given = self.thresholds.model_dump(exclude={"law"}, exclude_none=True)
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
        found = read_thresholds(
            path_of("thresholds.file", folder, given["file"]),
            given.get("column"),
            scale,
        )
        if given.get("quantity") != "force":
            return found
        require_number("contacts.stiffness", self.contacts.stiffness, **POSITIVE)
        force = found.steps  # f = k_i xi, with k_i = k sqrt(f/<f>) under the sqrt law
        stretch = (
            force
            if self.contacts.stiffness_law == "uniform"
            else np.sqrt(force * force.mean())
        )
        with under("thresholds"):
            return Table(stretch / self.contacts.stiffness)

    def driven(self, folder: Path | None = None) -> Drive | Programme:
        """How the slider moves; the path of a recorded drive is relative to `folder`,
        by default that of the run file. Raises InputError."""
        given, folder = self.drive, self.folder if folder is None else folder
        if (
            given.programme is not None
            or given.file is not None
            or given.stage is not None
        ):
            return self._programme(folder)
        if given.velocity is None:
            raise InputError("drive.velocity: is required")
        elastic = None
        if self.elastic is not None:
            with under("elastic"):
                elastic = Elastic(**self.elastic.model_dump())
        with under("drive"):
            return Drive(given.velocity, given.distance, given.start, elastic)  # type: ignore[arg-type]  # checked there

    def constant(self, folder: Path | None = None) -> Drive:
        """How it moves where only a constant velocity has an answer. Raises InputError."""
        return require_drive(self.driven(folder))

    def _programme(self, folder: Path) -> Programme:
        given = self.drive
        if self.elastic is not None:
            name = next(
                name
                for name in ("programme", "file", "stage")
                if getattr(given, name) is not None
            )
            raise InputError(
                f"drive.{name}: not allowed with [elastic], whose plate moves at drive.velocity"
            )
        if given.programme is not None and given.file is not None:
            raise InputError("drive.file: not allowed with drive.programme")
        alone = given.programme is None and given.file is None
        if given.distance is not None and not alone:
            raise InputError(
                f"drive.distance = {given.distance!r}: not allowed with a programme or file"
            )
        if alone and given.velocity is None:
            raise InputError("drive.velocity: is required")
        stage, segments = None, []
        with under("drive"):
            if given.stage is not None:
                with under("stage"):
                    stage = Stage(**given.stage.model_dump())
            if given.file is not None:
                segments = read_drive(path_of("file", folder, given.file))
            elif alone:
                distance = (
                    200.0 * self._threshold_law(folder).mean
                    if given.distance is None
                    else given.distance
                )
                segments = [Segment(given.velocity or 0.0, distance)]
            for index, section in enumerate(given.programme or []):
                with under(f"programme.{index}"):
                    segments.append(section.segment())
            return Programme(tuple(segments), given.start, given.velocity, stage)  # type: ignore[arg-type]  # checked there

    def check_output(self) -> None:
        """Raise InputError unless the size and seed of a recording can be used."""
        output = self.output
        with under("output"):
            check_output(output.points, output.seed, output.replicas)
        if output.series and output.replicas == 1:
            raise InputError(
                "output.series: writes the force of every replica; needs output.replicas of 2 or more"
            )
        if output.series and output.replicas * output.points > MOST_SERIES:
            size = f"output.replicas x output.points = {output.replicas * output.points:.3g}"
            raise InputError(
                f"output.series: {size}; at most {MOST_SERIES:.0e} forces are kept"
            )
        for name, asked in (("series", output.series), ("breaks", output.breaks)):
            if asked and self.elastic is not None:
                raise InputError(
                    f"output.{name}: not with [elastic], which writes every block and avalanche"
                )
        constant = (
            self.drive.programme is None
            and self.drive.file is None
            and self.drive.stage is None
        )
        if output.breaks and not constant:
            raise InputError(
                "output.breaks: breaks are listed at a constant drive.velocity only"
            )


_KINDS = {name: field.annotation for name, field in RunFile.model_fields.items()}
_SECTIONS = {
    name: kind
    for name, kind in _KINDS.items()
    if isinstance(kind, type) and issubclass(kind, BaseModel)
}


_PAIRS = (
    ("thermal.temperature", "thermal.kT"),
    ("interface.normal_load", "interface.normal_stress"),
)
_ALTERNATIVES = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}


def _two_temperatures(temperature: float) -> str:
    return f"temperature = {shown(temperature)}: not allowed with kT; give one of them"


def _without_alternatives(data: dict[str, Any], changes: dict[str, Any]) -> None:
    """Of two keys that say the same, a change of one replaces the other in the content
    of a run file."""
    for key in _ALTERNATIVES.keys() & changes.keys():
        section, name = _ALTERNATIVES[key].split(".")
        if _ALTERNATIVES[key] not in changes and isinstance(data.get(section), dict):
            data[section].pop(name, None)


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
        Its sections are attributes (`file.output.seed`); `file.ensemble()` are the
        contacts and `file.driven()` is the drive, as `steady` and `trajectory` take
        them.

    Raises
    ------
    InputError
        If the file cannot be read, or holds what is not allowed.
    """
    path, changes = Path(path), changes or {}
    text, data = read_toml(path)
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
        raise InputError("thermal." + _two_temperatures(heat["temperature"]))
    file = check(data)
    file._folder = path.parent
    file._text = text + "".join(
        f"# --set {key}={value!r}\n" for key, value in changes.items()
    )
    return file


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


def opened(file: RunFile | Path | str) -> RunFile:
    """A run file, read if it is the path of one. Raises InputError."""
    if not isinstance(file, (RunFile, Path, str)):
        raise InputError(f"file = {shown(file)}: must be a run file or the path of one")
    return file if isinstance(file, RunFile) else load(file)


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
    known = dict(_keys())
    if file and file.elastic:
        kinds: dict[str, type] = {"blocks": int, "edges": str}
        known |= {
            f"elastic.{name}": kinds.get(name, float)
            for name in ElasticSection.model_fields
        }
    if file and file.drive.stage:
        known |= {f"drive.stage.{name}": float for name in StageSection.model_fields}
    for index, segment in enumerate((file.drive.programme if file else None) or []):
        for name, value in segment:
            if value is not None:
                known[f"drive.programme.{index}.{name}"] = (
                    int if name == "points" else float
                )
    return known


@functools.cache
def _keys() -> dict[str, type]:

    def kind(field: FieldInfo) -> type:
        first, *_ = get_args(field.annotation) or (
            field.annotation,
        )  # of float | None; of a Literal it is text
        return first if isinstance(first, type) else str

    labels = ("units", "interface")  # no parameters: averages do not depend on them
    others = {"title", "sweep", "fit", "elastic", *_SECTIONS}
    known = {
        name: kind(field)
        for name, field in RunFile.model_fields.items()
        if name not in others
    }
    for name, section in _SECTIONS.items():
        if name in labels:
            continue
        fields = {
            key: field
            for key, field in section.model_fields.items()
            if key not in ("programme", "stage")
        }
        fields = {
            key: field for key, field in fields.items() if field.annotation is not bool
        }  # what is written
        known |= {f"{name}.{key}": kind(field) for key, field in fields.items()}
    return known


def parameters(file: RunFile) -> dict[str, Any]:
    """The values of all `keys()`, with the defaults of the threshold law filled in:
    equal settings, equal dicts."""
    data = file.model_dump()
    found: dict[str, Any] = {
        key: functools.reduce(_part, key.split("."), data) for key in keys(file)
    }
    for key, default in threshold_parameters(file.thresholds.law).items():
        if found[f"thresholds.{key}"] is None:
            found[f"thresholds.{key}"] = default
    return {
        key: value + 0.0 if isinstance(value, float) else value
        for key, value in found.items()
    }  # no -0.0


def _part(data: Any, name: str) -> Any:
    """The content of a section, or of a segment by its number."""
    return data[int(name)] if isinstance(data, list) else data[name]


def at(file: RunFile, changes: dict[str, Any]) -> RunFile:
    """The run file of one point of its sweep, with `changes` ("section.key": value).
    Raises InputError."""
    data = file.model_dump(exclude={"sweep", "fit"}, exclude_unset=True)
    known = keys(file)
    _without_alternatives(data, changes)
    for key, value in changes.items():
        if key not in known:
            hint = meant(key, known) or "there are " + ", ".join(
                dict.fromkeys(one.split(".")[0] for one in known)
            )
            raise InputError(
                f"{key}: is not a key that can change from point to point; {hint}"
            )
        *sections, last = key.split(".")
        place: Any = data
        for name in sections:
            place = (
                place[int(name)]
                if isinstance(place, list)
                else place.setdefault(name, {})
            )
        place[last] = value
    found = check(data)
    found._folder = file.folder
    return found


def stored(settings: dict[str, Any]) -> RunFile:
    """A run file as it was in force, from the provenance of a table, infinite rates
    included. Raises InputError."""

    def restored(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            return {key: restored(content, key) for key, content in value.items()}
        if isinstance(value, list):
            return [restored(content, name) for content in value]
        return math.inf if value == "Infinity" and name not in _FREE_TEXT else value

    return check(restored(settings))


def check(data: dict[str, Any]) -> RunFile:
    """A run file from its content. Raises InputError with one line that names the
    field."""
    for name in ("sweep", "fit"):
        _check_plain(name, data.get(name))
    try:
        file = RunFile.model_validate(data)
    except pydantic.ValidationError as error:
        raise InputError(_explain(error)) from None
    file.of_interface(), file.in_units()
    return file.heated()


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
    section, last = (
        RunFile if len(location) == 1 else _SECTIONS.get(location[0]),
        location[-1],
    )
    for name, part in (("programme", SegmentSection), ("stage", StageSection)):
        if location[:2] == ["drive", name]:
            return meant(last, part.model_fields) or "known here: " + ", ".join(
                part.model_fields
            )
    if len(location) > 1 and location[0] == "elastic":
        return meant(last, ElasticSection.model_fields) or "known here: " + ", ".join(
            ElasticSection.model_fields
        )
    here = list(section.model_fields) if section else []
    others = [(name, kind) for name, kind in _SECTIONS.items() if kind != section]
    elsewhere = [f"{name}.{key}" for name, kind in others for key in kind.model_fields]
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
