"""Temperature, attempt frequency and barrier of thermally activated breaking."""

from dataclasses import dataclass

from eqsim.errors import NOT_NEGATIVE, require_choice, require_number
from eqsim.laws.barrier import BARRIERS


@dataclass(frozen=True)
class Thermal:
    """Thermally activated breaking.

    Raises InputError for negative or non-finite values and an unknown barrier.

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

    Examples
    --------
    >>> Thermal(kT=0.1, attempt_frequency=10.0)
    Thermal(kT=0.1, attempt_frequency=10.0, barrier='soft')
    """

    kT: float = 0.0
    attempt_frequency: float = 1.0
    barrier: str = "soft"

    def __post_init__(self) -> None:
        require_number("kT", self.kT, **NOT_NEGATIVE)
        require_number("attempt_frequency", self.attempt_frequency, **NOT_NEGATIVE)
        require_choice("barrier", self.barrier, tuple(BARRIERS))
