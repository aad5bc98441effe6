"""The command line, in process where that is enough and as a real process where it
matters."""

import importlib.metadata
import inspect
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from command_line import call
from typer.testing import CliRunner
from waiting import has_worked, once

from eqsim import Drive, Table, load, steady
from eqsim.cli.app import app
from eqsim.cli.options import typed
from eqsim.errors import shown
from eqsim.estimate import OBSERVABLES, Estimate
from eqsim.io import terminal
from eqsim.io.terminal import Report, bar
from eqsim.numerics.kernel_folder import locked_folder
from eqsim.workflows.report import difference_of

RUN = """
title = "small"
[contacts]
count = 2000
[thermal]
kT = 0.1
[delay]
time = 1.0
[drive]
velocity = 0.1
distance = 10.0
[output]
points = 51
seed = 7
"""
RUNS = Path(__file__).parents[2] / "runs"
RECORD, TABLE = RUNS / "fit-basalt-step.toml", RUNS / "fit-synthetic.toml"
EQSIM = [sys.executable, "-c", "from eqsim.__main__ import main; main()"]


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "with space" / "small.toml"
    path.parent.mkdir()
    path.write_text(RUN)
    return path


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_run_writes_table_summary_and_picture(run_file):
    result = call("run", run_file)
    assert result.exit_code == 0, result.output
    assert "friction" in result.output
    out = run_file.parent / "out" / "small"
    assert tree(out) == ["force.png", "summary.json", "trajectory.parquet"]
    table = pq.read_table(out / "trajectory.parquet")
    assert table.column_names == [
        "X",
        "t",
        "force",
        "pinned",
        "force_stderr",
        "pinned_stderr",
    ]
    columns = {name: table[name].to_numpy() for name in table.column_names}
    np.testing.assert_allclose(columns["X"], np.linspace(0, 10, 51), rtol=1e-15)
    np.testing.assert_allclose(columns["t"], columns["X"] / 0.1, rtol=1e-15)
    origin = json.loads(table.schema.metadata[b"eqsim"])
    assert origin["run_file"] == RUN
    assert origin["seed"] == 7
    assert origin["settings"]["contacts"]["count"] == 2000
    assert set(origin["versions"]) == {"python", "eqsim", "numpy", "numba", "scipy"}
    summary = json.loads((out / "summary.json").read_text())
    assert {
        "friction",
        "pinned",
        "break_stretch",
        "lives",
        "engine_seconds",
        "threads",
        "seed",
        "versions",
    } <= set(summary)
    assert summary["force_reliable"]
    assert "force_stderr" not in result.output
    friction = summary["friction"]
    assert (
        abs(friction["value"] - summary["steady"]["friction"]["value"])
        < 5 * friction["stderr"]
    )
    assert (out / "force.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_what_was_not_seen_is_not_exact(run_file, tmp_path):
    result = call(
        "run",
        run_file,
        "--out",
        tmp_path / "o",
        "--set",
        "contacts.count=64",
        "--set",
        "drive.distance=1e-6",
    )
    (row,) = [line for line in result.stdout.splitlines() if "break_stretch" in line]
    assert "none seen" in row
    assert "exact" not in row
    blocks = "[elastic]\nblocks = 8\ncoupling = 1.0\ndrive_stiffness = 0.1\n"
    contacts = '[contacts]\ncount = 80\nstiffness_law = "uniform"\n'
    drive = "[drive]\nvelocity = 0.1\ndistance = 1e-3\n[output]\npoints = 5\n"
    path = tmp_path / "blocks.toml"
    path.write_text(contacts + blocks + drive)
    result = call("run", path, "--out", tmp_path / "o2")
    rows = [line for line in result.stdout.splitlines() if "none seen" in line]
    assert [row.split()[-2] for row in rows] == ["none", "none"]


@pytest.mark.parametrize(
    ("estimate", "expected", "said"),
    [
        (Estimate(1.0, 0.0, 9), Estimate(1.0, 0.0, 0), "exact"),
        (Estimate(1.0, 0.1, 9), Estimate(1.2, 0.0, 0), "-2.00"),
        (Estimate(None, None, 0), Estimate(1.0, 0.0, 0), "none"),
        (Estimate(1.0, None, 1), Estimate(1.0, 0.1, 0), "none"),
        (Estimate(1.0, 0.1, 9), Estimate(None, None, 0), "none"),
        (Estimate(1.0, 0.1, 9), None, "none"),
        # errors from 2, from 4, and from 3 and 5 batches
        (Estimate(10.0, 1.0, 9, 1), Estimate(0.0, 0.0, 0), "+1.86"),
        (Estimate(0.0, 0.0, 9), Estimate(2.0, 0.5, 0, 3), "-2.20"),
        (Estimate(0.0, 3.0, 9, 2), Estimate(10.0, 4.0, 9, 4), "-1.68"),
    ],
)
def test_differences_from_what_is_expected(estimate, expected, said):
    """Scores of Student's law where errors are of few batches, by Welch and
    Satterthwaite of both."""
    assert difference_of(estimate, expected) == said


def test_rounded_counts_and_times():
    """Counts that round to a thousand have the next letter, and 1e3 ms are a second."""
    printed = {999: "999", 999.6: "1 k", 999_400: "999 k", 999_999: "1 M", 0: "0"}
    assert {number: terminal.count(number) for number in printed} == printed
    printed = {0.9994: "999 ms", 0.9996: "1.0 s", 9.94: "9.9 s", 9.96: "10 s"}
    printed |= {119.0: "119 s", 120.0: "2.0 min"}
    assert {seconds: terminal.duration(seconds) for seconds in printed} == printed


@pytest.mark.parametrize(
    ("interface", "label"),
    [
        ("", "peak_force"),
        ("contacts_per_area = 0.1\n", "peak_shear_stress"),
        ("normal_load = 10.0\n", "peak_mu"),
    ],
)
def test_the_peak_is_called_what_it_is(run_file, tmp_path, interface, label):
    units = f'[units]\nforce = "mN"\n[interface]\n{interface}'
    run_file.write_text(run_file.read_text() + units)
    shown = call("run", run_file, "--out", tmp_path / "o").stdout
    assert re.findall(r"│ (peak_\w+) ", shown) == [label, "peak_X"]


def test_error_bars_that_cannot_be_trusted_say_so(tmp_path):
    """Three contacts; one threshold of 4000 is so strong that it would make most of the
    force's scatter."""
    (tmp_path / "broad.csv").write_text("threshold\n" + "1.0\n" * 3999 + "10.0\n")
    run = tmp_path / "broad.toml"
    run.write_text(
        '[contacts]\ncount = 3\n[thresholds]\nlaw = "table"\nfile = "broad.csv"\n[drive]\nvelocity = 1.0\n'
    )
    said = call("run", run, "--set", "output.points=11").output
    assert "force_stderr: not to be trusted" in said
    assert "unreliable" in said
    summary = json.loads((tmp_path / "out" / "broad" / "summary.json").read_text())
    assert not summary["force_reliable"]
    assert not summary["friction"]["reliable"]


def test_run_json_and_replicas(run_file, tmp_path):
    out = tmp_path / "o"
    result = call(
        "run",
        run_file,
        "--out",
        out,
        "--json",
        "--set",
        "output.replicas=4",
        "--seed",
        3,
    )
    summary = json.loads(result.stdout)
    assert summary == json.loads((out / "summary.json").read_text())
    assert summary["seed"] == 3
    other = steady(load(run_file).ensemble, Drive(0.1), seed=3)
    assert summary["steady"]["friction"] == other.friction.as_dict()
    table = pq.read_table(out / "trajectory.parquet")
    assert "force_replica_std" in table.column_names
    output = json.loads(table.schema.metadata[b"eqsim"])["settings"]["output"]
    assert output == {
        "points": 51,
        "seed": 3,
        "replicas": 4,
        "series": False,
        "breaks": False,
    }


def test_same_bytes_for_any_threads(run_file, tmp_path):
    files = []
    for threads in (1, 2):
        out = tmp_path / str(threads)
        assert (
            call("run", run_file, "--out", out, "--threads", threads, "--quiet").output
            == ""
        )
        files.append(
            [(out / name).read_bytes() for name in ("trajectory.parquet", "force.png")]
        )
    assert files[0] == files[1]


def test_steady_and_info(run_file):
    found = json.loads(call("steady", run_file, "--json", "--rel-error", "1e-4").stdout)
    assert set(found) == {*OBSERVABLES, "lives", "seed", "reached", "reference", "z"}
    assert all(
        abs(found["z"][name]) < 4.5 for name in ("friction", "pinned", "break_stretch")
    )
    assert set(found["friction"]) == {"value", "stderr", "n", "dof", "reliable"}
    assert found["friction"]["stderr"] <= 1e-4 * found["friction"]["value"]
    assert "relative error" in call("steady", run_file).output
    groups = json.loads(call("info", run_file, "--json").stdout)
    assert groups["b"] == pytest.approx(5.0, rel=1e-15, abs=0)
    assert groups["v tau/x_*"] == pytest.approx(0.1, rel=1e-15, abs=0)
    exact = json.loads(
        call(
            "info", run_file, "--json", "--set", "contacts.stiffness_law=uniform"
        ).stdout
    )["v_*"]
    # nt12
    assert exact == pytest.approx(
        3 * np.sqrt(np.pi) / 4 * (1 + 5 / 3) / 36, rel=1e-9, abs=0
    )
    assert "annealed ensemble" in call("info", run_file).output


def test_long_estimates_say_how_long(run_file, monkeypatch):
    """From the speed of the attempt before, here of a clock that ticks once a look:
    1000 lives a second."""
    seconds, notes, told = iter(range(100)), [], []
    monkeypatch.setattr(terminal.time, "perf_counter", lambda: float(next(seconds)))
    progress = terminal.announcing(lambda *both: told.append(both), notes.append)
    calls = [
        (0, 2000),
        (1000, 2000),
        (2000, 2000),
        (0, 20_000),
        (20_000, 20_000),
        (0, 10**6),
        (10**6, 10**6),
    ]
    for both in calls:
        progress(*both)
    assert told == calls
    # and 20 s are none worth a note
    assert notes == ["about 50 s to go: 1 M lives at 20 k/s"]
    monkeypatch.undo()
    monkeypatch.setattr(terminal, "LONG_ATTEMPT", 0.0)
    args = ("steady", run_file, "--rel-error", "2e-5")
    assert re.search(
        r"^about \S+ m?s to go: \S+ [kM] lives at \S+ [kM]/s\n", call(*args).stdout
    )
    assert "to go" not in call(*args, "--json").stdout


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ["--set", "contacts.cuont=5"],
            'contacts.cuont: unknown key; did you mean "count"?',
        ),
        (["--set", "thermal.kt=1"], 'thermal.kt: unknown key; did you mean "kT"?'),
        (["--set", "kt=1"], 'kt: unknown key; did you mean "thermal.kT"?'),
        (["--set", "aging.rate=1"], "aging.rule: is required with rate; must be"),
        (["--set", "thermal.kT=-1"], "thermal.kT = -1.0: must be a finite number >= 0"),
        (["--set", "thermal.kT=hot"], "thermal.kT = 'hot': must be a valid number"),
        (
            ["--set", "drive.velocity=0"],
            "drive.velocity = 0.0: must be a finite number > 0",
        ),
        (["--set", "drive.distance=0"], "drive.distance = 0.0"),
        (["--set", "nonsense"], "--set nonsense: must be section.key=value"),
        (["--set", ".count=1"], "--set .count=1: must be section.key=value"),
        (["--set", "output.points=1"], "points = 1: must be an integer from 2"),
        (["--set", "output.seed=-1"], "output.seed = -1: must be an integer from 0"),
        (
            ["--set", "thresholds.law=table", "--set", "thresholds.file=no.csv"],
            "no.csv: cannot be read",
        ),
        (["--set", "contacts.count=1000000000000"], "lives, more than --max-lives"),
        (["--max-lives", "100"], "more than --max-lives = 100"),
        (["--threads", "0"], "--threads = 0: must be an integer from 1"),
        (["--set", "drive.velocity=1e-300"], "must be a finite number"),
        (
            ["--set", "drive.distance=1e300"],
            "drive.distance = 1e+300: must be a finite number > 0",
        ),
        (["--set", "delay.time=1e300"], "delay"),
    ],
)
def test_bad_input(run_file, args, message):
    """One line on standard error, exit code 2, nothing on disk."""
    result = call("run", run_file, *args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert tree(run_file.parent) == ["small.toml"]


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (
            ["steady", "RUN", "--rel-error", "0"],
            "--rel-error = 0.0: must be a finite number > 0",
        ),
        (
            ["steady", "RUN", "--max-lives", "-1"],
            "--max-lives = -1.0: must be a finite number > 0",
        ),
        (
            ["steady", "RUN", "--max-lives", "10"],
            "this needs 6.55e+04 lives, more than --max-lives = 10",
        ),
        (["run", "RUN", "--max-lives", "10"], "more than --max-lives = 10"),
        (
            ["run", "RUN", "--seed", "-1"],
            "--seed = -1: must be an integer from 0 to 9223372036854775807",
        ),
        (
            ["run", "RUN", "--set", "output.seed=-1"],
            "output.seed = -1: must be an integer from 0",
        ),
        (
            ["reference", "RUN", "--transient", "--closure"],
            "--transient, --closure: only one of them",
        ),
        (
            ["material", "steel", "--temperature", "-1"],
            "--temperature = -1.0: must be a finite number >= 0",
        ),
        (
            ["material", "steel", "--toml", "--velocity", "0"],
            "--velocity = 0.0: must be a finite number > 0",
        ),
        (
            ["material", "steel", "--toml", "--disorder", "frozen"],
            "--disorder = 'frozen': must be one of",
        ),
        (
            ["material", "steel", "--velocity", "1"],
            "--velocity 1.0: is for the run file that --toml prints",
        ),
        (
            ["material", "steel", "--disorder", "x"],
            "--disorder x: is for the run file that --toml prints",
        ),
        (["rsf", "RUN", "--noise", "0.1"], "--noise 0.1: only of a CSV file"),
        (
            ["rsf", "x.csv", "--velocity", "1", "--noise", "-1"],
            "--noise = -1.0: must be",
        ),
        (["rsf", RECORD, "--starts", "0"], "--starts = 0: must be an integer"),
        (["rsf", RECORD, "--workers", "0"], "--workers = 0: must be an integer"),
        (["fit", TABLE, "--out", "x", "--data", "no.csv"], "--data = no.csv: cannot"),
        (["fit", RECORD, "--out", "x", "--data", "no.csv"], "--data = no.csv: cannot"),
        (["fit", TABLE, "--out", "x", "--data", "."], "--data = .: is not a file"),
        (
            ["fit", TABLE, "--out", "x", "--set", "fit.data=no.csv"],
            f"fit.data = {TABLE.with_name('no.csv')}: cannot",
        ),
    ],
)
def test_options_are_named_as_they_are_typed(run_file, args, said):
    result = call(*(run_file if arg == "RUN" else arg for arg in args))
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert result.stderr.startswith(f"eqsim: {said}") or said.startswith("more")
    assert said in result.stderr


