"""Run files: defaults, bad input in one line that names the field, and threshold
tables."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from eqsim import (
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Programme,
    Segment,
    Thermal,
    catalogue,
    load,
    trajectory,
)
from eqsim.errors import require_integer, require_number
from eqsim.io import schema
from eqsim.io.parameters import keys, parameters
from eqsim.io.runfile import at, check, opened, stored
from eqsim.io.storage import provenance
from eqsim.io.tables import read_thresholds
from eqsim.laws.named import THRESHOLDS, threshold_parameters
from eqsim.laws.stiffness import relative_stiffness


def test_defaults(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[drive]\nvelocity = 0.1\n")
    file = load(path)
    ensemble = file.ensemble
    assert ensemble.thresholds == Gamma(1.0, 1.0)
    assert ensemble.thermal == Thermal(0.0, 1.0, "soft")
    assert ensemble.delay == Delay(0.0, "fixed")
    assert (ensemble.count, ensemble.stiffness, ensemble.stiffness_law) == (
        100_000,
        1.0,
        "sqrt",
    )
    assert (ensemble.disorder, ensemble.eta) == ("quenched", 0.0)
    assert file.drive == Drive(0.1, None, "fresh")
    assert (file.output.points, file.output.seed, file.output.replicas) == (2001, 1, 1)
    assert file.drive.over(ensemble) == pytest.approx(
        200 * ensemble.thresholds.mean, rel=1e-15, abs=0
    )


def test_every_key_is_in_the_catalogue():
    """With its meaning, and no other; a section's dataclass has no field beside, but
    for what other sections hold."""
    sections = {
        name: kind for name, kind in schema._DATACLASSES.items() if kind is not Ensemble
    }
    for name, kind in sections.items():
        given = {field.name for field in dataclasses.fields(kind)} - {
            *("elastic", "natural", "catch", "slip"),
        }
        if name == "population":
            given -= set(schema.OF_POPULATION)
        assert given <= schema.keys_of(name).keys(), name
    thresholds = schema.keys_of("thresholds").keys()
    assert all(set(threshold_parameters(law)) <= thresholds for law in THRESHOLDS)
    for entry in catalogue.KEYS.values():
        assert entry.meaning
    for entry in (*catalogue.KEYS.values(), *catalogue.COLUMNS.values()):
        assert entry.symbol.count("$") in (0, 2)


def test_every_key(tmp_path):
    (tmp_path / "x.csv").write_text("threshold\n1.0\n0.5\n")
    data = {
        "title": "t",
        "disorder": "annealed",
        "contacts": {"count": 1e3, "stiffness": 2, "stiffness_law": "uniform"},
        "thresholds": {"law": "table", "file": "x.csv"},
        "thermal": {"kT": 1, "attempt_frequency": 3.0, "barrier": "stiff"},
        "aging": {"rule": "none", "rate": 0.0, "x_star_final": 2.0},
        "delay": {"time": 1.5, "law": "exponential"},
        "viscosity": {"eta": 0.25},
        "drive": {"velocity": 2, "distance": 7, "start": "stationary"},
        "output": {"points": 11, "seed": 5, "replicas": 3},
        "sweep": {"drive.velocity": [1.0, 2.0]},
    }
    ensemble = check(data, tmp_path).ensemble
    assert list(ensemble.thresholds.steps) == [0.5, 1.0]
    assert ensemble.count == 1000
    assert ensemble.delay == Delay(1.5, "exponential")
    assert check(data, tmp_path).drive == Drive(2, 7, "stationary")
    assert check(
        {"thresholds": {"law": "delta", "x_star": 2.0}}
    ).ensemble.thresholds == Delta(2.0)


def programme(*segments, **more):
    return {"drive": {"programme": list(segments), **more}}


BAD = [
    ({"contacts": {"cuont": 5}}, 'contacts.cuont: unknown key; did you mean "count"?'),
    ({"velocity": 1.0}, 'velocity: unknown key; did you mean "drive.velocity"?'),
    ({"drive": {"kT": 1.0}}, 'drive.kT: unknown key; did you mean "thermal.kT"?'),
    ({"nonsense": 1}, "nonsense: unknown key; known here: title"),
    (
        {"contacts": {"count": "many"}},
        "contacts.count = 'many': must be a valid integer",
    ),
    ({"contacts": {"count": 0}}, "contacts.count = 0: must be an integer from 1"),
    ({"contacts": {"count": 1.5}}, "contacts.count = 1.5: must be a valid integer"),
    ({"contacts": {"count": True}}, "contacts.count = True: must be a valid integer"),
    (
        {"contacts": {"stiffness": -1.0}},
        "contacts.stiffness = -1.0: must be a finite number > 0",
    ),
    (
        {"contacts": {"stiffness": "1"}},
        "contacts.stiffness = '1': must be a valid number",
    ),
    (
        {"contacts": {"stiffness_law": "cubic"}},
        'contacts.stiffness_law = \'cubic\': must be one of "sqrt", "uniform"',
    ),
    ({"contacts": 5}, "contacts = 5: must be a section, [contacts]"),
    ({"thresholds": {"n": -0.5}}, "thresholds.n = -0.5: must be a finite number >= 0"),
    (
        {"thresholds": {"x_star": 0}},
        "thresholds.x_star = 0.0: must be a finite number > 0",
    ),
    (
        {"thresholds": {"law": "delta", "n": 1.0}},
        'thresholds.n = 1.0: not allowed with law = "delta"',
    ),
    (
        {"thresholds": {"law": "table"}},
        'thresholds.file: is required with law = "table"',
    ),
    (
        {"thresholds": {"law": "table", "file": "x", "x_star": 1.0}},
        "thresholds.x_star = 1.0: not allowed",
    ),
    (
        {"thresholds": {"law": "weird"}},
        'thresholds.law = \'weird\': must be "gamma", "delta", "none", "lognormal", ',
    ),
    (
        {"thermal": {"kT": float("nan")}},
        "thermal.kT = nan: must be a finite number >= 0",
    ),
    (
        {"thermal": {"kT": float("inf")}},
        "thermal.kT = inf: must be a finite number >= 0",
    ),
    ({"thermal": {"barrier": "hard"}}, "thermal.barrier = 'hard': must be one of"),
    ({"aging": {"rule": "flow"}}, 'aging.x_star_final: is required with rule = "flow"'),
    ({"aging": {"rule": "slow"}}, "aging.rule = 'slow': must be one of"),
    (
        {"aging": {"rule": "flow", "rate": -1.0, "x_star_final": 1.0}},
        "aging.rate = -1.0: must be a finite number >= 0",
    ),
    (
        {"aging": {"rule": "langevin", "rate": math.inf, "x_star_final": 1.0}},
        'aging.rate = inf: must be finite with rule = "langevin" and quenched disorder',
    ),
    (
        {
            "aging": {"rule": "flow", "x_star_final": 1.0},
            "thresholds": {"law": "delta"},
        },
        'aging.rule = "flow": needs thresholds of law "gamma"',
    ),
    (
        {"aging": {"rule": "flow", "x_star_final": 1e9}},
        "aging.x_star_final = 1000000000.0: must be within a factor",
    ),
    (
        {"newborn": {"stretch": 0.3}},
        'newborn.law: is required with stretch; must be "delta", "uniform", "exponential", "normal" or "unstressed"',
    ),
    ({"newborn": {"law": "delta"}}, 'newborn.stretch: is required with law = "delta"'),
    (
        {"newborn": {"law": "uniform", "low": 0.0, "high": 1.0, "mean": 0.5}},
        'newborn.mean = 0.5: not allowed with law = "uniform", which takes low and high',
    ),
    (
        {"newborn": {"law": "gauss"}},
        'newborn.law = \'gauss\': must be one of "unstressed", "delta", "uniform"',
    ),
    (
        {"newborn": {"law": "delta", "strech": 0.3}},
        'newborn.strech: unknown key; did you mean "stretch"?',
    ),
    (
        {"newborn": {"law": "delta", "stretch": 30.0}},
        'newborn.law = "delta": contacts are born with stretches up to 30, but no threshold is above 21.8',
    ),
    (
        {"newborn": {"law": "normal", "mean": 0.0, "std": 1.0, "of": "threshold"}},
        'newborn.law = "normal": reaches beyond any threshold; of = "threshold" takes "delta" or "uniform"',
    ),
    (
        {"newborn": {"law": "delta", "stretch": 1.0, "of": "threshold"}},
        "newborn.stretch = 1.0: must be > -1 and < 1",
    ),
    (
        {
            "newborn": {"law": "delta", "stretch": 0.3},
            "aging": {"rule": "flow", "rate": 0.1, "x_star_final": 2.0},
        },
        'newborn.law = "delta": must be "unstressed" for contacts that age, or take aging.rule = "none"',
    ),
    ({"delay": {"time": -1.0}}, "delay.time = -1.0: must be a finite number >= 0"),
    ({"delay": {"law": "weird"}}, "delay.law = 'weird': must be one of"),
    ({"viscosity": {"eta": -2}}, "viscosity.eta = -2.0: must be a finite number >= 0"),
    (
        {"disorder": "frozen"},
        'disorder = \'frozen\': must be one of "quenched", "annealed"',
    ),
    ({}, "drive.velocity: is required"),
    ({"drive": {"velocity": 0}}, "drive.velocity = 0.0: must be a finite number > 0"),
    ({"drive": {"velocity": 10**400}}, "drive.velocity"),
    (
        {"drive": {"velocity": 1.0, "distance": 0.0}},
        "drive.distance = 0.0: must be a finite number > 0",
    ),
    (
        {"drive": {"velocity": 1.0, "start": "warm"}},
        "drive.start = 'warm': must be one of",
    ),
    (programme(), "drive.programme = []: must have at least one segment"),
    (
        programme({"velocity": 1.0}),
        "drive.programme.0.distance: a segment has either a distance or a time",
    ),
    (
        programme({"velocity": 1.0, "distance": 1.0, "time": 1.0}),
        "drive.programme.0.distance: a segment has either",
    ),
    (
        programme({"distance": 1.0}),
        "drive.programme.0.velocity: a segment has either a velocity or a hold",
    ),
    (
        programme({"hold": 1.0}, {"hold": 1.0, "velocity": 1.0}),
        "drive.programme.1.velocity: a segment has either",
    ),
    (
        programme({"hold": 1.0, "time": 2.0}),
        "drive.programme.0.time = 2.0: not allowed with hold",
    ),
    (
        programme({"hold": 0.0}),
        "drive.programme.0.hold = 0.0: must be a finite number > 0",
    ),
    (
        programme({"hold": math.inf}),
        "drive.programme.0.hold = inf: must be a finite number > 0",
    ),
    (
        programme({"velocity": 0.0, "distance": 1.0}),
        "drive.programme.0.velocity = 0.0: must not be 0 with a distance",
    ),
    (
        programme({"velocity": math.nan, "time": 1.0}),
        "drive.programme.0.velocity = nan: must be a finite number",
    ),
    (
        programme({"velocity": 1.0, "time": -1.0}),
        "drive.programme.0.time = -1.0: must be a finite number > 0",
    ),
    (
        programme({"velocity": 1.0, "tiem": 1.0}),
        'drive.programme.0.tiem: unknown key; did you mean "time"?',
    ),
    (
        programme({"velocity": 1.0, "time": 1.0, "points": 0}),
        "drive.programme.0.points = 0: must be an integer from 1",
    ),
    (
        programme({"hold": 1.0}, start="stationary"),
        'drive.velocity: is required with start = "stationary"',
    ),
    (
        programme({"hold": 1.0}, distance=1.0),
        "drive.distance = 1.0: not allowed with a programme or file",
    ),
    (
        programme({"hold": 1.0}, file="x.csv"),
        "drive.file: not allowed with drive.programme",
    ),
    ({"drive": {"programme": 3}}, "drive.programme = 3: must be a valid list"),
]


@pytest.mark.parametrize(("data", "message"), BAD)
def test_bad_input(data, message, tmp_path):
    def use():
        file = check(data, tmp_path)
        return file.ensemble, file.drive

    with pytest.raises(InputError) as caught:
        use()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[drive\nvelocity = 1", "is not valid TOML"),
        (b"\xff\xfe\x00", "is not a text file in UTF-8"),
        (b"a = 1\na = 2\n", "is not valid TOML"),
    ],
)
def test_not_toml(tmp_path, content, message):
    path = tmp_path / "run.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        load(path)
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; its first line must name the columns"),
        (
            "xi,y\n1.0,2\n",
            'needs a column "threshold" in its first line; found xi, y (thresholds.column names another)',
        ),
        ("# a comment\nxi\n# another\n-1.0\n", "line 4: '-1.0' must be"),
        ("2.0\n-1.0\n", "line 2: '-1.0' must be"),
        ("threshold\n", "is empty"),
        ("threshold\n1.0\nsoft\n", "line 3: 'soft' must be a finite number > 0"),
        ("threshold\n1.0\n-2\n", "line 3: '-2' must be"),
        ("threshold\n0\n", "line 2: '0' must be"),
        ("threshold\nnan\n", "line 2: 'nan' must be"),
        ("threshold\ninf\n", "line 2: 'inf' must be"),
        ("a,threshold\n1,\n", "line 2: '' must be"),
        ("a,threshold\n1\n", "line 2: has 1 of 2 cells"),
        ("nan\n1.0\n", "line 1: 'nan' must be"),  # no name of a column
        ("1.5e\n1.0\n", "line 1: '1.5e' must be"),
        ("1.5 2.5\n1.0\n", "line 1: '1.5 2.5' must be"),
        ("threshold\n1e-200\n", "1e-200; every threshold"),
    ],
)
def test_bad_tables(tmp_path, content, message):
    path = tmp_path / "x.csv"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_thresholds(path)
    assert message in str(caught.value)
    with pytest.raises(InputError, match="cannot be read"):
        read_thresholds(tmp_path / "absent.csv")


def test_good_tables(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(
        "\ufeffsample, threshold\n1, 2.5\n2, 0.5\n\n3, 1e3\n", encoding="utf-8"
    )
    assert list(read_thresholds(path).steps) == [0.5, 2.5, 1000.0]
    path.write_text("# no name\n2.5\n1\n")
    assert list(read_thresholds(path).steps) == [1.0, 2.5]


def test_tables_of_forces(tmp_path):
    """Contacts with these stretches and stiffnesses hold these forces."""
    forces = np.array([1.0, 4.0, 10.0])
    (tmp_path / "strengths.csv").write_text(
        "# by indentation\n\nstrength_nN\n1\n4\n10\n"
    )
    table = {"law": "table", "file": "strengths.csv", "quantity": "force"}
    for law in ("uniform", "sqrt"):
        contacts = {"stiffness": 2.0, "stiffness_law": law}
        file = check({"thresholds": table, "contacts": contacts}, tmp_path)
        ensemble = file.ensemble
        stretch = ensemble.thresholds.steps
        stiffness = 2.0 * relative_stiffness(law, stretch, ensemble.thresholds.rms)
        # ten roundings of 1e-16
        np.testing.assert_allclose(stiffness * stretch, forces, rtol=1e-14, atol=0)
    with pytest.raises(InputError, match="quantity = 'force': not allowed with law"):
        _ = check({"thresholds": {"quantity": "force"}}).ensemble


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_cells_are_separated_by_other_signs(tmp_path, separator):
    (tmp_path / "table.csv").write_text(f"threshold{separator}area\n1{separator}2\n")
    assert read_thresholds(tmp_path / "table.csv").steps.tolist() == [1.0]


@pytest.mark.parametrize(
    ("content", "column"),
    [
        ("# measured in nm\nsample,xs_nm\na,2.5\n# doubtful\nb,0.5\n", "xs_nm"),
        ("  # in nm\nxs_nm\n2.5\n0.5\n", None),  # the only column there is
        ("2.5\n0.5\n", None),  # without a name
        ("threshold, other\n2.5, 1\n0.5, 1\n", None),
    ],
)
def test_columns_and_scale_of_tables(tmp_path, content, column):
    (tmp_path / "x.csv").write_text(content)
    key = f'column = "{column}"\n' if column else ""
    text = f'[thresholds]\nlaw = "table"\nfile = "x.csv"\n{key}scale = 1e-9\n[drive]\nvelocity = 1.0\n'
    (tmp_path / "run.toml").write_text(text)
    file = load(tmp_path / "run.toml")
    assert list(file.ensemble.thresholds.steps) == [0.5e-9, 2.5e-9]
    other = at(file, {"thresholds.scale": 1.0})  # remembered are the values of both
    assert list(other.ensemble.thresholds.steps) == [0.5, 2.5]
    assert list(file.ensemble.thresholds.steps) == [0.5e-9, 2.5e-9]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"thresholds.scale": 0.0},
            "thresholds.scale = 0.0: must be a finite number > 0",
        ),
        (
            {"thresholds.column": "b"},
            'needs a column "b" in its first line; found a, c',
        ),
        (
            {"thresholds.law": "gamma", "thresholds.file": None},
            'thresholds.scale = 1.0: not allowed with law = "gamma"',
        ),
    ],
)
def test_bad_columns_and_scales(tmp_path, changes, message):
    (tmp_path / "x.csv").write_text("a,c\n1,2\n")
    text = '[thresholds]\nlaw = "table"\nfile = "x.csv"\nscale = 1.0\n[drive]\nvelocity = 1.0\n'
    (tmp_path / "run.toml").write_text(text)
    with pytest.raises(InputError) as caught:
        _ = at(load(tmp_path / "run.toml"), changes).ensemble
    assert message in str(caught.value)


NM = 'thresholds.file = {}: column "{}" is in {}, [units] says um'
SCALED = NM + "; thresholds.scale = {} converts"


@pytest.mark.parametrize(
    ("content", "more", "said"),
    [
        ("threshold (nm)\n800\n", {}, ("threshold (nm)", "nm", "0.001")),
        ("threshold,b\n[nm],s\n800,1\n9,1\n", {}, ("threshold", "nm", "0.001")),
        ("threshold [Å]\n800\n", {}, ("threshold [Å]", "Å", "0.0001")),
        ("threshold (N)\n8\n", {}, ("threshold (N)", "N")),
        ("threshold (um)\n800\n", {}, ()),
        ("threshold (µm)\n800\n", {}, ()),
        ("threshold (N)\n800\n", {"quantity": "force"}, ()),
        ("threshold (sample)\n800\n", {}, ()),
        ("threshold (nm)\n800\n", {"scale": 1.0}, ()),
    ],
)
def test_units_of_thresholds_are_those_of_the_run_file(content, more, said, tmp_path):
    """Unless a scale is given. Without [units] nothing is compared, nor where a run is
    repeated."""
    (tmp_path / "x.csv").write_text(content, encoding="utf-8")
    data = {"thresholds": {"law": "table", "file": "x.csv", **more}}
    united = {"units": {"length": "um", "force": "N"}} | data
    assert check(data, tmp_path).ensemble.thresholds.steps[-1] == 800 or said
    repeated = at(stored(check(united).settings, tmp_path), {"thermal.kT": 0.1})
    assert repeated.ensemble.thresholds == check(data, tmp_path).ensemble.thresholds
    if not said:
        assert check(united, tmp_path).ensemble.thresholds.steps.tolist() == [800.0]
        return
    with pytest.raises(InputError) as caught:
        _ = check(united, tmp_path).ensemble
    form = SCALED if len(said) == 3 else NM
    assert str(caught.value) == form.format(tmp_path / "x.csv", *said)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("t (ms),X (um)", '"t (ms)" is in ms, [units] says s'),
        ("t (s),X (mm)", '"X (mm)" is in mm, [units] says um'),
        ("t,X\ns,mm", '"X" is in mm, [units] says um'),
        ("t (s),X (um)", ""),
        ("t (laps),X (V)", ""),
    ],
)
def test_units_of_a_recorded_drive_are_those_of_the_run_file(names, said, tmp_path):
    (tmp_path / "x.csv").write_text(f"{names}\n0,0\n2,1\n")
    data = {"drive": {"file": "x.csv"}}
    united = {"units": {"length": "um", "time": "s"}} | data
    bare = check(data, tmp_path).drive
    assert stored(check(united).settings, tmp_path).drive == bare
    if not said:
        assert check(united, tmp_path).drive == bare
        return
    with pytest.raises(InputError) as caught:
        _ = check(united, tmp_path).drive
    where = f"drive.file = {tmp_path / 'x.csv'}"
    assert str(caught.value) == f"{where}: column {said}"


def test_changes(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[drive]\nvelocity = 0.1\n")
    file = load(path, {"drive.velocity": 2.0, "title": "x", "delay.time": 3})
    assert (file["drive.velocity"], file.title, file["delay.time"]) == (2.0, "x", 3.0)
    with pytest.raises(InputError, match="velocity is not a section"):
        load(path, {"drive.velocity.x": 1})
    numbers = {"contacts.count": np.int64(7), "sweep": {"thermal.kT": np.array([1, 2])}}
    file = load(path, numbers)
    assert (file["contacts.count"], file.sweep) == (7, {"thermal.kT": [1, 2]})
    assert file.text.endswith("# --set sweep={'thermal.kT': [1, 2]}\n")


@pytest.mark.parametrize("value", [True, 1.0, "3", None, 0, 11])
def test_integers_are_integers(value):
    """Of Python's bool is one; of a number of contacts it is a mistake."""
    with pytest.raises(
        InputError,
        match=rf"^field = {re.escape(repr(value))}: must be an integer from 1 to 10$",
    ):
        require_integer("field", value, 1, 10)
    require_integer("field", 1, 1, 10)
    require_integer("field", 10, 1, 10)


