"""Tables as CSV: what they hold, what their comments say, and where they are written."""

import glob
import json
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import call

from eqsim import Units, load, run, sweep
from eqsim.catalogue import KEYS
from eqsim.fitting.record import read_record
from eqsim.fitting.section import section_of
from eqsim.io import csv, storage
from eqsim.io.export import meaning
from eqsim.io.runfile import check
from eqsim.io.tables import read_drive

THREADS = """
import os, sys
from pathlib import Path
import eqsim
from eqsim.io.export import as_csv
from eqsim.io.runfile import check
from eqsim.sweeps.plan import Plan
from eqsim.workflows.replay import _REPEAT, _replayed_table
file, out, rows = map(Path, sys.argv[1:])
readers = {
    "export": lambda: as_csv([out / "sweep.parquet"]),
    "plan": lambda: Plan(check({"sweep": {"file": str(rows)}})),
    "sweep": lambda: eqsim.sweep(file, out=out, workers=1, progress=False),
    "replay": lambda: _replayed_table(out / "sweep.parquet", _REPEAT),
}
for name, read in readers.items():
    before = os.listdir("/proc/self/task")
    read()
    assert os.listdir("/proc/self/task") == before, name
"""
RUN = """title = "small # not a comment"
[contacts]
count = 100
[drive]
velocity = 0.1
distance = 5.0
[output]
points = 11
[sweep]
"drive.velocity" = [0.1, 1.0]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    (folder / "a.toml").write_text(RUN)
    for command in (("run",), ("sweep", "--out", folder / "swept", "--workers", 1)):
        done = call(command[0], folder / "a.toml", *command[1:])
        assert done.exit_code == 0, done.output
    return folder


def same(csv, parquet):
    """Whether pandas reads the same values, to the last bit."""
    found, known = pd.read_csv(csv, comment="#"), pd.read_parquet(parquet)
    pd.testing.assert_frame_equal(found, known, check_dtype=False, check_exact=True)
    return True


def test_a_run(made, tmp_path):
    table = made / "out" / "a" / "trajectory.parquet"
    done = call("export", table, "--out", tmp_path / "mine.csv", "--json")
    assert done.exit_code == 0, done.output
    assert len(json.loads(done.stdout)["files"]) == 1
    assert same(tmp_path / "mine.csv", table)
    text = (tmp_path / "mine.csv").read_text()
    assert "# | velocity = 0.1\n" in text
    assert "# force_stderr: statistical standard error (length)\n" in text
    assert "# X: slider displacement (length)\n" in text
    assert "# force: friction force over N k, <F>/(N k) (length)\n" in text
    assert "# units: lengths, times and energies are in those of the run file\n" in text
    assert text.startswith("# eqsim 0.")
    assert call("export", table.parent).exit_code == 0  # beside the table
    assert same(table.with_suffix(".csv"), table)
    assert call("export", table, "--out", tmp_path).exit_code == 0  # into a folder
    assert (tmp_path / "trajectory.csv").read_text() == text


def test_an_export_is_a_drive_and_a_record(made, tmp_path):
    """The run file in its comments has quotes, in the title and around laws."""
    assert (
        call(
            "export",
            made / "out" / "a" / "trajectory.parquet",
            "--out",
            tmp_path / "x.csv",
        ).exit_code
        == 0
    )
    table = pd.read_parquet(made / "out" / "a" / "trajectory.parquet")
    assert [
        segment.time for segment in read_drive(tmp_path / "x.csv").segments
    ] == list(np.diff(table["t"]))
    fit = {
        "record": {"file": "x.csv"},
        "noise": {"absolute": 1.0},
        "free": {"fit.offset": {"bounds": [-1.0, 1.0]}},
    }
    found = read_record(tmp_path / "x.csv", section_of(check({"fit": fit})))
    assert (list(found.time), list(found.value)) == (
        list(table["t"]),
        list(table["force"]),
    )


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="threads are listed in /proc")
def test_tables_are_read_without_threads(made, tmp_path):
    """A process that ends while those of pyarrow start is aborted."""
    pd.DataFrame({"drive.velocity": [0.1, 1.0]}).to_parquet(tmp_path / "rows.parquet")
    given = (made / "a.toml", made / "swept", tmp_path / "rows.parquet")
    command = [sys.executable, "-c", THREADS, *map(str, given)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", ["swept", "swept/sweep.parquet"])
def test_a_sweep(made, path):
    """One table beside the folder, in which everything is read as points."""
    assert call("export", made / path).exit_code == 0
    assert same(made / "swept.csv", made / "swept")
    assert (
        "# friction_reference_error: bound of the error of the reference (length)\n"
        in (made / "swept.csv").read_text()
    )
    assert all(map(meaning, set(pd.read_parquet(made / "swept")) - {*KEYS}))
    (made / "swept.csv").unlink()
    refused = call("export", made / path, "--out", made / "swept" / "x.csv")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "where everything is read as points" in refused.stderr


CHAIN = {
    "contacts": {"count": 40, "stiffness_law": "uniform"},
    "drive": {"velocity": 0.1, "time": 2.0},
    "elastic": {"blocks": 4, "coupling": 1, "drive_stiffness": 1, "damping": 0.3},
    "output": {"points": 3},
}


def test_columns_of_chains_in_time():
    """Each column of each table has a meaning, and a unit if it is no number."""
    tables = run(check(CHAIN)).tables()
    assert {"trajectory", "blocks", "broke", "events", "fronts"} <= tables.keys()
    names = set().union(*tables.values())
    assert [name for name in names if not meaning(name)] == []
    units = Units("um", "s", "mN")
    united = {"duration": "s", "peak": "um", "energy": "um^2", "speed": "1/s"}
    united |= {"speed_stderr": "1/s", "V": "um/s", "roughness": "um"}
    for name, unit in united.items():
        assert meaning(name, units).endswith(f" ({unit})"), name
    assert meaning("growth_error", units).endswith(" (1/s)")  # of `stability`
    assert all(map(meaning, ("wave_number", "growth", "z")))


def test_a_table_that_lies_in_the_folder_of_a_sweep(made, tmp_path):
    """It is exported itself, to another folder."""
    folder = shutil.copytree(made / "swept", tmp_path / "swept")
    table = shutil.copy(made / "out" / "a" / "trajectory.parquet", folder)
    assert call("export", table, "--out", tmp_path / "x.csv").exit_code == 0
    assert same(tmp_path / "x.csv", table)
    refused = call("export", table)
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "must be outside" in refused.stderr


@pytest.mark.parametrize("parts", ["parts", "_parts"])
def test_an_unfinished_sweep(made, tmp_path, parts):
    """While it is at work, and just before its table has its name: what is on disk is
    exported, drawn and counted."""
    folder = tmp_path / "half"
    (folder / parts).mkdir(parents=True)
    (folder / "_sweep.json").write_text('{"points": 3}')
    assert "no point is on disk yet" in call("export", folder).stderr
    assert "holds no point yet, of 3" in call("plot", folder).stderr
    rows = pq.read_table(made / "swept" / "sweep.parquet")
    files = [folder / parts / f"part-{index}.parquet" for index in range(2)]
    for index, path in enumerate(files):
        pq.write_table(rows.slice(index, 1), path)
    for path in (folder, files[0]):
        assert call("export", path).exit_code == 0
        assert same(tmp_path / "half.csv", made / "swept")
        assert (
            "# 2 of 3 points: the sweep is not finished\n"
            in (tmp_path / "half.csv").read_text()
        )
        (tmp_path / "half.csv").unlink()
    drawn = call("plot", folder, "--out", tmp_path / "half.png", "--json")
    assert drawn.exit_code == 0, drawn.output
    assert json.loads(drawn.stdout)["points"] == 2
    refused = call("replay", files[0])
    assert refused.exit_code == 2
    assert "holds 1 of the 2 points of a sweep that was not finished" in refused.stderr


@pytest.mark.parametrize("hidden", [False, True])
def test_a_sweep_that_ends_while_it_is_listed(tmp_path, monkeypatch, hidden):
    """It renames the folder of its parts once that is listed; or, where it has been
    renamed, writes the table and removes a part. Every row is found, once."""
    parts, renamed = tmp_path / "parts", tmp_path / "_parts"
    folder = renamed if hidden else parts
    folder.mkdir()
    for path in (tmp_path / "_sweep.json", folder / "part-0.parquet"):
        path.touch()

    def listed(pattern, root_dir):
        names = glob.glob(pattern, root_dir=root_dir)
        if names and hidden:
            (tmp_path / "sweep.parquet").touch()
            (renamed / "part-0.parquet").unlink()
        elif names and parts.exists():
            parts.replace(renamed)
        return names

    monkeypatch.setattr(storage, "glob", listed)
    found = tmp_path / "sweep.parquet" if hidden else renamed / "part-0.parquet"
    assert storage.sweep_files(tmp_path) == [found]


def test_parts_that_are_renamed_after_both_listings(tmp_path, monkeypatch):
    """They are found where they are then."""
    parts, renamed = tmp_path / "parts", tmp_path / "_parts"
    parts.mkdir()
    for path in (tmp_path / "_sweep.json", parts / "part-0.parquet"):
        path.touch()

    def listed(pattern, root_dir):
        names = glob.glob(pattern, root_dir=root_dir)
        if root_dir == renamed and parts.exists():
            parts.replace(renamed)
        return names

    monkeypatch.setattr(storage, "glob", listed)
    assert storage.sweep_files(tmp_path) == [renamed / "part-0.parquet"]


@pytest.mark.parametrize("command", ["export", "plot"])
def test_a_sweep_that_ends_before_it_is_read(made, tmp_path, monkeypatch, command):
    """Its table takes the place of the parts that were listed."""
    folder = tmp_path / "half"
    (folder / "parts").mkdir(parents=True)
    (folder / "_sweep.json").write_text('{"points": 2}')
    table = made / "swept" / "sweep.parquet"
    shutil.copy(table, folder / "parts" / "part-0.parquet")
    listed = storage.sweep_files

    def ended(where):
        files = listed(where)
        shutil.copy(table, folder)
        shutil.rmtree(folder / "parts", ignore_errors=True)
        return files

    monkeypatch.setattr(storage, "sweep_files", ended)
    done = call(command, folder)
    assert done.exit_code == 0, done.output
    if command == "export":
        assert same(tmp_path / "half.csv", made / "swept")
        assert "not finished" not in (tmp_path / "half.csv").read_text()


def test_a_sweep_that_was_stopped(made, tmp_path):
    """A sweep that is broken off leaves what its export shows."""
    file = load(made / "a.toml")

    def stop(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(file, out=tmp_path / "stopped", rel_error=0.1, progress=stop)
    assert call("export", tmp_path / "stopped").exit_code == 0
    found = csv.read(tmp_path / "stopped.csv", "")
    assert 1 <= len(list(found.rows())) <= 2


@pytest.mark.long
def test_units(made, tmp_path):
    """Each column has the unit of its numbers, those of the run file if it names them,
    in every table."""
    given = (
        '[units]\nlength = "um"\ntime = "s"\nforce = "mN"\n[interface]\narea = 1.0\n'
    )
    (tmp_path / "b.toml").write_text(
        RUN.replace("[contacts]", given + "[contacts]").replace(
            "points = 11", "points = 11\nreplicas = 2"
        )
    )
    for command in (["run"], ["sweep", "--out", tmp_path / "swept", "--workers", 1], ["reference", "--transient"],
                    ["fluctuations", "--points", 3, "--lives", 0, "--out", tmp_path / "out" / "b"]):  # fmt: skip
        done = call(command[0], tmp_path / "b.toml", *command[1:])
        assert done.exit_code == 0, done.output

    def header(table):
        assert call("export", table, "--out", tmp_path / "x.csv").exit_code == 0
        lines = (tmp_path / "x.csv").read_text().splitlines()
        assert "# units: length um, time s, force mN" in lines
        return dict(
            line.removeprefix("# ").split(": ", 1)
            for line in lines
            if line.startswith("# ") and ": " in line
        )

    run = header(tmp_path / "out" / "b" / "trajectory.parquet")
    assert run["force"] == "friction force over N k, <F>/(N k) (um)"
    assert run["force_stderr"] == "statistical standard error (um)"
    assert run["force_replica_std"] == "standard deviation between replicas (um)"
    assert (run["t"], run["pinned"]) == ("time (s)", "pinned fraction N_c / N")
    assert header(tmp_path / "out" / "b" / "transient.parquet")["force_error"].endswith(
        "(um)"
    )
    lags = header(tmp_path / "out" / "b" / "fluctuations.parquet")
    assert (lags["lag"], lags["covariance"]) == (
        "displacement between two forces (um)", "N times the autocovariance of F/(N k) (um^2)",
    )  # fmt: skip
    swept = header(tmp_path / "swept")
    assert "force" not in swept  # a length elsewhere
    assert swept["friction_force"] == "friction force (mN)"
    assert swept["friction_force_stderr"] == "statistical standard error (mN)"
    assert swept["friction_z"] == "difference from the reference in standard errors"
    assert swept["shear_stress"].endswith("(Pa)")
    assert (swept["drive.velocity"], swept["contacts.stiffness"]) == (
        "(um/s)",
        "(mN/um)",
    )
    table = pd.read_parquet(tmp_path / "swept")
    # N k = 100 mN/um
    np.testing.assert_allclose(
        table["friction_force"], 100 * table["friction"], rtol=1e-14
    )
    np.testing.assert_allclose(
        table["shear_stress"], table["friction_force"] * 1e-3 / 1e-12, rtol=1e-14
    )


def test_a_sweep_of_version_1(made, tmp_path):
    """`force` in the unit of forces: exported and drawn as such, and asked for by its
    old name in a new one."""
    rows = pq.read_table(made / "swept" / "sweep.parquet")
    origin = rows.schema.metadata
    old = rows.append_column("force", rows["friction"]).append_column(
        "force_stderr", rows["friction_stderr"]
    )
    (tmp_path / "old").mkdir()
    pq.write_table(
        old.replace_schema_metadata(origin), tmp_path / "old" / "sweep.parquet"
    )
    assert call("export", tmp_path / "old" / "sweep.parquet").exit_code == 0
    assert (
        "# force: friction force (force)\n"
        in (tmp_path / "old" / "sweep.csv").read_text()
    )
    (tmp_path / "old" / "sweep.csv").unlink()
    for name in ("force", "friction_force"):
        drawn = call(
            "plot", tmp_path / "old", "--y", name, "--out", tmp_path / "old.png"
        )
        assert drawn.exit_code == 0, drawn.output
        assert drawn.stderr == ""


def test_tables_are_not_overwritten(made, tmp_path):
    """A table is not its own CSV file, and several are not one."""
    table = shutil.copy(made / "out" / "a" / "trajectory.parquet", tmp_path / "x.csv")
    before = table.read_bytes()
    for given in (["--out", table], []):
        done = call("export", table, *given)
        assert done.exit_code == 2
        assert done.stderr.endswith("x.csv: is the table that is exported\n")
        assert table.read_bytes() == before
    shutil.copy(table, tmp_path / "a.parquet")
    shutil.copy(table, tmp_path / "b.parquet")
    done = call("export", tmp_path, "--out", tmp_path / "all.csv")
    assert done.exit_code == 2
    assert done.stderr.endswith("all.csv: must be a folder, for 2 tables\n")
    assert call("export", tmp_path, "--out", tmp_path / "all").exit_code == 0
    assert len([*(tmp_path / "all").iterdir()]) == 2


def test_text_with_comment_signs(tmp_path):
    """And a table that eqsim has not written."""
    pq.write_table(
        pa.table({"a": [1.5, None], "text": ["x # y", 'say "no"']}),
        tmp_path / "t.parquet",
    )
    assert call("export", tmp_path / "t.parquet").exit_code == 0
    assert same(tmp_path / "t.csv", tmp_path / "t.parquet")


def test_meanings():
    """The longest suffix decides; keys of the run file explain themselves."""
    assert (
        meaning("friction_reference_error")
        == "bound of the error of the reference (length)"
    )
    assert (
        meaning("force_error") == "bound of the error of a numerical solution (length)"
    )
    assert meaning("friction") == "friction <F> / (N k) (length)"
    assert (
        meaning("force_variance", command="sweep")
        == "force variance Var(F) / (N k^2) (length^2)"
    )
    assert meaning("drive.velocity") == "(length/time)"
    assert meaning("thermal.temperature") == "(K)"
    assert meaning("disorder") == ""
    units = Units("um", "s", "mN")
    assert meaning("segment_1_end", units) == "segment 1: force at its end (um)"
    mu = "segment 1: force at its end, friction coefficient"
    assert meaning("segment_1_end_friction_coefficient", units) == mu
    assert meaning("newborn.mean") == "(length)"
    assert meaning("newborn.mean", fractions=True) == ""


@pytest.mark.parametrize("name", ["absent", "empty", "a.toml"])
def test_bad_input(made, tmp_path, name):
    (tmp_path / "empty").mkdir()
    done = call("export", made / name if name == "a.toml" else tmp_path / name)
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert name in done.stderr
