"""Temperature, attempt frequency and barrier of thermally activated breaking."""

from dataclasses import dataclass, fields
from typing import NamedTuple

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_number,
    require_number_or_infinity,
    shown,
    under,
)
from eqsim.laws.barrier import BARRIERS


class Pathway(NamedTuple):
    """Way in which a catch-slip bond opens.

    `Thermal` raises InputError unless both are > 0.

    Attributes
    ----------
    rate : float
        At zero force (1/time).
    force : float
        Force that changes the rate by e (force), infinite if none does.

    Examples
    --------
    >>> Pathway(rate=10.0, force=1.0)
    Pathway(rate=10.0, force=1.0)
    """

    rate: float
    force: float


@dataclass(frozen=True, repr=False)
class Thermal:
    """Thermally activated breaking.

    Raises InputError for values out of range, an unknown barrier, and what the barrier
    does not take or lacks.

    Parameters
    ----------
    kT : float
        Temperature (energy); 0 switches heat off.
    attempt_frequency : float
        omega (1/time).
    barrier : str
        Barrier that heat has to overcome, one of `eqsim.laws.barrier.BARRIERS`: "soft"
        or "stiff", those behind eqs. (18) and (19) of Braun and Peyrard (2011), or
        "cusp". Stiff and cusp are nu = 2/3 and 1/2 of Dudko, Hummer and Szabo (2006).
        Or a bond whose rate depends on its force f alone, and takes neither kT nor
        attempt_frequency: "bell", off_rate exp(f/force_scale), or "catch-slip",
        catch.rate exp(-f/catch.force) + slip.rate exp(f/slip.force).
    off_rate, force_scale : float, optional
        Of "bell" (1/time, force); an infinite scale makes the rate constant.
    catch, slip : Pathway, optional
        Of "catch-slip".

    Examples
    --------
    >>> Thermal(kT=0.1, attempt_frequency=10.0)
    Thermal(kT=0.1, attempt_frequency=10.0, barrier='soft')
    >>> Thermal(barrier="bell", off_rate=0.1, force_scale=2.0)
    Thermal(force_scale=2.0, off_rate=0.1, barrier='bell')
    """

    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: str = "soft"
    off_rate: float | None = None
    force_scale: float | None = None
    catch: Pathway | None = None
    slip: Pathway | None = None

    def __post_init__(self) -> None:
        require_number("kT", self.kT, **NOT_NEGATIVE)
        require_number("attempt_frequency", self.attempt_frequency, **NOT_NEGATIVE)
        require_choice("barrier", self.barrier, tuple(BARRIERS))
        taken = (*BARRIERS[self.barrier].keys, "barrier")
        for key in fields(self):
            value, said = getattr(self, key.name), f'with barrier = "{self.barrier}"'
            if key.name in taken and value is None:
                raise InputError(f"{key.name}: is required {said}")
            if key.name not in taken and value != key.default:
                raise InputError(f"{key.name} = {shown(value)}: not allowed {said}")
        for name in ("catch", "slip"):
            path = getattr(self, name)
            if path is not None:
                if not isinstance(path, Pathway):
                    raise InputError(f"{name} = {shown(path)}: must be Pathway(...)")
                with under(name):
                    _check_bond("rate", path.rate, "force", path.force)
        if self.off_rate is not None and self.force_scale is not None:
            _check_bond("off_rate", self.off_rate, "force_scale", self.force_scale)

    def __repr__(self) -> str:
        names = (*BARRIERS[self.barrier].keys, "barrier")
        return f"Thermal({', '.join(f'{n}={getattr(self, n)!r}' for n in names)})"

    @property
    def active(self) -> bool:
        """True if heat breaks contacts."""
        law = BARRIERS[self.barrier]
        return law.numbers(self, 1.0, 1.0)[1] > 0.0 and (self.kT > 0.0 or law.by_force)


def _check_bond(name: str, rate: float, of: str, force: float) -> None:
    """Raise InputError unless a rate and a scale of force are in range."""
    require_number(name, rate, **NOT_NEGATIVE)
    require_number_or_infinity(of, force, **POSITIVE)
