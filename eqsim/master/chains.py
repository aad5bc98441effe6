"""Chains of blocks of contacts in slow motion at T = 0: the load of the first break, the
precursors of sliding, and static friction against length (derived).

Blocks j = 0, ..., B - 1 with contacts of stiffness 1 have neighbours at springs K, both
over n k; a force F (over n k, a length) pulls block 0, and the far end is free:

    K (X_{j-1} - 2 X_j + X_{j+1}) = F_j(X_j),      F = F_0(X_0) + K (X_0 - X_1).

Without heat, delay and aging a contact knows displacement, not time, and F_j is a
function of X_j. Then the law of a J integral holds where springs are soft enough for a
continuum, F^2/(2 K) = W(X_0), W = int_0^X F_j dX.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy import integrate, linalg, optimize
from scipy.interpolate import CubicSpline

from eqsim.errors import InputError, require_integer, require_number
from eqsim.laws.no_thresholds import has_jumps
from eqsim.master.chain_fronts import decay
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import reduced
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Mean thresholds over which F(X) is solved for; beyond them it is steady.
_REACH = 30.0
# Points of F(X).
_POINTS = 6001
# Most blocks of a chain with precursors, whose response is a matrix.
_MOST_BLOCKS = 5000
# Stretches of the far end that are tried for the largest force.
_TRIED = 60
# Rounding of a threshold that counts as reached.
_ROUNDING = 1e-12


@dataclass(frozen=True, repr=False)
class Precursors(Result):
    """Precursors of a chain that is pulled at its edge, one row for each, arrays
    (precursors,).

    Attributes
    ----------
    force : ndarray
        Force on the edge over n k x_s, the sum of the thresholds of a block of mean
        load.
    reach : ndarray
        Number of blocks that have slipped by then, from the edge on; the last one is
        the whole chain if it came to slide.
    breaks : ndarray
        Slips of blocks in this event, of the last one until all blocks slide.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "force",
        "reach",
        "",
        "force on the edge  F/n k x_s",
        "blocks that have slipped",
        False,
        True,
    )
    force: Array
    reach: Array
    breaks: Array


def edge_load(coupling: float, blocks: int | None = None) -> float:
    """Solve for the force on the edge of a chain at which its first block breaks, over
    the sum n k x_s of the equal thresholds of a block:

        F = 1/(1 - z),    z + 1/z = 2 + 1/K,

    for a half infinite chain, and sinh(B y)/(2 sinh(y/2) cosh((B - 1/2) y)), y = -ln z,
    for B blocks with a free far end (derived).

    Parameters
    ----------
    coupling : float
        K/(n k), the spring between neighbours over the stiffness of the n contacts of a
        block, > 0.
    blocks : int, optional
        B.

    Raises
    ------
    InputError
        For values out of range.

    Examples
    --------
    >>> from eqsim import edge_load
    >>> print(f"{edge_load(20.0):.6f} {edge_load(20.0, blocks=10):.6f}")
    5.000000 4.872139
    """
    require_number("coupling", coupling, least=1e-6, most=1e9)
    z = decay(coupling)
    if blocks is None:
        return 1.0 / (1.0 - z)
    require_integer("blocks", blocks, 1, 10_000_000)
    # sinh(B y)/(2 sinh(y/2) cosh((B - 1/2) y)) without overflow
    grown = z ** (2 * blocks)
    return (1.0 - grown) / ((1.0 - z) * (1.0 + grown / z))


