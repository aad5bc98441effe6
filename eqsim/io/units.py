"""Units, and what friction is in a laboratory: a force, a shear stress, a coefficient."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

from scipy import constants

from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_number, shown
from eqsim.estimate import OBSERVABLES, Averages, Estimate
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Group

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


class Dimension(NamedTuple):
    """Powers of length, time and force."""

    length: int = 0
    time: int = 0
    force: int = 0


NUMBER, LENGTH, TIME, FORCE = (
    Dimension(),
    Dimension(1),
    Dimension(0, 1),
    Dimension(0, 0, 1),
)
VELOCITY, RATE, ENERGY, STIFFNESS = (
    Dimension(1, -1),
    Dimension(0, -1),
    Dimension(1, 0, 1),
    Dimension(-1, 0, 1),
)
STRESS, AREA, PER_AREA = Dimension(-2, 0, 1), Dimension(2), Dimension(-2)
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

    Examples
    --------
    >>> print(f"{Units('um', 's', 'nN').energy(300.0):.2e}")  # k_B T in nN um
    4.14e-06
    """

    length: str = ""
    time: str = ""
    force: str = ""

    def __post_init__(self) -> None:
        for name, label in self._given():
            if (
                not label.isprintable()
                or len(label) > _LONGEST
                or label != label.strip()
            ):
                said = f"must be a unit, such as {self._examples(name)}, or a label of up to {_LONGEST} characters"
                raise InputError(f"{name} = {shown(label)}: {said}")

    def __bool__(self) -> bool:
        return any(label for _, label in self._given())

    def _given(self) -> list[tuple[str, str]]:
        return [(field.name, getattr(self, field.name)) for field in fields(self)]

    def _parts(self, of: Dimension) -> list[tuple[str, str, int]]:
        """Name, label and power of each unit that has a part in a dimension, those in
        the numerator and force first."""
        order = ("force", "length", "time")
        powers = [(name, getattr(self, name), getattr(of, name)) for name in order]
        return sorted(
            (part for part in powers if part[2]), key=lambda part: part[2] < 0
        )

    def size(self, of: Dimension) -> float | None:
        """The unit of a dimension in SI units; None if a part of it is not given or no
        SI unit."""
        size = 1.0
        for name, label, power in self._parts(of):
            one = _size(name, label)
            if one is None:
                return None
            size *= one**power
        return size

    def label(self, of: Dimension) -> str:
        """The unit of a dimension, such as "um/s", "nN nm" or "Pa"; "" of a number, or
        if a part of it is not given."""
        parts = self._parts(of)
        if not all(label for _, label, _ in parts):
            return ""
        texts = [
            label + (f"^{abs(power)}" if abs(power) > 1 else "")
            for _, label, power in parts
        ]
        above = " ".join(
            text for text, part in zip(texts, parts, strict=True) if part[2] > 0
        )
        below = "".join(
            f"/{text}" for text, part in zip(texts, parts, strict=True) if part[2] < 0
        )
        whole = (above or "1" * bool(below)) + below
        return _NAMED.get((of, whole), whole)

    def energy(self, temperature: float) -> float:
        """k_B T in the unit of energy, length times force, of a `temperature` in
        kelvin. Raises InputError if that is negative or the unit is not known."""
        require_number("temperature", temperature, **NOT_NEGATIVE)
        for name in ("length", "force"):
            label = getattr(self, name)
            if _size(name, label) is None:
                here = (
                    f"units.{name} = {shown(label)} is none"
                    if label
                    else f"units.{name} is not given"
                )
                raise InputError(
                    f"temperature = {shown(temperature)}: kT takes SI units of length and force, and {here}; "
                    f"must be such as {self._examples(name)}"
                )
        return constants.k * temperature / (self.size(ENERGY) or 1.0)

    def kelvin(self, kT: float) -> float | None:
        """The temperature of a `kT` in the unit of energy; None if that is not known."""
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
    return (
        float(f"1e{_PREFIXES[prefix]}")
        if prefix != label and prefix in _PREFIXES
        else None
    )


@dataclass(frozen=True)
class Interface:
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

    area: float | None = None
    contacts_per_area: float | None = None
    normal_load: float | None = None
    normal_stress: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) is not None:
                require_number(field.name, getattr(self, field.name), **POSITIVE)
        if self.normal_stress is not None and self.normal_load is not None:
            raise InputError(
                f"normal_stress = {shown(self.normal_stress)}: not allowed with normal_load; give one"
            )
        if (
            self.normal_stress is not None
            and self.area is None
            and self.contacts_per_area is None
        ):
            said = (
                "needs area or contacts_per_area, which say how many contacts carry it"
            )
            raise InputError(f"normal_stress = {shown(self.normal_stress)}: {said}")

    def __bool__(self) -> bool:
        return any(getattr(self, field.name) is not None for field in fields(self))

    def contacts(self, count: int) -> float:
        """Number of its contacts, if `count` are simulated."""
        return (
            count
            if self.area is None or self.contacts_per_area is None
            else self.area * self.contacts_per_area
        )

    def density(self, count: int) -> float | None:
        """Contacts per area; None if neither that nor the area is given."""
        if self.contacts_per_area is None and self.area is not None:
            return count / self.area
        return self.contacts_per_area


