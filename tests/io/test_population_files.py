"""Populations in run files: what they take from the top of the file, and their keys."""

import json
import tomllib
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from command_line import call

from eqsim import (
    Aging,
    Delay,
    Gamma,
    InputError,
    Table,
    Thermal,
    catalogue,
    load,
    reference,
)
from eqsim.io.labels import axis, described
from eqsim.io.parameters import keys
from eqsim.io.runfile import check, stored
from eqsim.io.units import Units
from eqsim.sweeps.plan import Plan

RUNS = Path(__file__).parents[2] / "runs"
TEXT = """
[contacts]
count = 10
stiffness = 2.0
[thresholds]
law = "gamma"
n = 3.0
x_star = 0.5
[thermal]
kT = 0.1
attempt_frequency = 7.0
[delay]
law = "exponential"
time = 2.0
[drive]
velocity = 0.1
[[population]]
share = 3
[[population]]
share = 1
stiffness = 5.0
[population.thresholds]
law = "gamma"
x_star = 4.0
[population.thermal]
kT = 0.3
[population.delay]
time = 1.0
[population.aging]
rule = "flow"
rate = 0.1
x_star_final = 8.0
"""


def file_of(text=TEXT, **changes):
    return check(tomllib.loads(text))


def test_default_distance_is_that_of_the_strongest_population():
    """Rigid or pulled by a spring, 200 mean newborn thresholds of the second one."""
    rigid = file_of()
    pulled = file_of(
        TEXT.replace("velocity = 0.1", "velocity = 0.1\nstage = { stiffness = 0.5 }")
    )
    mean = rigid.ensemble.kinds[1].contacts.thresholds.mean
    assert mean > 2.0 * rigid.ensemble.thresholds.mean
    assert rigid.drive.over(rigid.ensemble) == 200.0 * mean
    assert pulled.drive.segments[0].distance == 200.0 * mean


def test_a_population_takes_what_it_does_not_give():
    first, second = (kind.contacts for kind in file_of().ensemble.kinds)
    assert (first.count, first.stiffness) == (8, 2.0)
    assert first.thresholds == Gamma(3.0, 0.5)
    assert first.thermal == Thermal(0.1, 7.0)
    assert first.delay == Delay(2.0, "exponential")
    assert not first.aging.active
    assert (second.count, second.stiffness) == (2, 5.0)
    assert second.thresholds == Gamma(1.0, 4.0)  # a section with its law stands alone
    assert second.thermal == Thermal(0.3, 7.0)
    assert second.delay == Delay(1.0, "exponential")
    assert second.aging == Aging("flow", 0.1, 8.0)


def test_values_of_keys():
    file = file_of()
    assert file["population.0.thermal.kT"] == 0.1
    assert file["population.0.stiffness"] == 2.0
    assert file["population.1.thermal.attempt_frequency"] == 7.0
    assert file["population.1.thresholds.n"] is None
    warm = file.with_changes({"thermal.kT": 0.2, "population.1.stiffness": 6.0})
    assert [kind.contacts.thermal.kT for kind in warm.ensemble.kinds] == [0.2, 0.3]
    assert warm.ensemble.mean_stiffness == pytest.approx(2.8, rel=1e-15, abs=0)
    known = keys(file)
    assert known["population.1.delay.time"] is float
    assert known["population.0.aging.rule"] is str
    assert "population.2.share" not in known
    assert not any(name.startswith("population") for name in keys())


def test_temperatures_replace_each_other():
    text = TEXT.replace("kT = 0.1", "temperature = 300.0")
    text += '[units]\nlength = "nm"\nforce = "nN"\n'
    file = file_of(text)
    room, hot = (kind.contacts.thermal.kT for kind in file.ensemble.kinds)
    assert hot == 0.3
    assert room == pytest.approx(1.380649e-23 * 300.0 / 1e-18, rel=1e-12, abs=0)
    kelvin = text.replace("kT = 0.3", "temperature = 600.0")
    found = [kind.contacts.thermal.kT for kind in file_of(kelvin).ensemble.kinds]
    assert found[1] == pytest.approx(2.0 * room, rel=1e-12, abs=0)


