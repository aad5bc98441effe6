"""Units of run files, temperatures in kelvin, and friction as a force, a shear stress
and a coefficient."""

import json
import math
from pathlib import Path

import pytest
from command_line import call
from scipy import constants

from eqsim import Ensemble, Estimate, catalogue, load
from eqsim.catalogue import Dimension
from eqsim.errors import InputError
from eqsim.fitting.report import to_toml
from eqsim.io.parameters import parameters
from eqsim.io.runfile import at, stored
from eqsim.io.surface import doubts, machine_stiffness
from eqsim.io.units import Interface, Units, quantities, scales

RUNS = Path(__file__).parents[2] / "runs"
RUN = """
title = "film"
[units]
length = "nm"
time = "s"
force = "nN"
[interface]
contacts_per_area = 1e-6
[contacts]
count = 2000
stiffness = 0.4
stiffness_law = "uniform"
[thresholds]
x_star = 500.0
[thermal]
temperature = 300.0
attempt_frequency = 1e9
[drive]
velocity = 1.4e4
distance = 1e4
[output]
points = 51
"""


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "film.toml"
    path.write_text(RUN)
    return path


@pytest.mark.parametrize(
    ("units", "dimension", "label", "size"),
    [
        (Units("nm", "s", "nN"), catalogue.VELOCITY, "nm/s", 1e-9),
        (Units("um", "ms", "uN"), catalogue.VELOCITY, "um/ms", 1e-3),
        (Units("µm", "min", "N"), catalogue.VELOCITY, "µm/min", 1e-6 / 60),
        (Units("nm", "s", "nN"), catalogue.ENERGY, "nN nm", 1e-18),
        (Units("m", "s", "N"), catalogue.ENERGY, "J", 1.0),
        (Units("m", "s", "N"), catalogue.STRESS, "Pa", 1.0),
        (Units("nm", "s", "nN"), catalogue.STRESS, "nN/nm^2", 1e9),
        (Units("m", "h", "N"), catalogue.dimension("1/time"), "1/h", 1 / 3600),
        (Units("m", "s", "kN"), Dimension(-1, 1, 1), "kN s/m", 1e3),
        (Units("m"), catalogue.AREA, "m^2", 1.0),
        (Units("x_*"), catalogue.LENGTH, "x_*", None),
        (Units("x_*"), catalogue.VELOCITY, "", None),
        (Units("angstrom", "s"), catalogue.LENGTH, "angstrom", 1e-10),
        (Units(), catalogue.NUMBER, "", 1.0),
    ],
)
def test_labels_and_sizes(units, dimension, label, size):
    assert units.label(dimension) == label
    found = units.size(dimension)
    assert (
        found is size
        if size is None
        else found == pytest.approx(size, rel=1e-12, abs=0)
    )


def test_kelvin():
    """k_B 300 K is 4.14e-21 J, and 4.14e-3 nN nm; there and back again."""
    assert Units("m", "s", "N").energy(300.0) == constants.k * 300.0
    small = Units("nm", "", "nN")
    assert small.energy(300.0) == pytest.approx(4.1419e-3, rel=1e-4, abs=0)
    assert small.kelvin(small.energy(77.0)) == pytest.approx(77.0, rel=1e-14, abs=0)
    assert Units("x_*", "", "nN").kelvin(1.0) is None


SI = Units("m", "s", "N")


def known(interface, units=SI, count=1000, stiffness=2.0):
    found = quantities(Ensemble(count=count, stiffness=stiffness), units, interface)
    return {one.name: (one.factor, one.unit) for one in found}


def test_what_is_known_of_which_interface():
    """By hand: 1000 contacts of k = 2 N/m, at friction 1 m carry 2000 N."""
    assert known(Interface()) == {"force": (2000.0, "N")}
    assert known(Interface(), Units("m", "s")) == {}
    area = known(Interface(area=0.5))
    assert area == {"force": (2000.0, "N"), "shear_stress": (4000.0, "Pa")}
    assert known(Interface(contacts_per_area=2000.0)) == area
    load = known(Interface(normal_load=8000.0))
    assert load == {"force": (2000.0, "N"), "friction_coefficient": (0.25, "")}
    assert known(Interface(area=0.5, normal_load=8000.0))["friction_coefficient"] == (
        0.25,
        "",
    )
    assert known(Interface(area=0.5, normal_stress=16000.0)) == area | {
        "friction_coefficient": (0.25, "")
    }
    # a larger interface, of which the contacts are a sample
    wide = known(Interface(area=5.0, contacts_per_area=2000.0, normal_load=8e4))
    assert wide == {
        "force": (20000.0, "N"),
        "shear_stress": (4000.0, "Pa"),
        "friction_coefficient": (0.25, ""),
    }
    small = known(Interface(area=0.5), Units("nm", "s", "nN"))
    assert small["force"] == (2000.0, "nN")
    assert small["shear_stress"][0] == pytest.approx(4000e9, rel=1e-12, abs=0)
    assert known(Interface(area=0.5), Units())["shear_stress"] == (4000.0, "")
    assert known(Interface(area=0.5), Units("x_*", "", "f"))["shear_stress"] == (
        4000.0,
        "f/x_*^2",
    )


