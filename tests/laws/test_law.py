"""Laws of different type are different, though their numbers may be equal."""

import dataclasses
import operator
import pickle
from itertools import combinations, permutations

import numba
import pytest
from kernels import compiled

from eqsim.laws.aging import RULES, Unaged
from eqsim.laws.barrier import BARRIERS, Mechanical
from eqsim.laws.barrier.base import height
from eqsim.laws.barrier.pooled import NO_POOL, Pooled
from eqsim.laws.delay import DELAYS
from eqsim.laws.named import THRESHOLDS
from eqsim.laws.newborn import LAWS
from eqsim.laws.threshold import Gamma

NUMBERS = [
    Mechanical,
    *BARRIERS.values(),
    Unaged,
    *RULES.values(),
    *DELAYS.values(),
    *LAWS.values(),
]


def of_ones(law):
    """A law all numbers of which are 1."""
    return law._make([1.0] * len(law._fields))


def test_every_law_is_unequal_to_every_other():
    assert len(NUMBERS) >= 13
    for one, other in permutations(NUMBERS, 2):
        assert of_ones(one) != of_ones(other)
        assert not operator.eq(of_ones(one), of_ones(other))
    assert len({of_ones(law) for law in NUMBERS}) == len(NUMBERS)
    same = [
        (one, other)
        for one, other in combinations(NUMBERS, 2)
        if len(one._fields) == len(other._fields)
    ]
    assert len(same) > 20  # whose numbers are equal


@pytest.mark.parametrize("law", NUMBERS, ids=lambda law: law.__name__)
def test_equal_laws(law):
    one, other = of_ones(law), of_ones(law)
    assert one == other
    assert not operator.ne(one, other)
    assert hash(one) == hash(other)
    assert one != one._replace(**{law._fields[0]: 2.0})
    assert one != tuple(one)
    assert pickle.loads(pickle.dumps(one)) == one


def test_pooled_barriers_of_other_tables_are_compared_by_identity():
    assert Pooled(1.0, *NO_POOL) == Pooled(1.0, *NO_POOL)
    assert Pooled(1.0, *NO_POOL) != Pooled(2.0, *NO_POOL)


def test_laws_of_thresholds():
    """Dataclasses: those of numbers that all of them take."""
    laws = [Gamma, *THRESHOLDS.values()]
    made = {law: object.__new__(law) for law in laws}
    for law, empty in made.items():
        for field in dataclasses.fields(law):
            object.__setattr__(empty, field.name, 1.0)
    for one, other in permutations(made.values(), 2):
        assert one != other
        assert {one: 1}.get(other) is None


def test_kernels_tell_them_apart():
    laws = [BARRIERS[name](3.0, 1.0) for name in ("soft", "stiff", "cusp")]
    assert len({numba.typeof(law) for law in laws}) == 3
    height_of = compiled(height)
    found = [height_of(law, 1.0, 0.25, 3.0) for law in laws]
    assert found == pytest.approx(
        [3.0 * (1.0 - 0.0625), 3.0 * 0.75**1.5, 3.0 * 0.75**2], rel=1e-14, abs=0
    )
