"""`eqsim plot`: what is drawn, what is refused, and what is left on disk."""

import json

import matplotlib.figure
import numpy as np
import pandas as pd
import pytest
from scipy import constants
from typer.testing import CliRunner

from eqsim import load
from eqsim import sweep as run_sweep
from eqsim.cli.app import app
from eqsim.errors import InputError
from eqsim.model.healing import healing_law
from eqsim.plots.style import COLORS, PAPER, saved
from eqsim.plots.sweeps import Sweep, healing_of, read_sweep, select, sweep_figure
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.rows import Asked
from eqsim.sweeps.store import Store

VELOCITIES, TEMPERATURES = np.geomspace(1e-3, 10.0, 9), [0.01, 0.1, 1.0]


def points(stiffnesses=(1.0,)):
    """A made-up sweep: friction = 0.75 v/(v + kT/10), drawn 1 standard error too high."""
    v, kT, k = (
        a.ravel()
        for a in np.meshgrid(VELOCITIES, TEMPERATURES, stiffnesses, indexing="ij")
    )
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


def drawn(table, x, y, *by, **kwargs):
    """The figure instead of its pixels, and notes."""
    return sweep_figure(Sweep(table), table, (x, y), list(by), **kwargs)


def marks(axes):
    """(x, y, filled) of every point drawn."""
    return [
        (x, y, line.get_markerfacecolor() != "white")
        for line in axes.lines
        if line.get_linestyle() == "None" and line.get_marker() in tuple("os^DvPX<>ph*")
        for x, y in zip(*line.get_data(), strict=True)
    ]


def test_every_point_bar_and_line_is_where_it_should_be():
    table = points()
    figure, notes = drawn(table, "drive.velocity", "friction", "thermal.kT", title="T")
    axes = figure.axes[0]
    good = table[table.status != "failed"]
    expected = zip(
        good["drive.velocity"], good.friction, good.status == "ok", strict=True
    )
    assert sorted(marks(axes)) == sorted(expected)
    bars = np.concatenate([c.get_segments() for c in axes.collections])
    # +- 2 standard errors
    np.testing.assert_allclose(bars[:, 1, 1] - bars[:, 0, 1], 4 * 0.01, rtol=1e-12)
    # nothing is known of the run file: references are dashes at the points, not lines
    # that pretend to be curves
    assert all(line.get_linestyle() == "None" for line in axes.lines)
    dashes = [
        line
        for line in axes.lines
        if line.get_marker() == "_" and line.get_markersize() == 13
    ]
    assert len(dashes) == 3
    for line, kT in zip(dashes, TEMPERATURES, strict=True):
        here = good[good["thermal.kT"] == kT]
        np.testing.assert_array_equal(
            line.get_data(), [here["drive.velocity"], here.friction_reference]
        )
    assert notes == ["left out: 1 failed"]
    assert axes.get_title() == "T\nleft out: 1 failed"
    assert axes.get_xscale() == "log"
    assert axes.get_xlabel() == "driving velocity  $v$  [unit of the run file]"
    assert axes.get_ylabel().startswith("friction")
    # without colours: a marker of its own for each series
    legend = figure.legends[0]
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts[:4] == ["thermal energy  $k_B T$", "0.01", "0.1", "1"]
    assert texts[4:] == [
        "points: simulated",
        "dashes: master equation",
        "bars: ± 2 standard errors",
        "open: unreliable",
    ]
    assert len({handle.get_marker() for handle in legend.legend_handles[1:4]}) == 3


def test_points_of_a_column_that_is_not_reliable_are_open():
    """Also in a row that is, as of healing after a hold; those without a word on it are
    not."""
    table = points()[10:14].assign(drop=1.0, drop_reliable=[True, False, None, True])
    figure, _ = drawn(table, "drive.velocity", "drop", "thermal.kT")
    assert sorted(filled for _, _, filled in marks(figure.axes[0])) == [
        False,
        True,
        True,
        True,
    ]


