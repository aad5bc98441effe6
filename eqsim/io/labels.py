"""What pictures and tables call things: keys, observables, ensembles, in the units of a
run file."""

import math
import re

from eqsim.estimate import OBSERVABLES
from eqsim.io import units as dimensions
from eqsim.io.units import Dimension, Units
from eqsim.model.ensemble import Ensemble

FORCE = "friction  $F / (N k)$"
_FREE = "unit of the run file"
_FRICTION = r"$\langle F \rangle / (N k)$"
# Of each key of a run file and column of a sweep: words, symbol, and the dimension of
# its unit.
_KNOWN: dict[str, tuple[str, str, Dimension]] = {
    "disorder": ("ensemble", "", dimensions.NUMBER),
    "contacts.count": ("number of contacts", "$N$", dimensions.NUMBER),
    "contacts.stiffness": ("stiffness of a contact", "$k$", dimensions.STIFFNESS),
    "contacts.stiffness_law": ("law of stiffness", "", dimensions.NUMBER),
    "thresholds.law": ("law of thresholds", "", dimensions.NUMBER),
    "thresholds.n": ("exponent of the threshold law", "$n$", dimensions.NUMBER),
    "thresholds.x_star": ("threshold scale", "$x_*$", dimensions.LENGTH),
    "thermal.kT": ("thermal energy", "$k_B T$", dimensions.ENERGY),
    "thermal.attempt_frequency": ("attempt frequency", r"$\omega$", dimensions.RATE),
    "thermal.barrier": ("barrier", "", dimensions.NUMBER),
    "aging.rule": ("aging", "", dimensions.NUMBER),
    "aging.rate": ("rate of aging", "$D$", Dimension(2, -1)),
    "aging.x_star_final": ("final threshold scale", "$x_{*f}$", dimensions.LENGTH),
    "aging.beta": ("growth of thresholds", r"$\beta$", dimensions.NUMBER),
    "aging.cutoff_time": ("cutoff time of aging", "$t_c$", dimensions.TIME),
    "newborn.stretch": ("stretch at birth", "", dimensions.LENGTH),
    "newborn.mean": ("mean stretch at birth", "", dimensions.LENGTH),
    "newborn.std": (
        "standard deviation of the stretch at birth",
        "",
        dimensions.LENGTH,
    ),
    "delay.time": ("mean delay", r"$\tau$", dimensions.TIME),
    "delay.law": ("law of the delay", "", dimensions.NUMBER),
    "viscosity.eta": (
        "viscous coefficient of a detached contact",
        r"$\eta$",
        Dimension(-1, 1, 1),
    ),
    "drive.velocity": ("driving velocity", "$v$", dimensions.VELOCITY),
    "drive.distance": ("distance", "", dimensions.LENGTH),
    "drive.stage.stiffness": (
        "stiffness of the spring",
        r"$\kappa_s = K / (N k)$",
        dimensions.NUMBER,
    ),
    "drive.stage.damping": (
        "damping of the slider",
        r"$\eta_s / (N k)$",
        dimensions.TIME,
    ),
    "drive.stage.mass": ("mass of the slider", "$m / (N k)$", Dimension(0, 2)),
    "elastic.coupling": (
        "coupling of blocks",
        r"$\kappa_b / (n k)$",
        dimensions.NUMBER,
    ),
    "elastic.drive_stiffness": (
        "spring of a block",
        "$K_d / (n k)$",
        dimensions.NUMBER,
    ),
    "elastic.blocks": ("number of blocks", "", dimensions.NUMBER),
    "output.seed": ("seed", "", dimensions.NUMBER),
    "friction": ("friction", _FRICTION, dimensions.LENGTH),
    "pinned": ("pinned fraction", "$N_c / N$", dimensions.NUMBER),
    "break_stretch": ("mean stretch at breaking", "", dimensions.LENGTH),
    "travel": ("mean travel from birth to breaking", "", dimensions.LENGTH),
    "birth_stretch": ("mean stretch at birth", "", dimensions.LENGTH),
    "force_variance": (
        "force variance",
        r"$\mathrm{Var}(F) / (N k^2)$",
        dimensions.AREA,
    ),
    "friction_force": ("friction force", r"$\langle F \rangle$", dimensions.FORCE),
    "friction_coefficient": ("friction coefficient", r"$\mu$", dimensions.NUMBER),
    "size": ("breaks per avalanche", "", dimensions.NUMBER),
    "single": ("fraction of single breaks", "", dimensions.NUMBER),
    "slips": ("number of slips", "", dimensions.NUMBER),
    "period": ("period of the slips", "", dimensions.TIME),
    "drop": ("drop of the force in a slip", r"$\Delta F / (N k)$", dimensions.LENGTH),
    "time": ("time", "$t$", dimensions.TIME),
    "X": ("slider displacement", "$X$", dimensions.LENGTH),
    "D": ("displacement of the plate", "$D$", dimensions.LENGTH),
}
_SEGMENT = {
    "end": ("force at its end", dimensions.LENGTH), "peak": ("peak force", dimensions.LENGTH), "at": ("peak at", None),
    "direct": ("direct effect", dimensions.LENGTH), "evolution": ("evolution effect", dimensions.LENGTH),
    "memory": ("memory length", dimensions.LENGTH),
}  # fmt: skip
# Of each column of the tables of results that is no key of a run file and no column of
# a sweep: words and dimension.
_COLUMNS: dict[str, tuple[str, Dimension]] = {
    "t": ("time", dimensions.TIME),
    "stage": ("displacement of the stage", dimensions.LENGTH),
    "spring": ("force of the stage's spring over N k", dimensions.LENGTH),
    "force": ("friction force over N k, <F>/(N k)", dimensions.LENGTH),
    "segment": ("of the programme, from 0", dimensions.NUMBER),
    "work": ("work of the stage over N k", dimensions.AREA),
    "stored": ("energy over N k of spring, slider and contacts", dimensions.AREA),
    "dissipated": ("dissipated energy over N k", dimensions.AREA),
    "missing": ("energy over N k that finite steps miss", dimensions.AREA),
    "distance": ("how far the slider moves", dimensions.LENGTH),
    "stretch": ("stretch at breaking", dimensions.LENGTH),
    "stiffness": ("k_i/k of the contact at birth", dimensions.NUMBER),
    "breaks": ("number of breaks", dimensions.NUMBER),
    "f_k": ("elastic force per pinned contact, F/(N_c k)", dimensions.LENGTH),
    "shear_stress": ("friction force over apparent area", dimensions.STRESS),
    "velocity": ("driving velocity", dimensions.VELOCITY),
    "critical_stiffness": (
        "kappa_s = K/(N k) below which steady sliding is unstable",
        dimensions.NUMBER,
    ),
    "fresh_critical_stiffness": (
        "kappa_s = K/(N k) of a first slip",
        dimensions.NUMBER,
    ),
    "lag": ("displacement between two forces", dimensions.LENGTH),
    "covariance": ("N times the autocovariance of F/(N k)", dimensions.AREA),
    "simulated": ("N times the autocovariance of F/(N k), simulated", dimensions.AREA),
    "error": ("bound of the error of the covariance", dimensions.AREA),
    **{
        f"thresholds.{name}": ("", dimensions.LENGTH) for name in ("low", "high", "std")
    },
    **{f"newborn.{name}": ("", dimensions.LENGTH) for name in ("low", "high")},
}
_KELVIN = ("temperature", "thermal.temperature")
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
_OF_SEGMENT = {
    "velocity": dimensions.VELOCITY, "hold": dimensions.TIME, "time": dimensions.TIME, "distance": dimensions.LENGTH,
}  # fmt: skip


