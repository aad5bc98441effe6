"""Pictures of runs: what their titles, axes and legends say, in which formats they are,
and what colours they have."""

import json
from itertools import combinations
from types import SimpleNamespace

import matplotlib
import matplotlib.colors
import numpy as np
import pytest
from command_line import call
from matplotlib import animation
from matplotlib.ticker import AutoLocator
from typer.testing import CliRunner

from eqsim import load
from eqsim.cli.app import app
from eqsim.estimate import OBSERVABLES, Estimate
from eqsim.io import labels
from eqsim.io.parameters import keys
from eqsim.io.units import Units
from eqsim.master.chain_modes import Modes
from eqsim.model.healing import Healing
from eqsim.plots import checks, runs, style
from eqsim.plots.chains import animation_of, chain_figure
from eqsim.plots.panels import Caption
from eqsim.plots.style import saved
from eqsim.workflows.curve import curve
from eqsim.workflows.run import run

RUN = """
title = "A $ film, k_i"
[contacts]
count = 50
[thermal]
kT = 0.1
[delay]
time = 1.0
[drive]
velocity = 0.1
distance = 100.0
[output]
points = 1001
"""
UNITS = '[units]\nlength = "um"\ntime = "s"\nforce = "uN"\n[interface]\nnormal_load = 100.0\n'


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "film.toml"
    path.write_text(RUN)
    return path


SHORT = ("--set", "drive.distance=5.0", "--set", "output.points=21")


def simulated(path, changes=None):
    return run(load(path, changes), path.parent).picture("film")