@pytest.mark.parametrize(
    ("bounds", "good", "bad"),
    [
        ({"above": 0.0}, [5e-324, 1e300], [0.0, -1.0, math.inf, math.nan, "1", None]),
        (
            {"least": 2.0, "most": 3.0},
            [2.0, 3.0, 2],
            [math.nextafter(2.0, 0.0), math.nextafter(3.0, 4.0), math.nan],
        ),
        ({}, [-1e300, 0], [math.inf, -math.inf, math.nan, 10**400]),
    ],
)
def test_bounds_of_numbers(bounds, good, bad):
    """What is allowed ends where the message says it does."""
    for value in good:
        require_number("field", value, **bounds)
    for value in bad:
        with pytest.raises(InputError, match=r"^field = .*: must be a finite number"):
            require_number("field", value, **bounds)


def test_no_count_of_contacts_is_true():
    for call in (
        lambda: Ensemble(count=True),
        lambda: trajectory(Ensemble(count=5), Drive(1.0, 1.0), replicas=True),
    ):
        with pytest.raises(InputError, match=r" = True: must be an integer from 1"):
            call()


def test_a_programme_in_a_run_file(tmp_path):
    data = programme(
        {"velocity": 0.1, "distance": 5},
        {"hold": 1e3, "points": 7},
        {"velocity": -1, "time": 2},
        velocity=2,
        start="stationary",
    )
    expected = Programme(
        [Segment(0.1, 5.0), Segment(0.0, None, 1e3, 7), Segment(-1.0, None, 2.0)],
        "stationary",
        2.0,
    )
    assert check(data, tmp_path).drive == expected


