"""`eqsim plot`: what is drawn, what is refused, and what is left on disk."""

import json

import matplotlib.figure
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from eqsim.cli.app import app
from eqsim.io.plots import read_points, sweep_png

VELOCITIES, TEMPERATURES = np.geomspace(1e-3, 10.0, 9), [0.01, 0.1, 1.0]


def points(stiffnesses=(1.0,)):
    """A made-up sweep: friction = 0.75 v/(v + kT/10), drawn 1 standard error too high."""
    v, kT, k = (a.ravel() for a in np.meshgrid(VELOCITIES, TEMPERATURES, stiffnesses, indexing="ij"))
    exact = 0.75 * v / (v + kT / 10)
    table = pd.DataFrame(
        {
            "disorder": "annealed", "contacts.stiffness": k, "thermal.kT": kT, "drive.velocity": v,
            "aging.x_star_final": np.nan, "output.seed": np.arange(v.size),
            "friction": exact + 0.01, "friction_stderr": 0.01, "pinned": 1.0, "pinned_stderr": 0.0,
            "friction_reference": exact, "friction_reference_error": 1e-9, "status": "ok",
        }
    )  # fmt: skip
    table.loc[[3, 7], "status"] = "unreliable"
    table.loc[5, "status"] = "failed"
    table.loc[5, ["friction", "friction_stderr", "pinned"]] = np.nan
    return table


@pytest.fixture
def folder(tmp_path):
    """The sweep in two files of a folder."""
    made = tmp_path / "sweep"
    made.mkdir()
    table = points()
    table[:10].to_parquet(made / "part-0.parquet")
    table[10:].to_parquet(made / "part-1.parquet")
    return made


def call(*args):
    return CliRunner().invoke(app, ["plot", *map(str, args)])


def drawn(monkeypatch, *args, **kwargs):
    """The figure instead of its pixels."""
    figures = []
    monkeypatch.setattr("eqsim.io.plots.as_png", lambda figure: figures.append(figure) or b"")
    _, notes = sweep_png(*args, **kwargs)
    return figures[0], notes


def marks(axes):
    """(x, y, filled) of every point drawn."""
    return [
        (x, y, not isinstance(line.get_markerfacecolor(), str))
        for line in axes.lines
        if line.get_linestyle() == "None" and line.get_marker() in tuple("os^DvPX<>ph*")
        for x, y in zip(*line.get_data(), strict=True)
    ]


def test_every_point_bar_and_line_is_where_it_should_be(monkeypatch):
    table = points()
    figure, notes = drawn(monkeypatch, table, "drive.velocity", "friction", "thermal.kT", title="T")
    axes = figure.axes[0]
    good = table[table.status != "failed"]
    expected = zip(good["drive.velocity"], good.friction, good.status == "ok", strict=True)
    assert sorted(marks(axes)) == sorted(expected)
    bars = np.concatenate([c.get_segments() for c in axes.collections])
    np.testing.assert_allclose(bars[:, 1, 1] - bars[:, 0, 1], 4 * 0.01, rtol=1e-12)  # +- 2 standard errors
    lines = [line for line in axes.lines if line.get_linestyle() != "None"]
    assert len(lines) == 3
    for line, kT in zip(lines, TEMPERATURES, strict=True):
        here = good[good["thermal.kT"] == kT]
        np.testing.assert_array_equal(line.get_data(), [here["drive.velocity"], here.friction_reference])
    assert notes == ["left out: 1 failed"]
    assert axes.get_title() == "T\nleft out: 1 failed"
    assert axes.get_xscale() == "log"
    assert "drive.velocity" in axes.get_xlabel()
    assert axes.get_ylabel().startswith("friction")
    # without colours: a marker and a line of its own for each series
    assert len({line.get_linestyle() for line in lines}) == 3
    legend = figure.legends[0]
    assert [text.get_text() for text in legend.get_texts()][:3] == ["0.01", "0.1", "1"]
    assert len({handle.get_marker() for handle in legend.legend_handles[:3]}) == 3
    assert legend.get_title().get_text() == "thermal.kT"


def test_legend_covers_no_data():
    """The legend stands beside the axes, on the figure as it is laid out."""
    seen = []
    save = matplotlib.figure.Figure.savefig

    def savefig(figure, *args, **kwargs):
        save(figure, *args, **kwargs)
        seen.append((figure.legends[0].get_window_extent(), figure.axes[0].get_window_extent(), figure.bbox))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.figure.Figure, "savefig", savefig)
        sweep_png(points(), "drive.velocity", "friction", "thermal.kT")
    legend, axes, whole = seen[0]
    assert legend.x0 > axes.x1
    assert legend.x1 <= whole.x1
    assert legend.y0 >= whole.y0
    assert axes.width > 0.5 * whole.width


