"""Quenched contacts whose thresholds fluctuate and age: the joint kinetic equation
(derived from the aging operator L of Braun and Peyrard, 2011, eq. `L`).

A pinned contact of stretch x has a threshold xi; their joint density q(xi, x) obeys,
lengths in units of the newborn scale x_*i, with rho = x_*f/x_*i, D_v = D/(v x_*i) and r
the thermal rate of `laws.barrier`,

    dq/dx = D_v d/dxi [dq/dxi - ((2n+1)/xi - 2 xi/rho^2) q] - (omega x_*i/v) r(x, xi) q    on xi > x,    q(x, x) = 0

from q(xi, 0) = P_ci(xi). Without breaking q would stay in the family of P_ci, with
scale s(x), where s^2 = rho^2 - (rho^2 - 1) exp(-4 D_v x/rho^2). Divide by that law: u =
q/P(xi; s) is the share of contacts now at xi that is still pinned, and in the
coordinate eta = xi/s aging drops out of its equation,

    du/dx = (D_v/s^2) [d2u/deta2 + ((2n+1)/eta - 2 eta) du/deta] - (omega x_*i/v) r(x, s eta) u,    u = 1 at x = 0,

but for the boundary eta = x/s, which only moves up. u is smooth also where the density
is negligible.

Method: central differences of second order on nodes that ride on the boundary (y = eta
- x/s = const) and crowd towards it, on three grids, and extrapolation; in x an L-stable
Runge-Kutta method of fourth order, whose steps are chosen on the coarsest grid, used on
all, and halved there once. The error is the last correction of the extrapolation plus a
third of what halving the steps changes; true errors are some ten times smaller. It is
usually below 1e-6 after half a second; the steep front of very many attempts (log_w =
50) takes seconds.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize, special
from scipy.interpolate import CubicSpline

from eqsim.laws.aging import Langevin
from eqsim.laws.aging.base import scale2
from eqsim.laws.barrier import Barrier
from eqsim.laws.stiffness import StiffnessLaw, relative_stiffness
from eqsim.laws.threshold import Gamma
from eqsim.model.reduced import Reduced
from eqsim.numerics.quadrature import extrapolated, largest_nearby
from eqsim.numerics.tables import Array

# ESDIRK4(3)6L[2]SA of Kennedy and Carpenter (2003): the implicit part of
# ARK4(3)6L[2]SA; last row = weights
_C = np.array([0.0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1.0])
_A = np.zeros((6, 6))
_A[1, :1] = 1 / 4
_A[2, :2] = 8611 / 62500, -1743 / 31250
_A[3, :3] = 5012029 / 34652500, -654441 / 2922500, 174375 / 388108
_A[4, :4] = (15267082809 / 155376265600, -71443401 / 120774400,
             730878875 / 902184768, 2285395 / 8070912)  # fmt: skip
_A[5, :5] = 82889 / 524892, 0.0, 15625 / 83664, 69875 / 102672, -2260 / 8211
_GAMMA = 1 / 4
_B = np.append(_A[5, :5], _GAMMA)
_B_ERROR = _B - [4586570599 / 29645900160, 0.0, 178811875 / 945068544,
                 814220225 / 1159782912, -3700637 / 11593932, 61727 / 225920]  # fmt: skip

# dz of the finest grid.
_FINEST_CELL = 0.04
# dz of the three grids over that of the finest.
_RATIOS = (2.0, 1.5, 1.0)
# y beyond which cells grow no further.
_WIDE = 1.0
# More cells where the thermal front may be, per e-fold of the rate.
_CROWDING = 0.3
# By how much that region is blurred, in ln y.
_BLEND = 0.4
# A smaller gap, and a smaller diffusivity, change nothing that could be seen.
_LEAST_GAP = 1e-14
_LEAST_DIFFUSIVITY = 1e-12
# Error of S and of a tenth of u per step.
_ERROR_OF_STEP = 1e-6
# The largest fall of S in a step, and the longest step over the longest life, as values
# are to be interpolated.
_LARGEST_FALL = 0.04
_STRIDE = 0.01
# Share of what is left in stretch and work, where a life ends.
_NEGLIGIBLE_REST = 1e-11
# Steps at most, of some hundreds that are usual.
_MOST_IN_MARCH = 20_000


class Survival(NamedTuple):
    """A life in the mean, lengths in units of x_*i: ascending stretches `x` (points,)
    from 0 to where nothing that matters survives; `values` there, S(x) = P(x_b > x),
    E[kappa; x_b > x] and E[kappa^2; x_b > x], kappa that of the current threshold, and
    their absolute `errors`, shape (3, points); and int S dx, int x E[kappa; x_b > x]
    dx, and absolute errors of both."""

    x: Array
    values: Array
    errors: Array
    stretch: float
    work: float
    stretch_error: float
    work_error: float


def fluctuating_moments(contacts: Reduced) -> Array:
    """C, work and their errors, shape (4,), of contacts whose thresholds fluctuate."""
    return np.array(survival_of_fluctuating(contacts)[3:])


def fluctuating_survivors(contacts: Reduced, x: Array) -> Array:
    """The `values` of `Survival` at x > 0, shape (3, n)."""
    found = survival_of_fluctuating(contacts)
    values = CubicSpline(np.log(found.x[1:]), found.values[:, 1:], axis=1)
    return np.where(
        x > found.x[-1], 0.0, values(np.log(np.clip(x, found.x[1], found.x[-1])))
    )


def survival_of_fluctuating(contacts: Reduced) -> Survival:
    """The life of a contact whose threshold fluctuates and ages (derived; eq. `L` for
    the unbroken law), remembered: the solution takes a second. A diffusivity D_v below
    1e-12 counts as 1e-12."""
    if not isinstance(contacts.aging, Langevin):
        raise TypeError(f"these thresholds do not fluctuate: {contacts.aging}")
    return _survival(contacts.aging, contacts.stiffness, contacts.barrier)


# A solution takes 0.6 s or more, and a transient asks for it four times; 16 of them are
# a few MB.
@functools.lru_cache(maxsize=16)
def _survival(aging: Langevin, stiffness: StiffnessLaw, barrier: Barrier) -> Survival:
    life = _Life(aging, stiffness, barrier)
    coarse, middle, fine = (_Grid(life, cells * _FINEST_CELL) for cells in _RATIOS)
    first = _solve_along(life, coarse)
    middles = 0.5 * (first.x[1:] + first.x[:-1])
    halved = _solve_along(life, coarse, np.sort(np.append(first.x, middles)))
    second, third = (
        _solve_along(life, middle, first.x),
        _solve_along(life, fine, first.x),
    )
    halving = halved.values[:, ::2] - first.values
    ways = first.values, second.values, third.values
    values, errors = _extrapolated_life(*ways, halving)
    # along x a front that passes the nodes makes the error swing through 0; its
    # neighbours know how far
    size = np.maximum(np.abs(values), 1e-300)
    errors = largest_nearby(errors / size, 15) * size
    halving = halved.totals[:, ::2] - first.totals
    ways = first.totals, second.totals, third.totals
    totals, missed = _extrapolated_life(*ways, halving)
    # the worst on the way to the end, where errors may cancel by chance
    ends = *totals[:, -1].tolist(), *missed.max(axis=1).tolist()
    return Survival(first.x, values, errors, *ends)


def _extrapolated_life(
    first: Array, second: Array, third: Array, halving: Array
) -> tuple[Array, Array]:
    """The value and its error from three grids, whose errors go with the second and
    fourth power of dz, and from what halving the steps changes."""
    h = np.array(_RATIOS) ** 2
    early = extrapolated(first, second, h[0] / h[1])
    late = extrapolated(second, third, h[1] / h[2])
    last = extrapolated(early, late, h[0] / h[2]) - late
    # steps are of fourth order, so that a fifteenth of `halving` is left; a hundredth
    # of the bare change guards against a last correction that is small by chance
    error = np.abs(last) + 0.01 * np.abs(third - second)
    error += np.abs(halving) / 3.0 + 1e-9 * np.abs(late)
    return late + last + halving, error


class _Life:
    """The coefficients of the equation of u, and where it ends."""

    def __init__(
        self, aging: Langevin, stiffness: StiffnessLaw, barrier: Barrier
    ) -> None:
        self.n, self.final2 = aging.shape, aging.final2
        self.stiffness, self.barrier = stiffness, barrier
        self.diffusivity = max(0.25 * aging.alpha * aging.final2, _LEAST_DIFFUSIVITY)
        law = Gamma(self.n)
        self.rms = law.rms
        self.log_norm = math.log(2.0) - special.gammaln(self.n + 1.0)
        # where lives are short by exp(-log_w), contacts as rare as that still count in
        # the mean
        self.top = float(law.inverse_survival(45.0 + max(barrier.log_w, 0.0)))
        most = 2 * self.top * max(1.0, aging.final)
        end = optimize.brentq(lambda x: x - self.top * self.scale(x), 0.0, most)
        self.end = float(end)

    def scale(self, x: float) -> float:
        """s(x), the scale of the unbroken law."""
        return math.sqrt(scale2(self.final2, 4.0 * self.diffusivity * x / self.final2))

    def matrix(self, x: float, grid: "_Grid") -> Array:
        """du/dx = A u: lower, main and upper diagonal of A, those of node j in column
        j, shape (3, N)."""
        s = self.scale(x)
        eta = x / s + grid.y
        # d(x/s)/dx
        slope = 2.0 * self.diffusivity * x / s
        boundary = 1.0 / s - slope * (1.0 / s**2 - 1.0 / self.final2)
        spread = self.diffusivity / s**2
        drift = (boundary + spread * ((2 * self.n + 1) / eta - 2.0 * eta)) * grid.first
        a: Array = spread * grid.second
        a[0] -= drift
        a[2] += drift
        if self.barrier.thermal:
            xi = x + s * grid.y
            b = self.barrier.b * self.kappa(xi)
            a[1] -= np.exp(self.barrier.log_w + self.barrier.log_rate(x, xi, b))
        return a

    def kappa(self, xi: Array) -> Array:
        """k_i/k."""
        return relative_stiffness(self.stiffness, xi, self.rms)

    def survivors(self, x: float, grid: "_Grid", u: Array) -> Array:
        """S, E[kappa; pinned] and E[kappa^2; pinned] at stretch x."""
        s = self.scale(x)
        eta = x / s + grid.y
        log_law = self.log_norm + (2 * self.n + 1) * np.log(eta) - eta**2
        share = np.exp(log_law) * grid.width * u
        kappa = self.kappa(s * eta)
        return np.array([share.sum(), np.dot(share, kappa), np.dot(share, kappa**2)])


class _Grid:
    """Nodes y_j = y(j dz), j = 1 .. N, of a smooth map; u = 0 at y_0 = 0, the boundary.

    dz/dy = 1/(y + least) + 1/_WIDE: even near the boundary, then as ln y, then even
    again; where the thermal front may be the first term is raised by the number of
    e-folds of the rate that the front must tell apart.
    """

    def __init__(self, life: _Life, dz: float) -> None:
        low, high = sorted((1.0, life.scale(life.end)))
        # contacts drift into the boundary within D_v; where they diffuse to it, lives
        # are as short as 1/D_v
        self.least = 1e-3 * min(life.diffusivity / high, low, low**2 / life.diffusivity)
        self.front, self.crowd = (0.0, 0.0), 0.0
        if life.barrier.thermal:
            self.front = _front(life, low, high)
            self.crowd = _CROWDING * min(max(life.barrier.log_w, 0.0), 60.0)
            self.least = min(self.least, 0.1 * math.exp(self.front[0]))
        self.least = max(self.least, _LEAST_GAP)
        count = math.ceil(float(self._z(np.array([life.top]))[0]) / dz)
        # at y_1/2, y_1, y_3/2 ...
        y, slope = self._invert(0.5 * dz * np.arange(1, 2 * count + 2))
        cell = slope * dz  # dy/dj
        self.y, self.width = y[1::2], cell[1::2].copy()
        self.first = 0.5 / self.width  # of the differences u_j+1 - u_j-1
        left, right = 1.0 / (cell[:-1:2] * self.width), 1.0 / (cell[2::2] * self.width)
        # du/dy = 0 at the far end
        left[-1] += right[-1]
        right[-1] = self.first[-1] = 0.0
        self.second = np.array([left, -left - right, right])
        self.width[-1] *= 0.5

    def _z(self, y: Array) -> Array:
        t = np.log(np.append(0.0, y) + self.least)
        near, far = (np.logaddexp(0.0, (t - edge) / _BLEND) for edge in self.front)
        z = t + self.crowd * _BLEND * (near - far)
        return np.asarray(z[1:] - z[0] + y / _WIDE)

    def _slope(self, y: Array) -> Array:
        """dz/dy."""
        t = np.log(y + self.least)
        near, far = (special.expit((t - edge) / _BLEND) for edge in self.front)
        crowding = 1.0 + self.crowd * (near - far)
        return np.asarray(crowding / (y + self.least) + 1.0 / _WIDE)

    def _invert(self, z: Array) -> tuple[Array, Array]:
        """y and dy/dz, by Newton's method in t = ln(1 + y/least)."""
        t = np.linspace(0.0, math.log1p(1e4 / self.least), 20_001)
        t = np.interp(z, self._z(self.least * np.expm1(t)), t)
        for _ in range(5):
            y = self.least * np.expm1(t)
            t -= (self._z(y) - z) / (self._slope(y) * (y + self.least))
        y = self.least * np.expm1(t)
        return y, 1.0 / self._slope(y)


