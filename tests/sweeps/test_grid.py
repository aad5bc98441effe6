"""The points of a sweep: axes, what a point's identity depends on, and what is refused."""

import hashlib
import tomllib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eqsim.errors import InputError
from eqsim.io.runfile import check
from eqsim.sweeps import plan as module
from eqsim.sweeps.plan import Plan, seed_of

BASE = 'title = "small"\n[contacts]\ncount = 500\nstiffness_law = "uniform"\n[drive]\nvelocity = 0.1\ndistance = 5.0\n'


def file_of(text, folder=Path()):
    return check(tomllib.loads(text), folder)


def plan_of(text, folder=Path()):
    return Plan(file_of(text, folder))


def grid(table, base=BASE, folder=Path()):
    plan = plan_of(f"{base}[sweep]\n{table}\n", folder)
    return [plan.changes(index) for index in range(plan.size)]


def test_sheets_are_refused_before_anything_is_computed():
    base = f"{BASE}[elastic]\nblocks = 4\ncoupling = 1\ndrive_stiffness = 1\n"
    with pytest.raises(InputError, match=r"point 2 of 2: elastic.blocks = \[2, 2\]: a"):
        grid('"elastic.blocks" = [4, [2, 2]]', base)


def test_keys_of_blocks_may_stand_in_the_interface(tmp_path):
    base = f"{BASE}[elastic]\nblocks = 4\ncoupling = 1\ndrive_stiffness = 1\n"
    points = [{"elastic.blocks": 4, "elastic.coupling": 2.0}]
    axes = "interface.blocks = [4]", "interface.coupling = [2.0]"
    quoted = ['"{}" ={}'.format(*axis.split(" =")) for axis in axes]
    for one, other in (axes, quoted):
        assert grid(f"{one}\n{other}", base) == points
        assert grid(f"zip = [{{ {one}, {other} }}]", base) == points
        assert grid(f"zip = {{ {one}, {other} }}", base) == points
    file = file_of(base).with_changes({"interface.coupling": 3.0})
    assert file["elastic.coupling"] == 3.0
    pq.write_table(pa.table({"interface.coupling": [2.0]}), tmp_path / "p.parquet")
    assert grid('file = "p.parquet"', base, tmp_path) == [{"elastic.coupling": 2.0}]


def test_axes_and_their_product():
    assert grid('"thermal.kT" = [0.1, 1]\n"delay.law" = ["fixed", "exponential"]') == [
        {"thermal.kT": 0.1, "delay.law": "fixed"},
        {"thermal.kT": 0.1, "delay.law": "exponential"},
        {"thermal.kT": 1, "delay.law": "fixed"},
        {"thermal.kT": 1, "delay.law": "exponential"},
    ]
    log = [
        point["drive.velocity"]
        for point in grid("drive.velocity = { log = [1e-3, 1e2, 6] }")
    ]
    # to the last bit, whatever made the powers
    assert log == [0.001, 0.01, 0.1, 1.0, 10.0, 100.0]
    assert [p["delay.time"] for p in grid('"delay.time" = { linear = [0, 1, 5] }')] == [
        0,
        0.25,
        0.5,
        0.75,
        1,
    ]
    assert [
        p["contacts.count"] for p in grid('"contacts.count" = { log = [10, 1000, 5] }')
    ] == [10, 32, 100, 316, 1000]
    assert [p["disorder"] for p in grid('disorder = ["quenched", "annealed"]')] == [
        "quenched",
        "annealed",
    ]


def test_inner_values_of_an_axis_have_twelve_digits():
    """Rounded to half a unit of the twelfth, that is by up to 5e-12 of themselves; ends
    are as they were written."""
    log = [
        point["drive.velocity"]
        for point in grid("drive.velocity = { log = [0.0123456789012345, 1e2, 8] }")
    ]
    linear = [
        point["delay.time"]
        for point in grid('"delay.time" = { linear = [0.1, 1.23456789012345, 8] }')
    ]
    share = np.arange(8) / 7
    exact = 0.0123456789012345 * (1e2 / 0.0123456789012345) ** share
    np.testing.assert_allclose(log, exact, rtol=5.1e-12)
    np.testing.assert_allclose(linear, 0.1 + share * 1.13456789012345, rtol=5.1e-12)
    assert (log[0], linear[-1]) == (0.0123456789012345, 1.23456789012345)
    assert all(value == float(f"{value:.12g}") for value in (*log[1:-1], *linear[1:-1]))