def texts(figure):
    """Of the legend of a figure."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_a_run_shows_its_title_its_contacts_and_its_transient(run_file):
    figure = simulated(run_file)
    title = figure.get_suptitle()
    assert title.startswith("A \\$ film, k_i\n50 quenched contacts, $k_i \\propto")
    assert "k_B T = 0.1" in title
    first, whole = figure.axes[:2]
    assert (
        first.get_xlim()[1]
        < 0.1 * whole.get_xlim()[1]
        == pytest.approx(10.0, rel=1e-12, abs=0)
    )
    assert first.get_ylabel() == "friction  $F / (N k)$\n[$x_*$]"
    assert any(
        "± 2 standard deviations between ensembles of N = 50" in text
        for text in texts(figure)
    )
    # the legend stands below the panels
    style.saved(figure)
    lowest = min(axes.get_window_extent().y0 for axes in figure.axes)
    assert figure.legends[0].get_window_extent().y1 < lowest
    short = simulated(run_file, {"drive.distance": 10.0})  # control: nothing to enlarge
    assert len(short.axes) == 3


def test_labels_are_within_the_page(run_file):
    """Also that of differences, whose panel is low: with half numbers on its axis, which
    come and go with its height (control), it is not."""

    def left_end(figure):
        saved(figure)
        return min(
            axes.yaxis.label.get_window_extent().x0
            for axes in figure.axes
            if axes.get_ylabel()
        )

    changes = {"drive.distance": 5.0, "output.points": 101}
    figure = simulated(run_file, changes)
    assert left_end(figure) > 0.0
    figure = simulated(run_file, changes)
    figure.axes[1].yaxis.set_major_locator(AutoLocator())
    assert left_end(figure) < 0.0


def test_long_titles_are_within_the_page(run_file):
    """Signs of dollar in a title begin no formula, which would stay whole."""
    file = load(run_file, {"title": "from $1 " + "for a word " * 16 + "to $9"})
    caption = Caption.of(file)
    figure = runs.sizes_figure(np.ones(9, int), 9, np.empty(0), caption, False)
    saved(figure)
    title = figure.axes[0].title
    lines = title.get_text().split("\n")
    assert len(lines) > 2
    assert [" ".join(lines[:-1]), lines[-1]] == caption.heading.split("\n")
    extent = title.get_window_extent()
    assert 0 < extent.x0 < extent.x1 < figure.bbox.x1
    assert extent.y1 < figure.bbox.y1


def test_long_titles_of_films(monkeypatch):
    monkeypatch.setattr(animation, "FuncAnimation", lambda figure, *_, **__: [figure])
    records = np.zeros((2, 5))
    found = SimpleNamespace(
        t=records[:, 0], in_space=lambda _: records, chain=SimpleNamespace(count=5)
    )
    (figure,) = animation_of(found, Caption("a film of a chain " * 9))
    saved(figure)
    extent = figure.axes[0].title.get_window_extent()
    assert 0 < extent.x0 < extent.x1 < figure.bbox.x1


def programme(points):
    """Four holds and motion between, of so many records each, whatever contacts do."""
    count = 7 * points
    segment = np.maximum(np.arange(count + 1) - 1, 0) // points
    segments = [SimpleNamespace(velocity=i % 2, t=1.0 + i) for i in range(7)]
    force, t = np.full(count + 1, 0.5), np.linspace(0.0, 7.0, count + 1)
    return SimpleNamespace(
        t=t, X=t, force=force, force_stderr=0.1 * force, segment=segment,
        segments=segments,
    )  # fmt: skip


def test_panels_of_holds():
    """Each shows a line, and labels are beside each other within the page. Of a hold of
    one record beside that at which it begins (control), there is none to show."""

    def panels(points):
        figure = runs.programme_figure(programme(points), None, Caption(""))
        saved(figure)
        return figure, [axes for axes in figure.axes if axes.get_xscale() == "log"]

    figure, below = panels(3)
    for number, panel in enumerate(below):
        label = f"time held, segment {2 * number}\n[unit of the run file]"
        assert panel.get_xlabel() == label
        assert np.count_nonzero(panel.lines[0].get_xdata() > 0) > 1
    extents = [panel.xaxis.label.get_window_extent() for panel in below]
    edges = [x for extent in extents for x in (extent.x0, extent.x1)]
    assert len(edges) == 8
    assert sorted([0.0, *edges, figure.bbox.x1]) == [0.0, *edges, figure.bbox.x1]
    assert panels(1)[1] == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_forces_of_a_chain_that_reverses_are_within_the_axes(sign):
    """With all marks and room below them; else the axis begins at 0 (control)."""
    t = np.linspace(0.0, 1.0, 21)
    force = np.where(t < 0.5, t, sign * t)
    events = {"t": t[-1:], "peak": 1.1 * force[-1:], "blocks": np.array([5])}
    found = SimpleNamespace(
        t=t, spring=force, force=0.9 * force, roughness=t,
        events=events | {"ended": np.array([True])}, chain=SimpleNamespace(count=5),
    )  # fmt: skip
    figure = chain_figure(found, Caption(""))
    saved(figure)
    top = figure.axes[0]
    low, high = top.get_ylim()
    assert low == 0.0 if sign > 0 else low < -1.1
    assert high > force.max()
    legend = top.get_legend().get_window_extent()
    points = top.transData.transform(np.column_stack((t, force)))
    assert not any(legend.contains(*point) for point in points)


def test_titles_say_what_is_simulated(run_file):
    """Whatever the run file's own title says, in pictures and tables."""
    changes = {
        "disorder": "annealed",
        "output.replicas": 3,
        "contacts.stiffness_law": "uniform",
        "thermal.kT": 0.0,
    }
    figure = simulated(
        run_file, {**changes, "drive.distance": 5.0, "output.points": 51}
    )
    assert "50 annealed contacts, uniform stiffness, $T = 0$" in figure.get_suptitle()
    assert any(
        "mean of 3 simulated ensembles, ± 2 standard errors" in text
        for text in texts(figure)
    )
    shown = (
        CliRunner()
        .invoke(
            app,
            [
                "steady",
                str(run_file),
                "--set",
                "disorder=annealed",
                "--rel-error",
                "0.1",
            ],
        )
        .stdout
    )
    assert "50 annealed contacts, k_i ~ sqrt(f_si), kT = 0.1 k x_*^2" in shown
    assert "quenched" not in shown


def test_exact_curves(tmp_path):
    """Against X, and along a programme against t; panels below the force where there is
    something to see in them."""
    path = tmp_path / "run.toml"
    path.write_text(
        'title = "A film"\n[drive]\nvelocity = 0.1\ndistance = 4.0\n[output]\npoints = 21\n'
    )
    steps = "[drive]\nprogramme = [{ velocity = 0.1, distance = 1.0 }, { velocity = 1.0, distance = 1.0 }]\n"
    every = {
        "force": {},
        "pinned fraction\n$N_c / N$": {"delay.time": 1.0},
        "displacement\n[$x_*$]": {
            "contacts.stiffness_law": "uniform", "drive.stage.stiffness": 0.5, "drive.stage.damping": 0.1,
        },
        "time": {},
    }  # fmt: skip
    for label, changes in every.items():
        if label == "time":
            path.write_text(steps)
        file = load(path, changes)
        found = curve(file)
        columns, figure = found.columns, found.figures(path.stem)["transient"]
        labels = [axes.get_ylabel() for axes in figure.axes]
        assert labels[0] == "friction  $F / (N k)$\n[$x_*$]"
        (line,) = figure.axes[0].lines
        along = "t" if label == "time" or "displacement" in label else "X"
        np.testing.assert_array_equal(line.get_xdata(), columns[along])
        np.testing.assert_array_equal(line.get_ydata(), columns["force"])
        assert label in labels[1:] or (label in ("force", "time") and len(labels) == 1)
        assert (
            figure.axes[-1]
            .get_xlabel()
            .startswith("time" if along == "t" else "slider displacement")
        )
        assert "quenched contacts" in figure.axes[0].get_title()


