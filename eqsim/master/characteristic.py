"""Linear stability of steady sliding through a spring, of contacts that neither heat
nor age changes (derived).

While X = V t + x exp(p t), contacts born at a rate that varies as exp(p t) break after
a displacement xi. To first order in x the force of all changes by Z(p) x, so that
perturbations obey, all per N k,

    m p^2 + eta_s p + kappa_s + Z(p) = 0,
    Z(p) = beta (1 - D) (drag (1 - P) - q M)/(1 - D P) + eta_l p (1 - pinned),

    P = E[exp(-q xi)],   M = E[(k_i/k) (1 - exp(-q xi) (1 + q xi))/q^2],   q = p/V,   D = E[exp(-p delay)],
    beta = 1/(C + V tau),   drag = eta_l V,   pinned = beta C,

where births answer to breaks as b = D Gamma, Gamma = p beta (1 - P)/(1 - D P) being the
perturbation of breaks, and the detached share changes by Gamma (1 - D)/p. M is the
transform of x E[k_i/k; xi > x]. Without delay D = 1 and Z = 0: no perturbation is
amplified or damped by the contacts.

Lengths are in units of the law's scale and time is displacement, V = 1. Means over
births are sums over Gauss-Legendre nodes in the normal deviate of the threshold; two
sets of panels, of different range, give the result and its error: where many thresholds
are so much greater than most that decaying exponentials make their mean diverge, it is
large.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from eqsim.errors import InputError
from eqsim.laws.delay import Exponential, Fixed
from eqsim.master.quenched import different_steps, kappa_of
from eqsim.model.reduced import Pull, Reduced
from eqsim.numerics.quadrature import gauss_legendre, normal_exponent
from eqsim.numerics.tables import Array

METHOD = "characteristic equation"


class Nodes(NamedTuple):
    """How finely a law is resolved: panels, and the range of thresholds in normal
    deviates, on either side."""

    panels: int
    reach: float


FINE = Nodes(128, 8.2)
# Another number of panels and another range than FINE, so that the difference tells the
# error of either.
COARSE = Nodes(64, 7.4)
# Fewest panels, for scans.
SCAN = Nodes(24, 8.2)
_SERIES = np.array(
    [(-1.0) ** k * (k - 1) / math.factorial(k) for k in range(2, 18)]
)  # of (1 - exp(-z)(1 + z))/z^2
# Terms that are summed at once, to bound memory.
_AT_ONCE = 2**21
# The step of the scan in phase over a cycle.
_PHASE = 0.05
# The first range of the scan in 1/threshold.
_FIRST = 6.0
# Points of the scan at most.
_MOST = 100_000
# Share of the largest Z below which no border is looked for.
_FAINT = 1e-4
# Rounds of Newton's method.
_ROUNDS = 25
# The relative step that ends it, after which a root is good to its square, or to
# rounding.
_SETTLED = 1e-8
# How small the equation is at a root, relative to its terms.
_FOUND = 1e-9
# Decays faster than so many per cycle are not looked for.
_LEFT = 4.0


class Births(NamedTuple):
    """Thresholds of newborn contacts, their shares and kappa, arrays (nodes,)."""

    xi: Array
    share: Array
    kappa: Array


def births_of(contacts: Reduced, nodes: Nodes) -> Births:
    """Nodes that stand for the law; of a discrete one all its thresholds."""
    if contacts.law.steps.size:
        return Births(*different_steps(contacts))
    # deviates at which the density of the law has jumps and kinks
    kinks = special.ndtri(np.asarray(contacts.law.cdf(contacts.law.kinks), float))
    even = np.linspace(-nodes.reach, nodes.reach, nodes.panels + 1)
    edges = np.union1d(even, kinks[np.abs(kinks) < nodes.reach])
    z, weights = map(np.ravel, gauss_legendre(8).between(edges[:-1], edges[1:]))
    share = weights * np.exp(-0.5 * z**2)
    xi = contacts.law.inverse_survival(normal_exponent(z)) / contacts.law.scale
    return Births(xi, share / share.sum(), kappa_of(contacts, xi))


class Loop(NamedTuple):
    """The loop that answers to a perturbation: contacts, their delays, the viscous
    force of a detached contact, and the damping and the mass of the slider; damping
    also by contacts that are detached in the mean."""

    births: Births
    delay: Fixed | Exponential
    drag: float
    beta: float
    damping: float
    mass: float

    @property
    def cycle(self) -> float:
        """C + V tau."""
        return 1.0 / self.beta

    def response(self, p: Array) -> Array:
        """Z without its term in eta_l p (1 - pinned), which is in `damping`; p complex,
        not 0, shape (n,)."""
        xi, share, kappa = self.births
        if p.size * xi.size > _AT_ONCE and p.size > 1:
            return np.concatenate([self.response(p) for p in np.array_split(p, 2)])
        z = p[:, None] * xi
        lost = -np.expm1(-z)
        broken = lost @ share  # 1 - P
        far = np.abs(z) >= 0.5
        work = np.polynomial.polynomial.polyval(np.where(far, 0.0, z), _SERIES)
        work[far] = (lost[far] - z[far] * (1.0 - lost[far])) / z[far] ** 2
        M = work @ (share * kappa * xi**2)
        away = self.delay.forgotten(p)  # 1 - D
        change = self.beta * away * (self.drag * broken - p * M)
        return np.asarray(change / (away + (1.0 - away) * broken))

    def balance(self, p: Array, stiffness: float) -> Array:
        """The characteristic equation, shape (n,)."""
        held = self.mass * p**2 + self.damping * p + stiffness
        return np.asarray(held + self.response(p))


def loop_of(contacts: Reduced, pull: Pull, nodes: Nodes) -> Loop:
    """Raises InputError for identical contacts with a fixed delay."""
    delay = contacts.delay
    if (
        isinstance(delay, Fixed)
        and contacts.law.steps.size
        and np.ptp(contacts.law.steps) == 0.0
    ):
        raise InputError(
            "thresholds: identical contacts with a fixed delay stay in step; no steady state"
        )
    births = births_of(contacts, nodes)
    C = float(births.share @ births.xi)
    beta = 1.0 / (C + delay.mean)
    damping = pull.damping + contacts.drag * beta * delay.mean
    return Loop(births, delay, contacts.drag, beta, damping, pull.mass)


class Border(NamedTuple):
    """The largest stiffness at which a perturbation neither grows nor decays, and its
    frequency (0 without one)."""

    stiffness: float
    frequency: float


def border_of(loop: Loop, coarse: Loop) -> Border:
    """Below it steady sliding is unstable: the greatest of m w^2 - Re Z(i w) over the
    roots of eta w + Im Z(i w) = 0.

    Infinite of a slider with a mass, no damping and contacts with a fixed delay:
    whenever w tau is near a multiple of 2 pi Im Z changes its sign. The scan, with the
    nodes of `coarse`, ends where |Z| is below the greatest found, or too small for
    another root; of discrete thresholds without damping, whose |Z| does not fall, after
    `_MOST` steps. Raises InputError if with a mass it does not end.
    """
    if loop.mass > 0.0 and loop.damping == 0.0 and isinstance(loop.delay, Fixed):
        return Border(math.inf, math.inf)
    xi, share, _ = coarse.births
    mean = float(share @ xi)
    apart = max(float(share @ xi**2) - mean**2, 0.0)
    apart += 0.0 if isinstance(loop.delay, Fixed) else loop.delay.mean**2
    # contacts in step lose 2 (pi width)^2 of a phase in a cycle, width that of its
    # length
    step = _PHASE * min(1.0, 20.0 * apart / loop.cycle**2 + 0.02) / loop.cycle
    best, largest, low, high = Border(0.0, 0.0), 0.0, step, _FIRST / mean
    while True:
        if high / step > _MOST:
            if low == step:
                raise InputError(
                    f"delay.time: is {loop.delay.mean / mean:.3g} thresholds long; the border is out of reach"
                )
            if loop.mass == 0.0:
                return best
            raise InputError(
                "drive.stage: its damping is too small beside its mass to find the border of stability"
            )
        w = np.arange(low, high + step, step)
        Z = coarse.response(1j * w)
        size = float(np.abs(Z[w.size // 2 :]).max())
        largest = max(largest, float(np.abs(Z).max()))
        phase = loop.damping * w + Z.imag
        for i in np.flatnonzero(phase[:-1] * phase[1:] < 0.0):
            best = max(best, _crossing(loop, w[i], w[i + 1]))
        faint = loop.mass == 0.0 and size < max(best.stiffness, _FAINT * largest)
        if faint or loop.damping * high > 2.0 * size:
            return best
        # |Z| falls as 1/w from here on
        last = 0.0
        if loop.mass > 0.0 and loop.damping > 0.0:
            last = math.sqrt(2.0 * size * high / loop.damping)
        low, high = float(w[-1]), max(2.0 * high, last if last > _MOST * step else 0.0)


def _crossing(loop: Loop, low: float, high: float) -> Border:
    """Where a root crosses the imaginary axis between two frequencies."""

    def phase(w: float) -> float:
        return loop.damping * w + float(loop.response(np.array([1j * w]))[0].imag)

    if phase(low) * phase(high) > 0.0:  # the coarser nodes differ
        return Border(0.0, 0.0)
    w = float(optimize.brentq(phase, low, high, xtol=1e-14, rtol=1e-13))
    stiffness = loop.mass * w**2 - float(loop.response(np.array([1j * w]))[0].real)
    return Border(stiffness, w)


def root_of(loop: Loop, coarse: Loop, stiffness: float) -> complex | None:
    """The root of the characteristic equation with the largest real part, imaginary
    part >= 0; None if all decay faster than `_LEFT` per cycle. Newton's method from a
    grid of beginnings, with the nodes of `coarse`; then by those of `loop`."""
    mean = float(loop.births.share @ loop.births.xi)
    stiff = float(loop.births.share @ loop.births.kappa)
    left = -_LEFT / loop.cycle
    if loop.delay.mean and not isinstance(loop.delay, Fixed):
        left = max(left, -0.9 / loop.delay.mean)
    scales = [loop.cycle, mean, loop.delay.mean, stiffness / (loop.beta * stiff)]
    scales += [loop.damping / stiffness, math.sqrt(loop.mass / stiffness)]
    scales = [scale for scale in scales if scale > 0.0]
    slow, fast = 0.2 / max(scales), 10.0 / min(scales)
    whole = 2.0 * math.pi / loop.cycle * np.arange(9)
    w = np.append(whole, np.geomspace(slow, fast, 24))
    real = np.append([0.6 * left, 0.15 * left, 0.0], np.geomspace(0.3 * slow, fast, 4))
    grid = (real[:, None] + 1j * w).ravel() + 1e-9 / loop.cycle
    found = _newton(coarse, grid, stiffness)
    found = found[(found.real > left) & (found.imag >= -1e-12)]
    if not found.size:
        return None
    last = _newton(loop, found[np.argsort(-found.real)[:4]], stiffness)
    return complex(last[np.argmax(last.real)]) if last.size else None


def nearest_root(loop: Loop, p: complex, stiffness: float) -> complex:
    """The root that Newton's method reaches from p; p itself if none."""
    found = _newton(loop, np.array([p]), stiffness)
    return complex(found[0]) if found.size else p


def _newton(loop: Loop, p: Array, stiffness: float) -> Array:
    """Roots that Newton's method reaches from p, shape (n,), those above the real axis."""
    found = [p[:0]]
    with np.errstate(all="ignore"):
        for _ in range(_ROUNDS):
            h = 1e-6 * np.abs(p) + 1e-12
            both = loop.balance(np.concatenate((p, p + h)), stiffness)
            f, beyond = both.reshape(2, -1)
            step = f * h / (beyond - f)
            size, most = np.abs(step), 0.5 * (np.abs(p) + 0.1 / loop.cycle)
            after = p - step * np.minimum(1.0, most / np.maximum(size, 1e-300))
            good = np.isfinite(after) & (after.real > -10.0 * _LEFT / loop.cycle)
            still = size > _SETTLED * np.abs(p)
            found.append(after[good & ~still])
            p = after[good & still]
            if not p.size:
                break
    p = np.concatenate(found)
    if not p.size:
        return p
    scale = stiffness + np.abs(loop.mass * p**2) + np.abs(loop.damping * p)
    p = p[np.abs(loop.balance(p, stiffness)) < _FOUND * scale]
    return np.asarray(np.where(p.imag < 0.0, p.conj(), p))
