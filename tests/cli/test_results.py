"""What Python shows of eqsim: names, help, texts and tables of results, pictures,
sweeps, series and breaks."""

import dataclasses
import inspect
import math
import pydoc
import re
import subprocess
import sys

import matplotlib
import numpy as np
import pandas as pd
import pytest
from command_line import call

import eqsim
from eqsim import (
    Drive,
    Elastic,
    Ensemble,
    Estimate,
    Gamma,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    breaks,
    curve,
    fluctuations,
    load,
    reference,
    run,
    steady,
    sweep,
    trajectory,
    transient,
)
from eqsim.estimate import Averages, score

matplotlib.use("Agg")
WARM = Ensemble(thermal=Thermal(0.1), count=500)
DRIVE = Drive(0.1, 10.0)
FUNCTIONS = [name for name in eqsim.__all__ if inspect.isfunction(getattr(eqsim, name))]
CLASSES = [name for name in eqsim.__all__ if inspect.isclass(getattr(eqsim, name))]


# ------------------------------------------------------------------------------------------------------
# discovery


def test_names_can_be_completed_before_any_is_used():
    said = subprocess.run(
        [sys.executable, "-c", "import eqsim; print(*dir(eqsim))"],
        capture_output=True,
        text=True,
    )
    assert set(eqsim.__all__) | {"__version__"} <= set(said.stdout.split())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_help_says_what_functions_take(name):
    """The signature with its defaults, and a line on every parameter."""
    function, text = (
        getattr(eqsim, name),
        pydoc.plain(pydoc.render_doc(getattr(eqsim, name))),
    )
    signature = inspect.signature(function)
    assert name + "(" in text
    assert "Lazy" not in text
    told = text.partition("Parameters\n")[2].partition("Raises\n")[0]
    for parameter, part in signature.parameters.items():
        assert re.search(rf"\b{parameter}\b", told), f"{name}({parameter})"
        if part.default is not part.empty and isinstance(
            part.default, float | int | str
        ):
            assert f"= {part.default!r}" in text, f"{name}({parameter})"


@pytest.mark.parametrize("name", CLASSES)
def test_help_says_what_classes_hold(name):
    """Every field, in the class or in one that it extends."""
    kind = getattr(eqsim, name)
    text = " ".join(inspect.getdoc(part) or "" for part in kind.__mro__[:-1])
    assert len(text) > 30
    if name == "RunFile":  # its keys are those of run files
        return
    for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
        assert re.search(rf"\b{field.name}\b", text), f"{name}.{field.name}"


def test_defaults_are_shown():
    assert "thermal: eqsim.laws.thermal.Thermal = Thermal(kT=0.0" in str(
        inspect.signature(Ensemble)
    )


@pytest.mark.parametrize(
    "many", [np.array([0.1, 0.2]), np.array([0.1]), [0.1, 0.2], (0.1,)], ids=str
)
def test_many_velocities(many):
    """One sentence that says what to call, and what that says is what one velocity at a
    time does."""
    with pytest.raises(
        InputError,
        match=r"^velocity = .*: must be one number; eqsim\.curve\(ensemble, velocities\) is",
    ):
        Drive(many)
    found = curve(WARM, many)
    for i, v in enumerate(many):
        exact = reference(WARM, Drive(v)).friction
        assert (
            abs(found.friction[i] - exact.value)
            <= found.friction_error[i] + exact.stderr
        )


def test_other_arrays_are_refused_as_text_is():
    with pytest.raises(
        InputError, match=r"^kT = array\(0\.1\): must be a finite number >= 0"
    ):
        Thermal(kT=np.array(0.1))
    with pytest.raises(
        InputError, match=r"^x_star = \[1\.0\]: must be a finite number > 0"
    ):
        Gamma(x_star=[1.0])
    assert Thermal(kT=np.float64(0.1)) == Thermal(0.1)