def test_units_are_on_the_axes(run_file):
    run_file.write_text(RUN + UNITS)
    figure = simulated(run_file, {"drive.distance": 10.0, "output.points": 51})
    top, *_, last = figure.axes
    assert top.get_ylabel() == "friction  $F / (N k)$  [µm]"
    assert last.get_xlabel() == "slider displacement  $X$  [µm]"
    (right,) = top.child_axes
    assert right.get_ylabel() == "friction coefficient"
    style.saved(figure)
    # 50 uN/um over 100 uN
    assert right.get_ylim()[1] == pytest.approx(
        0.5 * top.get_ylim()[1], rel=1e-9, abs=0
    )


def test_formats(run_file, tmp_path):
    out = tmp_path / "o"
    args = [
        "run",
        str(run_file),
        "--out",
        str(out),
        "--format",
        "pdf",
        "--format",
        "svg",
        "--set",
        "drive.distance=5.0",
    ]
    result = CliRunner().invoke(app, [*args, "--set", "output.points=21"])
    assert result.exit_code == 0, result.output
    begins = {"force.png": b"\x89PNG", "force.pdf": b"%PDF", "force.svg": b"<?xml"}
    assert all(
        (out / name).read_bytes().startswith(begin) for name, begin in begins.items()
    )
    assert "force.png, force.pdf, force.svg" in " ".join(result.stdout.split())
    refused = call("run", run_file, "--out", tmp_path / "p", "--format", "gif")
    assert refused.exit_code == 2
    assert '--format = \'gif\': must be one of "png", "pdf", "svg"' in refused.stderr
    assert not (tmp_path / "p").exists()


def test_every_key_and_observable_has_a_label(run_file):
    """Words, not the key itself, and mathematics that matplotlib can set."""
    programme = tmp = run_file.with_name("p.toml")
    tmp.write_text(
        "[drive]\nprogramme = [{ velocity = 1.0, distance = 1.0 }, { hold = 1.0 }]\nstage = { stiffness = 1.0 }"
    )
    names = {
        *keys(load(run_file)),
        *keys(load(programme)),
        *OBSERVABLES,
        "segment_1_peak",
        "segment_0_memory",
        "period",
    }
    figure = matplotlib.figure.Figure()
    bare = []
    for units in (Units(), Units("nm", "s", "nN"), Units("x_*", "1/w^2", "k x_*")):
        for name in sorted(names):
            label = labels.axis(name, units)
            bare += [name] * (label == name)
            figure.text(0, 0, label)
    style.saved(figure)
    assert bare == []
    assert (
        labels.axis("drive.velocity", Units("um", "s"))
        == "driving velocity  $v$  [µm/s]"
    )
    assert (
        labels.axis("thermal.kT", Units("m", "s", "N"))
        == "thermal energy  $k_B T$  [J]"
    )
    assert labels.axis("force_variance", Units("nm")).endswith("[nm$^{2}$]")
    assert labels.axis("friction", Units("x_*")).endswith("[$x_*$]")


@pytest.mark.parametrize(
    ("change", "key", "unit"),
    [
        ({}, "friction", "[$x_*$]"),
        ({}, "drive.velocity", r"[$x_*\,\omega$]"),
        ({}, "thermal.kT", "[$k\\,x_*^2$]"),
        ({}, "delay.time", r"[$1 / \omega$]"),
        ({"thresholds.x_star": 2.0}, "friction", "[length unit of the run file]"),
        ({"thresholds.x_star": 2.0}, "delay.time", r"[$1 / \omega$]"),
        (
            {"sweep.contacts.stiffness": [1.0, 2.0]},
            "thermal.kT",
            "[unit of the run file]",
        ),
        ({"units.length": "nm"}, "friction", "[nm]"),
        ({"units.length": "nm"}, "drive.velocity", "[unit of the run file]"),
    ],
)
def test_numbers_without_units_are_in_those_that_are_one(tmp_path, change, key, unit):
    path = tmp_path / "run.toml"
    path.write_text("[drive]\nvelocity = 1.0")
    label = labels.axis(key, load(path, change).units)
    assert label.endswith(unit)
    matplotlib.figure.Figure().text(0, 0, label)