@pytest.mark.parametrize("course", ["programme", "file"])
def test_a_velocity_that_a_programme_does_not_use_is_refused(course, tmp_path):
    """It is that of a stationary start. Beside a start that is given it may stand, as
    the other start is chosen by that key alone, but not be changed."""
    (tmp_path / "x.csv").write_text("t,X\n0,0\n2,1\n")
    drive = programme({"velocity": 0.1, "time": 2.0})["drive"]
    drive = {"velocity": 5.0} | (drive if course == "programme" else {"file": "x.csv"})
    said = r"^drive.velocity = 5.0: not allowed with a programme or file, unless"
    fresh = {"drive": drive | {"start": "fresh"}}
    with pytest.raises(InputError, match=said):
        _ = check({"drive": drive}, tmp_path).drive
    with pytest.raises(InputError, match=said):
        opened(check(fresh, tmp_path), changes={"drive.velocity": 5.0})
    assert check(fresh, tmp_path).drive.start == "fresh"
    moving = at(check(fresh, tmp_path), {"drive.start": "stationary"})
    assert moving.drive.velocity_before == 5.0
    assert stored(check({"drive": drive}).settings, tmp_path).drive.start == "fresh"


def test_a_recorded_drive(tmp_path):
    """Piecewise linear: velocities and times of segments; a first line with a
    byte-order mark, more columns."""
    (tmp_path / "x.csv").write_text(
        "\ufefft, X ,temperature\n0,0,1\n2,1,1\n5,1,1\n6,0.5,1\n", encoding="utf-8"
    )
    drive = check({"drive": {"file": "x.csv"}}, tmp_path).drive
    assert [(segment.velocity, segment.time) for segment in drive.segments] == [
        (0.5, 2.0),
        (0.0, 3.0),
        (-0.5, 1.0),
    ]


