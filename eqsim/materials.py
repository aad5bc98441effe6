"""From material constants to the parameters of the contacts (section VI of Braun and
Peyrard, 2011).

Everything is a plain number in SI units: m, s, kg, N, Pa, J, K. One contact stands on
each a^2 of the interface, in a gap of thickness h, and the interface yields at the
shear stress sigma_*, so that k x_* = a^2 sigma_*. A contact is a cylinder of radius r_c
= gamma_c a and height h that bends: k = 3 E I/h^3, omega = (3.52/h^2) sqrt(E I/(pi
r_c^2 rho)).
"""

import dataclasses
import json
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

from scipy import constants

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    meant,
    require_choice,
    require_integer,
    require_number,
    shown,
    under,
)
from eqsim.laws.aging import Aging
from eqsim.laws.delay import Delay
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Gamma
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Disorder, Ensemble
from eqsim.paper import equation

BOLTZMANN: float = constants.k  # J/K
ROOM_TEMPERATURE = 4e-21 / BOLTZMANN  # K; kT = 4e-21 J as in the paper, 289.7 K


def _decimal(value: float) -> float:
    """To 15 digits, all that every decimal number keeps as a float: 0.4 and not
    0.39999999999999997."""
    return float(f"{value:.15g}")


@dataclass(frozen=True)
class _Arrhenius:
    prefactor: float
    energy: float = 0.0

    def __post_init__(self) -> None:
        require_number("prefactor", self.prefactor, **POSITIVE)
        require_number("energy", self.energy, **NOT_NEGATIVE)

    def _log_factor(self, temperature: float) -> float:
        """E/(k_B T); infinite at T = 0."""
        require_number("temperature", temperature, **NOT_NEGATIVE)
        if self.energy == 0:
            return 0.0
        thermal = BOLTZMANN * temperature
        return self.energy / thermal if thermal > 1e-300 * self.energy else math.inf


class ArrheniusTime(_Arrhenius):
    """A time that thermal activation shortens, tau(T) = prefactor exp(energy/(k_B T)).

    Parameters
    ----------
    prefactor : float
        s.
    energy : float
        Activation energy (J); without it the time is constant.
    """

    def value(self, temperature: float) -> float:
        """tau (s) at `temperature` (K). Raises InputError where it is beyond 1e100 s."""
        log_factor = self._log_factor(temperature)
        if math.log(self.prefactor) + log_factor > math.log(1e100):
            raise InputError(
                f"temperature = {temperature!r}: too low for the activated time, which exceeds 1e100 s"
            )
        return self.prefactor * math.exp(log_factor)


class ArrheniusRate(_Arrhenius):
    """A rate that thermal activation raises, D(T) = prefactor exp(-energy/(k_B T)): as
    `ArrheniusTime`, with a `prefactor` in m^2/s for an aging rate."""

    def value(self, temperature: float) -> float:
        """D (m^2/s) at `temperature` (K)."""
        return self.prefactor * math.exp(-self._log_factor(temperature))


@dataclass(frozen=True)
class ActivatedAging:
    """Aging of pinned contacts at a thermally activated rate; the material's own x_* is
    that of newborn contacts.

    Parameters
    ----------
    rate : ArrheniusRate
        D(T) (m^2/s).
    x_star_final : float
        Scale of the final thresholds (m).
    rule : str
        As in `Aging`.
    """

    rate: ArrheniusRate
    x_star_final: float
    rule: str = "langevin"

    def __post_init__(self) -> None:
        self.at(0.0)

    def at(self, temperature: float) -> Aging:
        """The aging law at `temperature` (K)."""
        return Aging(self.rule, self.rate.value(temperature), self.x_star_final)


