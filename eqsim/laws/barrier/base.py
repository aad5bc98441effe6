"""Barriers: the rate at which heat breaks a pinned contact, the hazard, which is its
integral, and the inverse of the hazard.

With stretch x, threshold xi and a = k_i/(2 kT), a contact that makes omega attempts per
unit time breaks at the rate

    omega r,    r = p exp(-E),

E the height of the barrier over kT and p a prefactor of each law. At velocity v the
hazard per unit displacement is (omega/v) r and its integral (omega/v) H, H(x) = int_0^x
r dy. A contact draws an exponential clock c ~ Exp(1) and breaks where (omega/v) H(x) =
c, or at xi if that comes first. Exponents reach 1e9, so everything is done in
logarithms.

A law is a NamedTuple of the numbers that kernels need, with formulas as methods and
bodies of the kernel routines below; `eqsim.laws.barrier` lists the laws. Every law has
`exponent` and `log_hazard`, and `prefactor` if p is not 1. From these the other routines
follow numerically; bodies of their own, where there are closed forms, are faster.
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.laws.law import Law
from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import Bracket, bisected, narrowed
from eqsim.numerics.tables import NO_TABLE, Array

_CELL_NODES, _CELL_WEIGHTS = gauss_legendre(8)
SHORT_WAY = gauss_legendre(10)  # along a way on which E changes by less than 1
_CELL_RANGE = 2.0  # change of E in a cell for which 8 nodes are good to 1e-12
# cells whose E exceeds the least E at an end of the interval by so much are left out
_NEGLIGIBLE_CELL = 40.0
_COARSEST = 3  # halvings before a cell may be left out: E may have its minimum inside
_MOST_HALVINGS = 60  # halvings of the interval; in finer cells only rounding varies


class Numbers(NamedTuple):
    """Fields of barriers with heat, see `Barrier`."""

    b: float
    log_w: float


class Barrier(Law):
    """Base of all barriers: formulas for NumPy arrays of any shape that broadcast.
    Lengths are in units of the scale of the threshold law.

    Attributes
    ----------
    b : float
        k x_*^2/(2 kT) (nt08a); a contact of relative stiffness k_i/k has a = b k_i/k.
    log_w : float
        ln(omega x_*/v), attempts while the slider moves by one unit of length.
    """

    __slots__ = ()
    thermal: ClassVar[bool] = True  # heat breaks contacts
    # b above which a quenched contact breaks at its threshold, to 1e-10
    flat_out: ClassVar[float] = 1e16
    # the rate depends on the force alone, not on the threshold (`bell.ByForce`)
    by_force: ClassVar[bool] = False
    # fields of `eqsim.Thermal` that b and omega are made of
    keys: ClassVar[tuple[str, ...]] = ("kT", "attempt_frequency")
    b_words: ClassVar[str] = "k x_*^2/(2 kT)"
    b: float
    log_w: float

    def __init_subclass__(cls) -> None:
        """Compile the formulas of a law for kernels, too."""
        super().__init_subclass__()
        if not cls.thermal:
            return
        exponent = routine(inline=True)(cls.exponent)
        factor = routine(inline=True)(cls.prefactor)

        @height.register(cls)
        def _height(law: Any, xi: float, x: float, a: float) -> Any:
            return exponent(max(xi - x, 0.0), xi + x, xi, a)

        @prefactor.register(cls)
        def _prefactor(law: Any, xi: float, x: float) -> Any:
            return factor(max(xi - x, 0.0), xi)  # a stretch may round to more

    @classmethod
    def numbers(cls, thermal: Any, stiffness: float, unit: float) -> tuple[float, ...]:
        """b, omega (1/time) and whatever else the law has, of an `eqsim.Thermal`, the
        stiffness k and a unit of length."""
        energy, kT = 0.5 * stiffness * unit * unit, thermal.kT
        b = energy / kT if kT > energy * 1e-300 else math.inf
        return b, thermal.attempt_frequency

    @classmethod
    def declared(
        cls, thermal: Any, stiffness: float, unit: float, velocity: float
    ) -> tuple[float, ...]:
        """Numbers for `Ensemble.declared`, products and ratios."""
        ratio = thermal.kT / (stiffness * unit * unit)
        return ratio, thermal.attempt_frequency * unit / velocity

    @property
    def lasting(self) -> bool:
        """True if the rate does not vanish as contacts become stronger and stiffer."""
        return False

    def in_unit(self, unit: float) -> float:
        """b with lengths in units of `unit`."""
        return self.b * (unit if self.by_force else unit**2)

    @staticmethod
    def exponent(gap: Any, total: Any, xi: Any, a: Any) -> Any:
        """E at stretch x of a contact of threshold xi, numbers or arrays, given gap =
        xi - x and total = xi + x, which some callers know without cancellation."""
        raise NotImplementedError

    @staticmethod
    def prefactor(gap: Any, xi: Any) -> Any:
        """Prefactor p of the rate, 1 by default."""
        return 1.0

    @classmethod
    def log_prefactor(cls, gap: Any, xi: Any) -> Any:
        """ln p, -inf where p vanishes."""
        with np.errstate(divide="ignore"):
            return np.log(cls.prefactor(gap, xi))

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

    def hazard_over(self, x: Array, way: Array, xi: Array, a: Array) -> Array:
        """(omega/v) (H(x) - H(x - way)), 0 <= way <= x <= xi, arrays of one shape,
        without cancellation where the barrier hardly changes on the way."""
        ends = x, x - way
        with np.errstate(divide="ignore", invalid="ignore"):  # x = 0
            last, first = (self.log_hazard(end, xi, a) + self.log_w for end in ends)
            less = np.minimum(first - last, 0.0)  # above 0 by rounding
            found = -np.exp(np.minimum(last, 300.0)) * np.expm1(less)
        E = [self.exponent(np.maximum(xi - end, 0.0), xi + end, xi, a) for end in ends]
        short = abs(E[1] - E[0]) < 1.0
        back, weights = SHORT_WAY.between(0.0 * way[short], way[short])
        x, xi, a = (part[short, None] for part in (x, xi, a))
        log_rate = self.log_rate(x - back, xi, a) + self.log_w
        found[short] = (np.exp(np.minimum(log_rate, 300.0)) * weights).sum(axis=1)
        return np.asarray(found)

    def whole_hazard(self, xi: Array, stiffness: Array) -> Array:
        """(omega/v) H(xi) of contacts of relative stiffness `stiffness`; beyond e^7
        about as much as that."""
        log_hazard = self.log_hazard(xi, xi, self.b * stiffness) + self.log_w
        return np.exp(np.minimum(log_hazard, 7.0))

    # The following only place panels and grids; a law may replace them by closed forms.

    @classmethod
    def width(cls, exponent: Any, y: Any, a: Any) -> Array:
        """Distance xi - y above a stretch y at which E is about `exponent`, for
        contacts of the same a."""
        shape = np.broadcast(exponent, y, a).shape

        def below(log_ratio: Array) -> Array:
            gap = y * np.exp(log_ratio)
            return ~(cls.exponent(gap, gap + 2 * y, y + gap, a) > exponent)

        low, high = np.full(shape, -40.0), np.full(shape, 20.0)
        return np.asarray(y * np.exp(bisected(below, low, high, 20)[1]))

    @classmethod
    def layer(cls, x: float, a: float) -> float:
        """Distance, over x, of the threshold above stretch x at which E is about 1."""
        return float(cls.width(1.0, x, a)) / x

    def stretch_at(self, levels: Array, xi: Array, a: Array) -> Array:
        """Stretch at which ln((omega/v) H) reaches each of `levels`, shape (n, levels),
        for n contacts: closer than the layer in which they break, which may be 1e-9 of
        a threshold."""
        xi, a = xi[:, None], a[:, None]
        low = np.full((xi.size, levels.size), -700.0)

        def below(log_x: Array) -> Array:
            reached = self.log_hazard(xi * np.exp(log_x), xi, a) + self.log_w
            return np.asarray(reached < levels)

        return np.asarray(xi * np.exp(bisected(below, low, np.zeros_like(low), 48)[1]))

    def ends_of_panels(self, levels: Array, xi: Array, a: Array) -> Array:
        """Stretches between which the hazard is smooth, shape (n, ends), for n contacts:
        `layers`, and last those of `stretch_at`."""
        return np.concatenate((self.layers(xi, a), self.stretch_at(levels, xi, a)), 1)

    def layers(self, xi: Array, a: Array) -> Array:
        """Stretches on the scale of which the rate falls as the stretch grows, shape (n,
        layers), for n contacts: none but for catch bonds."""
        return np.empty((xi.size, 0))

    @classmethod
    def table(cls) -> Array:
        """Table for the routine `stretch`, empty if it needs none."""
        return NO_TABLE

    @classmethod
    def hazard_table(cls) -> Array:
        """Table for the routine `hazard`, empty if it needs none."""
        return NO_TABLE


# ---- kernels ----


@by_law
def thermal(law: Any) -> bool:
    """True if heat breaks contacts."""
    return True


@by_law
def height(law: Any, xi: float, x: float, a: float) -> float:
    """E at threshold xi and stretch x; 0 where xi < x."""
    return math.inf


@by_law
def height_slope(law: Any, xi: float, x: float, a: float) -> float:
    """dE/dxi at fixed a."""
    step = 1e-6 * xi
    return (height(law, xi + step, x, a) - height(law, xi, x, a)) / step


@by_law
def slopes(
    law: Any, xi: float, x: float, k: float, growth: float
) -> tuple[float, float, float]:
    """dE/dxi where the relative stiffness k has the slope `growth` with xi, a bound on
    the changes of E with xi and with x, per length, and the share of it that is a bound
    on those with xi."""
    a = law.b * k
    slope = height_slope(law, xi, x, a) + height(law, xi, x, a) * growth / k
    return slope, slope, 1.0


@by_law
def prefactor(law: Any, xi: float, x: float) -> float:
    """Prefactor p of the rate."""
    return 1.0


@by_law
def path_step(law: Any) -> float:
    """Factor on the usual step of the path of a fluctuating threshold."""
    return 1.0


@by_law
def stretch(law: Any, table: Array, xi: float, k: float, clock: float) -> float:
    """Stretch at which a contact breaks, born unstressed with threshold `xi`, relative
    stiffness `k` and exponential clock `clock`."""
    return carried(law, xi, k, 0.0, xi, clock, 1.0)


@by_law
def hazard(law: Any, table: Array, xi: float, k: float, x: float) -> float:
    """(omega/v) H at stretch 0 <= x <= xi; the inverse of `stretch`."""
    return mean_rate(law, table, xi, k, 0.0, x) * x


@by_law
def mean_rate(
    law: Any, table: Array, xi: float, k: float, x: float, length: float
) -> float:
    """Mean of `rate` from stretch x to x + length, both from 0 to xi, to 1e-8 of
    itself. `length` may be less than the resolution of x; where it is 0 this is the
    rate at x."""
    return averaged(law, xi, k, x, length)


@by_law
def rate(law: Any, xi: float, k: float, x: float) -> float:
    """(omega/v) r at stretch 0 <= x <= xi."""
    return math.exp(law.log_w - height(law, xi, x, law.b * k)) * prefactor(law, xi, x)


@by_law
def onward(law: Any, c: Any, xi: float, k: float, y: float, clock: float) -> float:
    """Travel of a contact of threshold `xi` and relative stiffness `k` from stretch 0 <
    y < xi until it breaks, with `clock` left of its clock; to 1e-8 of itself, however
    short. `c` is an `engine.contacts.Contacts`, for its tables."""
    return carried(law, xi, k, y, xi - y, clock, 1.0)


@by_law
def back(
    law: Any, c: Any, xi: float, k: float, y: float, clock: float
) -> tuple[float, float]:
    """Travel from stretch -y < 0 until the contact breaks, at most to 0, and the rest
    of its clock there, negative if it breaks before; arguments as in `onward`."""
    left = clock - hazard(law, c.hazard_table, xi, k, y)
    return (y, left) if left >= 0.0 else (carried(law, xi, k, y, y, clock, -1.0), -1.0)


@by_law
def averaged(law: Any, xi: float, k: float, x: float, length: float) -> float:
    """`mean_rate` of laws that need no table for it."""
    return _integrated(law, xi, k, x, length)


@routine
def _integrated(law: Any, xi: float, k: float, x: float, length: float) -> float:
    """`averaged` of any law, by Gauss-Legendre nodes in cells that are halved until E
    varies little in them. In u = sqrt(xi - x) the rate of a barrier that vanishes at
    the threshold is smooth; dx = -2 u du."""
    a = law.b * k
    far, near = math.sqrt(max(xi - x, 0.0)), math.sqrt(max(xi - x - length, 0.0))
    if far + near == 0.0:
        return rate(law, xi, k, xi)
    way = min(length / (far + near), far)  # far - near without cancellation
    left = height(law, xi, xi - far * far, a)
    right = height(law, xi, xi - near * near, a)
    least = min(left, right)
    total, level, index = 0.0, 0, 0
    while True:
        width = 0.5**level
        t = index * width
        u = far - (t + width) * way
        right = height(law, xi, xi - u * u, a)
        u = far - (t + 0.5 * width) * way
        middle = height(law, xi, xi - u * u, a)
        seen = level < _COARSEST or min(left, right) < least + _NEGLIGIBLE_CELL
        varies = max(abs(right - left), abs(middle - left), abs(middle - right))
        if seen and varies > _CELL_RANGE and level < _MOST_HALVINGS:
            level, index = level + 1, 2 * index
            continue
        if seen:
            for i in range(_CELL_NODES.size):
                u = far - (t + 0.5 * width * (1.0 + _CELL_NODES[i])) * way
                weight = 0.5 * width * _CELL_WEIGHTS[i]
                total += weight * rate(law, xi, k, xi - u * u) * u
        left, index = right, index + 1
        while index % 2 == 0 and level > 0:
            level, index = level - 1, index // 2
        if level == 0:
            return 2.0 * total / (far + near)


@routine
def carried(
    law: Any, xi: float, k: float, y: float, most: float, clock: float, sign: float
) -> float:
    """Travel from stretch y, away from 0 (`sign` 1) or towards it (-1), until the
    hazard of the travel is `clock`; at most `most`. Newton's method for the logarithm
    of the hazard, in a bracket."""
    if averaged(law, xi, k, min(y, y + sign * most), most) * most <= clock:
        return most
    bracket, now = Bracket(0.0, most), rate(law, xi, k, y)
    s = min(clock / now, most) if now > 0.0 else 0.5 * most
    for _ in range(200):
        spent = averaged(law, xi, k, min(y, y + sign * s), s) * s
        slope, guess = s * rate(law, xi, k, y + sign * s), math.nan
        if slope > 0.0 and spent > 0.0:
            guess = s * math.exp(spent / slope * math.log(clock / spent))
        bracket, step = narrowed(bracket, s, spent - clock, guess)
        if abs(step - s) <= 1e-14 * s:
            break
        s = step
    return s


@routine
def travel(c: Any, xi: float, k: float, y: float, clock: float) -> float:
    """Travel of a contact born at stretch y until it breaks; `c` is an
    `engine.contacts.Contacts`."""
    if y > 0.0:
        return onward(c.barrier, c, xi, k, y, clock)
    if y < 0.0:
        s, clock = back(c.barrier, c, xi, k, -y, clock)
        if clock < 0.0:
            return s
    return -y + stretch(c.barrier, c.barrier_table, xi, k, clock)


@by_law
def stretches(
    law: Any, table: Array, springs: Any, lives: Any, r: int, count: int
) -> None:
    """Fill the first `count` travels of round r with `stretch` of these contacts, born
    unstressed; `lives` is an `engine.lanes.Lives`."""
    for i in range(count):
        xi, k, clock = lives.threshold[r, i], lives.stiffness[r, i], lives.clock[r, i]
        lives.travel[r, i] = stretch(law, table, xi, k, clock)


def require_whole(name: str, law: Any) -> None:
    """Raise InputError unless a barrier, listed as `name`, has the formulas that every
    law needs."""
    missing = [
        formula
        for formula in ("exponent", "log_hazard")
        if not any(formula in vars(c) for c in type(law).__mro__ if c is not Barrier)
    ]
    if missing:
        raise InputError(
            f'thermal.barrier = "{name}": the law {type(law).__name__} lacks '
            f"{', '.join(missing)}; what every barrier has is listed in "
            "eqsim/laws/barrier/base.py"
        )
