"""Closed forms and limits of the published master equation, printed and corrected, side
by side.

All for the annealed ensemble with n = 1, soft barriers and uniform stiffness (Braun and
Peyrard, 2011, nt01-nt16, and star3-star4 for aging contacts); no one of them applies to
literal (quenched) contacts at T > 0. Where the printed formula is in error,
`printed=True` gives it as it stands in the paper and the default the correction
(derived), so that readers can compare. `u = x/x_*`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from eqsim.errors import NOT_NEGATIVE, POSITIVE, require_number
from eqsim.numerics.quadrature import gauss_legendre
from eqsim.numerics.tables import Array

C_0 = 4.0 / (3.0 * math.sqrt(math.pi))  # nt05


@dataclass(frozen=True)
class Published:
    """nt01-nt16, in the user's units; functions take stretches x (length) and
    velocities v of any shape.

    Parameters
    ----------
    kT : float
        Temperature (energy), > 0.
    stiffness, x_star, attempt_frequency : float
        k (force/length), x_* (length) and omega (1/time).

    Raises
    ------
    InputError
        For values that are not positive.
    """

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
        bracket = special.erf(u) - self.S_1 * u * np.exp(-(u**2))
        return np.asarray(self.S_0(v) * bracket)

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
        attempts = self.attempt_frequency * self.x_star
        return attempts / C_0 * (1 + self.b / 3) / (1 + self.b) ** 2

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

        The paper puts dU ~ S_2 u, which fails at u ~ 1: its C_1 = 5 sqrt(pi)/8 - C_0
        and C_2 = 16/(9 pi) - 1/3 hold for no b. Corrected (derived): C_1, C_2 from the
        moments of dU itself.
        """
        S_2 = self.attempt_frequency * self.x_star / (np.asarray(v) * (1 + self.b) ** 2)
        C_1, C_2 = self._expansion()
        if printed:
            C_1, C_2 = 0.625 * math.sqrt(math.pi) - C_0, 16 / (9 * math.pi) - 1 / 3
        second = C_2 * S_2**2 if order > 1 else 0.0
        return np.asarray(self.f_k0 * (1 - C_1 * S_2 + second))

    def _expansion(self) -> tuple[float, float]:
        """C_1 and C_2 of nt16 with dU in full: moments of J_c dU^k/S_2^k over u."""
        u, weight = gauss_legendre(200).between(np.array(0.0), np.array(8.0))
        g, J = self.dU(u * self.x_star, 1.0) / self.S_2(1.0), self.J_c(u * self.x_star)
        c = [float(weight @ (J * g**k)) / math.factorial(k) for k in range(3)]
        m = [float(weight @ (u * J * g**k)) / math.factorial(k) for k in range(3)]
        # (m0 - m1 s + m2 s^2)/(c0 - c1 s + c2 s^2), over m0/c0
        first = m[1] / m[0] - c[1] / c[0]
        second = m[2] / m[0] - c[2] / c[0] - c[1] / c[0] * first
        return first, second


