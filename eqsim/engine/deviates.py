"""Normal and chi-square deviates of a step of fluctuating thresholds."""

import math
from typing import Any

from eqsim.numerics.compiled import routine
from eqsim.numerics.streams import Key, midpoints
from eqsim.numerics.vector_math import exp, log, quarter_sine


@routine(inline=True)
def normals_of(u: float, v: float) -> tuple[float, float]:
    """A normal deviate and the square of another from two uniforms (Box and Muller)."""
    square = -2.0 * log(u)
    normal = math.sqrt(square) * quarter_sine(2.0 * v - 1.0)
    return normal, max(square - normal * normal, 0.0)


@routine(inline=True)
def pairs_of(shape: float) -> int:
    """Number of pairs of squared normals in chi-square of 2 shape + 1 degrees of
    freedom; -1 if `try_chi_square` draws it."""
    freedom = 2.0 * shape + 1.0
    whole = freedom == math.floor(freedom) and freedom < 14.0
    return int(freedom) // 2 if whole else -1


@routine(inline=True)
def times_uniforms(
    key: Key, contact: int, life: int, draw: int, product: float, count: int
) -> float:
    """`product` times min(count, 4) further uniforms."""
    a, b, d, e = midpoints(key, contact, life, draw)
    product *= a
    if count > 1:
        product *= b
    if count > 2:
        product *= d
    return product * e if count > 3 else product


@routine(inline=True)
def chi_square(shape: float, square: float, product: float) -> float:
    """Chi-square of 2 shape + 1 degrees of freedom from the square of a normal, and the
    product of a uniform for every pair of squares."""
    pairs = pairs_of(shape)
    odd = square if 2.0 * shape + 1.0 > 2.0 * pairs else 0.0
    return odd - 2.0 * log(product) if pairs > 0 else odd


@routine(inline=True)
def try_chi_square(
    key: Key, contact: int, life: int, draw: int, shape: float, u: float
) -> float:
    """Chi-square of 2 shape + 1 degrees of freedom, or 0, which means to try again with
    another draw but the same uniform `u` (Marsaglia and Tsang, 2000, for the shape 1/2
    + shape >= 1/2, raised by 1 if below 1)."""
    half, lift = shape + 0.5, 1.0
    if half < 1.0:
        lift, half = exp(log(u) / half), half + 1.0
    third = half - 1.0 / 3.0
    a, b, d, _ = midpoints(key, contact, life, draw)
    z, _ = normals_of(a, b)
    root = max(1.0 + z / math.sqrt(9.0 * third), 1e-30)  # so small that it is rejected
    cube = root * root * root
    taken = log(d) < 0.5 * z * z + third * (1.0 - cube + log(cube))
    return 2.0 * third * cube * lift if taken else 0.0


@routine(inline=True)
def random_step(
    key: Key, contact: int, life: int, draw: int, shape: float
) -> tuple[Any, Any, Any, Any]:
    """A normal deviate, a chi-square deviate of 2 shape + 1 degrees of freedom, a
    uniform, and the next draw."""
    a, b, product, passage = midpoints(key, contact, life, draw)
    draw += 1
    normal, square = normals_of(a, b)
    pairs = pairs_of(shape)
    if pairs < 0:
        square = 0.0
        while square == 0.0:
            square = try_chi_square(key, contact, life, draw, shape, product)
            draw += 1
        return normal, square, passage, draw
    for done in range(1, pairs, 4):
        product = times_uniforms(key, contact, life, draw, product, pairs - done)
        draw += 1
    return normal, chi_square(shape, square, product), passage, draw