def test_columns_of_a_file_are_no_options():
    said = "rec.csv, line 4: velocity = 'oops': must be a number"
    assert typed(said) == said
    assert typed("velocity = 0.0: must be") == "--velocity = 0.0: must be"


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("# x\nstrength (mN), area\n0.8,1\n1.2,2\n", Table([0.4, 0.6])),
        ("s [nm];a\n800;1\n1200;2\n", Table([0.8, 1.2])),
        ("0.8\n1.2\n", Table([0.8, 1.2])),
        ("no,strength\n-,uN\n1,800\n2,1200\n", Table([0.4, 0.6])),
        ("strength (Å)\n8000\n12000\n", Table([0.8, 1.2])),
        ("s,no\nangstrom,-\n8000,1\n12000,2\n", Table([0.8, 1.2])),
    ],
)
def test_a_new_run_file_of_measured_thresholds(text, law, tmp_path):
    """Strengths in mN of contacts of 2 N/mm are stretches in um; the stiffness is that
    of the mean strength."""
    (tmp_path / "s.csv").write_text(text)
    path = tmp_path / "mine.toml"
    given = ["--thresholds", tmp_path / "s.csv", "--stiffness", "2 N/mm"]
    given += ["--column", "strength"] * text.startswith("no")
    done = call("new", path, *given)
    assert done.exit_code == 0, done.output
    ensemble = load(path).ensemble
    assert ensemble.stiffness == pytest.approx(2.0, rel=1e-12, abs=0)
    assert ensemble.thresholds.steps == pytest.approx(law.steps, rel=1e-12, abs=0)
    again = call("new", path)
    assert (again.exit_code, again.stderr) == (2, f"eqsim: {path}: is there already\n")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["x.txt"], "x.txt: must end in .toml"),
        (["x.toml", "--stiffness", "2"], "--stiffness 2: must be a stiffness"),
        (["x.toml", "--thresholds", "no.csv"], "no.csv"),
        (["x.toml", "--stiffness", "1e400 N/m"], "contacts.stiffness = inf"),
        (["x.toml", "--column", "a"], "--column a: is for the file of --thresholds"),
        (["x.toml", "--thresholds", "negative.csv"], "line 2: '-1' must be"),
        (["x.toml", "--thresholds", "bare.csv"], "needs names of its columns"),
        (["x.toml", "--thresholds", "kgf.csv"], 'as in nm or mN; its unit is "kgf"\n'),
        (["x.toml", "--thresholds", "s.csv"], 'as in nm or mN; its unit is "s"\n'),
    ],
)
def test_bad_new_run_files(given, said, tmp_path, monkeypatch):
    """Options that cannot be used are refused before a file is there."""
    monkeypatch.chdir(tmp_path)
    Path("negative.csv").write_text("stretch (um)\n-1\n2\n")
    Path("bare.csv").write_text("1.0,2.0\n2.0,3.0\n")
    Path("kgf.csv").write_text("strength (kgf)\n1\n2\n")
    Path("s.csv").write_text("strength (s)\n1\n2\n")
    done = call("new", *given)
    assert done.exit_code == 2
    assert said in done.stderr
    assert not Path("x.toml").exists()


