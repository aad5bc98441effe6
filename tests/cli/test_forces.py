"""Forces and motors in run files: pictures of bursts and avalanches, and sweeps."""

import json

import numpy as np
import pandas as pd
import pytest
from cases import chosen
from command_line import call

from eqsim import bursts, lifetime, load, run

BUNDLE = """
[contacts]
count = 5000
stiffness_law = "uniform"
[thresholds]
law = "weibull"
shape = 2.0
[delay]
time = inf
[drive]
force_rate = 0.5
time = 1.0
[output]
points = 21
replicas = 2
"""
CLUSTER = """
[contacts]
count = 10
[thresholds]
law = "none"
[thermal]
barrier = "bell"
off_rate = 1.0
force_scale = 1.0
[delay]
time = inf
[drive]
force = 0.5
time = 40.0
[output]
points = 21
replicas = 4000
"""
MOTOR = """
[contacts]
count = 10
[thermal]
kT = 0.2
[thresholds]
law = "delta"
[delay]
time = 1.0
law = "exponential"
[drive]
velocity = 1.0
stall_force = 2.0
time = 20.0
[drive.stage]
stiffness = 0.1
[output]
points = 101
replicas = 4
[sweep]
"drive.stage.stiffness" = [0.1, 10.0]
"""


def test_a_run_of_a_bundle_draws_its_bursts(tmp_path):
    path = tmp_path / "bundle.toml"
    path.write_text(BUNDLE)
    done = call("run", path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "avalanches.png").stat().st_size > 0
    listed = pd.read_parquet(tmp_path / "out" / "avalanches.parquet")
    assert listed["breaks"].sum() == 2 * 5000
    exact = bursts(path)
    assert exact.size.tolist() == [*range(1, 1001)]
    single = np.sum(listed["breaks"] == 1) / 1e4
    assert abs(single - exact.number[0]) < 4.5 * np.sqrt(exact.number[0] / 1e4)


RE_ATTACHED = {"delay.time": 1.0, "drive.time": 0.75}
AT_ONCE = {"drive.force_rate": None, "drive.force": 0.7}
NOT_TO_THE_END = {"drive.time": 0.5}


@chosen("changes", [{}, RE_ATTACHED, AT_ONCE, NOT_TO_THE_END], [{}, NOT_TO_THE_END])
def test_the_law_of_bursts_is_that_of_a_force_that_is_raised(changes, tmp_path):
    """From 0 until all contacts are broken for ever; others are drawn without a law."""
    path = tmp_path / "bundle.toml"
    path.write_text(BUNDLE.replace("count = 5000", "count = 200"))
    axes = run(path, changes=changes).figures("")["avalanches"].axes[0]
    assert axes.get_ylabel().startswith("bursts over contacts")
    laws = [line for line in axes.lines if line.get_label().startswith("infinitely")]
    assert len(laws) == (not changes)


def test_a_motor_without_a_stage_has_no_picture_of_bursts(tmp_path):
    """Its contacts form again and break as often as the run is long."""
    path = tmp_path / "motor.toml"
    path.write_text(
        "[contacts]\ncount = 100\n[drive]\nvelocity = 1.0\nstall_force = 2.0\n"
        "time = 3.0\n[output]\npoints = 5\n"
    )
    found = run(path)
    assert found.trajectory.avalanches["breaks"].size > 0
    assert [*found.figures("")] == ["force"]


COLD, WARM, EQUAL = {}, {"thermal.kT": 0.05}, {"thresholds.law": "delta"}


@chosen("changes", [COLD, WARM, EQUAL], [COLD, EQUAL])
def test_a_run_behind_a_stage_draws_its_avalanches(changes, tmp_path):
    """Beside the law of contacts that only force breaks, one after the other."""
    path = tmp_path / "stage.toml"
    path.write_text(
        "[contacts]\ncount = 200\n[drive]\nvelocity = 1.0\ndistance = 5.0\n"
        "[drive.stage]\nstiffness = 0.5\n[output]\npoints = 11\n"
    )
    figure = run(path, changes=changes).figures("")["avalanches"]
    (_, *texts) = figure.axes[0].get_legend_handles_labels()[1][::-1]
    assert texts == ["infinitely many contacts, exact"] * (not changes)


