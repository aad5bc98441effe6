"""States of runs that may be stopped, on disk beside where their results will be."""

import hashlib
import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from eqsim.errors import InputError
from eqsim.io import storage
from eqsim.io.runfile import RunFile, contents_of
from eqsim.numerics.tables import Array

_EVERY = 30.0  # seconds between two states of a replica
_DIGEST = hashlib.sha256().digest_size  # bytes before the arrays of a state


class States:
    """States of the replicas of a run (`engine.keeping.Keep`), in a folder of `out` that
    is named by a digest of `parts`, all that its numbers depend on."""

    def __init__(self, out: Path, *parts: str | bytes) -> None:
        self.folder = storage.unfinished(out, *parts)
        self.begin = time.perf_counter()
        self.saved: dict[int, float] = {}

    def due(self, replica: int) -> bool:
        return time.perf_counter() - self.saved.get(replica, self.begin) > _EVERY

    def load(self, replica: int) -> dict[str, Array] | None:
        """The state that was saved; None if there is none, or if it is damaged."""
        content = b""
        with suppress(OSError):
            content = self._path(replica).read_bytes()
        digest, arrays = content[:_DIGEST], content[_DIGEST:]
        if digest != hashlib.sha256(arrays).digest():
            return None
        with np.load(io.BytesIO(arrays)) as saved:
            return dict(saved)

    def save(self, replica: int, state: dict[str, Array]) -> None:
        """Save a state. One that cannot be written, as on a full disk, does not end the
        run: the next one is tried as usual."""
        written = io.BytesIO()
        np.savez(written, allow_pickle=False, **state)
        arrays = written.getvalue()
        with suppress(InputError):
            content = hashlib.sha256(arrays).digest() + arrays
            storage.save(self._path(replica), content)
        self.saved[replica] = time.perf_counter()

    def remove(self) -> None:
        """Forget all states, when the run is done."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, replica: int) -> Path:
        return self.folder / f"{replica}.state"


@contextmanager
def kept(file: RunFile, out: Path | States | None) -> Iterator[States | None]:
    """The states of the runs of a file with coupled blocks, if there is a folder for its
    results; they are removed at the end of the block. States stay with the caller that
    has made them, and removes them once results are on disk."""
    if isinstance(out, States):
        yield out
        return
    if out is None or not file["elastic"]:
        yield None
        return
    contents = contents_of(file).values()
    states = States(out, storage.to_json(file.settings), *contents)
    yield states
    states.remove()