def test_errors_go_along_and_prefixes_are_chosen():
    (_, stress) = quantities(
        Ensemble(count=1, stiffness=1.0), Units("m", "s", "N"), Interface(area=1.0)
    )
    friction = Estimate(2.5e6, 1e3, 7, 3, False)
    assert stress.of(friction) == friction
    near = stress.near(2.5e6)
    assert (near.unit, near.of(friction).value, near.of(friction).stderr) == (
        "MPa",
        2.5,
        1e-3,
    )
    assert near.of(friction).dof == 3
    assert stress.of(Estimate(None, None, 0)).value is None
    units = {
        value: stress.near(value).unit
        for value in (0.0, 2e-3, 2.0, 1e3, 999.0, 1e6, -1e9, 1e15, 1e-9)
    }
    assert [*units.values()] == [
        "Pa",
        "mPa",
        "Pa",
        "kPa",
        "Pa",
        "MPa",
        "GPa",
        "GPa",
        "mPa",
    ]


def test_a_temperature_is_a_kT(run_file):
    file = load(run_file)
    kT = constants.k * 300.0 / 1e-18
    assert file["thermal.kT"] == pytest.approx(kT, rel=1e-14, abs=0)
    assert file.ensemble.thermal.kT == file["thermal.kT"]
    assert parameters(file)["thermal.kT"] == file["thermal.kT"]
    assert parameters(file)["thermal.temperature"] == 300.0
    # what changes one of the two replaces the other, on the command line and along a
    # sweep
    hot = at(file, {"thermal.temperature": 600.0})
    assert hot["thermal.kT"] == pytest.approx(2 * kT, rel=1e-14, abs=0)
    assert at(hot, {"drive.velocity": 1.0})["thermal.kT"] == hot["thermal.kT"]
    run_file.write_text("\n".join(to_toml(hot.given)))
    # as fits write their best run file: with one of the two
    assert load(run_file).settings["thermal"] == hot.settings["thermal"]
    plain = load(run_file, {"thermal.kT": 0.5})
    assert (plain["thermal.kT"], plain["thermal.temperature"]) == (0.5, None)
    assert at(plain, {"thermal.temperature": 300.0})["thermal.kT"] == file["thermal.kT"]
    assert "kT" not in stored(file.settings).given["thermal"]
    loaded = load(RUNS / "steel.toml", {"interface.normal_load": 2.0}).interface
    assert (loaded.normal_load, loaded.normal_stress) == (2.0, None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("thermal.kT=0.0 thermal.temperature=300", "thermal.temperature = 300.0: not allowed with kT; give one"),
        ("thermal.temperature=-1.0", "thermal.temperature = -1.0: must be a finite number >= 0"),
        ('units.force=""', 'thermal.temperature = 300.0: kT takes SI units of length and force, and units.force is'),
        ("units.length=x_*", "and units.length = 'x_*' is none; must be such as \"m\", \"um\", \"nm\""),
        ("units.length=abcdefghijklmnopqrstu", "units.length = 'abcdefghijklmnopqrstu': must be a unit, such as"),
        ("units.mass=kg", "units.mass: unknown key; known here: length, time, force"),
        ("interface.area=0.0", "interface.area = 0.0: must be a finite number > 0"),
        ("interface.normal_load=1.0 interface.normal_stress=1.0", "interface.normal_stress = 1.0: not allowed"),
        ("interface.lode=1.0", "interface.lode: unknown key; known here: area, contacts_per_area"),
    ],
)  # fmt: skip
def test_refusals(run_file, change, message):
    sets = [part for one in change.split() for part in ("--set", one)]
    result = call("info", run_file, *sets)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_stress_needs_contacts_per_area():
    with pytest.raises(
        InputError, match=r"normal_stress = 1\.0: needs area or contacts_per_area"
    ):
        Interface(normal_stress=1.0)


