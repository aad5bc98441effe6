"""Vectorised elementary functions in units of the last place of 60 digits, and loops
with them that do vectorise."""

import functools
import math
from fractions import Fraction

import mpmath
import numba
import numpy as np
import pytest
from kernels import compiled

from eqsim.numerics import vector_math
from eqsim.numerics.compiled import fma
from eqsim.numerics.streams import uniform
from eqsim.numerics.tables import look_up, look_up_all, octave_edges, octave_table

RNG = np.random.default_rng(5)
UNIT = RNG.random(4000)  # of (0, 1)
ARGUMENTS = {
    "log": [
        UNIT,
        1.0 - 1e-3 * UNIT,
        1.0 + 1e-9 * UNIT,
        0.5 + UNIT,
        2.0 ** (2000 * UNIT - 1000),
        2.0 ** -np.arange(50),
    ],
    "exp": [
        1416 * UNIT - 708,
        4 * UNIT - 2,
        1e-9 * UNIT,
        np.arange(-20, 21) * math.log(2) / 2,
        [-708.0, 0.0, 708.0],
    ],
    "exp_less_one": [
        1416 * UNIT - 708,
        4 * UNIT - 2,
        -(10.0 ** (300 * UNIT - 300)),
        np.arange(-20, 21) * math.log(2) / 2,
    ],
    "quarter_sine": [
        2 * UNIT - 1,
        10.0 ** (300 * UNIT - 300),
        1.0 - 1e-9 * UNIT,
        [-1.0, 0.0, 1.0],
    ],
    "log_one_plus": [UNIT, 10.0 ** (600 * UNIT - 300), [0.0, 1e-17, 2.0**-53, 1e16]],
    "two_thirds_power": [
        UNIT,
        2.0 ** (120 * UNIT - 60),
        1.0 + 7 * UNIT,
        [1e-17, 1.0, 8.0],
    ],
}
EXACT = {
    "log": mpmath.log,
    "exp": mpmath.exp,
    "exp_less_one": mpmath.expm1,
    "quarter_sine": lambda z: mpmath.sinpi(z / 2),
    "log_one_plus": mpmath.log1p,
    "two_thirds_power": lambda y: mpmath.cbrt(y) ** 2,
}
# ulp
STATED = {
    "log": 1.0,
    "exp": 1.5,
    "exp_less_one": 2.0,
    "quarter_sine": 5.0,
    "log_one_plus": 2.5,
    "two_thirds_power": 3.0,
}


def loop(name):
    """The function over an array, compiled as a kernel is."""
    function = getattr(vector_math, name)

    @numba.njit(error_model="numpy")
    def apply(x, y):
        for i in range(x.size):
            y[i] = function(x[i])

    return apply


@functools.cache
def exact_values(name):
    with mpmath.workdps(60):
        return [
            EXACT[name](mpmath.mpf(float(value)))
            for value in np.concatenate(ARGUMENTS[name])
        ]


def worst(name, change=lambda y: y):
    """The greatest error in ulp of the exact value."""
    x = np.concatenate(ARGUMENTS[name])
    y = np.empty_like(x)
    loop(name)(x, y)
    y, exact = change(y), exact_values(name)
    with mpmath.workdps(60):
        errors = [
            abs(mpmath.mpf(float(a)) - b) / float(np.spacing(abs(float(b))))
            for a, b in zip(y, exact, strict=True)
        ]
    return float(max(errors))


@pytest.mark.parametrize("name", STATED)
def test_stated_error(name):
    assert worst(name) < STATED[name]
    # negative control
    assert worst(name, lambda y: y * (1 + 4 * np.finfo(float).eps)) > STATED[name]


def test_exp_ends_at_its_bounds():
    """What lies beyond +-708 counts as +-708: no infinity, no denormal number."""
    x, y = np.array([-1e300, -709.0, 709.0, 1e300]), np.empty(4)
    loop("exp")(x, y)
    np.testing.assert_array_equal(y[[0, 3]], y[[1, 2]])
    np.testing.assert_allclose(y[1:3], np.exp([-708.0, 708.0]), rtol=1e-12)


@pytest.mark.parametrize("name", STATED)
def test_loops_vectorise(name):
    """A loop over lanes holds packed multiplications of doubles, on any processor that
    has them; libm's does not."""

    def packed(function):
        x = np.ones(128)
        function(x, x.copy())
        return function.inspect_asm(function.signatures[0]).count("mulpd")

    @numba.njit(error_model="numpy")
    def libm(x, y):
        for i in range(x.size):
            y[i] = math.log(x[i])

    # which holds three, besides those that are fused with additions
    fewest = 3 if name == "exp_less_one" else 4
    assert packed(loop(name)) >= fewest
    assert packed(libm) == 0


def test_fma_rounds_once():
    """What the product of two numbers loses to rounding, exactly; additions and
    multiplications would find 0."""

    @numba.njit
    def lost(x, y):
        return fma(x, y, -(x * y))

    exact = [
        float(Fraction(x) * Fraction(y) - Fraction(x * y))
        for x, y in zip(UNIT[:50], UNIT[50:100], strict=True)
    ]
    assert [lost(x, y) for x, y in zip(UNIT[:50], UNIT[50:100], strict=True)] == exact
    assert any(exact)


def test_uniforms_are_rounded_once():
    """Two words make 63 bits, which are rounded once, ties to even, as Python does."""
    draw = compiled(uniform)
    ties = [
        2**k + step
        for k in range(53, 63)
        for step in (1, 2 ** (k - 53), 3 * 2 ** (k - 53), 2 ** (k - 53) + 1)
    ]
    whole = [
        0,
        1,
        2**32 - 1,
        2**32,
        2**53 - 1,
        2**63 - 1,
        *ties,
        *RNG.integers(0, 2**63, 500).tolist(),
    ]
    words = [
        (np.uint64(2 * number % 2**32), np.uint64(2 * number // 2**32))
        for number in whole
    ]
    expected = [
        min((float(number) + 0.5) * 2.0**-63, 1.0 - 2.0**-53) for number in whole
    ]
    assert [draw(*pair) for pair in words] == expected


@pytest.mark.parametrize("count", [1, 4, 7, 8])
def test_look_up_all(count):
    """The same bits as one at a time, also below and beyond the table."""

    @numba.njit
    def each(table, x, y):
        for i in range(x.size):
            y[i] = look_up(table, x[i])

    @numba.njit
    def together(table, s, row, count):
        look_up_all(table, s, row, count)

    edges = octave_edges(-3, 3)
    table = octave_table(-3, edges**0.7, 0.7 * edges**-0.3)
    s = 2.0 ** RNG.uniform(-5, 5, 8)
    expected = np.append(np.empty(count), s[count:])  # the rest is left as it is
    each(table, s[:count].copy(), expected)
    together(table, s, np.empty(8, np.int64), count)
    np.testing.assert_array_equal(s, expected)
