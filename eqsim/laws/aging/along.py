"""Lives along thresholds that grow in a known way, xi(x) = xi(0) s(x): `flow` and
`logarithmic`."""

import math
from typing import Any, NamedTuple

from eqsim.laws.aging import base
from eqsim.laws.aging.base import AgingLaw, Held, end, growth, kappa_at, smooth
from eqsim.laws.barrier.base import height, prefactor, thermal
from eqsim.laws.stiffness import Springs
from eqsim.numerics.compiled import routine
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.roots import Bracket, narrowed, newton

_NODES, _WEIGHTS = gauss_legendre(10)
# Within a cell barriers differ by at most this, beyond their rounding.
_RANGE = 4.0
# Within a cell thresholds grow by at most this factor.
_GROWN = 1.5
# Hazards less than exp(-37) of the clock do not count.
_NEGLIGIBLE = 37.0
# Halvings of a path after which a cell is small enough whatever happens in it.
_DEEPEST = 1000
# Halvings made in any case where a stretch relaxes under a falling threshold.
_RELAXING = 4
# Rounding of E over a xi^2: 9 units in the last place, of threshold, stretch and their
# difference.
_ROUNDING = 2e-15
# Share of an interval that a golden section leaves.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


class AlongPaths(AgingLaw):
    """Base of laws whose thresholds grow alike: they have `growth`, `end` and
    `smooth`."""

    __slots__ = ()


class _Path(NamedTuple):
    """A contact: its laws, its threshold at birth, where the path ends, and the stretch
    and age where it begins. The stretch grows by `moves` s."""

    law: Any
    barrier: Any
    springs: Springs
    xi: float
    end: float
    stretch: float
    moves: float
    age: float


@routine(inline=True)
def _at(c: _Path, s: float) -> tuple[float, float]:
    """Threshold at s, and the barrier there."""
    xi = c.xi * growth(c.law, c.age + s)
    a = c.barrier.b * kappa_at(c.law, c.springs, c.xi, xi)
    return xi, height(c.barrier, xi, abs(c.stretch + c.moves * s), a)


@routine
def path_life(
    law: Any, barrier: Any, springs: Springs, xi: float, clock: float
) -> tuple[float, float]:
    """The stretch at which a contact of threshold `xi` at birth and exponential clock
    `clock` breaks, and the hazard it has spent."""
    return _follow(_Path(law, barrier, springs, xi, end(law, xi), 0.0, 1.0, 0.0), clock)


@routine
def _follow(c: _Path, clock: float) -> tuple[float, float]:
    """The s of a path at which a contact of exponential clock `clock` breaks, or its
    end, and the hazard it has spent.

    The hazard along a growing threshold has no closed form. It is integrated over z, s
    = end z (2 - z), which makes it smooth where a stiff barrier vanishes, by 10
    Gauss-Legendre nodes in dyadic cells. A cell is halved unless the barrier and the
    aging vary little in it, or nothing happens in it: the barrier first rises, then
    falls (derived, for rising thresholds; for falling ones it falls), so its least
    value in a cell is at an end. Where a stretch relaxes under a falling threshold it
    may first fall: no coarse cell is skipped. Error 5e-9 of the hazard.
    """
    law, top, log_w = c.law, c.end, c.barrier.log_w
    if not thermal(c.barrier):
        return top, 0.0
    floor = math.log(min(clock, 100.0)) - _NEGLIGIBLE
    born, left = _at(c, 0.0)
    final = _at(c, top)[0]
    greatest = max(born, final)
    noise = _ROUNDING * c.barrier.b * kappa_at(law, c.springs, c.xi, greatest)
    noise *= greatest
    noise *= greatest
    most = _RANGE + noise  # by which E may differ within a cell
    coarse = _RELAXING if c.stretch < 0.0 and final < born else 0
    spent, level, index = 0.0, 0, 0
    while True:
        width = 0.5**level
        z = index * width
        x0, x1 = top * z * (2.0 - z), top * (z + width) * (2.0 - z - width)
        now, right = _at(c, x1)
        log_hazard = log_w + math.log(2.0 * top * width) - min(left, right)
        seen = log_hazard > floor or level < coarse
        last = level >= _DEEPEST
        # thresholds vanish at some x < 0, perhaps nearby
        fine = last or (
            abs(right - left) <= most
            and level >= coarse
            and smooth(law, c.age + x0, c.age + x1)
            and now <= _GROWN * c.xi * growth(law, c.age + x0)
        )
        if seen and fine and not last:
            for quarter in range(1, 4):  # the barrier may rise and fall inside
                part = z + 0.25 * quarter * width
                inner = top * part * (2.0 - part)
                _, middle = _at(c, inner)
                fine = fine and max(abs(middle - left), abs(middle - right)) <= most
        if seen and not fine:
            level, index = level + 1, 2 * index
            continue
        if seen:
            whole = _hazard_in(c, z, width)
            if spent + whole >= clock:
                bracket, part = Bracket(0.0, width), width * (clock - spent) / whole
                for _ in range(60):
                    excess = spent + _hazard_in(c, z, part) - clock
                    bracket, step = newton(bracket, part, excess, _rate(c, z + part))
                    near = abs(step - part) <= 1e-13 * part
                    part = step
                    if near or abs(excess) <= 1e-14 * clock:
                        break
                z += part
                return top * z * (2.0 - z), clock
            spent += whole
        left, index = right, index + 1
        while index % 2 == 0 and level > 0:
            level, index = level - 1, index // 2
        if level == 0 and index == 1:
            return top, spent