@pytest.mark.parametrize("quantity", ["", "_friction_coefficient", "_friction_force"])
def test_healing_that_is_not_reliable_is_open_in_every_quantity(quantity):
    """It does not count for the logarithm, which is that of the others."""
    hold = np.geomspace(1.0, 1e4, 5)
    x, base = "drive.programme.1.hold", "segment_2_healing"
    y, healing = base + quantity, 0.02 * np.log10(1.0 + hold)
    table = pd.DataFrame({x: hold, y: healing, f"{y}_stderr": 1e-3})
    table[f"{base}_reliable"] = [False, True, True, True, True]
    table.loc[0, y] = 1.0
    figure, _ = drawn(table, x, y)
    assert sum(not filled for *_, filled in marks(figure.axes[0])) == 1
    assert healing_of(table, x, y) == healing_law(hold[1:], healing[1:], 0 * hold[1:] + 1e-3)  # fmt: skip


def test_friction_coefficients_are_as_reliable_as_friction():
    table = points()[10:14].assign(friction_coefficient=1.0)
    table["friction_reliable"] = [True, False, True, True]
    figure, _ = drawn(table, "drive.velocity", "friction_coefficient", "thermal.kT")
    assert sum(not filled for *_, filled in marks(figure.axes[0])) == 1


@pytest.mark.parametrize("end", ["_reference", "_stderr", "_z"])
def test_columns_of_the_errors_of_healing_are_no_healing(end):
    hold, y = np.geomspace(1.0, 1e4, 5), "segment_2_healing"
    table = pd.DataFrame({"drive.programme.1.hold": hold, y: 0.1, f"{y}_stderr": 0.01})
    table[f"{y}{end}"] = 0.01
    figure, notes = drawn(table, "drive.programme.1.hold", f"{y}{end}")
    assert len(marks(figure.axes[0])) == 5
    assert notes == []


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"y_stderr": ["a"] * 3}, "--y y: y_stderr is not a column of numbers but of a"),
        ({"y_stderr": -0.1}, "--y y: y_stderr = -0.1: must be 0 or more"),
        ({"y_reference": "b"}, "--y y: y_reference is not a column of numbers but of b"),
        ({"y_stderr": None, "y_reference": None}, ""),
    ],
)  # fmt: skip
def test_errors_and_references_of_any_table(columns, said):
    """Errors and exact values that are no numbers are refused; empty ones are none."""
    table = pd.DataFrame({"x": [1.0, 2.0, 3.0], "y": [1.0, 2.0, 3.0]}).assign(**columns)
    if not said:
        assert len(marks(drawn(table, "x", "y")[0].axes[0])) == 3
        return
    with pytest.raises(InputError) as error:
        drawn(table, "x", "y")
    assert str(error.value) == said


def test_a_table_with_old_and_new_names(tmp_path):
    """Both columns stay what they are."""
    names = ("drive.velocity", "friction", "force", "friction_force")
    table = pd.DataFrame({name: [1.0, 2.0, 3.0 + i] for i, name in enumerate(names)})
    table.to_parquet(tmp_path / "p.parquet")
    pd.testing.assert_frame_equal(read_sweep(tmp_path).table, table)


@pytest.mark.parametrize("varied", ["share", "stiffness", ""])
def test_no_second_axis_where_populations_vary(tmp_path, varied):
    """The coefficient of the same F/(N k) is in proportion to the mean stiffness k,
    here from 1 to 3 or 6. Control: of other points the axis is drawn."""
    run = tmp_path / "x.toml"
    run.write_text(
        "[interface]\nnormal_load = 2.0\n[contacts]\ncount = 10\n[drive]\nvelocity = 1.0\n"
        "[[population]]\nshare = 1\nstiffness = 1.0\n[[population]]\nshare = 1\nstiffness = 5.0\n"
    )
    x = f"population.0.{varied}" if varied else "thermal.kT"
    table = pd.DataFrame({x: [0.1, 1.0, 9.0], "friction": 0.75})
    figure = sweep_figure(Sweep(table, load(run)), table, (x, "friction"))[0]
    assert len(figure.axes[0].child_axes) == (0 if varied else 1)


