"""The inside of the stationary state, for any law of thresholds: densities of stretches
and breaking rates.

P, U, H, dU and E_P are those of the published master equation (Braun and Peyrard,
2011), which describes annealed contacts; `eqsim.master.closed_forms.Published` has
their closed forms for n = 1, soft barriers and uniform stiffness.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from eqsim.errors import InputError
from eqsim.estimate import known
from eqsim.master.annealed import pooled_polynomials, successful_attempts
from eqsim.master.steady import reference
from eqsim.master.survivors import hazard_passed, survivor_moments
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, reduced
from eqsim.numerics.tables import Array

# At stretch 0 barriers are divided by it.
_LEAST_STRETCH = 1e-100


@dataclass(frozen=True)
class StationaryState:
    """The stationary state of contacts that do not age, in the user's units.

    Functions take stretches x >= 0 (length) of any shape, which the result has too;
    they are those of pinned contacts, so that a delay plays no part. P to dU are good
    to 1e-8 relative, densities to 1e-8 of Q(0) and as good as `C`.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Only its velocity counts.

    Raises
    ------
    InputError
        By functions: for contacts that age, for stretches that are negative or not
        finite, and where a function does not exist: the published ones for quenched
        contacts at kT > 0, and any that needs P_c for a discrete law.
    """

    ensemble: Ensemble
    drive: Drive

    @functools.cached_property
    def _reduced(self) -> Reduced:
        require_drive(self.drive)
        if self.ensemble.aging.active:
            raise InputError(
                "aging: the densities are those of contacts that do not age"
            )
        if self.ensemble.newborn.active:
            law = self.ensemble.newborn.law
            raise InputError(
                f'newborn.law = "{law}": the densities are those of contacts born '
                "unstretched"
            )
        return reduced(self.ensemble, self.drive.velocity)

    @functools.cached_property
    def C(self) -> float:
        """C[P], mean stretch at breaking, a length (Q11a; quenched: derived)."""
        return known(reference(self.ensemble, self.drive).break_stretch)

    def density(self, x: Any) -> Array:
        """Q(x), density of the stretches of pinned contacts, 1/length: P(x_b > x)/C,
        which is E_P/C for annealed contacts (Q11a) and E[S(x|xi); xi > x]/C for
        quenched ones (derived)."""
        u = np.maximum(self._lengths("x", x), _LEAST_STRETCH)
        alive = survivor_moments(self._reduced, u.ravel())[0, 0]
        return np.asarray(alive.reshape(u.shape) / self.C)

    def joint_density(self, x: Any, xi: Any) -> Array:
        """Density of pinned contacts in stretch x and own threshold xi > 0, 1/length^2:
        P_c(xi) S(x|xi)/C on x < xi and 0 beyond (derived), where annealed contacts have
        S = exp(-dU(x)). x and xi are broadcast."""
        s, threshold = self._smooth(), self._lengths("xi", xi)
        if not np.all(threshold > 0):
            raise InputError("xi: every threshold must be > 0")
        u, threshold = np.broadcast_arrays(self._lengths("x", x), threshold)
        travel = np.maximum(u.ravel(), _LEAST_STRETCH)
        passed = hazard_passed(s, 0.0 * travel, travel, threshold.ravel())
        survive = np.where(u < threshold, np.exp(-passed).reshape(u.shape), 0.0)
        return np.asarray(s.law.pdf(threshold * s.law.scale) * survive / self.C)

    def P(self, x: Any) -> Array:
        """Mechanical breaking per unit displacement, P_c/J_c, 1/length (PcP); infinite
        where no threshold is left."""
        s = self._published()
        x = self._lengths("x", x) * s.law.scale
        J_c = s.law.sf(x)
        return np.where(J_c > 0, s.law.pdf(x) / np.where(J_c > 0, J_c, 1.0), np.inf)

    def U(self, x: Any) -> Array:
        """int_0^x P = -ln J_c (below Q11a)."""
        s = self._published()
        x = self._lengths("x", x) * s.law.scale
        broken = s.law.cdf(x)
        with np.errstate(divide="ignore"):  # no threshold left
            return np.where(
                broken < 0.5, -np.log1p(-np.minimum(broken, 0.5)), -np.log(s.law.sf(x))
            )

    def H(self, x: Any) -> Array:
        """Thermal breaking per unit displacement, (omega/v) h, 1/length (temper11,
        temper12)."""
        s, u = self._published(), np.maximum(self._lengths("x", x), _LEAST_STRETCH)
        if not s.barrier.thermal:
            return np.zeros_like(u)
        found = successful_attempts(s, u.ravel())
        return np.asarray(found.reshape(u.shape) / s.law.scale)

    def dU(self, x: Any) -> Array:
        """Delta U(x) = int_0^x H (nt09 for any law)."""
        s, u = self._published(), self._lengths("x", x)
        thermal = s.barrier.thermal
        return pooled_polynomials(s).integral(u) if thermal else np.zeros_like(u)

    def E_P(self, x: Any) -> Array:
        """P(x_b > x) = J_c exp(-dU) (above nt13)."""
        return np.asarray(np.exp(-self.dU(x)) * self.ensemble.thresholds.sf(x))

    def _lengths(self, name: str, x: Any) -> Array:
        """`x` in units of the law's scale."""
        x = np.asarray(x, float)
        if not np.all(np.isfinite(x) & (x >= 0)):
            raise InputError(f"{name}: every value must be finite and >= 0")
        return x / self._reduced.law.scale

    def _smooth(self) -> Reduced:
        """The numbers of contacts whose law has a density."""
        if self._reduced.law.steps.size:
            raise InputError(
                f"thresholds = {self.ensemble.thresholds!r}: this needs a law with a "
                "density"
            )
        return self._reduced

    def _published(self) -> Reduced:
        """The numbers of contacts that the published functions describe."""
        if self.ensemble.disorder == "quenched" and self._reduced.barrier.thermal:
            raise InputError(
                'disorder = "quenched": the published functions describe "annealed" '
                "contacts (or kT = 0)"
            )
        return self._smooth()
