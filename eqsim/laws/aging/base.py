"""Aging of pinned contacts: thresholds that move from the newborn law P_ci (scale x_*i)
to the final law P_cf (x_*f).

The Smoluchowski equation of Braun and Peyrard (2011, section IV) with thresholds
xi^2/x_*^2 ~ Gamma(n+1) is solved by the norm of a (2n+2)-dimensional Ornstein-Uhlenbeck
process of rate 2D/x_*f^2 and variance x_*f^2/2 per component (derived). So, for
contacts of age t that have not broken,

    transition    xi'^2 = (xi e + s Z)^2 + s^2 chi^2(2n+1),
                  e = exp(-2Dt/x_*f^2),   s^2 = x_*f^2 (1 - e^2)/2
    one-time law  Gamma(n, x_*(t)),
                  x_*(t)^2 = x_*f^2 - (x_*f^2 - x_*i^2) exp(-4Dt/x_*f^2)

with Z normal. There are two rules for quenched contacts: the thresholds of `langevin`
follow that process; those of `flow` follow xi(t) = xi(0) x_*(t)/x_*i, which has the
same one-time laws and no fluctuations. The annealed (published) ensemble draws frozen
thresholds from the law of `pooled` under either rule. A third rule, `logarithmic`, has
no final law and nothing in common with these.

Lengths are in units of the newborn law's scale and ages are displacements: `final2` is
(x_*f/x_*i)^2 and `alpha` is 4 D x_*i/(v x_*f^2). A law is a NamedTuple of its numbers
with a body of each kernel routine below.
"""

import math
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.laws.barrier.base import hazard, mean_rate, rate, stretch, stretches, travel
from eqsim.laws.law import Law
from eqsim.laws.stiffness import Springs, kappa
from eqsim.laws.threshold import Gamma
from eqsim.numerics.compiled import by_law
from eqsim.numerics.tables import NO_TABLE, Array

# displacement over threshold in which no rate varies, so that the clock divided by the
# rate is the time
_STANDSTILL = 1e-250
# largest n of pooled laws and of Fokker-Planck equations, whose grids resolve the width
# of the newborn law
_MOST_N = 1000.0


def change2(final2: float, age: Any) -> Array:
    """x_*^2/x_*i^2 - 1 of the unbroken law at `age` = alpha x (any shape)."""
    return np.asarray((1.0 - final2) * np.expm1(-age))


def scale2(final2: float, age: Any) -> Array:
    """x_*^2/x_*i^2 of the unbroken law, a sum of positive terms; `age` may be
    infinite."""
    if final2 < 1:
        return np.asarray(final2 + (1.0 - final2) * np.exp(-age))
    return 1.0 + change2(final2, age)


class AgingLaw(Law):
    """A law of aging: `fluctuates` if lives are paths of a random process,
    `closed` if they are known in closed form, without integrating a hazard or following
    a path, and `stiffens` if the stiffness of the sqrt law follows the threshold, which
    else is that at birth. `keys` are the parameters of `Aging` that are its own."""

    __slots__ = ()
    fluctuates: ClassVar[bool] = False
    closed: ClassVar[bool] = False
    stiffens: ClassVar[bool] = False
    keys: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def check(cls, aging: Any, law: Any, disorder: str) -> None:
        """Raise InputError unless contacts of newborn thresholds `law` can age as
        `aging`, an `Aging`, says."""

    @classmethod
    def reduced(cls, aging: Any, law: Any, velocity: float) -> "AgingLaw":
        """The law from an `Aging`, the law of newborn thresholds and the velocity.
        Raises InputError."""
        raise NotImplementedError

    @property
    def most(self) -> float:
        """The factor by which a threshold that sets the stiffness grows at most."""
        return 1.0

    def growth_at(self, x: Array) -> Array:
        """Factor by which thresholds have grown in contacts that have been pinned for
        `x` (any shape), where it is the same for all."""
        return np.ones_like(x)

    def bracket(self, xi: Any) -> tuple[Any, Any]:
        """Two stretches between which thresholds born as `xi` (any shape) meet the
        stretch."""
        return xi, xi

    def table(self, springs: Springs) -> Array:
        """Table for the routine `work`, empty if it needs none."""
        return NO_TABLE


class Drift(AgingLaw):
    """Thresholds of a gamma law that drift to a final one, numbers as above."""

    __slots__ = ()
    stiffens: ClassVar[bool] = True
    keys: ClassVar[tuple[str, ...]] = ("rate", "x_star_final")
    final2: float
    alpha: float

    @classmethod
    def check(cls, aging: Any, law: Any, disorder: str) -> None:
        if not isinstance(law, Gamma):
            raise InputError(f'rule = "{aging.rule}": needs thresholds of law "gamma"')
        fluctuates = disorder == "quenched" and cls.fluctuates
        if aging.rate == math.inf and fluctuates:
            said = f'must be finite with rule = "{aging.rule}" and quenched disorder'
            raise InputError(f"rate = inf: {said}")
        if not 1e-3 <= aging.final(law.x_star) <= 1e3:
            given = f"x_star_final = {aging.x_star_final!r}"
            raise InputError(f"{given}: must be within a factor 1000 of x_star")
        annealed = disorder == "annealed"
        if aging.active and law.n > _MOST_N and (annealed or fluctuates):
            who = "annealed contacts"
            if not annealed:
                who = f'contacts of rule "{aging.rule}"'
            raise InputError(
                f"rule: {who} can age for n <= {_MOST_N:g}; n is {law.n:g}"
            )

    @property
    def final(self) -> float:
        """x_*f/x_*i."""
        return math.sqrt(self.final2)

    @property
    def most(self) -> float:
        return max(1.0, self.final)

    def bracket(self, xi: Any) -> tuple[Any, Any]:
        return xi * min(1.0, self.final), xi * max(1.0, self.final)


