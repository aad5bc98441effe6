"""Contacts and sizes that are timed: k = omega = x_* = 1 and n = 1 at v = 0.01, cold
and warm, plain and general."""

from dataclasses import dataclass
from typing import Literal

from eqsim import Delay, Ensemble, Thermal

VELOCITY = 0.01
DELAY = 20.0  # tau of the general case: contacts stay detached over 0.2 x_*


@dataclass(frozen=True)
class Case:
    """One kind of contacts. If `general`, k_i ~ sqrt(f_si) and there is a fixed delay;
    otherwise k is uniform, without delay."""

    kT: float
    barrier: str
    general: bool

    @property
    def name(self) -> str:
        contacts = "sqrt k, delay" if self.general else "uniform k"
        return (
            f"{self.barrier} kT={self.kT:g}, {contacts}"
            if self.kT
            else f"T=0, {contacts}"
        )

    @property
    def stiffness_law(self) -> Literal["sqrt", "uniform"]:
        return "sqrt" if self.general else "uniform"

    @property
    def delay(self) -> float:
        """v tau."""
        return VELOCITY * DELAY if self.general else 0.0

    def ensemble(self, count: int) -> Ensemble:
        thermal, delay = (
            Thermal(kT=self.kT, barrier=self.barrier),
            Delay(DELAY if self.general else 0.0),
        )
        return Ensemble(
            thermal=thermal, delay=delay, count=count, stiffness_law=self.stiffness_law
        )


CASES = [
    Case(kT, barrier, general)
    for kT, barrier in ((0.0, "soft"), (0.1, "soft"), (0.1, "stiff"))
    for general in (False, True)
]


@dataclass(frozen=True)
class Sizes:
    """Sizes that are timed; lengths in x_*. Rival A gets fewer contacts, over a shorter
    distance."""

    contacts: int = 100_000
    distance: float = 200.0
    points: int = 4001
    stepped_contacts: int = 10_000
    stepped_distance: float = 20.0
    lives: int = 100_000_000  # of a plain steady average, about
    scalar_lives: int = 8_000_000  # of a plain steady average by rival B
    errors: tuple[float, ...] = (1e-3, 1e-5)  # relative, asked of the steady averages
    repeats: int = 5
    plain_repeats: int = 3
    cold_starts: int = 2
    scalar_contacts: int = 4000  # that rival B takes along a programme
    pulled_contacts: int = 100_000  # behind a spring
    pulled_points: int = 61
    fits: int = 2  # rounds of each fit
    many: int = 1_000_000  # contacts whose memory is compared with that of a thousand

    @property
    def contact_steps(self) -> float:
        """Contact-steps of the whole trajectory over those that rival A does."""
        return (
            self.contacts
            * self.distance
            / (self.stepped_contacts * self.stepped_distance)
        )


QUICK = Sizes(
    3200,
    50.0,
    1001,
    1000,
    5.0,
    640_000,
    64_000,
    (1e-3, 1e-4),
    3,
    3,
    0,
    320,
    1000,
    31,
    1,
    100_000,
)
COMPILE = Sizes(320, 10.0, 11, 10, 1.0, 6400, 320, (1e-2,), 1, 1, 0, 32, 32, 5, 1, 2000)