@routine(inline=True)
def _rate(c: _Path, z: float) -> float:
    """Hazard per unit z."""
    s = c.end * z * (2.0 - z)
    x = abs(c.stretch + c.moves * s)
    now = max(c.xi * growth(c.law, c.age + s), x)
    a = c.barrier.b * kappa_at(c.law, c.springs, c.xi, now)
    rate = math.exp(c.barrier.log_w - height(c.barrier, now, x, a))
    return rate * 2.0 * c.end * (1.0 - z) * prefactor(c.barrier, now, x)


@routine
def _hazard_in(c: _Path, z: float, width: float) -> float:
    total = 0.0
    for i in range(_NODES.size):
        total += _WEIGHTS[i] * _rate(c, z + 0.5 * width * (1.0 + _NODES[i]))
    return 0.5 * width * total


@base.whole_hazard.register(AlongPaths)
def _whole_hazard(law: Any, c: Any, xi: float) -> tuple[float, float]:
    return path_life(law, c.barrier, c.springs, xi, math.inf)


@base.life.register(AlongPaths)
def _life(law: Any, c: Any, xi: float, clock: float) -> float:
    return path_life(law, c.barrier, c.springs, xi, clock)[0]


# ---- segments of a programme ----


@routine(inline=True)
def _excess(law: Any, contact: Held, moves: float, s: float) -> float:
    """Threshold less stretch at s of a segment."""
    stretch = abs(contact.stretch + moves * s)
    return contact.threshold * growth(law, contact.age + s) - stretch


@routine
def _root(law: Any, contact: Held, moves: float, low: float, high: float) -> float:
    """The s at which the stretch reaches the threshold, between one where it is below
    and one where it is not."""
    bracket, s = Bracket(low, high), 0.5 * (low + high)
    for _ in range(200):
        if bracket.high - bracket.low <= 2e-16 * bracket.high:
            break
        excess = -_excess(law, contact, moves, s)
        bracket, s = narrowed(bracket, s, excess, math.nan)
    return bracket.high


@routine
def crossing(law: Any, contact: Held, moves: float, length: float) -> float:
    """The s in a segment of that length at which the stretch of a contact first reaches
    its threshold; infinity if there is none. Growth is concave and falling thresholds
    are convex in time, so that there is one crossing where the stretch grows or stays;
    where it relaxes, only a falling threshold can meet it, between the beginning and
    the least excess (derived)."""
    y, age = contact.stretch, contact.age
    turn = min(-y / moves, length) if moves != 0 and y < 0.0 else 0.0
    if turn > 0.0 and growth(law, age + turn) < growth(law, age):
        low, high = 0.0, turn
        for _ in range(80):  # the least excess, by golden sections
            left = high - _GOLDEN * (high - low)
            right = low + _GOLDEN * (high - low)
            if _excess(law, contact, moves, left) < _excess(law, contact, moves, right):
                high = right
            else:
                low = left
        if _excess(law, contact, moves, 0.5 * (low + high)) <= 0.0:
            return _root(law, contact, moves, 0.0, 0.5 * (low + high))
    if _excess(law, contact, moves, length) > 0.0:
        return math.inf
    return _root(law, contact, moves, turn, length)


@routine
def _along(
    law: Any, c: Any, contact: Held, moves: float, end: float, clock: float
) -> tuple[float, float]:
    """`_follow` up to `end` of a segment, in two parts if the stretch changes its sign
    on the way."""
    xi, _, y, age = contact
    turn = -y / moves if moves != 0 and -end * moves < y < 0.0 else 0.0
    before = 0.0
    if turn > 0.0:
        path = _Path(law, c.barrier, c.springs, xi, turn, y, float(moves), age)
        s, before = _follow(path, clock)
        if s < turn:
            return s, clock
        y, age = 0.0, age + turn
    if end <= turn:
        return turn, before
    path = _Path(law, c.barrier, c.springs, xi, end - turn, y, float(moves), age)
    s, after = _follow(path, clock - before)
    return turn + s, before + after


@base.spend.register(AlongPaths)
def _spend(
    law: Any, c: Any, contact: Held, moves: float, length: float, clock: float
) -> tuple[float, float]:
    ends = crossing(law, contact, moves, length)
    s, passed = _along(law, c, contact, moves, min(ends, length), clock)
    if passed >= clock or ends <= length:
        return s, 0.0
    return math.inf, clock - passed


@base.spent.register(AlongPaths)
def _spent(law: Any, c: Any, contact: Held, moves: float, length: float) -> float:
    return _along(law, c, contact, moves, length, math.inf)[1]
