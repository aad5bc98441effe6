"""What a barrier is: the rate at which heat breaks a pinned contact, its integral, and the inverse of that.

With stretch x, threshold xi and a = k_i/(2 kT), a contact that makes omega attempts per unit time breaks at the rate

    omega r,    r = p exp(-E),

E the height of the barrier over kT and p a prefactor of each law. At velocity v the hazard per unit displacement is
(omega/v) r and its integral (omega/v) H, H(x) = int_0^x r dy; a contact whose exponential clock shows c breaks where
(omega/v) H(x) = c, or at xi if that comes first. Exponents reach 1e9, so everything is done in logarithms.

A law is a NamedTuple of the numbers that kernels need, with NumPy's formulas as methods and a body of each kernel
routine below; `eqsim.laws.barrier` lists the laws.
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.tables import NO_TABLE, Array


class Numbers(NamedTuple):
    """What is declared of `Barrier` for the laws that kernels see."""

    b: float
    log_w: float


class Barrier:
    """Formulas of a barrier for NumPy: arrays of any shape that broadcast. Lengths are in units of `law.scale`.

    Attributes
    ----------
    b : float
        k x_*^2/(2 kT) (nt08a); a contact of relative stiffness k_i/k has a = b k_i/k.
    log_w : float
        ln(omega x_*/v), attempts while the slider moves by one unit of length.
    """

    __slots__ = ()
    thermal: ClassVar[bool] = True  # whether heat breaks contacts at all
    flat_out: ClassVar[float] = 1e16  # b above which a quenched contact breaks at its threshold, to 1e-10
    b: float
    log_w: float

    @classmethod
    def exponent(cls, gap: Any, total: Any, xi: Any, a: Any) -> Array:
        """E at stretch x of a contact of threshold xi, given gap = xi - x and total = xi + x, which some callers know
        without cancellation."""
        raise NotImplementedError

    @classmethod
    def log_prefactor(cls, gap: Any, xi: Any) -> Any:
        """ln p; 0 unless a law says otherwise."""
        return 0.0

    @classmethod
    def log_attempt(cls, gap: Any, total: Any, xi: Any, a: Any) -> Array:
        """ln r, arguments as in `exponent`."""
        return np.asarray(cls.log_prefactor(gap, xi) - cls.exponent(gap, total, xi, a))

    @classmethod
    def log_rate(cls, x: Any, xi: Any, a: Any) -> Array:
        """ln r at stretch 0 <= x < xi."""
        return cls.log_attempt(xi - x, xi + x, xi, a)

    @classmethod
    def log_hazard(cls, x: Any, xi: Any, a: Any) -> Array:
        """ln H(x), 0 < x <= xi."""
        raise NotImplementedError

    def whole_hazard(self, xi: Array, stiffness: Array) -> Array:
        """(omega/v) H(xi) of contacts of relative stiffness `stiffness`; beyond e^7 about as much as that."""
        return np.exp(np.minimum(self.log_hazard(xi, xi, self.b * stiffness) + self.log_w, 7.0))

    # Where to look: only panels and grids depend on the following, which a law may replace by closed forms.

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        """Distance xi - y above a stretch y at which E is about `exponent`, for contacts of the same a."""
        size = np.broadcast(exponent, y, a)
        low, high = np.full(size.shape, -40.0), np.full(size.shape, 20.0)  # ln of it over y
        for _ in range(20):
            middle = 0.5 * (low + high)
            gap = y * np.exp(middle)
            far = cls.exponent(gap, gap + 2 * y, y + gap, a) > exponent
            low, high = np.where(far, low, middle), np.where(far, middle, high)
        return np.asarray(y * np.exp(high))

    @classmethod
    def layer(cls, x: float, a: float) -> float:
        """Distance from the threshold, over x, within which the rate falls by a factor e at stretch x."""
        return float(cls.width(1.0, x, a)) / x

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        """About the stretch at which ln((omega/v) H) passes each of `levels`, shape (n, levels), of n contacts."""
        low, high = np.full((xi.size, levels.size), -700.0), np.zeros((xi.size, levels.size))
        for _ in range(20):
            middle = 0.5 * (low + high)
            early = self.log_hazard(xi[:, None] * np.exp(middle), xi[:, None], a[:, None]) + self.log_w < levels
            low, high = np.where(early, middle, low), np.where(early, high, middle)
        return np.asarray(xi[:, None] * np.exp(high))

    @classmethod
    def table(cls) -> Array:
        """What `stretch` looks up, if anything."""
        return NO_TABLE

    @classmethod
    def hazard_table(cls) -> Array:
        """What `hazard` looks up, if anything."""
        return NO_TABLE


# --------------------------------------------------------------------------------------------------------- kernels


@by_law
def thermal(law: Any) -> bool:
    """Whether heat breaks contacts."""
    return True


@by_law
def height(law: Any, xi: float, x: float, a: float) -> float:
    """E at threshold xi and stretch x; 0 where xi < x."""
    return math.inf


@by_law
def height_slope(law: Any, xi: float, x: float, a: float) -> float:
    """dE/dxi at fixed a."""
    return 0.0


@by_law
def prefactor(law: Any, xi: float, x: float) -> float:
    """p."""
    return 1.0


@by_law
def path_step(law: Any) -> float:
    """Share of the usual step that the path of a fluctuating threshold may take."""
    return 1.0


@by_law
def stretch(law: Any, table: Array, xi: float, stiffness: float, clock: float) -> float:
    """Where a contact of threshold `xi` and relative stiffness `stiffness` breaks whose clock shows `clock`."""
    return xi


@by_law
def hazard(law: Any, table: Array, xi: float, stiffness: float, x: float) -> float:
    """(omega/v) H at stretch 0 <= x <= xi; the inverse of `stretch`."""
    raise TypeError("this barrier has no hazard")


@by_law
def hazard_between(law: Any, table: Array, xi: float, stiffness: float, x: float, other: float) -> float:
    """(omega/v) (H(other) - H(x)), 0 <= x, other <= xi; soft and stiff: to 1e-8 of itself however short."""
    return hazard(law, table, xi, stiffness, other) - hazard(law, table, xi, stiffness, x)


@by_law
def rate(law: Any, xi: float, stiffness: float, x: float) -> float:
    """(omega/v) r at stretch 0 <= x <= xi."""
    return math.exp(law.log_w - height(law, xi, x, law.b * stiffness)) * prefactor(law, xi, x)


@by_law
def onward(law: Any, c: Any, xi: float, stiffness: float, y: float, clock: float) -> float:
    """How far a contact of threshold `xi` and relative stiffness `stiffness` is carried from stretch 0 < y < xi before
    it breaks, whose clock has `clock` left; to 1e-8 of itself, however short. `c` holds the tables."""
    return xi - y


@by_law
def back(law: Any, c: Any, xi: float, stiffness: float, y: float, clock: float) -> tuple[float, float]:
    """How far it is carried from stretch -y < 0 before it breaks, up to stretch 0, and what the clock has left there,
    less than 0 if it breaks before."""
    return y, clock


@routine
def travel(c: Any, xi: float, stiffness: float, y: float, clock: float) -> float:
    """How far a contact born at stretch y is carried before it breaks; `c` is an `engine.contacts.Contacts`."""
    if y > 0.0:
        return onward(c.barrier, c, xi, stiffness, y, clock)
    if y < 0.0:
        s, clock = back(c.barrier, c, xi, stiffness, -y, clock)
        if clock < 0.0:
            return s
    return -y + stretch(c.barrier, c.barrier_table, xi, stiffness, clock)


@by_law
def stretches(law: Any, table: Array, springs: Any, r: int, lives: Any, row: Array, count: int) -> None:
    """`stretch` of `count` contacts in the place of their thresholds `lives.stretch[r]`. Clocks are overwritten, `row`
    is scratch."""
    x, stiffness, clock = lives.stretch, lives.stiffness, lives.clock
    for i in range(count):
        x[r, i] = stretch(law, table, x[r, i], stiffness[r, i], clock[r, i])