def test_run_files_know_where_they_are(tmp_path, monkeypatch):
    """A path may be text; tables of thresholds are found from anywhere; `run` takes the
    path as the command does."""
    (tmp_path / "x.csv").write_text("threshold\n1.0\n2.0\n")
    text = (
        '[contacts]\ncount = 50\n[thresholds]\nlaw = "table"\nfile = "x.csv"\n'
        "[drive]\nvelocity = 0.1\ndistance = 9.0\n"
    )
    (tmp_path / "run.toml").write_text(text)
    monkeypatch.chdir("/")
    file = load(str(tmp_path / "run.toml"), {"drive.velocity": 0.2})
    assert file.ensemble.thresholds.mean == 1.5
    assert file.drive == Drive(0.2, 9.0)
    assert file.folder == tmp_path
    assert run(str(tmp_path / "run.toml")).trajectory.X[-1] == 9.0
    with pytest.raises(InputError, match=r"nowhere\.toml: cannot be read"):
        load("nowhere.toml")
    with pytest.raises(
        InputError, match=r"^file = 3: must be a run file or the path of one"
    ):
        run(3)


# -------------------------------------------------------------------------------------------------------
# results


def test_estimates_are_written_as_physicists_do():
    assert str(Estimate(0.92858, 0.00084, 10)) == "0.92858(84)"
    assert repr(Estimate(1.2345e-9, 2.1e-11, 10)) == "Estimate(1.234(21)e-09)"
    assert str(Estimate(1.0, 0.0, 10)) == "1"
    assert str(Estimate(None, None, 0)) == "none seen"
    assert str(Estimate(2.0, 0.1, 3, reliable=False)) == "2.00(10)  unreliable"


@pytest.fixture(scope="module")
def results():
    uniform = Ensemble(count=64, stiffness_law="uniform")
    steps = Programme([Segment(0.1, distance=3.0), Segment(0.0, time=10.0)])
    pulled = Programme([Segment(0.1, distance=3.0)], stage=Stage(0.5, damping=0.1))
    return {
        "steady": steady(WARM, DRIVE, rel_error=1e-2),
        "reference": reference(WARM, DRIVE),
        "trajectory": trajectory(WARM, DRIVE, points=21, replicas=3),
        "programme": trajectory(WARM, steps, points=21),
        "slider": trajectory(uniform, pulled, points=21, replicas=2),
        "elastic": eqsim.elastic_trajectory(
            uniform, Drive(1.0, 5.0, elastic=Elastic(8, 1.0, 0.5)), points=21
        ),
        "transient": transient(WARM, DRIVE, 21),
        "curve": curve(WARM, [1.0, 0.1, 0.01]),
        "fluctuations": fluctuations(WARM, DRIVE, 21),
        "breaks": breaks(WARM, DRIVE),
        "stability": eqsim.stability(uniform, pulled),
        "averages": trajectory(WARM, DRIVE, points=21).averages,
    }


CURVES = {
    "trajectory",
    "programme",
    "slider",
    "elastic",
    "transient",
    "curve",
    "fluctuations",
    "breaks",
}


def test_texts_are_short(results):
    for name, result in results.items():
        assert repr(result).startswith(type(result).__name__ + "("), name
        assert len(repr(result)) < 300, name
        assert "array(" not in repr(result)
    assert repr(results["reference"]).startswith("Reference(friction 0.928371")
    assert "21 points, X 0 to 10, force 0 to" in repr(results["transient"])


def test_tables(results):
    """Curves as columns; estimates one a row, whose numbers are those of the result;
    the same in notebooks."""
    for name, result in results.items():
        table, html = result.to_pandas(), result._repr_html_()
        assert isinstance(table, pd.DataFrame)
        assert "<table" in html
        assert type(result).__name__ in html
        if name in CURVES:
            for column in table:
                np.testing.assert_array_equal(table[column], result.columns()[column])
        else:
            assert list(table.columns) == ["value", "stderr", "n", "dof", "reliable"]
    assert (
        results["steady"].to_pandas().loc["friction", "value"]
        == results["steady"].friction.value
    )
    stability = results["stability"].to_pandas()
    assert (
        stability.loc["critical_stiffness", "value"]
        == results["stability"].critical_stiffness.value
    )
    assert (
        stability.loc["fresh_critical_stiffness", "value"]
        == results["stability"].fresh.critical_stiffness.value
    )


