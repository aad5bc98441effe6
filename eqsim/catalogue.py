"""The catalogue: each key of a run file and each column of a table of results, once.

The entries stand in `catalogue.toml`, with words, symbol, dimension and meaning. Labels
of axes, comments of exported tables, units, symmetries of fits and the documentation
read them here. Which keys a section has, with their types and defaults, are the fields
of the model's dataclasses (`eqsim.io.runfile`).
"""

import math
import re
import tomllib
from pathlib import Path
from typing import NamedTuple


class Dimension(NamedTuple):
    """Powers of length, time and force."""

    length: int = 0
    time: int = 0
    force: int = 0


def dimension(text: str) -> Dimension:
    """The dimension that a text such as "force time/length^2" or "1/time" names."""
    powers = dict.fromkeys(Dimension._fields, 0)
    for part, sign in zip(text.split("/"), (1, -1), strict=False):
        for name, power in re.findall(r"([a-z]+)(?:\^(\d))?", part):
            powers[name] += sign * int(power or 1)
    return Dimension(**powers)


def product(factors: list[tuple[str, int]], times: str = " ", per: str = "/") -> str:
    """Names to their powers, such as "nN s/m^2" or "1/s"; "" without any."""
    texts = [(f"{name}^{abs(n)}" if abs(n) > 1 else name, n) for name, n in factors]
    above = times.join(text for text, power in texts if power > 0)
    below = "".join(per + text for text, power in texts if power < 0)
    return (above or "1" * bool(below)) + below


NUMBER = Dimension()
LENGTH = dimension("length")
TIME = dimension("time")
FORCE = dimension("force")
RATE = dimension("1/time")
VELOCITY = dimension("length/time")
ENERGY = dimension("force length")
STRESS = dimension("force/length^2")
AREA = dimension("length^2")


class Entry(NamedTuple):
    """A key or a column; what it does not have is "". `default` and `values` are those
    of the documentation, where the program's own default and type say too little."""

    words: str = ""  # what pictures call it
    symbol: str = ""  # in mathtext
    dimension: Dimension = NUMBER  # of its unit
    fixed_unit: str = ""  # its unit, if it is always the same
    meaning: str = ""  # in full, for the documentation (Markdown) and exported tables
    default: str = ""
    values: str = ""
    since: str = ""  # the version with which a key came, if that was after 0.1

    @property
    def mathtext(self) -> str:
        """Words and symbol as in pictures."""
        return f"{self.words}  {self.symbol}".strip()

    @property
    def label(self) -> str:
        """Words and symbol in plain text."""
        text = re.sub(r"\\mathrm\{(\w+)\}", r"\1", self.mathtext.replace("$", ""))
        return text.replace(r"\langle ", "<").replace(r" \rangle", ">")

    @property
    def unit(self) -> str:
        """The dimension of an average: "length", "length^2", or "" for a number."""
        return {LENGTH: "length", AREA: "length^2"}.get(self.dimension, "")

    def size(self, unit: float) -> float:
        """One of it where lengths are in units of `unit`."""
        return math.prod((unit,) * self.dimension.length)


def _entry(known: dict[str, str]) -> Entry:
    others = {name: text for name, text in known.items() if name != "dimension"}
    return Entry(dimension=dimension(known.get("dimension", "")), **others)


_FILE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
# Heading, if it is not the name, and introduction of each section in the documentation.
SECTIONS: dict[str, dict[str, str]] = _FILE["sections"]
KEYS = {name: _entry(known) for name, known in _FILE["keys"].items()}
COLUMNS = {name: _entry(known) for name, known in _FILE["columns"].items()}


def entry(name: str) -> Entry | None:
    """The entry of a key or a column, if it has one; words of those of a segment, as
    drive.programme.1.hold and segment_1_peak, or a population say which."""
    physical = "(?:_(friction_force|friction_coefficient|shear_stress))?"
    if found := re.fullmatch(rf"segment_(\d+)_(\w+?){physical}", name):
        known = COLUMNS.get(f"segment.{found[2]}")
        measure = COLUMNS.get(found[3] or "")
        if known and measure:
            words = f"{known.words}, {measure.words}"
            known = measure._replace(words=words, meaning="")
        return known and known._replace(words=f"segment {found[1]}: {known.words}")
    if found := re.fullmatch(r"drive\.programme\.(\d+)\.(\w+)", name):
        known = KEYS.get(f"drive.programme.{found[2]}")
        return known and known._replace(words=f"{known.words} of segment {found[1]}")
    if found := re.fullmatch(r"population\.(\d+)\.(.+)", name):
        known = KEYS.get(f"population.{found[2]}") or KEYS.get(found[2])
        return known and known._replace(words=f"{known.words} of population {found[1]}")
    return KEYS.get(name) or COLUMNS.get(name)