def column(name: str, units: Units, fractions: bool = False) -> tuple[str, str]:
    """Say what a column of a table of results holds.

    Parameters
    ----------
    name : str
    units : Units
        Those of the run file.
    fractions : bool
        Whether stretches of the newborn are fractions of their thresholds.

    Returns
    -------
    words, unit : str
        Words are "" of a key of a run file, whose name says it. The unit is such as
        "um/s", or "length/time" where units are not given; "" of a number and of what
        is not known.
    """
    for suffix, (text, same) in _SUFFIXES.items():
        if name.endswith(suffix):
            return text, column(name.removesuffix(suffix), units, fractions)[
                1
            ] if same else ""
    if name in _KELVIN:
        return "", "K"
    dimension: Dimension | None = None
    words = ""
    if name in OBSERVABLES:
        words = " ".join(OBSERVABLES[name].label.split())
        dimension = _KNOWN[name][2]
    elif name in _COLUMNS:
        words, dimension = _COLUMNS[name]
    elif found := re.fullmatch(r"segment_(\d+)_(\w+)", name):
        words, dimension = _SEGMENT.get(found[2], ("", None))
        words = words and f"segment {found[1]}: {words}"
    elif found := re.fullmatch(r"drive\.programme\.(\d+)\.(\w+)", name):
        dimension = _OF_SEGMENT.get(found[2])
    elif name in _KNOWN:
        words, _, dimension = _KNOWN[name]
        words = "" if "." in name or name == "disorder" else words
    if dimension is None or (fractions and name.startswith("newborn.")):
        return words, ""
    if dimension == dimensions.STRESS and units.size(dimension) is not None:
        return words, "Pa"  # `units.quantities`
    known = (getattr(units, part) or part for part in ("length", "time", "force"))
    return words, Units(*known).label(dimension)


