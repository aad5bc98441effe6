"""What lives leave on the output grid and in the batch sums, routine by routine,
against plain sums over lives."""

import math

import numpy as np
import pytest
from kernels import compiled

from eqsim import Aging, Delay, Ensemble, Thermal
from eqsim.engine import recorder, segments
from eqsim.engine.blocks import Totals
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import ROUNDS, idle_lanes
from eqsim.engine.recorder import (
    Deposit,
    Ramp,
    Recorder,
    Run,
    Scales,
    Window,
    edge_after,
    moments,
)
from eqsim.engine.segments import Span
from eqsim.engine.stationary import Fresh, extremes
from eqsim.laws.aging.base import growth
from eqsim.laws.stiffness import kappa
from eqsim.numerics.streams import key

leave, leave_ramp, average = (
    compiled(recorder.leave),
    compiled(recorder.leave_ramp),
    compiled(recorder.average),
)
leave_ramps, join_ramps = compiled(recorder.leave_ramps), compiled(recorder.join_ramps)
leave_span = compiled(segments.leave_span)
cross_edges = compiled(segments.cross_edges)

# fixed point: 1e-12, of numbers up to some hundred and thousand
CONTACTS, DISTANCE, UNIT = (40, 10.0, 2.0**40)
ROUNDING = 1e-9  # of sums of a few hundred of them, and of squares that cancel
UNSTRESSED = contacts(Ensemble(), 1.0)


def scales(uniform):
    return Scales(
        Deposit(1.0, *[UNIT] * 5),
        Window(UNIT, UNIT, UNIT, 1.0, UNIT, UNIT),
        1.0,
        1.0,
        uniform,
    )


def empty(run, uniform=False, size=4):
    """A recorder of nothing yet, of up to `size` lives at once."""
    total = Totals(run.points + 1, run.points, 1)
    found = Recorder.of(UNSTRESSED, run, scales(uniform), Fresh(), total)
    return found._replace(points=np.zeros((2, size), np.int64))


def lives(uniform, delayed, early=0.0):
    """Stiffness, birth, break and birth of the next one, one row a life of some
    contact, over more than the distance; the first ones are born up to `early` before
    it. One is too short to be seen, and some end on a grid point."""
    rng, rows = (
        np.random.default_rng(5),
        [(1.0, 4.31, 4.32, 4.32), (1.0, 2.5, 5.0, 5.0)],
    )
    for _ in range(CONTACTS):
        born = -early * rng.random()
        while born <= DISTANCE:
            broke = born + rng.gamma(3.0, 0.4)
            reborn = broke + delayed * rng.exponential(0.7)
            rows.append(
                (1.0 if uniform else rng.uniform(0.2, 3.0), born, broke, reborn)
            )
            born = reborn
    return np.array(rows)


def seen(rows, run, force=None):
    """Sums over contacts of force, pinned and squared force at each grid point."""
    X = np.linspace(0.0, run.distance, run.points)[:, None]
    stiffness, born, broke, _ = rows.T
    pinned = (born <= X) & (broke > X)
    each = np.where(
        pinned, stiffness * (X - born) if force is None else force(X - born), 0.0
    )
    return each.sum(axis=1), pinned.sum(axis=1), (each**2).sum(axis=1)


