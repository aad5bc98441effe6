"""What the stationary state looks like inside, for any law of thresholds: densities of stretches and breaking rates.

P, U, H, dU and E_P are those of the published master equation (Braun and Peyrard, 2011), which describes annealed
contacts; `eqsim.master.closed_forms.Published` has their closed forms for n = 1, soft barriers and uniform stiffness.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from eqsim.model.ensemble import Ensemble, pooled_hazard_of
from eqsim.errors import InputError
from eqsim.estimate import known
from eqsim.numerics.tables import Array
from eqsim.laws.stiffness import relative_stiffness
from eqsim.laws.thermal import NO_POOL, pooled_rate
from eqsim.master import kinetic, published
from eqsim.master.steady import Setting, reference, setting

_NODES, _WEIGHTS = special.roots_legendre(3)
_AT_ONCE = 2048  # stretches, to bound the memory of a call


@dataclass(frozen=True)
class StationaryState:
    """The stationary state of an ensemble at constant `velocity`, in the user's units.

    Stretches x are finite and >= 0, of any shape, which the result has too; they are those of pinned contacts, so that
    a delay plays no part. P to dU are good to 1e-8 relative, densities to 1e-8 of Q(0) and as good as `C`.
    Raises InputError for other stretches, for contacts that age, and where a function does not exist.
    """

    ensemble: Ensemble
    velocity: float

    @functools.cached_property
    def _setting(self) -> Setting:
        if self.ensemble.aging.active:
            raise InputError("aging: the densities are those of contacts that do not age")
        return setting(self.ensemble, self.velocity)

    @functools.cached_property
    def C(self) -> float:
        """C[P], mean stretch at breaking, a length (Q11a; quenched: derived)."""
        return known(reference(self.ensemble, self.velocity).break_stretch)

    def density(self, x: Any) -> Array:
        """Q(x), density of the stretches of pinned contacts, 1/length: P(x_b > x)/C, which is E_P/C for annealed
        contacts (Q11a) and E[S(x|xi); xi > x]/C for quenched ones (derived)."""
        s, u = self._setting, self._lengths("x", x)
        if s.annealed and not s.law.steps.size:
            return self.E_P(x) / self.C
        survivors: Callable[..., Any] = published.survivors if s.annealed else kinetic.survivors
        ascending, back = np.unique(np.maximum(u, 1e-100), return_inverse=True)
        outlast = _in_parts(lambda x: survivors(s.law, s.stiffness, s.barrier, s.b, s.log_w, x)[0], ascending)
        return np.asarray(outlast[back].reshape(u.shape) / self.C)

    def joint_density(self, x: Any, xi: Any) -> Array:
        """Density of pinned contacts in stretch x and own threshold xi > 0, 1/length^2: P_c(xi) S(x|xi)/C on x < xi
        and 0 beyond (derived), where annealed contacts have S = exp(-dU(x)). x and xi are broadcast.

        Raises InputError for a discrete law, which has no density of thresholds.
        """
        s, u, threshold = self._smooth(), self._lengths("x", x), self._lengths("xi", xi)
        if not np.all(threshold > 0):
            raise InputError("xi: every threshold must be > 0")
        if s.annealed:
            survive = np.where(u < threshold, np.exp(-self.dU(x)), 0.0)
        else:
            a = s.b * relative_stiffness(s.stiffness, threshold, s.law.rms / s.law.scale)
            survive = kinetic.survival(s.barrier, u, threshold, a, s.log_w)
        return np.asarray(s.law.pdf(threshold * s.law.scale) * survive / self.C)

    def P(self, x: Any) -> Array:
        """Mechanical breaking per unit displacement, P_c/J_c, 1/length (PcP); infinite where no threshold is left."""
        s = self._master_equation()
        x = self._lengths("x", x) * s.law.scale
        J_c = s.law.sf(x)
        return np.where(J_c > 0, s.law.pdf(x) / np.where(J_c > 0, J_c, 1.0), np.inf)

    def U(self, x: Any) -> Array:
        """int_0^x P = -ln J_c (below Q11a)."""
        s = self._master_equation()
        x = self._lengths("x", x) * s.law.scale
        broken = s.law.cdf(x)
        with np.errstate(divide="ignore"):  # no threshold left
            return np.where(broken < 0.5, -np.log1p(-np.minimum(broken, 0.5)), -np.log(s.law.sf(x)))

    def H(self, x: Any) -> Array:
        """Thermal breaking per unit displacement, (omega/v) h, 1/length (temper11, temper12)."""
        s = self._master_equation()
        return np.asarray(self._rate(self._lengths("x", x)) * np.exp(s.log_w) / s.law.scale)

    def dU(self, x: Any) -> Array:
        """Delta U(x) = int_0^x H (nt09 for any law)."""
        s, u = self._master_equation(), self._lengths("x", x)
        pool = NO_POOL if s.barrier is None else pooled_hazard_of(s.law, s.stiffness, s.barrier, s.b)
        node = np.searchsorted(pool.x, u, side="right")
        low, G = np.append(0.0, pool.x)[node], np.append(0.0, pool.G)[node]
        half = 0.5 * (u - low)[..., None]  # the rest of the way from the node below
        G = G + (half * _WEIGHTS * self._rate(low[..., None] + half * (1.0 + _NODES))).sum(axis=-1)
        return np.asarray(np.exp(s.log_w) * G)

    def E_P(self, x: Any) -> Array:
        """P(x_b > x) = J_c exp(-dU) (above nt13)."""
        return np.asarray(np.exp(-self.dU(x)) * self.ensemble.thresholds.sf(x))

    def _lengths(self, name: str, x: Any) -> Array:
        """`x` in units of the law's scale."""
        x = np.asarray(x, float)
        if not np.all(np.isfinite(x) & (x >= 0)):
            raise InputError(f"{name}: every value must be finite and >= 0")
        return x / self._setting.law.scale

    def _smooth(self) -> Setting:
        if self._setting.law.steps.size:
            raise InputError(f"thresholds = {self.ensemble.thresholds!r}: this needs a law with a density")
        return self._setting

    def _master_equation(self) -> Setting:
        if self.ensemble.disorder == "quenched" and self._setting.barrier is not None:
            raise InputError('disorder = "quenched": the published functions describe "annealed" contacts (or kT = 0)')
        return self._smooth()

    def _rate(self, u: Array) -> Array:
        """h, lengths in units of the law's scale."""
        s = self._setting
        if s.barrier is None:
            return np.zeros_like(u)
        barrier, ahead = s.barrier, np.maximum(u, 1e-100)  # at 0 pooled_rate divides by the barrier's height
        return _in_parts(lambda part: pooled_rate(s.law, s.stiffness, barrier, s.b, part), ahead).reshape(u.shape)


def _in_parts(function: Callable[[Array], Array], x: Array) -> Array:
    return np.concatenate([function(part) for part in np.array_split(x.ravel(), x.size // _AT_ONCE + 1)])
