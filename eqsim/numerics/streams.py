"""Random streams that belong to contacts: a draw depends on (seed, purpose, contact,
life, draw) and nothing else.

Philox4x32-10 (Salmon, Moraes, Dror and Shaw, 2011: "Parallel random numbers: as easy as
1, 2, 3") turns a counter and a key into 128 random bits. The key comes from (seed,
purpose), the counter holds contact, life and draw, so that a contact's history cannot
depend on threads, blocks, or on what was simulated before it.
"""

import hashlib
from typing import Any, NamedTuple

import numpy as np

from eqsim.numerics.compiled import routine

TRAJECTORY = 1  # purpose of contacts that are simulated along a drive
CANDIDATES = 3  # purpose of the candidates for breaks by heat in coupled blocks
STEADY = 2  # purpose of steady estimates; a hash of their parameters is added to it

ROUGH = 2.0**-20  # below it the cells of `product` are wider than 2^-12 of it

_LOW, _HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
_MULTIPLY_0, _MULTIPLY_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_UNITS = np.uint64(0x4330000000000000)  # bits of 2^52
_UNITS_OF_UPPER = np.uint64(0x4530000000000000)  # bits of 2^84
_WEYL_0, _WEYL_1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)


class Key(NamedTuple):
    """The two 32-bit words of a Philox key, each in 64 bits."""

    low: Any
    high: Any


def key(seed: int, purpose: int) -> Key:
    """Philox key of the stream of random numbers of a seed and a purpose."""
    words = np.random.SeedSequence((seed, purpose)).generate_state(2, np.uint32)
    return Key(np.uint64(words[0]), np.uint64(words[1]))


def seed_named(*name: int) -> int:
    """A seed below 2^63 for the stream of random numbers with this name."""
    return int(np.random.SeedSequence(name).generate_state(1, np.uint64)[0] >> 1)


def generator(*name: int) -> np.random.Generator:
    """NumPy generator of the stream with this name. It has the first child of the name
    as a seed, as SciPy's Sobol sequence has, whose bits `numerics.sobol` repeats."""
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(name, spawn_key=(0,)))
    )


def name_of(*declared: Any) -> int:
    """Hash of declared parameters, texts and numbers of any shape, to 64 bits: a part
    of the names of streams. Numbers are rounded to 33 bits, since computed ones, as
    10**-1.5, may differ in their last bits between processors, and have to name the
    same stream."""
    digest = hashlib.sha256()
    for parameter in declared:
        if isinstance(parameter, str):
            digest.update(parameter.encode() + b"\0")
        else:
            mantissa, exponent = np.frexp(np.asarray(parameter, float))
            number = np.ldexp(np.rint(mantissa * 2.0**33), exponent - 33)
            digest.update(number.astype("<f8").tobytes() + b"\0")
    return int.from_bytes(digest.digest()[:8])


@routine(inline=True)
def philox(c0: Any, c1: Any, c2: Any, c3: Any, key: Key) -> tuple[Any, Any, Any, Any]:
    """Ten rounds of Philox4x32; every word is a uint64 that holds 32 bits."""
    # so that the compiler multiplies 32 bits by 32 in the first round, too
    c1, c3 = c1 & _LOW, c3 & _LOW
    low, high = key.low & _LOW, key.high & _LOW
    for _ in range(10):
        p0, p1 = _MULTIPLY_0 * c0, _MULTIPLY_1 * c2
        c0, c1 = (p1 >> _HALF) ^ c1 ^ low, p1 & _LOW
        c2, c3 = (p0 >> _HALF) ^ c3 ^ high, p0 & _LOW
        low, high = (low + _WEYL_0) & _LOW, (high + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@routine(inline=True)
def uniform(low: Any, high: Any) -> float:
    """A uniform in (0, 1) from two 32-bit words: 63 bits near 0, never 0 and never 1."""
    bits = (low | (high << _HALF)) >> np.uint64(1)
    # Halves in the mantissas of 2^84 and of 2^52, whose sum is rounded once: few
    # processors convert several 64-bit integers at a time.
    upper = np.uint64((bits >> _HALF) | _UNITS_OF_UPPER).view(np.float64)
    upper -= 2.0**84 + 2.0**52
    whole = upper + np.uint64((bits & _LOW) | _UNITS).view(np.float64)
    return min((whole + 0.5) * 2.0**-63, 1.0 - 2.0**-53)


@routine(inline=True)
def _midpoint(word: Any) -> float:
    """A 32-bit word plus 1/2 as a float, from the mantissa of 2^52."""
    return np.uint64(word | _UNITS).view(np.float64) - (2.0**52 - 0.5)


@routine(inline=True)
def product(low: Any, high: Any) -> float:
    """The product of two independent uniforms in (0, 1) from two 32-bit words:
    mid-points of cells 2^-32 wide, good enough where the product is above `ROUGH`;
    below, `fine_product` divides the cells further."""
    return (_midpoint(low) * 2.0**-32) * (_midpoint(high) * 2.0**-32)


@routine(inline=True)
def fine_product(
    key: Key, contact: int, life: int, draw: int, low: Any, high: Any
) -> float:
    """Refine a small `product`: a further draw divides the cells of both uniforms,
    which then reach down to 2^-96."""
    u, v = uniforms(key, contact, life, draw)
    first = (np.float64(np.int64(low)) + u) * 2.0**-32
    return first * ((np.float64(np.int64(high)) + v) * 2.0**-32)


@routine(inline=True)
def fill_words(
    key: Key, contact: Any, life: Any, draw: int, words: Any, lanes: int
) -> None:
    """Fill the columns of `words`, shape (4, lanes), with the `bits` of contacts'
    lives."""
    for i in range(lanes):
        a, b, d, e = bits(key, contact[i], life[i], draw)
        words[0, i], words[1, i], words[2, i], words[3, i] = a, b, d, e


@routine(inline=True)
def bits(key: Key, contact: int, life: int, draw: int) -> tuple[Any, Any, Any, Any]:
    """Four random 32-bit words, from which `uniforms` makes its numbers."""
    c, j = np.uint64(contact), np.uint64(life)
    last = ((j >> _HALF) << np.uint64(16)) | np.uint64(draw)
    return philox(c & _LOW, c >> _HALF, j & _LOW, last, key)


@routine(inline=True)
def uniforms(key: Key, contact: int, life: int, draw: int) -> tuple[float, float]:
    """Two independent uniforms of a contact's life; contact < 2^63, life < 2^47, draw <
    2^16."""
    a, b, d, e = bits(key, contact, life, draw)
    return uniform(a, b), uniform(d, e)


@routine(inline=True)
def words(
    key: Key, contact: int, life: int, draw: int
) -> tuple[float, float, float, float]:
    """Four independent 32-bit integers of a contact's path, as floats; contact < 2^63,
    life < 2^32, draw < 2^31. No call of `uniforms` has the same counter."""
    c = np.uint64(contact)
    last = np.uint64(draw) | np.uint64(0x80000000)
    a, b, d, e = philox(c & _LOW, c >> _HALF, np.uint64(life) & _LOW, last, key)
    return np.float64(a), np.float64(b), np.float64(d), np.float64(e)


@routine(inline=True)
def midpoints(
    key: Key, contact: int, life: int, draw: int
) -> tuple[float, float, float, float]:
    """Four independent uniforms in (0, 1) of a contact's path, mid-points of cells
    2^-32 wide, from `words`."""
    a, b, d, e = words(key, contact, life, draw)
    unit = 2.0**-32
    return (a + 0.5) * unit, (b + 0.5) * unit, (d + 0.5) * unit, (e + 0.5) * unit
