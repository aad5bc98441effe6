"""Philox4x32-10 against published vectors, uniforms at their extremes, and streams that
must not meet."""

import itertools

import numpy as np
import pytest
import scipy.stats
from kernels import compiled

from eqsim.numerics import streams
from eqsim.numerics.streams import ROUGH, STEADY, TRAJECTORY, key

philox, uniform, uniforms = (
    compiled(streams.philox),
    compiled(streams.uniform),
    compiled(streams.uniforms),
)
product, fine_product = compiled(streams.product), compiled(streams.fine_product)
fill_words, words_of_paths = compiled(streams.fill_words), compiled(streams.words)

MASK = 0xFFFFFFFF
# Random123, kat_vectors, philox4x32 of 10 rounds: counter, key, result
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((MASK,) * 4, (MASK,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def words(*values):
    return tuple(np.uint64(value) for value in values)


def plain_philox(counter, k):
    """The algorithm in Python's integers."""
    c0, c1, c2, c3 = counter
    k0, k1 = k
    for _ in range(10):
        a, b = 0xD2511F53 * c0, 0xCD9E8D57 * c2
        c0, c1, c2, c3 = (b >> 32) ^ c1 ^ k0, b & MASK, (a >> 32) ^ c3 ^ k1, a & MASK
        k0, k1 = (k0 + 0x9E3779B9) & MASK, (k1 + 0xBB67AE85) & MASK
    return c0, c1, c2, c3


@pytest.mark.parametrize(("counter", "k", "result"), KNOWN)
def test_known_answers(counter, k, result):
    assert tuple(map(int, philox(*words(*counter), streams.Key(*words(*k))))) == result
    assert plain_philox(counter, k) == result


def test_against_plain_integers():
    for row in np.random.default_rng(1).integers(0, 2**32, (200, 6)).tolist():
        assert tuple(
            map(int, philox(*words(*row[:4]), streams.Key(*words(*row[4:]))))
        ) == plain_philox(row[:4], row[4:])


def test_layout_of_the_counter():
    """contact and life each fill 64 bits of the counter, the draw the last 16; halves
    of the result make a uniform."""
    k = key(7, TRAJECTORY)
    for contact, life, draw in [
        (0, 0, 0),
        (5, 3, 1),
        (2**40 + 9, 2**35 + 2, 65535),
        (2**63 - 1, 2**48 - 1, 1),
    ]:
        counter = (
            contact & MASK,
            contact >> 32,
            life & MASK,
            (life >> 32) << 16 | draw,
        )
        a, b, c, d = plain_philox(counter, tuple(map(int, k)))
        expected = [((high << 32 | low) >> 1) + 0.5 for low, high in ((a, b), (c, d))]
        assert uniforms(k, contact, life, draw) == tuple(
            value * 2.0**-63 for value in expected
        )


def test_key_is_what_numpy_makes_of_seed_and_purpose():
    """Seeds of up to 63 bits; the words are pinned so that no update can silently
    change every result."""
    assert tuple(map(int, key(1, TRAJECTORY))) == tuple(
        np.random.SeedSequence((1, 1)).generate_state(2).tolist()
    )
    keys = {
        tuple(map(int, key(s, p)))
        for s in (0, 1, 2, 2**32, 2**63 - 1)
        for p in (TRAJECTORY, STEADY)
    }
    assert len(keys) == 10


def test_uniform_is_never_0_or_1():
    assert uniform(*words(0, 0)) == 2.0**-64
    assert uniform(*words(1, 0)) == 2.0**-64
    assert uniform(*words(MASK, MASK)) == 1.0 - 2.0**-53
    assert uniform(*words(2**32 - 2**10, MASK)) < 1.0


def test_tail_is_resolved_below_a_double_near_1():
    """All 63-bit values next to 0 differ; their spacing is 2^-63."""
    found = [uniform(*words(low, 0)) for low in range(0, 64, 2)]
    np.testing.assert_array_equal(np.diff(found), 2.0**-63)
    # carries into the high word
    assert uniform(*words(0, 1)) - uniform(*words(MASK, 0)) == 2.0**-63


def test_uniform_rises_with_its_bits():
    values = [
        *sorted(
            np.random.default_rng(2).integers(0, 2**64, 2000, dtype=np.uint64).tolist()
        ),
        2**64 - 1,
    ]
    found = [uniform(*words(value & MASK, value >> 32)) for value in values]
    assert np.diff(found).min() >= 0.0
    np.testing.assert_allclose(
        found, np.array(values, float) * 2.0**-64, rtol=4e-16, atol=2.0**-63
    )


def test_neighbours_differ():
    """No two (seed, purpose, contact, life, draw) in a box share a uniform: 8e4 values
    of 53 bits or more, chance of an accidental tie 4e-7."""
    drawn = [
        u
        for seed, purpose in itertools.product((0, 1), (TRAJECTORY, STEADY))
        for k in [key(seed, purpose)]
        for contact, life, draw in itertools.product(
            (*range(20), 2**32, 2**32 + 1), (*range(20), 2**32), (*range(20), 65535)
        )
        for u in uniforms(k, contact, life, draw)
    ]
    assert len(set(drawn)) == len(drawn)


def walk(direction, count=20_000):
    """Successive pairs of uniforms along one direction of the counter, or over seeds."""
    k = key(3, TRAJECTORY)
    if direction == "contact":
        return np.array([uniforms(k, i, 5, 0) for i in range(count)])
    if direction == "life":
        return np.array([uniforms(k, 5, i, 0) for i in range(count)])
    if direction == "draw":
        return np.array([uniforms(k, 5, 5, i) for i in range(count)])
    return np.array([uniforms(key(i, TRAJECTORY), 5, 5, 0) for i in range(count)])


def p_values(pairs):
    """Uniformity of both columns, and independence of a value from its partner and from
    the next pair."""
    u = pairs[:, 0]
    return (
        scipy.stats.kstest(u, "uniform").pvalue,
        scipy.stats.kstest(pairs[:, 1], "uniform").pvalue,
        scipy.stats.pearsonr(*pairs.T).pvalue,
        scipy.stats.pearsonr(u[1:], u[:-1]).pvalue,
        scipy.stats.kstest((u[1:] + u[:-1])[::2] % 1.0, "uniform").pvalue,
    )


@pytest.mark.parametrize("direction", ["contact", "life", "draw", "seed"])
def test_streams_are_uniform_and_independent(direction):
    """Five p-values in each of four directions, p > 1e-5: false alarm 2e-4."""
    assert min(p_values(walk(direction))) > 1e-5


def test_related_streams_fail():
    """Negative controls: a drift, equal neighbours, an additive (Weyl) sequence, a
    repeated stream."""
    good = walk("contact")
    assert min(p_values(good**1.05)) < 1e-5
    assert min(p_values(np.repeat(good, 2, axis=0)[: len(good)])) < 1e-5
    assert (
        min(
            p_values(
                np.stack((np.arange(20_000) * 0.6180339887 % 1.0, good[:, 1]), axis=1)
            )
        )
        < 1e-5
    )
    assert min(p_values(np.stack((good[:, 0], good[:, 0]), axis=1))) < 1e-5


def test_words_have_counters_of_their_own():
    """The top bit of the last word is set for paths and clear for every life < 2^47 and
    draw < 2^16 of `uniforms`."""
    k = key(7, TRAJECTORY)
    plain = tuple(map(int, k))
    for contact, life, draw in [
        (0, 0, 0),
        (5, 3, 1),
        (2**40 + 9, 2**32 - 1, 65535),
        (2**63 - 1, 7, 2**31 - 1),
    ]:
        counter = (contact & MASK, contact >> 32, life, draw | 2**31)
        assert words_of_paths(k, contact, life, draw) == plain_philox(counter, plain)
    assert (((2**47 - 1) >> 32) << 16 | 65535) < 2**31


def test_words_do_not_repeat_uniforms():
    """No 64-bit half of a path's words is one of the same contact's uniforms: 8e3
    values, chance 2e-12 of a tie."""
    k = key(3, TRAJECTORY)
    box = list(itertools.product((0, 1, 2**32), (0, 1, 2, 2**32 - 1), range(200)))
    paths = {
        half for at in box for w in [words_of_paths(k, *at)] for half in (w[:2], w[2:])
    }
    assert len(paths) == 2 * len(box)
    others = {uniform(np.uint64(low), np.uint64(high)) for low, high in paths}
    assert not others & {u for at in box for u in uniforms(k, *at)}


@pytest.mark.parametrize("direction", ["contact", "life", "draw"])
def test_words_are_uniform_and_independent(direction):
    """Five p-values of each of two pairs of words in each direction, p > 1e-5: false
    alarm 3e-4."""
    k = key(4, TRAJECTORY)
    place = {
        "contact": lambda i: (i, 5, 6),
        "life": lambda i: (5, i, 6),
        "draw": lambda i: (5, 6, i),
    }[direction]
    found = (
        np.array([words_of_paths(k, *place(i)) for i in range(20_000)]) + 0.5
    ) * 2.0**-32
    assert min(*p_values(found[:, :2]), *p_values(found[:, 2:])) > 1e-5


def test_lanes_of_words_are_those_of_uniforms():
    k = key(5, TRAJECTORY)
    contact, life = (
        np.array([0, 7, 2**40 + 9, 2**62]),
        np.array([3, 2**35 + 2, 0, 2**46]),
    )
    found = np.empty((4, 4), np.uint64)
    fill_words(k, contact, life, 2, found, 4)
    for i in range(4):
        a, b, c, d = found[:, i]
        assert (uniform(a, b), uniform(c, d)) == uniforms(
            k, int(contact[i]), int(life[i]), 2
        )


def test_product_is_never_0_or_1_and_is_that_of_cell_centres():
    assert product(*words(0, 0)) == 2.0**-66
    assert product(*words(MASK, MASK)) == (1.0 - 2.0**-33) ** 2 < 1.0
    for low, high in np.random.default_rng(4).integers(0, 2**32, (200, 2)).tolist():
        assert product(*words(low, high)) == pytest.approx(
            (low + 0.5) * (high + 0.5) * 2.0**-64, rel=2e-16, abs=0
        )


def test_small_products_are_refined_within_their_cells():
    """The refined factors lie in the cells of the coarse ones, at uniforms of a draw of
    their own."""
    k = key(6, TRAJECTORY)
    for contact, (low, high) in enumerate(
        np.random.default_rng(4).integers(0, 2**12, (200, 2)).tolist()
    ):
        u, v = uniforms(k, contact, 9, 2)
        assert fine_product(k, contact, 9, 2, *words(low, high)) == pytest.approx(
            (low + u) * (high + v) * 2.0**-64, rel=1e-15, abs=0
        )


def test_resolution_of_products():
    """Where a product is above ROUGH both factors are, so that a cell of 2^-32 is at
    most 2^-12 of its factor: its centre stands for the mean of -ln u over it with an
    error of (2^-12)^2/24 = 2.5e-9, in a share ROUGH of all draws.
    """
    low = np.uint64(ROUGH * 2**32) - np.uint64(1)
    assert product(low, np.uint64(MASK)) < ROUGH  # any smaller factor is refined
    edge = ROUGH + np.arange(4097) * 2.0**-32
    mean = 1.0 - np.diff(edge * np.log(edge)) / np.diff(edge)
    error = -np.log(0.5 * (edge[1:] + edge[:-1])) - mean
    # rounding of differences of u ln u, 1e-16 of 1e-5 over 2e-10
    assert np.abs(error).max() < 2.0**-24 / 24 + 1e-11
