"""A chain of blocks of contacts in time: blocks with a mass or a drag that a plate, an
edge or both pull (derived).

Block j has n_j contacts, N/B = n in the mean, and obeys

    M X_j'' + eta X_j' = K_j (Y - X_j) - K (L X)_j - alpha (L X')_j - F_j,
    (L X)_j = sum over neighbours i of X_j - X_i,

all per n k, with Y the position of what drives, and F_j the force of the contacts of
the block over n k.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_integer,
    require_number,
    shown,
)
from eqsim.model.elastic import Edges
from eqsim.numerics.tables import Array

Driven = Literal["plate", "edge", "both"]
_MOST_BLOCKS = 100_000


@dataclass(frozen=True)
class Chain:
    """A chain of blocks of contacts that moves in time. It is declared in
    `Programme(chain=...)`, whose segments are those of the plate or of the end of the
    spring at the edge.

    Raises InputError for a value out of range, and without both mass and damping: that
    is the quasi-static model of `Elastic`.

    Parameters
    ----------
    blocks : int
        B. Contacts of an ensemble are divided among them, n = N/B in the mean.
    coupling : float
        K/(n k), the spring between neighbours.
    drive_stiffness : float
        The spring of each block to the plate over n k, or that of the edge.
    drive : str
        "plate": a plate pulls every block. "edge": block 0 alone is pulled. "both":
        every block through `drive_stiffness`, and block 0 also through
        `edge_stiffness`.
    edge_stiffness : float, optional
        The spring at the edge over n k, of "both".
    mass, damping : float
        M/(n k) (time squared) and eta/(n k) (time) of a block.
    bulk_damping : float
        alpha/(n k) (time), of differences of the velocities of neighbours.
    load : sequence of float, optional
        Weights of the blocks, shape (blocks,), > 0: their contacts are in proportion to
        these. By default all are equal.
    edges : str
        "open" or "periodic".
    tolerance : float
        By how much the force of a block may miss its course between two steps (in units
        of the mean threshold).

    Examples
    --------
    >>> chain = Chain(blocks=100, coupling=20.0, drive_stiffness=0.1, mass=1.0)
    >>> round(chain.wave_speed, 3)  # blocks per time
    4.472
    """

    blocks: int
    coupling: float
    drive_stiffness: float
    drive: Driven = "plate"
    edge_stiffness: float | None = None
    mass: float = 0.0
    damping: float = 0.0
    bulk_damping: float = 0.0
    load: tuple[float, ...] | None = None
    edges: Edges = "open"
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        require_integer("blocks", self.blocks, 1, _MOST_BLOCKS)
        require_number("coupling", self.coupling, least=0.0, most=1e9)
        require_number("drive_stiffness", self.drive_stiffness, **POSITIVE)
        require_choice("drive", self.drive, ("plate", "edge", "both"))
        if self.drive == "edge" and self.blocks > 1 and self.coupling == 0.0:
            said = 'must be > 0 with drive = "edge", or nothing pulls the others'
            raise InputError(f"coupling = {self.coupling!r}: {said}")
        both, edge = self.drive == "both", self.edge_stiffness
        if both != (edge is not None):
            said = 'is required with drive = "both"'
            said = said if both else 'not allowed unless drive = "both"'
            raise InputError(f"edge_stiffness: {said}")
        if edge is not None:
            require_number("edge_stiffness", edge, **POSITIVE)
        for name in ("mass", "damping", "bulk_damping"):
            require_number(name, getattr(self, name), **NOT_NEGATIVE)
        if not self.mass and not self.damping:
            said = (
                "a chain in time has a damping or a mass > 0; without them it is "
                "quasi-static, and declared in [elastic]"
            )
            raise InputError(f"damping = {self.damping!r}: {said}")
        require_choice("edges", self.edges, ("open", "periodic"))
        if self.edges == "periodic" and (self.blocks < 3 or self.drive != "plate"):
            said = 'takes 3 blocks or more and drive = "plate"; a ring has no edge'
            raise InputError(f'edges = "periodic": {said}')
        require_number("tolerance", self.tolerance, least=1e-8, most=1e-1)
        if self.load is not None:
            object.__setattr__(self, "load", tuple(self.load))
            if len(self.load) != self.blocks:
                said = f"must be {self.blocks} numbers, one for each block"
                raise InputError(f"load: has {len(self.load)}; {said}")
            for weight in self.load:
                require_number("load", weight, above=0.0, most=1e9)

    @property
    def wave_speed(self) -> float:
        """c = sqrt(K/M) of long waves without contacts (blocks per time); infinite
        without a mass."""
        return math.sqrt(self.coupling / self.mass) if self.mass else math.inf

    @property
    def springs(self) -> Array:
        """K_j/(n k) of the spring that drives each block, (blocks,)."""
        springs = np.full(self.blocks, float(self.drive_stiffness))
        if self.drive == "edge":
            springs[1:] = 0.0
        springs[0] += self.edge_stiffness or 0.0
        return springs

    @property
    def neighbours(self) -> Array:
        """Number of neighbours of each block, (blocks,)."""
        found = np.full(self.blocks, 2.0)
        if self.edges == "open":
            found[0] -= 1.0
            found[-1] -= 1.0
        return found

    def contacts_of(self, count: int) -> Array:
        """Number of contacts of each block, of `count` in all, shape (blocks,). Raises
        InputError if a block has none, or if equal blocks cannot have equal numbers."""
        if self.load is None and count % self.blocks:
            said = f"must be a multiple of the {self.blocks} blocks of the chain"
            raise InputError(f"contacts.count = {count}: {said}")
        weights = np.ones(self.blocks) if self.load is None else np.array(self.load)
        ends = np.rint(np.cumsum(weights) * (count / weights.sum())).astype(np.int64)
        found = np.diff(ends, prepend=0)
        if found.min() < 1:
            few = int(np.argmin(found))
            said = f"gives block {few} no contact of {shown(count)}; take more of them"
            raise InputError(f"load: {said}")
        return np.asarray(found)
