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
from typing import Annotated

import numpy as np

from eqsim.errors import InputError, Limits, NotNegative, shown
from eqsim.model.elastic import Elastic
from eqsim.numerics.tables import Array


@dataclass(frozen=True)
class Chain(Elastic):
    """A chain of blocks of contacts that moves in time. It is declared in
    `Programme(chain=...)`, whose segments are those of the plate, or of the end of the
    spring at the edge.

    Raises InputError for a value out of range, for a sheet, and without both mass and
    damping: that is the quasi-static model, `Elastic`.

    Parameters
    ----------
    blocks, coupling, drive_stiffness, edges, drive, edge_stiffness, load
        Those of a chain, as in `Elastic`.
    mass, damping : float
        M/(n k) (time squared) and eta/(n k) (time) of a block.
    bulk_damping : float
        alpha/(n k) (time), of differences of the velocities of neighbours.
    tolerance : float
        By how much the force of a block may miss its course between two steps (in units
        of the mean threshold).

    Examples
    --------
    >>> chain = Chain(blocks=100, coupling=20.0, drive_stiffness=0.1, mass=1.0)
    >>> round(chain.wave_speed, 3)  # blocks per time
    4.472
    """

    mass: NotNegative = 0.0
    damping: NotNegative = 0.0
    bulk_damping: NotNegative = 0.0
    tolerance: Annotated[float, Limits(1e-8, 1e-1)] = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.shape[1] > 1:
            raise InputError(
                f"blocks = {shown(self.blocks)}: in time only a chain moves"
            )
        if not self.mass and not self.damping:
            said = "a chain in time has a damping or a mass > 0; without them it is"
            more = "quasi-static, and declared in [elastic]"
            raise InputError(f"damping = {self.damping!r}: {said} {more}")
        if self.drive == "edge" and self.count > 1 and self.coupling == 0.0:
            said = 'must be > 0 with drive = "edge", or nothing pulls the others'
            raise InputError(f"coupling = {self.coupling!r}: {said}")
        if self.edges == "periodic" and self.count < 3:
            raise InputError('edges = "periodic": a ring has 3 blocks or more')

    @property
    def wave_speed(self) -> float:
        """c = sqrt(K/M) of long waves without contacts (blocks/time), or infinite."""
        return math.sqrt(self.coupling / self.mass) if self.mass else math.inf

    @property
    def neighbours(self) -> Array:
        """Number of neighbours of each block, (blocks,)."""
        found = np.full(self.count, 2.0)
        if self.edges == "open":
            found[0] -= 1.0
            found[-1] -= 1.0  # a single block has none
        return found
