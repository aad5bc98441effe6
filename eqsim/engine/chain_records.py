"""Records of chains of blocks: fronts, events, and what is read off them."""

from dataclasses import dataclass

from eqsim.engine.records import PulledRecord
from eqsim.model.chain import Chain
from eqsim.numerics.tables import Array


@dataclass(frozen=True, repr=False)
class ChainTrajectory(PulledRecord):
    """A record of a chain of blocks. X, force and pinned share are means over blocks
    and replicas, `spring` is the force of all springs that drive, over N k.

    Attributes are those of `PulledRecord`, and

    Attributes
    ----------
    chain : Chain
        The blocks.
    steps : tuple of int
        Steps of each replica.
    blocks : dict of ndarray
        Columns, with a row for each record of each block: `t`, `block`, displacement
        `X` (length), velocity `V` (length/time), `force` F_j/(n k) (length), `pinned`
        share of its contacts, `breaks` so far, and the `replica`.
    broke : dict of ndarray
        Columns, with a row for each block that broke in an event, when half of its
        contacts had broken: the number of the `event`, `block`, `t`, its `X` then
        (length), and the `replica`.
    events : dict of ndarray
        Columns: the number of the `event`, `t` when it began, `duration`, how many
        `blocks` broke, `peak`, the largest force of the springs that drive since the
        event before, and its `drop` (lengths), the `energy` taken by breaks and dampers
        over N k (length squared), and the `replica`. An event goes on while a block
        moves more than ten times as fast as the fastest segment of the programme; at
        least one block breaks.
    """

    chain: Chain
    steps: tuple[int, ...]
    blocks: dict[str, Array]
    broke: dict[str, Array]
    events: dict[str, Array]