@pytest.mark.verification
def test_a_sweep_of_motors_has_their_mean_force(tmp_path):
    path = tmp_path / "motor.toml"
    path.write_text(MOTOR)
    done = call("sweep", path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(tmp_path / "out")
    assert table["status"].tolist() == ["ok", "ok"]
    assert (table["friction"] > 0.0).all()
    assert (table["friction"] < 2.0).all()
    assert (table["friction_stderr"] > 0.0).all()


def test_the_lifetime_of_a_run_file(tmp_path):
    path = tmp_path / "cluster.toml"
    path.write_text(
        "[contacts]\ncount = 10\n[thermal]\nkT = 0.2\n[thresholds]\nlaw = 'delta'\n"
        "[delay]\ntime = inf\n[drive]\nforce = 0.3\ntime = 50.0\n[output]\npoints = 5\n"
    )
    file = load(path)
    found = lifetime(path)
    assert found.t.size == 5
    assert repr(found) == repr(lifetime(file.ensemble, file.drive, points=5))


def test_a_run_of_contacts_that_never_form_again_has_a_peak_and_no_averages(tmp_path):
    path = tmp_path / "bundle.toml"
    drive = "[drive]\nvelocity = 1.0\ndistance = 3.0\n"
    path.write_text(f"[contacts]\ncount = 1000\n[delay]\ntime = inf\n{drive}")
    done = call("run", path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "contacts never form again" in done.output
    assert "peak_force" in done.output
    assert "break_stretch" not in done.output
    assert "unreliable" not in done.output


@pytest.mark.verification
def test_a_run_under_a_force_tells_when_it_lets_go(tmp_path):
    """Lifetimes of clusters beside the exact one, the strength of a bundle, and no mean
    field of a few bonds, which would take minutes."""
    path = tmp_path / "cluster.toml"
    path.write_text(CLUSTER)
    done = call("run", path, "--json", "--out", tmp_path / "out")
    found = json.loads(done.stdout)
    exact = lifetime(path).mean.value
    life = found["lifetime"]
    assert abs(life["value"] - exact) < 4.5 * life["stderr"]
    assert abs(life["value"] - 1.05 * exact) > 4.5 * life["stderr"]
    shown = call("run", path, "--out", tmp_path / "out")
    assert f"{exact:.10g}" in shown.stdout
    assert "4000 of 4000 replicas let go" in shown.stdout
    assert "these are 10" in shown.stdout
    path.write_text(BUNDLE)
    strength = call("run", path, "--json", "--out", tmp_path / "out").stdout
    found = json.loads(strength)["strength"]
    assert abs(found["value"] - 0.5 * json.loads(strength)["lifetime"]["value"]) < 1e-12
    # a weakest link, N = 5000
    assert 0.95 < found["value"] / bursts(path).strength < 1.05


HELD = """
[contacts]
count = 2000
stiffness_law = "uniform"
[drive]
force = 0.5
time = 10.0
[output]
points = 3
replicas = 8
"""


def test_a_slider_that_a_force_does_not_tear_off_shows_where_it_stands(tmp_path):
    path = tmp_path / "held.toml"
    path.write_text(HELD)
    said = call("run", path, "--out", tmp_path / "out").stdout
    assert "0 of 8 replicas let go" in said
    X, pinned = (
        next(line for line in said.splitlines() if f"{name} at the end" in line)
        for name in ("X", "pinned")
    )
    z = float(X.split("│")[4])
    assert abs(z) < 4.5  # false alarm 7e-6
    assert "exact" not in pinned


@chosen("count", [2000, 20_001], [2000])  # by events, and step by step
def test_a_slip_without_end_is_refused(count, tmp_path):
    path = tmp_path / "torn.toml"
    path.write_text(HELD.replace("force = 0.5", "force = 2.0"))
    more = "--set", f"contacts.count={count}", "--set", "output.replicas=1"
    found = call("run", path, "--out", tmp_path / "out", *more, "--no-exact")
    assert found.exit_code == 2
    assert found.stderr.startswith("eqsim: drive.force: contacts that form again")
    assert not (tmp_path / "out" / "summary.json").exists()
