"""Scrambled Sobol sequences, many at a time: to the last bit those of `scipy.stats.qmc.Sobol`, which takes longer to
begin one of them than two thousand points do.

Point i of a sequence is a shift and, for each bit k of i, an exclusive or with a word w_k: so many points follow from
half as many. Direction numbers are those of Joe and Kuo (2008); the scramble is a lower triangular matrix of bits and a
shift (Matousek, J. of Complexity 14, 527, 1998).
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eqsim.numerics.compiled import routine
from eqsim.numerics.tables import Array

_BITS = 30
CELL = 2.0**-_BITS  # points lie in the middle of their cells, away from 0
_PLACES = np.arange(_BITS - 1, -1, -1, dtype=np.int32)  # of the bits of a number, the highest first


@functools.cache
def _directions(dimensions: int) -> Array:
    """The bits of the direction numbers of up to three dimensions, shape (dimensions, bits, numbers)."""
    m = np.ones((3, _BITS), np.int64)
    m[2, 1] = 3
    for k in range(1, _BITS):
        m[1, k] = 2 * m[1, k - 1] ^ m[1, k - 1]
        if k > 1:
            m[2, k] = 2 * m[2, k - 1] ^ 4 * m[2, k - 2] ^ m[2, k - 2]
    numbers = m[:dimensions] << _PLACES
    return np.asarray((numbers[:, None, :] >> _PLACES[:, None]) & 1, np.float64)


class Sobol(NamedTuple):
    """Sequences of points in the unit cube; the first point is number 0.

    Attributes
    ----------
    shift : ndarray of uint32, shape (dimensions, sequences)
    words : ndarray of uint32, shape (dimensions, sequences, words)
        As many as the number of a point has bits.
    """

    shift: Array
    words: Array

    @classmethod
    def of(cls, generators: Sequence[np.random.Generator], dimensions: int, most: int) -> "Sobol":
        """A sequence of each random generator, of `most` points, up to 2^30, in up to three dimensions."""
        size, shape = dimensions * _BITS, (len(generators), dimensions, _BITS)
        drawn = np.array([rng.integers(2, size=size * (1 + _BITS), dtype=np.uint32) for rng in generators])
        shifts = drawn[:, :size].reshape(shape)
        scramble = drawn[:, size:].reshape(*shape, _BITS) * np.tri(_BITS, k=-1) + np.eye(_BITS)
        needed = _directions(dimensions)[:, :, : (most - 1).bit_length()]
        bits = (scramble @ needed).astype(np.int32) & 1
        words = np.bitwise_or.reduce(bits << _PLACES[:, None], axis=2).astype(np.uint32)
        words[..., 1:] ^= words[..., :-1]  # points follow each other in the order of Gray
        shift = (shifts << _PLACES[::-1]).sum(axis=2, dtype=np.uint32)
        return cls(shift.T.copy(), words.transpose(1, 0, 2).copy())

    def some(self, which: slice) -> "Sobol":
        """Some of the sequences."""
        return Sobol(self.shift[:, which], self.words[:, which])

    def at(self, number: int) -> Array:
        """Point `number` of each sequence, in cells, shape (dimensions, sequences)."""
        places = [k for k in range(number.bit_length()) if number >> k & 1]
        return self.shift ^ np.bitwise_xor.reduce(self.words[..., places], axis=2)


@routine
def put_points(start: int, words: Array, found: Array) -> None:
    """Points of one dimension in cells, from `start` on, whose number is a multiple of the power of 2 that `found` has
    room for."""
    found[0], half = start, 1
    for k in range(words.size):
        if half < found.size:
            for i in range(half):
                found[half + i] = found[i] ^ words[k]
            half *= 2