@pytest.mark.parametrize("name", ["mine.toml", "below/it.toml", 'my "best" ü\\.toml'])
@pytest.mark.parametrize("column", ["force (mN)", 'the "force"'])
def test_new_run_files_of_any_name(name, column, tmp_path, monkeypatch):
    """Names with quotes, and thresholds in another folder; one that is not there yet is
    made."""
    monkeypatch.chdir(tmp_path)
    quoted = column.replace('"', '""')
    Path("s.csv").write_text(f'"{quoted}"\n0.8\n1.2\n')
    done = call("new", name, "--thresholds", "s.csv", "--column", column)
    assert done.exit_code == 0, done.output
    file = load(name)
    assert file.title == Path(name).stem
    assert file["thresholds.column"] == column
    assert file.ensemble.thresholds.mean == pytest.approx(1.0, rel=1e-12, abs=0)


def test_keys_of_run_files():
    """Every section and every key of it has a meaning; others are refused."""
    sections = json.loads(call("keys", "--json").stdout)
    assert all(sections.values())
    for section in sections:
        keys = json.loads(call("keys", section or "title", "--json").stdout)
        assert keys
        assert all(key["meaning"] for key in keys.values()), section
    found = json.loads(call("keys", "thermal.barrier", "--json").stdout)
    assert found["barrier"]["values"].startswith('"soft", "stiff"')
    found = json.loads(call("keys", "contacts", "--json").stdout)
    assert "k_i = k sqrt(f_{si}/f_s), wide" in found["stiffness_law"]["meaning"]
    found = json.loads(call("keys", "thresholds", "--json").stdout)
    assert "deviation of ln xi, 0.001" in found["sigma"]["meaning"]
    assert "(x_*/x)^{exponent}, 3.05" in found["exponent"]["meaning"]
    assert "P_c(x) ~ x^{1+2n}" in found["law"]["meaning"]
    wrong = call("keys", "termal")
    assert wrong.exit_code == 2
    assert wrong.stderr.endswith('did you mean "thermal"?\n')


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--bad"], "--bad"),
        (["rnu"], "rnu"),
        (["run"], "RUN.toml"),
        (["run", "a", "b"], "b"),
        (["run", "a", "--bogus", "3"], "--bogus"),
        (["run", "a", "--threads", "two"], "'--threads': 'two' .*valid integer"),
        (["run", "a", "--seed", "1.5"], "'--seed': '1.5' .*valid integer"),
        (
            ["run", "a", "--max-lives", "many"],
            "'--max-lives': 'many' .*valid (float|number)",
        ),
        (["steady", "a", "--rel-error"], "--rel-error.* requires an argument"),
        (["sweep", "a"], "--out"),
    ],
)
def test_errors_of_usage_are_one_line_too(args, said):
    result = call(*args)
    assert result.exit_code == 2
    assert re.fullmatch(rf"eqsim: .*{said}.*; see `eqsim.* --help`\n", result.stderr)
    assert result.stdout == ""


