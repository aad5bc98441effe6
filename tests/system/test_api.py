"""The public names: what a type checker and a user see of them."""

import inspect
import json
import math
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import gamma
from typer.testing import CliRunner

import eqsim
from eqsim import (
    Aging,
    Delay,
    Distribution,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Interface,
    Population,
    Programme,
    Segment,
    Stage,
    Thermal,
    Units,
    reference,
    steady,
    trajectory,
)
from eqsim.cli.app import app
from eqsim.materials import STEEL, ActivatedAging

ROOT = Path(__file__).parents[2]
STEADY = Ensemble(count=10), Drive(0.1)
TWO = np.array([1.0, 2.0])
SEVERAL = Ensemble(thermal=Thermal(0.1), populations=[Population(0.5, stiffness=2.0)])
USER = """\
import eqsim
from eqsim import Drive, Ensemble, Thermal, reference, steady
found = steady(Ensemble(thermal=Thermal(kT=0.1)), Drive(velocity=0.1)).friction.value
reveal_type(eqsim.__version__)
reveal_type(found)
reveal_type(Ensemble)
reveal_type(steady("x.toml", changes={"thermal.kT": 0.1}).friction.value)
reference(Ensemble(), 0.1)
eqsim.Ensembel
eqsim.Programme([eqsim.Segment(0.1, distance=2.0)])
eqsim.Elastic(2, 1.0, 0.5, load=[1.0, 3.0])
"""
RUN = """[contacts]
count = 200
stiffness = 2.0
stiffness_law = "uniform"
[thermal]
kT = 0.1
[drive]
velocity = 0.1
distance = 2.0
[output]
points = 5
seed = 3
"""
UNITS = """[units]
length = "um"
force = "mN"
[interface]
area = 50.0
normal_load = 900.0
"""