def test_what_was_in_force_is_read_again():
    for text in (TEXT, TEXT.replace("rate = 0.1", "rate = inf")):
        file = file_of(text)
        settings = json.loads(
            json.dumps(file.settings).replace("Infinity", '"Infinity"')
        )
        assert stored(settings).ensemble == file.ensemble
        assert stored(settings).settings == file.settings


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("share = 3\n", "", r"population.0.share: is required"),
        ("share = 3", "share = -3", r"population.0.share = -3.0: must be a"),
        (
            "stiffness = 5.0",
            "stifness = 5",
            r"population.1.stifness: unknown key; .* .stiff",
        ),
        ("kT = 0.3", "kt = 0.3", r'population.1.thermal.kt: unknown key; .* "kT"'),
        ("kT = 0.3", "kT = -0.3", r"population.1.thermal.kT = -0.3: must be"),
        ("stiffness = 5.0", "stiffness = 0", r"population.1.stiffness = 0.0: must"),
        ("x_star = 4.0", "shape = 2.0", r"population.1.thresholds.shape = 2.0: not"),
        ("[[population]]\nshare = 3", "[population]", r"population = "),
        ("[population.aging]", "[population.drive]", r"population.1.drive: unknown"),
    ],
)
def test_messages_name_the_population(old, new, said):
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if new == "[population]":
        text = text.partition("[[population]]")[0]
    with pytest.raises(InputError, match=f"^{said}"):
        _ = file_of(text).ensemble


def test_labels():
    assert axis("population.1.thermal.kT", Units()).startswith(
        "thermal energy of population 1"
    )
    assert (
        catalogue.entry("population.0.share").words
        == "share of contacts of population 0"
    )
    assert described(file_of().ensemble, Units()).endswith(", 2 populations")


def test_groups_of_each_population(tmp_path):
    (tmp_path / "x.toml").write_text(TEXT)
    found = json.loads(call("info", tmp_path / "x.toml", "--json").output)
    assert (found["0: N"], found["1: N"]) == (8, 2)
    assert found["0: b"] == pytest.approx(2.0 * 0.25 / 0.2, rel=1e-12, abs=0)
    assert found["1: b"] == pytest.approx(5.0 * 16.0 / 0.6, rel=1e-12, abs=0)


SWEEP = """
[sweep]
population.1.stiffness = [1.0, 4.0]
"population.0.share" = [1.0, 9.0]
"""


@pytest.mark.verification
def test_a_sweep_over_keys_of_populations(tmp_path):
    """Also made again from its table, bit by bit."""
    text = TEXT.replace("count = 10", "count = 10_000") + SWEEP
    text = text.replace(
        '[population.aging]\nrule = "flow"\nrate = 0.1\nx_star_final = 8.0\n', ""
    )
    (tmp_path / "s.toml").write_text(text)
    out = tmp_path / "swept"
    done = call("sweep", tmp_path / "s.toml", "--out", out, "--quiet")
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(out)
    assert list(table["population.1.stiffness"]) == [1.0, 1.0, 4.0, 4.0]
    assert list(table["population.0.share"]) == [1.0, 9.0, 1.0, 9.0]
    assert set(table["population.0.thermal.kT"]) == {0.1}
    assert table["id"].nunique() == 4
    assert (table["friction_z"].abs() < 4.5).all()
    plan = Plan(load(tmp_path / "s.toml"))
    point = plan.at(3)
    exact = reference(point.ensemble, point.drive).friction.value
    assert table["friction_reference"][3] == exact
    assert call("replay", out / "sweep.parquet").exit_code == 0
    (tmp_path / "s.toml").write_text(text.replace("kT = 0.3", "kT = 0.2"))
    done = call("sweep", tmp_path / "s.toml", "--out", out, "--quiet")
    assert "population.1.thermal.kT was 0.3, is 0.2" in done.output


def test_a_run_is_made_again(tmp_path):
    text = TEXT.replace("velocity = 0.1", "velocity = 0.1\ndistance = 5.0")
    (tmp_path / "x.toml").write_text(text + "[output]\npoints = 11\nreplicas = 3\n")
    out = tmp_path / "out"
    done = call(
        "run", tmp_path / "x.toml", "--out", out, "--set", "population.1.share=4"
    )
    assert done.exit_code == 0, done.output
    assert call("replay", out / "trajectory.parquet").exit_code == 0
    origin = json.loads(pq.read_schema(out / "trajectory.parquet").metadata[b"eqsim"])
    assert origin["settings"]["population"][1]["share"] == 4.0
    done = call("steady", tmp_path / "x.toml", "--json")
    z = json.loads(done.output)["z"]
    assert abs(z["friction"]) < 4.5
    assert abs(z["break_stretch"]) < 4.5