def test_commands_show_what_an_engineer_knows(run_file, tmp_path):
    """Shear stress in kPa, in every table and in JSON; one simulated number, in several
    units."""
    with_load = [run_file, "--set", "interface.normal_stress=1e-3"]  # nN/nm^2, 1 MPa
    for command in ("steady", "reference"):
        text = call(command, *with_load).stdout
        assert (
            "film: 2 000 quenched contacts, uniform stiffness, T = 300 K"
            in text.replace("\n", " ")
        )
        rows = {
            line.split()[1]: line for line in text.splitlines() if line.startswith("│")
        }
        assert {
            "friction",
            "force",
            "shear_stress",
            "mu",
            "pinned",
            "break_stretch",
        } <= rows.keys()
        assert "kPa" in rows["shear_stress"]
        assert "nm" in rows["friction"]
        found = json.loads(call(command, *with_load, "--json").stdout)
        friction = (
            found["friction"]["value"] if command == "steady" else found["friction"]
        )
        physical = found["physical"]
        assert physical["force"]["value"] == pytest.approx(
            2000 * 0.4 * friction, rel=1e-12, abs=0
        )
        stress = physical["shear_stress"]
        assert stress["unit"] == "Pa"
        assert stress["value"] == pytest.approx(
            1e-6 * 0.4 * friction * 1e9, rel=1e-12, abs=0
        )
        assert physical["friction_coefficient"]["value"] == pytest.approx(
            stress["value"] / 1e6, rel=1e-12, abs=0
        )
    assert found["physical"]["force"]["stderr"] == pytest.approx(
        800 * found["error"]["friction"], rel=1e-12, abs=0
    )
    result = call("run", *with_load, "--out", tmp_path / "o")
    assert result.exit_code == 0, result.output
    assert "kPa" in result.stdout
    summary = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert summary["physical"]["shear_stress"]["reference"] == pytest.approx(
        400 * summary["steady"]["friction"]["value"], rel=1e-12, abs=0
    )
    assert call("replay", tmp_path / "o" / "trajectory.parquet").exit_code == 0
    groups = json.loads(call("info", *with_load, "--json").stdout)
    assert groups["T (K)"] == pytest.approx(300.0, rel=1e-12, abs=0)
    assert groups["area (nm^2)"] == pytest.approx(2e9, rel=1e-12, abs=0)
    assert groups["friction coefficient"] == pytest.approx(0.2, rel=1e-12, abs=0)


def test_programmes_show_coefficients(run_file):
    programme = "drive.programme=[{velocity = 1e4, distance = 4e3}, {hold = 1.0}]"
    path = run_file.with_name("steps.toml")
    path.write_text(RUN.replace("velocity = 1.4e4\ndistance = 1e4\n", ""))
    args = [
        path,
        "--set",
        programme,
        "--set",
        "interface.normal_stress=1e-3",
        "--set",
        "output.points=21",
        "--out",
        path.parent / "p",
        "--no-exact",
    ]
    result = call("run", *args)
    assert result.exit_code == 0, result.output
    assert "mu then" in " ".join(result.stdout.split())
    summary = json.loads((path.parent / "p" / "summary.json").read_text())
    assert summary["physical"]["friction_coefficient"]["factor"] == pytest.approx(
        4e-4, rel=1e-12, abs=0
    )


def test_run_files_without_units_stay_as_they_are(run_file):
    path = run_file.with_name("plain.toml")
    path.write_text("[contacts]\ncount = 100\n[drive]\nvelocity = 0.1\n")
    found = json.loads(call("reference", path, "--json").stdout)
    assert "physical" not in found
    assert "unit" not in call("reference", path).stdout
    assert not any(
        "(" in name and ")" in name
        for name in json.loads(call("info", path, "--json").stdout)
        if "T" in name
    )


def test_steel_is_in_megapascal():
    """sigma_* = 1 GPa and H = 3 sqrt(3) sigma_*: mu is friction/x_* over 5.2."""
    found = json.loads(call("reference", RUNS / "steel.toml", "--json").stdout)
    file = load(RUNS / "steel.toml")
    reduced = found["friction"] / file["thresholds.x_star"]
    assert found["physical"]["shear_stress"]["value"] == pytest.approx(
        1e9 * reduced, rel=1e-9, abs=0
    )
    assert found["physical"]["friction_coefficient"]["value"] == pytest.approx(
        reduced / (3 * math.sqrt(3)), rel=1e-3, abs=0
    )
    assert "MPa" in call("reference", RUNS / "steel.toml").stdout