def test_zipped_axes_advance_together():
    text = 'zip = [{ "drive.velocity" = { log = [0.1, 10, 3] }, "thermal.kT" = [1, 2, 3] }]\n"delay.time" = [0, 1]'
    assert [tuple(point.values()) for point in grid(text)] == [
        (0.1, 1, 0), (0.1, 1, 1), (1.0, 2, 0), (1.0, 2, 1), (10, 3, 0), (10, 3, 1),
    ]  # fmt: skip


def test_points_file(tmp_path):
    columns = {
        "thresholds.law": ["gamma", "delta"],
        "thresholds.n": [2.0, None],
        "contacts.count": [5, 6],
    }
    pq.write_table(pa.table(columns), tmp_path / "points.parquet")
    points = grid('file = "points.parquet"', folder=tmp_path)
    assert points == [
        {"thresholds.law": "gamma", "thresholds.n": 2.0, "contacts.count": 5},
        {"thresholds.law": "delta", "contacts.count": 6},
    ]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('"drive.velocty" = [1]', 'sweep.drive.velocty.*did you mean "drive.velocity"'),
        ("velocity = [1]", 'sweep.velocity.*did you mean "drive.velocity"'),
        ('title = ["a"]', "sweep.title"),
        ('"thermal.kT" = 0.1', r"sweep.thermal.kT = 0.1: must be a list"),
        ('"thermal.kT" = []', "sweep.thermal.kT = .*must be a list"),
        ('"thermal.kT" = { log = [0.0, 1.0, 3] }', r"sweep.thermal.kT.log = 0.0: .*> 0"),
        ('"thermal.kT" = { log = [1.0, 2.0] }', r"must be \[first, last, count\]"),
        ('"thermal.kT" = { linear = [1.0, 2.0, 2.5] }', r"thermal.kT.linear, count = 2.5: must be an integer from 2"),
        ('"thermal.kT" = { linear = [1.0, 2.0, inf] }', r"thermal.kT.linear, count = inf: must be an integer from 2"),
        ('"thermal.kT" = { linear = [1.0, "a", 3] }', "thermal.kT.linear = 'a': must be a finite number"),
        ('"thermal.barrier" = { linear = [1.0, 2.0, 3] }', "holds text"),
        ('"thermal.kT" = [0.1, "hot"]', r"sweep, point 2 of 2: thermal.kT = 'hot': must be a valid number"),
        ('"thermal.kT" = [0.1, -1]', r"sweep, point 2 of 2: thermal.kT = -1.0: must be a finite number >= 0"),
        ('"thermal.barrier" = ["soft", "hard"]', r"point 2 of 2: thermal.barrier = 'hard': must be one of"),
        ('"thermal.kT" = [0.1, 0.1]', r"points 1 and 2 are the same \(thermal.kT = 0.1\)"),
        ('zip = [{ "thermal.kT" = [1, 2], "delay.time" = [1] }]', "equal lengths; found thermal.kT 2, delay.time 1"),
        ('zip = [{ "thermal.kT" = [1, 2] }]\n"thermal.kT" = [3]', "sweep.thermal.kT: is in two axes"),
        ("zip = [3]", "sweep.zip: must be tables"),
        ('file = "absent.parquet"', "absent.parquet: is not a file; must be a Parquet file"),
        ('"thermal.kT" = { linear = [0, 1, 100000] }\n"delay.time" = { linear = [0, 1, 100] }', "at most 1000000"),
        ("", r"needs a \[sweep\] table"),
    ],
)  # fmt: skip
def test_bad_sweeps_are_refused_by_name(table, said):
    with pytest.raises(InputError, match=said):
        grid(table)


# ---- identity ----


def test_identity_depends_on_what_a_value_depends_on(monkeypatch):
    def ids(text):
        return plan_of(text).ids

    swept = BASE + '[sweep]\n"thermal.kT" = [0.1, 1.0]\n'
    ids_ = ids(swept)
    assert ids_ == ids(swept.replace("small", "other title"))
    # neither order nor 1 for 1.0
    assert ids_[::-1] == ids(swept.replace("[0.1, 1.0]", "[1, 0.1]"))
    # nor the rest of the grid
    assert ids_[0] in ids(swept.replace("[0.1, 1.0]", "[0.1, 2.0, 3.0]"))
    assert ids_ == ids(
        BASE
        + "[thresholds]\nn = 1.0\nx_star = 1\n"
        + '[sweep]\n"thermal.kT" = [0.1, 1.0]\n'
    )
    seeds = ids(BASE + '[sweep]\n"thermal.kT" = [0.1]\n"output.seed" = [1, 2]\n')
    assert seeds[0] == ids_[0]
    assert seeds[1] not in ids_
    assert not set(ids_) & set(ids(swept.replace("count = 500", "count = 501")))
    monkeypatch.setattr(module, "RESULTS_VERSION", module.RESULTS_VERSION + 1)
    assert not set(ids_) & set(ids(swept))
    assert all(0 <= seed_of(i) < 2**63 for i in ("f" * 64, "0" * 64, *ids_))


