"""Thresholds of annealed contacts that age: the law P_c of star1 (Braun and Peyrard,
2011)."""

import math
from typing import Any

import numpy as np
from scipy import interpolate

from eqsim.laws.threshold import FIRST_OCTAVE, LAST_OCTAVE, Continuous, Gamma
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array, octave_edges, octave_table


class PooledThresholds(Continuous):
    """Thresholds of annealed contacts that age: Gamma(n, x_*(s)) with s ~ Exp(1) mean
    pinned times, that is

        x_*(s)^2 = x_*f^2 - (x_*f^2 - x_*i^2) exp(-decay s),   decay = 4 D C/(v x_*f^2)

    with the mean pinned time C/v (the resolvent that solves star1, derived); infinite
    `decay` gives the final law. A threshold law like those of `laws.threshold`, except
    that `scale` and `rms` remain those of `newborn`, where the sqrt law has k_i = k.

    The mixture is summed over ln s by the trapezoidal rule and kept as splines of
    ln(-ln J_c) and ln P_c over ln xi, whose error is below 2e-9 for -ln J_c up to 100
    (of P_c 2e-8, of the quantile 5e-8; beyond, J_c is good to 3e-2 at exp(-500)) and
    P(xi < x) down to 1e-16 absolute.
    """

    def __init__(self, newborn: Gamma, final_scale: float, decay: float) -> None:
        self.newborn, self.decay = newborn, decay
        self.final = final_scale / newborn.x_star
        self.scale, self.rms = newborn.scale, newborn.rms
        n, unit = newborn.n, Gamma(newborn.n, 1.0)
        width = 1.0 / math.sqrt(newborn.n + 1.0)
        log_s = np.arange(-39.0, math.log(700.0), min(0.05, 0.2 * width))
        s = np.exp(log_s)
        share = s * np.exp(-s)
        share /= share.sum()  # of births
        age = np.exp(-decay * s) if math.isfinite(decay) else np.zeros(s.size)
        square = self.final**2 - (self.final**2 - 1.0) * age
        use = share > 1e-300
        share, square = share[use], square[use]
        first = float(unit.inverse_survival(2.0**-56)) * min(1, self.final)
        last = float(unit.inverse_survival(520.0)) * max(1, self.final)
        step = 0.02 * max(width, 1e-3)
        log_x = np.arange(math.log(max(first, 1e-18)), math.log(last), step)
        log_share = np.log(share) - (n + 1) * np.log(square)

        def log_density(log_x: Array) -> Array:
            """ln of the density of ln xi."""
            found = np.empty(log_x.size)
            for i in range(0, log_x.size, 256):
                y = log_x[i : i + 256, None]
                terms = log_share - np.exp(2 * y) / square
                most = terms.max(axis=1)
                total = np.exp(terms - most[:, None]).sum(axis=1)
                found[i : i + 256] = most + np.log(total)
            return math.log(2.0) + 2 * (n + 1) * log_x + found - math.lgamma(n + 1.0)

        log_p = log_density(log_x)
        there = log_p > -560.0
        log_x, log_p = log_x[there], log_p[there]
        nodes, weights = gauss_legendre(7)
        half = 0.5 * np.diff(log_x)[:, None]
        inner = log_x[:-1, None] + half * (1.0 + nodes)
        density = np.exp(log_density(inner.ravel()).reshape(inner.shape))
        cells = (half * weights * density).sum(axis=1)
        # a power of xi below the grid
        below = np.exp(log_p[0]) / (2 * (n + 1)) + np.append(0.0, np.cumsum(cells))
        tail = np.exp(log_p[-1]) * (log_x[-1] - log_x[-2]) / (log_p[-2] - log_p[-1])
        above = tail + np.append(np.cumsum(cells[::-1])[::-1], 0.0)
        most = -np.log1p(-np.minimum(below, 0.5))
        log_e = np.log(np.where(below < 0.5, most, -np.log(above)))
        self._log_e = _spline(log_x, log_e)
        self._log_x = _spline(log_e, log_x)
        self._log_pdf = _spline(log_x, log_p - log_x)
        self._range, self._ranks = (log_x[0], log_x[-1]), (log_e[0], log_e[-1])
        self.mean = float(newborn.mean * (share @ np.sqrt(square)))

    def __repr__(self) -> str:
        final = f"{self.final * self.scale:g}"
        return f"PooledThresholds({self.newborn}, {final}, decay={self.decay:g})"

    @property
    def declared(self) -> tuple[Any, ...]:
        # `decay` is an estimate, which no stream may depend on
        return (*self.newborn.declared, "pooled", self.final)

    def _log(self, x: Any) -> tuple[Array, Array]:
        """ln(x/scale) clipped to the splines, and by how much it was below."""
        with np.errstate(divide="ignore"):
            log_x = np.log(np.maximum(np.asarray(x, float), 0.0) / self.scale)
        inside = np.clip(log_x, *self._range)
        return inside, np.minimum(log_x - inside, 0.0)

    def pdf(self, x: Any) -> Array:
        """P_c(x) (star1)."""
        inside, below = self._log(x)
        power = 2 * self.newborn.n + 1
        lowered = power * below if power else np.zeros_like(below)
        return np.asarray(np.exp(self._log_pdf(inside) + lowered) / self.scale)

    def _e(self, x: Any) -> Array:
        """-ln J_c(x)."""
        inside, below = self._log(x)
        power = 2 * (self.newborn.n + 1)
        return np.asarray(np.exp(self._log_e(inside) + power * below))

    def cdf(self, x: Any) -> Array:
        """P(xi <= x)."""
        return -np.expm1(-self._e(x))

    def sf(self, x: Any) -> Array:
        """J_c(x) = P(xi > x)."""
        return np.exp(-self._e(x))

    def inverse_survival(self, e: Any) -> Array:
        """The threshold that a fraction exp(-e) of the contacts exceeds, e in
        (0, 512)."""
        log_e = np.log(np.asarray(e, float))
        inside = np.clip(log_e, *self._ranks)
        # a power of xi
        below = np.minimum(log_e - inside, 0.0) / (2 * (self.newborn.n + 1))
        return np.asarray(self.scale * np.exp(self._log_x(inside) + below))

    def table(self) -> Array:
        """`inverse_survival` in units of `scale` for `threshold_draw`."""
        e = octave_edges(FIRST_OCTAVE, LAST_OCTAVE)
        xi = self.inverse_survival(e)
        slope = np.exp(-e) / self.pdf(xi) / self.scale
        return octave_table(FIRST_OCTAVE, xi / self.scale, slope)


def _spline(x: Array, y: Array) -> Any:
    """A spline of degree 5, as polynomials, which are evaluated twice as fast."""
    return interpolate.PPoly.from_spline(interpolate.make_interp_spline(x, y, k=5))
