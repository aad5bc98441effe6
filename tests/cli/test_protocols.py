"""Programmes from the command line: run, replay, sweep, plot, info, reference."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from cases import chosen
from command_line import call
from scipy import signal

from eqsim import Programme, Segment, Thermal, load
from eqsim.engine.readings import Forces, extreme, shown_by, velocity_step
from eqsim.engine.records import observed
from eqsim.estimate import z_score
from eqsim.master.transient import transient
from eqsim.model.ensemble import Ensemble
from eqsim.model.healing import healing_law

RUN_FILE = """
title = "Steps and a hold"
[contacts]
count = 3000
stiffness_law = "uniform"
[thermal]
kT = 0.1
[drive]
start = "stationary"
velocity = 0.1
programme = [
    { velocity = 0.1, distance = 1.0, points = 10 },
    { velocity = 1.0, distance = 2.0, points = 40 },
    { hold = 100.0, points = 10 },
    { velocity = 1.0, distance = 1.0, points = 20 },
]
[output]
points = 81
[sweep]
"drive.programme.2.hold" = [1.0, 100.0]
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(RUN_FILE)
    return file


def test_run_and_replay(path, tmp_path):
    """Table, files and JSON of a programme; split over processes, and run again: the
    same bits."""
    out = tmp_path / "out"
    result = call("run", path, "--out", out)
    assert result.exit_code == 0, result.output
    assert "hold" in result.output
    assert "velocity step of segment 1" in result.output
    columns = pd.read_parquet(out / "trajectory.parquet")
    assert list(columns) == [
        "segment",
        "X",
        "t",
        "force",
        "pinned",
        "force_stderr",
        "pinned_stderr",
    ]
    assert columns.groupby("segment").size().tolist() == [11, 40, 10, 20]
    summary = json.loads((out / "summary.json").read_text())
    assert [segment["velocity"] for segment in summary["segments"]] == [
        0.1,
        1.0,
        0.0,
        1.0,
    ]
    for segment in summary["segments"]:
        assert (
            abs(segment["end"]["value"] - segment["exact"]["end"])
            < 4.5 * segment["end"]["stderr"]
        )
    assert (out / "force.png").stat().st_size > 10_000
    shared = tmp_path / "shared"
    done = call("run", path, "--out", shared, "--workers", 2, "--no-exact", "--json")
    for segment, same in zip(
        json.loads(done.output)["segments"], summary["segments"], strict=True
    ):
        del same["exact"]
        assert segment == same
    again = call("replay", out / "trajectory.parquet")
    assert again.exit_code == 0, again.output