@dataclass(frozen=True)
class PublishedAging:
    """Aging contacts at high velocity, to first order in 1/v (star3-star4), that is for
    S_2, |S_3| << 1; u_i = x/x_*i.

    Newborn thresholds follow nt01 with x_*i and age towards nt01 with x_*f.

    Parameters
    ----------
    rate : float
        D (length^2/time).
    x_star_initial, x_star_final : float
        x_*i and x_*f (length).
    kT, stiffness, attempt_frequency : float
        As in `Published`; kT may be 0.

    Raises
    ------
    InputError
        For values out of range.
    """

    rate: float
    x_star_initial: float
    x_star_final: float
    kT: float = 0.0
    stiffness: float = 1.0
    attempt_frequency: float = 1.0

    def __post_init__(self) -> None:
        for name in ("rate", "kT", "attempt_frequency"):
            require_number(name, getattr(self, name), **NOT_NEGATIVE)
        for name in ("x_star_initial", "x_star_final", "stiffness"):
            require_number(name, getattr(self, name), **POSITIVE)

    @property
    def b(self) -> float:
        """k x_*i^2/(2 kT) of newborn contacts (nt08a); infinite at kT = 0."""
        energy = 0.5 * self.stiffness * self.x_star_initial**2
        return energy / self.kT if self.kT > 0 else math.inf

    @property
    def inverse_x_if_squared(self) -> float:
        """1/x_if^2 = 1/x_*i^2 - 1/x_*f^2, negative if contacts weaken (star3c)."""
        return 1.0 / self.x_star_initial**2 - 1.0 / self.x_star_final**2

    def S_2(self, v: Any) -> Array:
        """Initial slope of dU in u_i (nt14 of newborn contacts); 0 at kT = 0."""
        attempts = self.attempt_frequency * self.x_star_initial
        return np.asarray(attempts / (np.asarray(v) * (1 + self.b) ** 2))

    def S_3(self, v: Any) -> Array:
        """4 D_v C/x_if^2, D_v = D/v (star4c). C is C[P] of newborn contacts at T = 0,
        x_*i/C_0: whatever C gains from aging or loses to temperature is of first order
        in 1/v, and changes S_3 in the second only."""
        per_C = 4 * self.rate / np.asarray(v) * self.inverse_x_if_squared
        return np.asarray(per_C * self.x_star_initial / C_0)

    def P_change(self, x: Any, v: float, *, printed: bool = False) -> Array:
        """P_c - P_ci (star3a). The paper has u_i in place of u_i^3, which does not
        integrate to 0."""
        u = np.asarray(x) / self.x_star_initial
        power = u if printed else u**3
        change = -4 * self.S_3(v) / self.x_star_initial * power
        return np.asarray(change * np.exp(-(u**2)) * (1 - u**2 / 2))

    def J_change(self, x: Any, v: float) -> Array:
        """J_c - J_ci (star3b, correct as printed)."""
        u = np.asarray(x) / self.x_star_initial
        return np.asarray(self.S_3(v) * u**4 * np.exp(-(u**2)))

    def C(self, v: Any, *, printed: bool = False) -> Array:
        """Mean stretch at breaking x_*i (1/C_0 - a S_2 + C_12 S_3) (star4a).

        Printed: a = 1, from dU ~ S_2 u, and C_12 = 1.324, from the slip in star3a.
        Corrected (derived): a = int J_ci dU/S_2 du = 9 pi/32 + (3 pi/32 - 1/8) b and
        C_12 = int u^4 exp(-u^2) du = 3 sqrt(pi)/8.
        """
        C_12 = 1.324 if printed else 3 * math.sqrt(math.pi) / 8
        slope = (1.0, 0.0) if printed else (9 * math.pi / 32, 3 * math.pi / 32 - 1 / 8)
        thermal = self._thermal(v, *slope)
        return np.asarray(
            self.x_star_initial * (1 / C_0 - thermal + C_12 * self.S_3(v))
        )

    def f_k(self, v: Any, *, printed: bool = False) -> Array:
        """Kinetic friction (x_*i^2/C)(1 - c S_2 + C~_12 S_3), a length (star4b).

        Printed: c = C_0 + C_1 = 5 sqrt(pi)/8 and C~_12 = 1.789, for the same reasons as
        in `C`. Corrected (derived): c = int u J_ci dU/S_2 du = sqrt(pi/2) (47 + 11
        b)/64 and C~_12 = int u^5 exp(-u^2) du = 1.
        """
        C_12 = 1.789 if printed else 1.0
        root = math.sqrt(math.pi / 2) / 64
        slope = (5 * math.sqrt(math.pi) / 8, 0.0) if printed else (47 * root, 11 * root)
        bracket = 1 - self._thermal(v, *slope) + C_12 * self.S_3(v)
        return np.asarray(self.x_star_initial**2 / self.C(v, printed=printed) * bracket)

    def _thermal(self, v: Any, constant: float, slope: float) -> Array:
        """(constant + slope b) S_2; 0 at kT = 0, where b is infinite."""
        factor = constant + slope * self.b if self.kT > 0 else 0.0
        return np.asarray(factor * self.S_2(v))


def beta(v: Any, v_eta: float, v_d: float) -> Array:
    """Factor 1 + v^2/(v_eta v_d), of the shape of v, by which viscous detached contacts
    raise the friction of the delayed ensemble (section V) at velocities v, with v_eta =
    f_k/eta_l and v_d = C/tau (velocities)."""
    return np.asarray(1 + np.asarray(v) ** 2 / (v_eta * v_d))


def minimum_velocity(v_eta: float, v_d: float, *, printed: bool = False) -> float:
    """Velocity v_d (sqrt(1 + v_eta/v_d) - 1) at which beta(v)/(1 + v/v_d) is least at
    fixed C (derived), v_eta and v_d as in `beta`; `printed` gives the limit for v_eta >>
    v_d that the paper has, sqrt(v_eta v_d)."""
    return math.sqrt(v_eta * v_d) if printed else v_d * (math.sqrt(1 + v_eta / v_d) - 1)
