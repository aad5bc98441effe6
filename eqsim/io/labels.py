"""Labels of pictures and tables for keys, observables and ensembles, in the units of a
run file."""

import math
import re
from typing import Any

from eqsim import catalogue
from eqsim.catalogue import LENGTH, NUMBER, STRESS, Dimension
from eqsim.estimate import OBSERVABLES
from eqsim.io.units import Units
from eqsim.laws.barrier import BARRIERS
from eqsim.model.ensemble import Ensemble

FORCE = catalogue.COLUMNS["force"].mathtext
_FREE = "unit of the run file"
# What a suffix of a column adds to its name, and whether it has the unit of the column;
# the longer of two first.
_SUFFIXES = {
    "_reference_error": ("bound of the error of the reference", True),
    "_reference": ("exact value", True),
    "_replica_std": ("standard deviation between replicas", True),
    "_stderr": ("statistical standard error", True),
    "_error": ("bound of the error of a numerical solution", True),
    "_dof": ("degrees of freedom of the standard error, none: normal", False),
    "_reliable": ("whether the standard error can be trusted", False),
    "_z": ("difference from the reference in standard errors", False),
}


def column(name: str, units: Units, fractions: bool = False) -> tuple[str, str]:
    """Words and unit of a column of a table of results, in the units of the run file;
    `fractions`: whether stretches of the newborn are fractions of their thresholds.

    Words are "" of a key of a run file, whose name says it. The unit is such as "um/s",
    or "length/time" where units are not given; "" of a number and what is not known."""
    for suffix, (text, same) in _SUFFIXES.items():
        if name.endswith(suffix):
            _, unit = column(name.removesuffix(suffix), units, fractions)
            return text, unit if same else ""
    entry = catalogue.entry(name)
    if entry is None:
        return "", ""
    words = entry.meaning or (entry.label if name in OBSERVABLES else entry.words)
    numbered = name.startswith(("drive.programme.", "population."))
    words = "" if numbered or name in catalogue.KEYS else " ".join(words.split())
    if entry.fixed_unit or (fractions and _is_fraction(name)):
        return words, entry.fixed_unit
    if entry.dimension == STRESS and units.size(STRESS) is not None:
        return words, "Pa"  # `units.quantities`
    parts = ("length", "time", "force")
    known: dict[str, Any] = {part: getattr(units, part) or part for part in parts}
    return words, Units(**known).label(entry.dimension)


def _is_fraction(name: str) -> bool:
    """True for a key that may be a stretch of newborn contacts over their threshold."""
    return name.startswith("newborn.") and catalogue.KEYS[name].dimension == LENGTH


def unit_text(units: Units, of: Dimension, unknown: bool = True) -> str:
    """A unit as pictures show it, in mathtext, given or natural; if neither is known,
    that it is the run file's, unless not `unknown`."""
    if of == NUMBER:
        return ""
    label = _tex(units.label(of)) or units.natural_label(of)
    if label or not unknown:
        return label
    return f"length {_FREE}" if of == LENGTH else _FREE


def _tex(label: str) -> str:
    """A label of a unit in mathtext."""
    text = re.sub(r"(?<![A-Za-z])u(?=[msN](?![A-Za-z]))", "µ", label)
    if re.fullmatch(r"[A-Za-z]+_[*A-Za-z0-9]( [A-Za-z]+_[*A-Za-z0-9])*", text):
        return f"${text}$".replace(" ", r"\,")
    text = text.replace("$", r"\$")
    text = re.sub(r"\^(\d+)", r"$^{\1}$", text)
    return text.replace("x_*", "$x_*$")


def with_unit(text: str, unit: str) -> str:
    """A label of an axis."""
    return f"{text}  [{unit}]" if unit else text


def axis(
    name: str,
    units: Units,
    stress: str = "",
    *,
    unknown: bool = True,
    fractions: bool = False,
) -> str:
    """A label for the axis of a key, an observable or a column of a sweep, or the head
    of a legend, which says nothing of an `unknown` unit; `stress`: the unit of a shear
    stress, if known; `fractions`: those of `column`."""
    entry = catalogue.entry(name)
    if entry is None or not entry.words:
        return plain(name)
    if fractions and _is_fraction(name):
        return f"{entry.words} over threshold"
    return with_unit(entry.mathtext, column_unit(name, units, stress, unknown))


def column_unit(
    name: str, units: Units, stress: str = "", unknown: bool = False
) -> str:
    """The unit of a column on its `axis`; "" if it is not known, unless `unknown`."""
    entry = catalogue.entry(name) or catalogue.Entry()
    unit = entry.fixed_unit or (stress if entry.dimension == STRESS else "")
    return unit or unit_text(units, entry.dimension, unknown)


def of_trajectory(x: str, units: Units) -> dict[str, str]:
    """Labels of the axes of a picture of the force against a column `x`."""
    x_label, y_label = (axis(name, units, unknown=False) for name in (x, "force"))
    return {"xlabel": x_label, "ylabel": y_label}


def symbol(name: str) -> str:
    """A key in a legend: its symbol, or its words if it has none."""
    entry = catalogue.entry(name)
    return (entry and (entry.symbol or entry.words)) or plain(name)


def plain(text: str) -> str:
    """A text for a picture: no mathematics, nothing that no font has."""
    return text.encode(errors="backslashreplace").decode().replace("$", r"\$")


def described(contacts: Ensemble, units: Units, tex: bool = False) -> str:
    """An ensemble in some words: contacts, disorder, stiffness, temperature, aging."""
    count = f"{contacts.count:,}".replace(",", " ")
    springs = r"$k_i \propto \sqrt{f_{si}}$" if tex else "k_i ~ sqrt(f_si)"
    if contacts.stiffness_law == "uniform":
        springs = "uniform stiffness"
    parts = [f"{count} {contacts.disorder} contact{'s' * (contacts.count != 1)}"]
    parts.append(springs)
    if contacts.populations:
        return ", ".join([*parts, f"{len(contacts.populations)} populations"])
    kT, energy = contacts.thermal.kT, contacts.stiffness * contacts.thresholds.scale**2
    kelvin = units.kelvin(kT)
    thermal = contacts.thermal
    if BARRIERS[thermal.barrier].by_force:
        parts.append(f"{thermal.barrier} bonds")
    elif not kT:
        parts.append("$T = 0$" if tex else "T = 0")
    elif kelvin is not None:
        parts.append(f"$T$ = {kelvin:.4g} K" if tex else f"T = {kelvin:.4g} K")
    elif math.isfinite(kT / energy) and tex:
        parts.append(rf"$k_B T = {_power(kT / energy)}\, k x_*^2$")
    else:
        parts.append(f"kT = {kT / energy:.4g} k x_*^2")
    if contacts.aging.active:
        parts.append(f"aging: {contacts.aging.rule}")
    return ", ".join(parts)


def _power(value: float) -> str:
    """A number in mathematics: 1.9e-09 is 1.9 times a power of ten."""
    number, _, exponent = f"{value:.3g}".partition("e")
    return rf"{number} \times 10^{{{int(exponent)}}}" if exponent else number
