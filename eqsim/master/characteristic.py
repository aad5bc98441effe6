"""Linear stability of steady sliding through a spring (derived).

While X = V t + x exp(p t), contacts born at a rate that varies as exp(p t) break after
a displacement xi. To first order in x the force of all changes by Z(p) x, so that
perturbations obey, all per N k,

    m p^2 + eta_s p + kappa_s + Z(p) = 0,
    Z(p) = beta (1 - D) (drag (1 - P) - q M)/(1 - D P) + eta_l p (1 - pinned),

    P = E[exp(-q xi)],   M = E[(k_i/k) (1 - exp(-q xi) (1 + q xi))/q^2],
    q = p/V,   D = E[exp(-p delay)],
    beta = 1/(C + V tau),   drag = eta_l V,   pinned = beta C,

where births answer to breaks as b = D Gamma, Gamma = p beta (1 - P)/(1 - D P) being the
perturbation of breaks, and the detached share changes by Gamma (1 - D)/p. M is the
transform of x E[k_i/k; xi > x]. Without delay D = 1 and Z = 0: no perturbation is
amplified or damped by the contacts. Of contacts that heat breaks or that age,
`master.lives` has Z.

Lengths are in units of the law's scale and time is displacement, V = 1. Means over
births are sums over Gauss-Legendre nodes in the normal deviate of the threshold. Two
sets of panels, of different range, give the result and its error. The error is large
where rare, strong thresholds let the means of decaying exponentials diverge.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.laws.aging import Unaged
from eqsim.laws.delay import DelayLaw, Fixed
from eqsim.master.lives import Lives, lives_of
from eqsim.master.programme import cells_of_law
from eqsim.master.quenched import different_steps, kappa_of
from eqsim.model.reduced import Pull, Reduced
from eqsim.numerics.tables import Array

METHOD = "characteristic equation"


class Nodes(NamedTuple):
    """Resolution of a law: panels, and the range of thresholds on either side in normal
    deviates; and panels of equally spaced ages of contacts that heat breaks or that
    age."""

    panels: int
    reach: float
    ages: int


FINE = Nodes(128, 8.2, 14)
# Fewer panels and a smaller range than FINE, so that the difference shows the error of
# either.
COARSE = Nodes(64, 7.4, 10)
# The error of FINE over its difference from COARSE: tables of rates are of second order,
# with 1.4 times as many cells.
OF_COARSER = 1.5
# Fewest panels, for scans.
SCAN = Nodes(24, 8.2, 6)
# Of these panels of thresholds so many fewer where heat blurs them.
_BLURRED = 4
# Coefficients of (1 - exp(-z)(1 + z))/z^2.
_SERIES = np.array([(-1.0) ** k * (k - 1) / math.factorial(k) for k in range(2, 18)])
# Terms that are summed at once, to bound memory.
_TERMS_AT_ONCE = 2**21
# The step of the scan in phase over a cycle.
_PHASE = 0.05
# The first range of the scan, over 1/(mean threshold).
_FIRST_RANGE = 6.0
# Most points of the scan.
_SCAN_POINTS = 100_000
# Share of the largest Z below which no border is sought.
_FAINT = 1e-4
# Rounds of Newton's method.
_ROUNDS = 25
# The relative step that ends it, after which a root is good to its square, or to
# rounding.
_LAST_STEP = 1e-8
# Largest value of the equation at a root, relative to its terms.
_AT_ROOT = 1e-9
# Largest decay per cycle of a root that is sought.
_FASTEST_DECAY = 4.0

# Most roots of the coarser nodes that are followed to those of the finer ones: rapid
# growth within a panel of ages makes some that do not exist.
_CANDIDATES = 12

# |p| times a panel of thresholds whose eight nodes resolve exp(-p xi), to 1e-10.
_FOLLOWED = 6.0

# |p| times a panel of ages that its eight nodes resolve, to 1e-5 of Z.
_RESOLVED = 8.0

# An estimate without a value.
NO_VALUE = Estimate(None, None, 0)


class Mode(NamedTuple):
    """Slowest perturbation: rate of growth (1/time; negative: it decays), and period
    (time), which has no value if it does not oscillate; neither has one if all decay
    within a cycle."""

    growth: Estimate
    period: Estimate


def mode(p: complex, error: float, least: float, reliable: bool = True) -> Mode:
    """Mode exp(p t), p with an `error`; it oscillates if its frequency exceeds
    `least`."""
    growth, period = Estimate(p.real, error, 0, None, reliable), None
    frequency = abs(p.imag)
    if frequency > least:
        period = 2.0 * math.pi / frequency
    missed = period and period * error / frequency
    return Mode(growth, Estimate(period, missed, 0, None, reliable))


class Panels(NamedTuple):
    """Panels of thresholds: their ends, arrays (panels,), and the matrices that turn
    integrals of Legendre polynomials over a panel into weights of its nodes over their
    shares, shape (panels, nodes, nodes)."""

    low: Array
    high: Array
    weights: Array

    @classmethod
    def between(cls, edges: Array, nodes: Array) -> "Panels":
        """Panels between edges, with nodes (panels, nodes) in them."""
        low, high = edges[:-1], edges[1:]
        half = np.where(high > low, 0.5 * (high - low), 1.0)[:, None]
        at = (nodes - 0.5 * (low + high)[:, None]) / half
        values = np.polynomial.legendre.legvander(at, nodes.shape[1] - 1)
        weights = np.linalg.pinv(values).transpose(0, 2, 1)
        return cls(low, high, weights / (2.0 * weights[..., :1]))

    def unresolved(self, p: Array) -> tuple[Array, Array]:
        """Find the nodes in whose panel exp(-p xi) changes too much for the rule of
        Gauss, and the numbers that take its place there by the rule of Filon, exact for
        densities that are polynomials within a panel; both of shape (n, nodes) for p of
        shape (n,)."""
        z = 0.5 * p[:, None] * (self.high - self.low)
        order = self.weights.shape[1]
        steep = np.repeat(2.0 * np.abs(z) > _FOLLOWED, order, axis=1)
        first, last = np.exp(-p[:, None] * self.low), np.exp(-p[:, None] * self.high)
        # panels without a width are not steep
        with np.errstate(all="ignore"):
            integrals = [(first - last) / z, (first - last) / z**2 - (first + last) / z]
            for n in range(1, order - 1):
                integrals.append(integrals[-2] + (2 * n + 1) * integrals[-1] / z)
            found = self.weights @ np.array(integrals).transpose(2, 0, 1)
        return steep, found.transpose(2, 0, 1).reshape(steep.shape)


class Loop(NamedTuple):
    """Numbers of the characteristic equation: thresholds of newborn contacts, their
    shares and kappa, arrays (nodes,); delays; the viscous force of a detached contact;
    beta; the damping, with that by the mean share of detached contacts; the mass of
    the slider; lives of contacts that heat breaks or that age, else None; and panels of
    the thresholds unless the law is discrete."""

    xi: Array
    share: Array
    kappa: Array
    delay: DelayLaw
    drag: float
    beta: float
    damping: float
    mass: float
    lives: Lives | None = None
    panels: Panels | None = None

    @property
    def travel(self) -> float:
        """Mean travel of a contact."""
        return self.lives.travel if self.lives else float(self.share @ self.xi)

    @property
    def scatter(self) -> float:
        """Variance of the lengths of cycles."""
        if self.lives:
            return self.lives.scatter + self.delay.variance
        square = float(self.share @ self.xi**2) - self.travel**2
        return max(square, 0.0) + self.delay.variance

    @property
    def stiffness(self) -> float:
        """Mean stiffness of contacts."""
        return self.lives.stiffness if self.lives else float(self.share @ self.kappa)

    @property
    def cycle(self) -> float:
        """Mean length of a cycle, C + V tau."""
        return 1.0 / self.beta

    def resolves(self, p: complex) -> bool:
        """True if panels of ages are short beside a period, growth and decay; else
        perturbations are found that do not exist. No panels can be short beside none.
        """
        if self.lives is None or math.isinf(abs(p)):
            return True
        return abs(p) * float(self.lives.width.max()) < _RESOLVED

    def response(self, p: Array) -> Array:
        """Z without its term in eta_l p (1 - pinned), which is in `damping`; p complex,
        not 0, shape (n,)."""
        top, bottom = self._fraction(p)
        return top / bottom

    def _fraction(self, p: Array) -> Array:
        """Z as a fraction of two functions without poles, shape (2, n); the lower one is
        (1 - D P)/p, which is 0 at the poles of Z."""
        if self.lives:
            numbers = self.delay, self.drag
            found = [self.lives.fraction(z, *numbers) for z in p.tolist()]
            top, bottom = np.array(found, complex).reshape(-1, 2).T
            return np.array([self.beta * top, bottom])
        if p.size * self.xi.size > _TERMS_AT_ONCE and p.size > 1:
            halves = [self._fraction(p) for p in np.array_split(p, 2)]
            return np.concatenate(halves, axis=1)
        z = p[:, None] * self.xi
        lost, far = -np.expm1(-z), np.abs(z) >= 0.5
        if self.panels:
            steep, decay = self.panels.unresolved(p)
            lost, far = np.where(steep, 1.0 - decay, lost), far | steep
        broken = lost @ self.share  # 1 - P
        work = np.empty_like(z)
        work[~far] = np.polynomial.polynomial.polyval(z[~far], _SERIES)
        work[far] = (lost[far] - z[far] * (1.0 - lost[far])) / z[far] ** 2
        M = work @ (self.share * self.kappa * self.xi**2)
        away = self.delay.forgotten(p)  # 1 - D
        change = self.beta * away * (self.drag * broken - p * M)
        return np.array([change, away + (1.0 - away) * broken]) / p

    def balance(self, p: Array, stiffness: float) -> Array:
        """The characteristic equation, shape (n,)."""
        return self._held(p, stiffness) + self.response(p)

    def without_poles(self, p: Array, stiffness: float) -> Array:
        """The characteristic equation times (1 - D P)/p, shape (n,)."""
        top, bottom = self._fraction(p)
        return np.asarray(self._held(p, stiffness) * bottom + top)

    def _held(self, p: Array, stiffness: float) -> Array:
        """Force of the spring, the damping and the mass."""
        return np.asarray(self.mass * p**2 + self.damping * p + stiffness)


def loop_of(contacts: Reduced, pull: Pull, nodes: Nodes) -> Loop:
    """Numbers of the characteristic equation, with `nodes` that represent the law, or
    all thresholds of a discrete law. Raises InputError for identical contacts with a
    fixed delay."""
    law, delay = contacts.law, contacts.delay
    simple = not contacts.barrier.thermal and isinstance(contacts.aging, Unaged)
    cells = None
    if law.steps.size:
        xi, share, kappa = different_steps(contacts)
        if xi.size == 1 and isinstance(delay, Fixed) and not contacts.barrier.thermal:
            raise InputError(
                "thresholds: identical contacts with a fixed delay stay in step; no "
                "steady state"
            )
    else:
        panels = nodes.panels if simple else nodes.panels // _BLURRED
        even = np.linspace(-nodes.reach, nodes.reach, panels + 1)
        edges, inner, weights = cells_of_law(law, law.kinks, even, 8)
        cells = Panels.between(edges, inner)
        xi, share = inner.ravel(), weights.ravel()
        kappa = kappa_of(contacts, xi)
    lives = None if simple else lives_of(contacts, xi, share, nodes.ages)
    drag, mass = contacts.drag, pull.mass
    loop = Loop(xi, share, kappa, delay, drag, 1.0, pull.damping, mass, lives, cells)
    beta = 1.0 / (loop.travel + delay.mean)
    damping = pull.damping + drag * beta * delay.mean
    return loop._replace(beta=beta, damping=damping)


class Border(NamedTuple):
    """The largest stiffness at which a perturbation neither grows nor decays, and its
    frequency (0 without one)."""

    stiffness: float
    frequency: float


def border_of(loop: Loop, coarse: Loop) -> Border:
    """Find the stiffness below which steady sliding is unstable: the greatest of
    m w^2 - Re Z(i w) over the roots of eta w + Im Z(i w) = 0.

    It is infinite for a slider with a mass and no damping if the delay is fixed, as Im
    Z changes its sign whenever w tau is near a multiple of 2 pi. The scan, with the
    nodes of `coarse`, ends where -Re Z is below the greatest so far over an octave, in
    which sharp edges of a law resonate, or |Im Z| too small for another root; for
    discrete thresholds without damping, whose |Z| does not fall, after `_SCAN_POINTS`
    steps. Raises InputError if with a mass it does not end.
    """
    if loop.mass > 0.0 and loop.damping == 0.0 and isinstance(loop.delay, Fixed):
        return Border(math.inf, math.inf)
    mean, apart = coarse.travel, coarse.scatter
    # contacts in step lose 2 (pi width)^2 of a phase in a cycle, width being the
    # scatter of cycles over their length
    step = _PHASE * min(1.0, 20.0 * apart / loop.cycle**2 + 0.02) / loop.cycle
    best, largest, low, high = Border(0.0, 0.0), 0.0, step, _FIRST_RANGE / mean
    while True:
        if high / step > _SCAN_POINTS:
            if low == step:
                raise InputError(
                    f"delay.time: is {loop.delay.mean / mean:.3g} thresholds long; the "
                    "border is out of reach"
                )
            if loop.mass == 0.0:
                return best
            raise InputError(
                "drive.stage: its damping is too small beside its mass to find the "
                "border of stability"
            )
        w = np.arange(low, high + step, step)
        Z = coarse.response(1j * w)
        late = w >= 0.5 * high
        weakening = float(-Z.real[late].min())
        size = float(np.abs(Z.imag[late]).max())
        largest = max(largest, float(-Z.real.min()))
        phase = loop.damping * w + Z.imag
        for i in np.flatnonzero(phase[:-1] * phase[1:] < 0.0):
            best = max(best, _crossing(loop, w[i], w[i + 1]))
        border = max(best.stiffness, _FAINT * largest)
        rising = loop.delay.mean * high
        if 0.0 < rising < 1.0:
            # at most beta tau is the same whatever the thresholds; the rest, of sharp
            # edges of a law, may rise as |1 - D|, up to w tau = 1
            edges = largest - loop.beta * loop.delay.mean
            weakening = max(weakening, edges / rising)
        faint = loop.mass == 0.0 and weakening <= border
        if faint or loop.damping * high > 2.0 * size:
            return best
        low, last, high = float(w[-1]), high, 2.0 * high
        if loop.mass > 0.0 and loop.damping > 0.0:
            # |Z| falls as 1/w from here on
            end = math.sqrt(2.0 * size * last / loop.damping)
            high = max(high, end) if end > _SCAN_POINTS * step else high


def _crossing(loop: Loop, low: float, high: float) -> Border:
    """Crossing of a root and the imaginary axis between two frequencies."""

    def balance(w: float) -> complex:
        return complex(loop.balance(np.array([1j * w]), 0.0)[0])

    def phase(w: float) -> float:
        return balance(w).imag

    if phase(low) * phase(high) > 0.0:  # a root of the coarser nodes only
        return Border(0.0, 0.0)
    w = float(optimize.brentq(phase, low, high, xtol=1e-14, rtol=1e-13))
    return Border(-balance(w).real, w)


def root_of(loop: Loop, coarse: Loop, stiffness: float) -> complex | None:
    """Find the slowest root, if any, from `guesses_of` of `coarse`."""
    roots = slowest_first(loop, guesses_of(coarse, stiffness), stiffness)
    return roots[0] if roots else None


def slowest_first(loop: Loop, guesses: Array, stiffness: float) -> list[complex]:
    """Find roots of the characteristic equation, imaginary part >= 0, by Newton's method
    from guesses, those with the largest real part first."""
    roots = roots_from(loop, guesses, stiffness)
    return list(roots[np.argsort(-roots.real)].tolist())


def guesses_of(loop: Loop, stiffness: float) -> Array:
    """Find roots of the characteristic equation with few nodes, by Newton's method from
    a grid: guesses, shape (n,), of those that decay no faster than `_FASTEST_DECAY` per
    cycle."""
    mean, stiff = loop.travel, loop.stiffness
    left = -_FASTEST_DECAY / loop.cycle
    if loop.delay.variance:  # E[exp(-p delay)] of the gamma law has a pole
        left = max(left, -0.9 * loop.delay.mean / loop.delay.variance)
    scales = [loop.cycle, mean, loop.delay.mean, stiffness / (loop.beta * stiff)]
    scales += [loop.damping / stiffness, math.sqrt(loop.mass / stiffness)]
    scales = [scale for scale in scales if scale > 0.0]
    slow, fast = 0.2 / max(scales), 10.0 / min(scales)
    whole = 2.0 * math.pi / loop.cycle * np.arange(9)
    w = np.append(whole, np.geomspace(slow, fast, 24))
    real = np.append(
        [0.6 * left, 0.15 * left, 1e-9 / loop.cycle], np.geomspace(0.3 * slow, fast, 4)
    )
    grid = (real[:, None] + 1j * w).ravel()
    # behind a stiff spring they are next to poles, which are near harmonics of a cycle
    harmonics = (real[:3, None] + 1j * whole).ravel()
    near = roots_from(loop, harmonics, stiffness)
    roots = np.append(_newton(loop, grid, stiffness, poles=True), near)
    roots = roots[(roots.real > left) & (roots.imag >= -1e-12)]
    # one guess in each group that is closer than it is worth
    roots = roots[np.unique(np.round(roots * loop.cycle, 3), return_index=True)[1]]
    return roots[np.argsort(-roots.real)[:_CANDIDATES]]


def roots_from(loop: Loop, p: Array, stiffness: float) -> Array:
    """Find roots above the real axis that Newton's method reaches from p, shape (n,);
    by the equation without poles only where panels of ages resolve it, as elsewhere it
    has more roots that do not exist."""
    sure = np.array([loop.resolves(z) for z in p.tolist()], bool)
    found = _newton(loop, p[sure], stiffness, poles=False)
    found = found[[loop.resolves(z) for z in found.tolist()]] if found.size else found
    return np.append(found, _newton(loop, p[~sure], stiffness, poles=True))


def _newton(loop: Loop, p: Array, stiffness: float, *, poles: bool) -> Array:
    """Find roots above the real axis by Newton's method, from p, shape (n,), on the
    equation with or without its `poles`."""
    equation = loop.balance if poles else loop.without_poles
    roots = [p[:0]]
    with np.errstate(all="ignore"):
        for _ in range(_ROUNDS):
            if not p.size:
                break
            h = 1e-6 * np.abs(p) + 1e-12
            both = equation(np.concatenate((p, p + h)), stiffness)
            f, beyond = both.reshape(2, -1)
            step = f * h / (beyond - f)
            size, most = np.abs(step), 0.5 * (np.abs(p) + 0.1 / loop.cycle)
            after = p - step * np.minimum(1.0, most / np.maximum(size, 1e-300))
            good = np.isfinite(after)
            good &= after.real > -10.0 * _FASTEST_DECAY / loop.cycle
            still = size > _LAST_STEP * np.abs(p)
            roots.append(after[good & ~still])
            p = after[good & still]
    p = np.concatenate(roots)
    scale = stiffness + np.abs(loop.mass * p**2) + np.abs(loop.damping * p)
    if not poles:
        scale /= np.abs(p) + 1.0 / loop.cycle  # as (1 - D P)/p, but for its roots
    p = p[np.abs(equation(p, stiffness)) < _AT_ROOT * scale]
    return np.asarray(np.where(p.imag < 0.0, p.conj(), p))
