"""Run files: TOML in, an Ensemble and a Drive out.

Names and types of keys are those of `eqsim.io.schema`. Here sections become the model's
dataclasses, which refuse values out of range, and keys that do not go together are
refused.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from eqsim import catalogue
from eqsim.errors import (
    POSITIVE,
    InputError,
    meant,
    require_integer,
    require_number,
    shown,
    under,
)
from eqsim.estimate import Averages, Estimate
from eqsim.io import csv, schema
from eqsim.io.content import (
    copied,
    of_blocks,
    path_of,
    plain,
    put,
    read_toml,
    with_blocks,
    without_alternatives,
)
from eqsim.io.course import PULLS, programme_of, recorded_drive, require_use
from eqsim.io.labels import described
from eqsim.io.parameters import keys
from eqsim.io.tables import read_thresholds
from eqsim.io.units import (
    Interface,
    Quantity,
    Row,
    Units,
    over_contacts,
    quantities,
    rows_of,
)
from eqsim.laws.aging import RULES, Aging
from eqsim.laws.delay import Delay
from eqsim.laws.named import law_of, threshold_parameters
from eqsim.laws.newborn import LAWS, Newborn
from eqsim.laws.thermal import Pathway, Thermal
from eqsim.laws.threshold import Table, ThresholdLaw
from eqsim.laws.viscosity import Viscosity
from eqsim.model.chain import Chain
from eqsim.model.drive import Drive, Output, Programme, require_drive
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble, Population
from eqsim.results import Listed

Section = TypeVar("Section")
# Keys whose text may be any word, also "Infinity".
_FREE_TEXT = ("title", "file", "column")
# What of a stage is given for the machine: the key that follows, and per what it is.
_MACHINE = {
    "machine_stiffness": ("stiffness", catalogue.LENGTH),
    "radiation_damping": ("damping", catalogue.VELOCITY),
}
# Keys of a drive that change nothing with these values.
_IDLE = {"stall_force": math.inf, "rebinding": "unstretched"}


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
    repeats : bool
        True of one that was in force before, in which units in files are passed over.
    """

    given: dict[str, Any] = field(compare=False)
    settings: dict[str, Any] = field(repr=False)
    text: str = field(default="", repr=False, compare=False)
    folder: Path = field(default=Path(), repr=False, compare=False)
    repeats: bool = field(default=False, repr=False, compare=False)
    unlisted: ClassVar[tuple[str, ...]] = (
        *("constant_drive", "driven_by", "headline", "physical"),
        *("preferred", "pulled", "quantities_in", "repeats", "rows"),
        "sweep_settings",
    )

    def __getitem__(self, key: str) -> Any:
        """The value of a "section.key", or its default; None if it has none."""
        found: Any = self.settings
        for name in key.split("."):
            found = found[int(name) if isinstance(found, list) else name]
        return found

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

    def _made(self, kind: Callable[..., Section], name: str, **more: Any) -> Section:
        """The dataclass of a section, with `more` of its fields. Raises InputError."""
        with under(name):
            return kind(**self.settings[name] | more)

    @cached_property
    def units(self) -> Units:
        """The units of its numbers. Raises InputError."""
        law, varied = self["thresholds.law"], repr((self.sweep, self.fit))
        x_star = threshold_parameters(law).get("x_star") if law != "table" else None
        bond = self["thermal.off_rate"] is not None or self["thermal.slip"]
        omega = None if bond else self["thermal.attempt_frequency"]
        keys = {
            "x_*": ("x_star", self["thresholds.x_star"] or x_star),
            "omega": ("attempt_frequency", omega),
            "k": ("stiffness", self["contacts.stiffness"]),
        }
        several = "file" in self.sweep or self["population"]
        natural = tuple(
            symbol
            for symbol, (key, value) in keys.items()
            if value == 1.0 and key not in varied and not several
        )
        return self._made(Units, "units", natural=natural)

    @cached_property
    def interface(self) -> Interface:
        """The interface that the contacts stand for. Raises InputError."""
        return self._made(Interface, "interface")

    @cached_property
    def output(self) -> Output:
        """The recording of a run. Raises InputError."""
        output = self._made(Output, "output")
        for name in ("series", "breaks"):
            if getattr(output, name) and self["elastic"]:
                said = "not with [elastic], which writes every block and avalanche"
                raise InputError(f"output.{name}: {said}")
        if output.breaks and self.driven_by:
            said = "breaks are listed at a constant drive.velocity only"
            raise InputError(f"output.breaks: {said}")
        return output

    @property
    def driven_by(self) -> list[str]:
        """The keys of [drive] that make it another drive than one at `drive.velocity`
        over `drive.distance`."""
        usual = ("velocity", "distance", "start")
        given = {key: x for key, x in self["drive"].items() if key not in usual}
        return [key for key, x in given.items() if x not in (None, _IDLE.get(key))]

    @property
    def pulled(self) -> bool:
        """True if a stage, force, motor or blocks in time move the slider."""
        if isinstance(self.blocks, Chain):
            return True
        given = set(self.driven_by)
        for part in self["drive.programme"] or ():
            given |= {name for name in PULLS if part[name] is not None}
        return not given.isdisjoint(("stage", "stall_force", *PULLS))

    @cached_property
    def ensemble(self) -> Ensemble:
        """The contacts. Raises InputError."""
        alone, kinds = self._contacts(), []
        for index, given in enumerate(self["population"] or []):
            with under(f"population.{index}"):
                require_number("stiffness", given["stiffness"], **POSITIVE)
                kind = population_alone(self, index)._contacts()
                laws = {name: getattr(kind, name) for name in schema.OF_POPULATION}
                kinds.append(Population(given["share"], kind.stiffness, **laws))
        return replace(alone, populations=kinds)

    def _contacts(self) -> Ensemble:
        """The contacts of one kind that the keys at the top say. Raises InputError."""
        alone = replace(self._made(Ensemble, "contacts"), disorder=self["disorder"])
        heat = {k: v for k, v in self["thermal"].items() if k != "temperature"}
        for name in ("catch", "slip"):
            heat[name] = heat[name] and Pathway(**heat[name])
        with under("thermal"):
            thermal = Thermal(**heat)
        delay, law = self._made(Delay, "delay"), self._threshold_law()
        # contacts that do not age, or are born unstressed, would be a surprise
        _require_law("aging.rule", self.given, (*RULES, "none"))
        with under("aging"):
            aging = Aging.of_keys(self["aging"], set(self.given.get("aging", ())))
            aging.check(law, alone.disorder)
        with under("viscosity"):
            drag = dict(self["viscosity"])
            alone = replace(alone, eta=drag.pop("eta"), viscosity=Viscosity(**drag))
        _require_law("newborn.law", self.given, (*LAWS, "unstressed"))
        newborn = self._made(Newborn, "newborn")
        with under("newborn"):
            newborn.check(law, alone.disorder, aging.active)
        laws: dict[str, Any] = {"thresholds": law, "thermal": thermal, "delay": delay}
        return replace(alone, **laws, aging=aging, newborn=newborn)

    def _threshold_law(self) -> ThresholdLaw:
        given = {k: v for k, v in self["thresholds"].items() if v is not None}
        law, tabled = given.pop("law"), ("file", "column", "scale", "quantity")
        allowed = tabled if law == "table" else threshold_parameters(law)
        for key, value in given.items():
            if key not in allowed:
                said = f'not allowed with law = "{law}"'
                raise InputError(f"thresholds.{key} = {shown(value)}: {said}")
        if law != "table":
            with under("thresholds"):
                return law_of(law, given)
        if "file" not in given:
            raise InputError('thresholds.file: is required with law = "table"')
        scale = given.get("scale", 1.0)
        require_number("thresholds.scale", scale, **POSITIVE)
        path = path_of("thresholds.file", self.folder, given["file"])
        forces = given.get("quantity") == "force"
        compared = not self.repeats and "scale" not in given
        unit = (self.units.force if forces else self.units.length) if compared else ""
        found = read_thresholds(path, given.get("column"), scale, unit)
        if not forces:
            return found
        contacts = self._made(Ensemble, "contacts")
        force = found.steps  # f = k_i xi, with k_i = k sqrt(f/<f>) under the sqrt law
        uniform = contacts.stiffness_law == "uniform"
        stretch = force if uniform else np.sqrt(force * force.mean())
        with under("thresholds"):
            return Table(stretch / contacts.stiffness)

    @cached_property
    def drive(self) -> Drive | Programme:
        """The drive of the slider. Raises InputError."""
        given, blocks = self["drive"], self.blocks
        if self.driven_by or isinstance(blocks, Chain):
            return programme_of(self)
        if given["velocity"] is None:
            raise InputError("drive.velocity: is required")
        with under("drive"):
            return Drive(given["velocity"], given["distance"], given["start"], blocks)

    @cached_property
    def blocks(self) -> Elastic | None:
        """The coupled blocks, a `Chain` if they move in time. Raises InputError."""
        given = self["elastic"]
        if given is None:
            return None
        with under("elastic"):
            if given["mass"] or given["damping"]:
                return Chain(**given)
            if given["bulk_damping"]:
                said = "needs a mass or a damping of each block"
                raise InputError(f"bulk_damping: {said}")
            names = (field.name for field in fields(Elastic))
            return Elastic(**{name: given[name] for name in names})

    @property
    def constant_drive(self) -> Drive:
        """The drive, if it has a constant velocity. Raises InputError."""
        return require_drive(self.drive)

    @property
    def said(self) -> list[str]:
        """How drive.file was read, where drive.record says how. Raises InputError."""
        if self["drive.record"] is None:
            return []
        return [f"drive.file: {', '.join(recorded_drive(self).said)}"]

    def with_changes(self, changes: dict[str, Any]) -> "RunFile":
        """The run file of one point, without [sweep] and [fit]; `changes` are values by
        "section.key", {"thermal.kT": 0.1}. Raises InputError for a key that there is
        not, and a value that has not its type."""
        data, known = copied(self.given, without=("sweep", "fit")), keys(self)
        changes = {of_blocks(key): value for key, value in changes.items()}
        without_alternatives(data, changes)
        for key, value in changes.items():
            if key not in known:
                first = dict.fromkeys(one.split(".")[0] for one in known)
                hint = meant(key, known) or "there are " + ", ".join(first)
                said = "is not a key that can change from point to point"
                raise InputError(f"{key}: {said}; {hint}")
            put(data, key, value)
        return check(data, self.folder, self.repeats)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Friction as a force, a shear stress and a coefficient, if known."""
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

    def sweep_settings(self) -> dict[str, Any]:
        """Settings of which `stored` makes every point of a sweep again. Populations
        and loads are as given: what the ones inherit, and how many the others are,
        follows from keys that may differ from point to point."""
        settings, elastic = dict(self.settings), self.given.get("elastic", {})
        if "population" in self.given:
            settings["population"] = self.given["population"]
        if "load" in elastic:
            settings["elastic"] = settings["elastic"] | {"load": elastic["load"]}
        return settings

    def headline(self, name: str) -> str:
        """The title of a table, or `name` without one, and what is simulated."""
        return f"{self.title or name}: {described(self.ensemble, self.units)}"

    def preferred(self, friction: Estimate) -> Quantity | None:
        """The coefficient, or else the stress or the force, in a unit fit for
        `friction`; None if none is known."""
        found = self.quantities
        return found[-1].near(friction.value or 0.0) if found else None

    def rows(self, averages: Averages) -> list[tuple[str, Row]]:
        """Rows of a table of averages (`units.rows_of`)."""
        return rows_of(averages, self.units, self.quantities)


def population_alone(file: RunFile, index: int) -> RunFile:
    """The run file of one population alone. Raises InputError."""
    data = copied(file.given, without=("population", "sweep", "fit"))
    for name, given in file.given["population"][index].items():
        if name == "stiffness":
            data.setdefault("contacts", {})[name] = given
        elif name != "share":
            without_alternatives(data, [f"{name}.{key}" for key in given])
            alone = given.keys() & {"law", "rule", "barrier"}
            data[name] = given if alone else data.get(name, {}) | given
    return check(data, file.folder, file.repeats)


def _require_law(key: str, given: dict[str, Any], laws: tuple[str, ...]) -> None:
    """Raise InputError if a section has keys, but not the one that names its law."""
    section, name = key.split(".")
    there = given.get(section) or {}
    if there and name not in there:
        *more, last = (f'"{law}"' for law in laws)
        allowed = f"{', '.join(more)} or {last}"
        raise InputError(f"{key}: is required with {min(there)}; must be {allowed}")


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
    without_alternatives(data, changes)
    for key, value in changes.items():
        axes, axis = data.get("sweep", {}), key.removeprefix("sweep.")
        first = axis.split(".")[0]
        nested = not isinstance(axes, dict) or isinstance(axes.get(first), dict)
        quoted = axis != key and not nested and first not in ("zip", "file")
        put(data, key, value, ["sweep", axis] if quoted else None)
    text += "".join(
        f"# --set {key}={plain(value)!r}\n" for key, value in changes.items()
    )
    file = check(data, folder)
    if "drive.velocity" in changes and not file.sweep:
        require_use(file)
    return replace(file, text=text)


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


at = RunFile.with_changes


def stored(settings: dict[str, Any], folder: Path | str = "") -> RunFile:
    """A run file as it was in force, from the provenance of a table, infinite rates
    included. Raises InputError."""

    def restored(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            named = value.get("rule") if name == "aging" else None  # a list in [sweep]
            rule = RULES.get(named) if isinstance(named, str) else None
            usual = {one.name: one.default for one in fields(Aging)} if rule else {}
            for key in ("rule", *rule.keys) if rule else ():
                usual.pop(key, None)
            # keys of other rules of aging are stored with their defaults
            kept = (one for one in value.items() if usual.get(one[0], ...) != one[1])
            return {key: restored(content, key) for key, content in kept}
        if isinstance(value, list):
            return [restored(content, name) for content in value]
        return math.inf if value == "Infinity" and name not in _FREE_TEXT else value

    return check(restored(settings), Path(folder), repeats=True)


def check(
    data: dict[str, Any], folder: Path = Path(), repeats: bool = False
) -> RunFile:
    """A run file from its content; paths in it start in `folder`. Raises InputError
    with one line that names the field."""
    data = with_blocks(data)
    content = schema.validated(data)
    given = content.model_dump(exclude_unset=True, exclude_none=True)
    given |= {name: data[name] for name in ("sweep", "fit") if data.get(name)}
    file = RunFile(given, content.model_dump(), folder=folder, repeats=repeats)
    _heat(file)
    _ = file.units, file.interface, file.output
    _load(file)
    for index, population in enumerate(file.settings["population"] or []):
        with under(f"population.{index}"):
            merged = population_alone(file, index).settings
        population |= {name: merged[name] for name in schema.OF_POPULATION}
        population["stiffness"] = merged["contacts"]["stiffness"]
    _stage(file)
    return file


def _load(file: RunFile) -> None:
    """Put the numbers of elastic.load, which may be a file or the first and the last of
    them, in its place. Raises InputError."""
    given = file.settings["elastic"]
    load = given["load"] if given else None
    if isinstance(load, str):
        where = f"elastic.load = {load}"
        sheet = csv.read(path_of("elastic.load", file.folder, load), where)
        sheet.require_names()  # "1,5" is no pair of loads
        sheet = sheet.whole
        load = csv.numbers(sheet, sheet.columns[:1], strict=True).values[:, 0].tolist()
    elif isinstance(load, dict):
        if load.keys() != {"first", "last"}:
            raise InputError("elastic.load: a table has `first` and `last`")
        for name, value in load.items():
            require_number(f"elastic.load.{name}", value, **POSITIVE)
        require_integer("elastic.blocks", given["blocks"], 1, 10**7)
        load = np.linspace(load["first"], load["last"], given["blocks"]).tolist()
    if load is not None:
        given["load"] = load


def _heat(file: RunFile) -> None:
    """Put in the kT that belongs to thermal.temperature, if that is given: it is not
    itself given, and follows where the temperature changes. Raises InputError."""
    thermal = file.settings["thermal"]
    if thermal["temperature"] is None:
        return
    with under("thermal"):
        thermal["kT"] = kT = file.units.energy(thermal["temperature"])
        before = file.given["thermal"].pop("kT", kT)
        # what was in force is read again with both
        if not math.isclose(before, kT, rel_tol=1e-12, abs_tol=0.0):
            given = f"temperature = {shown(thermal['temperature'])}"
            raise InputError(f"{given}: not allowed with kT; give one of them")


def _stage(file: RunFile) -> None:
    """Put in the stiffness and damping of a stage that follow from those of its
    machine, as `_heat` does. Raises InputError."""
    stage = file.settings["drive"]["stage"]
    for name, (other, per) in _MACHINE.items() if stage else ():
        text = stage[name]
        if text is None:
            continue
        try:
            value = over_contacts(text, per, file.units, file.quantities)
            before = file.given["drive"]["stage"].pop(other, value)
            if not math.isclose(before, value, rel_tol=1e-12, abs_tol=0.0):
                raise InputError(f"not allowed with {other}; give one of them")
        except InputError as error:
            raise InputError(f"drive.stage.{name} = {shown(text)}: {error}") from None
        stage[other] = value
    if stage and stage["stiffness"] is None:
        raise InputError("drive.stage.stiffness: is required")


def contents_of(file: RunFile, more: Collection[str] = ()) -> dict[str, bytes]:
    """Contents of the files of thresholds and drives that a run file names, and of some
    `more`, by name. Raises InputError for one that cannot be read."""
    names = [file["thresholds.file"], file["drive.file"]]
    names += [x["thresholds"]["file"] for x in file["population"] or []]
    names += more
    try:
        return {name: (file.folder / name).read_bytes() for name in names if name}
    except OSError as error:
        said = f"cannot be read ({error.strerror})"
        raise InputError(f"{error.filename}: {said}") from None