def unit_text(units: Units, of: Dimension, unknown: bool = True) -> str:
    """A unit as pictures show it, in mathtext; if it is not known, that it is the run
    file's, unless not `unknown`."""
    if of == dimensions.NUMBER:
        return ""
    label = units.label(of)
    if label:
        return _tex(label)
    if not unknown:
        return ""
    return f"length {_FREE}" if of == dimensions.LENGTH else _FREE


def _tex(label: str) -> str:
    """A label of a unit in mathtext."""
    text = re.sub(r"(?<![A-Za-z])u(?=[msN](?![A-Za-z]))", "µ", label)
    if text == "x_*" or re.fullmatch(
        r"[A-Za-z]+_[*A-Za-z0-9]( [A-Za-z]+_[*A-Za-z0-9])*", text
    ):
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
    stress, if it is known; `fractions`: whether stretches of the newborn are fractions
    of their thresholds."""
    if fractions and name.startswith("newborn.") and name in _KNOWN:
        return f"{_KNOWN[name][0]} over threshold"
    if name == "thermal.temperature":
        return "temperature  $T$  [K]"
    if name == "shear_stress":
        return with_unit(
            r"shear stress  $\tau$", stress or unit_text(units, dimensions.STRESS)
        )
    if name in _KNOWN:
        words, symbol, dimension = _KNOWN[name]
        return with_unit(
            f"{words}  {symbol}".strip(), unit_text(units, dimension, unknown)
        )
    found = re.fullmatch(r"segment_(\d+)_(\w+)", name)
    if found and found[2] in _SEGMENT:
        words, segment_dimension = _SEGMENT[found[2]]
        unit = unit_text(units, segment_dimension) if segment_dimension else ""
        symbol = "  $F / (N k)$" if found[2] in ("end", "peak") else ""
        return with_unit(f"segment {found[1]}: {words}{symbol}", unit)
    found = re.fullmatch(r"drive\.programme\.(\d+)\.(\w+)", name)
    if found and found[2] in _OF_SEGMENT:
        words = "hold" if found[2] == "hold" else found[2]
        return with_unit(
            f"{words} of segment {found[1]}",
            unit_text(units, _OF_SEGMENT[found[2]], unknown),
        )
    return plain(name)


def of_trajectory(x: str, units: Units) -> dict[str, str]:
    """Labels of the axes of a picture of the force against the column `x` of a
    trajectory."""
    along = axis({"t": "time"}.get(x, x), units, unknown=False)
    return {
        "xlabel": along,
        "ylabel": with_unit(FORCE, unit_text(units, dimensions.LENGTH, unknown=False)),
    }


def symbol(name: str) -> str:
    """A key in a legend: its symbol, or its words if it has none."""
    if name == "thermal.temperature":
        return "$T$"
    words, sign, _ = _KNOWN.get(name, (plain(name), "", None))
    return sign or words


def plain(text: str) -> str:
    """A text for a picture: no mathematics, nothing that no font has."""
    return text.encode(errors="backslashreplace").decode().replace("$", r"\$")


def described(contacts: Ensemble, units: Units, tex: bool = False) -> str:
    """An ensemble in some words: how many contacts of which disorder and stiffness,
    temperature and aging."""
    count = f"{contacts.count:,}".replace(",", " ")
    law = (
        (r"$k_i \propto \sqrt{f_{si}}$" if tex else "k_i ~ sqrt(f_si)")
        if contacts.stiffness_law == "sqrt"
        else ""
    )
    parts = [
        f"{count} {contacts.disorder} contact{'s' * (contacts.count != 1)}",
        law or "uniform stiffness",
    ]
    kT, energy = contacts.thermal.kT, contacts.stiffness * contacts.thresholds.scale**2
    kelvin = units.kelvin(kT)
    if not kT:
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