class Held(NamedTuple):
    """A pinned contact where a segment begins: its threshold and relative stiffness at
    birth, its stretch in the direction of motion, and for how long it has been pinned
    (displacement at the pace of its laws)."""

    threshold: float
    stiffness: float
    stretch: float
    age: float


class _NoNumbers(NamedTuple):
    final2: float = 1.0
    alpha: float = 0.0


class Unaged(_NoNumbers, AgingLaw):
    """Thresholds stay as they are."""

    __slots__ = ()
    closed: ClassVar[bool] = True


# ---- kernels ----


@by_law
def growth(law: Any, x: float) -> float:
    """`AgingLaw.growth_at` in kernels."""
    return 1.0


@by_law
def end(law: Any, xi: float) -> float:
    """The stretch at which a contact born with threshold `xi` breaks unless heat breaks
    it before."""
    return xi


@by_law
def smooth(law: Any, x0: float, x1: float) -> bool:
    """True if growth between two stretches is well described by a polynomial of a few
    degrees."""
    return True


@by_law
def kappa_at(law: Any, springs: Springs, born: float, now: float) -> float:
    """k_i/k of a contact whose threshold was `born` at birth and is `now`."""
    return kappa(springs, born)


@by_law
def whole_hazard(law: Any, c: Any, xi: float) -> tuple[float, float]:
    """The stretch at which a contact born with threshold `xi` breaks mechanically, and
    its integrated hazard until then; of laws whose lives have no closed form. `c` is an
    `engine.contacts.Contacts`."""
    raise TypeError("lives of this law of aging are closed, or paths")


@by_law
def life(law: Any, c: Any, xi: float, clock: float) -> float:
    """The stretch at which a contact born with threshold `xi` and exponential clock
    `clock` breaks."""
    raise TypeError("lives of this law of aging are paths")


@by_law
def break_lives(law: Any, c: Any, lives: Any, r: int, count: int) -> None:
    """Fill travel, and stiffness at birth, of the first `count` lives of round r;
    `lives` is an `engine.lanes.Lives`."""
    threshold, stiffness = lives.threshold, lives.stiffness
    clock, travel = lives.clock, lives.travel
    for i in range(count):
        stiffness[r, i] = kappa(c.springs, threshold[r, i])
        travel[r, i] = life(law, c, threshold[r, i], clock[r, i])


@by_law
def spend(
    law: Any, c: Any, contact: Held, moves: float, length: float, clock: float
) -> tuple[float, float]:
    """Time at which a contact with `clock` left of its exponential clock breaks along a
    segment of a programme, or infinity, and the rest of the clock at the end. Time is
    displacement at the pace of `c`, and the slider `moves` at so many times that pace:
    1 along a segment of a programme, 0 in a hold."""
    raise TypeError("contacts of this law of aging follow no programme")


@by_law
def spent(law: Any, c: Any, contact: Held, moves: float, length: float) -> float:
    """The hazard along a segment, arguments as in `spend`, of a contact that survives
    it."""
    raise TypeError("contacts of this law of aging follow no programme")


@by_law
def stiffness_varies(law: Any, springs: Springs) -> bool:
    """True if a contact's stiffness changes while it is pinned."""
    return False


@by_law
def work(law: Any, table: Array, springs: Springs, stiffness: float, x: float) -> float:
    """int_0^x (k_i/k) y dy of a contact of relative stiffness `stiffness` at birth."""
    return 0.5 * stiffness * x * x


@life.register(Unaged)
def _life(law: Unaged, c: Any, xi: float, clock: float) -> float:
    return stretch(c.barrier, c.barrier_table, xi, kappa(c.springs, xi), clock)


@break_lives.register(Unaged)
def _lives(law: Unaged, c: Any, lives: Any, r: int, count: int) -> None:
    threshold, stiffness = lives.threshold, lives.stiffness
    for i in range(count):
        stiffness[r, i] = kappa(c.springs, threshold[r, i])
    stretches(c.barrier, c.barrier_table, c.springs, lives, r, count)


@spent.register(Unaged)
def _spent(law: Unaged, c: Any, contact: Held, moves: float, length: float) -> float:
    xi, stiffness, y, _ = contact
    way = moves * length
    end = y + way
    if y < 0.0 < end:
        before = hazard(c.barrier, c.hazard_table, xi, stiffness, -y)
        return (before + hazard(c.barrier, c.hazard_table, xi, stiffness, end)) / moves
    y = max(y, -end)
    return mean_rate(c.barrier, c.hazard_table, xi, stiffness, y, way) * length


@spend.register(Unaged)
def _spend(
    law: Unaged, c: Any, contact: Held, moves: float, length: float, clock: float
) -> tuple[float, float]:
    xi, stiffness, y, _ = contact
    if y + moves * length < xi:
        left = clock - spent(law, c, contact, moves, length)
        if left > 0.0:
            return math.inf, left
    if moves * clock < _STANDSTILL:
        return min(clock / rate(c.barrier, xi, stiffness, abs(y)), length), 0.0
    way = max(travel(c, xi, stiffness, y, moves * clock), 0.0)
    return min(way / moves, length), 0.0