def test_bad_files(tmp_path, run_file):
    for path, message in (
        (tmp_path / "none.toml", "cannot be read"),
        (tmp_path, "cannot be read"),
    ):
        result = call("run", path)
        assert result.exit_code == 2
        assert message in result.stderr
    occupied = tmp_path / "file"
    occupied.write_text("")
    for out in (occupied, occupied / "below"):
        result = call("run", run_file, "--out", out)
        assert result.exit_code == 2
        assert "--out" in result.stderr
        assert result.stderr.count("\n") == 1


def test_unwritable_folder(run_file, tmp_path):
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "nowhere" / "at all")
    # what is refused first needs no such work
    lives = ["--set", "contacts.count=1000000000000"]
    for out in (dangling, dangling / "below"):
        result = call("run", run_file, "--out", out, *lives)
        assert result.exit_code == 2
        assert result.stderr.endswith("dangling is not a folder\n")
    folder = tmp_path / "sealed"
    folder.mkdir(mode=0o500)
    if os.access(folder, os.W_OK):
        folder = "/proc/eqsim"  # the superuser may write anywhere but here
    result = call("run", run_file, "--out", folder)
    assert result.exit_code == 2
    assert "cannot be written" in result.stderr


@pytest.mark.parametrize(
    "command",
    [
        ["run", "RUN"],
        ["reference", "RUN", "--transient"],
        ["fluctuations", "RUN"],
        ["stability", "RUN"],
        ["fit", TABLE],
        ["rsf", RECORD],
        ["validate"],
    ],
    ids=lambda command: command[0],
)
def test_no_results_among_the_points_of_a_sweep(run_file, tmp_path, command):
    """Nor below them: all files there are read as points."""
    (tmp_path / "swept").mkdir()
    (tmp_path / "swept" / "_sweep.json").touch()
    given = [run_file if word == "RUN" else word for word in command]
    for out in (tmp_path / "swept", tmp_path / "swept" / "a" / "b"):
        done = call(*given, "--out", out)
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
        assert f"--out {out}: must be outside {tmp_path / 'swept'}" in done.stderr
    assert tree(tmp_path / "swept") == ["_sweep.json"]