def test_legend_covers_no_data():
    """The legend stands beside the axes, on the figure as it is laid out."""
    seen = []
    save = matplotlib.figure.Figure.savefig

    def savefig(figure, *args, **kwargs):
        save(figure, *args, **kwargs)
        seen.append(
            (
                figure.legends[0].get_window_extent(),
                figure.axes[0].get_window_extent(),
                figure.bbox,
            )
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.figure.Figure, "savefig", savefig)
        saved(drawn(points(), "drive.velocity", "friction", "thermal.kT")[0])
    legend, axes, whole = seen[0]
    assert legend.x0 > axes.x1
    assert legend.x1 <= whole.x1
    assert legend.y0 >= whole.y0
    assert axes.width > 0.5 * whole.width


@pytest.mark.long
def test_two_columns_of_a_table_on_a_column_of_a_page():
    """Text has 7 or 8 points and is within the page, 85 mm wide, whose height follows
    the legend; without wrapping (control) a long title is not."""
    table, columns = points(), ("drive.velocity", "friction", "pinned")
    more = ["thermal.kT"], None, "a title " * 20, 85.0 / 25.4
    figure, _ = sweep_figure(Sweep(table), table, columns, *more)
    saved(figure, "svg", PAPER)
    page, drawn = figure.bbox_inches, figure.get_tightbbox()
    assert page.width == pytest.approx(85.0 / 25.4, rel=1e-12, abs=0)
    assert page.x0 <= drawn.x0 < drawn.x1 <= page.x1
    assert page.y0 <= drawn.y0 < drawn.y1 <= page.y1
    texts = figure.findobj(lambda one: hasattr(one, "get_fontsize") and one.get_text())
    assert {text.get_fontsize() for text in texts} == {7.0, 8.0}
    assert [axes.get_ylabel()[:6] for axes in figure.axes] == ["fricti", "pinned"]
    figure.axes[0].set_title("a title " * 20)
    saved(figure, "svg", PAPER)
    assert figure.get_tightbbox().x0 < page.x0


@pytest.mark.parametrize(
    ("spread", "log_x", "scale"),
    [
        (29.0, None, "linear"),
        (31.0, None, "log"),
        (31.0, False, "linear"),
        (2.0, True, "log"),
    ],
)
def test_scale_of_the_axis(spread, log_x, scale):
    table = pd.DataFrame({"drive.velocity": [1.0, spread], "friction": [1.0, 2.0]})
    figure, _ = drawn(table, "drive.velocity", "friction", log_x=log_x)
    assert figure.axes[0].get_xscale() == scale
    assert not figure.legends
    zero = pd.DataFrame({"thermal.kT": [0.0, 100.0], "friction": [1.0, 2.0]})
    assert drawn(zero, "thermal.kT", "friction")[0].axes[0].get_xscale() == "linear"


def test_values_that_cannot_be_drawn_are_counted():
    table = points()
    table.loc[[8, 9], "friction"] = np.nan
    figure, notes = drawn(table, "drive.velocity", "friction", "thermal.kT")
    assert len(marks(figure.axes[0])) == len(table) - 3
    assert notes == [
        "left out: 1 failed",
        "left out: 2 without a finite drive.velocity or friction",
    ]