# N = 2000 of k = .4 N/m on 2000/1e-6 nm^2 = 2e-9 m^2: N k = 800 N/m, tau = 4e11 Pa/m
# times F/(N k) and mu = 4e8 times it, under 1 kPa; time is in s.
MACHINES = {
    "machine_stiffness": {
        "40 N/m": 0.05,
        "0.04 N/mm": 0.05,
        "2e-2 MPa/um": 0.05,
        "20 1/um": 0.05,
        ".02/nm": 0.05,
    },
    "radiation_damping": {"4e5 MPa s/m": 1.0, "800 N s/m": 1.0, "2e8 s/m": 0.5},
}


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_in_its_own_units(name, run_file):
    stage = '[drive.stage]\nstiffness = 0.3\n[units]\nlength = "nm"'
    text = RUN.replace('[units]\nlength = "nm"', stage)
    run_file.write_text(
        text.replace("[contacts]", "normal_stress = 1e-6\n[contacts]", 1)
    )
    field = {"machine_stiffness": "stiffness", "radiation_damping": "damping"}[name]
    for given, expected in MACHINES[name].items():
        file = load(run_file, {f"drive.stage.{name}": given})
        found = getattr(file.drive.stage, field)
        assert found == pytest.approx(expected, rel=1e-12, abs=0), given
    if field == "stiffness":
        assert machine_stiffness(file, 0.1) == "0.04/nm"
    assert machine_stiffness(load(run_file), 0.1) == "80 nN/nm"
    swept = at(file, {f"drive.stage.{field}": 0.2})
    assert getattr(swept.drive.stage, field) == 0.2
    for change, said in (
        ({f"drive.stage.{name}": "50"}, "must be a number with its unit, such as"),
        ({f"drive.stage.{name}": "50 N"}, "must be a number with its unit, such as"),
        ({f"drive.stage.{name}": "1 m/s^2"}, "must be a number with its unit, such as"),
        ({"units.length": "x"}, "takes SI units"),
        (
            {f"drive.stage.{name}": given, f"drive.stage.{field}": 0.2},
            "give one of them",
        ),
        (
            {f"drive.stage.{name}": given, f"drive.stage.{field}": 0.0},
            "give one of them",
        ),
    ):
        with pytest.raises(InputError, match=said):
            load(run_file, {f"drive.stage.{name}": given, **change})


def test_what_is_assumed_of_a_surface_is_said(run_file):
    """What a file in units leaves out, heat that is idle, a friction coefficient of 33;
    nothing of a file that says all, or without units."""
    assert not list(doubts(load(run_file)))
    for key in ("count = 2000\n", "stiffness = 0.4\n", "attempt_frequency = 1e9\n"):
        RUN_ = run_file.read_text().replace(key, "")
        run_file.write_text(RUN_)
    changes = {"interface.normal_load": 1e6, "thermal.temperature": 1e-9}
    assumed, heat, mu = doubts(load(run_file, changes))
    assert assumed == (
        "not given, and assumed: contacts.count = 100 000, contacts.stiffness = 1 nN/nm, "
        "thermal.attempt_frequency = 1 1/s"
    )
    assert "heat does next to nothing" in heat
    # half the mean threshold, Gamma(5/2)/Gamma(2) x_* = 1.329 x_*, times N k/load
    assert "friction coefficients are about 33.2: are stiffness" in mu
    plain = RUN_[RUN_.index("[contacts]") :].replace("temperature = 300.0", "kT = 0.1")
    run_file.write_text(plain)
    assert not list(doubts(load(run_file)))


def test_a_surface_of_several_kinds_of_contacts(tmp_path):
    """Heat counts for each kind, friction is that of all; the law at the top of the file
    is of no contact, and there is no x_* in common."""
    (tmp_path / "two.toml").write_text(
        """
units = { length = "m", time = "s", force = "N" }
interface = { normal_load = 0.1 }
contacts = { count = 1000 }
thermal = { temperature = 300.0 }
[[population]]
share = 0.5
stiffness = 1e5
thresholds = { x_star = 1e-8 }
[[population]]
share = 0.5
stiffness = 2e5
thresholds = { x_star = 2e-8 }
thermal = { temperature = 1.0 }
[drive]
velocity = 1e-6
"""
    )
    file = load(tmp_path / "two.toml")
    heat, mu = doubts(file)
    assert heat.startswith("population.1: b = 2.9e+12: heat does next to nothing")
    # half of 1.329 x_* in the mean over forces, 1/3 of 1e-8 m and 2/3 of 2e-8 m, times N k/load
    assert mu.startswith("friction coefficients are about 16.6: are stiffness")
    rows = [row.name for row in scales(file.ensemble, file.units, file.interface)]
    assert {"0: x_* (m)", "1: x_* (m)"} < {*rows}
    assert "friction coefficient" not in rows
