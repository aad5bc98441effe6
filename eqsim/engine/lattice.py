"""A lattice of coupled blocks: the displacement of all blocks by a break of one, and the
block whose next break comes first.

A block has a threshold h_j in units of the level, which the plate raises. Blocks `b` are
a NamedTuple with thresholds `h`, with room to a multiple of `LEAF`, and `tree`, the
lowest ones of `LEAF` blocks, and of these, as a binary tree from node 1 on.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from eqsim.model.elastic import Elastic
from eqsim.numerics.compiled import by_law, routine
from eqsim.numerics.tables import Array

LEAF = 32  # blocks whose lowest threshold is a leaf of the tree
TO_WHOLE = 6755399441055744.0  # 1.5 * 2^52, beside which only whole numbers are left


class Response(NamedTuple):
    """Displacements of all blocks after a break, on their lattice."""

    G: Array  # `Elastic.response`
    reach: Array  # largest column distance of a block that moves, for each row of G
    nx: int  # columns
    ny: int  # rows
    periodic: bool
    unit: float  # a power of 2, of which positions are multiples


class Banded(NamedTuple):
    """The same of blocks that differ, as rows of a band."""

    G: Array  # of a break at i, (B, width): displacements of blocks from `first[i]` on
    first: Array  # (B,)
    unit: float  # 0: levels are not rounded


@routine(inline=True)
def rounded(x: float, unit: float) -> float:
    """Nearest multiple of a power of 2."""
    big = unit * TO_WHOLE
    return (x + big) - big


def no_levels(blocks: int) -> tuple[Array, Array]:
    """Thresholds `h` of blocks and their `tree`, all infinite."""
    filled = -(-blocks // LEAF)
    leaves = 1 << (filled - 1).bit_length()
    return np.full(filled * LEAF, math.inf), np.full(2 * leaves, math.inf)


def balance_of(own: Array, coupling: float, periodic: bool = False) -> sparse.csc_array:
    """diag(own) + kappa L of a chain, over n k: `own` springs of the blocks, (blocks,),
    and those between neighbours."""
    size = own.size
    neighbours = np.full(size, 2.0)
    if not periodic:
        neighbours[0] -= 1.0
        neighbours[-1] -= 1.0
    beside = np.full(size - 1, -coupling)
    diagonals = {0: own + coupling * neighbours, 1: beside, -1: beside}
    if periodic:
        diagonals |= {size - 1: beside[:1], 1 - size: beside[:1]}
    whole = sparse.diags_array([*diagonals.values()], offsets=[*diagonals])
    return whole.tocsc()


class Reached(NamedTuple):
    """Blocks `begin` to `end` that a break moves; block k by G[row, offset + k]."""

    row: int
    offset: int
    begin: int
    end: int


@routine(inline=True)
def _push(b: Any, r: Any, reached: Reached, force: float) -> None:
    """Move blocks, and mend the tree. Indices are unsigned, so that numba does not look
    for ones that count from the end, and loops vectorise. Four chains of minima do not
    wait for each other."""
    row, begin, end = reached.row, reached.begin, reached.end
    big = r.unit * TO_WHOLE
    start, shift = np.uint64(begin), np.uint64(reached.offset + begin)
    for k in range(np.uint64(end - begin)):
        b.h[start + k] -= (r.G[row, shift + k] * force + big) - big
    leaves = b.tree.size // 2
    low, high = begin // LEAF, (end - 1) // LEAF
    for leaf in range(low, high + 1):
        j = np.uint64(leaf * LEAF)
        m0 = b.h[j]
        m1 = b.h[j + np.uint64(1)]
        m2 = b.h[j + np.uint64(2)]
        m3 = b.h[j + np.uint64(3)]
        for _ in range(np.uint64(1), np.uint64(LEAF // 4)):
            j += np.uint64(4)
            m0 = min(b.h[j], m0)
            m1 = min(b.h[j + np.uint64(1)], m1)
            m2 = min(b.h[j + np.uint64(2)], m2)
            m3 = min(b.h[j + np.uint64(3)], m3)
        b.tree[leaves + leaf] = min(min(m0, m1), min(m2, m3))
    low, high, changed = (leaves + low) // 2, (leaves + high) // 2, True
    while changed and low > 0:
        changed = False
        for node in range(low, high + 1):
            lowest = min(b.tree[2 * node], b.tree[2 * node + 1])
            changed |= lowest != b.tree[node]
            b.tree[node] = lowest
        low //= 2
        high //= 2


@by_law
def spread(r: Any, b: Any, block: int, force: float) -> None:
    """Move all blocks after a drop of the force at `block`, which is divided by n k."""
    row = r.G[block]
    end = r.first[block] + row.size
    _push(b, r, Reached(block, -r.first[block], r.first[block], end), force)


@spread.register(Response)
def _spread_on_lattice(r: Response, b: Any, block: int, force: float) -> None:
    nx, ny = r.nx, r.ny
    x, y = block % nx, block // nx
    far, middle = r.G.shape[0] // 2, r.G.shape[1] // 2
    around_x = nx if r.periodic else 2 * nx
    around_y = ny if r.periodic else 2 * ny
    for dy in range(-min(far, (around_y - 1) // 2), min(far, around_y // 2) + 1):
        row, line = far + dy, y + dy
        if line < 0:
            line = line + ny if r.periodic else -1 - line
        elif line >= ny:
            line = line - ny if r.periodic else 2 * ny - 1 - line
        left = min(r.reach[row], (around_x - 1) // 2)
        right = min(r.reach[row], around_x // 2)
        for image in range(-1, 2):  # around the ring, or mirrored at the edges
            if image == 0 or r.periodic:
                offset = middle - x + image * nx
                begin = max(0, middle - left - offset)
                end = min(nx, middle + right + 1 - offset)
            else:
                offset = middle + x + 1 - (image + 1) * nx
                begin = max(0, middle - right - offset)
                end = min(nx, middle + left + 1 - offset)
            if begin < end:
                at = line * nx
                _push(b, r, Reached(row, offset - at, at + begin, at + end), force)


@routine(inline=True)
def lowest_block(b: Any) -> int:
    """Find the block with the lowest threshold."""
    leaves, lowest, node = b.tree.size // 2, b.tree[1], 1
    while node < leaves:
        node = 2 * node if b.tree[2 * node] == lowest else 2 * node + 1
    j = (node - leaves) * LEAF
    while b.h[j] != lowest:
        j += 1
    return j


def response_of(elastic: Elastic, distance: float) -> Response:
    """Response for a plate that moves by `distance`; 51 bits hold every position."""
    G = elastic.response()
    from_middle = np.abs(np.arange(G.shape[1]) - G.shape[1] // 2)
    reach = np.max(np.where(G != 0.0, from_middle, 0), axis=1)
    unit = 2.0 ** (math.ceil(math.log2(distance + 16.0)) - 51)
    return Response(G, reach, *elastic.shape, elastic.edges == "periodic", unit)
