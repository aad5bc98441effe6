"""Coupled blocks at T = 0: the response to a break, avalanches one by one, exact
numbers, run files.

Scores are compared with 4.5, p-values with 1e-4: a correct program fails one of these
tests once in some 10 000 seeds.
"""

import itertools
import json
import math
import re
from functools import partial

import numpy as np
import pandas as pd
import pytest
from command_line import call
from kernels import compiled
from scipy import special, stats
from test_slider import busy_period

from eqsim import (
    Chain,
    Delta,
    Distribution,
    Drive,
    Elastic,
    Ensemble,
    Gamma,
    Programme,
    Segment,
    Stage,
    Table,
    Thermal,
    elastic_trajectory,
    reference,
    steady,
    trajectory,
    transient,
    z_score,
)
from eqsim.engine.contacts import contacts
from eqsim.engine.elastic import expected_lives
from eqsim.engine.lanes import draw_birth
from eqsim.errors import InputError
from eqsim.io.export import meaning
from eqsim.master.avalanche_sizes import missed_by_few, size_law
from eqsim.materials import OCTAMETHYLCYCLOTETRASILOXANE, STEEL
from eqsim.numerics.streams import TRAJECTORY, key
from eqsim.workflows.run import run as run_file

UNIFORM = {"stiffness_law": "uniform"}


def interface(count, distance, elastic, **more):
    return elastic_trajectory(
        Ensemble(count=count, **UNIFORM), Drive(1.0, distance, elastic=elastic), **more
    )


def balance(elastic):
    """((K_d + n k) 1 + kappa_b L)/(n k) by adding up springs, one by one."""
    (nx, ny), B = elastic.shape, elastic.count
    matrix = (1.0 + elastic.drive_stiffness) * np.eye(B)
    for x, y in itertools.product(range(nx), range(ny)):
        for right, below in ((1, 0), (0, 1)):
            to = x + right, y + below
            if elastic.edges == "periodic":
                to = to[0] % nx, to[1] % ny
            if to[0] < nx and to[1] < ny:
                i, j = y * nx + x, to[1] * nx + to[0]
                for a, b in ((i, i), (j, j)):
                    matrix[a, b] += elastic.coupling
                for a, b in ((i, j), (j, i)):
                    matrix[a, b] -= elastic.coupling
    return matrix


LATTICES = [
    Elastic(1, 1.0, 0.3),
    Elastic(5, 0.7, 0.3),
    Elastic(6, 40.0, 0.3),
    Elastic(7, 0.7, 0.3, "periodic"),
    Elastic(4, 20.0, 0.3, "periodic"),
    Elastic(2, 1.0, 0.3, "periodic"),
    Elastic((3, 4), 0.5, 0.3),
    Elastic((4, 3), 5.0, 0.3, "periodic"),
    Elastic((1, 5), 2.0, 0.3),
]
ON_LATTICES = pytest.mark.parametrize("elastic", LATTICES, ids=str)


# ---- one avalanche after the other ----


def one_by_one(elastic, n, until):
    """Avalanches of n contacts to a block, with the explicit response, by looking at
    all contacts for every break: of those that can break in an avalanche the one of the
    greatest number. D, where it began, breaks, blocks, drop."""
    G, B = np.linalg.inv(balance(elastic)), elastic.count
    c, stream, draw = (
        contacts(Ensemble(count=B * n, **UNIFORM), 1.0),
        key(1, TRAJECTORY),
        compiled(draw_birth),
    )
    of = np.repeat(np.arange(B), n)
    xi = np.array([draw(c.newborn, c, stream, i, 0).threshold for i in range(B * n)])
    ends, lives, moved, D, found = xi.copy(), np.ones(B * n, int), np.zeros(B), 0.0, []
    share = elastic.drive_stiffness / (1.0 + elastic.drive_stiffness)
    while True:
        ahead = ends - moved[of] - share * D
        if ahead.min() > 0.0:
            i = int(np.argmin(ahead))
            D += ahead[i] / share
            if until < D:
                return [(*event[:3], len(event[3]), event[4]) for event in found]
            found.append([D, of[i], 0, set(), 0.0])
            unstable = [i]
        else:
            unstable = np.flatnonzero(ahead <= 0.0)
        i = unstable[-1]
        found[-1][2] += 1
        found[-1][3].add(of[i])
        found[-1][4] += share * xi[i] / (B * n)
        moved += G[:, of[i]] * xi[i] / n
        xi[i] = draw(c.newborn, c, stream, i, lives[i]).threshold
        ends[i] += xi[i]
        lives[i] += 1


