"""Perturbations of the steady sliding of a chain of blocks (derived).

Perturbations cos(q j) e^(p t) of blocks that all slide at V obey

    M p^2 + eta p + (K + alpha p)(2 - 2 cos q) + K_d + Z(p) = 0

with Z of a rigid slider (`master.characteristic`): a chain is a slider behind a spring
of the stiffness K_d + K (2 - 2 cos q). Without alpha modes with q < q_c grow, q_c =
arccos(1 - (kappa_c - K_d)/(2 K)), kappa_c being the critical stiffness of the slider.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate
from eqsim.master.characteristic import Loop, border_of, root_of, roots_from
from eqsim.master.stability import NEUTRAL, SteadyPull
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Wave numbers at which roots are followed, at least.
_WAVE_NUMBERS = 25
# Steps from the root on the border of stability to that of the nearest wave number.
_FROM_BORDER = 5
# Growth per cycle from which others are found that do not oscillate.
_REAL_ROOTS = np.geomspace(0.1, 30.0, 8)
# Wave numbers end at the critical one or at that of plate springs, times this.
_BEYOND = 3.0


@dataclass(frozen=True, repr=False)
class Modes(Result):
    """Perturbations cos(q j) of steady sliding, one row for each wave number, arrays
    (wave_numbers,).

    Attributes
    ----------
    wave_number : ndarray
        q, per block.
    growth, growth_error, frequency : ndarray
        Rate (1/time; negative: it decays) with the error of the solver, and angular
        frequency (1/time), of the root that grows behind the stiffest springs, or if
        none grows of the slowest; NaN where it decays within a fraction of a cycle.
    critical_wave_number : Estimate
        q_c, below which modes grow; 0 where none does, without a value where all do.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "wave_number",
        "growth",
        "growth_error",
        "wave number  $q$  (1/block)",
        "growth rate",
    )
    wave_number: Array
    growth: Array
    growth_error: Array
    frequency: Array
    critical_wave_number: Estimate


class _Links(NamedTuple):
    """Springs of a chain, in units of time in which V is a threshold: K_d, K and
    alpha."""

    plate: float
    coupling: float
    bulk_damping: float

    def root(self, loop: Loop, q: float, near: complex) -> complex:
        """Root of the mode q near another; NaN if there is none."""
        bend = 2.0 - 2.0 * math.cos(q)
        damping, stiffness = self.bulk_damping * bend, self.plate + self.coupling * bend
        return _root(loop, stiffness, damping, near)

    def followed(self, loop: Loop, q: Array, first: complex) -> list[complex]:
        """Roots of the modes q, (n,), each near that before; `first` is that of q[0]."""
        roots = [first]
        for i in range(1, q.size):
            guess = roots[-1]
            if i > 1:  # straight on
                slope = (roots[-1] - roots[-2]) / (q[i - 1] - q[i - 2])
                guess += slope * (q[i] - q[i - 1])
            roots.append(self.root(loop, float(q[i]), guess))
        return roots


def _root(loop: Loop, stiffness: float, damping: float, near: complex) -> complex:
    """Root that Newton's method reaches, or if it does not oscillate the largest of
    these; NaN if there is none."""
    damped = loop._replace(damping=loop.damping + damping)
    roots = roots_from(damped, np.array([near]), stiffness)
    if roots.size and roots[0].imag <= 1e-6 * abs(roots[0]):
        rates = (_REAL_ROOTS / loop.cycle).astype(complex)
        roots = np.append(roots, roots_from(damped, rates, stiffness))
        roots = roots[[np.argmax(roots.real)]]
    return complex(roots[0]) if roots.size else complex(math.nan, math.nan)


def chain_modes(
    pulled: SteadyPull,
    coupling: float,
    bulk_damping: float = 0.0,
    wave_numbers: Array | None = None,
) -> Modes:
    """Solve for the growth of perturbations cos(q j) e^(p t) of a chain that slides
    steadily.

    The stage of `pulled` has the spring K_d of a block to the plate, its damping and
    its mass, over n k; `coupling` is K/(n k), and `bulk_damping` alpha/(n k) (time) of
    the difference of neighbours' velocities. `wave_numbers`, 0 to pi, default to 25 up
    to three times the critical one. Raises InputError as `eqsim.stability` does, for
    contacts that amplify and damp nothing, and where q = 0 has no slow mode."""
    require_number("coupling", coupling, least=1e-9, most=1e9)
    require_number("bulk_damping", bulk_damping, least=0.0, most=1e9)
    if pulled.method == NEUTRAL:
        raise InputError(f"chain: {NEUTRAL}")
    rate = pulled.velocity / pulled.ensemble.thresholds.scale
    springs = _Links(pulled.stage.stiffness, coupling, bulk_damping * rate)
    fine, coarse, scan = pulled.loops()
    border = border_of(coarse, scan)
    last = _BEYOND * math.sqrt(max(border.stiffness, springs.plate) / coupling)
    grid = np.linspace(0.0, min(last, math.pi), _WAVE_NUMBERS)
    asked = grid if wave_numbers is None else np.asarray(wave_numbers, float)
    if asked.ndim != 1 or not np.all((asked >= 0.0) & (asked <= math.pi)):
        raise InputError("wave_numbers: must be numbers from 0 to pi, shape (n,)")
    every, middle = np.union1d(grid, asked), 0
    if 0.0 < border.stiffness < math.inf:
        # from the border on either way: there the root oscillates, and is one of a pair
        bend = 2.0 - 2.0 * np.cos(every)
        stiffness = springs.plate + coupling * bend
        middle = int(np.argmin(np.abs(stiffness - border.stiffness)))
        first = complex(0.0, border.frequency)
        for share in np.linspace(0.0, 1.0, _FROM_BORDER):
            between = border.stiffness + share * (stiffness[middle] - border.stiffness)
            damping = float(share * springs.bulk_damping * bend[middle])
            first = _root(coarse, float(between), damping, first)
    else:
        first = root_of(coarse, scan, springs.plate) or complex(math.nan)
    if math.isnan(first.real):
        raise InputError("chain: perturbations of all blocks alike decay at once")
    below = springs.followed(coarse, every[middle::-1], first)[:0:-1]
    roots = below + springs.followed(coarse, every[middle:], first)
    rough = np.array(roots)
    q, near = asked.tolist(), rough[np.searchsorted(every, asked)].tolist()
    p = np.array([springs.root(fine, *each) for each in zip(q, near, strict=True)])
    error = np.abs(p - near) + 1e-9 * np.abs(p)
    critical = Estimate(0.0, 0.0, 0)
    if roots[0].real > 0.0:
        falls = np.flatnonzero((rough.real[:-1] > 0.0) & (rough.real[1:] <= 0.0))
        critical = Estimate(None, None, 0)
        if falls.size:
            i = int(falls[-1])
            found = [
                optimize.brentq(
                    lambda q, loop=loop: springs.root(loop, q, roots[i]).real,
                    *every[i : i + 2].tolist(),
                    xtol=1e-9,
                )
                for loop in (fine, coarse)
            ]
            critical = Estimate(found[0], abs(found[0] - found[1]) + 1e-9, 0)
    return Modes(asked, rate * p.real, rate * error, rate * p.imag, critical)