STEP = "[drive]\nprogramme = [{ velocity = 0.1, distance = 1.0 }]\n"


def test_a_velocity_that_a_point_does_not_use_is_refused():
    """An axis of it would look as if values depended on it: only seeds differ."""
    axis = '"drive.velocity" = [0.1, 1.0]'
    for start in ("", 'start = "fresh"\n'):
        with pytest.raises(
            InputError, match=r"point 1 of 2: drive.velocity = 0.1: not"
        ):
            grid(axis, STEP + start)
    assert len(grid(axis, STEP + 'start = "stationary"\n')) == 2
    starts = '"drive.start" = ["fresh", "stationary"]'
    assert len(grid(starts, STEP + "velocity = 0.1\n")) == 2
    with pytest.raises(InputError, match=r"point 1 of 4: drive.velocity = 0.1: not"):
        grid(f"{axis}\n{starts}", STEP)


def test_seeds_of_points_differ():
    """They have 63 bits: two of 3e5 points share one with probability 5e-9, and with 31
    bits a score would."""
    ids = [
        hashlib.sha256(str(number).encode()).hexdigest() for number in range(300_000)
    ]
    seeds = np.array([seed_of(point_id) for point_id in ids])
    assert np.unique(seeds).size == seeds.size
    # the control: some 21 are expected to be the same
    assert np.unique(seeds % 2**31).size < seeds.size - 5
    assert seed_of("f" * 64) == 2**63 - 1


def test_a_table_of_thresholds_enters_with_its_values(tmp_path):
    text = '[thresholds]\nlaw = "table"\nfile = "x.csv"\n[drive]\nvelocity = 1.0\n[sweep]\n"thermal.kT" = [0.1]\n'
    path = tmp_path / "x.csv"
    path.write_text("threshold\n1.0\n2.0\n")
    before = plan_of(text, tmp_path).ids
    path.rename(tmp_path / "y.csv")
    assert plan_of(text.replace("x.csv", "y.csv"), tmp_path).ids == before
    path.write_text("threshold\n1.0\n2.5\n")
    assert plan_of(text, tmp_path).ids != before


def test_a_table_of_a_population_enters_with_its_values(tmp_path):
    """Its name and its column do not; else a sweep over files would go on with the rows
    of those that have changed."""
    kind = "[[population]]\nshare = 1\nstiffness = 1.0\n"
    table = '[population.thresholds]\nlaw = "table"\nfile = "x.csv"\n'
    axis = '[sweep]\n"population.1.thresholds.file" = ["x.csv", "y.csv"]\n'
    text = "[drive]\nvelocity = 1.0\n" + 2 * kind + table
    for name, last in (("x", 2.0), ("y", 3.0)):
        (tmp_path / f"{name}.csv").write_text(f"threshold\n1.0\n{last}\n")
    before = plan_of(text + axis, tmp_path).ids
    (tmp_path / "y.csv").rename(tmp_path / "z.csv")
    assert plan_of(text + axis.replace("y.csv", "z.csv"), tmp_path).ids == before
    (tmp_path / "y.csv").write_text("threshold\n1.0\n4.0\n")
    now = plan_of(text + axis, tmp_path).ids
    assert (now[0] == before[0], now[1] == before[1]) == (True, False)


def test_rates_without_a_rule_are_refused():
    """Nothing would age, and nobody would know; with a rule, or the rule as an axis,
    something does."""
    rates = '[sweep]\n"aging.rate" = [0.1, 1.0]\n'
    with pytest.raises(
        InputError, match=r"point 1 of 2: aging.rule: is required with rate"
    ):
        plan_of(BASE + rates)
    assert (
        plan_of(BASE + '[aging]\nrule = "flow"\nx_star_final = 2.0\n' + rates).size == 2
    )
    aging = "[aging]\nrate = 0.1\nx_star_final = 2.0\n"
    assert (
        plan_of(BASE + aging + '[sweep]\n"aging.rule" = ["none", "flow"]\n').size == 2
    )


@pytest.mark.parametrize("key", ["thermal.kT", "disorder"])
def test_a_file_of_points_with_a_column_twice(tmp_path, key):
    """A row would keep the last of the two."""
    pq.write_table(
        pa.Table.from_arrays([pa.array([0.1]), pa.array([0.2])], [key, key]),
        tmp_path / "points.parquet",
    )
    with pytest.raises(InputError, match=r"points\.parquet: cannot be read as Parquet"):
        plan_of(BASE + '[sweep]\nfile = "points.parquet"\n', tmp_path)