def test_tables_of_thresholds(tmp_path):
    (tmp_path / "a.csv").write_text("force\n1.0\n3.0\n")
    text = TEXT.replace(
        'law = "gamma"\nx_star = 4.0',
        'law = "table"\nfile = "a.csv"\nquantity = "force"',
    ).partition("[population.aging]")[0]
    file = check(tomllib.loads(text), tmp_path)
    law = file.ensemble.kinds[1].contacts.thresholds
    assert isinstance(law, Table)
    # forces over the stiffness of the population, under the sqrt law
    assert law.steps == pytest.approx([2**0.5 / 5, 6**0.5 / 5], rel=1e-15, abs=0)


def test_the_run_file_of_the_documentation():
    file = load(RUNS / "populations.toml")
    assert len(file.ensemble.kinds) == 2


@pytest.mark.verification
def test_bonds_of_two_types(tmp_path):
    """Catch-slip and Bell bonds without thresholds: a barrier of its own, too, stands
    alone, and parts of it are keys. Along a programme and in a sweep."""
    text = """
[thermal]
barrier = "bell"
off_rate = 0.1
force_scale = 2.0
[thresholds]
law = "none"
[delay]
time = 1.0
[contacts]
count = 2000
[drive]
velocity = 1.0
[[population]]
share = 1
[population.thermal]
barrier = "catch-slip"
catch = { rate = 10.0, force = 1.0 }
slip = { rate = 0.1, force = 4.0 }
[[population]]
share = 1
stiffness = 3.0
[sweep]
population.0.thermal.slip.force = [4.0, 5.0]
"""
    file = check(tomllib.loads(text))
    catch, bell = (kind.contacts for kind in file.ensemble.kinds)
    assert (catch.thermal.slip.force, catch.thermal.off_rate) == (4.0, None)
    assert (bell.thermal.off_rate, bell.thermal.slip) == (0.1, None)
    assert keys(file)["population.0.thermal.slip.force"] is float
    exact = reference(file.ensemble, file.drive)
    # friction per bond of the rigid slider, by k of each
    expected = 0.25 * 0.013712347186 + 0.75 * reference(bell, file.drive).friction.value
    assert exact.friction.value == pytest.approx(expected, rel=1e-9, abs=0)
    (tmp_path / "s.toml").write_text(text)
    done = call("sweep", tmp_path / "s.toml", "--out", tmp_path / "out", "--quiet")
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(tmp_path / "out")
    assert (table["friction_z"].abs() < 4.5).all()
    assert table["friction_reference"][0] == exact.friction.value
    assert table["friction_reference"].is_unique


def test_a_temperature_of_a_population_replaces_its_heat():
    """And the other way round, as at the top of the file; other kinds keep theirs."""
    units = {"length": "nm", "force": "nN"}
    kinds = [{"share": 1, "stiffness": 1.0, "thermal": {"kT": x}} for x in (0.1, 0.2)]
    drive = {"velocity": 0.1}
    file = check({"units": units, "drive": drive, "population": kinds})
    kelvin = file.with_changes({"population.0.thermal.temperature": 300.0})
    assert kelvin["population.0.thermal.kT"] == pytest.approx(4.142e-3, rel=1e-3, abs=0)
    assert kelvin["population.1.thermal.kT"] == 0.2
    heat = kelvin.with_changes({"population.0.thermal.kT": 0.3})
    assert heat["population.0.thermal.temperature"] is None
    assert heat["population.0.thermal.kT"] == 0.3
    both = {"population.0.thermal.temperature": 300.0, "population.0.thermal.kT": 0.3}
    for kT in (0.3, 0.0):
        both["population.0.thermal.kT"] = kT
        with pytest.raises(InputError, match=r"^population\.0\.thermal.* with kT"):
            file.with_changes(both)


def test_a_machine_pulls_populations_that_inherit_their_stiffness():
    """K/(N k) of ten contacts, 8 as stiff as the key at the top says."""
    machine = {"machine_stiffness": "52 N/m"}
    drive = {"velocity": 0.1, "stage": machine}
    kinds = [{"share": 4}, {"share": 1, "stiffness": 5.0}]
    content = {"contacts": {"count": 10, "stiffness": 2.0}, "population": kinds}
    content["units"] = {"length": "m", "time": "s", "force": "N"}
    stage = check(content | {"drive": drive}).drive.stage
    assert stage.stiffness == pytest.approx(52.0 / 26.0, rel=1e-14, abs=0)