@pytest.mark.long
def test_full_disk_leaves_nothing(run_file, tmp_path):
    """A process that may write no file above 4 KB: the table does not fit."""
    out = tmp_path / "deep" / "out"
    call("run", run_file, "--out", tmp_path / "warm")  # kernels are cached now

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    done = subprocess.run(
        [*EQSIM, "run", str(run_file), "--out", str(out)],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    assert not out.exists() or tree(out) == []


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_interrupt_leaves_nothing(run_file, tmp_path, number):
    """Ctrl-C, or a batch system's SIGTERM, in mid-run: 128 + its number, one line, no
    file."""
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*EQSIM, "run", str(run_file), "--out", str(out), "--threads", "1", "--set", "contacts.count=300000000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    once(lambda: has_worked(process, 0.5), process)
    process.send_signal(number)
    output, error = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert error == "eqsim: interrupted; nothing is half-written\n"
    assert output == ""
    assert not out.exists()


def test_help_needs_no_numba():
    """--help answers without the heavy imports."""
    heavy = {"matplotlib", "numba", "numpy", "pandas", "scipy"}
    code = f"import sys, eqsim.cli.app; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
    for args in (
        ["--help"],
        ["run", "--help"],
        ["steady", "--help"],
        ["info", "--help"],
    ):
        assert call(*args).exit_code == 0


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (0.9285132, 0.00076, "0.92851(76)"),
        (1.0, 0.0, "1"),
        (1.335049e-09, 3.9e-14, "1.335049(39)e-09"),
        (123.4, 20.0, "123(20)"),
        (2.5e7, 1.0e5, "2.500(10)e+07"),
        (0.0996, 0.000996, "0.0996(10)"),
        (1e-15, 4.1e-3, "0.0000(41)"),
    ],
)
def test_printed_errors(value, stderr, text):
    assert str(Estimate(value, stderr, 1)) == text


