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
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, cast

from scipy import constants

from eqsim.errors import (
    NOT_NEGATIVE,
    Checked,
    InputError,
    NotNegative,
    Positive,
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
# Presets, what `parameters` shows, and the run file.
_FILE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def _decimal(value: float) -> float:
    """Round to 15 digits, all that every decimal number keeps as a float: 0.4 and not
    0.39999999999999997."""
    return float(f"{value:.15g}")


@dataclass(frozen=True)
class _Arrhenius(Checked):
    prefactor: Positive
    energy: NotNegative = 0.0

    def _exponent(self, temperature: float) -> float:
        """E/(k_B T); infinite at T = 0."""
        require_number("temperature", temperature, **NOT_NEGATIVE)
        thermal = BOLTZMANN * temperature
        if thermal > 1e-300 * self.energy:
            return self.energy / thermal
        return math.inf if self.energy else 0.0


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
        """tau (s) at `temperature` (K). Raises InputError where it is beyond
        1e100 s."""
        exponent = self._exponent(temperature)
        if math.log(self.prefactor) + exponent > math.log(1e100):
            said = "too low for the activated time, which exceeds 1e100 s"
            raise InputError(f"temperature = {temperature!r}: {said}")
        return self.prefactor * math.exp(exponent)


class ArrheniusRate(_Arrhenius):
    """A rate that thermal activation raises, D(T) = prefactor exp(-energy/(k_B T)): as
    `ArrheniusTime`, with a `prefactor` in m^2/s for an aging rate."""

    def value(self, temperature: float) -> float:
        """D (m^2/s) at `temperature` (K)."""
        return self.prefactor * math.exp(-self._exponent(temperature))


@dataclass(frozen=True)
class ActivatedAging(Checked):
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
        super().__post_init__()
        self.at(0.0)

    def at(self, temperature: float) -> Aging:
        """The aging law at `temperature` (K)."""
        return Aging(self.rule, self.rate.value(temperature), self.x_star_final)


@dataclass(frozen=True, kw_only=True)
class Material(Checked):
    """An interface; what those of this module share.

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

    Attributes
    ----------
    stiffness, x_star, attempt_frequency : float
        k (N/m), the threshold scale x_* (m), and omega (1/s).
    contacts_per_area : float
        1/a^2 (1/m^2).
    elastic_modulus, hardness : float or None
        E of the bodies that the contacts join, and the normal stress that the contacts
        carry (Pa); None where they are not known.
    """

    stiffness: ClassVar[Any]
    x_star: ClassVar[Any]
    attempt_frequency: ClassVar[Any]
    contacts_per_area: ClassVar[Any]
    elastic_modulus: ClassVar[Any] = None
    hardness: ClassVar[Any] = None
    name: str
    density: float
    shear_strength: float
    delay: ArrheniusTime | None = None
    aging: ActivatedAging | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            required = value is not None or field.default is not None
            if field.name not in ("name", "delay", "aging") and required:
                require_number(field.name, value, above=0, least=1e-30, most=1e30)

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
        require_number("temperature", temperature, **NOT_NEGATIVE)
        kT, omega = BOLTZMANN * temperature, self.attempt_frequency
        newborn = Ensemble(
            Gamma(1.0, _decimal(self.x_star)),
            Thermal(_decimal(kT), _decimal(omega)),
            count=count,
            stiffness=_decimal(self.stiffness),
            stiffness_law=stiffness_law,
            disorder=disorder,
        )
        delay = Delay() if self.delay is None else Delay(self.delay.value(temperature))
        aging = Aging() if self.aging is None else self.aging.at(temperature)
        with under("aging"):
            return dataclasses.replace(newborn, delay=delay, aging=aging)

    def _newborn(self, temperature: float) -> Ensemble:
        """Contacts without delay and aging, which have no part in b and v_*."""
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
        """H as given, or 3 sqrt(3) sigma_* (Pa) of plastic contacts: three times the
        yield stress (Tabor), which is sqrt(3) times that in shear (von Mises)."""
        return self.indentation_hardness or 3.0 * math.sqrt(3.0) * self.shear_strength

    @property
    def elastic_modulus(self) -> float:
        """E of the asperities: the two are of one material."""
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
        kT = self._newborn(temperature).thermal.kT
        film = self.thickness * self.density * self.shear_strength
        return kT / (self.spacing**2 * math.sqrt(self.spacing * film * self.gamma_c**3))


KINDS: dict[str, type[Material]] = {"rough": RoughContacts, "islands": LubricantIslands}


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
        kinds = ", ".join(f'"{kind}"' for kind in KINDS)
        raise InputError(f"kind: is required; must be one of {kinds}")
    require_choice("kind", given.pop("kind"), tuple(KINDS))
    if not isinstance(given["name"], str):
        raise InputError(f"name = {shown(given['name'])}: must be text")
    found: Material = _made(KINDS[constants["kind"]], given)
    return found


def constants_of(material: Material) -> dict[str, Any]:
    """The constants of which `from_constants` makes a material."""
    kind = next(kind for kind, made in KINDS.items() if isinstance(material, made))
    given = dataclasses.asdict(material).items()
    return {"kind": kind} | {key: value for key, value in given if value is not None}


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
            hint = meant(name, fields) or "known here: " + ", ".join(fields)
            raise InputError(f"{name}: unknown constant; {hint}")
    missing = [
        name
        for name, field in fields.items()
        if field.default is dataclasses.MISSING and name not in given
    ]
    if missing:
        raise InputError(f"{', '.join(missing)}: required, in SI units")
    values = dict(given)
    for name in _PARTS.keys() & given.keys():
        if not isinstance(given[name], dict):
            said = "must be a section of constants"
            raise InputError(f"{name} = {shown(given[name])}: {said}")
        with under(name):
            values[name] = _made(_PARTS[name], given[name])
    return of(**values)


MATERIALS: dict[str, Material] = {
    name: from_constants(constants, name)
    for name, constants in _FILE["presets"].items()
}
ALIASES = {"omcts": "octamethylcyclotetrasiloxane"}
STEEL = cast(RoughContacts, MATERIALS["steel"])
OCTAMETHYLCYCLOTETRASILOXANE = cast(LubricantIslands, MATERIALS[ALIASES["omcts"]])


def preset(name: str) -> Material | None:
    """The material of `MATERIALS` with this name or alias, in upper or lower case; None
    if there is none."""
    lower = name.lower()
    return MATERIALS.get(ALIASES.get(lower, lower))


def omcts_film(layers: int) -> LubricantIslands:
    """Octamethylcyclotetrasiloxane as in figure A05: h = n_l 8.75 A, sigma_* = 4e6
    exp(-1.5 n_l) Pa.

    That is 2e5 Pa for two layers and 1e4 Pa for four, while the preset, as in the
    paper's text, has 2e5 Pa for four.

    Parameters
    ----------
    layers : int
        n_l, molecular layers, from 1 to 50.
    """
    require_integer("layers", layers, 1, 50)
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


def parameters(
    material: Material, temperature: float = ROOM_TEMPERATURE
) -> list[Parameter]:
    """The material's constants and what follows from them at `temperature` (K). Raises
    InputError."""
    length, a, found = material.elastic_length, material.spacing_of_contacts, []
    size = math.nan if length is None else length / a
    numbers = {"kT": BOLTZMANN * temperature, "a": None if length is None else a}
    words = {
        "size": size,
        "where": "already between neighbours" if size < 1.0 else "beyond it",
        "hardness": _origin(material),
        "nt08a": equation("nt08a"),
        "nt12": equation("nt12"),
    }
    for name, (attribute, unit, meaning) in _FILE["parameters"].items():
        value = numbers.get(name, getattr(material, attribute, None))
        value = value(temperature) if callable(value) else value
        if value is not None:
            found.append(Parameter(name, value, unit, meaning.format(**words)))
    return found


def _origin(material: Material) -> str:
    """The source of the hardness of a material."""
    if getattr(material, "indentation_hardness", None):
        return "hardness, given"
    return "hardness of plastic contacts, 3 sqrt(3) sigma_*"


def run_file_text(
    material: Material,
    temperature: float = ROOM_TEMPERATURE,
    velocity: float | None = None,
    *,
    disorder: Disorder = "quenched",
    stiffness_law: StiffnessLaw = "uniform",
    count: int = 100_000,
) -> str:
    """A run file (TOML, SI units) of `material.ensemble(...)` over 20 x_*, with a sweep
    of five decades of velocity around its own.

    It loads to the same numbers, to the last bit.

    Parameters
    ----------
    velocity : float, optional
        m/s; default: v_* at room temperature, whatever `temperature` is.
    material, temperature, disorder, stiffness_law, count
        As in `Material.ensemble`.

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
    load = "# normal_stress = 1e6  # Pa, for a friction coefficient"
    if material.hardness is not None:
        load = f"normal_stress = {material.hardness:.4g}  # Pa, {_origin(material)}"
    decade = math.floor(math.log10(drive.velocity))
    missing = {name for name in ("aging", "delay") if getattr(material, name) is None}
    sections = (text for name, text in _FILE["run_file"].items() if name not in missing)
    return "".join(sections).format(
        title=json.dumps(material.name, ensure_ascii=False),
        per_area=f"{material.contacts_per_area:.12g}",
        load=load,
        contacts=contacts,
        drive=drive,
        temperature=temperature,
        low=decade - 2,
        high=decade + 3,
    )