def sizes(breaks, per, *, bursts):
    """The axes of a picture of sizes, without a law."""
    figure = runs.sizes_figure(breaks, per, np.empty(0), Caption(""), bursts)
    return figure.axes[0]


def test_all_sizes_are_within_the_axes():
    """Also where contacts that form again break four times each."""
    axes = sizes(np.ones(828, int), 200, bursts=True)
    (points, *_) = axes.containers[0].lines
    low, high = axes.get_ylim()
    (highest,) = points.get_ydata()
    assert low < 4.0 < highest < high


def test_bursts_are_no_avalanches_where_contacts_break_one_by_one():
    assert sizes(np.ones(200, int), 200, bursts=True).get_ylabel().startswith("bursts")
    assert "probability" in sizes(np.ones(200, int), 200, bursts=False).get_ylabel()


SLIPS = """
[contacts]
count = 20
[thresholds]
law = "delta"
[drive]
velocity = 1.0
time = 30.0
[drive.stage]
stiffness = 0.05
[output]
points = 31
replicas = 3
"""
AT_SAME_X = "friction of the contacts, ± 2 standard errors at the same X"
SCATTER = "friction of the contacts, ± 2 standard errors"
OF_SPRING = "force of the spring; displacement of the stage"
SLIDER = "displacement of the slider"


@pytest.mark.parametrize(
    ("changes", "title", "said"),
    [
        ({}, "means of 3 replicas", [SCATTER, OF_SPRING, "slips of all replicas, at half of their drop"]),
        ({"output.replicas": 1}, "", [AT_SAME_X, OF_SPRING, "slips, at half of their drop"]),
        ({"drive.stage": None, "drive.stall_force": 2.0, "drive.time": 3.0}, "means of 3 replicas",
         [SCATTER, "force of the motor"]),
    ],
    ids=["three", "one", "motor"],
)  # fmt: skip
def test_legends_of_sliders(tmp_path, changes, title, said):
    """Legends say what errors are, of how many replicas lines are means, what pulls."""
    path = tmp_path / "slider.toml"
    path.write_text(SLIPS)
    found = run(load(path, changes))
    figure = found.figures("")["force"]
    (legend,) = figure.legends
    assert legend.get_title().get_text() == title
    assert [text for text in texts(figure) if "mean field" not in text] == [
        *said,
        SLIDER,
    ]
    pull = "spring" if OF_SPRING in said else "motor"
    assert figure.axes[2].get_ylabel().startswith(f"force of the {pull}")
    stage = [line for line in figure.axes[1].lines if line.get_linestyle() == "-"]
    assert len(stage) == (pull == "spring")


BLOCKS = """
[contacts]
count = 64
stiffness_law = "uniform"
[drive]
velocity = 1.0
distance = 5.0
[elastic]
blocks = 4
coupling = 2.0
drive_stiffness = 0.5
[output]
replicas = 2
points = 1002
"""


def test_no_break_is_missing_in_a_picture_of_breaks(tmp_path):
    """Pixels are as many as a panel can show, and their sum is that of all breaks of
    the first replica."""
    path = tmp_path / "blocks.toml"
    path.write_text(BLOCKS)
    found = run(load(path))
    figure = found.figures("")["fronts"]
    saved(figure)
    breaks = found.trajectory.blocks["breaks"].reshape(2, 1002, 4)[0]
    panel = figure.axes[1]
    (image,) = panel.images
    assert image.get_array().sum() == breaks[-1].sum() - breaks[0].sum() > 50
    assert image.get_array().shape == (334, 4)  # of 3 of the 1001 intervals
    assert image.get_array().shape[0] < panel.get_window_extent().height
    # a third of the last row is beyond the end; 1e-12 is rounding
    end = 5.0 * 1002 / 1001
    assert image.get_extent()[3] == pytest.approx(end, rel=1e-12, abs=0)
    assert panel.get_ylim()[1] == pytest.approx(5.0, rel=1e-12, abs=0)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert "breaks between two records,\nsums over 3 intervals" in labels
    assert figure.get_suptitle().endswith("the first of 2 replicas")


