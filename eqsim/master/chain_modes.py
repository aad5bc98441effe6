"""Perturbations of the steady sliding of a chain of blocks (derived).

Perturbations cos(q j) e^(p t) of blocks that all slide at V obey

    M p^2 + eta p + (K + alpha p)(2 - 2 cos q) + K_d + Z(p) = 0

with Z of a rigid slider (`master.characteristic`): a chain is a slider behind a spring
of the stiffness K_d + K (2 - 2 cos q). Without alpha modes with q < q_c grow, q_c =
arccos(1 - (kappa_c - K_d)/(2 K)), kappa_c being the critical stiffness of the slider.
"""

import math
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import linalg, optimize

from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate
from eqsim.master.characteristic import (
    NO_VALUE,
    OF_COARSER,
    Loop,
    border_of,
    root_of,
    roots_from,
)
from eqsim.master.stability import NEUTRAL, pulled_by
from eqsim.model.chain import Chain
from eqsim.model.drive import Programme, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Wave numbers at which roots are followed, at least.
_WAVE_NUMBERS = 25
# Steps from the root on the border of stability to that of the nearest wave number.
_FROM_BORDER = 5
# Growth per cycle from which others are found that do not oscillate.
_REAL_ROOTS = np.geomspace(0.1, 30.0, 8)
# Stiffness that stands for none, with which q = 0 would be neutral.
_FAINT = 1e-9
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
    lowest : float
        q of the softest mode of this chain: 0 where a plate pulls it, pi/(2 B - 1) or
        less where a spring pulls its edge.
    softest : Estimate
        Rate of growth of that mode (1/time).
    """

    drawn: ClassVar[Drawn] = Drawn(
        "wave_number",
        "growth",
        "growth_error",
        "wave number  q",
        "growth rate",
    )
    wave_number: Array
    growth: Array
    growth_error: Array
    frequency: Array
    critical_wave_number: Estimate
    lowest: float
    softest: Estimate

    @property
    def verdict(self) -> str:
        """Verdict on this chain: "stable", "unstable", or "undecided" where the error
        is too large."""
        growth, error = self.softest.value, self.softest.stderr or 0.0
        if growth is None:  # it decays at once
            return "stable"
        if abs(growth) <= 2.0 * error:
            return "undecided"
        return "unstable" if growth > 0.0 else "stable"


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
    ensemble: Ensemble, drive: Programme, wave_numbers: Array | None = None
) -> Modes:
    """Solve for the growth of perturbations cos(q j) e^(p t) of a chain of blocks that
    slides steadily (derived):

        M p^2 + eta p + (K + alpha p)(2 - 2 cos q) + K_d + Z(p) = 0,

    Z being the response of a rigid slider.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Programme
        With a chain and one segment (velocity in length/time); how it starts does not
        matter. K_d is 0 where only the edge is pulled; of a single block it is the
        stiffness of all springs that pull.
    wave_numbers : array_like, shape (wave_numbers,), optional
        q from 0 to pi; by default 25 up to three times the critical one.

    Returns
    -------
    Modes

    Raises
    ------
    InputError
        As `stability` does; for blocks of unequal load; for bulk damping where the edge
        is pulled; and for contacts that amplify and damp nothing.

    Examples
    --------
    >>> from eqsim import Chain, Delay, Ensemble, Programme, Segment, chain_modes
    >>> chain = Chain(50, coupling=0.5, drive_stiffness=0.02, damping=0.03)
    >>> drive = Programme([Segment(3.0, distance=1.0)], chain=chain)
    >>> found = chain_modes(Ensemble(delay=Delay(1.0)), drive)
    >>> found.verdict, f"{found.critical_wave_number.value:.6f}"
    ('unstable', '2.245651')
    """
    chain = drive.chain if isinstance(drive, Programme) else None
    if chain is None:
        raise InputError("drive: must have a chain of blocks")
    if chain.load and min(chain.load) < max(chain.load):
        raise InputError("chain.load: must be even, as modes are those of equal blocks")
    if chain.drive != "plate" and chain.bulk_damping:
        said = "must be 0 where the edge is pulled, which modes are then not known"
        raise InputError(f"chain.bulk_damping = {chain.bulk_damping:g}: {said}")
    require_number("chain.coupling", chain.coupling, least=1e-9)
    K_d = 0.0 if chain.drive == "edge" else chain.drive_stiffness
    if chain.count == 1:  # all its springs are to what pulls
        K_d = float(chain.springs[0])
    stage = Stage(chain.drive_stiffness, damping=chain.damping, mass=chain.mass)
    pulled = pulled_by(ensemble, replace(drive, chain=None, stage=stage))
    if pulled.method == NEUTRAL:
        raise InputError(f"chain: {NEUTRAL}")
    rate = pulled.velocity / ensemble.thresholds.scale
    coupling = chain.coupling
    springs = _Links(max(K_d, _FAINT), coupling, chain.bulk_damping * rate)
    lowest = _lowest(chain, K_d)
    border, (fine, coarse, scan) = pulled.resolved(
        pulled.loops(), lambda each: border_of(each.coarse, each.scan)
    )
    last = _BEYOND * math.sqrt(max(border.stiffness, springs.plate) / coupling)
    grid = np.linspace(0.0, min(last, math.pi), _WAVE_NUMBERS)
    asked = grid if wave_numbers is None else np.asarray(wave_numbers, float)
    if asked.ndim != 1 or not np.all((asked >= 0.0) & (asked <= math.pi)):
        raise InputError("wave_numbers: must be numbers from 0 to pi, shape (n,)")
    every, middle = np.union1d(grid, np.append(asked, lowest)), 0
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
    seen = np.append(asked, lowest)
    q, near = seen.tolist(), rough[np.searchsorted(every, seen)].tolist()
    p = np.array([springs.root(fine, *each) for each in zip(q, near, strict=True)])
    error = OF_COARSER * np.abs(p - near) + 1e-9 * np.abs(p)
    critical = Estimate(0.0, 0.0, 0)
    if roots[0].real > 0.0:
        falls = np.flatnonzero((rough.real[:-1] > 0.0) & (rough.real[1:] <= 0.0))
        critical = Estimate(None, None, 0)
        if falls.size:
            i = int(falls[-1])
            # by secants: the two loops may change sign in different steps of the grid
            low, high = every[i : i + 2].tolist()
            found = [
                optimize.root_scalar(
                    lambda q, loop=loop: springs.root(loop, q, roots[i]).real,
                    method="secant",
                    x0=low,
                    x1=high,
                    xtol=1e-9,
                ).root
                for loop in (fine, coarse)
            ]
            critical = Estimate(
                found[0], OF_COARSER * abs(found[0] - found[1]) + 1e-9, 0
            )
    softest = NO_VALUE
    if not math.isnan(p.real[-1]):
        softest = Estimate(rate * float(p.real[-1]), rate * float(error[-1]), 0)
    growth, missed, frequency = (
        rate * p.real[:-1],
        rate * error[:-1],
        rate * p.imag[:-1],
    )
    return Modes(asked, growth, missed, frequency, critical, lowest, softest)


def _lowest(chain: Chain, K_d: float) -> float:
    """Wave number of the softest mode of a chain of B blocks, whose springs, those of
    the edge included, have the stiffness K_d + K (2 - 2 cos q)."""
    if chain.drive == "plate":
        return 0.0
    diagonal = chain.coupling * chain.neighbours + chain.springs - K_d
    beside = np.full(chain.count - 1, -chain.coupling)
    softest = linalg.eigvalsh_tridiagonal(diagonal, beside, "i", (0, 0))[0]
    return 2.0 * math.asin(min(math.sqrt(softest / chain.coupling) / 2.0, 1.0))