def test_defaults_that_are_written_out_change_nothing():
    """A constant drive is no programme with these; a motor that stalls is one."""
    given = {"velocity": 0.1, "distance": 5.0}
    usual = {"stall_force": math.inf, "rebinding": "unstretched"}
    file = check({"drive": given | usual})
    assert file.constant_drive == Drive(0.1, 5.0)
    assert not file.pulled
    motor = check({"drive": given | {"stall_force": 2.0}})
    assert motor.pulled
    assert motor.drive.pulled
    assert check({"drive": {"force": 0.1, "time": 2.0}}).pulled
    with pytest.raises(InputError, match=r"drive\.time: has no steady state"):
        _ = check({"drive": {"velocity": 0.1, "time": 2.0}}).constant_drive


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t\n0\n", 'needs a column "X" in its first line; found t'),
        ("t,X\n0,0\n1,1\n1,2\n", "line 4: t = 1: must be later than 1 before it"),
        (
            "t,X\n0,0\n1,1\n0.5,2\n",
            "line 4: t = 0.5: must be later than 1 before it",
        ),
        (
            "t,X\n0,1\n1,1\n",
            "line 2: t = 0, X = 1: the first instant must be t = 0, X = 0",
        ),
        ("t,X\n0,0\n1,nan\n", "line 3: X = nan: must be finite"),
        ("t,X\n0,0\n1,much\n", "line 3: X = 'much': must be a number"),
        ("t,X\n0,0\n", "needs 2 instants at least"),
        ("t,X,X\n0,0,0\n", 'has 2 columns "X"'),
        ("t,X\n0,0\n1,5,3\n", "line 3: more values than columns"),
    ],
)
def test_bad_recorded_drives(tmp_path, text, message):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        _ = check({"drive": {"file": "x.csv"}}, tmp_path).drive
    assert str(caught.value).startswith("drive.file = ")
    assert message in str(caught.value)
    with pytest.raises(InputError, match="cannot be read"):
        _ = check({"drive": {"file": "absent.csv"}}, tmp_path).drive


