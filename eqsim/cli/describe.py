"""Commands about the meaning of parameters: info, keys, material."""

import os
import re
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from eqsim import catalogue
from eqsim.cli.options import Changes, RunFilePath, Shown, Threads, cores
from eqsim.errors import InputError, meant, require_choice
from eqsim.errors import shown as short
from eqsim.io import terminal
from eqsim.lazy import lazily
from eqsim.paper import NOTE

with lazily():
    from eqsim import materials
    from eqsim.engine import elastic, trajectory
    from eqsim.io import content, schema, surface, units
    from eqsim.model import groups

_PRESETS = '"steel", "octamethylcyclotetrasiloxane" ("omcts")'
_NAME = f"{_PRESETS}, or MINE.toml, a file of constants."
_CONSTANT = "Change a constant, or give those of a material of kind rough or islands; repeatable."
_AT_KELVIN = "In kelvin. Default: 289.7, where kT = 4e-21 J as in the paper."
_RUN_VELOCITY = (
    "Velocity of the run file, m/s. Default: v_* at 289.7 K, at any temperature."
)
_DISORDER = 'Disorder of the run file. Default: "quenched".'
_NO_WALLS = "no elastic correlation length a^2 E/k: E of the walls is not given"
_SetConstant = Option("--set", metavar="KEY=VALUE", help=_CONSTANT)


def info(
    path: RunFilePath, changes: Changes, threads: Threads = None, *, shown: Shown
) -> None:
    """Dimensionless groups and regime of a run file, without simulating it."""
    file = changes.load(path)
    cores(threads)
    ensemble, drive = file.ensemble, file.drive
    found = groups.groups(ensemble, drive)
    predicted = trajectory.predicted_lives
    if drive.elastic:
        predicted = elastic.expected_lives
    lives = predicted(ensemble, drive, file.output.replicas)
    found += units.scales(ensemble, file.units, file.interface)
    stage = file["drive.stage"]
    if stage and (machine := surface.machine_stiffness(file, stage["stiffness"])):
        found.append(groups.Group("K", machine, "stiffness of the machine"))
    shown.doubt(file, drive)
    texts = (x.value if isinstance(x.value, str) else f"{x.value:.6g}" for x in found)
    rows = [(g.name, text, g.meaning) for g, text in zip(found, texts, strict=True)]
    shown.report(
        {**{group.name: group.value for group in found}, "lives": lives},
        title=file.headline(path.stem),
        columns=("group", "value", "meaning"),
        rows=[*rows, ("lives", terminal.count(lives), "predicted for `eqsim run`")],
        notes=[NOTE],
    )


_SECTION_OR_KEY = "A section, such as thermal; or one key, thermal.kT."
_SECTION = Argument(metavar="[SECTION|KEY]", help=_SECTION_OR_KEY)


def keys(name: Annotated[str | None, _SECTION] = None, *, shown: Shown) -> None:
    """Sections of a run file, or the keys of one: defaults, values and meanings."""
    sections = catalogue.SECTIONS
    if name is None:
        told = {
            f"[{name}]" * bool(name): about["about"] for name, about in sections.items()
        }
        told = {name: _in_plain_text(about) for name, about in told.items()}
        notes = ["`eqsim keys SECTION` lists the keys of a section"]
        columns = "section", "meaning"
        shown.report(told, columns=columns, rows=told.items(), notes=notes)
        return
    name = name.strip("[]")
    section, _, last = (name, "", "") if name in sections else name.rpartition(".")
    listed = schema.rows_of(section) if section in sections else []
    listed = [row for row in listed if row.key == last or not last]
    if not listed:
        known = [*filter(None, sections), *schema.KEYS]
        nearest = meant(name, known) or "known are " + ", ".join(filter(None, sections))
        raise InputError(f"{name}: is no section or key of a run file; {nearest}")
    plain = [schema.KeyRow(*map(_in_plain_text, row)) for row in listed]
    shown.report(
        {row.key: row._asdict() for row in plain},
        title=_in_plain_text(sections[section]["about"]),
        columns=schema.KeyRow._fields,
        rows=plain,
    )


def _in_plain_text(markdown: str) -> str:
    """A line of the documentation without its links and marks."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", markdown)
    text = re.sub(r"; see [^.]*", "", text)
    text = re.sub(r"\\text\{(\w+)\}", r"\1", text).replace(r"\propto", " ~ ")
    text = re.sub(r"\\sqrt\{((?:[^{}]|\{[^{}]*\})*)\}", r" sqrt(\1)", text)
    text = re.sub(r"\\ln(?=\\)", " ln ", text).replace(r"\ln", " ln")
    return re.sub(" +", " ", re.sub(r"[`$\\]", "", text))


def material(
    name: Annotated[str, Argument(metavar="NAME", help=_NAME)],
    temperature: Annotated[float | None, Option(help=_AT_KELVIN)] = None,
    toml: Annotated[bool, Option("--toml", help="Print a run file instead.")] = False,
    disorder: Annotated[str | None, Option(help=_DISORDER)] = None,
    velocity: Annotated[float | None, Option(help=_RUN_VELOCITY)] = None,
    set_: Annotated[list[str] | None, _SetConstant] = None,
    *,
    shown: Shown,
) -> None:
    """SI parameters of a real interface, from its material constants."""
    changes = {key: value for key, (value, _) in Changes(set_).given().items()}
    found = _material(name, changes)
    kelvin = materials.ROOM_TEMPERATURE if temperature is None else temperature
    if toml:
        if shown.json:
            raise InputError("--toml: prints a run file, which cannot be JSON (--json)")
        kind: Any = disorder or "quenched"
        require_choice("--disorder", kind, ("quenched", "annealed"))
        text = materials.run_file_text(found, kelvin, velocity, disorder=kind)
        shown.report(None, notes=[text.removesuffix("\n")])
        return
    for option, value in (("--disorder", disorder), ("--velocity", velocity)):
        if value is not None:
            said = "is for the run file that --toml prints"
            raise InputError(f"{option} {value}: {said}")
    rows = materials.parameters(found, kelvin)
    shown.report(
        {row.name: row.value for row in rows},
        title=f"{found.name} at {kelvin:.4g} K",
        columns=("", "value", "unit", "meaning"),
        rows=[(row.name, f"{row.value:.5g}", row.unit, row.meaning) for row in rows],
        notes=[*([] if found.elastic_length else [_NO_WALLS]), NOTE],
    )


def _material(name: str, changes: dict[str, Any]) -> "materials.Material":
    """A preset, a material of a TOML file, or of `changes` alone. Raises InputError."""
    known = materials.preset(name)
    if known is not None:
        constants = materials.constants_of(known)
        changed = [f"{key} = {value}" for key, value in changes.items()]
        constants["name"] = ", ".join([known.name, *changed])
    elif name.lower() in materials.KINDS:
        constants = {"kind": name.lower()}
    elif name.lower().endswith(".toml") or os.path.lexists(name):
        _, constants = content.read_toml(Path(name))
    else:
        kinds = " or ".join(f'"{kind}"' for kind in materials.KINDS)
        given = f"{_PRESETS}, a TOML file of constants, or {kinds}"
        said = f"must be {given} with all of them as --set KEY=VALUE"
        raise InputError(f"NAME = {short(name)}: {said}")
    for key, value in changes.items():
        content.put(constants, key, value)
    return materials.from_constants(constants, Path(name).stem)
