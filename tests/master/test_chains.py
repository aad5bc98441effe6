"""Chains of blocks in slow motion and in creep, against rational numbers, limits, and
equations that are solved in another way."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from eqsim import (
    Aging,
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Thermal,
    edge_load,
    precursors,
    reference,
)
from eqsim.master.chain_creep import creep_velocity
from eqsim.master.chains import static_friction

COLD = Ensemble(Gamma(1.0), Thermal(0.0), stiffness_law="uniform")
AGED_AT_ONCE = replace(COLD, aging=Aging("flow", math.inf, 100.0))
POOLED = replace(COLD, disorder="annealed", aging=Aging("flow", 0.1, 2.0))


def exactly(value):
    return pytest.approx(value, rel=1e-12, abs=0)


def test_the_load_of_the_first_break_is_that_of_a_solved_chain():
    assert edge_load(20.0) == exactly(5.0)
    assert edge_load(20.0, 10) == pytest.approx(4.8721390019, rel=1e-10, abs=0)
    assert edge_load(3.0, 1) == exactly(1.0)
    chain = (1.0 + 2.0 * 20.0) * np.eye(10) - 20.0 * (
        np.eye(10, k=1) + np.eye(10, k=-1)
    )
    chain[[0, -1], [0, -1]] -= 20.0
    moved = np.linalg.inv(chain)[0]
    assert edge_load(20.0, 10) == exactly(1.0 / moved[0])
    assert moved[-1] / moved[0] == pytest.approx(0.23815967, rel=1e-7, abs=0)


def rational_loads(events):
    """Loads of precursors of a half infinite chain with K = 20, z = 4/5, as fractions."""
    z, blocks = Fraction(4, 5), 2 * events
    m = [0] * blocks

    def G(j, i):
        return (1 - z) / (1 + z) * (z ** abs(i - j) + z ** (i + j + 1))

    loads = []
    for _ in range(events):
        rest = [
            sum(G(j, i) * m[i] for i in range(blocks)) - m[j] for j in range(blocks)
        ]
        F = min((1 - x) / G(j, 0) for j, x in enumerate(rest))
        loads.append(F)
        while True:
            x = [
                F * G(j, 0) + sum(G(j, i) * m[i] for i in range(blocks)) - m[j]
                for j in range(blocks)
            ]
            if max(x) < 1:
                break
            m[x.index(max(x))] += 1
    return loads


def test_loads_of_precursors_are_rational():
    known = ["5", "21/4", "461/80", "10501/1600", "881/125", "18501/2500"]
    loads = rational_loads(6)
    assert loads == [Fraction(load) for load in known]
    found = precursors(20.0, 200, most=6)
    assert found.force.tolist() == pytest.approx(
        [float(F) for F in loads], rel=1e-12, abs=0
    )
    assert found.reach.tolist() == [1, 2, 3, 4, 5, 6]
    assert found.breaks.tolist() == [1, 1, 1, 1, 2, 2]


@pytest.mark.parametrize("coupling", [1.0, 1])
def test_precursors_of_two_blocks_of_unequal_load(coupling):
    """Two blocks of weights 1/2 and 3/2 with K = 1, by hand: G = ((10, 4), (4, 6))/11,
    and a break of the first block moves both by half of its column."""
    found = precursors(coupling, 2, load=[1.0, 3.0])
    assert found.force.tolist() == pytest.approx([1.1, 1.7, 1.75], rel=1e-14, abs=0)
    assert found.reach.tolist() == [1, 1, 2]
    assert found.breaks.tolist() == [1, 1, 1]


def test_precursors_end_when_the_chain_slides_and_go_farther_where_it_bears_less():
    even = precursors(5.0, 30)
    assert even.reach[-1] == 30 > even.reach[-2]
    assert np.all(np.diff(even.force) >= 0.0)
    same = precursors(5.0, 30, load=[7.0] * 30)
    assert np.array_equal(same.force, even.force)
    light = precursors(5.0, 30, load=np.linspace(0.2, 1.8, 30))
    assert light.force[0] < even.force[0]
    assert light.reach[light.force < even.force[0]].max() > 1


def test_static_friction_falls_with_length_from_peak_to_steady_friction():
    known = ((0.01, 0.821505), (0.1, 0.821504), (1.0, 0.814350), (2.0, 0.782200))
    for length, friction in known:
        assert static_friction(COLD, length) == pytest.approx(friction, rel=2e-6, abs=0)
    steady = reference(COLD, Drive(1.0)).friction.value
    assert steady < static_friction(COLD, 20.0) < 1.01 * steady


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: edge_load(0.0), "coupling = 0.0"),
        (lambda: edge_load(1.0, 0), "blocks = 0"),
        (lambda: precursors(1.0, 1), "blocks = 1"),
        (lambda: precursors(1.0, 3, load=[1, 2]), "load: must be 3 numbers"),
        (lambda: precursors(1.0, 2, load=[1, -2]), "load: must be 2 numbers"),
        (lambda: static_friction(COLD, 0.0), "length = 0.0"),
        (lambda: static_friction(Ensemble(thermal=Thermal(0.1)), 1.0), "thermal.kT"),
        (lambda: static_friction(Ensemble(delay=Delay(1.0)), 1.0), "thermal.kT"),
        (lambda: static_friction(AGED_AT_ONCE, 1.0), "thermal.kT"),
        (lambda: static_friction(POOLED, 1.0), "annealed contacts is defined at"),
        (lambda: static_friction(Ensemble(Delta(), Thermal(0.0)), 1.0), "discrete"),
        (lambda: creep_velocity(0.6, 10.0, coupled=True), "stretch = 0.6"),
    ],
)  # fmt: skip
def test_what_is_refused_is_named(call, said):
    with pytest.raises(InputError, match=said):
        call()


def test_steady_creep_between_its_limits():
    known = {0.1: (5.017468e-6, 6.896277e-6), 0.3: (3.349974e-5, 2.415488e-4)}
    for x, both in known.items():
        found = [creep_velocity(x, 10.0, coupled=rigid) for rigid in (False, True)]
        assert found == pytest.approx(both, rel=2e-7, abs=0)
    warm = Ensemble(Delta(), Thermal(0.05), stiffness_law="uniform")
    bears = reference(warm, Drive(found[1])).friction
    assert bears.value == pytest.approx(0.3, rel=1e-6, abs=0)
    # breaks of a cold chain are all at about a stretch: with 32 times as many nodes
    cold = creep_velocity(0.3, 500.0, coupled=True)
    assert cold == pytest.approx(3.15150106724e-142, rel=1e-10, abs=0)