def _front(life: _Life, low: float, high: float) -> tuple[float, float]:
    """ln y of the nearest and the farthest gap at which thermal breaking may end: the
    rate falls within `layer` at large stretch, and at no stretch with the barrier
    itself."""
    x, b, log_w = life.top * high, life.barrier.b, life.barrier.log_w
    layer = x * min(life.barrier.layer(x, b * float(life.kappa(np.array(x)))), 1.0)
    attempts = max(log_w, 1.0)
    near = 0.5 * layer * max(log_w + math.log(layer), 1.0)
    far = 1.4 * (
        (attempts * life.rms / b) ** (1 / 3)
        if life.stiffness == "sqrt"
        else math.sqrt(attempts / b)
    )
    near = min(near / high, life.top)
    return math.log(near), math.log(min(max(far / low, near), life.top))


class _March(NamedTuple):
    """`x` (steps + 1,), `values` of `survivors` there (3, steps + 1), `totals` =
    stretch and work up to there (2, steps + 1)."""

    x: Array
    values: Array
    totals: Array


def _solve_along(life: _Life, grid: _Grid, stops: Array | None = None) -> _March:
    """u from x = 0 on: by steps that end at `stops`, or of controlled error until
    nothing that matters is left."""
    u, matrix = np.ones(grid.y.size), life.matrix(0.0, grid)
    matrix[0, 0] = 0.0  # it belongs to the boundary, where u = 0
    state = _State(u, matrix.sum(axis=0), life.survivors(0.0, grid, u))
    path, values, totals = [0.0], [state.survivors], [np.zeros(2)]
    h = 1e-10 * min(life.end, math.exp(-life.barrier.log_w))
    for _ in range(_MOST_IN_MARCH):
        x = path[-1]
        h = min(h, life.end - x) if stops is None else stops[len(path)] - x
        step = _solve_step(life, grid, x, h, state)
        if stops is None:
            # u never grows, neither in the mean nor anywhere, so that errors at most
            # add up
            error = np.abs(step.u_error)
            sizes = (
                life.survivors(x + h, grid, error) / step.end.survivors,
                np.abs(step.gain_error) / (totals[-1] + step.gain),
                [0.1 * error.max() / step.end.u.max()],
            )
            fall = (state.survivors[0] - step.end.survivors[0]) / _LARGEST_FALL
            size = np.append(np.concatenate(sizes) / _ERROR_OF_STEP, fall**4)
            worst = max(float(np.where(size >= 0.0, size, np.inf).max()), 1e-9)
            following = h * min(5.0, max(0.1, 0.9 * worst**-0.25))
            if worst > 1.0:
                h = following
                continue
            h, after = min(following, _STRIDE * life.end), x + h
        else:
            after = stops[len(path)]
        state = step.end
        path.append(after)
        values.append(state.survivors)
        totals.append(totals[-1] + step.gain)
        left = state.survivors[:2] * (life.end - after, life.end**2)
        over = bool(np.all(left < _NEGLIGIBLE_REST * totals[-1])) or after >= life.end
        if over if stops is None else len(path) == stops.size:
            return _March(np.array(path), np.array(values).T, np.array(totals).T)
    raise ArithmeticError(
        f"the Fokker-Planck equation was not solved in {_MOST_IN_MARCH} steps: {vars(life)}"
    )


