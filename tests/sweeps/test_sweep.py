"""Sweeps: rows, the folder that survives anything, and workers that do not change a
bit."""

import base64
import concurrent.futures as futures
import contextlib
import dataclasses
import glob
import hashlib
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rows import BASIC
from scipy import stats
from test_grid import BASE, file_of, plan_of
from typer.testing import CliRunner
from waiting import once

from eqsim.cli import survey
from eqsim.cli.app import app
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import trajectory
from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.io.parameters import naming
from eqsim.io.runfile import check, load, stored
from eqsim.io.storage import publish, versions
from eqsim.laws.delay import Delay
from eqsim.master.lifetimes import lifetime
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Programme, Segment, Stage
from eqsim.model.ensemble import Ensemble
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps import rows as rows_module
from eqsim.sweeps import store as store_module
from eqsim.sweeps.plan import Plan, seed_of, swept
from eqsim.sweeps.rows import Asked
from eqsim.sweeps.scheduler import Scheduler, sweep
from eqsim.sweeps.store import SCHEMA, WORKERS_DIED, Store, schema
from eqsim.sweeps.workers import Workers
from eqsim.workflows.sweep import sweep as eqsim_sweep

GRID = (
    BASE
    + '[sweep]\n"drive.velocity" = { log = [0.01, 1.0, 3] }\n"thermal.kT" = [0.1, 1.0]\n"delay.time" = [0.0, 1.0]\n'
)
# Rows reach the disk at once, and workers are told to stop nowhere in particular.
EAGER = (
    "import eqsim.sweeps.scheduler as s, eqsim.sweeps.store as t; t._FLUSH_ROWS = 3; s._BATCH_SECONDS = 0.1; "
    "from eqsim.__main__ import main; main()"
)


def table_of(folder):
    """The dataset without its times, as its reader sees it."""
    return pq.read_table(folder / "sweep.parquet").drop_columns("seconds")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A run file of 12 points and its dataset, computed by one process with one thread."""
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.toml").write_text(GRID)
    sweep(Plan(load(folder / "small.toml")), folder / "one")
    return folder


# ---- the dataset ----


def test_rows_are_what_steady_and_reference_say(small):
    table = pd.read_parquet(small / "one")
    assert len(table) == 12
    assert list(table.columns) == schema(plan_of(GRID)).names
    assert set(naming(check({}))) <= set(table.columns)
    plan = plan_of(GRID)
    assert list(table["id"]) == plan.ids  # in the order of the grid
    for index in (0, 7):
        row, point = table.iloc[index], plan.at(index)
        found = steady(
            point.ensemble,
            point.drive,
            rel_error=1e-2,
            seed=seed_of(row["id"]),
        )
        exact = reference(point.ensemble, point.drive)
        assert row["friction"] == found.friction.value
        assert row["friction_stderr"] == found.friction.stderr
        assert row["lives"] == found.lives
        assert row["pinned_reference"] == exact.pinned.value
        for name in BASIC:
            ours, level = getattr(found, name), getattr(exact, name)
            assert row[f"{name}_reference_error"] == level.stderr
            # 32 randomisations
            assert (row[f"{name}_dof"], row[f"{name}_reliable"]) == (31, True)
            sigma = math.hypot(ours.stderr, level.stderr)
            if sigma:  # Student's probability as that of a normal score, with the sign of ours - theirs
                score = stats.norm.ppf(
                    stats.t.cdf((ours.value - level.value) / sigma, 31)
                )
                assert row[f"{name}_z"] == pytest.approx(score, rel=1e-9, abs=0)
        assert row["drive.velocity"] == point["drive.velocity"]
        assert row["seed"] == seed_of(row["id"])
    z = table[["friction_z", "pinned_z", "break_stretch_z"]].stack().dropna()
    assert (z.abs() < 5).all()  # some 30 normal scores: a false alarm in 6e4 seeds
    assert table["pinned_z"].isna().sum() == 6  # without delay both errors are 0
    assert set(table["status"]) == {"ok"}
    origin = json.loads(
        pq.read_schema(small / "one" / "sweep.parquet").metadata[b"eqsim"]
    )
    assert origin["run_file"] == GRID
    assert origin["schema"] == SCHEMA
    assert origin["results_version"] == RESULTS_VERSION
    assert origin["versions"] == versions()


@pytest.mark.parametrize(
    "text",
    [
        """
[thermal]
kT = 0.1
[drive]
velocity = 0.1
[[population]]
share = 0.5
[[population]]
share = 0.5
stiffness = 2.0
[sweep]
"thermal.kT" = [0.05, 0.5]
""",
        """
contacts = { count = 80, stiffness_law = "uniform" }
drive = { velocity = 0.1 }
elastic = { blocks = 4, coupling = 1, drive_stiffness = 1, load = { first = 1, last = 3 } }
sweep = { "elastic.blocks" = [4, 8] }
""",
        """
contacts = { stiffness_law = "uniform" }
drive = { velocity = 0.1 }
aging = { rule = "flow", rate = 0.1, x_star_final = 2.0 }
[sweep]
aging.rule = ["flow", "langevin"]
""",
    ],
    ids=["populations", "loads", "rules"],
)
def test_provenance_holds_every_point(text, tmp_path):
    """Populations inherit keys that change from point to point, there are as many loads
    as blocks, and rules of aging may be a list."""
    plan = plan_of(text)
    store = Store(tmp_path / "o", plan, Asked())
    store.close()
    origin = json.loads(store.schema.metadata[b"eqsim"])
    again = Plan(stored(origin["settings"]["sweep"], origin["folder"]))
    assert again.ids == plan.ids
    for index in range(plan.size):
        assert again.task(index) == plan.task(index)


def test_lifetimes_under_a_force():
    """Beside the exact mean of identical contacts; none while some have not let go."""
    text = """
