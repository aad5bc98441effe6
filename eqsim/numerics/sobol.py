"""Scrambled Sobol sequences, many at a time: the same bits as `scipy.stats.qmc.Sobol`,
which takes longer to begin a sequence than to make two thousand points.

Point i of a sequence is a shift and, for each bit k of i, an exclusive or with a word
w_k: so many points follow from half as many. Direction numbers are those of Joe and Kuo
(2008); the scramble is a lower triangular matrix of bits and a shift (Matousek, J. of
Complexity 14, 527, 1998).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eqsim.numerics.compiled import kernel
from eqsim.numerics.tables import Array

_SOBOL_BITS = 30
# places of the bits of a number, the highest first
_PLACES = np.arange(_SOBOL_BITS - 1, -1, -1, dtype=np.int32)


def _directions(dimensions: int) -> Array:
    """The bits of the direction numbers of up to three dimensions, shape (dimensions,
    bits, numbers)."""
    m = np.ones((3, _SOBOL_BITS), np.int64)
    m[2, 1] = 3
    for k in range(1, _SOBOL_BITS):
        m[1, k] = 2 * m[1, k - 1] ^ m[1, k - 1]
        if k > 1:
            m[2, k] = 2 * m[2, k - 1] ^ 4 * m[2, k - 2] ^ m[2, k - 2]
    numbers = m[:dimensions] << _PLACES
    return np.asarray((numbers[:, None, :] >> _PLACES[:, None]) & 1, np.float64)


class Sobol(NamedTuple):
    """Sequences of points in the unit cube, as numbers uint32; the first point is number
    0."""

    shift: Array  # (sequences, dimensions)
    words: Array  # (sequences, dimensions, words), one for each bit of a point's number

    @classmethod
    def of(
        cls, generators: Sequence[np.random.Generator], dimensions: int, most: int
    ) -> "Sobol":
        """Make a sequence of `most` points, up to 2^30, from each random generator, in
        up to three dimensions."""
        shape = len(generators), dimensions, _SOBOL_BITS
        size = dimensions * _SOBOL_BITS
        count = size * (1 + _SOBOL_BITS)
        each = [rng.integers(2, size=count, dtype=np.uint32) for rng in generators]
        drawn = np.array(each)
        shifts = drawn[:, :size].reshape(shape)
        matrices = drawn[:, size:].reshape(*shape, _SOBOL_BITS)
        scramble = matrices * np.tri(_SOBOL_BITS, k=-1) + np.eye(_SOBOL_BITS)
        needed = _directions(dimensions)[:, :, : (most - 1).bit_length()]
        bits = (scramble @ needed).astype(np.int32) & 1
        words = np.bitwise_or.reduce(bits << _PLACES[:, None], axis=2).astype(np.uint32)
        # points follow each other in the order of Gray
        words[..., 1:] ^= words[..., :-1]
        return cls((shifts << _PLACES[::-1]).sum(axis=2, dtype=np.uint32), words)

    def some(self, which: slice) -> "Sobol":
        """Select sequences."""
        return Sobol(self.shift[which], self.words[which])

    def points(self, first: int, count: int) -> Array:
        """Points number `first` to `first` + `count` - 1 of each sequence in the middle
        of their cells, away from 0, shape (dimensions, sequences, count); `count` is a
        power of 2 that divides `first`."""
        found = np.empty((*self.shift.shape[::-1], count))
        put_points(self, first, np.empty(count, np.uint32), found)
        return found


@kernel
def put_points(sobol: Sobol, first: int, bits: Array, found: Array) -> None:
    """The kernel of `Sobol.points`; `bits` is scratch."""
    shift, words = sobol
    for s in range(shift.shape[0]):
        for d in range(shift.shape[1]):
            bits[0], half = shift[s, d], 1
            for k in range(words.shape[2]):
                if first >> k & 1:
                    bits[0] ^= words[s, d, k]
            for k in range(words.shape[2]):
                if half < bits.size:
                    for i in range(half):
                        bits[half + i] = bits[i] ^ words[s, d, k]
                    half *= 2
            for i in range(bits.size):
                found[d, s, i] = bits[i] * 2.0**-_SOBOL_BITS + 2.0 ** -(_SOBOL_BITS + 1)