class Quantity(NamedTuple):
    """What friction F/(N k) is in a laboratory.

    Attributes
    ----------
    name : str
        "force", "shear_stress" or "friction_coefficient".
    symbol : str
        F, tau or mu.
    factor : float
        It is `factor` times friction.
    unit : str
        Pa if that is known, else as in the run file; "" of a coefficient, or if no
        units are given.
    """

    name: str
    symbol: str
    factor: float
    unit: str

    @property
    def label(self) -> str:
        """Its name in words."""
        return self.name.replace("_", " ")

    @property
    def column(self) -> str:
        """Its name in tables, where `force` is F/(N k), a length."""
        return "friction_force" if self.name == "force" else self.name

    def of(self, friction: Estimate) -> Estimate:
        """It, from friction, with its standard error."""
        value, stderr = friction.value, friction.stderr
        return replace(
            friction,
            value=None if value is None else value * self.factor,
            stderr=None if stderr is None else stderr * abs(self.factor),
        )

    def near(self, friction: float) -> "Quantity":
        """The same in kPa, MPa or GPa, or mPa, where `friction` is some thousands of
        Pa, or thousandths."""
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
        return {
            "value": found.value,
            "stderr": found.stderr,
            **exact,
            "unit": self.unit,
        }


def quantities(
    ensemble: Ensemble, units: Units, interface: Interface
) -> tuple[Quantity, ...]:
    """What the friction F/(N k) of an ensemble is at an interface.

    The force is that of all contacts of the interface and is known if anything of the
    interface is given, or a unit of force; the shear stress if an area or contacts per
    area are; the coefficient if a load or normal stress is.
    """
    if not interface and not units.force:
        return ()
    k, count = ensemble.stiffness, ensemble.count
    force, density = interface.contacts(count) * k, interface.density(count)
    found = [Quantity("force", "F", force, units.label(FORCE))]
    if density is not None:
        size = units.size(STRESS)
        unit = units.label(STRESS) if size is None else "Pa"
        found.append(Quantity("shear_stress", "tau", density * k * (size or 1.0), unit))
    if interface.normal_load is not None:
        found.append(
            Quantity("friction_coefficient", "mu", force / interface.normal_load, "")
        )
    elif interface.normal_stress is not None and density is not None:
        found.append(
            Quantity(
                "friction_coefficient", "mu", density * k / interface.normal_stress, ""
            )
        )
    return tuple(found)


def scales(ensemble: Ensemble, units: Units, interface: Interface) -> list[Group]:
    """Physical scales of an ensemble in its units, beside its dimensionless groups;
    none if neither units nor anything of the interface is given."""
    if not units and not interface:
        return []
    unit, kelvin = ensemble.thresholds.scale, units.kelvin(ensemble.thermal.kT)
    found = [
        Group(
            f"x_* ({units.label(LENGTH) or 'length'})",
            unit,
            "scale of thresholds, a length",
        ),
        Group(
            f"k ({units.label(STIFFNESS) or 'force/length'})",
            ensemble.stiffness,
            "stiffness of a contact",
        ),
    ]
    if kelvin is not None:
        found.append(
            Group("T (K)", kelvin, "temperature, kT over the constant of Boltzmann")
        )
    contacts, density = (
        interface.contacts(ensemble.count),
        interface.density(ensemble.count),
    )
    if interface:
        found.append(Group("contacts", contacts, "of the interface"))
    if density is not None:
        area, per = (
            units.label(AREA) or "length^2",
            units.label(PER_AREA) or "1/length^2",
        )
        found.append(
            Group(f"area ({area})", contacts / density, "of the interface, apparent")
        )
        found.append(Group(f"contacts per area ({per})", density, "of the interface"))
    for one in quantities(ensemble, units, interface):
        one = one.near(unit)
        mark = f" ({one.unit})" * bool(one.unit)
        found.append(
            Group(one.label + mark, one.factor * unit, "if friction F/(N k) were x_*")
        )
    return found


class Row(NamedTuple):
    """How a table shows an observable: `label`, its `unit` as a column, if there is
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
    force, stress and coefficient come after itself. Units are shown where any is known.
    """
    found = [quantity.near(averages.friction.value or 0.0) for quantity in found]
    several = bool(units or found)
    rows = []
    for name in averages.shown:
        dimension = Dimension(
            length={"length": 1, "length^2": 2}.get(OBSERVABLES[name].unit, 0)
        )
        rows.append((name, Row(name, (units.label(dimension),) * several)))
        if name == "friction":
            rows += [
                (name, Row("mu" if one.symbol == "mu" else one.name, (one.unit,), one))
                for one in found
            ]
    return rows
