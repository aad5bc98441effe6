"""Logarithm, exponential and sine without branches and tables, for loops over lanes of
contacts that are to vectorise.

The usual mathematical library is called once a number; these are additions,
multiplications and at most one division, in strict IEEE arithmetic, so that eight of
them run side by side. The logarithm is that of fdlibm (Sun, 1993), the exponential a
Taylor polynomial of degree 13 after a reduction to |r| <= ln(2)/2. Errors in units of
the last place: below 1 for log (of 2^-1000 to 2^1000), 1.5 for exp and 2 for
exp_less_one (of -708 to 708), 2.5 for log_one_plus, 3 for two_thirds_power, 5 for
quarter_sine.
"""

import math
from typing import Any

import numpy as np

from eqsim.numerics.compiled import fma, routine

# their product with 2^11 is exact
_LN2_HIGH, _LN2_LOW = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_ROOT_HALF = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
# added to a number below 2^51, leaves its nearest integer in the low bits
_SHIFT = 1.5 * 2.0**52
_SHIFT_BITS = 0x4338000000000000
# start of Newton's method for y^(-1/3), less than 4 % off
_CUBE_BITS = (4.0 / 3.0 * 1023.0 - 0.065) * 2.0**52
# where exponents are cut: there ln(1 + y) is ln y to rounding, and y times any factor
# does not yet overflow
FLAT = 400.0
_TAYLOR = tuple(1.0 / math.factorial(i) for i in range(14))
_SINE = (  # of sin(pi z/2)/z in z^2: Chebyshev interpolation, 3e-16 off
    1.5707963267948963, -0.6459640975062232, 0.07969262624568337, -0.004681754131447062,
    0.0001604411695631063, -3.5988107063136794e-06, 5.688318064017795e-08, -6.449471237809134e-10,
)  # fmt: skip


@routine(inline=True)
def _split(x: float) -> tuple[Any, Any]:
    """k and f of a normal x = 2^k (1 + f) > 0, sqrt(1/2) <= 1 + f < sqrt(2)."""
    bits = np.float64(x).view(np.int64)
    k = (bits - _ROOT_HALF) >> 52
    return k, np.int64(bits - (k << 52)).view(np.float64) - 1.0


@routine(inline=True)
def _log_of(k: Any, f: float) -> float:
    """ln(2^k (1 + f)) of what `_split` returns."""
    exponent = np.int64(k + _SHIFT_BITS).view(np.float64) - _SHIFT
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = fma(
        w,
        fma(w, 1.531383769920937332e-01, 2.222219843214978396e-01),
        3.999999999940941908e-01,
    )
    even = fma(
        w,
        fma(w, 1.479819860511658591e-01, 1.818357216161805012e-01),
        2.857142874366239149e-01,
    )
    rest = fma(w, odd, z * fma(w, even, 6.666666666666735130e-01))
    half = 0.5 * f * f
    return fma(
        exponent, _LN2_HIGH, f - (half - fma(s, half + rest, exponent * _LN2_LOW))
    )


@routine(inline=True)
def log(x: float) -> float:
    """ln x of a normal x > 0."""
    return _log_of(*_split(x))


@routine(inline=True)
def exp(x: float) -> float:
    """e^x; beyond +-708 the value there."""
    return bounded_exp(min(max(x, -708.0), 708.0))


@routine(inline=True)
def _exp_parts(x: float) -> tuple[float, float]:
    """e^r - 1 and 2^k of e^x = 2^k e^r, |x| <= 708."""
    shifted = x * 1.4426950408889634 + _SHIFT
    k = shifted - _SHIFT
    r = fma(-k, _LN2_LOW, fma(-k, _LN2_HIGH, x))
    r2 = r * r
    r4 = r2 * r2
    highest = fma(
        r2, fma(_TAYLOR[13], r, _TAYLOR[12]), fma(_TAYLOR[11], r, _TAYLOR[10])
    )
    high = fma(r2, highest, fma(_TAYLOR[9], r, _TAYLOR[8]))
    middle = fma(r2, fma(_TAYLOR[7], r, _TAYLOR[6]), fma(_TAYLOR[5], r, _TAYLOR[4]))
    power = np.int64(
        (np.float64(shifted).view(np.int64) - _SHIFT_BITS + 1023) << 52
    ).view(np.float64)
    return fma(r2, fma(r2, fma(r4, high, middle), fma(_TAYLOR[3], r, 0.5)), r), power


@routine(inline=True)
def bounded_exp(x: float) -> float:
    """e^x, |x| <= 708."""
    more, power = _exp_parts(x)
    return (1.0 + more) * power


@routine(inline=True)
def exp_less_one(x: float) -> float:
    """e^x - 1, |x| <= 708."""
    more, power = _exp_parts(x)
    return fma(more, power, power - 1.0)


@routine(inline=True)
def quarter_sine(z: float) -> float:
    """sin(pi z/2), |z| <= 1."""
    w = z * z
    w2 = w * w
    high = fma(w2, fma(_SINE[7], w, _SINE[6]), fma(_SINE[5], w, _SINE[4]))
    low = fma(w2, fma(_SINE[3], w, _SINE[2]), fma(_SINE[1], w, _SINE[0]))
    return z * fma(w2 * w2, high, low)


@routine(inline=True)
def log_one_plus(t: float) -> float:
    """ln(1 + t), 0 <= t < 2^1000: what 1 + t loses is added to its mantissa."""
    u = 1.0 + t
    k, f = _split(u)
    return _log_of(k, f + (t - (u - 1.0)) * np.int64((1023 - k) << 52).view(np.float64))


@routine(inline=True)
def two_thirds_power(y: float) -> float:
    """y^(2/3) of a normal y > 0: Newton's method for y^(-1/3), from a third of the bits
    of y."""
    r = np.int64(
        _CUBE_BITS - np.float64(np.float64(y).view(np.int64)) * (1.0 / 3.0)
    ).view(np.float64)
    for _ in range(4):
        r = fma(r * (1.0 / 3.0), fma(-y, r * r * r, 1.0), r)
    return y * r