def compare(found, uniform, expected):
    """Of `moments` of one contact that does all: sums, and sums of squares less the
    square of the sum."""
    run, deposits = found.run, found.deposits
    force, pinned, variance, _ = moments(deposits, scales(uniform), run, 1, 0.0)
    np.testing.assert_allclose(force, expected[0], rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_array_equal(pinned, expected[1])
    # few contacts have a smaller sum of squares than the square of their sum: compare
    # what was added up
    units = scales(uniform).deposits._asdict()
    total = Deposit(
        *(np.cumsum(deposits[name][:-1]) / unit for name, unit in units.items())
    )
    X = np.linspace(0.0, run.distance, run.points)
    slope2, ramp2 = (
        (total.count, total.force) if uniform else (total.slope2, total.ramp2)
    )
    np.testing.assert_allclose(
        (slope2 * X + 2 * ramp2) * X + total.square,
        expected[2],
        rtol=ROUNDING,
        atol=1e-8,
    )
    np.testing.assert_allclose(
        variance, np.maximum(expected[2] - expected[0] ** 2, 0.0), rtol=1e-7, atol=1e-6
    )


@pytest.mark.parametrize("count", [1, 1000, 10**9])
@pytest.mark.parametrize(
    "thermal", [Thermal(), Thermal(0.1), Thermal(0.1, 1.0, "stiff")]
)
def test_no_sum_can_overflow(count, thermal):
    """If all contacts were the strongest there can be, and lived the longest life, no
    sum would reach 2^63; and no unit but that of counts is finer than it has to be by
    more than rounding down to a power of 2 can make it."""
    c = contacts(Ensemble(thermal=thermal), 0.1)
    run = Run(DISTANCE, 2, stationary=True)
    xi, x = extremes(c)
    found, strong, reach = (
        Scales.of(c, run, count, 3, 5.0),
        kappa(c.springs, xi),
        DISTANCE + x,
    )
    deposits = np.array(
        [
            1.0,
            strong * reach,
            (strong * reach) ** 2,
            strong,
            strong**2,
            strong**2 * reach,
        ]
    )
    windows = np.array([strong * x * reach, reach, reach, 1.0, reach, reach])
    most = max(strong * x, 5.0)
    for sums in (
        count * deposits * np.array(found.deposits),
        count * windows * np.array(found.windows),
        np.array([1, 3 * most * found.replica, 3 * most**2 * found.replica_square]),
    ):
        sizes = np.log2(sums)
        assert np.all(sizes < 63)
        assert np.sum(sizes > 60.9) >= sizes.size - 1


@pytest.mark.parametrize("points", [2, 5, 101])
@pytest.mark.parametrize("early", [0.0, 2.0])
def test_single_deposits(points, early):
    run, rows = Run(DISTANCE, points), lives(False, True, early)
    found = empty(run)
    for stiffness, born, broke, _ in rows:
        leave_ramp(found, Ramp(stiffness, born, born, broke))
    compare(found, False, seen(rows, run))


def columns(rows):
    """The columns of `lives`, with a life beyond the distance."""
    beyond = [1.0, 2 * DISTANCE, 2 * DISTANCE, 2 * DISTANCE]
    return np.ascontiguousarray(np.vstack([rows, beyond]).T)


@pytest.mark.parametrize("points", [2, 5, 101])
@pytest.mark.parametrize("uniform", [False, True])
def test_deposits_side_by_side(points, uniform):
    run, rows = Run(DISTANCE, points), lives(uniform, True)
    stiffness, born, broke, _ = columns(rows)
    found = empty(run, uniform, born.size)
    leave_ramps(found, born, broke, stiffness, uniform)
    compare(found, uniform, seen(rows, run))


@pytest.mark.parametrize("points", [2, 5, 101])
def test_deposits_that_join(points):
    """Without delay, from the first birth of each contact on."""
    run, rows = Run(DISTANCE, points), lives(True, False)[2:]
    _, born, broke, _ = columns(rows)
    found = empty(run, True, born.size)
    for _ in range(CONTACTS):
        leave(found, 0, 1, 1.0, 0.0)
    join_ramps(found, born, broke)
    compare(found, True, seen(rows, run))


def averages(rows, low, high, work=None):
    """Area, pinned, elapsed, breaks, stretch and travel of lives between two
    displacements."""
    stiffness, born, broke, reborn = rows.T
    start, end, later = (
        np.maximum(born, low),
        np.clip(broke, low, high),
        np.clip(reborn, low, high),
    )
    end = np.maximum(end, start)
    if work is None:
        area = 0.5 * stiffness * ((end - born) ** 2 - (start - born) ** 2)
    else:
        area = work(end - born) - work(start - born)
    breaks = (low < broke) & (broke <= high)
    return np.array([
        np.where(start < end, area, 0.0).sum(), (end - start).sum(), np.maximum(later - start, 0.0).sum(), breaks.sum(),
        *[(broke - born)[breaks].sum()] * 2,
    ])  # fmt: skip


def in_window(found, batch, quarter):
    """What a batch has left in a quarter, in the order of `averages`."""
    return [
        found.windows[batch, quarter][name] / scale
        for name, scale in found.window_scales._asdict().items()
    ]


def test_records_of_quarters():
    """Of both quarters of the second half, batch by batch."""
    run, rows = Run(DISTANCE, 2), lives(False, True, 2.0)
    found = empty(run)
    for i, row in enumerate(rows):
        stiffness, born, broke, reborn = row
        average(found, i % 3, Ramp(stiffness, born, born, broke), reborn)
    for batch in range(3):
        for quarter, low in enumerate((5.0, 7.5)):
            sums = in_window(found, batch, quarter)
            np.testing.assert_allclose(
                sums,
                averages(rows[batch::3], low, low + 2.5),
                rtol=ROUNDING,
                atol=ROUNDING,
            )


def test_edges():
    run = Run(DISTANCE, 2)
    edges = {
        0.0: 5.0,
        5.0: 5.0,
        5.1: 7.5,
        7.5: 7.5,
        7.6: 10.0,
        10.0: 10.0,
        10.1: math.inf,
    }
    assert {x: compiled(edge_after)(run, x) for x in edges} == edges
    assert compiled(edge_after)(run._replace(averages=False), 5.0) == DISTANCE


@pytest.mark.parametrize("delay", [0.0, 0.2])
@pytest.mark.parametrize("edge", [5.0, 7.5, 10.0])
def test_crossing_an_edge(edge, delay):
    """What was gathered since the last edge goes to the quarter before this one, if it
    is one of the second half; the life that crosses it is divided, and gathering begins
    anew. Without delay a contact is pinned all the time."""
    c = contacts(Ensemble(delay=Delay(delay)), 1.0)
    found = empty(Run(DISTANCE, 2))._replace(laws=c)
    (lanes, lives), averaging, age = idle_lanes(c, key(0, 0)), found.averaging, 3
    crossing = (1.5, edge - 0.4, edge + 0.3, edge + 0.3 + delay)
    stiffness, born, broke, reborn = crossing
    x = broke - born
    lanes.contact[0], lanes.age[0], lanes.position[0] = 1, age, born
    lives.travel[0, 0], lives.stiffness[0, 0] = x, stiffness
    averaging.edge[0], averaging.broke[0], averaging.reborn[0] = edge, broke, reborn
    averaging.since[0], averaging.lives[0] = born - 2.0, ROUNDS * age - 4
    averaging.pinned[0], averaging.work[0] = 1.5 + x, 3.25 + 0.5 * stiffness * x**2
    ended = edge == DISTANCE
    assert cross_edges(found, lanes, lives, 0, 1) == ended
    assert not found.windows[0].view(np.int64).any()
    pinned = 1.5 if delay else 2.0
    for quarter, low in enumerate((5.0, 7.5)):
        expected = averages(np.array([crossing]), low, low + 2.5)
        if low + 2.5 == edge:
            expected += [3.25, pinned, 2.0, 4, pinned, pinned]
        np.testing.assert_allclose(
            in_window(found, 1, quarter), expected, rtol=ROUNDING, atol=ROUNDING
        )
    goes_on = math.inf if ended else reborn
    assert (averaging.edge[0], averaging.since[0]) == (
        edge_after(found.run, goes_on),
        goes_on,
    )
    assert averaging.reborn[0] == goes_on
    assert (averaging.lives[0], averaging.work[0], averaging.pinned[0]) == (
        ROUNDS * age + 1,
        0.0,
        0.0,
    )
    assert found.lives[0] == 5


@pytest.mark.parametrize("points", [2, 5, 101])
def test_forces_that_are_no_ramps(points):
    """A stiffness that follows the threshold along `flow`: its force at each point, its
    square, and its work in both quarters (to the 1e-8 of the table of work)."""
    c = contacts(Ensemble(aging=Aging("flow", 0.3, 3.0)), 1.0)
    run, rows = Run(DISTANCE, points), lives(False, True, 2.0)
    found = empty(run)._replace(laws=c)
    for stiffness, born, broke, _ in rows:
        span = Span(stiffness, 0.0, 0.0, born, broke - born)
        assert leave_span(found, 0, span) == 0.0  # no work is left
    stiffness = rows[:, 0]
    grown = np.vectorize(lambda x: growth(c.aging, max(x, 0.0)))
    compare(found, False, seen(rows, run, lambda x: stiffness * grown(x) * x))
    x = np.linspace(0.0, 15.0, 30_001)
    work = np.append(
        0.0, np.cumsum(0.5 * np.diff(x) * (lambda f: f[1:] + f[:-1])(grown(x) * x))
    )
    for quarter, low in enumerate((5.0, 7.5)):
        area = averages(
            rows, low, low + 2.5, lambda y: stiffness * np.interp(y, x, work)
        )[0]
        assert found.windows[0, quarter]["area"] / UNIT == pytest.approx(
            area, rel=1e-6, abs=0
        )