@dataclass(frozen=True, kw_only=True)
class Material(ABC):
    """What the interfaces of this module share.

    Every method raises InputError for a temperature (K) that is not a number >= 0.

    Parameters
    ----------
    name : str
    density : float
        rho (kg/m^3).
    shear_strength : float
        sigma_* (Pa).
    delay : ArrheniusTime, optional
        tau(T), the same for all contacts.
    aging : ActivatedAging, optional
        With D(T).
    """

    name: str
    density: float
    shear_strength: float
    delay: ArrheniusTime | None = None
    aging: ActivatedAging | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name not in ("name", "delay", "aging") and (
                value is not None or field.default is not None
            ):
                require_number(field.name, value, above=0, least=1e-30, most=1e30)

    @property
    @abstractmethod
    def stiffness(self) -> float:
        """k (N/m)."""

    @property
    @abstractmethod
    def x_star(self) -> float:
        """Threshold scale x_* (m)."""

    @property
    @abstractmethod
    def attempt_frequency(self) -> float:
        """omega (1/s)."""

    @property
    @abstractmethod
    def contacts_per_area(self) -> float:
        """1/a^2 (1/m^2)."""

    @property
    def elastic_modulus(self) -> float | None:
        """E of the bodies that the contacts join (Pa); None where it is not given."""
        return None

    @property
    def hardness(self) -> float | None:
        """Normal stress that the contacts carry (Pa); None where it is not known."""
        return None

    @property
    def spacing_of_contacts(self) -> float:
        """a (m), of the contacts' centres."""
        return 1.0 / math.sqrt(self.contacts_per_area)

    @property
    def elastic_length(self) -> float | None:
        """lambda_c = a^2 E/k (m), over which the contacts' own elasticity keeps
        neighbours together (Braun, Peyrard, Stryzheus and Tosatti, 2012): the rigid
        slider holds over patches of that size. None where E is not given."""
        E = self.elastic_modulus
        return None if E is None else E / (self.contacts_per_area * self.stiffness)

    def ensemble(
        self,
        temperature: float = ROOM_TEMPERATURE,
        *,
        disorder: Disorder = "quenched",
        stiffness_law: StiffnessLaw = "uniform",
        count: int = 100_000,
    ) -> Ensemble:
        """Contacts of this material in SI units: soft barriers and n = 1.

        Parameters
        ----------
        temperature : float
            T (K).
        disorder, stiffness_law, count
            As in `Ensemble`; those of the paper are "annealed" and "uniform".

        Raises
        ------
        InputError
            If they are out of range, or delay and aging are at this temperature.
        """
        bare = Ensemble(
            thresholds=Gamma(1.0, _decimal(self.x_star)),
            thermal=self._thermal(temperature),
            count=count,
            stiffness=_decimal(self.stiffness),
            stiffness_law=stiffness_law,
            disorder=disorder,
        )
        delay = Delay() if self.delay is None else Delay(self.delay.value(temperature))
        aging = Aging() if self.aging is None else self.aging.at(temperature)
        with under("aging"):
            return dataclasses.replace(bare, delay=delay, aging=aging)

    def _thermal(self, temperature: float) -> Thermal:
        require_number("temperature", temperature, **NOT_NEGATIVE)
        return Thermal(
            _decimal(BOLTZMANN * temperature), _decimal(self.attempt_frequency)
        )

    def _newborn(self, temperature: float) -> Ensemble:
        """Without delay and aging, which have no part in b and v_*."""
        return dataclasses.replace(self, delay=None, aging=None).ensemble(temperature)

    def b(self, temperature: float = ROOM_TEMPERATURE) -> float:
        """k x_*^2/(2 k_B T), eq. (21) of Braun and Peyrard (2011)."""
        return self._newborn(temperature).b

    def crossover_velocity(self, temperature: float = ROOM_TEMPERATURE) -> float:
        """v_* (m/s) of newborn contacts in the annealed ensemble, eq. (26) of Braun and
        Peyrard (2011); quenched contacts show no crossover there."""
        return self._newborn(temperature).crossover_velocity

    def shear_stress(self, friction: float) -> float:
        """sigma = F/A = sigma_* <F>/(N k x_*) (Pa) from `friction` <F>/(N k) (m)."""
        return self.shear_strength * friction / self.x_star


