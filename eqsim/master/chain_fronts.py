"""Steady fronts along an endless chain of blocks of identical contacts: which prestress
drives them at a given speed, and the speed at a given prestress, at T = 0.

A block of mass M and damping eta has neighbours at springs K, contacts of stiffness 1
and a spring K_d to a plate, all over n k; time is the user's, distance is counted in
blocks. In a steady front X_j(t) = X(t - j T), T = 1/v, and with

    Lam(w; s) = s - M w^2 - i eta w + 4 K sin^2(w T/2)

the prestress p, at which the next block breaks when its turn has come, is

    reattached  p = 1 - 1/(2 a) + (1/pi) int_0^inf eta/|Lam(w; a)|^2 dw,  a = 1 + K_d,
    detached    p = sqrt(K_d/a) exp[(1/pi) int_0^inf arg(Lam(w; a)/Lam(w; K_d)) dw/w],
    rigid       p = exp[-(1/pi) int_0^inf arg(Lam(w; 0)/(-M w^2 - i eta w)) dw/w].

The first two are derived. `reattached`: contacts take hold again at once, unstretched;
`detached`: not while the front passes; without plate springs Lam(w; 0) has a factor
-i w, and p is the limit of K_d = 0. Both have p = x_0/x_s, the stretch ahead of the
front over the threshold. `rigid` are Amontons-Coulomb blocks, p = (initial -
kinetic)/(static - kinetic force), by the method of Wiener and Hopf (Amundsen et al.,
Phys. Rev. E 92, 032406, 2015; Thogersen et al., Phys. Rev. E 100, 043004, 2019).
Undamped fronts faster than c = sqrt(K/M) have closed forms:

    rigid       p = sqrt(1 - (c/v)^2),
    detached    p = w_a sqrt(M - K T^2),  M w_a^2 = 1 + 4 K sin^2(w_a T/2),  K_d = 0.

All presuppose that each block breaks once, in its turn, and does not stop before the
front is far.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError, require_choice, require_number
from eqsim.estimate import Estimate
from eqsim.numerics.quadrature import gauss_legendre, halved
from eqsim.numerics.tables import Array

Contacts = Literal["reattached", "detached", "rigid"]

# Periods of sin^2(w T/2) that are doubled so often, to extrapolate what is beyond them.
_DOUBLINGS = 8
# Most periods, to bound memory.
_MOST_PERIODS = 4096
# Frequencies of interest over those at which damping is as strong as springs or inertia,
# at least.
_SLOWEST = 1e-2
# Nodes in a panel.
_ORDER = 16
# Difference of a panel from its halves that does not matter, absolute and relative to
# all of the integral.
_ALIKE = 1e-14
# Damping below which products with the slowest frequencies underflow.
_LEAST_DAMPING = 1e-100
# The last resonance lies below so many times the largest frequency of the chain.
_BEYOND_RESONANCE = 1.5
# Speeds that are tried, over the fastest of sound and drag: a range, and how many.
_SPEEDS = 0.02, 50.0, 40
# Relative error of the quadrature that is not seen in its extrapolation.
_ROUNDING = 1e-11


class _Blocks(NamedTuple):
    """Chain of blocks, stiffnesses over n k; with T = 1/v and arrays w (n,)."""

    coupling: float
    mass: float
    damping: float
    drive_stiffness: float

    def balance(self, w: Array, stiffness: float, T: float) -> Array:
        """Lam(w; stiffness)."""
        springs = stiffness + 4.0 * self.coupling * np.sin(0.5 * w * T) ** 2
        return np.asarray(springs - self.mass * w**2 - 1j * self.damping * w)

    def log_balance(self, w: Array, stiffness: float, T: float) -> Array:
        """ln(i Lam), without a cut where Im Lam < 0."""
        return np.asarray(np.log(1j * self.balance(w, stiffness, T)))

    def path(self, w: Array, T: float) -> tuple[Array, Array]:
        """Path beside the real axis, and its derivative (derived). Weakly damped waves
        are roots of Lam beside the axis, on the side to which d(Re Lam)/dw is positive.
        The path is on the other side, by less than 1/T, and crosses where the
        derivative vanishes. Im Lam < 0 on it and between it and the axis."""
        wave = self.coupling * T**2
        slope = (wave * np.sin(w * T) - self.mass * w * T) / (wave + self.mass)
        bend = (wave * np.cos(w * T) - self.mass) / (wave + self.mass)
        root = np.sqrt(1.0 + slope**2)
        return w - 1j / T * slope / root, 1.0 - 1j * bend / root**3

    def integral(self, function: Callable[[Array], Array], T: float) -> Estimate:
        """Integral from 0 to infinity of the imaginary part of an analytic function of
        w that has the periods of the chain and falls as 1/w^2 in their mean: on a path
        beside resonances, in panels that are halved where they must, then extrapolated
        from partial sums, a series in 1/periods (Richardson)."""
        stiffest = 1.0 + self.drive_stiffness + 4.0 * self.coupling
        last = stiffest / self.damping
        if self.mass:
            last = min(last, math.sqrt(stiffest / self.mass))
        quarter = 0.5 * math.pi / T
        resonant = max(1, math.ceil(0.25 * _BEYOND_RESONANCE * last / quarter))
        if resonant > _MOST_PERIODS:
            said = "is so slow that the front is trapped, or nearly so"
            raise InputError(f"speed = {1.0 / T:g}: {said}")
        first, rule = resonant, gauss_legendre(_ORDER)
        if self.mass:  # a series only where inertia exceeds damping
            heavy = math.ceil(self.damping / self.mass / (4.0 * quarter))
            first = max(first, min(heavy, _MOST_PERIODS // 4))

        def total(edges: Array) -> float:
            w, weights = rule.between(edges[:-1], edges[1:])
            return float((function(w) * weights).imag.sum())

        def beside(low: Array, high: Array) -> Array:
            nodes, weights = rule.between(low, high)
            w, slope = self.path(nodes, T)
            return np.asarray((function(w) * slope * weights).imag.sum(axis=-1))

        springs = min(self.drive_stiffness or 1.0, 1.0) / self.damping
        inertia = self.damping / (self.mass + self.coupling * T**2)
        slowest = min(_SLOWEST * min(springs, inertia), 0.5 * quarter)
        doublings = math.ceil(math.log2(quarter / slowest))
        slow = np.geomspace(slowest, quarter, doublings + 1)
        edges = np.concatenate(([0.0], slow, quarter * np.arange(2, 4 * resonant + 1)))
        begin, rough = halved(beside, edges, _ALIKE)
        # from the end of the path to the axis
        begin += total(np.append(self.path(edges[-1:], T)[0], edges[-1]))
        sums = [begin + total(quarter * np.arange(4 * resonant, 4 * first + 1))]
        periods = first
        while len(sums) <= _DOUBLINGS and (periods < _MOST_PERIODS or len(sums) < 3):
            whole = quarter * np.arange(4 * periods, 8 * periods + 1)
            sums.append(sums[-1] + total(whole))
            periods *= 2
        table = before = np.array(sums)
        for order in range(1, len(sums)):
            before, ratio = table, 2.0**order
            table = (ratio * table[1:] - table[:-1]) / (ratio - 1.0)
        # steps of the last orders, of which one may be small by chance; of a heavily
        # damped mass the series begins later than sums end
        missed = max(abs(table[0] - before[1]), abs(before[1] - before[0]))
        return Estimate(float(table[0]), 2.0 * float(missed) + rough, 0)

    def prestress(self, speed: float, contacts: Contacts) -> Estimate:
        """Prestress of a front at a speed, without checks."""
        T, held = 1.0 / speed, 1.0 + self.drive_stiffness
        if self.damping == 0.0:
            value = self._undamped(T, contacts)
            return Estimate(value, _ROUNDING * value, 0)
        if contacts == "reattached":

            def response(w: Array) -> Array:
                return np.asarray((1.0 / self.balance(w, held, T) - 1.0 / held) / w)

            found = self.integral(response, T)
            value = 1.0 - 0.5 / held + found.value / math.pi  # type: ignore[operator]
            return Estimate(value, found.stderr / math.pi + _ROUNDING, 0)  # type: ignore[operator]

        g = 1.0 / max(self.damping, math.sqrt(self.mass))
        slow, before = self.drive_stiffness or self.damping * g, 1.0
        if contacts == "detached":
            before = math.sqrt(slow / held)

        def phase(w: Array) -> Array:
            sliding = self.log_balance(w, self.drive_stiffness, T)
            if contacts == "rigid":
                alone = np.log(w) + np.log(self.damping - 1j * self.mass * w)
                return np.asarray((alone - sliding) / w)
            if not self.drive_stiffness:  # then Lam (w + i g)/w has no root at w = 0
                sliding += np.log(w + 1j * g) - np.log(w)
            rest = 2.0 * math.log(before)
            return np.asarray((self.log_balance(w, held, T) - sliding + rest) / w)

        found = self.integral(phase, T)
        value = before * math.exp(found.value / math.pi)  # type: ignore[operator]
        return Estimate(value, value * (found.stderr / math.pi + _ROUNDING), 0)  # type: ignore[operator]

    def _undamped(self, T: float, contacts: Contacts) -> float:
        if contacts == "rigid":
            return math.sqrt(1.0 - self.coupling * T**2 / self.mass)

        def excess(w: float) -> float:
            return float(self.balance(np.array([w]), 1.0, T)[0].real)

        most = math.sqrt((1.0 + 4.0 * self.coupling) / self.mass)
        w = float(optimize.brentq(excess, 0.0, 1.001 * most, xtol=1e-15, rtol=1e-14))
        return w * math.sqrt(self.mass - self.coupling * T**2)


def front_prestress(
    speed: float,
    coupling: float,
    *,
    mass: float = 0.0,
    damping: float = 0.0,
    drive_stiffness: float = 0.0,
    contacts: Contacts = "reattached",
) -> Estimate:
    """Solve for the prestress at which a steady front runs along a chain of blocks at a
    speed, at T = 0 and for identical contacts.

    With Lam(w; s) = s - M w^2 - i eta w + 4 K sin^2(w/(2 v)) and a = 1 + K_d it is

        1 - 1/(2 a) + (1/pi) int_0^inf eta/abs(Lam(w; a))^2 dw

    of contacts that are "reattached" at once (derived), and for others an exponential
    of such an integral (derived; rigid: Amundsen et al., Phys. Rev. E 92, 032406, 2015).

    Parameters
    ----------
    speed : float
        Blocks per time, > 0.
    coupling : float
        K/(n k), the spring between neighbours over the stiffness of the n contacts of a
        block, > 0.
    mass, damping : float
        M/(n k) (time^2) and eta/(n k) (time) of a block, >= 0, not both 0.
    drive_stiffness : float
        K_d/(n k), the spring of each block to the plate, >= 0; 0 with "rigid".
    contacts : str
        "reattached" at once and unstretched; "detached" while the front passes;
        "rigid", a force that falls from static to kinetic friction (stiffnesses, mass
        and damping may then be over anything).

    Returns
    -------
    Estimate
        Stretch ahead of the front over the threshold; of "rigid" contacts (initial -
        kinetic)/(static - kinetic force). `stderr` is the error of the quadrature. That
        each block breaks once, in its turn, and stops only far behind the front is
        presupposed, not checked.

    Raises
    ------
    InputError
        For values out of range; for undamped fronts that re-attach, have plate springs,
        or are not faster than sqrt(K/M), whose waves never leave them; for contacts that
        re-attach and a faster front, behind which they would break again; and for
        speeds so low that the front is all but trapped.

    Examples
    --------
    >>> from eqsim import front_prestress
    >>> print(f"{front_prestress(5.0, coupling=20.0, damping=1.0).value:.8f}")
    0.75580050
    """
    require_number("speed", speed, above=0.0, most=1e9)
    blocks = _checked(_Blocks(coupling, mass, damping, drive_stiffness), contacts)
    sound = math.sqrt(coupling / mass) if mass else math.inf
    if not damping and speed <= sound:
        said = f"must be above sqrt(K/M) = {sound:g} without damping"
        raise InputError(f"speed = {speed:g}: {said}")
    if contacts == "reattached" and speed >= sound:
        said = f"must be below sqrt(K/M) = {sound:g}, or blocks break again behind it"
        raise InputError(f"speed = {speed:g}: {said}")
    return blocks.prestress(speed, contacts)


def front_speed(
    prestress: float,
    coupling: float,
    *,
    mass: float = 0.0,
    damping: float = 0.0,
    drive_stiffness: float = 0.0,
    contacts: Contacts = "reattached",
) -> Estimate:
    """Solve for the speed of a steady front at a prestress, the inverse of
    `front_prestress`; of several speeds the fastest, at which a larger prestress makes
    the front faster, as it does where fronts are stable.

    Parameters
    ----------
    prestress : float
        Between 0 and 1.
    coupling, mass, damping, drive_stiffness, contacts
        As of `front_prestress`.

    Returns
    -------
    Estimate
        Blocks per time, with the error of the solver. Speeds are tried from 0.02 to 50
        times the fastest by which the chain carries a disturbance.

    Raises
    ------
    InputError
        As `front_prestress` does, and if no front runs at this prestress: a chain traps
        fronts of a small prestress, unless inertia carries them.

    Examples
    --------
    >>> from eqsim import front_speed
    >>> print(f"{front_speed(0.6, 1.0, mass=1.0, contacts='rigid').value:.6f}")
    1.250000
    """
    require_number("prestress", prestress, above=0.0, most=1.0 - 1e-9)
    blocks = _checked(_Blocks(coupling, mass, damping, drive_stiffness), contacts)
    scales = [math.sqrt(coupling / mass)] if mass else []
    if damping:
        scales.append((1.0 + 2.0 * math.sqrt(coupling)) / damping)

    def excess(speed: float) -> float:
        return float(blocks.prestress(speed, contacts).value or 0.0) - prestress

    slowest, fastest, points = _SPEEDS
    speeds = min(scales) * np.geomspace(slowest, fastest, points)
    if mass and contacts == "reattached":
        speeds = np.minimum(speeds, (1.0 - 1e-9) * scales[0])
    if not damping:
        speeds = scales[0] * (1.0 + np.geomspace(1e-9, fastest, points))
    high = float(speeds[-1])
    above = excess(high)
    for low in speeds[-2::-1].tolist():
        below = excess(low)
        if below < 0.0 <= above:
            speed = float(optimize.brentq(excess, low, high, xtol=1e-14, rtol=1e-13))
            step = 1e-4 * speed
            slope = (excess(speed + step) - excess(speed - step)) / (2.0 * step)
            error = blocks.prestress(speed, contacts).stderr or 0.0
            return Estimate(speed, error / abs(slope) + 1e-12 * speed, 0)
        high, above = low, below
    said = (
        f"no steady front between {speeds[0]:.3g} and {speeds[-1]:.3g} blocks per time"
    )
    raise InputError(f"prestress = {prestress:g}: {said}")


def decay(coupling: float, stiffness: float = 1.0) -> float:
    """z, by which displacements fall from block to block where each is held by a
    `stiffness`, both over n k: stiffness = K (1 - z)^2/z."""
    c = 1.0 + 0.5 * stiffness / coupling
    return 1.0 / (c + math.sqrt(c * c - 1.0))


def _checked(blocks: _Blocks, contacts: Contacts) -> _Blocks:
    """The chain, if it can be solved for."""
    require_choice("contacts", contacts, ("reattached", "detached", "rigid"))
    require_number("coupling", blocks.coupling, above=0.0, least=1e-6, most=1e9)
    for name in ("mass", "damping", "drive_stiffness"):
        require_number(name, getattr(blocks, name), least=0.0, most=1e9)
    if not blocks.mass and not blocks.damping:
        raise InputError("damping = 0: must be > 0 without a mass")
    if 0.0 < blocks.damping < _LEAST_DAMPING:
        said = f"must be 0 or at least {_LEAST_DAMPING:g}"
        raise InputError(f"damping = {blocks.damping:g}: {said}")
    if contacts == "rigid" and blocks.drive_stiffness:
        said = "must be 0 with rigid contacts"
        raise InputError(f"drive_stiffness = {blocks.drive_stiffness:g}: {said}")
    if not blocks.damping and (contacts == "reattached" or blocks.drive_stiffness):
        said = (
            "must be > 0 where contacts or plate springs hold blocks behind the front"
        )
        raise InputError(f"damping = 0: {said}")
    return blocks
