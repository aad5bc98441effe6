"""The command that writes a first run file: new."""

import json
import os
import tomllib
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from eqsim.catalogue import FORCE, LENGTH, dimension
from eqsim.cli.options import Shown
from eqsim.errors import InputError
from eqsim.lazy import lazily

with lazily():
    from eqsim.io import csv, runfile, storage, units

_FILE = "The run file to be written; none is overwritten."
_STRENGTHS = "CSV file of measured thresholds: stretches, or forces in a unit of force."
_COLUMN = "Its column; by default the first one."
_STIFFNESS = "Of one contact, with its unit."
_MICROMETRE, _MILLINEWTON = 1e-6, 1e-3
_TEXT = """\
# `eqsim keys SECTION` says what else a section may hold.
title = {title}

[units]                  # of all numbers below
length = "um"
time = "s"
force = "mN"

[contacts]
count = 10_000           # more give smaller error bars
stiffness = {stiffness}
stiffness_law = "uniform" # "sqrt": strong contacts are stiffer

[thresholds]
{thresholds}

[thermal]
# temperature = 295      # kelvin; heat matters if kT is not far below k x_*^2
# attempt_frequency = 1e9 # 1/s

[delay]
time = 0.0               # s, from a break to the next contact

[drive]
velocity = 1.0           # um/s
# distance = 100.0       # um; by default 200 mean thresholds

# [drive.stage]
# machine_stiffness = "50 N/mm" # of the spring between drive and slider

[output]
seed = 1
"""
_GAMMA = """\
law = "gamma"            # x^(2n+1) exp(-x^2/x_*^2)
n = 1.0
x_star = 1.0             # um, where a contact breaks"""


def new(
    path: Annotated[Path, Argument(metavar="MINE.toml", help=_FILE)],
    thresholds: Annotated[Path | None, Option(help=_STRENGTHS)] = None,
    column: Annotated[str | None, Option(help=_COLUMN)] = None,
    stiffness: Annotated[
        str | None, Option(metavar='"2 N/mm"', help=_STIFFNESS)
    ] = None,
    *,
    shown: Shown,
) -> None:
    """Write a run file with comments, of your own thresholds if there are any."""
    if path.suffix != ".toml":
        raise InputError(f"{path}: must end in .toml")
    if path.exists():
        raise InputError(f"{path}: is there already")
    if column is not None and thresholds is None:
        raise InputError(f"--column {column}: is for the file of --thresholds")
    given = "1.0          # mN/um, assumed"
    if stiffness is not None:
        value, of = units.measured(stiffness) or (0.0, LENGTH)
        if of != dimension("force/length") or not value > 0:
            said = 'must be a stiffness with its unit, such as "2 N/mm"'
            raise InputError(f"--stiffness {stiffness}: {said}")
        given = f"{value * _MICROMETRE / _MILLINEWTON:<13.6g}# mN/um"
    law = _GAMMA if thresholds is None else _law(thresholds, column, path.parent)
    text = _TEXT.format(title=_quoted(path.stem), stiffness=given, thresholds=law)
    data = tomllib.loads(text)
    if thresholds is not None:  # the folder may not be there yet, to go up from
        data["thresholds"]["file"] = str(thresholds)
    _ = runfile.check(data).ensemble  # a file that cannot be used is none
    storage.publish(path.parent, {path.name: text.encode()}, str(path))
    shown.report({"file": str(path)}, notes=[f"{path}; next: eqsim run {path}"])


def _law(path: Path, column: str | None, folder: Path) -> str:
    """The section of measured thresholds, with the unit in the name of the column or in
    a row of units."""
    sheet = csv.read(path, f"--thresholds {path}")
    index = sheet.index(column) if column else 0
    name = sheet.columns[index]
    sheet.require_names()
    unit = sheet.unit(index)
    found = units.measured(f"1 {unit}") if unit else (0.0, LENGTH)
    if found is None or found[1] not in (LENGTH, FORCE):
        said = f'column "{name}" must be a length or a force, as in nm or mN'
        raise InputError(f'--thresholds {path}: {said}; its unit is "{unit}"')
    value, of = found
    quantity = "force" if of == FORCE else "stretch"
    ours = "mN" if of == FORCE else "um"
    scale = value / (_MILLINEWTON if of == FORCE else _MICROMETRE) if value else 1.0
    # resolved, as ".." after a link leads elsewhere
    where = path if path.is_absolute() else path.resolve()
    if not path.is_absolute() and where.anchor == folder.resolve().anchor:
        where = Path(os.path.relpath(where, folder.resolve()))
    lines = ['law = "table"', f"file = {_quoted(where.as_posix())}"]
    if not sheet.headless:
        lines.append(f"column = {_quoted(name)}")
    lines.append(f'quantity = "{quantity}"')
    told = "" if value else ", assumed: its column names no unit"
    return "\n".join([*lines, f"scale = {scale:.6g}  # to {ours}{told}"])


def _quoted(text: str) -> str:
    """A text in TOML. Raises InputError for one that is not printable."""
    if not text.isprintable():
        raise InputError(f"{text!r}: must be printable, to stand in a run file")
    return json.dumps(text, ensure_ascii=False)