@pytest.mark.long
def test_a_type_checker_sees_classes(tmp_path):
    """Their fields and mistakes in calls, also if it is strict; and no mistake in the
    package."""
    (tmp_path / "user.py").write_text(USER)
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--no-error-summary",
        "--cache-dir",
        str(tmp_path),
    ]
    done = subprocess.run(
        [*command, "eqsim", "analysis", str(tmp_path / "user.py")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    lines = [line.partition("user.py:")[2] for line in done.stdout.splitlines()]
    said = [
        line for line in lines if "note: Possible" not in line and "def __" not in line
    ]
    assert said[:2] == [
        '4: note: Revealed type is "str"',
        '5: note: Revealed type is "float | None"',
    ], done.stdout
    assert said[2].startswith('6: note: Revealed type is "def (thresholds: ')
    assert said[3] == '7: note: Revealed type is "float | None"'
    assert said[4].startswith(
        '8: error: No overload variant of "__call__" of "Call" matches argument types "Ensemble", "float"'
    )
    assert said[5].startswith('9: error: Module has no attribute "Ensembel"')
    assert len(said) == 6


def test_public_names():
    assert eqsim.__version__ == metadata.version("eqsim")
    names: dict[str, object] = {}
    exec("from eqsim import *", names)
    assert set(eqsim.__all__) <= set(names)
    assert names["run"].__wrapped__ is eqsim.workflows.run.run
    assert pickle.loads(pickle.dumps(eqsim.steady)) is eqsim.steady
    assert names["Newborn"] is eqsim.laws.newborn.Newborn
    with pytest.raises(
        AttributeError, match="module 'eqsim' has no attribute 'Ensembel'"
    ):
        eqsim.Ensembel  # noqa: B018


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: Ensemble(Thermal(0.1)),
            "thresholds = Thermal(kT=0.1, attempt_frequency=1.0, barrier='soft'): must be a law",
        ),
        (lambda: Ensemble(thermal=0.1), "thermal = 0.1: must be Thermal(...)"),
        (lambda: Programme(None), "programme = None: must be a list of Segment("),
        (
            lambda: Programme(Segment(time=1.0)),
            "load_rate=None): must be a list of Segment(",
        ),
        (lambda: Units(5), "length = 5: must be a unit"),
        (
            lambda: Distribution(gamma(3.0), ["a"]),
            "breakpoints = ['a']: must be finite numbers",
        ),
        (
            lambda: Distribution(gamma(3.0), [[1.0], [math.nan]]),
            "breakpoints = [[1.0], [nan]]: must be finite numbers",
        ),
        (lambda: Ensemble(Gamma), "Gamma'>: must be a law of thresholds"),
        *(
            (
                lambda kinds=kinds: Ensemble(populations=kinds),
                "must be a sequence of Po",
            )
            for kinds in ((1, 2), [Population(0.5), None], "ab", Population(1.0), None)
        ),
        (lambda: SEVERAL.b, "population: these are numbers of one kind"),
        (lambda: SEVERAL.crossover_velocity, "population: these are numbers of one"),
        *(
            (lambda threads=threads: steady(*STEADY, threads=threads), "threads = ")
            for threads in (-1, True, 1.5, "2", None)
        ),
        (lambda: trajectory(*STEADY, threads=-1), "threads = -1: must be an integer"),
        (lambda: eqsim.run("x.toml", threads="2"), "threads = '2': must be an integer"),
        (lambda: eqsim.validate(threads=-1), "threads = -1: must be an integer from"),
        (lambda: Delay(TWO), "time = array([1., 2.]): must be a finite number"),
        (lambda: Aging("flow", TWO), "rate = array([1., 2.]): must be a finite"),
        (
            lambda: Thermal(barrier="bell", off_rate=1.0, force_scale=TWO),
            "force_scale = array([1., 2.]): must be a finite number",
        ),
        (
            lambda: replace(STEEL, delay=1e-3),
            "delay = 0.001: must be ArrheniusTime(...)",
        ),
        (
            lambda: ActivatedAging(1e-18, 1e-9),
            "rate = 1e-18: must be ArrheniusRate(...)",
        ),
        (lambda: Programme([0.1]), "programme: holds 0.1; must be Segment("),
        (lambda: steady(0.1), "ensemble = 0.1: must be an Ensemble, a run file, or"),
        (lambda: steady(Ensemble()), "drive = None: must be a Drive"),
        (lambda: steady(Ensemble(), 0.1), "drive = 0.1: must be a Drive"),
        (
            lambda: steady(Ensemble(), Drive(0.1), changes={"output.seed": 2}),
            "changes = {'output.seed': 2}: are those of a run file",
        ),
    ],
)
def test_arguments_of_another_kind_are_named(call, said):
    with pytest.raises(InputError, match=re.escape(said)):
        call()


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text(RUN + UNITS)
    return path


def calls():
    """Public functions that take contacts and a drive, or a run file."""
    return {
        name: inspect.signature(getattr(eqsim, name)).parameters
        for name in eqsim.__all__
        if inspect.isfunction(getattr(eqsim, name))
    }


def test_what_takes_contacts_or_a_file_takes_changes():
    taking = {name: set(one) for name, one in calls().items()}
    contacts = {name for name, given in taking.items() if "ensemble" in given}
    assert len(contacts) == 14
    for name, given in taking.items():
        changed = name in contacts or "file" in given or name == "load"
        assert ("changes" in given) == changed, name
        assert ("changes : dict" in getattr(eqsim, name).__doc__) == changed, name
    assert all("RunFile, Path or str" in getattr(eqsim, x).__doc__ for x in contacts)


SPRING = {"drive.stage.stiffness": 0.3, "drive.stage.damping": 0.1, "delay.time": 1.0}
COLD = {"thermal.kT": 0.0}
SAME = {
    "breaks": {},
    "closure": {"disorder": "annealed"},
    "elastic_trajectory": COLD
    | {"elastic.blocks": 20, "elastic.coupling": 1.0, "elastic.drive_stiffness": 0.5},
    "fresh_slip": COLD,
    "reference": {"thermal.kT": 0.3},
    "stability": COLD | SPRING,
    "steady": {"thermal.kT": 0.3},
    "trajectory": {},
    "transient": {"delay.time": 0.3},
}