def test_command_writes_one_picture_outside_the_dataset(folder, tmp_path):
    result = call(folder, "--by", "thermal.kT")
    assert result.exit_code == 0, result.output
    assert "left out: 1 failed" in result.stdout
    assert (tmp_path / "sweep.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sweep", "sweep.png"]
    assert call(folder, "--by", "thermal.kT", "--y", "pinned").exit_code == 0
    assert (tmp_path / "sweep-pinned.png").exists()
    assert len(read_sweep(folder).table) == len(pd.read_parquet(folder)) == 27
    other = tmp_path / "deep" / "p.png"
    result = call(
        folder, "--y", "pinned", "--where", "thermal.kT=1", "--out", other, "--json"
    )
    assert json.loads(result.stdout) == {
        "file": str(other),
        "points": 9,
        "notes": ["left out: 1 failed"],
    }
    assert other.exists()
    assert call(folder, "--by", "thermal.kT", "--quiet").output == ""
    table = points().rename(columns={"pinned": "friction_coefficient"})
    (tmp_path / "mu").mkdir()
    table.to_parquet(tmp_path / "mu" / "p.parquet")
    done = call(tmp_path / "mu", "--by", "thermal.kT", "--y", "mu, friction")
    assert (done.exit_code, done.stderr) == (0, "")
    assert (tmp_path / "mu-mu-friction.png").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("suffix", "begin"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")]
)
def test_formats_by_suffix(folder, tmp_path, suffix, begin):
    files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for file in files:
        assert call(folder, "--by", "thermal.kT", "--out", file).exit_code == 0
    assert files[0].read_bytes()[: len(begin)] == begin
    assert files[0].read_bytes() == files[1].read_bytes()


def test_two_columns_choose_colours_and_markers():
    figure, _ = drawn(
        points((1.0, 2.0)),
        "drive.velocity",
        "friction",
        "thermal.kT",
        "contacts.stiffness",
    )
    series = [
        line
        for line in figure.axes[0].lines
        if line.get_marker() in ("o", "s") and line.get_xdata().size
    ]
    looks = {(line.get_color(), line.get_marker()) for line in series}
    assert looks == {(color, marker) for color in COLORS[:3] for marker in "os"}
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[:7] == [
        "thermal energy  $k_B T$",
        "0.01",
        "0.1",
        "1",
        "stiffness of a contact  $k$",
        "1",
        "2",
    ]


def test_many_series_have_a_colour_bar():
    """Not a legend of fifty; text has no scale and keeps its legend."""
    kT = np.repeat(np.geomspace(1e-3, 1.0, 50), 2)
    table = pd.DataFrame(
        {
            "drive.velocity": [1.0, 2.0] * 50,
            "thermal.kT": kT,
            "friction": 1.0 / (1.0 + kT),
        }
    )
    figure, _ = drawn(table, "drive.velocity", "friction", "thermal.kT")
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == [
        "thermal energy  $k_B T$"
    ]
    assert not figure.legends
    colors = [
        tuple(line.get_color())
        for line in figure.axes[0].lines
        if line.get_xdata().size
    ]
    assert len(set(colors)) == 50
    named = table.assign(
        **{"thermal.kT": 0.1, "thermal.barrier": [f"b{i // 2:02}" for i in range(100)]}
    )
    figure, _ = drawn(named, "drive.velocity", "friction", "thermal.barrier")
    assert len(figure.axes) == 1
    assert len(figure.legends[0].get_texts()) == 51


def test_a_colour_bar_from_zero_on_tells_decades_apart():
    """Neighbours differ by a twentieth of the bar or more, as zero does from the next;
    a linear bar (control, of values that are alike) has equal steps."""

    def shades(kT):
        table = pd.DataFrame({"drive.velocity": 1.0, "thermal.kT": kT, "friction": kT})
        figure, _ = drawn(table, "drive.velocity", "friction", "thermal.kT")
        colors = [
            line.get_color() for line in figure.axes[0].lines if line.get_xdata().size
        ]
        bar = matplotlib.colormaps["viridis"](np.arange(256))
        assert figure.axes[1].get_ylim()[0] == 0.0
        return [np.abs(bar - color).sum(axis=1).argmin() for color in colors]

    assert min(np.diff(shades([0.0, *np.geomspace(1e-5, 1.0, 11)]))) > 256 / 20
    assert set(np.diff(shades(np.arange(11.0)))) <= {25, 26}