@ON_LATTICES
def test_avalanches_one_by_one(elastic, monkeypatch):
    """In another order of breaks, with the inverse matrix. Some hundred kicks, rounded
    to 1e-14 each."""
    # the kernel is called again
    monkeypatch.setattr("eqsim.engine.avalanches._ROOM", 3)
    expected = np.array(one_by_one(elastic, 8, 15.0))
    found = interface(8 * elastic.count, 15.0, elastic, points=2).avalanches
    assert expected[:, 2].sum() > 40
    assert len(expected) == found["D"].size
    for name, column in zip(
        ("D", "block", "breaks", "blocks", "drop"), expected.T, strict=True
    ):
        np.testing.assert_allclose(
            found[name], column, rtol=0, atol=1e-11, err_msg=name
        )


@ON_LATTICES
def test_response_is_the_inverse(elastic):
    """Its sum over all blocks is rho, to the rounding of a sum of some hundred entries
    (1e-15 each); what is cut off is below 1e-12 of the middle, of each of 12 entries,
    and as much is added where it is kept."""
    G, (nx, ny) = elastic.response(), elastic.shape
    periodic, found = (
        elastic.edges == "periodic",
        np.zeros((elastic.count, elastic.count)),
    )
    around = [size if periodic or size == 1 else 2 * size for size in (nx, ny)]
    middle = [G.shape[1] // 2, G.shape[0] // 2]
    steps = [
        range(-min(m, (a - 1) // 2), min(m, a // 2) + 1)
        for m, a in zip(middle, around, strict=True)
    ]
    for x, y, dx, dy in itertools.product(range(nx), range(ny), *steps):
        to = (x + dx) % around[0], (y + dy) % around[1]
        i, j = min(to[0], 2 * nx - 1 - to[0]), min(to[1], 2 * ny - 1 - to[1])
        found[j * nx + i, y * nx + x] += G[middle[1] + dy, middle[0] + dx]
    np.testing.assert_allclose(
        found, np.linalg.inv(balance(elastic)), rtol=0, atol=2e-11
    )
    np.testing.assert_allclose(found.sum(axis=0), elastic.branching, rtol=1e-13)


@pytest.mark.parametrize("stiffness", [2.0, 0.1])
def test_one_block_is_the_slider_of_a_stage(stiffness):
    """Event by event; a thousand positions are sums of ten thresholds and a thousand
    kicks, rounded to 1e-14 each."""
    ensemble = Ensemble(count=60, **UNIFORM)
    pulled = trajectory(
        ensemble,
        Programme([Segment(1.0, distance=20.0)], stage=Stage(stiffness)),
        points=21,
    )
    found = interface(60, 20.0, Elastic(1, 3.0, stiffness), points=21)
    assert pulled.avalanches["breaks"].sum() > 500
    np.testing.assert_array_equal(
        found.avalanches["breaks"], pulled.avalanches["breaks"]
    )
    np.testing.assert_allclose(
        found.avalanches["D"], pulled.avalanches["t"], rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(
        found.avalanches["drop"], pulled.avalanches["drop"], rtol=0, atol=1e-10
    )
    np.testing.assert_allclose(found.X, pulled.X, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.force, pulled.force, rtol=0, atol=1e-10)


def test_uncoupled_blocks_are_independent_sliders():
    """Replicas of one block have the contacts of the blocks of a chain. The unit of
    positions is the same: all bits."""
    together = interface(80, 15.0, Elastic(8, 0.0, 0.2), points=11)
    alone = interface(10, 15.0, Elastic(1, 0.0, 0.2), points=11, replicas=8)
    order = np.lexsort((alone.avalanches["replica"], alone.avalanches["D"]))
    np.testing.assert_array_equal(
        together.avalanches["D"], alone.avalanches["D"][order]
    )
    np.testing.assert_array_equal(
        together.avalanches["block"], alone.avalanches["replica"][order]
    )
    np.testing.assert_array_equal(
        together.avalanches["breaks"], alone.avalanches["breaks"][order]
    )
    assert set(together.avalanches["blocks"]) == {1}
    for name in ("X", "force"):
        blocks = together.blocks[name].reshape(11, 8).T.ravel()
        np.testing.assert_array_equal(blocks, alone.blocks[name])


def test_stiff_coupling_makes_one_slider():
    """Blocks are then n k/kappa_b = 1e-9 of a force apart, which has not mixed up two
    breaks in these."""
    chain = interface(60, 15.0, Elastic(6, 1e9, 0.2), points=4)
    one = interface(60, 15.0, Elastic(1, 0.0, 0.2), points=4)
    np.testing.assert_array_equal(chain.avalanches["breaks"], one.avalanches["breaks"])
    np.testing.assert_allclose(
        chain.avalanches["D"], one.avalanches["D"], rtol=0, atol=1e-7
    )
    np.testing.assert_allclose(
        chain.blocks["X"].reshape(4, 6), one.X[:, None] * np.ones(6), rtol=0, atol=1e-7
    )
    assert chain.avalanches["blocks"].max() == 6


@ON_LATTICES
def test_forces_balance(elastic):
    """Contacts' force on every block is that of its springs: some thousand kicks
    rounded to 1e-14."""
    found = interface(20 * elastic.count, 10.0, elastic, points=7)
    X, force = (found.blocks[name].reshape(7, elastic.count) for name in ("X", "force"))
    springs = elastic.drive_stiffness * found.D[:, None] - (X @ balance(elastic) - X)
    np.testing.assert_allclose(force, springs, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.force, force.mean(axis=1), rtol=0, atol=1e-12)
    breaks = found.blocks["breaks"].reshape(7, elastic.count)
    assert (
        breaks[-1].sum()
        == found.avalanches["breaks"].sum()
        == found.lives - 20 * elastic.count
    )
    assert np.all(np.diff(X, axis=0) >= 0)


def test_the_same_bits_on_any_number_of_threads():
    elastic = Elastic((5, 4), 1.0, 0.3, "periodic")
    one, four = (
        interface(400, 10.0, elastic, points=5, replicas=5, threads=threads)
        for threads in (1, 4)
    )
    for table in ("avalanches", "blocks"):
        for name, column in getattr(one, table).items():
            np.testing.assert_array_equal(column, getattr(four, table)[name])
    assert (one.friction, one.size, one.single) == (
        four.friction,
        four.size,
        four.single,
    )
    other = interface(400, 10.0, elastic, points=5, seed=2)
    assert not np.array_equal(other.X, one.X)


def test_units():
    """Lengths in nanometres, another velocity."""
    elastic = Elastic(10, 2.0, 0.5)
    one = interface(200, 10.0, elastic, points=5)
    ensemble = Ensemble(Gamma(x_star=1e-9), count=200, stiffness=3.0, **UNIFORM)
    nano = elastic_trajectory(ensemble, Drive(0.5, 1e-8, elastic=elastic), points=5)
    for table in ("avalanches", "blocks"):
        for name, column in getattr(nano, table).items():
            factor = {"t": 2e-9, "D": 1e-9, "X": 1e-9, "force": 1e-9, "drop": 1e-9}.get(
                name, 1
            )
            np.testing.assert_allclose(
                column,
                getattr(one, table)[name] * factor,
                rtol=1e-9,
                atol=1e-12 * factor,
            )
    assert nano.friction.value == pytest.approx(
        1e-9 * one.friction.value, rel=1e-9, abs=0
    )
    assert nano.size == one.size


# ---- exact numbers ----

ROWS = [
    (1, 4000, 1.0, 0.0),
    (1, 8000, 0.25, 0.0),
    (16, 1000, 0.25, 0.0),
    (32, 1000, 0.25, 2.5),
    (32, 1000, 0.25, 5e3),
    ((6, 5), 500, 0.5, 0.5),
    pytest.param((8, 8), 1000, 0.25, 1.0, marks=pytest.mark.verification),
]


@pytest.mark.parametrize(("blocks", "n", "drive", "coupling"), ROWS)
def test_exact_numbers(blocks, n, drive, coupling):
    """Friction over displacement is steady friction, for any n; breaks per avalanche
    are 1 + n k/K_d and single breaks as many as M/G/1 says, for n -> infinity, to some
    1/n (below a third of the error here)."""
    elastic = Elastic(blocks, coupling, drive)
    found = interface(elastic.count * n, 40.0, elastic, points=2)
    level = reference(Ensemble(**UNIFORM), Drive(1.0)).friction.value
    assert abs(z_score(found.friction, level)) < 4.5
    assert abs(z_score(found.size, 1.0 + 1.0 / drive)) < 4.5
    assert abs(z_score(found.single, busy_period(elastic.branching, 1)[0])) < 4.5
    assert found.friction.stderr < 5e-3
    assert found.size.stderr < 0.03 * found.size.value


def test_friction_over_displacement_needs_no_many_contacts():
    """Ten to a block, whose avalanches are far from those of many: their mean size
    misses 1 + n k/K_d."""
    elastic = Elastic(400, 1.0, 0.2, "periodic")
    found = interface(4_000, 60.0, elastic, points=2)
    assert (
        abs(
            z_score(
                found.friction,
                reference(Ensemble(**UNIFORM), Drive(1.0)).friction.value,
            )
        )
        < 4.5
    )
    assert z_score(found.size, elastic.mean_size) < -4.5


def test_lost_redistribution_is_noticed(monkeypatch):
    """Negative control of the sum rule: a tenth of what neighbours get is lost."""
    whole = Elastic.response

    def lossy(self):
        G = whole(self)
        return np.where(G.max() == G, G, 0.9 * G)

    elastic = Elastic(64, 5.0, 0.25)
    monkeypatch.setattr(Elastic, "response", lossy)
    found = interface(64_000, 30.0, elastic, points=2)
    assert z_score(found.size, elastic.mean_size) < -6


def sizes_against(law, sizes):
    """p of chi-square of avalanche sizes against P(1), P(2), ..."""
    edges = [*range(1, 12), 14, 18, 24, 32, 44, 60]
    expected = np.array(
        [law[a - 1 : b - 1].sum() for a, b in itertools.pairwise(edges)]
    )
    expected = np.append(expected, 1.0 - expected.sum()) * sizes.size
    counts = np.histogram(sizes, [*edges, np.inf])[0]
    assert expected.min() > 5
    return stats.chi2.sf(np.sum((counts - expected) ** 2 / expected), counts.size - 1)


@pytest.mark.parametrize(
    "coupling", [0.0, 5.0, pytest.param(1e6, marks=pytest.mark.verification)]
)
def test_sizes_are_busy_periods(coupling):
    """Chi-square against M/G/1. Negative control: 5 % less load."""
    elastic = Elastic(32, coupling, 0.25)
    found = interface(64_000, 20.0, elastic, points=2).avalanches
    sizes = found["breaks"][found["D"] > 12.0]
    assert sizes_against(size_law(Gamma(), elastic.branching, 100), sizes) > 1e-4
    assert sizes_against(size_law(Gamma(), 0.95 * elastic.branching, 100), sizes) < 1e-6


@pytest.mark.parametrize("n", [50, 200])
def test_few_contacts_of_uncoupled_blocks(n):
    """Mean size 1/(1 - rho + rho/n) and single breaks of n contacts, to the first order
    in 1/n: |z| < 4.5 beyond the second order, the square of the relative change.
    Negative control for n = 50: infinitely many contacts."""
    elastic = Elastic(64, 0.0, 0.25)
    found, few = (
        interface(64 * n, 60.0, elastic, points=2, replicas=2),
        missed_by_few(Gamma(), elastic.branching, n),
    )
    single = size_law(Gamma(), elastic.branching, 1)[0]
    laws = (found.size, elastic.mean_size, few.mean), (found.single, single, few.single)
    for seen, infinite, missed in laws:
        second = missed**2 / infinite
        assert abs(seen.value - infinite - missed) < 4.5 * seen.stderr + second
        if n == 50:
            assert abs(seen.value - infinite) > 4.5 * seen.stderr


def test_discrete_laws_have_no_expected_sizes(tmp_path):
    """Equal thresholds break together: sizes are seen, and compared with nothing."""
    text = '[contacts]\ncount = 800\nstiffness_law = "uniform"\n[thresholds]\nlaw = "delta"\n'
    text += "[drive]\nvelocity = 1.0\ndistance = 20.0\n"
    text += "[elastic]\nblocks = 8\ncoupling = 1.0\ndrive_stiffness = 0.25\n[output]\npoints = 11\n"
    path = tmp_path / "delta.toml"
    path.write_text(text)
    result = run_file(path)
    averages = result.averages()
    assert averages["size"][0].value > 100.0
    assert averages["size"][1].value is averages["single"][1].value is None
    assert result.summary()["z"]["size"] is None
    assert result.files()["avalanches.png"]


def test_coupling_spreads_avalanches():
    """Blocks that take part, not sizes, carry the elastic length."""
    runs = [
        interface(6_400, 20.0, Elastic(32, coupling, 0.25), points=2)
        for coupling in (0.0, 0.5, 5.0)
    ]
    alone, near, far = (run.avalanches["blocks"].mean() for run in runs)
    assert alone == 1.0
    assert 1.3 < near < 0.8 * far
    assert [run.avalanches["blocks"].max() <= 32 for run in runs] == [True] * 3


@pytest.mark.parametrize("kT", [0.0, 0.1])
def test_replicas_that_have_met_no_break_have_errors(kT):
    """Eight replicas, of which often none meets a break: forces of 20 seeds are within
    4.5 errors of the mean of 1000 replicas, less two of its own. A break that some 1/4
    meet is missed by all with probability 0.1; errors were 0 then."""
    for count in (4, 20):
        few = Ensemble(count=count, thermal=Thermal(kT, 0.3), **UNIFORM)
        drive = Drive(0.3, 0.6, elastic=Elastic(2, 1.0, 0.5))
        known = elastic_trajectory(few, drive, points=5, replicas=1000, seed=99)
        for seed in range(20):
            found = elastic_trajectory(few, drive, points=5, replicas=8, seed=seed)
            off = np.abs(found.force - known.force) - 2.0 * known.force_stderr
            assert found.force_reliable
            assert np.all(off[1:] < 4.5 * found.force_stderr[1:])


def test_avalanches_that_were_not_met_have_errors():
    """Stiff springs, for which one avalanche in some 500 has two breaks: mean sizes and
    single breaks of 40 seeds are within 4.5 errors of those of 100 times as many. Half
    of the seeds meet single breaks only, and quoted errors of 0."""
    elastic = Elastic(4, 1.0, 300.0)
    known = interface(8, 2000.0, elastic, points=3, replicas=8, seed=77)
    for seed in range(40):
        found = interface(8, 20.0, elastic, points=3, replicas=8, seed=seed)
        for name in ("size", "single"):
            ours, exact = getattr(found, name), getattr(known, name)
            assert ours.reliable
            assert abs(ours.value - exact.value) < 4.5 * ours.stderr
            assert ours.stderr < 0.01


@pytest.mark.verification
def test_errors_are_honest():
    """Scores of 60 seeds: their squares add up to chi-square for friction; errors of
    sizes are too large, not too small, because an avalanche more in one batch is one
    less in the next."""
    elastic, scores = Elastic(32, 3.0, 0.25), []
    level, single = (
        reference(Ensemble(**UNIFORM), Drive(1.0)).friction.value,
        size_law(Gamma(), elastic.branching, 1)[0],
    )
    for seed in range(60):
        found = interface(64_000, 40.0, elastic, points=2, seed=seed)
        exact = (
            (found.friction, level),
            (found.size, elastic.mean_size),
            (found.single, single),
        )
        scores.append([z_score(estimate, value) for estimate, value in exact])
    squares = np.sum(np.square(scores), axis=0)
    assert np.all(stats.chi2.sf(squares, 60) > 1e-4)
    assert stats.chi2.cdf(squares[0], 60) > 1e-4


@pytest.mark.verification
@pytest.mark.parametrize(("n", "drive"), [(20_000, 0.05), (200_000, 0.02)])
def test_near_the_critical_load(n, drive):
    """Long power laws: mean sizes 21 and 51, cut off at 441 and 2601."""
    elastic = Elastic(10, 50.0, drive)
    found = interface(
        10 * n, 60.0 if n < 10**5 else 80.0, elastic, points=2, replicas=2, threads=2
    )
    assert abs(z_score(found.size, elastic.mean_size)) < 4.5
    assert abs(z_score(found.single, size_law(Gamma(), elastic.branching, 1)[0])) < 4.5


# ---- the law of sizes ----


@pytest.mark.parametrize("load", [0.1, 0.8, 0.99])
def test_size_law(load):
    """Equal thresholds: the Borel law. Gamma: Fourier convolution on a grid of 6e-3, to
    1e-9. Means are 1/(1 - rho)."""
    s = np.arange(1, 501)
    borel = np.exp(-load * s + (s - 1) * np.log(load * s) - special.gammaln(s + 1))
    np.testing.assert_allclose(
        size_law(Delta(3.0), load, 500), borel, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        size_law(Table([3.0, 3.0]), load, 500), borel, rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(
        size_law(Gamma(), load, 60), busy_period(load, 60), rtol=0, atol=1e-9
    )
    if load < 0.9:
        for law in (
            Gamma(0.0),
            Gamma(3.5, 1e-9),
            Table([1.0, 2.0, 2.0]),
            Distribution(stats.lognorm(0.5)),
        ):
            found = size_law(law, load, 2000)
            assert found.sum() == pytest.approx(1.0, rel=1e-9, abs=0)
            assert found @ np.arange(1, 2001) == pytest.approx(
                1.0 / (1.0 - load), rel=1e-9, abs=0
            )


@pytest.mark.parametrize(
    ("edges", "shares"),
    [([0.2, 0.6, 0.9, 1.4, 1.5], [1, 8, 1, 4]), ([0.2, 0.6, 0.9, 1.4], [5, 0, 9])],
)
def test_size_law_of_thresholds_with_kinks_and_gaps(edges, shares):
    """Single breaks of a histogram in closed form, E[exp(-t)]."""
    share = np.array(shares) / sum(shares)
    low, high = np.array(edges[:-1]), np.array(edges[1:])
    rate = 0.8 / (share @ (0.5 * (low + high)))
    falls = np.exp(-rate * low) - np.exp(-rate * high)
    law = Distribution(stats.rv_histogram((share, np.array(edges)), density=False))
    found = size_law(law, 0.8, 1)[0]
    assert found == pytest.approx(
        share @ (falls / (rate * (high - low))), rel=1e-13, abs=0
    )


@pytest.mark.parametrize(
    ("load", "most", "said"),
    [(0.0, 1, "load = 0.0"), (2.0, 1, "load = 2.0"), (0.5, 0, "most = 0")],
)
def test_size_law_refuses(load, most, said):
    with pytest.raises(InputError, match=said):
        size_law(Gamma(), load, most)


# ---- run files ----

FILE = """
[contacts]
count = 3200
stiffness_law = "uniform"
[drive]
velocity = 0.5
distance = 40.0
[elastic]
blocks = 32
coupling = 2.0
drive_stiffness = 0.5
[output]
points = 41
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "chain.toml"
    file.write_text(FILE)
    return file


@pytest.mark.parametrize(
    "blocks", ["32", pytest.param("[8,4]", marks=pytest.mark.verification)]
)
def test_run_and_replay(path, tmp_path, blocks):
    out = tmp_path / "out"
    done = call(
        "run",
        path,
        "--out",
        out,
        "--json",
        "--set",
        f"elastic.blocks={blocks}",
        "--threads",
        "1",
    )
    assert done.exit_code == 0, done.output
    summary = json.loads(done.stdout)
    found = interface(
        3200, 40.0, Elastic(32 if blocks == "32" else (8, 4), 2.0, 0.5), points=41
    )
    few = missed_by_few(Gamma(), 2.0 / 3.0, 100)
    for name, value, missed in (
        ("friction", found.friction, 0.0), ("size", found.size, few.mean), ("single", found.single, few.single)
    ):  # fmt: skip
        assert summary[name] == value.as_dict()
        reference = summary["reference"][name]
        assert summary["z"][name] == pytest.approx(
            z_score(value, reference, missed), rel=1e-6, abs=0
        )
    assert summary["reference"]["size"] == 3.0
    assert summary["avalanches"] == found.avalanches["breaks"].size
    trajectories, avalanches, blocks = (
        pd.read_parquet(out / f"{name}.parquet")
        for name in ("trajectory", "avalanches", "blocks")
    )
    assert list(trajectories) == ["t", "D", "X", "force", "force_stderr"]
    assert list(avalanches) == [
        "t",
        "D",
        "block",
        "breaks",
        "blocks",
        "drop",
        "replica",
    ]
    assert list(blocks) == ["t", "D", "block", "X", "force", "breaks", "replica"]
    assert all(map(meaning, [*avalanches, *blocks]))
    late = avalanches[avalanches["D"] > 20.0]["block"]
    starts = late.value_counts().reindex(range(32), fill_value=0)
    shown = summary["starts"]
    assert (shown["most"], starts[shown["block"]]) == (starts.max(), starts.max())
    assert shown["mean"] == pytest.approx(late.size / 32, rel=1e-12, abs=0)
    assert shown["std"] == pytest.approx(starts.std(ddof=0), rel=1e-12, abs=0)
    assert len(blocks) == 32 * 41
    np.testing.assert_allclose(trajectories["t"], 2.0 * trajectories["D"], rtol=1e-14)
    np.testing.assert_allclose(avalanches["t"], 2.0 * avalanches["D"], rtol=1e-14)
    np.testing.assert_allclose(
        blocks.groupby("D")["force"].mean(), trajectories["force"], rtol=0, atol=1e-12
    )
    for name in ("force", "avalanches", "fronts"):
        assert (out / f"{name}.png").stat().st_size > 20_000
    for name in ("trajectory", "avalanches", "blocks"):
        again = call("replay", out / f"{name}.parquet", "--threads", "1")
        assert again.exit_code == 0, again.output


def test_table_and_replicas(path, tmp_path):
    done = call(
        "run",
        path,
        "--out",
        tmp_path / "out",
        "--set",
        "output.replicas=2",
        "--set",
        "drive.distance=3",
    )
    assert done.exit_code == 0, done.output
    assert "breaks per avalanche" in done.output
    assert "unreliable" in done.output
    table = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")
    scatter = table["force_replica_std"] / math.sqrt(2)
    assert np.all(table["force_stderr"] >= scatter * (1.0 - 1e-12))
    # the break of one contact changes less but at the start; a root and a quotient are
    # rounded by 1e-16 each
    assert np.isclose(table["force_stderr"], scatter, rtol=1e-12, atol=0).mean() > 0.5
    assert np.all(table["force_stderr"][1:] > 0.0)


@pytest.mark.verification
def test_nothing_breaks(path, tmp_path):
    nothing = call(
        "run",
        path,
        "--out",
        tmp_path / "nothing",
        "--set",
        "elastic.blocks=[8,4]",
        "--set",
        "drive.distance=0.001",
    )
    assert nothing.exit_code == 0, nothing.output
    assert "none seen" in nothing.output
    assert pd.read_parquet(tmp_path / "nothing" / "avalanches.parquet").empty


def test_info(path):
    done = call("info", path, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert (
        found["blocks"],
        found["n"],
        found["kappa_b/(n k)"],
        found["K_d/(n k)"],
    ) == ("32", 100, 2.0, 0.5)
    assert math.cosh(1.0 / found["lambda"]) == pytest.approx(
        1.0 + 1.5 / 4.0, rel=1e-12, abs=0
    )
    assert (found["rho"], found["mean size"]) == pytest.approx(
        (1.0 / 1.5, 3.0), rel=1e-12, abs=0
    )
    assert found["cutoff size"] == pytest.approx(9.0, rel=1e-12, abs=0)


@pytest.mark.verification
def test_sweep(path, tmp_path):
    path.write_text(FILE + '[sweep]\n"elastic.coupling" = [0.0, 2.0]\n')
    done = call("sweep", path, "--out", tmp_path / "out", "--workers", "1")
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(tmp_path / "out" / "sweep.parquet")
    assert table["elastic.coupling"].tolist() == [0.0, 2.0]
    assert set(table["status"]) == {"ok"}
    # n = 100 is not infinite
    assert table[["friction_z", "size_z", "single_z"]].abs().to_numpy().max() < 5.5
    assert set(table["size_reference"]) == {3.0}
    assert (
        call("replay", tmp_path / "out" / "sweep.parquet", "--threads", "1").exit_code
        == 0
    )


def test_sweeps_of_sheets_are_refused(path, tmp_path):
    path.write_text(
        FILE.replace("blocks = 32", "blocks = [8, 4]")
        + '[sweep]\n"elastic.coupling" = [0.0, 2.0]\n'
    )
    refused = call("sweep", path, "--out", tmp_path / "sheet", "--workers", "1")
    assert refused.exit_code == 2
    assert (
        "elastic.blocks = [8, 4]: a sweep has a column for chains only"
        in refused.stderr
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("elastic.blocks=0", "elastic.blocks = 0: must be an integer from 1"),
        (
            "elastic.blocks=[2,3,4]",
            "elastic.blocks = [2, 3, 4]: must be a number of blocks, or two",
        ),
        ("elastic.blocks=[4000,4000]", "elastic.blocks = 16000000: must be an integer"),
        (
            "elastic.blocks=33",
            "contacts.count = 3200: must be a multiple of the 33 blocks of [elastic]",
        ),
        (
            "elastic.coupling=-1.0",
            "elastic.coupling = -1.0: must be a finite number >= 0",
        ),
        (
            "elastic.drive_stiffness=0.0",
            "elastic.drive_stiffness = 0.0: must be a finite number >= 1e-06",
        ),
        (
            "elastic.edges=closed",
            'elastic.edges = \'closed\': must be one of "open", "periodic"',
        ),
        ("elastic.block=3", 'elastic.block: unknown key; did you mean "blocks"?'),
        ("delay.time=1.0", "delay.time = 1.0: must be 0 with [elastic]"),
        (
            "newborn={law='exponential',mean=0.2}",
            'newborn.law = "exponential": must be "unstressed" with [elastic]',
        ),
        ("viscosity.eta=1.0", "viscosity.eta = 1.0: must be 0 with [elastic]"),
        (
            "contacts.stiffness_law=sqrt",
            'contacts.stiffness_law = "sqrt": must be "uniform" with [elastic]',
        ),
        (
            "drive.start=stationary",
            'drive.start = "stationary": must be "fresh" with [elastic]',
        ),
        ("drive.stage.stiffness=0.1", "drive.elastic: not with a stage"),
        ("drive.stall_force=0.1", "drive.elastic: not with a stage"),
        (
            "output.points=1000000",
            "output.points = 1000000: records of all blocks and replicas",
        ),
        ("drive.distance=1e300", "distance = 1e+300: must be"),
        ("contacts.count=320000000", "avalanches, more than 3e+07"),
        ("contacts.count=32000000000", "more than --max-lives"),
    ],
)
def test_refused(path, tmp_path, change, said):
    done = call("run", path, "--out", tmp_path / "out", "--set", change)
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "command",
    [
        ["steady"],
        ["reference"],
        ["reference", "--transient"],
        ["reference", "--closure"],
        ["stability"],
    ],
)
def test_commands_for_a_rigid_slider_refuse(path, command):
    done = call(*command[:1], path, *command[1:])
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1


def test_python_refuses():
    ensemble, drive = (
        Ensemble(count=10, **UNIFORM),
        Drive(1.0, 1.0, elastic=Elastic(2, 1.0, 1.0)),
    )
    for solve in (steady, reference, trajectory, transient):
        with pytest.raises(InputError, match="elastic: coupled blocks"):
            solve(ensemble, drive)
    for take in (partial(Drive, 1.0), partial(Programme, [Segment(1.0, time=1.0)])):
        with pytest.raises(InputError, match=r"elastic = Chain.*Programme\(chain"):
            take(elastic=Chain(2, 1.0, 1.0, damping=1.0))
    with pytest.raises(InputError, match=r"drive\.elastic: is required"):
        elastic_trajectory(ensemble, Drive(1.0, 1.0))
    with pytest.raises(InputError, match="max_lives"):
        elastic_trajectory(ensemble, drive, max_lives=1.0)
    with pytest.raises(InputError, match="avalanches"):
        elastic_trajectory(
            Ensemble(count=10**7, **UNIFORM),
            Drive(1.0, 100.0, elastic=Elastic(2, 1.0, 1.0)),
        )


def held(distance, time, elastic):
    """A drive of blocks that ends with a hold."""
    segments = [Segment(1.0, distance=distance), Segment(time=time)]
    return Programme(segments, elastic=elastic)


def test_friction_in_a_hold_is_known_from_replicas():
    """Batches of a plate that stands are no independent ones: the error is that of the
    force at the end, to the motion in a hundredth of an attempt."""
    warm = Ensemble(count=200, thermal=Thermal(0.05), **UNIFORM)
    drive = held(20.0, 0.01, Elastic(4, 1.0, 1.0))
    run = elastic_trajectory(warm, drive, points=21, replicas=8)
    assert run.friction.dof == 7
    assert run.friction.stderr == pytest.approx(run.force_stderr[-1], rel=0.05, abs=0)


def test_lives_in_holds_are_counted():
    """Blocks that weak springs keep pulling on break more contacts than predicted."""
    warm = Ensemble(count=200, thermal=Thermal(0.1), **UNIFORM)
    drive = held(700.0, 1e7, Elastic(1, 0.0, 1e-3))
    expected = expected_lives(warm, drive)
    with pytest.raises(InputError, match=re.escape(f"{expected:.3g} were expected")):
        elastic_trajectory(warm, drive, points=21, max_lives=1.001 * expected)


def test_workers_are_refused(path, tmp_path):
    done = call("run", path, "--out", tmp_path / "out", "--workers", "2")
    assert done.exit_code == 2
    assert "coupled blocks are simulated in one process" in done.stderr


# ---- materials ----


def test_elastic_length_of_materials():
    """lambda_c = a^2 E/k with k = (3 pi/4) E a is 4 a/(3 pi), whatever E is."""
    assert STEEL.elastic_length / STEEL.contact_radius == pytest.approx(
        4.0 / (3.0 * math.pi), rel=1e-14, abs=0
    )
    assert OCTAMETHYLCYCLOTETRASILOXANE.elastic_length is None
    assert (
        "a^2 E/k = 0.42 a: the rigid slider is doubtful already between neighbours"
        in " ".join(call("material", "steel").stdout.replace("│", " ").split())
    )
    assert (
        "E of the walls is not given"
        in call("material", "octamethylcyclotetrasiloxane").stdout
    )


@pytest.mark.parametrize("kT", [0.0, 0.1])
def test_averages_do_not_depend_on_records(kT):
    """The second half itself tells whether the start is forgotten, however few records
    there are; values agree to rounding."""
    ensemble = Ensemble(thermal=Thermal(kT), count=400, stiffness_law="uniform")
    chain = Elastic(blocks=20, coupling=1.0, drive_stiffness=0.5)
    for distance in (3.0, 10.0):
        drive = Drive(1.0, distance=distance, elastic=chain)
        few, many = (
            elastic_trajectory(ensemble, drive, points=points, replicas=8)
            for points in (2, 101)
        )
        assert few.friction.reliable == many.friction.reliable
        assert few.size.reliable == many.size.reliable
        assert few.friction.value == pytest.approx(
            many.friction.value, rel=1e-12, abs=0
        )