def test_keys_of_a_programme():
    """Keys of segments, which sweeps and --set change, are those that are given."""
    file = check(programme({"velocity": 0.1, "distance": 5.0}, {"hold": 1e3}))
    found = {key: kind for key, kind in keys(file).items() if "programme" in key}
    expected = [
        "drive.programme.0.velocity",
        "drive.programme.0.distance",
        "drive.programme.1.hold",
    ]
    assert found == dict.fromkeys(expected, float)
    assert parameters(file)["drive.programme.1.hold"] == 1e3
    assert at(file, {"drive.programme.1.hold": 2.0})["drive.programme.1.hold"] == 2.0
    with pytest.raises(InputError, match="is not a key that can change"):
        at(file, {"drive.programme.1.velocity": 2.0})


def test_changes_of_a_programme(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(
        "[drive]\nprogramme = [{ velocity = 1.0, distance = 5.0 }, { hold = 1e3 }]\n"
    )
    assert load(path, {"drive.programme.1.hold": 2.0})["drive.programme.1.hold"] == 2.0
    for key in (
        "drive.programme.2.hold",
        "drive.programme.hold.1",
        "drive.programme.1",
    ):
        with pytest.raises(InputError, match=r"drive\.programme"):
            load(path, {key: 2.0})


def test_settings_are_stored_and_read_again():
    """An infinite rate, for which JSON has no number, and a title that is called as it
    is written."""
    data = {
        "title": "Infinity",
        "disorder": "annealed",
        "aging": {"rule": "flow", "rate": math.inf, "x_star_final": 2.0},
    }
    file = check(data)
    settings = provenance("run", file.settings, "", 1)["settings"]
    assert settings["aging"]["rate"] == "Infinity"
    again = stored(json.loads(json.dumps(settings)))
    assert (again.title, again["aging.rate"]) == ("Infinity", math.inf)
