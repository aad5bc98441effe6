"""Content of TOML files: reading it, and changing keys before anything is checked."""

import copy
import functools
import re
import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

from eqsim.errors import InputError, shown
from eqsim.io import schema

_LONGEST = 10_000_000  # characters of a run file
_LONGEST_NAME = 255  # characters of the name of a file or folder
# Keys that follow from another one, if that is given.
DERIVED = {
    "thermal.kT": "thermal.temperature",
    "drive.stage.stiffness": "drive.stage.machine_stiffness",
    "drive.stage.damping": "drive.stage.radiation_damping",
}
# Keys that say the same: a change of one replaces the other.
_ALTERNATIVES = DERIVED | {"interface.normal_load": "interface.normal_stress"}
_ALTERNATIVES |= {other: key for key, other in _ALTERNATIVES.items()}


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """Text and content of a TOML file, which may be a pipe. Raises InputError."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8") from None
    if len(text) > _LONGEST:  # a device may never end
        said = f"is longer than {_LONGEST:.0e} characters"
        raise InputError(f"{path}: {said}; a run file is not")
    try:
        return text, tomllib.loads(text)
    # also numbers and nesting beyond Python's limits
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not valid TOML: {error}") from None


def put(
    data: dict[str, Any], key: str, value: Any, path: list[str] | None = None
) -> None:
    """Put the value of a `key` into the content of a TOML file, at a `path` of sections
    and numbers of segments, by default that of its name. Raises InputError."""
    *sections, last = path or key.split(".")
    place: Any = data
    for name in sections:
        if isinstance(place, dict):
            place.setdefault(name, {})
        place = _below(place, name)
        if not isinstance(place, (dict, list)):
            raise InputError(f"{key}: {name} is not a section")
    if isinstance(place, list):
        said = f"must name one of the list, as in {'.'.join(sections)}.0.{last}"
        raise InputError(f"{key}: {said}")
    place[last] = plain(value)


def plain(value: Any) -> Any:
    """A value with lists and numbers of Python in the place of NumPy's and pandas'."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple, range)):
        return list(map(plain, value))
    return value


def _below(place: Any, name: str) -> Any:
    """The content of a section or a list under a name or a number; None without any."""
    if isinstance(place, dict):
        return place.get(name)
    inside = isinstance(place, list) and name.isdecimal() and int(name) < len(place)
    return place[int(name)] if inside else None


def copied(data: dict[str, Any], without: tuple[str, ...] = ()) -> Any:
    """A copy of the content of a run file `without` some of its keys."""
    return copy.deepcopy({k: part for k, part in data.items() if k not in without})


def of_population(key: str) -> tuple[str, str]:
    """The beginning of a key that names a population, or "", and the rest."""
    found = re.match(r"population\.\d+\.", key)
    population = found[0] if found else ""
    return population, key.removeprefix(population)


def alternative(key: str) -> str | None:
    """The key that says the same as this one, in the same population; None without
    any."""
    population, bare = of_population(key)
    other = _ALTERNATIVES.get(bare)
    return other and population + other


def without_alternatives(data: dict[str, Any], changes: Collection[str]) -> None:
    """Remove each key that says the same as one of the keys that change, at the top or
    in the same population."""
    for key in changes:
        other = alternative(key)
        if other is None or other in changes:
            continue
        *sections, name = other.split(".")
        place = functools.reduce(_below, sections, data)
        if isinstance(place, dict):
            place.pop(name, None)


def with_blocks(data: dict[str, Any]) -> dict[str, Any]:
    """The content of a run file with the keys of blocks that stand in [interface], as
    they may, in [elastic]. Raises InputError for one that stands in both."""
    data, named = dict(data), schema.keys_of("elastic")
    interface, elastic = data.get("interface"), data.get("elastic") or {}
    if isinstance(interface, dict) and isinstance(elastic, dict):
        blocks = {key: interface[key] for key in interface if key in named}
        for key in blocks.keys() & elastic.keys():
            raise InputError(f"interface.{key}: stands in [elastic], too")
        if blocks:
            data["elastic"] = elastic | blocks
            data["interface"] = {k: v for k, v in interface.items() if k not in named}
    if isinstance(sweep := data.get("sweep"), dict):
        data["sweep"] = _axes_of_blocks(sweep)
    return data


def of_blocks(key: str) -> str:
    """The key in [elastic] of one of blocks that stands in [interface]; else the key."""
    section, _, name = key.partition(".")
    moved = section == "interface" and name in schema.keys_of("elastic")
    return f"elastic.{name}" if moved else key


def _axes_of_blocks(sweep: Any) -> Any:
    """The content of [sweep], or of its `zip`, with axes over keys `of_blocks`."""
    if isinstance(sweep, list):
        return [_axes_of_blocks(group) for group in sweep]
    if not isinstance(sweep, dict):
        return sweep
    found: dict[str, Any] = {}
    for key, value in sweep.items():
        if key == "interface" and isinstance(value, dict):  # of keys without quotes
            found |= _axes_of_blocks({f"{key}.{name}": x for name, x in value.items()})
        else:
            found[of_blocks(key)] = _axes_of_blocks(value) if key == "zip" else value
    return found


def path_of(field: str, folder: Path, name: str) -> Path:
    """The path of a file that a key names. Raises InputError for what is no name."""
    if not name.strip() or max(map(len, Path(name).parts), default=0) > _LONGEST_NAME:
        raise InputError(f"{field} = {shown(name)}: must be the name of a file")
    return folder / name