def test_the_spread_between_blocks_is_that_of_all_replicas(tmp_path):
    path = tmp_path / "blocks.toml"
    path.write_text(BLOCKS)
    found = run(load(path, {"output.points": 21}))
    X = found.trajectory.blocks["X"].reshape(2, 21, 4)
    (line,) = found.figures("")["force"].axes[1].lines
    expected = np.sqrt(0.5 * (X[0].var(axis=1) + X[1].var(axis=1)))
    # rounding of X, 1e-15, against a spread of 0.1
    np.testing.assert_allclose(line.get_ydata(), expected, rtol=0, atol=1e-13)


def test_healing_in_a_legend():
    """Estimates as on a terminal, not as mathematics, with units behind numbers."""
    law = Healing(Estimate(3.5e-5, 1e-6, 4, None, False), Estimate(2.0, 0.1, 4), 1.0, 2)
    hold = np.array([1.0, 10.0, 100.0])
    holds = hold, law.at(hold), np.full(3, 1e-6)
    caption = Caption("", units=Units("um", "s"))
    figure = runs.healing_figure(holds, np.empty(0), law, caption)
    label = figure.axes[0].get_legend().get_texts()[0].get_text()
    assert label == "3.50(10)e-05 µm per decade, beyond $t$ = 2.00(10) s, unreliable"
    sure = law._replace(rate=Estimate(3.5e-5, 1e-6, 4))
    label = runs.healing_figure(holds, np.empty(0), sure, caption).axes[0].lines[-1]
    assert label.get_label().endswith("2.00(10) s")


def test_growth_of_perturbations():
    """The softest mode lies on the line, also between points that are far apart."""
    q, growth = np.array([0.01, 0.1, 1.0]), np.array([1.0, 2.0, -1.0])
    none = Estimate(None, None, 0)
    modes = Modes(q, growth, 0 * q, 0 * q, none, 0.5, Estimate(1.9, 0.0, 1))
    figure = checks.modes_figure(modes, Caption("", units=Units("um", "s")))
    axes = figure.axes[0]
    assert axes.get_ylabel() == "growth rate  [1/s]"
    line, star, _ = axes.lines
    assert star.get_xydata()[0].tolist() in line.get_xydata().tolist()
    assert line.get_xdata().tolist() == [0.01, 0.1, 0.5, 1.0]
    (grow,) = axes.collections  # as far as the line is above 0, to rounding
    end = 0.5 + 0.5 * 1.9 / 2.9
    farthest = max(path.vertices[:, 0].max() for path in grow.get_paths())
    assert farthest == pytest.approx(end, rel=1e-9, abs=0)


def seen(color, matrix):
    """A colour as an eye without one kind of cone sees it (Vienot, Brettel and Mollon,
    1999), linear RGB."""
    rgb = np.asarray(matplotlib.colors.to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return matrix @ linear


PROTANOPE = np.array(
    [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]
)
DEUTERANOPE = np.array(
    [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]
)


def nearest(colors):
    """The least distance of two colours, for the three kinds of eyes."""
    views = (np.eye(3), PROTANOPE, DEUTERANOPE)
    return min(
        np.linalg.norm(seen(a, m) - seen(b, m))
        for m in views
        for a, b in combinations(colors, 2)
    )


def test_colours_are_told_apart_by_all_eyes():
    """matplotlib's own cycle, the control, is not."""
    usual = matplotlib.rcParamsDefault["axes.prop_cycle"].by_key()["color"][:6]
    assert nearest(style.COLORS[:6]) > 2 * nearest(usual)


def test_the_figure_of_the_readme(tmp_path):
    """Few points: every line and marker of two ensembles at three temperatures, on both
    panels."""
    from analysis.friction import plot

    figure = plot(points=2, fine=3)
    left, right = figure.axes
    for panel, lines in ((left, 201), (right, 3)):
        assert [len(line.get_xdata()) for line in panel.lines].count(lines) == 6
        assert len(panel.containers) == 6
    assert style.saved(figure).startswith(b"\x89PNG")


def test_summaries_of_runs_without_units_have_no_physical(run_file, tmp_path):
    out = tmp_path / "o"
    args = [
        "run",
        str(run_file),
        "--out",
        str(out),
        "--quiet",
        "--set",
        "drive.distance=5.0",
        "--set",
        "output.points=21",
    ]
    assert CliRunner().invoke(app, args).exit_code == 0
    assert "physical" not in json.loads((out / "summary.json").read_text())
