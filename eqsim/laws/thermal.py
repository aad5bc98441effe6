"""Temperature, attempt frequency and barrier of thermally activated breaking."""

import math
from dataclasses import dataclass, field, fields

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_number,
    shown,
    under,
)
from eqsim.laws.barrier import BARRIERS


def _require_force(name: str, value: float) -> None:
    """Raise InputError unless a scale of force is > 0; infinite, nothing depends on
    it."""
    if value != math.inf:
        require_number(name, value, **POSITIVE)


@dataclass(frozen=True)
class Pathway:
    """One of the two ways in which a catch-slip bond opens.

    Raises InputError for values out of range.

    Parameters
    ----------
    rate : float
        Off-rate at zero force (1/time).
    force : float
        Force that changes it by a factor of e, > 0; infinite if none does.

    Examples
    --------
    >>> Pathway(rate=10.0, force=1.0)
    Pathway(rate=10.0, force=1.0)
    """

    rate: float
    force: float

    def __post_init__(self) -> None:
        require_number("rate", self.rate, **NOT_NEGATIVE)
        _require_force("force", self.force)


@dataclass(frozen=True)
class Thermal:
    """Thermally activated breaking.

    Raises InputError for values out of range, an unknown barrier, and what it does not
    take or lacks.

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
        Or a bond whose rate depends on its force f alone: "bell", off_rate
        exp(f/force_scale), or "catch-slip", catch.rate exp(-f/catch.force) + slip.rate
        exp(f/slip.force). These take neither kT nor attempt_frequency.
    off_rate : float, optional
        Of "bell": rate at zero force (1/time).
    force_scale : float, optional
        Of "bell": force that raises it by a factor of e; infinite for a constant rate.
    catch, slip : Pathway, optional
        Of "catch-slip".

    Examples
    --------
    >>> heat = Thermal(kT=0.1, attempt_frequency=10.0)
    >>> bond = Thermal(barrier="bell", off_rate=0.1, force_scale=2.0)
    """

    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: str = "soft"
    off_rate: float | None = field(default=None, repr=False)
    force_scale: float | None = field(default=None, repr=False)
    catch: Pathway | None = field(default=None, repr=False)
    slip: Pathway | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        require_number("kT", self.kT, **NOT_NEGATIVE)
        require_number("attempt_frequency", self.attempt_frequency, **NOT_NEGATIVE)
        require_choice("barrier", self.barrier, tuple(BARRIERS))
        taken = BARRIERS[self.barrier].keys
        for one in fields(self):
            value, wrong = getattr(self, one.name), f'with barrier = "{self.barrier}"'
            if one.name in taken:
                if value is None:
                    raise InputError(f"{one.name}: is required {wrong}")
            elif one.name != "barrier" and value != one.default:
                raise InputError(f"{one.name} = {shown(value)}: not allowed {wrong}")
        for name in ("catch", "slip"):
            value = getattr(self, name)
            if isinstance(value, dict):
                with under(name):
                    object.__setattr__(self, name, Pathway(**value))
            elif not isinstance(value, Pathway | None):
                raise InputError(f"{name} = {shown(value)}: must be Pathway(...)")
        if self.off_rate is not None and self.force_scale is not None:
            require_number("off_rate", self.off_rate, **NOT_NEGATIVE)
            _require_force("force_scale", self.force_scale)

    @property
    def active(self) -> bool:
        """True if heat breaks contacts."""
        _, rate, *_ = BARRIERS[self.barrier].numbers(self, 1.0, 1.0)
        return rate > 0.0 and (self.kT > 0.0 or BARRIERS[self.barrier].by_force)