def test_more_values_than_markers_are_refused():
    """Two of them would look alike. As many as there are markers differ (control), and
    named first they have a colour bar."""
    delay = np.repeat(np.arange(13.0), 2)
    kT = np.tile([0.0, 0.1], 13)
    table = pd.DataFrame({"drive.velocity": 1.0, "delay.time": delay, "thermal.kT": kT})
    table["friction"] = delay + kT
    columns = "drive.velocity", "friction"
    with pytest.raises(InputError) as error:
        drawn(table, *columns, "thermal.kT", "delay.time")
    assert str(error.value) == (
        "--by delay.time: 13 values (0, 1, 2, 3, 4, 5, 6, 7, ...) for 12 markers; "
        "choose with --where KEY=VALUE, or name it first, for colours"
    )
    assert len(drawn(table, *columns, "delay.time", "thermal.kT")[0].axes) == 2
    figure, _ = drawn(table[:-2], *columns, "thermal.kT", "delay.time")
    lines = [line for line in figure.axes[0].lines if line.get_xdata().size]
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == 24


def test_flat_curves_have_plain_labels():
    """Friction that differs by rounding only: no offset such as 1e-13 + 1.596e-9 beside
    the axis."""
    table = pd.DataFrame(
        {
            "drive.velocity": [1.0, 2.0, 3.0],
            "friction": 1.596e-9 * (1 + 1e-13 * np.arange(3.0)),
        }
    )
    figure, _ = drawn(table, "drive.velocity", "friction")
    saved(figure)
    axis = figure.axes[0].yaxis
    assert "+" not in axis.get_offset_text().get_text()
    low, high = figure.axes[0].get_ylim()
    assert (high - low) / 1.596e-9 == pytest.approx(0.01, rel=1e-3, abs=0)
    # control: limits that show something stay
    varied = table.assign(friction=[1.0, 1.001, 1.002])
    figure, _ = drawn(varied, "drive.velocity", "friction")
    before = figure.axes[0].get_ylim()
    saved(figure)
    assert figure.axes[0].get_ylim() == before


def test_where_accepts_what_it_prints():
    """Numbers of 12 digits, as grids have them, close neighbours, nothing, and texts."""
    values = [*np.geomspace(1e-3, 10.0, 7), 1.0000001, 1.0000002, np.nan, -2.5e-9]
    table = pd.DataFrame(
        {"thermal.kT": values, "disorder": ["quenched", *["annealed"] * 10]}
    )
    with pytest.raises(ValueError, match="no point has this value") as error:
        select(table, {"thermal.kT": "77"})
    printed = str(error.value).partition("there are ")[2].split(", ")
    assert len(printed) == 9
    for text in printed[:-1]:
        assert len(select(table, {"thermal.kT": text})) == 1, text
    assert len(select(table, {"thermal.kT": "none"})) == 1
    assert len(select(table, {"thermal.kT": "0.00464159"})) == 1
    assert len(select(table, {"disorder": "annealed"})) == 10


def test_empty_and_unfinished_sweeps(tmp_path):
    made = tmp_path / "sweep"
    (made / "parts").mkdir(parents=True)
    (made / "_sweep.json").write_text('{"points": 50}')
    result = call(made)
    assert (result.exit_code, result.stderr) == (
        2,
        f"eqsim: {made}: holds no point yet, of 50\n",
    )
    points().to_parquet(made / "parts" / "part-0.parquet")
    result = call(made, "--by", "thermal.kT", "--json")
    assert json.loads(result.stdout)["notes"] == [
        "left out: 1 failed",
        "27 of 50 points so far",
    ]