def test_pictures(results):
    """The line is the result's, in the order of x; one result on another; a result
    without either has none."""
    from matplotlib import pyplot

    for name in CURVES:
        result = results[name]
        axes = result.plot(label="this")
        x, y = axes.lines[0].get_data()
        order = np.argsort(getattr(result, result.drawn.x), kind="stable")
        np.testing.assert_array_equal(x, np.sort(x) if name != "slider" else x)
        np.testing.assert_array_equal(
            np.sort(y), np.sort(getattr(result, result.drawn.y)[order])
        )
        assert axes.get_legend().get_texts()[0].get_text() == "this"
        assert axes.get_xlabel()
    axes = results["trajectory"].plot()
    assert results["transient"].plot(axes, color="k") is axes
    assert len(axes.lines) == 2
    low, high = (
        axes.collections[0].get_paths()[0].vertices[:, 1].min(),
        results["trajectory"].force.max(),
    )
    assert low <= 0.0 < high
    axes = results["programme"].plot()
    results["programme"].plot(axes, x="X")
    assert axes.get_xlabel() == "time  $t$"
    np.testing.assert_array_equal(axes.lines[1].get_xdata(), results["programme"].X)
    assert results["transient"].plot(x="t").get_xlabel() == "time  $t$"
    with pytest.raises(
        ValueError, match=r"^x = 'T': must be a column of Transient: X, force"
    ):
        results["transient"].plot(x="T")
    with pytest.raises(TypeError, match=r"^Stability has no picture"):
        results["stability"].plot()
    pyplot.close("all")


def test_pictures_of_averages(results):
    """Values with two standard errors; beside a reference, the differences in standard
    errors, a score for each average that has an error."""
    from matplotlib import pyplot

    found = results["steady"]
    exact = reference(WARM, DRIVE, variance=True)
    axes = found.plot()
    points, _, (bars,) = axes.containers[0]
    assert [label.get_text().partition("\n")[0] for label in axes.get_yticklabels()] == [
        "friction", "pinned", "break stretch", "force variance",
    ]  # fmt: skip
    assert points.get_xdata()[0] == found.friction.value
    (low, _), (high, _) = bars.get_segments()[0]
    assert high - low == pytest.approx(4 * found.friction.stderr, rel=1e-9, abs=0)
    without = {
        name: dataclasses.replace(x, stderr=None)
        for name, x in found.averages().items()
    }
    alone = Averages(**without).plot(reference=Averages(**without))
    assert not alone.get_yticks().size
    assert str(Estimate(math.nan, 1.0, 3)) == "nan"
    axes = found.plot(reference=exact)
    z = axes.containers[0][0].get_xdata()
    names = [label.get_text().partition("\n")[0] for label in axes.get_yticklabels()]
    # pinned is 1 exactly
    assert names == ["friction", "break stretch", "force variance"]
    for value, name in zip(
        z, ("friction", "break_stretch", "force_variance"), strict=True
    ):
        assert value == score(getattr(found, name), getattr(exact, name))
    assert axes.get_xlim()[1] >= 1.1 * np.abs(z).max()
    exact.plot(found.plot(), label="exact")
    pyplot.close("all")


def test_axes_in_units_of_the_run_file(tmp_path):
    """Symbols are mathematics; units are those of [units], and x_* without it."""
    from matplotlib import pyplot

    text = "[contacts]\ncount = 50\n[drive]\nvelocity = 0.1\ndistance = 9.0\n"
    (tmp_path / "free.toml").write_text(text)
    (tmp_path / "nano.toml").write_text(
        text + '[units]\nlength = "nm"\ntime = "s"\nforce = "nN"\n'
    )
    axes = run(tmp_path / "nano.toml").plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "slider displacement  $X$  [nm]",
        "friction  $F / (N k)$  [nm]",
    )
    axes = run(tmp_path / "free.toml").plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "slider displacement  $X$  [$x_*$]",
        "friction  $F / (N k)$  [$x_*$]",
    )
    axes = curve(WARM, [0.1, 1.0]).plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "velocity  $v$",
        r"friction  $\langle F \rangle/(N k)$",
    )
    pyplot.close("all")


