"""States of long runs, so that one that was stopped goes on with the same bits."""

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from eqsim.numerics.tables import Array


class Keep(Protocol):
    """A place for the state of each replica."""

    def due(self, replica: int) -> bool:
        """True if the state was last saved, or the run begun, long enough ago."""

    def load(self, replica: int) -> Mapping[str, Array] | None:
        """The state that was saved, if there is one."""

    def save(self, replica: int, state: dict[str, Array]) -> None:
        """Save a state in the place of the last one."""


class State(NamedTuple):
    """Numbers from which a run goes on: `arrays`, which it changes in place, and lists that
    grow, of `rows` of one shape or of `chunks` of a table."""

    arrays: dict[str, Array]
    rows: dict[str, list[Array]]
    chunks: dict[str, list[Array]]

    def restore(self, keep: Keep | None, replica: int) -> int:
        """Go back to where a replica was saved. Returns how many parts of it were done
        there, 0 if nothing was."""
        saved = None if keep is None else keep.load(replica)
        if saved is None:
            return 0
        for name, array in self.arrays.items():
            array[...] = saved[name]
        for name, rows in self.rows.items():
            rows.extend(saved[name])
        for name, chunks in self.chunks.items():
            chunks.append(saved[name])
        return int(saved["done"])

    def save(self, keep: Keep | None, replica: int, done: int) -> None:
        """Save a replica where so many parts are done, if it is time."""
        if keep is None or not keep.due(replica):
            return
        state = {**self.arrays, "done": np.array(done)}
        state |= {name: np.array(rows) for name, rows in self.rows.items()}
        state |= {name: np.concatenate(parts) for name, parts in self.chunks.items()}
        keep.save(replica, state)