@dataclass(frozen=True, kw_only=True)
class RoughContacts(Material):
    """Two rough surfaces, a = h = r_c.

    Parameters
    ----------
    young_modulus : float
        E (Pa).
    contact_radius : float
        r_c (m).
    indentation_hardness : float, optional
        H (Pa), the normal stress that the contacts carry; by default 3 sqrt(3) sigma_*.
    **material
        Those of `Material`.

    Examples
    --------
    >>> print(f"{STEEL.stiffness:.3g} N/m, x_* = {STEEL.x_star:.3g} m")
    4.71e+05 N/m, x_* = 2.12e-09 m
    """

    young_modulus: float
    contact_radius: float
    indentation_hardness: float | None = None

    @property
    def stiffness(self) -> float:
        """k = (3 pi/4) E r_c (N/m; below eq. (49) of Braun and Peyrard, 2011)."""
        return 0.75 * math.pi * self.young_modulus * self.contact_radius

    @property
    def x_star(self) -> float:
        """x_* = r_c^2 sigma_*/k (m; below eq. (49) of Braun and Peyrard, 2011)."""
        return self.contact_radius**2 * self.shear_strength / self.stiffness

    @property
    def attempt_frequency(self) -> float:
        """omega = 1.76 sqrt(E/rho)/r_c (1/s; eq. (49) of Braun and Peyrard, 2011)."""
        return 1.76 * math.sqrt(self.young_modulus / self.density) / self.contact_radius

    @property
    def contacts_per_area(self) -> float:
        """1/r_c^2 (1/m^2)."""
        return self.contact_radius**-2

    @property
    def hardness(self) -> float:
        """As given, or 3 sqrt(3) sigma_* (Pa), of plastic contacts: three times the
        yield stress (Tabor), which is sqrt(3) times that in shear (von Mises)."""
        return self.indentation_hardness or 3.0 * math.sqrt(3.0) * self.shear_strength

    @property
    def elastic_modulus(self) -> float:
        """That of the asperities: the two are of one material."""
        return self.young_modulus


@dataclass(frozen=True, kw_only=True)
class LubricantIslands(Material):
    """A film of solid islands that melt under stress, x_* = r_c = gamma_c a.

    Parameters
    ----------
    thickness : float
        h (m).
    spacing : float
        a (m).
    gamma_c : float
        r_c/a, at most 1/2.
    **material
        Those of `Material`.

    Examples
    --------
    >>> film = OCTAMETHYLCYCLOTETRASILOXANE
    >>> print(f"{film.stiffness:.3g} N/m, omega = {film.attempt_frequency:.3g} 1/s")
    0.4 N/m, omega = 7.95e+08 1/s
    """

    thickness: float
    spacing: float
    gamma_c: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require_number("gamma_c", self.gamma_c, above=0, most=0.5)  # islands touch

    @property
    def stiffness(self) -> float:
        """k = a sigma_*/gamma_c (N/m; section VI)."""
        return self.spacing * self.shear_strength / self.gamma_c

    @property
    def x_star(self) -> float:
        """x_* = gamma_c a (m; section VI)."""
        return self.gamma_c * self.spacing

    @property
    def attempt_frequency(self) -> float:
        """omega = 1.15 sqrt(sigma_*/(a h rho gamma_c^3)) (1/s; section VI)."""
        inertia = self.spacing * self.thickness * self.density * self.gamma_c**3
        return 1.15 * math.sqrt(self.shear_strength / inertia)

    @property
    def contacts_per_area(self) -> float:
        """1/a^2 (1/m^2)."""
        return self.spacing**-2

    def printed_crossover_velocity(
        self, temperature: float = ROOM_TEMPERATURE
    ) -> float:
        """The paper's estimate of v_* (m/s) for b >> 1, k_B T/sqrt(a^5 h rho sigma_*
        gamma_c^3) (section VI): 1.9 % below `crossover_velocity`, because 2 * 1.15/(3
        C_0) was set to 1 (derived)."""
        kT = self._thermal(temperature).kT
        film = self.thickness * self.density * self.shear_strength
        return kT / (self.spacing**2 * math.sqrt(self.spacing * film * self.gamma_c**3))


# section VI; the shear strength of steel is that of plasticity, the film has four
# layers
STEEL = RoughContacts(
    name="steel",
    density=1e4,
    young_modulus=2e11,
    shear_strength=1e9,
    contact_radius=1e-6,
)
OCTAMETHYLCYCLOTETRASILOXANE = LubricantIslands(
    name="octamethylcyclotetrasiloxane",
    density=956.0,
    thickness=3.5e-9,
    shear_strength=2e5,
    gamma_c=0.5,
    spacing=1e-6,
)
MATERIALS: dict[str, Material] = {
    material.name: material for material in (STEEL, OCTAMETHYLCYCLOTETRASILOXANE)
}
ALIASES = {"omcts": "octamethylcyclotetrasiloxane"}
KINDS: dict[str, type[Material]] = {"rough": RoughContacts, "islands": LubricantIslands}


def preset(name: str) -> Material | None:
    """The material of `MATERIALS` with this name or alias, in upper or lower case; None
    if there is none."""
    lower = name.lower()
    return MATERIALS.get(ALIASES.get(lower, lower))