def test_reference_curves(tmp_path):
    """Transients as JSON columns; the closure of aging annealed contacts, and its
    refusal of others in one line."""
    path = tmp_path / "a.toml"
    path.write_text(
        'disorder = "annealed"\n[contacts]\nstiffness_law = "uniform"\n[thresholds]\nx_star = 0.5\n'
        '[aging]\nrule = "flow"\nrate = 0.1\nx_star_final = 1.0\n[drive]\nvelocity = 1.0\ndistance = 2.0\n'
        "[output]\npoints = 21\n"
    )
    for flag, extra in (("--transient", "pinned"), ("--closure", "mean_threshold")):
        result = CliRunner().invoke(app, ["reference", str(path), flag, "--json"])
        assert result.exit_code == 0, result.output
        columns = json.loads(result.stdout)
        assert {"X", "force", "breaks", "force_error", extra} <= set(columns)
        assert all(len(column) == 21 for column in columns.values())
        assert tree(tmp_path) == ["a.toml"]
        said = call("reference", path, flag, "--out", tmp_path / "o")
        name = flag.removeprefix("--") + ".parquet"
        assert f"{name}, {flag.removeprefix('--')}.png, 21 rows" in said.stdout
        assert said.stdout.count("\n") < 25
        assert (
            (tmp_path / "o" / name)
            .with_suffix(".png")
            .read_bytes()
            .startswith(b"\x89PNG")
        )
        table = pq.read_table(tmp_path / "o" / name)
        assert table.column_names == list(columns)
        assert table["force"].to_pylist() == columns["force"]
        again = call("replay", tmp_path / "o" / name)
        assert again.exit_code == 0, again.output
        shutil.rmtree(tmp_path / "o")
    assert call("reference", path, "--transient", "--quiet").exit_code == 0
    # where `run` puts its results
    assert tree(tmp_path / "out") == ["a", "a/transient.parquet", "a/transient.png"]
    for option in (("--out", tmp_path / "o"), ("--format", "pdf")):
        assert (
            "is for the table and the picture of --transient"
            in call("reference", path, *option).stderr
        )
    result = CliRunner().invoke(
        app, ["reference", str(path), "--closure", "--set", "disorder=quenched"]
    )
    assert result.exit_code == 2
    assert result.stderr.startswith("eqsim: disorder")
    assert result.stderr.count("\n") == 1