@pytest.mark.parametrize(
    ("spread", "log_x", "scale"),
    [(29.0, None, "linear"), (31.0, None, "log"), (31.0, False, "linear"), (2.0, True, "log")],
)
def test_scale_of_the_axis(monkeypatch, spread, log_x, scale):
    table = pd.DataFrame({"drive.velocity": [1.0, spread], "friction": [1.0, 2.0]})
    figure, _ = drawn(monkeypatch, table, "drive.velocity", "friction", log_x=log_x)
    assert figure.axes[0].get_xscale() == scale
    assert not figure.legends
    zero = pd.DataFrame({"thermal.kT": [0.0, 100.0], "friction": [1.0, 2.0]})
    assert drawn(monkeypatch, zero, "thermal.kT", "friction")[0].axes[0].get_xscale() == "linear"


def test_values_that_cannot_be_drawn_are_counted(monkeypatch):
    table = points()
    table.loc[[8, 9], "friction"] = np.nan
    figure, notes = drawn(monkeypatch, table, "drive.velocity", "friction", "thermal.kT")
    assert len(marks(figure.axes[0])) == len(table) - 3
    assert notes == ["left out: 1 failed", "left out: 2 without a finite drive.velocity or friction"]


def test_command_writes_one_picture_outside_the_dataset(folder, tmp_path):
    result = call(folder, "--by", "thermal.kT")
    assert result.exit_code == 0, result.output
    assert "left out: 1 failed" in result.stdout
    assert (tmp_path / "sweep.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sweep", "sweep.png"]
    assert len(read_points(folder)) == len(pd.read_parquet(folder)) == 27
    other = tmp_path / "deep" / "p.png"
    result = call(folder, "--y", "pinned", "--where", "thermal.kT=1", "--out", other, "--json")
    assert json.loads(result.stdout) == {"file": str(other), "points": 9, "notes": ["left out: 1 failed"]}
    assert other.exists()
    assert call(folder, "--by", "thermal.kT", "--quiet").output == ""


def test_partitioned_folders(tmp_path):
    """Folders named KEY=VALUE give numbers to choose and to draw by."""
    points().to_parquet(tmp_path / "d", partition_cols=["thermal.kT"])
    assert call(tmp_path / "d", "--by", "thermal.kT").exit_code == 0
    assert call(tmp_path / "d", "--x", "thermal.kT", "--where", "drive.velocity=0.001").exit_code == 0


def test_other_parameters_must_be_chosen(tmp_path):
    made = tmp_path / "sweep"
    made.mkdir()
    points((1.0, 2.0)).to_parquet(made / "p.parquet")
    result = call(made, "--by", "thermal.kT")
    assert result.exit_code == 2
    assert "contacts.stiffness (1, 2)" in result.stderr
    assert "output.seed" not in result.stderr
    assert not (tmp_path / "sweep.png").exists()
    result = call(made)
    assert "thermal.kT (0.01, 0.1, 1)" in result.stderr
    assert call(made, "--by", "thermal.kT", "--where", "contacts.stiffness=2").exit_code == 0
    chosen = ["--where", "contacts.stiffness=1", "--where", "thermal.kT=1e-1", "--where", "disorder=annealed"]
    assert json.loads(call(made, *chosen, "--json").stdout)["points"] == 9


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--x", "velocity"], '--x velocity: no such column; did you mean "drive.velocity"?'),
        (["--y", "mass"], "--y mass: no such column; there are disorder, contacts.stiffness"),
        (["--by", "kt"], '--by kt: no such column; did you mean "thermal.kT"?'),
        (["--where", "kT=1"], "--where kT: no such column"),
        (["--where", "kT"], "--where kT: must be KEY=VALUE"),
        (["--where", "thermal.kT=2"], "--where thermal.kT=2: no point has this value; there are 0.01, 0.1, 1"),
        (["--where", "thermal.kT=hot"], "no point has this value; there are 0.01, 0.1, 1"),
        (["--where", "disorder=quenched"], "no point has this value; there are annealed"),
        (["--y", "status"], "--y status: is not a column of numbers but of failed, ok, unreliable"),
        (["--where", "status=failed"], "--y friction: no point to draw; left out: 1 failed"),
        (["--x", "pinned", "--y", "contacts.stiffness"], "besides --x and --by other parameters vary"),
        (["--by", "thermal.kT", "--out", "p.pdf"], "--out p.pdf: must end in .png"),
    ],
)
def test_refusals(folder, tmp_path, args, message):
    """One line on standard error, exit code 2, nothing on disk."""
    result = call(folder, *args)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["sweep"]


def test_refused_places(folder, tmp_path):
    for args, message in (
        ([folder, "--by", "thermal.kT", "--out", folder / "p.png"], "must be outside"),
        ([tmp_path / "none"], "is not a folder"),
        ([folder / "part-0.parquet"], "is not a folder"),
    ):
        result = call(*args)
        assert result.exit_code == 2
        assert message in result.stderr
    (folder / "note.txt").write_text("not a table")
    result = call(folder, "--by", "thermal.kT")
    assert result.exit_code == 2
    assert "cannot be read as Parquet files" in result.stderr
    assert result.stderr.count("\n") == 1
    zero = tmp_path / "zero"
    zero.mkdir()
    assert call(zero).exit_code == 2
    pd.DataFrame({"thermal.kT": [0.0, 1.0], "friction": [1.0, 2.0]}).to_parquet(zero / "p.parquet")
    assert "thermal.kT = 0 is not above 0" in call(zero, "--x", "thermal.kT", "--log-x").stderr
