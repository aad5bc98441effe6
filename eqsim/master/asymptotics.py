"""Closed forms and limits of the published master equation, printed and corrected, side by side.

All for the annealed ensemble with n = 1, soft barriers and uniform stiffness (Braun and Peyrard, 2011, nt01-nt16); no
one of them applies to literal (quenched) contacts at T > 0. Where the printed formula is in error, `printed=True` gives
it as it stands in the paper and the default the correction (derived), so that readers can compare. `u = x/x_*`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from eqsim.errors import require_number
from eqsim.laws.octaves import Array

C_0 = 4.0 / (3.0 * math.sqrt(math.pi))  # nt05


@dataclass(frozen=True)
class Published:
    """The parameters of nt01-nt16, in the user's units: stiffness k, threshold scale x_*, attempt frequency omega,
    temperature kT > 0. Raises InputError."""

    kT: float
    stiffness: float = 1.0
    x_star: float = 1.0
    attempt_frequency: float = 1.0

    def __post_init__(self) -> None:
        for name in ("kT", "stiffness", "x_star", "attempt_frequency"):
            require_number(name, getattr(self, name), above=0)

    def P_c(self, x: Any) -> Array:
        """Law of newborn thresholds (nt01)."""
        u = np.asarray(x) / self.x_star
        return np.asarray(2.0 / self.x_star * u**3 * np.exp(-(u**2)))

    def J_c(self, x: Any) -> Array:
        """P(xi > x) (nt02), which is E_P at T = 0 (nt03b)."""
        u = np.asarray(x) / self.x_star
        return np.asarray((1 + u**2) * np.exp(-(u**2)))

    def P(self, x: Any) -> Array:
        """Mechanical breaking per unit displacement, P_c/J_c (nt03)."""
        u = np.asarray(x) / self.x_star
        return np.asarray(2.0 / self.x_star * u**3 / (1 + u**2))

    def U(self, x: Any) -> Array:
        """int_0^x P (nt03a)."""
        u = np.asarray(x) / self.x_star
        return np.asarray(u**2 - np.log1p(u**2))

    def H(self, x: Any, v: float) -> Array:
        """Thermal breaking per unit displacement, (omega/v) h (temper11, nt08)."""
        u = np.asarray(x) / self.x_star
        h = (1 + (1 + self.b) * u**2) / (1 + self.b) ** 2 * np.exp(-(u**2))
        return np.asarray(self.attempt_frequency / v * h)

    def dU(self, x: Any, v: float) -> Array:
        """int_0^x H (nt09)."""
        u = np.asarray(x) / self.x_star
        return np.asarray(self.S_0(v) * (special.erf(u) - self.S_1 * u * np.exp(-(u**2))))

    def E_P(self, x: Any, v: float) -> Array:
        """Survival to stretch x, J_c exp(-dU) (above nt13)."""
        return np.asarray(self.J_c(x) * np.exp(-self.dU(x, v)))

    @property
    def b(self) -> float:
        """k x_*^2/(2 kT) (nt08a)."""
        return 0.5 * self.stiffness * self.x_star**2 / self.kT

    @property
    def kT_star(self) -> float:
        """Crossover temperature k x_*^2/2 (nt09a)."""
        return 0.5 * self.stiffness * self.x_star**2

    @property
    def f_k0(self) -> float:
        """Kinetic friction at T = 0, a length (nt07)."""
        return C_0 * self.x_star

    @property
    def S_1(self) -> float:
        """nt11."""
        return C_0 / 2 * (1 + self.b) / (1 + self.b / 3)

    @property
    def v_star(self) -> float:
        """Crossover velocity, S_0 = 1 (nt12)."""
        return self.attempt_frequency * self.x_star / C_0 * (1 + self.b / 3) / (1 + self.b) ** 2

    @property
    def eta(self) -> float:
        """Effective viscosity f_k/v at low velocity, a time (nt15a)."""
        return (1 + self.b) ** 2 / self.attempt_frequency

    def S_0(self, v: float) -> float:
        """Total thermal hazard of a life, dU(inf) (nt10)."""
        return self.v_star / v

    def S_2(self, v: float) -> float:
        """Initial slope of dU in u (nt14)."""
        return self.attempt_frequency * self.x_star / (v * (1 + self.b) ** 2)

    def low_velocity(self, v: Any) -> Array:
        """f_k for v << v_* (nt15)."""
        return np.asarray(self.eta * np.asarray(v))

    def high_velocity(self, v: Any, *, printed: bool = False, order: int = 2) -> Array:
        """f_k for v >> v_*, to first or second order in S_2 (nt16).

        The paper puts dU ~ S_2 u, which fails at u ~ 1: its C_1 = 5 sqrt(pi)/8 - C_0 and C_2 = 16/(9 pi) - 1/3 hold for
        no b. Corrected (derived): C_1, C_2 from the moments of dU itself.
        """
        S_2 = self.attempt_frequency * self.x_star / (np.asarray(v) * (1 + self.b) ** 2)
        C_1, C_2 = (0.625 * math.sqrt(math.pi) - C_0, 16 / (9 * math.pi) - 1 / 3) if printed else self._expansion()
        return np.asarray(self.f_k0 * (1 - C_1 * S_2 + (C_2 * S_2**2 if order > 1 else 0.0)))

    def _expansion(self) -> tuple[float, float]:
        """C_1 and C_2 of nt16 with dU in full: moments of J_c dU^k/S_2^k over u."""
        u, weight = np.polynomial.legendre.leggauss(200)
        u, weight = 4.0 * (u + 1), 4.0 * weight
        unit = Published(self.kT, self.stiffness, self.x_star, self.attempt_frequency)
        g = unit.dU(u * self.x_star, 1.0) / unit.S_2(1.0)
        J = unit.J_c(u * self.x_star)
        c = [float(weight @ (J * g**k)) / math.factorial(k) for k in range(3)]
        m = [float(weight @ (u * J * g**k)) / math.factorial(k) for k in range(3)]
        # (m0 - m1 s + m2 s^2)/(c0 - c1 s + c2 s^2), over m0/c0
        first = m[1] / m[0] - c[1] / c[0]
        second = m[2] / m[0] - c[2] / c[0] - c[1] / c[0] * first
        return first, second


def beta(v: Any, v_eta: float, v_d: float) -> Array:
    """Factor by which viscous detached contacts raise the friction of the delayed ensemble (section V): 1 + v^2/(v_eta
    v_d), v_eta = f_k/eta_l, v_d = C/tau."""
    return np.asarray(1 + np.asarray(v) ** 2 / (v_eta * v_d))


def minimum_velocity(v_eta: float, v_d: float, *, printed: bool = False) -> float:
    """Where beta(v)/(1 + v/v_d) is least at fixed C: v_d (sqrt(1 + v_eta/v_d) - 1) (derived); the paper prints its
    limit for v_eta >> v_d, sqrt(v_eta v_d)."""
    return math.sqrt(v_eta * v_d) if printed else v_d * (math.sqrt(1 + v_eta / v_d) - 1)
