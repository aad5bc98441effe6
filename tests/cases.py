"""Cases of tests: some by default, all of them with -m verification."""

import itertools

import pytest


def thinned(every, *axes):
    """All combinations of the values of `axes`, for `parametrize`: by default one in `every`. Where there are
    several axes it has no factor in common with how many values they have, so that each value is met."""
    return some(every, itertools.product(*axes))


def some(every, cases):
    """These cases, tuples, for `parametrize`: by default one in `every`."""
    return [
        pytest.param(*case, marks=[pytest.mark.verification] if index % every else [])
        for index, case in enumerate(cases)
    ]
