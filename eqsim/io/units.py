"""Units, and what friction is in a laboratory: a force, a shear stress, a
coefficient."""

import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace
from typing import NamedTuple

from scipy import constants

from eqsim.catalogue import ENERGY, FORCE, NUMBER, STRESS, Dimension, dimension, product
from eqsim.errors import (
    NOT_NEGATIVE,
    Checked,
    InputError,
    Positive,
    require_number,
    shown,
)
from eqsim.estimate import OBSERVABLES, Averages, Estimate
from eqsim.laws.barrier import BARRIERS
from eqsim.model.ensemble import Ensemble
from eqsim.model.groups import Group

_PREFIXES = {
    "": 0, "f": -15, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2, "k": 3, "M": 6, "G": 9,
}  # fmt: skip
_BASES = {"length": "m", "time": "s", "force": "N"}
_OTHERS = {
    "length": {"Å": 1e-10, "angstrom": 1e-10},
    "time": {"min": 60.0, "h": 3600.0, "d": 86400.0},
    "force": dict[str, float](),
}
_LONGEST = 20  # characters of a label
_NAMED = {(ENERGY, "N m"): "J", (STRESS, "N/m^2"): "Pa"}


@dataclass(frozen=True)
class Units:
    """The units in which a run file is written.

    Raises InputError for a label that is too long or cannot be printed.

    Parameters
    ----------
    length, time, force : str
        An SI unit with its prefix ("nm", "um", "s", "min", "nN"), whose size is known,
        or any other label of up to 20 characters ("x_*"), which is shown as it is.
        Empty: not given.
    natural : tuple of str
        Which of "x_*", "omega" and "k" are 1 in the run file: labels of axes give
        numbers without units in these.

    Examples
    --------
    >>> print(f"{Units('um', 's', 'nN').energy(300.0):.2e}")  # k_B T in nN um
    4.14e-06
    """

    length: str = ""
    time: str = ""
    force: str = ""
    natural: tuple[str, ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        for name in _BASES:
            label = getattr(self, name)
            word = isinstance(label, str) and label.isprintable()
            if not word or len(label) > _LONGEST or label != label.strip():
                said = f"must be a unit, such as {self._examples(name)}"
                said += f", or a label of up to {_LONGEST} characters"
                raise InputError(f"{name} = {shown(label)}: {said}")

    def __bool__(self) -> bool:
        return any(getattr(self, name) for name in _BASES)

    def size(self, of: Dimension) -> float | None:
        """The unit of a dimension in SI units; None if a part of it is not known."""
        powers = {name: getattr(of, name) for name in ("force", "length", "time")}
        size = 1.0
        for name in sorted(powers, key=lambda name: powers[name] < 0):
            one = _size(name, getattr(self, name))
            if powers[name] and one is None:
                return None
            size *= (one or 1.0) ** powers[name]
        return size

    def label(self, of: Dimension) -> str:
        """The unit of a dimension, such as "um/s", "nN nm" or "Pa"; "" of a number, or
        if a part of it is not given."""
        labels = (self.force, of.force), (self.length, of.length), (self.time, of.time)
        factors = [(label, power) for label, power in labels if power]
        if not all(label for label, _ in factors):
            return ""
        whole = product(factors)
        return _NAMED.get((of, whole), whole)

    def natural_label(self, of: Dimension) -> str:
        """The unit of a dimension as a product of the `natural` ones, in mathtext; ""
        where that is not known, and where units are given."""
        powers = {"k": of.force, "x_*": of.length + of.force, "omega": -of.time}
        factors = {name: power for name, power in powers.items() if power}
        if self or not factors.keys() <= set(self.natural):
            return ""
        whole = product([*factors.items()], r"\,", " / ")
        return f"${whole}$".replace("omega", r"\omega")

    def energy(self, temperature: float) -> float:
        """k_B T in the unit of energy, length times force, of a `temperature` in
        kelvin. Raises InputError if that is negative or the unit is not known."""
        require_number("temperature", temperature, **NOT_NEGATIVE)
        for name in ("length", "force"):
            label = getattr(self, name)
            if _size(name, label) is None:
                here = f" = {shown(label)} is none" if label else " is not given"
                said = f"kT takes SI units of length and force, and units.{name}{here}"
                said += f"; must be such as {self._examples(name)}"
                raise InputError(f"temperature = {shown(temperature)}: {said}")
        return constants.k * temperature / (self.size(ENERGY) or 1.0)

    def kelvin(self, kT: float) -> float | None:
        """The temperature of a `kT` in the unit of energy; None if that is unknown."""
        size = self.size(ENERGY)
        return None if size is None else kT * size / constants.k

    @staticmethod
    def _examples(name: str) -> str:
        return ", ".join(f'"{prefix}{_BASES[name]}"' for prefix in ("", "u", "n"))


def _size(name: str, label: str) -> float | None:
    """A unit of length, time or force in SI units; None if it is not known."""
    if label in _OTHERS[name]:
        return _OTHERS[name][label]
    prefix = label.removesuffix(_BASES[name])
    known = prefix != label and prefix in _PREFIXES
    return float(f"1e{_PREFIXES[prefix]}") if known else None


@dataclass(frozen=True)
class Interface(Checked):
    """The interface that the simulated contacts stand for, in the units of the run
    file.

    The interface has `contacts_per_area` times `area` contacts if both are given, of
    which the ensemble's are a sample; else it has those of the ensemble.

    Raises InputError for values that are not positive, for both loads, and for a
    stress without an area or contacts per area.

    Parameters
    ----------
    area : float, optional
        Apparent area (length^2); default: that of the ensemble's contacts, if
        `contacts_per_area` is given.
    contacts_per_area : float, optional
        1/length^2; default: the ensemble's contacts over `area`, if that is given.
    normal_load : float, optional
        Force on the whole interface.
    normal_stress : float, optional
        Instead of it, the load per apparent area (force/length^2), which is then known.

    Examples
    --------
    >>> Interface(area=100.0, contacts_per_area=2.5).contacts(count=1000)
    250.0
    """

    area: Positive | None = None
    contacts_per_area: Positive | None = None
    normal_load: Positive | None = None
    normal_stress: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        given = f"normal_stress = {shown(self.normal_stress)}"
        if self.normal_stress is not None and self.normal_load is not None:
            raise InputError(f"{given}: not allowed with normal_load; give one")
        if self.normal_stress is not None and self.density(1) is None:
            said = "which say how many contacts carry it"
            raise InputError(f"{given}: needs area or contacts_per_area, {said}")

    def __bool__(self) -> bool:
        return any(value is not None for value in asdict(self).values())

    def contacts(self, count: int) -> float:
        """Number of its contacts, if `count` are simulated."""
        if self.area is None or self.contacts_per_area is None:
            return count
        return self.area * self.contacts_per_area

    def density(self, count: int) -> float | None:
        """Contacts per area; None if neither that nor the area is given."""
        if self.contacts_per_area is None and self.area is not None:
            return count / self.area
        return self.contacts_per_area


class Quantity(NamedTuple):
    """A laboratory's measure of friction F/(N k), which is `factor` times friction."""

    name: str  # "force", "shear_stress" or "friction_coefficient"
    symbol: str  # F, tau or mu
    factor: float
    unit: str  # Pa if that is known, else the run file's; "" of a number or if unknown

    @property
    def label(self) -> str:
        """Its name in words."""
        return self.name.replace("_", " ")

    @property
    def short(self) -> str:
        """Its name on a terminal."""
        return "mu" if self.symbol == "mu" else self.name

    @property
    def column(self) -> str:
        """Its name in tables, where `force` is F/(N k), a length."""
        return "friction_force" if self.name == "force" else self.name

    def of(self, friction: Estimate) -> Estimate:
        """It, from friction, with its standard error."""
        value, stderr = friction.value, friction.stderr
        value = None if value is None else value * self.factor
        stderr = None if stderr is None else stderr * abs(self.factor)
        return replace(friction, value=value, stderr=stderr)

    def near(self, friction: float) -> "Quantity":
        """This quantity in kPa, MPa or GPa, or mPa, where `friction` is some thousands
        of Pa, or thousandths."""
        value = abs(friction * self.factor)
        if self.unit != "Pa" or not value or not math.isfinite(value):
            return self
        power = min(max(3 * math.floor(math.log10(value) / 3.0 + 1e-12), -3), 9)
        prefix = {-3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[power]
        return self._replace(factor=self.factor / 10.0**power, unit=prefix + "Pa")

    def as_dict(
        self, friction: Estimate, reference: float | None = None
    ) -> dict[str, float | str | None]:
        """For JSON; `reference` is that of friction, if there is one."""
        found = self.of(friction)
        exact = {} if reference is None else {"reference": reference * self.factor}
        known = {"value": found.value, "stderr": found.stderr}
        return {**known, **exact, "unit": self.unit}


def quantities(
    ensemble: Ensemble, units: Units, interface: Interface
) -> tuple[Quantity, ...]:
    """The friction F/(N k) of an ensemble in the quantities of a laboratory. The force
    is that of all contacts of the interface and is known if anything of the interface
    is given, or a unit of force; the shear stress if an area or contacts per area are;
    the coefficient if a load or normal stress is."""
    if not interface and not units.force:
        return ()
    k, count = ensemble.mean_stiffness, ensemble.count
    force, density = interface.contacts(count) * k, interface.density(count)
    found = [Quantity("force", "F", force, units.label(FORCE))]
    if density is not None:
        size = units.size(STRESS)
        unit = units.label(STRESS) if size is None else "Pa"
        found.append(Quantity("shear_stress", "tau", density * k * (size or 1.0), unit))
    ratio = None
    if interface.normal_load is not None:
        ratio = force / interface.normal_load
    elif interface.normal_stress is not None and density is not None:
        ratio = density * k / interface.normal_stress
    if ratio is not None:
        found.append(Quantity("friction_coefficient", "mu", ratio, ""))
    return tuple(found)


_SI = {"Pa": "force/length^2", "m": "length", "s": "time", "N": "force"}


def number_and_unit(text: str) -> tuple[float | None, str]:
    """The number that a text such as "50 N/mm" begins with, if any, and the rest."""
    number = re.match(r"\s*\d*\.?\d+(e[-+]?\d+)?", text, re.IGNORECASE)
    return (float(number[0]), text[number.end() :]) if number else (None, text)


def measured(text: str) -> tuple[float, Dimension] | None:
    """SI value and dimension of a text such as "50 N/mm"; None without a unit."""
    number, unit = number_and_unit(text)
    if number is None:
        return None
    value, powers = number, dict.fromkeys(Dimension._fields, 0)
    for below, part in enumerate(unit.split("/")):
        for name, power in re.findall(r"([^\s^*]+)(?:\^(\d))?", part):
            base = next((one for one in _SI if name.endswith(one)), "")
            prefix, of = name.removesuffix(base), _SI.get(base, "")
            size = float(f"1e{_PREFIXES[prefix]}") if prefix in _PREFIXES else None
            for other, sizes in _OTHERS.items():
                of, size = (other, sizes[name]) if name in sizes else (of, size)
            if of and size:
                times = int(power or 1) * (-1 if below else 1)
                value *= size**times
                for axis, one in dimension(of)._asdict().items():
                    powers[axis] += times * one
            elif name != "1":
                return None
    return value, Dimension(**powers)


def over_contacts(
    text: str, per: Dimension, units: Units, found: Iterable[Quantity]
) -> float:
    """Convert a force, shear stress or friction coefficient per displacement (`per`
    LENGTH) or per VELOCITY, in a text such as "50 N/mm", "0.02 MPa/um", "1.6e-3/um" or
    "4.6 MPa s/m", to the same of friction F/(N k): kappa_s = K/(N k), or eta_s/(N k)
    (time). `found` are the `quantities` that friction is. Raises InputError for another
    unit, and where friction is not known in this one."""
    given, size = measured(text), units.size(per)
    kinds = {"force": FORCE, "shear_stress": STRESS, "friction_coefficient": NUMBER}
    for name, of in kinds.items():
        ours = (a - b for a, b in zip(of, per, strict=True))
        if not given or given[1] != Dimension(*ours):
            continue
        one = next((one for one in found if one.name == name), None)
        # a shear stress in known units is in Pa
        unit = units.size(of) if name == "force" else 1.0
        if one is None or size is None or units.size(of) is None or unit is None:
            said = f"a {name.replace('_', ' ')} takes SI units of length, time and"
            raise InputError(
                f"{said} force in [units], and what [interface] says of it"
            )
        return given[0] * size / (one.factor * unit)
    examples = '"50 N/mm", "0.02 MPa/um" or "1.6e-3/um"'
    if per.time:
        examples = '"4.6 MPa s/m", "100 N s/m" or "0.5 s/m"'
    raise InputError(f"must be a number with its unit, such as {examples}")


def scales(ensemble: Ensemble, units: Units, interface: Interface) -> list[Group]:
    """Physical scales of an ensemble in its units, beside its dimensionless groups;
    none if neither units nor anything of the interface is given."""
    if not units and not interface:
        return []
    contacts = interface.contacts(ensemble.count)
    density = interface.density(ensemble.count)

    def group(name: str, of: str, value: float, meaning: str) -> Group:
        return Group(f"{name} ({units.label(dimension(of)) or of})", value, meaning)

    found: list[Group] = []
    for number, alone, *_ in ensemble.kinds:
        of, k = f"{number}: " * bool(ensemble.populations), alone.stiffness
        scale, kelvin = alone.thresholds.scale, units.kelvin(alone.thermal.kT)
        found += [
            group(f"{of}x_*", "length", scale, "scale of thresholds, a length"),
            group(f"{of}k", "force/length", k, "stiffness of a contact"),
        ]
        if kelvin is not None and not BARRIERS[alone.thermal.barrier].by_force:
            said = "temperature, kT over the constant of Boltzmann"
            found.append(Group(f"{of}T (K)", kelvin, said))
    if interface:
        found.append(Group("contacts", contacts, "of the interface"))
    if density is not None:
        area, where = contacts / density, "of the interface"
        found.append(group("area", "length^2", area, f"{where}, apparent"))
        found.append(group("contacts per area", "1/length^2", density, where))
    # populations have no x_* in common
    unit, known = ensemble.thresholds.scale, quantities(ensemble, units, interface)
    for one in () if ensemble.populations else known:
        one = one.near(unit)
        name, size = one.label + f" ({one.unit})" * bool(one.unit), one.factor * unit
        found.append(Group(name, size, "if friction F/(N k) were x_*"))
    return found


class Row(NamedTuple):
    """The row of an observable in a table: `label`, its `unit` as a column, if there is
    one, and a factor."""

    label: str
    unit: tuple[str, ...] = ()
    quantity: Quantity | None = None

    def of(self, estimate: Estimate) -> Estimate:
        """In that unit."""
        return self.quantity.of(estimate) if self.quantity else estimate

    def exact(self, estimate: Estimate | None, form: str) -> str:
        """A value without error bar, in that unit."""
        if estimate is None or estimate.value is None:
            return "none"
        return "infinite" if estimate.diverges else f"{self.of(estimate).value:{form}}"


def rows_of(
    averages: Averages, units: Units, found: Iterable[Quantity]
) -> list[tuple[str, Row]]:
    """The observables that a table shows, each with its row; those of friction as a
    force, stress and coefficient come after itself, with units if any is known."""
    found = [quantity.near(averages.friction.value or 0.0) for quantity in found]
    several = bool(units or found)
    rows = []
    for name in averages.shown:
        unit = units.label(OBSERVABLES[name].dimension)
        rows.append((name, Row(name, (unit,) * several)))
        for one in found if name == "friction" else ():
            rows.append((name, Row(one.short, (one.unit,), one)))
    return rows
