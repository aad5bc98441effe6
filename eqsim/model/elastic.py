"""Blocks of contacts that feel each other through springs, quasi-statically (derived).

Block j has n contacts, or n_j in proportion to its load, a spring K_j to a plate at D,
and springs kappa_b to its neighbours:

    K_j (D - X_j) - kappa_b (L X)_j = F_j(X_j),
    (L X)_j = sum over neighbours i of X_j - X_i.

K_j = K_d of every block; or of the first one alone, the edge. Contacts break where X_j
takes them, or by heat before; a break at block i whose contact loses the force k x
moves block j by G_ji k x, G = (diag(K_j + n_j k) + kappa_b L)^-1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from eqsim.errors import (
    Checked,
    InputError,
    Limits,
    require_integer,
    require_number,
    shown,
)
from eqsim.numerics.tables import Array

Spring = Annotated[float, Limits(1e-6, 1e6)]  # avalanches have at most 1e6 breaks
_MOST_BLOCKS = 10_000_000
# Share of a block's response to its own breaks that rounding of positions hides
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class Elastic(Checked):
    """A chain or a sheet of blocks of contacts, which a plate pulls (derived). It is
    declared in `Drive(elastic=...)`.

    Raises InputError for a value out of range.

    Parameters
    ----------
    blocks : int or (int, int)
        B of a chain, or nx and ny of a sheet. The contacts of an ensemble are divided
        among them equally, n = N/B.
    coupling : float
        kappa_b/(n k), the spring between two neighbours over the stiffness of the
        contacts of a block, >= 0.
    drive_stiffness : float
        K_d/(n k), the spring of each block to the plate, likewise; of all blocks
        together K/(N k) is the same number.
    edges : str
        "open" or "periodic".
    drive : str
        What pulls: "plate", a plate every block; "edge", the first block of a chain
        alone, through `drive_stiffness`; "both", every block through `drive_stiffness`,
        and the first one also through `edge_stiffness`.
    edge_stiffness : float, optional
        K_e/(n k), of "both".
    load : sequence of float, optional
        Weights of the blocks of a chain, shape (blocks,), > 0: numbers of their
        contacts are in proportion to these. By default all are equal.

    Examples
    --------
    >>> Elastic(blocks=100, coupling=1.0, drive_stiffness=0.25).mean_size
    5.0
    """

    blocks: int | tuple[int, int]
    coupling: Annotated[float, Limits(0.0, 1e9)]
    drive_stiffness: Spring
    edges: Literal["open", "periodic"] = "open"
    drive: Literal["plate", "edge", "both"] = "plate"
    edge_stiffness: Spring | None = None
    load: Sequence[float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.blocks, (tuple, list)):
            if len(self.blocks) != 2:
                said = "must be a number of blocks, or two, [nx, ny]"
                raise InputError(f"blocks = {shown(self.blocks)}: {said}")
            object.__setattr__(self, "blocks", tuple(self.blocks))
        for number in self.shape:
            require_integer("blocks", number, 1, _MOST_BLOCKS)
        require_integer("blocks", self.count, 1, _MOST_BLOCKS)
        if (self.drive == "both") != (self.edge_stiffness is not None):
            said = "is required with" if self.drive == "both" else "not allowed unless"
            raise InputError(f'edge_stiffness: {said} drive = "both"')
        if self.load is not None:
            if not np.iterable(self.load):
                said = "must be numbers, one for each block"
                raise InputError(f"load = {shown(self.load)}: {said}")
            object.__setattr__(self, "load", tuple(self.load))
            if len(self.load) != self.count:
                said = f"must be {self.count} numbers, one for each block"
                raise InputError(f"load: has {len(self.load)}; {said}")
            for weight in self.load:
                require_number("load", weight, above=0.0, most=1e9)
        if self.differ and (self.shape[1] > 1 or self.edges == "periodic"):
            name = "load" if self.drive == "plate" else "drive"
            said = "blocks that differ are those of a chain with open edges"
            raise InputError(f"{name}: {said}")

    @property
    def differ(self) -> bool:
        """True if the blocks are not all pulled and loaded alike."""
        return self.drive != "plate" or self.load is not None

    def follows_events(self, heat: bool) -> bool:
        """True if breaks are followed one after the other, in the order of time: with
        `heat`, or where blocks differ. Else their order makes no difference."""
        return heat or self.differ

    @property
    def springs(self) -> Array:
        """K_j/(n k) of the spring that pulls each block, shape (blocks,)."""
        springs = np.full(self.count, float(self.drive_stiffness))
        if self.drive == "edge":
            springs[1:] = 0.0
        springs[0] += self.edge_stiffness or 0.0
        return springs

    @property
    def shape(self) -> tuple[int, int]:
        """Columns and rows; a chain has one row."""
        return self.blocks if isinstance(self.blocks, tuple) else (self.blocks, 1)

    @property
    def count(self) -> int:
        """Number of blocks B."""
        return self.shape[0] * self.shape[1]

    @property
    def length(self) -> float:
        """lambda, over which the displacement by a break decays, in blocks (of a sheet
        along its axes): cosh(1/lambda) = 1 + (K_d + n k)/(2 kappa_b), without K_d where
        the edge is pulled alone; 0 without coupling."""
        if not self.coupling:
            return 0.0
        both = 1.0 + (0.0 if self.drive == "edge" else self.drive_stiffness)
        return 1.0 / math.acosh(1.0 + both / (2.0 * self.coupling))

    @property
    def branching(self) -> float:
        """rho = n k/(n k + K_d), how many breaks follow from one in the mean."""
        return 1.0 / (1.0 + self.drive_stiffness)

    @property
    def mean_size(self) -> float:
        """1 + n k/K_d, breaks of an avalanche in the mean, of very many contacts."""
        return 1.0 + 1.0 / self.drive_stiffness

    def contacts_per_block(self, count: int) -> int:
        """n, of `count` contacts. Raises InputError if they cannot be divided."""
        if count % self.count:
            said = f"must be a multiple of the {self.count} blocks of [elastic]"
            raise InputError(f"contacts.count = {count}: {said}")
        return count // self.count

    def contacts_of(self, count: int) -> Array:
        """Number of contacts of each block, of `count` in all, shape (blocks,). Raises
        InputError if a block has none, or if equal blocks cannot have equal numbers."""
        if self.load is None:
            return np.full(self.count, self.contacts_per_block(count))
        weights = np.cumsum(self.load)
        ends = np.rint(weights * (count / weights[-1])).astype(np.int64)
        found = np.diff(ends, prepend=0)
        if found.min() < 1:
            few = int(np.argmin(found))
            said = f"gives block {few} no contact of {count}; take more of them"
            raise InputError(f"load: {said}")
        return np.asarray(found)

    def response(self) -> Array:
        """n k G between blocks at a distance of (dy, dx), shape (2 Ry + 1, 2 Rx + 1)
        with (0, 0) in the middle, on the ring or torus that is the lattice if its edges
        are periodic and twice the lattice, with mirror images, if they are open. What
        is below 1e-12 of the middle is cut off, and added to it: the sum over all
        blocks is exactly 1/(1 + K_d/(n k))."""
        images = 1 if self.edges == "periodic" else 2
        sizes = [1 if n == 1 else images * n for n in reversed(self.shape)]
        modes = (
            2.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(size) / size) for size in sizes
        )
        stiffness = 1.0 + self.drive_stiffness + self.coupling * np.add.outer(*modes)
        G = np.fft.ifft2(1.0 / stiffness).real
        reach = []
        for axis, size in enumerate(sizes):
            along = np.max(G, axis=1 - axis)[: size // 2 + 1]
            reach.append(int(np.flatnonzero(along >= _NEGLIGIBLE * G[0, 0])[-1]))
        middle = np.ix_(*(np.arange(-r, r + 1) for r in reach))
        found = np.where(G[middle] >= _NEGLIGIBLE * G[0, 0], G[middle], 0.0)
        # on an even ring the farthest block is met once, from one side
        rings = zip(reach, sizes, strict=True)
        once = [2 * np.arange(-r, r + 1) > -max(size, 2) for r, size in rings]
        total = np.sum(found * np.logical_and.outer(*once))
        found[reach[0], reach[1]] += self.branching - total
        return found