def test_a_sweep_knows_its_title_units_and_curve(tmp_path):
    """Of a real sweep, over a temperature in kelvin, before and after its end: the
    curve between the points is the master equation's, and pandas reads every row once.
    """
    run = tmp_path / "film.toml"
    run.write_text(
        'title = "A film"\ndisorder = "annealed"\n[units]\nlength = "nm"\ntime = "s"\nforce = "nN"\n'
        "[interface]\ncontacts_per_area = 1e-6\n[contacts]\nstiffness = 1e-3\nstiffness_law = 'uniform'\n"
        "[thermal]\nattempt_frequency = 1e3\n[sweep]\n'drive.velocity' = [1.0, 10.0, 100.0]\n"
        "'thermal.temperature' = [100.0, 300.0]\n"
    )
    command = [
        "sweep",
        str(run),
        "--out",
        str(tmp_path / "s"),
        "--workers",
        "1",
        "--quiet",
    ]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    table = pd.read_parquet(tmp_path / "s")
    assert len(table) == 6
    heat = table["thermal.kT"] / table["thermal.temperature"]
    np.testing.assert_allclose(heat, constants.k / 1e-18, rtol=1e-12)
    np.testing.assert_allclose(
        table["shear_stress"], table["friction"] * 1e-3 * 1e-6 * 1e9, rtol=1e-12
    )
    np.testing.assert_allclose(table["shear_stress_stderr"] / table["shear_stress"],
                               table["friction_stderr"] / table["friction"], rtol=1e-9)  # fmt: skip
    found = read_sweep(tmp_path / "s")
    assert found.file.title == "A film"
    columns = ("drive.velocity", "shear_stress")
    figure, _ = sweep_figure(found, found.table, columns, ["thermal.temperature"])
    axes, columns = figure.axes[0], ("drive.velocity", found.usual)
    assert axes.get_xlabel() == "driving velocity  $v$  [nm/s]"
    assert axes.get_ylabel().startswith(r"shear stress  $\tau$  [")
    lines = [line for line in axes.lines if line.get_linestyle() != "None"]
    assert [line.get_xdata().size > 100 for line in lines] == [True, True]
    unit = {"mPa": 1e-3, "Pa": 1.0, "kPa": 1e3}[
        axes.get_ylabel()[:-1].partition("[")[2]
    ]
    for line, temperature in zip(lines, (100.0, 300.0), strict=True):
        here = found.table[found.table["thermal.temperature"] == temperature]
        x, y = line.get_data()
        at_points = [y[x == v][0] for v in here["drive.velocity"]]
        np.testing.assert_allclose(
            at_points, here["shear_stress_reference"] / unit, rtol=1e-6
        )
    # newtons are drawn where nothing else is asked for, beside another quantity
    assert found.usual == "friction_force"
    axes = sweep_figure(found, found.table, columns, ["thermal.temperature"])[0].axes[0]
    assert axes.get_ylabel().endswith("[nN]")
    lines = [line for line in axes.lines if line.get_linestyle() != "None"]
    assert [line.get_xdata().size > 100 for line in lines] == [True, True]
    (right,) = axes.child_axes
    axes.figure.draw_without_rendering()
    stress = {"Pa": 1.0, "kPa": 1e3, "mPa": 1e-3}[right.get_ylabel()[15:-1]]
    ratio = found.table["shear_stress"] / found.table["friction_force"] / stress
    limits = [np.array(one.get_ylim()) for one in (axes, right)]
    np.testing.assert_allclose(limits[1] / limits[0], ratio[:2], rtol=1e-9)
    # the same over temperature, one solve a point
    args = (
        found.table[found.table["drive.velocity"] == 10.0],
        ("thermal.temperature", "friction"),
    )
    (line,) = [
        line
        for line in sweep_figure(found, *args)[0].axes[0].lines
        if line.get_linestyle() != "None"
    ]
    assert line.get_xdata().size >= 40
    assert np.all(np.diff(line.get_ydata()) < 0)