@pytest.mark.verification
def test_healing_per_decade(tmp_path):
    """Three holds in one run: printed, drawn and in JSON, beside the fit of the values."""
    motion, holds = (
        "{velocity = 1.0, distance = 3.0, points = 60}",
        (10.0, 100.0, 1000.0),
    )
    moves = ", ".join(f"{{hold = {t}, points = 9}}, {motion}" for t in holds)
    text = RUN_FILE[: RUN_FILE.index("[drive]")]
    text += "[aging]\nrule = 'logarithmic'\nbeta = 0.05\ncutoff_time = 0.1\n"
    text += f"[drive]\nvelocity = 1.0\nstart = 'stationary'\nprogramme = [{moves}]\n"
    (tmp_path / "run.toml").write_text(text)
    done = call("run", tmp_path / "run.toml", "--no-exact", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "per decade, logarithmic beyond" in done.output
    assert (tmp_path / "out" / "healing.png").stat().st_size > 10_000
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    found = [segment["healing"] for segment in summary["segments"][1::2]]
    columns = ([one[name] for one in found] for name in ("value", "stderr"))
    law = healing_law(np.array(holds), *map(np.array, columns))
    assert summary["healing"] == json.loads(json.dumps(law.as_dict()))


def test_healing_is_fitted_by_its_logarithm():
    """Of 500 noisy logarithms rate and cutoff scatter by what is quoted, or less, as
    errors grow with chi-square (rms 1 within 4.5/sqrt(1000)), and 1 in 1000 is called
    none (7 in 500 for 6e-7); a root of time is called none. Two holds have no law."""
    rng, t, error = (
        np.random.default_rng(1),
        np.geomspace(1.0, 1e4, 7),
        np.full(7, 1e-3),
    )
    truth, z, none = 0.02 * np.log10(1.0 + t / 5.0), [], 0
    for _ in range(500):
        law = healing_law(t, truth + error * rng.normal(size=7), error)
        cutoff = law.cutoff
        off = np.log(cutoff.value / 5.0) * cutoff.value / cutoff.stderr
        z.append(((law.rate.value - 0.02) / law.rate.stderr, off))
        none += not law.logarithmic
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.7) & (rms < 1.15))
    assert none <= 6
    assert not healing_law(t, 1e-3 * np.sqrt(t), error).logarithmic
    assert healing_law(t[:2], truth[:2], error[:2]) is None
    for falls in (0.03 - 5e-3 * np.log10(t), 0.03 - 5e-3 * np.arange(7)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert healing_law(t, falls, error) is None
    # contacts that weaken; least squares are searched for to some 1e-8
    few = 10.0 ** np.arange(3), 0.01 * np.arange(1.0, 4.0), error[:3]
    up, down = (healing_law(few[0], sign * few[1], few[2]) for sign in (1.0, -1.0))
    assert down.rate.value == pytest.approx(-up.rate.value, rel=1e-6, abs=0)
    doubtful = up._replace(cutoff=replace(up.cutoff, reliable=False))
    assert doubtful.told(unit="s") == up.told(unit="s")[:-1] + ", unreliable)"


@pytest.mark.long  # 20 s: the default suite has to end in time on a machine that others use as well
def test_sweep_and_plot(path, tmp_path):
    """One row per hold time, every segment beside its reference; the peak grows with
    the hold."""
    out = tmp_path / "healing"
    assert call("sweep", path, "--out", out).exit_code == 0
    table = pd.read_parquet(out / "sweep.parquet")
    assert table["kind"].tolist() == ["programme"] * 2
    assert table["drive.programme.2.hold"].tolist() == [1.0, 100.0]
    for name in ("end", "peak"):
        z = table[[f"segment_{index}_{name}_z" for index in range(4)]]
        assert np.abs(z.to_numpy()).max() < 4.5
    assert table["segment_1_direct"].notna().all()
    assert table["segment_3_direct"].isna().all()
    short, long = table["segment_3_peak"]
    assert long - short > 5 * table["segment_3_peak_stderr"].max()
    plotted = call(
        "plot", out, "--x", "drive.programme.2.hold", "--y", "segment_3_peak"
    )
    assert plotted.exit_code == 0, plotted.output
    assert call("replay", out / "sweep.parquet").exit_code == 0


@pytest.mark.verification
def test_reference_and_info(path):
    curve = json.loads(call("reference", path, "--transient", "--json").output)
    assert len(curve["force"]) == len(curve["t"]) == 81
    groups = json.loads(call("info", path, "--json").output)
    assert groups["segments"] == 4
    assert groups["slowest/fastest"] == pytest.approx(0.1, rel=1e-12, abs=0)


@pytest.mark.parametrize(
    "command", [("steady",), ("reference",), ("reference", "--closure")]
)
def test_what_has_no_steady_state(path, command):
    result = call(command[0], path, *command[1:])
    assert result.exit_code == 2
    assert (
        "drive.programme, drive.file or drive.time: has no steady state; this needs"
        in result.output
    )


def test_bad_programmes_leave_nothing(path, tmp_path):
    out = tmp_path / "out"
    for change, message in (
        (
            "drive.programme.1.velocity=0.0",
            "drive.programme.1.velocity = 0.0: must not be 0 with a distance",
        ),
        (
            "drive.programme.2.hold=-1.0",
            "drive.programme.2.hold = -1.0: must be a finite number > 0",
        ),
        ("drive.programme.7.hold=1.0", "drive.programme.7.hold"),
    ):
        result = call("run", path, "--out", out, "--set", change)
        assert result.exit_code == 2
        assert message in " ".join(result.output.split())
        assert not out.exists()
    result = call("run", path, "--out", tmp_path / "never", "--max-lives", 10)
    assert result.exit_code == 2
    assert "more than --max-lives = 10" in result.output


@pytest.mark.verification
def test_recorded_drive(path, tmp_path):
    t = np.linspace(0.0, 10.0, 21)
    pd.DataFrame({"t": t, "X": np.sin(t)}).to_csv(tmp_path / "drive.csv", index=False)
    start, end = RUN_FILE.index("programme = ["), RUN_FILE.index("[output]")
    path.write_text(RUN_FILE[:start] + 'file = "drive.csv"\n' + RUN_FILE[end:])
    result = call("run", path, "--out", tmp_path / "out", "--set", "sweep={}", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.output)["segments"]
    assert len(found) == 20
    assert found[-1]["X"] == pytest.approx(np.sin(10.0), rel=0, abs=1e-12)
    worst = max(
        abs(s["end"]["value"] - s["exact"]["end"]) / s["end"]["stderr"] for s in found
    )
    assert worst < 5  # 20 scores


STEPS = {
    ("uniform", 0.1, 1.0): (0.01588, 0.01357),
    ("uniform", 1.0, 0.1): (0.01585, 0.01354),
    ("sqrt", 0.1, 1.0): (0.01353, 0.02967),
    ("sqrt", 1.0, 0.1): (0.01380, 0.02993),
}


@pytest.mark.verification
@chosen("case", STEPS, [("uniform", 0.1, 1.0), ("sqrt", 1.0, 0.1)])
def test_effects_of_velocity_steps(case):
    """Direct effect, evolution effect and memory length of the exact means: numbers of
    a solution by another program, quenched contacts, kT = 0.1, soft; also where
    friction falls with velocity by more than the direct effect."""
    (law, before, after), (direct, evolution) = case, STEPS[case]
    ensemble = Ensemble(thermal=Thermal(0.1), stiffness_law=law)
    programme = Programme([Segment(after, distance=8.0)], "stationary", before)
    exact = transient(ensemble, programme, 1601)
    grid = programme.grid(1601)
    (segment,) = shown_by(programme, grid, Forces(exact.force, exact.force_error))
    allowed = 1e-5 + 2 * exact.force_error.max() / np.log(10)
    found = segment.step.direct.value, segment.step.evolution.value
    assert found == pytest.approx((direct, evolution), rel=0, abs=allowed)
    assert 0.4 < segment.step.memory.value < 0.8


@pytest.mark.parametrize("sigma", [0.005, 0.05])
def test_peaks_of_noise_are_not_too_high(sigma):
    """Peaks of 1000 noisy copies of a parabola, whose noise wanders over 0.7 as that of
    contacts does: the mean is off by less than a quarter of the quoted error, the
    largest value itself by more, and the scatter is what is quoted."""
    rng, x = np.random.default_rng(1), np.linspace(0.0, 2.0, 81)
    truth, keep = 1.0 - 0.5 * (x - 1.2) ** 2, np.exp(-x[1] / 0.7)
    steps = rng.normal(size=(1000, x.size)) * np.append(
        1.0, np.full(x.size - 1, np.sqrt(1.0 - keep**2))
    )
    noise = sigma * signal.lfilter([1.0], [1.0, -keep], steps)
    error = np.full(x.size, sigma)
    peaks = [extreme(x, Forces(truth + one, error))[0] for one in noise]
    value, quoted = (
        np.array([peak.value for peak in peaks]),
        np.mean([peak.stderr for peak in peaks]),
    )
    off = abs(value.mean() - 1.0)
    assert off < 0.25 * quoted
    assert off < 0.5 * ((truth + noise).max(axis=1).mean() - 1.0)
    # 1000 scores of rms 1: within 4.5 of its scatter 1/sqrt(2000), and what the
    # parabola may add to an error
    assert 0.85 < np.sqrt(np.mean((value - 1.0) ** 2)) / quoted < 1.1


def test_errors_of_differences_know_that_forces_are_correlated():
    """Relaxation, healing, drop and effects of 400 noisy records of a slide-hold-slide
    test and a step, in 16 parts whose noise wanders over 3: the scatter is what is quoted
    (scores that are normal, of rms 1 within 4.5/sqrt(800) for 7e-6); as if forces were
    independent, errors of healing are more than 1.5 times as large."""
    moves = [Segment(1.0, distance=1.0), Segment(time=1.0), Segment(1.0, distance=1.0)]
    programme = Programme([*moves, Segment(2.0, distance=1.0)], "stationary", 1.0)
    grid, rng, keep = programme.grid(161), np.random.default_rng(5), np.exp(-1 / 120)
    fall, rise, jump = (np.clip(40 * grid.t / 40 - t, 0, 1) for t in (1, 2, 3))
    truth = 1.0 - 0.4 * fall + 0.5 * np.minimum(1, 4 * rise) - 0.1 * rise
    truth += 0.2 * np.minimum(1, 4 * jump) - 0.1 * jump
    scores, ratios = [], []
    for _ in range(400):
        steps = rng.normal(size=(16, grid.t.size)) * np.sqrt(1 - keep**2)
        steps[:, 0] = rng.normal(size=16)
        parts = truth + 0.02 * signal.lfilter([1.0], [1.0, -keep], steps)
        error = np.full(grid.t.size, 0.02 / 4)
        forces = Forces(parts.mean(axis=0), error, parts)
        found = [observed(one) for one in shown_by(programme, grid, forces)]
        exact = [
            observed(o) for o in shown_by(programme, grid, Forces(truth, 0 * error))
        ]
        names = ((1, "relaxation"), (2, "healing"), (3, "a_minus_b"), (3, "direct"))
        scores.append([z_score(found[i][n], exact[i][n].value) for i, n in names])
        apart = observed(shown_by(programme, grid, forces._replace(parts=None))[2])
        ratios.append(apart["healing"].stderr / found[2]["healing"].stderr)
    assert np.abs(np.sqrt(np.mean(np.square(scores), axis=0)) - 1.0).max() < 0.16
    assert np.mean(ratios) > 1.5


@pytest.mark.parametrize("sigma", [0.003, 0.02])
def test_places_of_peaks_are_where_the_force_is(sigma):
    """A peak that rises steeply and falls slowly, as after a hold, in 1000 noisy
    records: the value is that of the record at the place that is told, within two
    standard errors, and the place is off by less than its error in the mean square, by
    less than four of them ever."""
    rng, x = np.random.default_rng(2), np.linspace(0.0, 2.0, 101)
    truth, keep, peak = (
        0.4 * (1.0 - np.exp(-x / 0.08)) - 0.05 * x,
        np.exp(-x[1] / 0.7),
        0.08 * np.log(100.0),
    )
    steps = rng.normal(size=(1000, x.size)) * np.append(
        1.0, np.full(x.size - 1, np.sqrt(1.0 - keep**2))
    )
    records = truth + sigma * signal.lfilter([1.0], [1.0, -keep], steps)
    error = np.full(x.size, sigma)
    found = [extreme(x, Forces(record, error), 1.0) for record in records]
    at = np.array([place.value for _, place in found])
    there = np.array(
        [np.interp(place, x, record) for place, record in zip(at, records, strict=True)]
    )
    value = np.array([top.value for top, _ in found])
    assert np.abs(there - value).max() <= 2.0 * sigma
    z = (at - peak) / np.array([place.stderr for _, place in found])
    assert np.sqrt(np.mean(z**2)) < 1.0
    assert np.abs(z).max() < 4.0


def test_memory_of_an_exponential():
    """A peak that relaxes with length 0.7: read off to a grid's step, and its effects."""
    x = np.linspace(0.0, 8.0, 801)
    force = (
        1.0
        - 0.1 * np.log(10)
        + 0.2 * np.log(10) * np.where(x > 0, np.exp(-x / 0.7), 0.0)
    )
    forces = Forces(force, np.full(x.size, 1e-9))
    step = velocity_step(x, forces, extreme(x, forces, 1.0), 10.0)
    assert step.memory.value == pytest.approx(0.7, rel=0, abs=0.01)


def test_run_files_of_the_repository(tmp_path):
    for name in ("velocity-step", "slide-hold-slide", "reversal"):
        file = load(
            __import__("pathlib").Path(__file__).parents[2] / "runs" / f"{name}.toml"
        )
        assert isinstance(file.drive, Programme)