def words(text):
    """What stands there, without frames and line breaks."""
    return " ".join(re.sub("[│╭╮╰╯─]", " ", text).split())


COMMANDS = [info.callback.__name__ for info in app.registered_commands]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_what_is_written(command, monkeypatch):
    """Every word of docstrings, options and epilogs, also [sections], which rich takes
    for markup; -h is --help."""
    monkeypatch.setenv("COLUMNS", "300")
    (info,) = [
        info for info in app.registered_commands if info.callback.__name__ == command
    ]
    shown = call(command, "-h")
    assert shown.exit_code == 0
    assert shown.output == call(command, "--help").output
    written = [inspect.cleandoc(info.callback.__doc__), info.epilog or ""]
    for option in inspect.signature(info.callback).parameters.values():
        written.append(option.annotation.__metadata__[0].help)
    for text in written:
        for part in text.replace("\\[", "[").split("\n\n"):
            assert words(part) in words(shown.output)
    assert ("[sweep]" in shown.output) == (command == "sweep")
    assert ("[fit]" in shown.output) == (command == "fit")


def test_help_of_everything():
    for flag in ("-h", "--help"):
        shown = words(call(flag).output)
        assert "its [fit] section" in shown
        assert "the [sweep] table" in shown
        assert all(f" {command} " in shown for command in COMMANDS)
    assert (
        "python -m analysis.figures A01 --quick`"
        in call("figures", "A01", "--quick").stderr
    )
    assert "1e10" in call("run", "--help").output
    assert call("--version").stdout == f"eqsim {importlib.metadata.version('eqsim')}\n"


@pytest.mark.parametrize(
    "command",
    [
        "info",
        "steady",
        "reference",
        "run",
        pytest.param("sweep", marks=pytest.mark.long),
    ],
)
def test_mixed_units_are_doubted(command, tmp_path):
    """Thresholds in nm beside SI: one line on standard error, and the result all the
    same; none with the scale."""
    (tmp_path / "x.csv").write_text("xs_nm\n2.1\n1.9\n3.0\n")
    path = tmp_path / "a.toml"
    path.write_text(
        '[contacts]\ncount = 100\nstiffness = 4e5\n[thresholds]\nlaw = "table"\nfile = "x.csv"\n'
        "[thermal]\nkT = 4e-21\nattempt_frequency = 1e9\n[output]\npoints = 11\n"
        '[drive]\nvelocity = 1e-8\n[sweep]\n"drive.velocity" = [1e-8]\n'
    )
    for scale in ("1.0", "1e-9"):
        more = ["--out", tmp_path / scale, "--workers", 1] if command == "sweep" else []
        found = call(command, path, "--set", f"thresholds.scale={scale}", *more)
        assert found.exit_code == 0, found.output
        assert found.stderr.count("\n") == (scale == "1.0")
        if scale == "1.0":
            assert "warning: b = k x_*^2/(2 kT) = 2.72e+26" in found.stderr
            assert "heat changes nothing" in found.stderr
            assert "thresholds.scale = 1e-9" in found.stderr
    if command == "info":
        assert call(command, path, "--quiet").stderr == ""
        short = call(
            command, path, "--set", "thermal.kT=0", "--set", "drive.distance=1e-8"
        )
        assert "hardly any contact breaks" in short.stderr


def test_words_of_tables_are_explained():
    """One word for a difference in standard errors, and two for two kinds of errors."""
    for command in ("run", "steady", "validate", "sweep"):
        assert "z: difference from the expected value in standard errors" in words(
            call(command, "-h").output
        )
    shown = words(call("sweep", "-h").output)
    for word in (
        "_stderr, _reference_error and _z",
        "stderr: statistical",
        "error: bound of the error of a numerical",
    ):
        assert word in shown
    assert "f_k: F/(N_c k)" in words(call("reference", "-h").output)


WIDE = [
    (
        (
            "kind",
            "scores",
            "chi-square",
            "p",
            "largest |z|",
            "p (of so many)",
            "verdict",
        ),
        ("transient variance", "55", "49.1/46", "0.61", "2.48", "0.51", "passed"),
    ),
    (
        ("slip", "at t", "at X", "drop of the force", "takes", "over"),
        ("mean", "every 60.06(11)", "39.8891", "0.4600(17)", "3.60654", "4.9512"),
    ),
    (
        ("", "best", "68 %", "95 %", ""),
        (
            "thermal.attempt_frequency",
            "0.01123",
            "0.00995 to 0.0123",
            "0.00895 to 0.0143",
            "determined",
        ),
    ),
    (
        ("", "value", "unit", "meaning"),
        ("contact_radius", "4.7124e+05", "kg/m^3", "elastic correlation " * 6),
    ),
]