contacts = { count = 50, stiffness_law = "uniform" }
thresholds = { law = "delta" }
thermal = { kT = 0.2 }
delay = { time = inf }
drive = { force = 0.3, time = 20.0 }
sweep = { "drive.force" = [0.3] }
"""
    plan = plan_of(text)
    task, names = plan.task(0), schema(plan).names
    assert {"lifetime", "lifetime_z", "strength"} < {*names}
    assert "slips" not in names
    run = SimpleNamespace(lifetimes=np.array([1.0, 2.0, 3.0]), lives=150)
    row = rows_module._failure_columns(task, task.drive, run, True)
    exact = lifetime(task.ensemble, task.drive).mean.value
    assert (row["status"], row["lifetime"], row["lifetime_dof"]) == ("ok", 2.0, 2)
    assert row["lifetime_reference"] == exact
    row = rows_module._failure_columns(task, task.drive, run, False)
    assert "lifetime_reference" not in row
    run.lifetimes[1] = math.inf
    row = rows_module._failure_columns(task, task.drive, run, True)
    assert (row["status"], row.get("lifetime")) == ("unreliable", None)


BLOCKS = """
contacts = { count = 80, stiffness_law = "uniform" }
drive = { velocity = 0.1 }
elastic = { blocks = 8, coupling = 1, drive_stiffness = 1 }
sweep = { "elastic.blocks" = [4] }
"""


def test_blocks_without_references(monkeypatch):
    ours = Estimate(1.0, 0.1, 9)
    run = SimpleNamespace(friction=ours, size=ours, single=ours, lives=1)
    monkeypatch.setattr(rows_module, "elastic_trajectory", lambda *_, **__: run)
    task = plan_of(BLOCKS).task(0)
    for exact in (True, False):
        row = rows_module._point_row(task, Asked(exact=exact), 1)
        assert ("friction_reference" in row) == ("reference_method" in row) == exact


DRIVEN = {
    "contacts": {"count": 40, "stiffness_law": "uniform"},
    "thresholds": {"law": "delta"},
    "thermal": {"kT": 0.1},
    "delay": {"time": 1.0},
    "drive": {"velocity": 0.1},
    "output": {"points": 21, "replicas": 8},
}
CHAIN = {
    "elastic": {"blocks": 4, "coupling": 1, "drive_stiffness": 1},
    "delay": {},
    "drive": {"velocity": 0.1, "distance": 4.0},
}
BUNDLE = {"drive": {"time": 1e4}, "delay": {"time": math.inf}}
TIMED = {"drive": {"velocity": 0.1, "time": 10.0}}


@pytest.mark.parametrize(
    "simulated", [False, pytest.param(True, marks=pytest.mark.long)]
)
@pytest.mark.parametrize(
    ("given", "key", "values"),
    [
        ({}, "drive.stall_force", {0.5: "friction", math.inf: "friction_z"}),
        (BUNDLE, "drive.force", {0.3: "lifetime"}),
        (BUNDLE, "drive.force_rate", {1e-3: "strength"}),
        (CHAIN, "elastic.damping", {0.3: "slips", 0.0: "size"}),
        (CHAIN, "elastic.mass", {1.0: "slips"}),
        ({}, "drive.time", {10.0: "segment_0_end"}),
        (TIMED, "thermal.kT", {0.1: "segment_0_end"}),
    ],
)
def test_an_axis_may_change_the_kind_of_drive(given, key, values, simulated, tmp_path):
    """Every row has its own kind, and all of its estimates a column."""
    sweep_table = {"sweep": {key: [*values]}}
    plan, asked = Plan(check(DRIVEN | given | sweep_table)), Asked(rel_error=0.1)
    store = Store(tmp_path / "o", plan, asked)
    for index, name in enumerate(values.values()):
        row = {"status": "ok", name: 1.0, "seconds": 0.0}
        if simulated:
            row = rows_module._point_row(plan.task(index), asked, 1)
        estimates = {name for name in row if f"{name}_stderr" in row}
        assert estimates <= {*store.schema.names}
        store.add(index, row)
    found = store.compact().to_pylist()
    store.close()
    usual = {math.inf: "steady", 0.0: "transient"}  # without motor, and damping
    for row, (value, name) in zip(found, values.items(), strict=True):
        assert row["kind"] == usual.get(value, "programme")
        assert row[name] is not None, row["message"]


SPEEDS = 0.1, 0.2
ALONG = {"drive": {"programme": [{"velocity": v, "distance": 2.0} for v in SPEEDS]}}
PULL = {"drive": {"force": 0.3, "time": 1e4}}
MOTOR = {"drive": {"velocity": 0.1, "distance": 2.0, "stall_force": 0.5}}
STAGE = {"drive": {"velocity": 0.1, "distance": 2.0, "stage": {"stiffness": 0.5}}}
LESS = ("_dof", "_reliable", "_reference_error")
IN_TIME = CHAIN | {"elastic": CHAIN["elastic"] | {"damping": 0.3}}


@pytest.mark.parametrize(
    "given",
    [
        pytest.param({}, id="constant"),
        pytest.param(TIMED, id="in time"),
        pytest.param(ALONG, id="along"),
        pytest.param(CHAIN, id="blocks"),
        pytest.param(CHAIN | ALONG, id="blocks along"),
        pytest.param(STAGE, id="stage"),
        pytest.param(BUNDLE | PULL, id="force"),
        pytest.param(MOTOR, id="motor"),
        pytest.param(
            {"drive": ALONG["drive"] | {"stall_force": 0.5}}, id="motor along"
        ),
        pytest.param(IN_TIME, id="chain"),
        pytest.param(IN_TIME | ALONG, id="chain along"),
    ],
)
def test_no_column_of_a_row_is_dropped(given):
    """Nor those of the forces at the interface. Of some estimates neither degrees of
    freedom nor bounds of references are kept."""
    small = {"output": {"points": 21, "replicas": 2}, "interface": {"normal_load": 9.0}}
    units = {"units": {"length": "um", "time": "s", "force": "mN"}}
    swept_key = {"sweep": {"thermal.kT": [0.1]}}
    plan = Plan(check(DRIVEN | given | small | units | swept_key))
    row = rows_module._point_row(plan.task(0), Asked(rel_error=0.1), 1)
    assert row["status"] != "failed"
    row |= store_module.physical(plan.at(0), row)
    dropped = row.keys() - {*schema(plan).names}
    assert {name for name in dropped if not name.endswith(LESS)} == set()
    for name in ("friction_force", "friction_coefficient"):
        assert (name in row) == ("friction" in row) == (name in schema(plan).names)


def test_a_drive_that_an_axis_reads_is_refused(tmp_path):
    """The content of such a file is no part of a point, as of one in [drive]."""
    with pytest.raises(InputError, match=r"^drive.file: not allowed with \[sweep\]"):
        plan_of(BASE + '[sweep]\n"drive.file" = ["a.csv"]\n', tmp_path)


def test_accuracy_that_some_points_need_is_allowed():
    def runs(*stalls):
        return Plan(check(DRIVEN | {"sweep": {"drive.stall_force": [*stalls]}})).runs

    Asked(rel_error=1e-3).require_effect(runs(0.5, math.inf))
    Asked(transient=True).require_effect(runs(0.5, math.inf))
    with pytest.raises(InputError, match="has no effect on a programme or a pulled"):
        Asked(rel_error=1e-3).require_effect(runs(0.5))


HOLD = """
drive = { programme = [{ velocity = 0.1, time = 1.0 }, { hold = 1.0 }] }
sweep = { "drive.programme.1.hold" = [1.0] }
"""


@pytest.mark.parametrize("text", [BLOCKS, HOLD], ids=["blocks", "programme"])
def test_accuracy_that_is_asked_of_runs_is_refused(text):
    file = file_of(text)
    for option, value in (("rel-error", 1e-3), ("transient", True)):
        said = (
            rf"^--{option}.*: has no effect on (blocks|a programme or a pulled slider)"
        )
        with pytest.raises(InputError, match=said):
            eqsim_sweep(file, **{option.replace("-", "_"): value})


def test_workers_and_threads_do_not_change_a_bit(small):
    for out, workers in (("threads", Workers(threads=2)), ("processes", Workers(2))):
        sweep(Plan(load(small / "small.toml")), small / out, workers=workers)
        assert table_of(small / out).equals(
            table_of(small / "one"), check_metadata=True
        )


def test_order_and_company_do_not_change_a_bit(small, tmp_path):
    other = GRID.replace("[0.1, 1.0]", "[3.0, 1.0]").replace("[0.0, 1.0]", "[1.0, 0.0]")
    sweep(plan_of(other), tmp_path / "o")
    one, two = (
        table_of(folder).to_pandas().set_index("id")
        for folder in (small / "one", tmp_path / "o")
    )
    both = one.index.intersection(two.index)
    assert len(both) == 6
    pd.testing.assert_frame_equal(one.loc[both], two.loc[both], check_exact=True)
    # negative control
    assert not one["friction"].isin(two.drop(both)["friction"]).any()


def test_transient(tmp_path):
    text = BASE + '[sweep]\n"thermal.kT" = [0.1, 1.0]\n'
    sweep(plan_of(text), tmp_path / "o", asked=Asked(transient=True))
    table = pd.read_parquet(tmp_path / "o")
    assert set(table["kind"]) == {"transient"}
    assert table["friction_reference"].isna().all()
    plan = plan_of(text)
    for index, row in table.iterrows():
        point, seed = plan.at(index), seed_of(row["id"])
        found = trajectory(
            point.ensemble,
            point.drive,
            points=point.output.points,
            seed=seed,
        )
        for name in BASIC:
            estimate = getattr(found.averages, name)
            assert (row[name], row[f"{name}_stderr"], row[f"{name}_dof"]) == (
                estimate.value,
                estimate.stderr,
                estimate.dof,
            )
        assert row["lives"] == found.lives > 500
    # 64 batches
    assert (table[["friction_dof", "break_stretch_dof"]] == 63).all(axis=None)


def test_failed_and_unreliable_points_do_not_stop_the_others(tmp_path, monkeypatch):
    """A velocity beyond all groups fails, now and when the sweep is asked for again;
    the rest are ok."""
    path = tmp_path / "a.toml"
    path.write_text(
        BASE
        + '[thermal]\nkT = 0.1\n[sweep]\n"drive.velocity" = [0.1, 1e-100, 1.0]\n"delay.time" = [1e-3]\n'
    )
    out = tmp_path / "o"
    result = CliRunner().invoke(
        app, ["sweep", str(path), "--out", str(out), "--workers", "1", "--json"]
    )
    assert result.exit_code == 1, result.output
    summary = json.loads(result.stdout)
    assert (summary["points"], summary["ok"], summary["failed"]) == (3, 2, 1)
    assert summary["failures"][0]["changes"]["drive.velocity"] == 1e-100
    monkeypatch.setattr(survey, "_MOST_FAILURES", 0)
    again = CliRunner().invoke(app, ["sweep", str(path), "--out", str(out)])
    assert again.stderr == "eqsim: 1 more failed; the column `message` says why\n"
    monkeypatch.undo()
    table = pd.read_parquet(out)
    assert list(table["status"]) == ["ok", "failed", "ok"]
    assert "-230" in table["message"][1]
    again = CliRunner().invoke(app, ["sweep", str(path), "--out", str(out)])
    assert again.exit_code == 1
    assert "2 ok, 1 FAILED" in again.stdout
    assert (
        "point 2 (drive.velocity = 1e-100, delay.time = 0.001) failed: ln(attempt"
        in again.stderr
    )


def test_what_cannot_be_trusted_is_unreliable(monkeypatch):
    task, found = plan_of(GRID).task(0), steady(Ensemble(), Drive(0.1), rel_error=1e-2)
    doubtful = dataclasses.replace(found.friction, reliable=False)
    for result, said in (
        (
            dataclasses.replace(found, reached=False),
            "relative error 0.01 was not reached",
        ),
        (
            dataclasses.replace(found, friction=doubtful),
            "error bars of friction cannot be trusted",
        ),
        (found, None),
    ):
        monkeypatch.setattr(
            "eqsim.sweeps.rows.steady", lambda *_, result=result, **__: result
        )
        row = rows_module._point_row(task, Asked(), 1)
        assert (row["status"], row["message"]) == ("unreliable" if said else "ok", said)


@pytest.mark.parametrize("reliable", [True, False])
def test_few_slips_are_told_beside_other_doubts(reliable, monkeypatch):
    """Also with several segments, whose forces have doubts of their own."""
    two = "drive = { programme = [{ velocity = 0.1, time = 1.0 }, { hold = 1.0 }], stage = { stiffness = 0.1 } }"
    task = plan_of(f'{two}\nsweep = {{ "contacts.count" = [40] }}').task(0)
    run = trajectory(task.ensemble, task.drive, points=21, seed=1, replicas=8)
    few = Estimate(1.0, 0.1, 3, reliable=False)
    told = dataclasses.replace(run, force_reliable=reliable)
    monkeypatch.setattr(rows_module, "trajectory", lambda *_, **__: told)
    monkeypatch.setattr(type(run), "period", few)
    monkeypatch.setattr(type(run), "drop", few)
    row = rows_module._point_row(task, Asked(exact=False), 1)
    said = ["few slips"]
    if not reliable:
        said.append(
            "error bars of forces cannot be trusted: how far X scatters is known from 8 replicas on"
        )
    said.append("no reference: not asked for")
    assert (row["status"], row["message"]) == ("unreliable", "; ".join(said))


# ---- the folder ----


def test_the_first_element_that_differs_is_shown(tmp_path):
    """However far on it stands."""
    values = np.linspace(0.1, 1.0, 60).tolist()
    other = [*values[:50], 7.5, *values[51:]]

    def opened(axis):
        plan = plan_of(f'{BASE}[sweep]\n"thermal.kT" = {axis}\n')
        Store(tmp_path, plan, Asked()).close()

    opened(values)
    with pytest.raises(InputError) as caught:
        opened(other)
    found = re.search(r"kT was \.\.\.(.*), is \.\.\.(.*)", str(caught.value))
    was, now = found.groups()
    assert (was.split(", ")[0], now.split(", ")[0]) == (str(values[50]), "7.5")
    assert len(str(caught.value)) < 400
    with pytest.raises(InputError, match=rf"was \.\.\.{values[-2]}, 1\.0\], is \.\.\."):
        opened(values[:-1])


FILES_OF_AXES = {
    "thresholds": (
        'thresholds = { law = "table", file = "a.csv" }\n'
        'drive = { velocity = 0.1 }\nsweep = { "thresholds.file" = ["a.csv", "b.csv"] }\n',
        "threshold\n1.0\n2.0\n",
    ),
    "loads": (
        'elastic = { blocks = 2, coupling = 1, drive_stiffness = 1, load = "a.csv" }\n'
        'drive = { velocity = 0.1 }\nsweep = { "elastic.load" = ["a.csv", "b.csv"] }\n',
        "load\n1.0\n2.0\n",
    ),
    "populations": (
        "population = [{ share = 1, stiffness = 1, thresholds = { "
        'law = "table", file = "a.csv" } }, { share = 1, stiffness = 1 }]\n'
        'drive = { velocity = 0.1 }\nsweep = { "population.0.thresholds.file" = ["a.csv", "b.csv"] }\n',
        "threshold\n1.0\n2.0\n",
    ),
}


@pytest.mark.parametrize("name", FILES_OF_AXES)
def test_contents_of_files_that_axes_name_belong_to_the_sweep(name, tmp_path):
    """A folder that an earlier release began knows only those that the file names."""
    text, content = FILES_OF_AXES[name]
    (tmp_path / "a.csv").write_text(content)
    (tmp_path / "b.csv").write_text(content + "3.0\n" * (name != "loads") or content)
    if name == "loads":
        (tmp_path / "b.csv").write_text(content.replace("2.0", "3.0"))

    def opened():
        Store(tmp_path / "o", plan_of(text, tmp_path), Asked()).close()

    opened()
    opened()
    before = (tmp_path / "b.csv").read_text()
    (tmp_path / "b.csv").write_text(before.replace("3.0", "4.0"))
    with pytest.raises(InputError, match=r"another folder: content of b.csv was"):
        opened()
    path = tmp_path / "o" / "_sweep.json"
    manifest = json.loads(path.read_bytes())
    del manifest["asked"]["content of b.csv"]
    path.write_text(json.dumps(manifest))
    opened()


@pytest.mark.parametrize("finished", [False, True])
def test_points_at_which_workers_died_are_computed_again(small, tmp_path, finished):
    """Once there is more memory; nothing else is, and a reader sees every row once."""
    plan, out = plan_of(GRID), tmp_path / "o"
    rows = pq.read_table(small / "one" / "sweep.parquet").to_pylist()
    rows = rows if finished else rows[:11]
    died = {"status": "failed", "message": f"3 {WORKERS_DIED} (or so)", "seconds": 0.0}
    store = Store(out, plan, Asked())
    for index, row in enumerate(rows):
        store.add(index, died if index == 4 else row)
    store.compact() if finished else store.flush()
    store.close()
    assert list(pd.read_parquet(out)["status"]).count("failed") == 1
    again = Store(out, plan, Asked())
    again.close()
    assert again.done == {row["id"] for row in rows} - {plan.ids[4]}
    assert list(pd.read_parquet(out)["status"]) == ["ok"] * len(again.done)
    found = sweep(plan, out)
    assert (found.computed, found.failed) == (1 if finished else 2, 0)
    assert table_of(out).equals(table_of(small / "one"))


def test_a_file_of_nothing_but_deaths_is_no_row(tmp_path):
    plan = plan_of(GRID)
    store = Store(tmp_path, plan, Asked())
    pool = Pool(seed_of(plan.ids[4]), 0.0)
    Scheduler(store, pool, Asked(), *SILENT).run([4])
    assert store.kept().startswith("1 of 12")
    store.close()
    again = Store(tmp_path, plan, Asked())
    again.close()
    assert (again.done, again.tables, again.parts) == (set(), [], [])


def test_another_sweep_in_the_same_folder_is_refused(small):
    def again(text, **asked):
        sweep(Plan(file_of(text)), small / "one", asked=Asked(**asked))

    before = (small / "one" / "sweep.parquet").stat().st_mtime_ns
    again(GRID)  # the same is welcome, and computes nothing
    with pytest.raises(InputError, match=r"contacts.count was 500, is 501"):
        again(GRID.replace("500", "501"))
    with pytest.raises(
        InputError, match=r"sweep.delay.time was \[0.0, 1.0\], is \[0.0\]"
    ):
        again(GRID.replace("[0.0, 1.0]", "[0.0]"))
    with pytest.raises(InputError, match=r"rel_error was 0.01, is 0.001"):
        again(GRID, rel_error=1e-3)
    assert (small / "one" / "sweep.parquet").stat().st_mtime_ns == before


def test_the_order_of_axes_without_quotes_belongs_to_the_sweep(tmp_path):
    axes = "thermal.kT = [0.1, 0.2]", "thermal.attempt_frequency = [1.0, 2.0]"
    for first, last in (axes, axes[::-1]):
        plan = plan_of(f"{BASE}[sweep]\n{first}\n{last}\n")
        if (first, last) == axes:
            Store(tmp_path / "o", plan, Asked()).close()
            continue
        with pytest.raises(InputError, match="order of axes was"):
            Store(tmp_path / "o", plan, Asked())


def test_what_the_sweep_replaces_may_change(small):
    """The base value of a swept key is no part of any point: the folder goes on, and
    computes nothing."""
    before = (small / "one" / "sweep.parquet").stat().st_mtime_ns
    file = file_of(GRID)
    other = check(file.given | {"drive": file.given["drive"] | {"velocity": 77.0}})
    assert other["drive.velocity"] != file["drive.velocity"]
    plan = Plan(other)
    assert plan.ids == plan_of(GRID).ids
    done = sweep(plan, small / "one")
    assert (done.resumed, done.computed) == (12, 0)
    assert (small / "one" / "sweep.parquet").stat().st_mtime_ns == before


def test_a_file_that_changes_meanwhile_ends_the_sweep(tmp_path, monkeypatch):
    """No point has the identity of other thresholds; with the file as it was the sweep
    goes on."""
    (tmp_path / "a.csv").write_text("threshold\n1\n2\n")
    (tmp_path / "a.toml").write_text(
        BASE + '[thresholds]\nlaw = "table"\nfile = "a.csv"\n'
        '[sweep]\n"contacts.count" = { linear = [100, 109, 10] }\n'
    )
    options = f"--out {tmp_path}/o --rel-error 0.2 --workers 1"
    command = f"sweep {tmp_path}/a.toml {options}".split()
    finish = Scheduler._finish

    def finished(scheduler, index, row):
        (tmp_path / "a.csv").write_text("threshold\n10\n20\n")
        finish(scheduler, index, row)

    monkeypatch.setattr(Scheduler, "_finish", finished)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 2
    assert "a file that the run file names has changed" in " ".join(done.stderr.split())
    assert set(pd.read_parquet(tmp_path / "o")["status"]) == {"ok"}
    monkeypatch.undo()
    (tmp_path / "a.csv").write_text("threshold\n1\n2\n")
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    found = pd.read_parquet(tmp_path / "o")
    assert len(found) == 10
    assert found["friction_reference"].nunique() == 1


def test_a_worker_with_other_code_is_refused():
    with pytest.raises(InputError, match="other code"):
        rows_module.compute([], Asked(), 1, RESULTS_VERSION + 1)


def test_a_folder_of_something_else_is_refused(tmp_path):
    pq.write_table(pa.table({"a": [1]}), tmp_path / "theirs.parquet")
    with pytest.raises(InputError, match="another origin"):
        sweep(plan_of(GRID), tmp_path)
    # which readers of the folder would stumble over
    (tmp_path / "theirs.parquet").rename(tmp_path / "notes.txt")
    with pytest.raises(
        InputError, match=r"another origin, notes.txt; must be a folder of its own"
    ):
        sweep(plan_of(GRID), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_one_sweep_at_a_time(tmp_path):
    plan = plan_of(GRID)
    store = Store(tmp_path, plan, Asked())
    with pytest.raises(InputError, match="another sweep is at work"):
        Store(tmp_path, plan, Asked())
    store.close()
    Store(tmp_path, plan, Asked()).close()


def parts_of(small, out, size=3, rows=9):
    """An unfinished folder: `rows` finished rows of `small`, in parts."""
    plan, table = (
        plan_of(GRID),
        pq.read_table(small / "one" / "sweep.parquet").to_pylist(),
    )
    store = Store(out, plan, Asked())
    for index, row in enumerate(table[:rows]):
        store.add(index, row)
        if index % size == size - 1:
            store.flush()
    store.close()
    return store.parts


@pytest.mark.parametrize("then", ["5b1f9c03a7e2d864", str(RESULTS_VERSION - 1)])
@pytest.mark.parametrize("finished", [False, True])
def test_a_folder_of_another_results_version_says_what_to_do(
    small, tmp_path, finished, then
):
    """Also one whose version is a digest of sources, as earlier releases wrote it:
    nothing in it is changed, and it can be exported and plotted."""
    out = tmp_path / "o"
    if finished:
        shutil.copytree(small / "one", out)
    else:
        parts_of(small, out)
    path = out / "_sweep.json"
    manifest = json.loads(path.read_bytes())
    manifest["asked"]["results version"] = then
    path.write_text(json.dumps(manifest))
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    done = CliRunner().invoke(
        app, ["sweep", str(small / "small.toml"), "--out", str(out)]
    )
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert (
        f"begun by another version of eqsim (results version {then}, not {RESULTS_VERSION})"
        in done.stderr
    )
    assert "finish it with that one, or use another folder" in done.stderr
    assert {
        path: path.read_bytes() for path in out.rglob("*") if path.is_file()
    } == before
    for command in (
        ["export"],
        ["plot", "--by", "thermal.kT", "--where", "delay.time=1"],
    ):
        done = CliRunner().invoke(
            app, [*command, str(out), "--out", str(tmp_path / f"{command[0]}.svg")]
        )
        assert done.exit_code == 0, done.output


# Sources that differ by comments, and what these say of a folder.
COMMENTED = """
import json, sys
from pathlib import Path
import eqsim
from eqsim.io.runfile import load
from eqsim.sweeps.plan import Plan, seed_of
from eqsim.sweeps.rows import Asked
from eqsim.sweeps.store import Store
path, out = map(Path, sys.argv[1:])
plan = Plan(load(path))
store = Store(out, plan, Asked())
print(json.dumps([eqsim.__file__, plan.ids, [*map(seed_of, plan.ids)], sorted(store.done)]))
"""


@pytest.mark.long
def test_a_comment_in_the_sources_changes_no_point(small, tmp_path):
    """Every source file is longer by a comment: ids and seeds are the same, and a
    half-done folder goes on."""
    out, copy = tmp_path / "o", tmp_path / "copy"
    parts_of(small, out)
    sources = Path(sys.modules["eqsim"].__file__).parent
    shutil.copytree(
        sources, copy / "eqsim", ignore=shutil.ignore_patterns("__pycache__")
    )
    for path in copy.rglob("*.py"):
        path.write_text(
            path.read_text(encoding="utf-8") + "# a comment\n", encoding="utf-8"
        )
    command = [sys.executable, "-c", COMMENTED, str(small / "small.toml"), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=copy)
    assert done.returncode == 0, done.stderr
    where, ids, seeds, finished = json.loads(done.stdout)
    assert Path(where).is_relative_to(copy)
    plan = plan_of(GRID)
    assert (ids, seeds) == (plan.ids, [seed_of(point_id) for point_id in plan.ids])
    assert finished == sorted(plan.ids[:9])


def test_a_table_names_all_libraries_that_made_it(small, tmp_path, monkeypatch):
    """A half-done folder goes on with other releases of libraries, and its table says
    so."""
    with monkeypatch.context() as patch:
        patch.setattr(
            "eqsim.io.storage.versions", lambda: versions() | {"numpy": "0.9"}
        )
        parts_of(small, tmp_path / "o")
    assert sweep(plan_of(GRID), tmp_path / "o").resumed == 9
    assert table_of(tmp_path / "o").equals(table_of(small / "one"))
    origin = json.loads(
        pq.read_schema(tmp_path / "o" / "sweep.parquet").metadata[b"eqsim"]
    )
    assert origin["versions"] == versions() | {"numpy": f"0.9, {np.__version__}"}


def test_columns_have_a_version():
    """A folder is refused by its version. Where columns change, `SCHEMA` is raised, and
    their digest entered here."""
    columns = {2: "f12a4c59b11c92e1"}
    names = [f"{field.name} {field.type}" for field in schema(plan_of(GRID))]
    assert hashlib.sha256(" ".join(names).encode()).hexdigest()[:16] == columns[SCHEMA]


def test_rows_with_other_columns_are_refused_and_kept(small, tmp_path):
    shutil.copytree(small / "one", tmp_path / "o")
    path = tmp_path / "o" / "sweep.parquet"
    pq.write_table(table_of(tmp_path / "o"), path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"sweep.parquet: has other columns than"):
        sweep(plan_of(GRID), tmp_path / "o")
    assert path.read_bytes() == before


def test_damaged_parts_are_named_and_computed_again(small, tmp_path):
    """A flipped bit, a file that was cut, and another part's content under this one's
    name; a fourth is whole."""
    parts = parts_of(small, tmp_path / "o", rows=12)
    content = [part.read_bytes() for part in parts]
    middle = len(content[0]) // 3
    parts[0].write_bytes(
        content[0][:middle] + bytes([content[0][middle] ^ 1]) + content[0][middle + 1 :]
    )
    parts[1].write_bytes(content[1][:middle])
    parts[2].write_bytes(content[3])
    notes = []
    found = sweep(plan_of(GRID), tmp_path / "o", note=notes.append)
    assert sorted(found.damaged) == sorted(str(part) for part in parts[:3])
    assert all(
        any(part.name in note and "damaged" in note for note in notes)
        for part in parts[:3]
    )
    assert (found.resumed, found.computed) == (3, 9)
    assert table_of(tmp_path / "o").equals(table_of(small / "one"))


def test_page_checksums_see_every_byte_of_the_data(small, tmp_path):
    """Of the finished table, which has no digest in its name: 40 flipped bits anywhere
    in its pages are all seen."""
    from eqsim.io import storage

    path = small / "one" / "sweep.parquet"
    content, table = path.read_bytes(), pq.read_table(path)
    assert storage.from_parquet(content).equals(table)
    chunks = pq.ParquetFile(path).metadata.row_group(0)
    column = chunks.column(table.column_names.index("friction"))
    begin, end = (
        column.dictionary_page_offset or column.data_page_offset,
        column.total_compressed_size,
    )
    rng = random.Random(1)
    for _ in range(40):
        bad = bytearray(content)
        bad[begin + rng.randrange(end)] ^= 1 << rng.randrange(8)
        found = storage.from_parquet(bytes(bad))
        # some bits of a page's header mean nothing
        assert found is None or found.equals(table)


def test_a_footer_with_a_wrong_byte_is_damaged():
    """Integers of one bit instead of 64, which pyarrow does not read."""
    from eqsim.io import storage

    content = storage.as_parquet(pa.table({"seed": [1]}))
    text = pq.ParquetFile(pa.BufferReader(content)).metadata.metadata[b"ARROW:schema"]
    schema = base64.b64decode(text)
    bits = [int(n).to_bytes(4, "little") for n in (64, 1)]
    assert schema.count(bits[0]) == 1
    wrong = content.replace(text, base64.b64encode(schema.replace(*bits)))
    with pytest.raises(pa.ArrowNotImplementedError):
        storage.read_parquet(wrong)
    assert storage.from_parquet(wrong) is None


def test_death_between_the_table_and_its_parts_doubles_nothing(
    small, tmp_path, monkeypatch
):
    parts_of(small, tmp_path / "o", size=6, rows=12)
    with monkeypatch.context() as patch:
        patch.setattr(
            Path,
            "unlink",
            lambda *_, **__: (_ for _ in ()).throw(SystemError("killed")),
        )
        with pytest.raises(SystemError):
            sweep(plan_of(GRID), tmp_path / "o")
    assert len(list((tmp_path / "o" / "_parts").iterdir())) == 2
    assert len(pd.read_parquet(tmp_path / "o")) == 12
    found = sweep(plan_of(GRID), tmp_path / "o")
    assert found.computed == 0
    assert not (tmp_path / "o" / "_parts").exists()
    assert pq.read_table(tmp_path / "o" / "sweep.parquet").equals(
        pq.read_table(small / "one" / "sweep.parquet")
    )


def test_death_before_the_table_has_its_name_loses_nothing(
    small, tmp_path, monkeypatch
):
    """Parts are hidden by then, so that no reader sees a row twice, and found again,
    with others that are not."""
    from eqsim.io import storage

    out = tmp_path / "o"
    parts_of(small, out, size=6, rows=12)
    with monkeypatch.context() as patch:
        patch.setattr(
            storage, "save", lambda *_: (_ for _ in ()).throw(SystemError("killed"))
        )
        with pytest.raises(SystemError):
            sweep(plan_of(GRID), out)
    assert len(list((out / "_parts").iterdir())) == 2
    assert not (out / "sweep.parquet").exists()
    (out / "parts").mkdir()
    hidden = next((out / "_parts").iterdir())
    hidden.replace(out / "parts" / hidden.name)
    assert len(pd.read_parquet(out)) == 6
    found = sweep(plan_of(GRID), out)
    assert found.computed == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "_lock",
        "_sweep.json",
        "sweep.parquet",
    ]
    assert pq.read_table(out / "sweep.parquet").equals(
        pq.read_table(small / "one" / "sweep.parquet")
    )


# ---- deaths ----


class Deadly(futures.Executor):
    """Workers that die at one point, and now and then otherwise."""

    def __init__(self, poison, chance):
        self.poison, self.rng, self.chance = poison, random.Random(5), chance
        self.alone = 0  # how often the point went alone

    def submit(self, work, tasks):
        future = futures.Future()
        self.alone += [task.seed for task in tasks] == [self.poison]
        if (
            self.poison in {task.seed for task in tasks}
            or self.rng.random() < self.chance
        ):
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(work(tasks))
        return future


SILENT = (lambda *_: None,) * 2


class Pool:
    lost, threads = (futures.BrokenExecutor,), 1

    def __init__(self, *args):
        self.executor, self.renewed = Deadly(*args), 0

    def slots(self):
        return 2

    def renew(self):
        self.renewed += 1


@pytest.mark.parametrize("poisonous", [False, True])
def test_a_point_that_kills_its_workers_is_found_out(small, tmp_path, poisonous):
    """It alone fails, whatever it was sent with; without it, workers that die by chance
    cost nothing."""
    plan = plan_of(GRID)
    store = Store(tmp_path, plan, Asked())
    pool = Pool(seed_of(plan.ids[4]) if poisonous else -1, 0.1 if poisonous else 0.2)
    Scheduler(store, pool, Asked(), *SILENT).run(list(range(12)))
    store.compact()
    store.close()
    found, exact = table_of(tmp_path).to_pandas(), table_of(small / "one").to_pandas()
    assert list(found["status"]) == [
        "failed" if poisonous and index == 4 else "ok" for index in range(12)
    ]
    if poisonous:
        assert (
            found["message"][4] == "3 workers died at this point (not enough memory?)"
        )
        assert pool.executor.alone == 3
        found, exact = found.drop(4), exact.drop(4)
    pd.testing.assert_frame_equal(found, exact, check_exact=True, check_dtype=False)


def test_workers_that_never_live_end_the_sweep(tmp_path):
    plan = plan_of(GRID)
    store = Store(tmp_path, plan, Asked())
    pool = Pool(-1, 1.0)
    with pytest.raises(InputError, match="as soon as they start"):
        Scheduler(store, pool, Asked(), *SILENT).run(list(range(12)))
    assert pool.renewed == 12  # four times as many in a row as a point may cost
    store.close()


def test_workers_that_die_now_and_then_do_not_end_the_sweep(tmp_path):
    """With any two points together, and with every second point the first two times it
    goes alone: more often than would end the sweep in a row, and every point is
    computed."""
    plan = plan_of(GRID.replace("1.0, 3]", "1.0, 6]"))
    store, pool = Store(tmp_path, plan, Asked()), Pool(-1, 0.0)
    left, submit = dict.fromkeys(map(seed_of, plan.ids[::2]), 2), pool.executor.submit

    def frail(work, tasks):
        dies = len(tasks) > 1 or left.get(tasks[0].seed, 0) > 0
        if len(tasks) == 1 and dies:
            left[tasks[0].seed] -= 1
        pool.executor.chance = float(dies)
        return submit(work, tasks)

    pool.executor.submit = frail
    Scheduler(store, pool, Asked(), *SILENT).run(list(range(24)))
    assert pool.renewed > 12
    assert set(store.compact()["status"].to_pylist()) == {"ok"}
    store.close()


def start(path, out, *options):
    command = [
        sys.executable,
        "-c",
        EAGER,
        "sweep",
        str(path),
        "--out",
        str(out),
        "--workers",
        "2",
        *options,
    ]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def on_disk(out):
    """id -> seconds of every row a reader can find."""
    rows = []
    names = ("*parts/part-*.parquet", "sweep.parquet")
    for path in [path for name in names for path in glob.glob(name, root_dir=out)]:
        # a sweep at work may just have moved these rows; it may move the folder, too,
        # which glob passes over and Path.glob does not
        with contextlib.suppress(FileNotFoundError):
            rows += pq.read_table(out / path).to_pylist()
    return {row["id"]: row["seconds"] for row in rows}


def killed_and_continued(path, out, delays, exact):
    """SIGKILL after each delay past the first rows; then to the end. Finished points
    keep even their times."""
    kept = {}
    for delay in delays:
        process = start(path, out)
        known = len(kept)
        deadline = time.monotonic() + 60
        while (
            process.poll() is None
            and len(on_disk(out)) <= known
            and time.monotonic() < deadline
        ):
            time.sleep(0.02)
        time.sleep(delay)
        children = (
            psutil.Process(process.pid).children(recursive=True)
            if process.poll() is None
            else []
        )
        process.kill()
        process.communicate()
        psutil.wait_procs(children, timeout=10)
        assert not [
            child
            for child in children
            if child.is_running() and child.status() != psutil.STATUS_ZOMBIE
        ]
        found = on_disk(out)
        assert kept.items() <= found.items()
        kept = found
    process = start(path, out)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    assert kept.items() <= on_disk(out).items()
    assert sorted(entry.name for entry in out.iterdir()) == [
        "_lock",
        "_sweep.json",
        "sweep.parquet",
    ]
    assert table_of(out).equals(table_of(exact))
    return len(kept)


@pytest.fixture(scope="module")
def larger(tmp_path_factory):
    """48 points and their dataset, never interrupted."""
    folder = tmp_path_factory.mktemp("larger")
    text = GRID.replace("1.0, 3]", "1.0, 8]").replace("[0.1, 1.0]", "[0.05, 0.3, 1.0]")
    (folder / "a.toml").write_text(text)
    sweep(Plan(load(folder / "a.toml")), folder / "exact", workers=Workers(2))
    return folder


@pytest.mark.long
def test_a_killed_sweep_continues(larger):
    delays = [random.uniform(0, 0.3) for _ in range(2)]
    assert (
        killed_and_continued(
            larger / "a.toml", larger / "twice", delays, larger / "exact"
        )
        > 0
    )


@pytest.mark.long
def test_a_sweep_killed_twenty_times_continues(larger):
    """Also while it starts, finishes, or has nothing left to do."""
    delays = [
        random.uniform(0, 0.1) if index % 4 else random.uniform(0, 2)
        for index in range(20)
    ]
    killed_and_continued(larger / "a.toml", larger / "often", delays, larger / "exact")


@pytest.mark.long
def test_ctrl_c_keeps_finished_rows_and_a_dead_worker_costs_nothing(larger):
    process = start(larger / "a.toml", larger / "stopped")
    rows = once(lambda: on_disk(larger / "stopped"), process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    said = re.search(
        r"interrupted; (\d+) of 48 points are on disk; the same command continues",
        errors,
    )
    assert said, errors
    kept = on_disk(larger / "stopped")
    assert rows.items() <= kept.items()
    assert len(kept) == int(said[1])
    process = start(larger / "a.toml", larger / "stopped", "--json")
    once(lambda: on_disk(larger / "stopped").keys() != kept.keys(), process)
    workers = [
        c
        for c in psutil.Process(process.pid).children()
        if "spawn_main" in " ".join(c.cmdline())
    ]
    os.kill(workers[0].pid, signal.SIGKILL)
    out, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert json.loads(out)["resumed"] == len(kept)
    assert table_of(larger / "stopped").equals(table_of(larger / "exact"))


@pytest.mark.parametrize(
    "moment",
    [
        "_finish",
        "flush",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("compact", "close")),
    ],
)
def test_interrupts_at_any_moment_lose_no_row(small, tmp_path, monkeypatch, moment):
    """The first one in a method once three points are finished, another one as the rows
    at hand are written."""
    monkeypatch.setattr("eqsim.io.signals.acknowledge", lambda: 130)
    monkeypatch.setattr(store_module, "_FLUSH_ROWS", 2)
    owner = Scheduler if moment == "_finish" else Store
    real, flush, begun = getattr(owner, moment), Store.flush, []

    def broken(self, *args, **kwargs):
        if len(getattr(self, "store", self).done) >= 3 and not begun:
            begun.append(None)
            if moment == "close":
                real(self)
            raise KeyboardInterrupt
        return real(self, *args, **kwargs)

    def hindered(self, *args, **kwargs):
        if len(begun) == 1 and moment != "close":
            begun.append(None)
            raise KeyboardInterrupt
        return (
            broken(self, *args, **kwargs)
            if moment == "flush"
            else flush(self, *args, **kwargs)
        )

    monkeypatch.setattr(owner, moment, broken)
    monkeypatch.setattr(Store, "flush", hindered)
    out = tmp_path / "o"
    done = CliRunner().invoke(
        app,
        [
            "sweep",
            str(small / "small.toml"),
            "--out",
            str(out),
            "--workers",
            "1",
            "--quiet",
        ],
    )
    assert done.exit_code == 130
    said = re.fullmatch(
        r"eqsim: interrupted; (\d+) of 12 points are on disk; the same command continues\n",
        done.stderr,
    )
    assert said, done.stderr
    assert len(on_disk(out)) == int(said[1])
    assert int(said[1]) >= 3


def test_an_interrupt_before_there_is_a_folder(small, tmp_path, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("eqsim.io.signals.acknowledge", lambda: 130)
    monkeypatch.setattr("eqsim.sweeps.plan.Plan", stop)
    done = CliRunner().invoke(
        app, ["sweep", str(small / "small.toml"), "--out", str(tmp_path / "o")]
    )
    said = "eqsim: interrupted; this call has computed nothing; the same command continues\n"
    assert (done.exit_code, done.stderr) == (130, said)
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("table", "args", "said"),
    [
        (
            '"thermal.kT" = [0.1, 1.0]',
            ["--set", "thermal.kT=0.5"],
            "--set thermal.kT=0.5: has no effect",
        ),
        (
            "thermal.kT = [0.1, 1.0]",
            ["--set", "thermal.kT=0.5"],
            "--set thermal.kT=0.5: has no effect",
        ),
        (
            'zip = [{ "thermal.kT" = [0.1, 1.0] }]',
            ["--set", "thermal.kT=0.5"],
            "--set thermal.kT=0.5: has no effect",
        ),
        (
            '"output.seed" = [1, 2]',
            ["--seed", "3"],
            "--seed: has no effect, the [sweep] table sets output.seed at",
        ),
        (
            'file = "points.parquet"',
            ["--set", "drive.velocity=2"],
            "--set drive.velocity=2: has no effect",
        ),
    ],
)
def test_set_and_sweep_do_not_contend(tmp_path, table, args, said):
    path, out = tmp_path / "a.toml", tmp_path / "o"
    path.write_text(BASE + "[sweep]\n" + table)
    points = {"drive.velocity": [0.1, 1.0], "delay.time": [None, 1.0]}
    pq.write_table(pa.table(points), tmp_path / "points.parquet")
    done = CliRunner().invoke(app, ["sweep", str(path), "--out", str(out), *args])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert said in done.stderr
    assert not out.exists()
    # what no axis sets, or not at every point, can change
    plan = Plan(load(path, {"contacts.count": 7}))
    assert plan.at(0)["contacts.count"] == 7
    if "file" in table:
        assert {*swept(load(path))} == {"drive.velocity"}


def test_a_key_that_follows_from_an_axis_is_refused(tmp_path):
    """A kT beside a temperature that every point sets."""
    path, out = tmp_path / "a.toml", tmp_path / "o"
    units = 'units = { length = "nm", time = "s", force = "nN" }\n'
    axis = '[sweep]\n"thermal.temperature" = [300.0, 400.0]\n'
    path.write_text(units + BASE + axis)
    given = ["sweep", str(path), "--out", str(out), "--set", "thermal.kT=0.5"]
    done = CliRunner().invoke(app, given)
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    said = "has no effect, the [sweep] table sets thermal.temperature at every point"
    assert f"--set thermal.kT=0.5: {said}" in done.stderr
    assert not out.exists()


@pytest.mark.parametrize("key", ['"thermal.kT"', "thermal.kT"])
def test_axes_can_be_set(tmp_path, key):
    """And added, also to a run file that has none."""
    path = tmp_path / "a.toml"
    path.write_text(BASE + f"[sweep]\n{key} = [0.1, 1.0]\n")
    other = [{"thermal.kT": kT} for kT in (0.2, 0.3, 0.4)]
    changes = {"sweep.thermal.kT": [0.2, 0.3, 0.4], "sweep.delay.time": [1.0]}
    assert Plan(load(path, changes)).axes == [other, [{"delay.time": 1.0}]]
    path.write_text(BASE)
    assert Plan(load(path, changes)).axes == [other, [{"delay.time": 1.0}]]


def test_without_a_cluster_nothing_is_left(small, tmp_path):
    args = ["--out", str(tmp_path / "o"), "--dask", "nowhere"]
    done = CliRunner().invoke(app, ["sweep", str(small / "small.toml"), *args])
    assert done.exit_code == 2
    assert "--dask nowhere: must be HOST:PORT" in done.stderr
    assert not (tmp_path / "o").exists()


@pytest.mark.long
def test_files_can_be_read_by_those_the_umask_allows(small, tmp_path):
    before = os.umask(0o027)
    try:
        CliRunner().invoke(
            app,
            [
                "sweep",
                str(small / "small.toml"),
                "--out",
                str(tmp_path / "o"),
                "--workers",
                "1",
            ],
        )
        publish(tmp_path / "p", {"a": b""})
    finally:
        os.umask(before)
    files = [path for folder in "op" for path in (tmp_path / folder).iterdir()]
    assert {path.stat().st_mode & 0o777 for path in files} == {0o640}
    assert {path.name for path in files} == {
        "_lock",
        "_sweep.json",
        "sweep.parquet",
        "a",
    }


def test_quiet_and_progress(small):
    command = ["sweep", str(small / "small.toml"), "--workers", "1", "--out"]
    result = CliRunner().invoke(app, [*command, str(small / "one"), "--quiet"])
    assert result.exit_code == 0, result.output
    assert result.output == ""
    result = CliRunner().invoke(app, [*command, str(small / "new")])
    assert "12 points (3 x 2 x 2)" in result.stdout
    assert "s a point" not in result.stdout  # of waits above 20 s
    result = CliRunner().invoke(
        app,
        [
            "sweep",
            str(small / "small.toml"),
            "--out",
            "x",
            "--workers",
            "2",
            "--dask",
            "y",
        ],
    )
    assert result.exit_code == 2


def test_newer_keys_name_no_point_that_leaves_them_out():
    """Keys that came with a later version change no name, seed and table of a sweep
    without them; where they are swept they are columns."""
    # as version 0.1.0 has it
    assert plan_of(GRID).ids[0].startswith("4ed3f8be1b84c8b9")
    newer = plan_of(GRID + '"delay.activation" = [0.0, 0.1]')
    assert newer.ids[0] == plan_of(GRID).ids[0] != newer.ids[1]
    assert "delay.activation" in schema(newer).names
    assert "delay.activation" not in schema(plan_of(GRID)).names


MOVING = Segment(1.0, time=20.0)


def test_a_motor_has_its_mean_friction_over_the_second_half():
    contacts = Ensemble(delay=Delay(1.0), count=40, stiffness_law="uniform")
    motor = Programme([MOVING], stage=Stage(0.1), stall_force=0.8)
    task = rows_module.Task(7, contacts, motor, 201, 8)
    [row] = rows_module.compute([task], Asked(), 1, RESULTS_VERSION)
    run = trajectory(contacts, motor, points=201, seed=7, replicas=8)
    each = np.trapezoid(run.force_replicas[:, run.t >= 10.0], dx=0.1) / 10.0
    assert row["status"] == "ok"
    assert 0.0 < row["friction"] < 0.8
    assert row["friction"] == pytest.approx(each.mean(), rel=1e-12, abs=0)
    error = each.std(ddof=1) / math.sqrt(8)
    assert row["friction_stderr"] == pytest.approx(error, rel=1e-9, abs=0)
    assert row["friction_dof"] == 7


def test_mean_friction_is_over_time_not_over_records():
    """A force of 1 during 60 of 100, and 0 after; each segment has ten records."""
    t = np.append(0.0, np.append(np.arange(1, 11) * 6.0, 60.0 + np.arange(1, 11) * 4.0))
    force = np.where(t <= 60.0, 1.0, 0.0) * np.ones((8, 1))
    run = SimpleNamespace(t=t, force_replicas=force)
    # half of the record between 60 and 64, a straight line, counts
    row = rows_module._late_force(run)
    assert row["friction"] == pytest.approx((10.0 + 2.0) / 50.0, rel=1e-12, abs=0)


def test_a_stage_without_a_motor_has_no_mean_friction():
    pulled = Programme([MOVING], stage=Stage(0.1))
    task = rows_module.Task(7, Ensemble(count=40), pulled, 201, 2)
    [row] = rows_module.compute([task], Asked(), 1, RESULTS_VERSION)
    assert "friction" not in row
    assert "slips" in row