def precursors(
    coupling: float, blocks: int, *, load: Any = None, most: int = 10_000
) -> Precursors:
    """Follow the precursors of a chain whose edge is pulled by a slowly raised force, at
    T = 0, with equal thresholds and contacts that take hold again at once: exact, as
    the end of an event does not depend on the order of breaks. Blocks j of w_j n
    contacts move by

        X = G (F e_0 + x_s w m) ,    G = (diag(w) + K L)^-1,    x_j = X_j - x_s m_j,

    after m_j breaks, and break where x_j = x_s (derived).

    Parameters
    ----------
    coupling : float
        K/(n k), n being the mean number of contacts of a block, > 0.
    blocks : int
        B, 2 to 5000.
    load : array_like, shape (blocks,), optional
        Weights w of blocks > 0; only their ratios matter.
    most : int
        Most events; they end when the last block has slipped.

    Returns
    -------
    Precursors

    Raises
    ------
    InputError
        For values out of range.

    Examples
    --------
    >>> from eqsim import precursors
    >>> found = precursors(20.0, blocks=100, most=4)
    >>> found.force.round(9).tolist(), found.reach.tolist()
    ([5.0, 5.25, 5.7625, 6.563125], [1, 2, 3, 4])
    """
    require_number("coupling", coupling, least=1e-6, most=1e9)
    require_integer("blocks", blocks, 2, _MOST_BLOCKS)
    require_integer("most", most, 1, 10_000_000)
    weight = np.ones(blocks) if load is None else np.asarray(load, float)
    if weight.shape != (blocks,) or not np.all((weight > 0.0) & (weight < 1e9)):
        raise InputError(f"load: must be {blocks} numbers > 0, one for each block")
    weight = weight / weight.mean()
    band = np.full((2, blocks), -float(coupling))
    band[1] = weight + 2.0 * coupling
    band[1, [0, -1]] -= coupling
    G = linalg.solveh_banded(band, np.eye(blocks))
    breaks, moved = np.zeros((2, blocks))
    rows: list[Any] = []
    while len(rows) < most and not breaks[-1]:
        lacking = (1.0 - (moved - breaks)) / G[0]
        force, ready, slips = float(lacking.min()), lacking <= lacking.min(), 0
        while ready.any() and not breaks[-1]:
            breaks += ready
            slips += int(ready.sum())
            moved += G[:, ready] @ weight[ready]
            ready = force * G[0] + moved - breaks >= 1.0 - _ROUNDING
        rows.append((force, int(np.count_nonzero(breaks)), slips))
    forces, reach, number = zip(*rows, strict=True)
    return Precursors(np.array(forces), np.array(reach), np.array(number))


class _Law(NamedTuple):
    """F(X) of contacts from a fresh start, beyond `reach` that of its end, in the user's
    units over n k; `size` is the mean threshold."""

    size: float
    reach: float
    force: CubicSpline

    def force_at(self, X: Array) -> Array:
        return np.asarray(self.force(np.minimum(X, self.reach)))


def _law_of(ensemble: Ensemble) -> _Law:
    """F(X). Raises InputError unless it is a smooth function of X."""
    contacts = reduced(ensemble, 1.0)
    still = not ensemble.aging.active and not contacts.delay.mean
    if contacts.barrier.thermal or not still:
        raise InputError(
            "thermal.kT: must be 0 without delay and aging, as the force is a function "
            "of the displacement only then"
        )
    if has_jumps(ensemble.thresholds):
        raise InputError("thresholds: must not be discrete, whose force jumps")
    size = ensemble.thresholds.mean
    exact = transient(ensemble, Drive(1.0, _REACH * size), _POINTS)
    return _Law(size, float(exact.X[-1]), CubicSpline(exact.X, exact.force))


def static_friction(ensemble: Ensemble, length: float) -> float:
    """Solve for the largest force per block F/(B n k) (length) that a chain bears that
    is pulled at its edge from a fresh start, its far end free, as a continuum of
    infinitely many contacts at T = 0 (derived). With l = B/sqrt(K) it is

        max over X_L of X'(l)/l,    X'' = F(X),  X(0) = X_L,  X'(0) = 0.

    It falls with l from the peak of a fresh rigid slider to steady friction.

    Parameters
    ----------
    ensemble : Ensemble
        Contacts without delay and aging at T = 0, of a continuous law of thresholds.
    length : float
        l = B/sqrt(K/(n k)), in units of the range of a static stretch, 0.01 to 20.

    Raises
    ------
    InputError
        For other contacts, and lengths out of range.

    Examples
    --------
    >>> from eqsim import Ensemble, Gamma, Thermal
    >>> from eqsim.master.chains import static_friction
    >>> cold = Ensemble(Gamma(1.0), Thermal(0.0), stiffness_law="uniform")
    >>> print(f"{static_friction(cold, 0.1):.5f} {static_friction(cold, 2.0):.5f}")
    0.82150 0.78220
    """
    require_number("length", length, least=0.01, most=20.0)
    law = _law_of(ensemble)

    def per_block(ends: Array) -> Array:
        start = np.append(ends, np.zeros(ends.size))

        def moved(_: float, state: Array) -> Array:
            X, slope = np.split(state, 2)
            return np.append(slope, law.force_at(X))

        tight = {"rtol": 1e-10, "atol": 1e-13 * law.size, "method": "DOP853"}
        end = integrate.solve_ivp(moved, (0.0, length), start, **tight).y[:, -1]
        return np.asarray(np.split(end, 2)[1] / length)

    tried = law.size * np.geomspace(1e-2 / math.cosh(length), _REACH / 3.0, _TRIED)
    best = int(np.argmax(per_block(tried)))
    near = tried[max(best - 1, 0)], tried[min(best + 1, _TRIED - 1)]
    found = optimize.minimize_scalar(
        lambda end: -float(per_block(np.array([end]))[0]),
        bounds=near,
        method="bounded",
        options={"xatol": 1e-6 * law.size},
    )
    return -float(found.fun)