def curve_at_points(sweep, x):
    """The curve of the master equation for friction at the points of a sweep."""
    (line,) = [
        line
        for line in sweep_figure(sweep, sweep.table, (x, "friction"))[0].axes[0].lines
        if line.get_linestyle() != "None"
    ]
    drawn_x, drawn_y = line.get_data()
    return [drawn_y[drawn_x == value][0] for value in sweep.table[x]]


def test_an_axis_of_a_single_value_is_that_of_the_curve(tmp_path):
    """Not that of the run file. So it is while others are not on disk yet."""
    run = tmp_path / "x.toml"
    run.write_text("[drive]\nvelocity = 0.1\n")
    grid = {"thermal.kT": [0.5], "drive.velocity": [1e-3, 1.0]}
    run_sweep(run, grid, out=tmp_path / "s", rel_error=0.1, progress=False)
    found = read_sweep(tmp_path / "s")
    at_points = curve_at_points(found, "drive.velocity")
    np.testing.assert_allclose(at_points, found.table["friction_reference"], rtol=1e-8)
    assert at_points[0] > 1.1 * at_points[1]


KELVIN = "thermal.temperature"
TWO_KINDS = 2 * "[[population]]\nshare = 1\nstiffness = 1.0\n"
OWN = "[population.thermal]\nkT = 0.01\n"


@pytest.mark.parametrize(
    ("kinds", "swept", "along"),
    [
        ("", KELVIN, (KELVIN, "thermal.kT")),
        (TWO_KINDS, KELVIN, (KELVIN, "thermal.kT", "population.0.thermal.kT")),
        (TWO_KINDS + OWN, KELVIN, (KELVIN, "population.0.thermal.kT")),
        (
            TWO_KINDS + OWN,
            f"population.1.{KELVIN}",
            (f"population.1.{KELVIN}", "population.1.thermal.kT"),
        ),
    ],
)
def test_keys_that_follow_from_others(kinds, swept, along, tmp_path):
    """Heat from a temperature, and what a population takes from the top of the file: a
    sweep can be drawn along each, and the curve of the master equation passes through
    its points, to errors of references."""
    (tmp_path / "x.toml").write_text(
        '[units]\nlength = "nm"\nforce = "nN"\n[thresholds]\nx_star = 0.1\n'
        f"[drive]\nvelocity = 0.1\n[thermal]\ntemperature = 300.0\n{kinds}"
    )
    grid = {swept: pd.Series([100.0, 1000.0, 10000.0])}
    out = tmp_path / "s"
    run_sweep(tmp_path / "x.toml", grid, out=out, rel_error=0.1, progress=False)
    found = read_sweep(out)
    for x in along:
        at_points = curve_at_points(found, x)
        np.testing.assert_allclose(
            at_points, found.table["friction_reference"], rtol=1e-8
        )
        assert at_points[0] > 1.1 * at_points[2]


@pytest.mark.parametrize(
    ("of", "label"),
    [("threshold", "over threshold"), ("length", " [$x_*$]")],
)
def test_stretch_at_birth_is_a_length_or_a_fraction(tmp_path, of, label):
    run = tmp_path / "born.toml"
    run.write_text(
        f'[newborn]\nlaw = "delta"\nof = "{of}"\nstretch = 0.3\n[drive]\nvelocity = 0.1\n'
    )
    table = points()[:3].assign(
        **{"newborn.stretch": [0.0, 0.2, 0.4], "thermal.kT": 0.0, "drive.velocity": 0.1}
    )
    figure = sweep_figure(
        Sweep(table, load(run)), table, ("newborn.stretch", "friction")
    )[0]
    assert figure.axes[0].get_xlabel() == f"stretch at birth {label}"


