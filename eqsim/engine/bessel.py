"""Passages of Bessel processes, and the modified Bessel functions that they need."""

import math

from eqsim.numerics.compiled import routine


@routine
def touching(n: float, a: float, b: float, r: float, t: float) -> float:
    """The chance that a bridge of the (2n+2)-dimensional Bessel process from a to b
    touches r < a, b in a time t, in which each component gathers the variance t
    (derived):

        exp(-(a-r)(b-r)/t) K(aq) K(bq) I(rs/t)/(K(rq) K(sq) I(ab/t)),   q = (a+b-2r)/t,   s = a+b-r

    with Bessel functions of order n. It is the saddle point of the inverse Laplace
    transform, with arguments such that it is exact for n = 1/2, at a = r and b = r and
    to first order in t. Of all passages in a step it misses 3e-3.
    """
    s, q = a + b - r, (a + b - 2.0 * r) / t
    low, high = r / t * s, a / t * b
    kept = bessel_k(n, a * q) / bessel_k(n, r * q) * bessel_k(n, b * q)
    kept = math.exp(-(a - r) * (b - r) / t) * (kept / bessel_k(n, s * q))
    return kept * (low / high) ** n * bessel_i(n, low) / bessel_i(n, high)


@routine
def bessel_i(n: float, z: float) -> float:
    """I_n(z) (2/z)^n Gamma(n+1), 0 <= n, 0 < z < 700."""
    square, k, term, total = 0.25 * z * z, 0.0, 1.0, 1.0
    while term > 1e-6 * total:
        k += 1.0
        term *= square / (k * (k + n))
        total += term
    return total


@routine
def bessel_k(n: float, z: float) -> float:
    """exp(z) K_n(z) to 1e-6, z > 0: the integral of exp(-z (cosh u - 1)) cosh(n u) over
    u > 0 by trapezoids."""
    width = 1.0 / math.sqrt(4.0 + z)
    total, u, exponent = 0.5, width, 0.0
    while exponent < 16.0:
        root = math.sinh(0.5 * u)
        exponent = 2.0 * z * root * root - n * u
        total += math.exp(-exponent) * 0.5 * (1.0 + math.exp(-2.0 * n * u))
        u += width
    return width * total