class _State(NamedTuple):
    """u, du/dx and `survivors` at a stretch."""

    u: Array
    slope: Array
    survivors: Array


class _Step(NamedTuple):
    """The state after a step, stretch and work gained in it, and the estimated errors
    of u and of these."""

    end: _State
    gain: Array
    u_error: Array
    gain_error: Array


def _solve_step(life: _Life, grid: _Grid, x: float, h: float, start: _State) -> _Step:
    """Solve from x to x + h."""
    slopes, alive, stages = np.empty((6, start.u.size)), np.empty((6, 3)), x + _C * h
    slopes[0], alive[0] = start.slope, start.survivors
    for i in range(1, 6):
        known = start.u + h * (_A[i, :i] @ slopes[:i])
        lower, main, upper = life.matrix(stages[i], grid) * (-_GAMMA * h)
        u = linalg.lapack.dgtsv(lower[1:], 1.0 + main, upper[:-1], known)[3]
        slopes[i] = (u - known) / (_GAMMA * h)
        alive[i] = life.survivors(stages[i], grid, u)
    rates = alive[:, :2] * np.stack((np.ones(6), stages), axis=1)
    end = _State(u, slopes[-1], alive[-1])
    return _Step(end, h * (_B @ rates), h * (_B_ERROR @ slopes), h * (_B_ERROR @ rates))