@pytest.mark.parametrize(("columns", "row"), WIDE)
@pytest.mark.parametrize("width", [1, 40, 60, 80])
def test_tables_break_no_word(columns, row, width, capsys, monkeypatch):
    """At 80 columns all fit; on a narrower terminal a table is wider than that rather
    than cut."""
    monkeypatch.setenv("COLUMNS", str(width))
    Report(None, "suite", columns, [row]).show()
    lines = capsys.readouterr().out.splitlines()[1:]
    assert len({len(line) for line in lines}) == 1
    assert width < 80 or len(lines[0]) <= 80
    shown = re.findall(r"[^\s┃│┏┓┗┛━┳┻┡┩╇└┘─┴]+", "\n".join(lines))
    assert sorted(shown) == sorted(" ".join([*columns, *row]).split())


@pytest.mark.parametrize(
    "command",
    [("info",), ("reference",), ("steady",), ("run", "--out", "o"), ("material",)],
)
def test_tables_of_commands_fit(command, run_file, tmp_path, monkeypatch):
    """On a terminal of 80 columns, and in a file."""
    monkeypatch.chdir(tmp_path)
    target = "steel" if command == ("material",) else run_file
    for width in (80, 100):
        monkeypatch.setenv("COLUMNS", "80")
        if width == 100:
            monkeypatch.delenv("COLUMNS")
        shown = call(command[0], target, *command[1:])
        assert shown.exit_code == 0, shown.output
        table = [line for line in shown.stdout.splitlines() if line[:1] in "┏┃│└"]
        assert table
        assert max(map(len, table)) <= width


@pytest.mark.parametrize(("least", "long"), [(0.0, True), (60.0, False)])
def test_the_bar_tells_of_compiling_that_takes_time(monkeypatch, capsys, least, long):
    """And of nothing where kernels are known."""
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal, to rich
    monkeypatch.setattr(terminal, "_COMPILING", least)
    for turn in ("compiled", "known"):
        with bar("simulating", False, "lives") as progress:
            if turn == "compiled":
                with locked_folder("test"):
                    time.sleep(0.3)  # ten looks a second
            progress(1, 2)
        assert ("compiling kernels" in capsys.readouterr().err) == (
            long and turn == "compiled"
        )


@pytest.mark.parametrize("text", ["", "  "])
@pytest.mark.parametrize(
    "words",
    [
        "run RUN --out", "sweep RUN --out", "reference RUN --transient --out", "stability RUN --out",
        "fluctuations RUN --out", "validate --out", "fit RUN --out", "export RUN --out",
        "plot RUN --out", "run", "info", "replay", "export", "plot", "fit RUN --out x --data",
        "fit RUN --out x --compare", "design RUN --for a --fit",
    ],
)  # fmt: skip
def test_no_path_is_empty(tmp_path, monkeypatch, words, text):
    """As an unset variable of a shell leaves it: one line, exit code 2, and nothing in
    the current folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("[drive]\nvelocity = 1.0\n")
    done = CliRunner().invoke(app, [*words.replace("RUN", "a.toml").split(), text])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
    assert "must be the name of a file or folder" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]


@pytest.mark.parametrize("text", ["", " ", "x" * 256], ids=["", " ", "long"])
@pytest.mark.parametrize(
    ("section", "command", "key"),
    [
        ('[thresholds]\nlaw = "table"\nfile = "{}"\n[drive]\nvelocity = 1.0\n', "info", "thresholds.file"),
        ('[drive]\nfile = "{}"\n', "info", "drive.file"),
        ('[drive]\nvelocity = 1.0\n[sweep]\nfile = "{}"\n', "sweep", "sweep.file"),
        ('[drive]\nvelocity = 1.0\n[fit]\ndata = "{}"\nfree."thresholds.n" = {{bounds = [0.5, 2.0]}}\n', "fit",
         "fit.data"),
        ('[drive]\nvelocity = 1.0\n[fit]\nrecord.file = "{}"\nfree."thresholds.n" = {{bounds = [0.5, 2.0]}}\n', "fit",
         "fit.record.file"),
    ],
)  # fmt: skip
def test_what_is_no_name_of_a_file(tmp_path, section, command, key, text):
    (tmp_path / "a.toml").write_text(section.format(text))
    more = [] if command == "info" else ["--out", str(tmp_path / "x")]
    done = CliRunner().invoke(app, [command, str(tmp_path / "a.toml"), *more])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
    assert f"{key} = {shown(text)}: must be the name of a file" in done.stderr