def test_results_of_commands(tmp_path):
    from matplotlib import pyplot

    (tmp_path / "run.toml").write_text(
        "[contacts]\ncount = 50\n[drive]\nvelocity = 0.1\ndistance = 9.0\n"
    )
    found = run(tmp_path / "run.toml")
    assert repr(found).startswith("RunResult(Trajectory(2001 points")
    assert len(found.plot().lines) == 2
    assert len(found.to_pandas()) == 2001
    assert "<table" in found._repr_html_()
    pyplot.close("all")


# --------------------------------------------------------------------------------------------------------
# sweeps

AXES = '"thermal.kT" = [0.1, 0.2]\n"drive.velocity" = [0.1, 1.0]\n'
RUN = f"[contacts]\ncount = 500\n[drive]\nvelocity = 0.1\n[sweep]\n{AXES}"


def test_sweep_is_that_of_the_command(tmp_path):
    """From a run file, from values by key, and from the command line: the same rows (to
    1e-12: processes of the command have one thread for linear algebra)."""
    (tmp_path / "run.toml").write_text(RUN)
    done = call(
        "sweep",
        tmp_path / "run.toml",
        "--out",
        tmp_path / "out",
        "--workers",
        "1",
        "--quiet",
    )
    assert done.exit_code == 0, done.output
    theirs = pd.read_parquet(tmp_path / "out" / "sweep.parquet")
    seen = []
    grid = {"thermal.kT": np.array([0.1, 0.2]), "drive.velocity": (0.1, 1.0)}
    values = {"contacts.count": 500, "drive.velocity": 0.1}
    ours = sweep(values, grid, progress=lambda done, total: seen.append((done, total)))
    again = sweep(tmp_path / "run.toml", progress=False)
    assert seen[-1] == (4, 4)
    for table in (ours, again):
        assert list(table.columns) == list(theirs.columns)
        assert list(table["id"]) == list(theirs["id"])
        numbers = table.select_dtypes("number").columns.drop("seconds")
        np.testing.assert_allclose(
            table[numbers].astype(float), theirs[numbers].astype(float), rtol=1e-12
        )
    assert ours["status"].eq("ok").all()


def test_sweep_keeps_and_continues(tmp_path):
    grid = {"drive.velocity": {"log": [0.1, 1.0, 2]}}
    first = sweep({"contacts.count": 100}, grid, out=tmp_path / "kept")
    seen = []
    again = sweep(
        {"contacts.count": 100},
        grid,
        out=tmp_path / "kept",
        progress=lambda *at: seen.append(at),
    )
    pd.testing.assert_frame_equal(first, again)
    assert seen == []


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: sweep({"kT": 0.1}, {"drive.velocity": [0.1]}),
            'kT: is not a key .* did you mean "thermal.kT"',
        ),
        (
            lambda: sweep({}, {"drive.velocty": [0.1]}),
            "sweep.drive.velocty: is not a key",
        ),
        (lambda: sweep({}, {}), "sweep: needs a"),
        (lambda: sweep({}, [0.1]), r"grid = \[0.1\]: must be values by key"),
        (
            lambda: sweep({}, {"drive.velocity": [0.1]}, workers=-1),
            "workers = -1: must be an integer",
        ),
        (
            lambda: sweep({"drive.velocity": 1.0}, {"thermal.kT": [-1.0]}),
            "sweep, point 1 of 1: thermal.kT = -1.0",
        ),
        (lambda: sweep(7), "file = 7: must be a run file"),
    ],
)
def test_bad_sweeps(make, message):
    with pytest.raises(InputError, match="^" + message):
        make()


def test_points_that_fail_are_warned_about():
    with pytest.warns(
        UserWarning, match=r"^2 of 2 points failed, the first at .*max_lives = 1e\+04"
    ):
        table = sweep(
            {"drive.velocity": 0.1}, {"thermal.kT": [0.0, 0.1]}, max_lives=1e4
        )
    assert table["status"].eq("failed").all()
    assert table["message"].str.contains("max_lives").all()