def test_an_unfinished_sweep_is_read_whole(tmp_path):
    """Rows on disk are seen by pandas and by `plot`; a changed base value of a swept
    key goes on with them."""
    run = tmp_path / "grid.toml"
    run.write_text(
        "[sweep]\n'drive.velocity' = [0.1, 1.0, 10.0]\n[drive]\nvelocity = 3.0\n"
    )
    plan, asked = Plan(load(run)), Asked(rel_error=0.1)
    store = Store(tmp_path / "s", plan, asked)
    store.add(1, {"friction": 0.5, "status": "ok"})
    store.flush()
    store.close()
    assert pd.read_parquet(tmp_path / "s")["friction"].tolist() == [0.5]
    assert read_sweep(tmp_path / "s").unfinished == "1 of 3 points so far"
    run.write_text(run.read_text().replace("3.0", "4.0"))
    again = Store(tmp_path / "s", Plan(load(run)), asked)
    assert again.done == {plan.ids[1]}
    again.close()
    run.write_text(run.read_text() + "[thermal]\nkT = 1.0\n")
    with pytest.raises(ValueError, match="holds another sweep"):
        Store(tmp_path / "s", Plan(load(run)), asked)


def test_partitioned_folders(tmp_path):
    """Folders named KEY=VALUE give numbers to choose and to draw by."""
    points().to_parquet(tmp_path / "d", partition_cols=["thermal.kT"])
    assert call(tmp_path / "d", "--by", "thermal.kT").exit_code == 0
    assert (
        call(
            tmp_path / "d", "--x", "thermal.kT", "--where", "drive.velocity=0.001"
        ).exit_code
        == 0
    )


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
    assert (
        call(made, "--by", "thermal.kT", "--where", "contacts.stiffness=2").exit_code
        == 0
    )
    chosen = [
        "--where",
        "contacts.stiffness=1",
        "--where",
        "thermal.kT=1e-1",
        "--where",
        "disorder=annealed",
    ]
    assert json.loads(call(made, *chosen, "--json").stdout)["points"] == 9


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ["--x", "velocity"],
            '--x velocity: no such column; did you mean "drive.velocity"?',
        ),
        (
            ["--y", "mass"],
            "--y mass: no such column; there are disorder, contacts.stiffness",
        ),
        (["--by", "kt"], '--by kt: no such column; did you mean "thermal.kT"?'),
        (["--where", "kT=1"], "--where kT: no such column"),
        (["--where", "kT"], "--where kT: must be KEY=VALUE"),
        (
            ["--where", "thermal.kT=1", "--where", "thermal.kT=0.1"],
            "--where thermal.kT=0.1: thermal.kT has a value already",
        ),
        (
            ["--where", "thermal.kT=2"],
            "--where thermal.kT=2: no point has this value; there are 0.01, 0.1, 1",
        ),
        (
            ["--where", "thermal.kT=hot"],
            "no point has this value; there are 0.01, 0.1, 1",
        ),
        (
            ["--where", "disorder=quenched"],
            "no point has this value; there are annealed",
        ),
        (
            ["--y", "status"],
            "--y status: is not a column of numbers but of failed, ok, unreliable",
        ),
        (
            ["--where", "status=failed"],
            "--y friction: no point to draw; left out: 1 failed",
        ),
        (
            ["--x", "pinned", "--y", "contacts.stiffness"],
            "besides --x and --by other parameters vary",
        ),
        (
            ["--by", "thermal.kT", "--out", "p.gif"],
            "--out p.gif: must end in .png, .pdf or .svg",
        ),
        (["--width", "3 mm"], "--width 3 mm: must be a length, 50mm to 500mm"),
        (["--width", "85"], "--width 85: must be a length"),
        (["--y", "friction,"], "--y : no such column"),
        (
            ["--by", "thermal.kT", "--by", "disorder", "--by", "pinned"],
            "--by pinned: at most two columns",
        ),
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
    pd.DataFrame({"thermal.kT": [0.0, 1.0], "friction": [1.0, 2.0]}).to_parquet(
        zero / "p.parquet"
    )
    assert (
        "thermal.kT = 0 is not above 0"
        in call(zero, "--x", "thermal.kT", "--log-x").stderr
    )
