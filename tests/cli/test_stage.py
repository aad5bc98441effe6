"""A stage in run files: commands, tables and files, replay, sweeps, and what is refused
in one line."""

import json
import re

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from command_line import call

from eqsim import Delay, Ensemble, Programme, Segment, Stage, trajectory
from eqsim.engine.readings import slips_of
from eqsim.engine.records import _mean_over
from eqsim.errors import InputError
from eqsim.io.runfile import check

FILE = """
[contacts]
count = 500
stiffness_law = "uniform"
[delay]
time = 1.0
[drive]
velocity = 0.1
distance = 20.0
[drive.stage]
stiffness = 0.1
damping = 0.1
[output]
points = 201
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "pulled.toml"
    file.write_text(FILE)
    return file


@pytest.mark.verification
def test_a_hold_behind_a_spring(path, tmp_path):
    """The table, JSON and rows of a sweep of a slide-hold-slide test are those of a
    rigid drive: forces at the ends, relaxation, healing, drop, and the place of the
    peak on the slider, all within 4.5 errors of the mean field (10 scores: 7e-5), also as
    a coefficient."""
    more = "[interface]\nnormal_load = 250.0\n[sweep]\n'drive.stage.preload' = [0.9]\n"
    moves = "[{velocity = 0.1, distance = 4.0}, {hold = 30.0}, {velocity = 0.1, distance = 4.0}]"
    text = FILE.replace("distance = 20.0", f"programme = {moves}") + "replicas = 8\n"
    aging = "[aging]\nrule = 'logarithmic'\nbeta = 0.05\ncutoff_time = 1.0\n"
    for old, new in (
        ("[delay]\ntime = 1.0\n", aging),
        ("damping = 0.1\n", ""),
        ("stiffness = 0.1\n", "stiffness = 0.5\n"),
    ):
        text = text.replace(old, new)
    path.write_text(text + more)
    done = call("run", path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    for said in ("after X or t", "hold of segment 1: relaxation", "of mu", "drop"):
        assert said in done.output
    segments = json.loads((tmp_path / "out" / "summary.json").read_text())["segments"]
    observables = [
        (i, name)
        for i, segment in enumerate(segments)
        for name in segment["exact"]
        if name != "at" or i == 2
    ]
    for i, name in observables:
        found, exact = segments[i][name], segments[i]["exact"][name]
        assert abs(found["value"] - exact) < 4.5 * found["stderr"], (i, name)
    assert len(observables) == 10
    assert call("sweep", path, "--out", tmp_path / "sweep").exit_code == 0
    (row,) = pd.read_parquet(tmp_path / "sweep").to_dict("records")
    assert {
        row[f"segment_{i}_{name}_reference"] is None for i, name in observables
    } == {False}
    mu = row["segment_2_peak_friction_coefficient"]
    assert mu == pytest.approx(2.0 * row["segment_2_peak"], rel=1e-12, abs=0)
    assert row["reference_method"] == "mean field"
    assert row["slips"] >= 0


@pytest.mark.verification
def test_particles_only(path, tmp_path, monkeypatch):
    """No mean field is solved, which the summary and the line below the table say, and
    a sweep has no references; thresholds that grow as ln t are replayed."""
    monkeypatch.setattr("eqsim.master.slider.pulled_of", None)
    hold = "programme = [{velocity = 0.1, distance = 4.0}, {hold = 1.0}]"
    aging = "[aging]\nrule = 'logarithmic'\nbeta = 0.05\ncutoff_time = 1.0\n"
    text = FILE.replace("distance = 20.0", hold).replace("[delay]\ntime = 1.0\n", aging)
    path.write_text(f"{text}[sweep]\n'drive.stage.preload' = [0.0]\n")
    done = call("run", path, "--out", tmp_path / "out", "--no-exact")
    assert "no exact curve: not asked for" in done.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["exact_curve"] == "not asked for"
    assert "exact" not in summary["segments"][0]
    assert call("replay", tmp_path / "out" / "trajectory.parquet").exit_code == 0
    assert call("sweep", path, "--out", tmp_path / "s", "--no-exact").exit_code == 0
    (row,) = pd.read_parquet(tmp_path / "s").to_dict("records")
    assert row["message"].endswith("no reference: not asked for")
    assert (
        "exact was False, is absent"
        in call("sweep", path, "--out", tmp_path / "s").output
    )


def test_run_and_replay(path, tmp_path):
    done = call("run", path, "--out", tmp_path / "out", "--no-exact")
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    table = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")
    assert {
        "X",
        "stage",
        "spring",
        "work",
        "stored",
        "dissipated",
        "missing",
        "segment",
    } <= set(table)
    assert len(table) == 201
    np.testing.assert_allclose(
        table["spring"], 0.1 * (table["stage"] - table["X"]), rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(table["stage"], 0.1 * table["t"], rtol=0, atol=1e-9)
    slips = summary["slips"]
    assert [slip["replica"] for slip in slips] == [0] * len(slips)
    assert len(slips) >= 2
    assert summary["drop"]["value"] == pytest.approx(
        np.mean([slip["drop"] for slip in slips[1:]]), rel=1e-12, abs=0
    )
    assert (tmp_path / "out" / "force.png").stat().st_size > 20_000
    again = call("replay", tmp_path / "out" / "trajectory.parquet")
    assert again.exit_code == 0, again.output
    assert f"{len(slips)} slips" in done.output


def test_drops_are_shown_as_a_coefficient_where_it_is_known(path, tmp_path):
    """Drops are N k over the load, 500/250 times those of summary.json, as forces of
    segments are."""
    path.write_text(f"{FILE}[interface]\nnormal_load = 250.0\n")
    done = call("run", path, "--out", tmp_path / "out", "--no-exact")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "│ drop of mu │" in re.sub(" +", " ", done.output.replace("┃", "│"))
    rows = [line.split("│")[1:-1] for line in done.output.splitlines()]
    assert len(summary["slips"]) > 1
    drops = [
        float(row[3].strip("> ")) for row in rows if row and row[0].strip().isdigit()
    ]
    expected = [2.0 * slip["drop"] for slip in summary["slips"]]
    assert drops == pytest.approx(expected, rel=1e-5, abs=0)


def test_avalanches(path, tmp_path):
    quasi_static = ["--set", "delay.time=0", "--set", "drive.stage.damping=0"]
    done = call("run", path, "--out", tmp_path / "out", *quasi_static)
    assert done.exit_code == 0, done.output
    table = pq.read_table(tmp_path / "out" / "avalanches.parquet").to_pandas()
    assert list(table) == ["t", "X", "breaks", "drop", "distance", "replica"]
    assert table["breaks"].sum() > 3_000
    assert np.all(np.diff(table["t"]) >= 0)
    assert call("replay", tmp_path / "out" / "avalanches.parquet").exit_code == 0


def test_reference_is_the_mean_field(path):
    done = call(
        "reference",
        path,
        "--transient",
        "--json",
        "--set",
        "output.points=11",
        "--set",
        "drive.distance=1",
    )
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert {
        "t",
        "X",
        "X_error",
        "stage",
        "force",
        "force_error",
        "pinned",
        "pinned_error",
    } <= set(found)
    assert found["X"][0] == found["X_error"][0] == 0.0
    assert np.all(np.diff(found["X"]) > 0)


@pytest.mark.verification
def test_sweep(path, tmp_path):
    path.write_text(FILE + '[sweep]\n"drive.stage.stiffness" = [0.1, 0.5]\n')
    done = call("sweep", path, "--out", tmp_path / "out", "--workers", "1")
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(tmp_path / "out" / "sweep.parquet")
    soft, stiff = table.sort_values("drive.stage.stiffness").to_dict("records")
    assert soft["slips"] > stiff["slips"]
    assert (stiff["status"], soft["kind"]) == ("ok", "programme")
    assert 0.2 < soft["drop"] < 0.6


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ({"stiffness": 0.0}, "drive.stage.stiffness = 0.0: must be"),
        ({"damping": 1.0}, "drive.stage.stiffness: is required"),
        (
            {"stiffness": 1.0, "stifness": 1.0},
            'drive.stage.stifness: unknown key; did you mean "stiffness"?',
        ),
        ({"stiffness": "soft"}, "drive.stage.stiffness = 'soft': must be"),
        ({"stiffness": 1.0, "tolerance": 0.5}, "drive.stage.tolerance = 0.5: must be"),
    ],
)
def test_refused(section, said, tmp_path):
    drive = {"velocity": 0.1, "distance": 1.0, "stage": section}
    with pytest.raises(InputError) as refusal:
        _ = check({"drive": drive}).drive
    assert said in str(refusal.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            ["aging.rule=langevin", "aging.rate=0.1", "aging.x_star_final=2"],
            'thresholds of rule "langevin"',
        ),
        (
            ["contacts.count=100000000"],
            "contacts.count = 100000000: must be <= 2e+07 with drive.stage",
        ),
        (["drive.velocity=0"], "drive.velocity = 0.0: must not be 0 with a distance"),
    ],
)
def test_refused_by_run(path, tmp_path, changes, said):
    sets = [part for change in changes for part in ("--set", change)]
    done = call("run", path, "--out", tmp_path / "out", *sets)
    assert done.exit_code == 2
    assert said in done.output.replace("\n", " ")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["steady", "reference"])
def test_no_steady_state(path, command):
    done = call(command, path)
    assert done.exit_code == 2
    assert (
        "drive.stage: a slider that a spring pulls has no steady state"
        in done.output.replace("\n", " ")
    )


def test_slips_of_a_saw():
    """Three teeth, a slow decline and a rise that goes on: by hand."""
    t = np.array([0.0, 10.0, 10.5, 20.0, 20.5, 30.0, 30.5, 40.0, 60.0, 61.0])
    spring = np.array([0.0, 1.0, 0.4, 1.0, 0.4, 1.2, 0.2, 0.9, 0.3, 0.5])
    X = np.array([0.0, 1.0, 7.0, 8.0, 14.0, 15.0, 25.0, 26.0, 28.0, 28.5])
    found = slips_of(t, X, spring, 0.3, 0.1)
    assert [slip.drop for slip in found] == pytest.approx(
        [0.6, 0.6, 1.0], rel=1e-12, abs=0
    )
    assert [slip.t for slip in found] == pytest.approx(
        [10.25, 20.25, 30.25], rel=1e-12, abs=0
    )
    assert [slip.X for slip in found] == pytest.approx(
        [4.0, 11.0, 20.0], rel=1e-12, abs=0
    )
    assert [slip.distance for slip in found] == pytest.approx(
        [6.0, 6.0, 10.0], rel=1e-12, abs=0
    )
    assert slips_of(t, X, spring, 2.0, 0.1) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slips_that_a_record_cuts(sign):
    """A record that begins in a slip, and ends in another: by hand, forwards and
    backwards."""
    t = np.array([0.0, 0.5, 10.0, 10.1, 10.2])
    X, spring = (
        sign * np.array([0.0, 5.0, 6.0, 10.0, 593.0]),
        sign * np.array([1.0, 0.4, 1.0, 0.5, 0.2]),
    )
    first, last = slips_of(t, X, spring, 0.3, 0.1)
    assert (first.begun, first.ended, last.begun, last.ended) == (
        False,
        True,
        True,
        False,
    )
    assert [first.drop, last.drop] == pytest.approx([0.6, 0.8], rel=1e-12, abs=0)
    assert [first.distance, last.distance] == pytest.approx(
        [sign * 5.0, sign * 587.0], rel=1e-12, abs=0
    )
    assert slips_of(t, X, spring, 0.3, 1e4) == []  # the stage is as fast


def test_whole_slips_make_the_means():
    """Drop and period without the first slip and without one that is not over."""
    t = np.arange(9.0)
    X, spring = (
        np.cumsum([0.0, 0, 9, 0, 9, 0, 9, 0, 9]),
        np.array([0.0, 1, 0.2, 1, 0.3, 1, 0.5, 1, 0.1]),
    )
    found = slips_of(t, X, spring, 0.3, 0.1)
    assert [slip.ended for slip in found] == [True, True, True, False]
    mean = _mean_over(found, lambda slips: [slip.drop for slip in slips])
    assert (mean.value, mean.n) == (pytest.approx(0.6, rel=1e-12, abs=0), 2)


@pytest.mark.verification
def test_a_slip_that_is_not_over_is_listed(path, tmp_path):
    """The spring is stretched so far at first that the record begins in a slip, and
    ends in the second: both are listed and marked, in the table and in JSON, and the
    drop of the second is less than that of the same slip in a longer record."""
    ensemble = Ensemble(count=500, delay=Delay(1.0), stiffness_law="uniform")
    stage = Stage(0.1, damping=0.1, preload=20.0)
    whole = trajectory(
        ensemble, Programme([Segment(0.1, time=60.0)], stage=stage), points=61
    ).slips[1]
    time = whole.t + 0.1
    arguments = (
        "--set",
        "drive.stage.preload=20.0",
        "--set",
        f"drive.distance={0.1 * time}",
        "--no-exact",
    )
    done = call("run", path, "--out", tmp_path / "out", *arguments)
    assert done.exit_code == 0, done.output
    first, last = json.loads((tmp_path / "out" / "summary.json").read_text())["slips"]
    assert (first["begun"], first["ended"], last["begun"], last["ended"]) == (
        False,
        True,
        True,
        False,
    )
    assert whole.begun
    assert whole.ended
    assert 0.3 * whole.drop < last["drop"] < 0.9 * whole.drop
    shown = " ".join(done.output.split())
    assert "the record begins during slip 0: drop" in shown
    assert "the record ends during slip 1: drop" in shown
    assert "> 0." in shown


@pytest.mark.verification
def test_the_exact_peak_is_where_the_slider_is(path, tmp_path):
    """`exact.at` is the slider's displacement as `at` is, and not that of the stage:
    |z| < 4.5 of the error of `at`, 8 replicas. Negative control: where the stage is at
    that instant."""
    sets = (
        "output.replicas=8",
        "drive.distance=4.0",
        "drive.stage.stiffness=0.5",
        "output.points=81",
    )
    done = call(
        "run",
        path,
        "--out",
        tmp_path / "out",
        "--json",
        *(a for s in sets for a in ("--set", s)),
    )
    assert done.exit_code == 0, done.output
    segment = json.loads(done.stdout)["segments"][0]
    table = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")
    off = abs(segment["at"]["value"] - segment["exact"]["at"])
    assert off < 4.5 * segment["at"]["stderr"]
    stage = float(np.interp(segment["at"]["value"], table["X"], table["stage"]))
    assert abs(segment["at"]["value"] - stage) > 4.5 * segment["at"]["stderr"]