def from_constants(constants: dict[str, Any], name: str = "material") -> Material:
    """A material from its constants by name, as they stand in a TOML file.

    Parameters
    ----------
    constants : dict
        `kind`, "rough" (`RoughContacts`) or "islands" (`LubricantIslands`), and the
        parameters of that class; its `delay`, `aging` and the `rate` of that are such
        dicts, too.
    name : str
        Where the constants have none.

    Returns
    -------
    Material

    Raises
    ------
    InputError
        With the constant that is missing, unknown or out of range.

    Examples
    --------
    >>> from_constants(constants_of(STEEL) | {"shear_strength": 5e8}).hardness > 1e9
    True
    """
    given = {"name": name, **constants}
    if "kind" not in given:
        raise InputError(
            "kind: is required; must be one of "
            + ", ".join(f'"{kind}"' for kind in KINDS)
        )
    require_choice("kind", given.pop("kind"), tuple(KINDS))
    if not isinstance(given["name"], str):
        raise InputError(f"name = {shown(given['name'])}: must be text")
    found: Material = _made(KINDS[constants["kind"]], given)
    return found


def constants_of(material: Material) -> dict[str, Any]:
    """The constants of which `from_constants` makes a material."""
    kind = next(kind for kind, made in KINDS.items() if isinstance(material, made))
    return {"kind": kind} | {
        key: value
        for key, value in dataclasses.asdict(material).items()
        if value is not None
    }


_PARTS: dict[str, type] = {
    "delay": ArrheniusTime,
    "aging": ActivatedAging,
    "rate": ArrheniusRate,
}


def _made(of: Any, given: dict[str, Any]) -> Any:
    """A dataclass from its fields by name."""
    fields = {field.name: field for field in dataclasses.fields(of)}
    for name in given:
        if name not in fields:
            raise InputError(
                f"{name}: unknown constant; {meant(name, fields) or 'known here: ' + ', '.join(fields)}"
            )
    required = [
        name for name, field in fields.items() if field.default is dataclasses.MISSING
    ]
    missing = ", ".join(name for name in required if name not in given)
    if missing:
        raise InputError(f"{missing}: required, in SI units")
    values = dict(given)
    for name in _PARTS.keys() & given.keys():
        if not isinstance(given[name], dict):
            raise InputError(
                f"{name} = {shown(given[name])}: must be a section of constants"
            )
        with under(name):
            values[name] = _made(_PARTS[name], given[name])
    return of(**values)


def omcts_film(layers: int) -> LubricantIslands:
    """Octamethylcyclotetrasiloxane as in figure A05: h = n_l 8.75 A, sigma_* = 4e6
    exp(-1.5 n_l) Pa.

    That is 2e5 Pa for two layers and 1e4 Pa for four, while the preset, as in the
    paper's text, has 2e5 Pa for four.

    Parameters
    ----------
    layers : int
        n_l, molecular layers, from 1 to 100.
    """
    require_integer("layers", layers, 1, 100)
    return dataclasses.replace(
        OCTAMETHYLCYCLOTETRASILOXANE,
        name=f"octamethylcyclotetrasiloxane, {layers} layers",
        thickness=layers * 8.75e-10,
        shear_strength=4e6 * math.exp(-1.5 * layers),
    )


class Parameter(NamedTuple):
    """A number of a material: its usual name, value, SI unit and meaning."""

    name: str
    value: float
    unit: str
    meaning: str


_UNITS = {
    "density": "kg/m^3",
    "young_modulus": "Pa",
    "contact_radius": "m",
    "thickness": "m",
    "spacing": "m",
    "gamma_c": "",
}


def parameters(
    material: Material, temperature: float = ROOM_TEMPERATURE
) -> list[Parameter]:
    """The material's constants and what follows from them at `temperature` (K). Raises
    InputError."""
    names = [
        field.name for field in dataclasses.fields(material) if field.name in _UNITS
    ]
    only_annealed = (
        f"crossover velocity of the annealed ensemble ({equation('nt12')}); "
        "quenched contacts have none there"
    )
    return [
        *(
            Parameter(name, getattr(material, name), _UNITS[name], "given")
            for name in names
        ),
        Parameter("kT", BOLTZMANN * temperature, "J", "temperature"),
        Parameter("k", material.stiffness, "N/m", "stiffness of a contact"),
        Parameter("x_*", material.x_star, "m", "threshold scale, k x_* = a^2 sigma_*"),
        Parameter("omega", material.attempt_frequency, "1/s", "attempt frequency"),
        Parameter("1/a^2", material.contacts_per_area, "1/m^2", "contacts per area"),
        *_elastic_lengths(material),
        Parameter(
            "b", material.b(temperature), "", f"k x_*^2/(2 kT) ({equation('nt08a')})"
        ),
        Parameter(
            "v_*", material.crossover_velocity(temperature), "m/s", only_annealed
        ),
        Parameter(
            "sigma_*",
            material.shear_strength,
            "Pa",
            "shear stress = sigma_* friction/x_*",
        ),
        *_hardness(material),
    ]


