"""Find where a density that is known by its values alone has jumps, kinks or
infinities."""

from collections.abc import Callable

import numpy as np

from eqsim.numerics.tables import Array

# Windows are cut to a quarter of their width, JUDGED_LEVELS times to judge them and
# SHARPER times more to locate kinks.
JUDGED_LEVELS = 7
SHARPER = 17
# A second difference falls by 4 per level at a kink and by 16 where the density is
# smooth, so that over the last three levels it falls by 64 or by 4096. The border is
# between.
FALLS = 1.0 / 400.0
# second differences, in units of the density nearby, that rounding may make
NOISE = 1e-11
LARGEST = 1e100  # stands for an infinite density
# kinks that are kept, those of the largest second differences: a density with noise has
# them everywhere
MOST_KINKS = 64
APART = 1e-9  # relative distance of kinks that are the same


def density_kinks(pdf: Callable[[Array], Array], x: Array) -> Array:
    """Find jumps, kinks and infinities of a density `pdf`, a function of an array of any
    shape, between ascending points `x`, shape (points,), that are close where it has
    features. Returns ascending positions, to about 1e-13 of the distance of points."""

    def sharpest(left: Array, width: Array) -> tuple[Array, Array]:
        """Left ends of the quarters of windows with the largest second differences, and
        these over the density."""
        at = left[:, None] + width[:, None] * np.linspace(0.0, 1.0, 9)
        with np.errstate(all="ignore"):
            f = np.nan_to_num(pdf(at), nan=LARGEST, posinf=LARGEST)
        second = np.abs(np.diff(f, 2, axis=1))
        place = second.argmax(axis=1)
        rows = np.arange(left.size)
        return at[rows, place], second[rows, place] / np.maximum(f.max(axis=1), 1e-300)

    left = x[:-2]
    width = x[2:] - left
    falls = []
    for _ in range(JUDGED_LEVELS):
        left, second = sharpest(left, width)
        width = width / 4.0
        falls.append(second)
    kink = np.flatnonzero((falls[-1] > FALLS * falls[-4]) & (falls[-1] > NOISE))
    kink = np.sort(kink[np.argsort(-falls[-1][kink], kind="stable")[:MOST_KINKS]])
    left, width = left[kink], width[kink]
    for _ in range(SHARPER):
        left, _ = sharpest(left, width)
        width = width / 4.0
    places = np.sort(left + 0.5 * width)
    return places[np.diff(places, prepend=-np.inf) > APART * np.abs(places)]
