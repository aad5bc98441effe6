"""Parameters of a checked run file: the keys that may change from point to point of a
sweep, and their values."""

import json
from typing import TYPE_CHECKING, Any

from eqsim import catalogue
from eqsim.io import schema
from eqsim.laws.named import threshold_parameters

if TYPE_CHECKING:
    from eqsim.io.runfile import RunFile

# A stage, programme and blocks are there or not; averages do not depend on units and
# interface, nor on what is written.
_PARAMETERS: dict[str, type] = {
    name: key.kind
    for name, key in schema.KEYS.items()
    if key.kind in (float, int, str)
    and name != "title"
    and not name.startswith(("units.", "interface.", "drive.programme.", "population."))
    and name.rpartition(".")[0] not in schema.OPTIONAL
}


def keys(file: "RunFile | None" = None) -> dict[str, type]:
    """Every `section.key` (or top-level key) but `title`, `sweep`, `units` and
    `interface`, and the type of its values: float, int or str. Of a `file` also those
    of its programme, stage, blocks, pathways or populations, as
    drive.programme.1.hold."""
    known = dict(_PARAMETERS)
    if file is None:
        return known
    known |= _optional(file)
    for index in range(len(file["population"] or [])):
        above = f"population.{index}."
        alone: dict[str, type] = {"share": float, "stiffness": float}
        alone |= {
            name: kind
            for name, kind in _PARAMETERS.items()
            if name.partition(".")[0] in schema.OF_POPULATION
        }
        alone |= _optional(file, above)
        known |= {above + name: kind for name, kind in alone.items()}
    kinds = {n: key.kind for n, key in schema.keys_of("drive.programme").items()}
    for index, segment in enumerate(file["drive.programme"] or []):
        given = (name for name, value in segment.items() if value is not None)
        known |= {f"drive.programme.{index}.{name}": kinds[name] for name in given}
    return known


def _optional(file: "RunFile", above: str = "") -> dict[str, type]:
    """Keys of the sections that a file, or its population `above`, has or has not."""
    of_population = [name for name in schema.OPTIONAL if name.startswith("thermal.")]
    return {
        f"{section}.{name}": str if key.kind is list else key.kind
        for section in (of_population if above else schema.OPTIONAL)
        if file[above + section]
        for name, key in schema.keys_of(section).items()
    }


def parameters(file: "RunFile") -> dict[str, Any]:
    """The values of all `keys()`, lists as text, with the defaults of the threshold law
    filled in: equal settings, equal dicts."""
    found = {key: file[key] for key in keys(file)}
    for key, default in threshold_parameters(file["thresholds.law"]).items():
        if found[f"thresholds.{key}"] is None:
            found[f"thresholds.{key}"] = default
    for key, value in found.items():
        if isinstance(value, float):
            found[key] = value + 0.0  # no -0.0
        elif isinstance(value, list) and not key.endswith(".blocks"):
            found[key] = json.dumps(value)
    return found


def naming(file: "RunFile") -> dict[str, Any]:
    """The `parameters` that name a point of a sweep. Keys that came with a later
    version are among them where they differ from their defaults: points keep their
    names."""
    newer = {name for name, key in catalogue.KEYS.items() if key.since}
    return {
        key: value
        for key, value in parameters(file).items()
        if key not in newer or value != schema.KEYS[key].default
    }