@pytest.mark.parametrize("name", SAME)
def test_a_run_file_is_its_contacts_and_drive(path, name):
    """With its seed and points, unless others are given; from a path and from a file,
    which keeps what it holds."""
    function, changes = getattr(eqsim, name), SAME[name]
    file = eqsim.load(path, changes)
    options = {
        key: getattr(file.output, key)
        for key in ("points", "seed", "replicas")
        if key in calls()[name]
    }
    known = repr(function(file.ensemble, file.drive, **options))
    assert repr(function(path, changes=changes)) == known
    assert repr(function(eqsim.load(path), changes)) == known
    if "points" in options:
        assert repr(function(path, changes=changes, points=4)) != known


def test_velocities_and_lags_of_a_run_file(path):
    contacts = eqsim.load(path).ensemble
    sweep = {"sweep.drive.velocity": {"log": [0.1, 1.0, 3]}}
    for known, found in (
        ([0.1], eqsim.curve(path)),
        ([0.3, 2.0], eqsim.curve(path, [0.3, 2.0])),
        ([0.3, 2.0], eqsim.curve(contacts, velocities=[0.3, 2.0])),
        (np.geomspace(0.1, 1.0, 3), eqsim.curve(path, changes=sweep)),
    ):
        assert found.velocity == pytest.approx(known, rel=1e-12, abs=0)
    exact = reference(path)
    lags = 5.0 * exact.travel.value / exact.pinned.value
    assert eqsim.fluctuations(path).lag[-1] == pytest.approx(lags, rel=1e-12, abs=0)


def test_a_drive_in_the_place_of_the_drive_of_a_run_file(path):
    assert (
        reference(path, Drive(2.0)).friction
        == reference(path, changes={"drive.velocity": 2.0}).friction
    )


def test_a_stage_is_a_drive_at_its_velocity():
    stage = Programme((Segment(0.1, time=1.0),), stage=Stage(0.3))
    known = repr(eqsim.fresh_slip(Ensemble(), Drive(0.1)))
    assert repr(eqsim.fresh_slip(Ensemble(), stage)) == known


def test_units_are_those_of_the_command_line(path):
    """And of a trajectory, its averages and what `run` finds; others can be given."""
    done = CliRunner().invoke(app, ["steady", str(path), "--json", "--quiet"])
    shown = json.loads(done.stdout)["physical"]
    found = steady(path).in_units()
    assert set(found) == set(shown) == {"force", "shear_stress", "friction_coefficient"}
    for name, one in found.items():
        assert [one.value, one.stderr, one.unit] == [
            shown[name][key] for key in ("value", "stderr", "unit")
        ]
    run = eqsim.run(path)
    factor = 200 * 2.0  # N k
    for record in (run, run.trajectory, eqsim.trajectory(path)):
        force = record.in_units()["force"]
        assert force.value == pytest.approx(
            factor * run.trajectory.force, rel=1e-12, abs=0
        )
        assert force.unit == "mN"
    level = run.trajectory.averages.in_units()["friction_coefficient"]
    expected = run.trajectory.friction.value * factor / 900.0
    assert level.value == pytest.approx(expected, rel=1e-12, abs=0)
    exact = reference(Ensemble(count=10), Drive(0.1))
    newtons = exact.in_units(Units("m", "s", "N"), Interface(normal_load=5.0))
    assert newtons["force"].value == pytest.approx(
        10 * exact.friction.value, rel=1e-12, abs=0
    )
    assert pickle.loads(pickle.dumps(exact)).in_units(Units(force="N"))["force"].unit
    with pytest.raises(InputError, match="neither a unit of force nor an interface"):
        exact.in_units()
    with pytest.raises(TypeError, match="Breaks has no force"):
        eqsim.breaks(path).in_units()


def test_completion_lists_what_is_meant(path):
    file = eqsim.load(path)
    shown = {name for name in dir(file) if not name.startswith("__")}
    assert shown == {
        *("blocks", "drive", "ensemble", "fit", "folder", "given", "interface"),
        "output",
        *("quantities", "said", "settings", "sweep", "text", "title", "units"),
        "with_changes",
    }
    for result in (reference(path), eqsim.transient(path), eqsim.run(path)):
        shown = {name for name in dir(result) if not name.startswith("__")}
        assert {"plot", "to_pandas", "in_units"} <= shown
        assert not {name for name in shown if name.startswith("_")}
        assert not {"drawn", "names", "shown", "unlisted"} & shown
