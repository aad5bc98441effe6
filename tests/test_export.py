"""Tables as CSV: what they hold, what their comments say, and where they are written."""

import json

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from eqsim.cli.app import app
from eqsim.io.export import meaning

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


def call(*args):
    return CliRunner().invoke(app, [str(arg) for arg in args])


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
    assert "# force_stderr: statistical standard error\n" in text
    assert "# X: displacement of the slider (length)\n" in text
    assert text.startswith("# eqsim 0.")
    assert call("export", table.parent).exit_code == 0  # beside the table
    assert same(table.with_suffix(".csv"), table)
    assert call("export", table, "--out", tmp_path).exit_code == 0  # into a folder
    assert (tmp_path / "trajectory.csv").read_text() == text


@pytest.mark.parametrize("path", ["swept", "swept/sweep.parquet"])
def test_a_sweep(made, path):
    """One table beside the folder, in which everything is read as points."""
    assert call("export", made / path).exit_code == 0
    assert same(made / "swept.csv", made / "swept")
    assert "# friction_reference_error: bound of the error of the reference\n" in (made / "swept.csv").read_text()
    (made / "swept.csv").unlink()
    refused = call("export", made / path, "--out", made / "swept" / "x.csv")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "where everything is read as points" in refused.stderr


def test_an_unfinished_sweep(made, tmp_path):
    folder = tmp_path / "half"
    (folder / "_parts").mkdir(parents=True)
    (folder / "_sweep.json").write_text("{}")
    assert "no point is finished" in call("export", folder).stderr
    rows = pq.read_table(made / "swept" / "sweep.parquet")
    for index in range(2):
        pq.write_table(rows.slice(index, 1), folder / "_parts" / f"part-{index}.parquet")
    assert call("export", folder).exit_code == 0
    assert same(tmp_path / "half.csv", made / "swept")


def test_text_with_comment_signs(tmp_path):
    """And a table that eqsim has not written."""
    pq.write_table(pa.table({"a": [1.5, None], "text": ["x # y", 'say "no"']}), tmp_path / "t.parquet")
    assert call("export", tmp_path / "t.parquet").exit_code == 0
    assert same(tmp_path / "t.csv", tmp_path / "t.parquet")


def test_meanings():
    """The longest suffix decides; keys of the run file explain themselves."""
    assert meaning("friction_reference_error") == "bound of the error of the reference"
    assert meaning("force_error") == "bound of the error of a numerical solution"
    assert meaning("friction").startswith("friction <F> / (N k)")
    assert meaning("drive.velocity") == ""


@pytest.mark.parametrize("name", ["absent", "empty", "a.toml"])
def test_bad_input(made, tmp_path, name):
    (tmp_path / "empty").mkdir()
    done = call("export", made / name if name == "a.toml" else tmp_path / name)
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert name in done.stderr