def _hardness(material: Material) -> list[Parameter]:
    if material.hardness is None:
        return []
    return [
        Parameter(
            "H", material.hardness, "Pa", f"{_origin(material)}; mu = shear stress/H"
        )
    ]


def _origin(material: Material) -> str:
    given = getattr(material, "indentation_hardness", None)
    return (
        "hardness, given"
        if given
        else "hardness of plastic contacts, 3 sqrt(3) sigma_*"
    )


def _elastic_lengths(material: Material) -> list[Parameter]:
    """lambda_c beside a, and what follows, if the modulus is known."""
    length, a = material.elastic_length, material.spacing_of_contacts
    if length is None:
        return []
    where = "already between neighbours" if length < a else "beyond it"
    said = f"elastic correlation length, a^2 E/k = {length / a:.2g} a: the rigid slider is doubtful {where}"
    return [
        Parameter("a", a, "m", "distance between neighbouring contacts"),
        Parameter("lambda_c", length, "m", said),
    ]


_RUN_FILE = """title = {title}
disorder = "{contacts.disorder}"

[units]
length = "m"
time = "s"
force = "N"

[interface]
contacts_per_area = {per_area}  # 1/m^2
{load}

[contacts]
count = {contacts.count}
stiffness = {contacts.stiffness}  # N/m
stiffness_law = "{contacts.stiffness_law}"

[thresholds]
n = {contacts.thresholds.n}
x_star = {contacts.thresholds.x_star}  # m

[thermal]
kT = {contacts.thermal.kT}  # J, {temperature:.4g} K
attempt_frequency = {contacts.thermal.attempt_frequency}  # 1/s
"""
_AGING = """
[aging]
rule = "{contacts.aging.rule}"
rate = {contacts.aging.rate}  # m^2/s
x_star_final = {contacts.aging.x_star_final}  # m
"""
_DELAY = """
[delay]
time = {contacts.delay.time}  # s
"""
_DRIVE = """
[drive]
velocity = {drive.velocity}  # m/s
distance = {drive.distance}  # m

[sweep]
"drive.velocity" = {{ log = [1e{low}, 1e{high}, 21] }}  # m/s
"""


def run_file_text(
    material: Material,
    temperature: float = ROOM_TEMPERATURE,
    velocity: float | None = None,
    *,
    disorder: Disorder = "quenched",
    stiffness_law: StiffnessLaw = "uniform",
    count: int = 100_000,
) -> str:
    """A run file of `material.ensemble(...)` over 20 x_*, with a sweep of five decades
    of velocity around its own.

    It loads to the same numbers, to the last bit.

    Parameters
    ----------
    velocity : float, optional
        m/s; default: v_* at room temperature, whatever `temperature` is.
    material, temperature, disorder, stiffness_law, count
        As in `Material.ensemble`.

    Returns
    -------
    str
        TOML, SI units.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> print(run_file_text(STEEL)[:15])
    title = "steel"
    """
    contacts = material.ensemble(
        temperature, disorder=disorder, stiffness_law=stiffness_law, count=count
    )
    wanted = _decimal(material.crossover_velocity()) if velocity is None else velocity
    drive = Drive(wanted, _decimal(20.0 * material.x_star))
    title, load = (
        json.dumps(material.name, ensure_ascii=False),
        "# normal_stress = 1e6  # Pa, for a friction coefficient",
    )
    if material.hardness is not None:
        load = f"normal_stress = {material.hardness:.4g}  # Pa, {_origin(material)}"
    decade = math.floor(math.log10(drive.velocity))
    sections = (
        _RUN_FILE
        + (_AGING if material.aging else "")
        + (_DELAY if material.delay else "")
        + _DRIVE
    )
    numbers = {
        "per_area": f"{material.contacts_per_area:.12g}",
        "load": load,
        "contacts": contacts,
        "drive": drive,
        "temperature": temperature,
        "low": decade - 2,
        "high": decade + 3,
    }
    return sections.format(title=title, **numbers)
