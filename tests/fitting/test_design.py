"""What measurements tell before they are made: expected errors, and `eqsim design`."""

import hashlib
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis import coverage
from eqsim.cli.app import app
from eqsim.errors import InputError
from eqsim.fitting.data import read_table
from eqsim.fitting.design import design, expected
from eqsim.fitting.estimate import minimise
from eqsim.fitting.model import DERIVATIVE_STEP as STEP
from eqsim.fitting.profiles import LEVELS
from eqsim.fitting.section import section_of
from eqsim.io import storage
from eqsim.io.runfile import load

RUNS = Path(__file__).parents[2] / "runs"
ROWS = list(coverage.TABLE.items())


@pytest.mark.parametrize(
    ("case", "values"),
    [
        pytest.param(*row, marks=[pytest.mark.verification] if i % 3 else [])
        for i, row in enumerate(ROWS)
    ],
    ids=[
        f"{case.disorder}-{case.b:g}-{case.law}-{case.decades:g}-{len(case.heats)}"
        for case, _ in ROWS
    ],
)
def test_expected_errors(case, values):
    """Values printed to two or three digits, good to 5 %."""
    found = coverage.expected(coverage.problem(case))
    assert [found[key] for key in coverage.COLUMNS] == pytest.approx(
        values, rel=0.05, abs=0
    )


def test_a_fixed_n_helps():
    """sd(ln b) of 1.12 becomes .17 (two digits, 5 %)."""
    free = ("thermal.kT", "thermal.attempt_frequency")
    found = coverage.expected(
        coverage.problem(coverage.Case("annealed", 5.0, "uniform", 4.0, (1.0,)), free)
    )
    assert found["thermal.kT"] == pytest.approx(0.17, rel=0.05, abs=0)


def test_derivatives():
    """By central differences: halving the step changes them by less than 1e-6 of the
    largest, three times the step's square; and the rows of a linear parameter are
    exact."""
    problem = coverage.problem(
        coverage.Case("annealed", 5.0, "uniform", 3.0, (1.0, 1.3))
    )
    u = problem.start
    for i in range(u.size):
        up, down = (
            u + sign * 0.5 * STEP * (np.arange(u.size) == i) for sign in (1.0, -1.0)
        )
        column = (problem.given(up) - problem.given(down)) / STEP / problem.sigma
        jacobian = problem.jacobian(u)[:, i]
        np.testing.assert_allclose(
            jacobian, column, rtol=0, atol=1e-6 * np.abs(jacobian).max()
        )


def test_singular_directions_have_no_bound():
    jacobian = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 2.0], [1.0, 1.0, 0.0]])
    assert expected(jacobian, 0) == math.inf
    assert expected(jacobian, 2) == 0.5
    assert expected(np.eye(2)[:1], 1) == math.inf


RUN = """
disorder = "annealed"
[contacts]
stiffness_law = "uniform"
[thermal]
kT = 0.1
[thresholds]
n = 1.0
[fit]
data = "data.csv"
scale = { start = 1.0, bounds = [0.01, 100.0] }
noise = { relative = 0.05 }
temperature = "temperature"
reference_temperature = 300.0
[fit.free]
"thermal.kT" = { bounds = [1e-3, 20.0] }
"thermal.attempt_frequency" = { bounds = [1e-4, 1e4] }
"thresholds.n" = { bounds = [0.0, 15.0], transform = "log1p" }
"""


@pytest.fixture
def folder(tmp_path):
    """Exact data, and a fit that found the truth."""
    exact = coverage.problem(coverage.Case("annealed", 5.0, "uniform", 3.0, (1.0,)))
    velocities = coverage.Case("annealed", 5.0, "uniform", 3.0, (1.0,)).velocities
    lines = [
        f"{v:.15g},300,{F:.15g}" for v, F in zip(velocities, exact.value, strict=True)
    ]
    (tmp_path / "data.csv").write_text(
        "drive.velocity,temperature,friction\n" + "\n".join(lines)
    )
    (tmp_path / "run.toml").write_text(RUN)
    file = load(tmp_path / "run.toml")
    truth = {
        "thermal.kT": 0.1,
        "thermal.attempt_frequency": 1.0,
        "thresholds.n": 1.0,
        "fit.scale": 1.0,
    }
    digest = read_table(tmp_path / "data.csv", file, section_of(file)).sha256
    found = {
        "parameters": {key: {"estimate": value} for key, value in truth.items()},
        "data_sha256": digest,
    }
    (tmp_path / "fit.json").write_text(json.dumps(found))
    fitted_with(tmp_path, file)
    return tmp_path


def fitted_with(folder, file):
    """Write the table of a fit, as far as its provenance."""
    origin = storage.provenance("fit", file.settings, file.text, 1, file.folder)
    (folder / "fitted.parquet").write_bytes(storage.parquet({"x": np.ones(1)}, origin))


def call(folder, *args):
    return CliRunner().invoke(
        app, ["design", str(folder / "run.toml"), "--fit", str(folder), *map(str, args)]
    )


def test_the_next_measurement(folder):
    """12 velocities over 3 decades: one more at 1e-4 v_*, 1.3 T takes sd(ln b) from
    2.10 to .53, where to repeat all gives 1.49 (three digits, 1 %)."""
    star = coverage.Case("annealed", 5.0, "uniform", 3.0, (1.0,)).velocities
    slow = 1e-4 * math.sqrt(star[0] * star[-1])
    one = call(folder, "--for", "thermal.kT", "--next", 1, "--velocity", f"{slow},{slow}", "--temperature", "390,390",
               "--json")  # fmt: skip
    assert one.exit_code == 0, one.output
    found = json.loads(one.output)
    assert found["now"] == pytest.approx(2.10, rel=0.01, abs=0)
    assert found["steps"][0]["sd"] == pytest.approx(0.53, rel=0.01, abs=0)
    assert found["repeated"] == pytest.approx(1.49, rel=0.01, abs=0)
    table = call(folder, "--for", "thermal.kT", "--temperature", "300,390")
    assert table.exit_code == 0, table.output
    many = json.loads(
        call(folder, "--for", "thermal.kT", "--temperature", "300,390", "--json").output
    )
    sd = [many["now"], *(step["sd"] for step in many["steps"])]
    assert len(sd) == 5
    assert np.all(np.diff(sd) < 0)  # every measurement helps
    assert sd[1] < 0.6 * sd[0]


def test_where_the_next_measurement_is_made(folder):
    """At the run file's value of a key that is a column of the data, which is told."""
    data = (folder / "data.csv").read_text().splitlines()
    lines = [
        f"{line},{x}"
        for line, x in zip(data, ["delay.time", *[0.0] * 99], strict=False)
    ]
    (folder / "data.csv").write_text("\n".join(lines))
    digest = hashlib.sha256((folder / "data.csv").read_bytes()).hexdigest()
    found = json.loads((folder / "fit.json").read_text())
    (folder / "fit.json").write_text(json.dumps({**found, "data_sha256": digest}))
    one = "--for", "thermal.kT", "--next", 1, "--set", "delay.time=2.0"
    assert "at delay.time = 2.0 of the run file" in call(folder, *one).output
    assert json.loads(call(folder, *one, "--json").output)["at"] == {"delay.time": 2.0}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("contacts.stiffness_law=sqrt", 'contacts.stiffness_law = "uniform", not "sqrt"'),
        ("disorder=quenched", 'disorder = "annealed", not "quenched"'),
        ("thresholds.x_star=2.0", "thresholds.x_star = 1.0, not 2.0"),
        ("fit.reference_temperature=200.0", "fit.reference_temperature = 300.0, not 200.0"),
        ("thermal.kT=0.2", None),  # is free
        ("drive.velocity=2.0", None),
        ("output.seed=5", None),
    ],
)  # fmt: skip
def test_a_fit_of_another_model_is_refused(folder, change, said):
    done = call(folder, "--for", "thermal.kT", "--next", 1, "--set", change)
    assert done.exit_code == (2 if said else 0), done.output
    made = f"eqsim: --fit {folder}: was made with {said}\n"
    assert done.stderr == (made if said else "")


def test_files_of_thresholds_are_compared_wherever_the_run_file_is(folder):
    """Run files in two folders name one file of thresholds by other words; a moved one
    is compared by its words."""
    (folder / "th.csv").write_text("0.5\n1.5\n")
    shutil.copy(folder / "th.csv", folder / "other.csv")
    text = RUN.replace("n = 1.0\n", 'law = "table"\nfile = "th.csv"\n')
    text = text[: text.index('"thresholds.n"')]
    below = text.replace('"th', '"../th').replace('"data', '"../data')
    (folder / "below").mkdir()
    (folder / "below" / "run.toml").write_text(below)
    (folder / "run.toml").write_text(text)
    found = json.loads((folder / "fit.json").read_text())
    del found["parameters"]["thresholds.n"]
    (folder / "fit.json").write_text(json.dumps(found))
    made = load(folder / "below" / "run.toml")
    moved = replace(load(folder / "run.toml"), folder=Path("/nowhere"))
    for fit in (made, moved):
        fitted_with(folder, fit)
        one = call(folder, "--for", "thermal.kT", "--next", 1)
        assert one.exit_code == 0, one.output
        other = call(
            folder, "--for", "thermal.kT", "--set", "thresholds.file=other.csv"
        )
        assert other.exit_code == 2
        assert "was made with thresholds.file = " in other.stderr


def test_populations_inherit_what_is_free(folder):
    """Its start may differ from that of the fit in each of them; what is fixed may
    not."""
    kinds = "[[population]]\nshare = 0.5\n" * 2
    (folder / "run.toml").write_text(RUN + kinds + "stiffness = 2.0\n")
    fitted_with(folder, load(folder / "run.toml"))
    changes = "--set", "thermal.kT=0.2", "--set", "population.1.stiffness=3.0"
    refused = call(folder, "--for", "thermal.kT", *changes)
    assert refused.stderr.endswith("population.1.stiffness = 2.0, not 3.0\n")


def test_keys_without_a_value_are_not_where_measurements_are_made(folder):
    """The temperature of a run file that has kT is one of them."""
    text = RUN.replace('temperature = "temperature"\n', "")
    text = text.replace("reference_temperature = 300.0\n", "").replace(
        '"thermal.kT" = { bounds = [1e-3, 20.0] }\n', ""
    )
    units = '[units]\nlength = "nm"\nforce = "pN"\ntime = "s"\n'
    (folder / "run.toml").write_text(text + units)
    data = (
        (folder / "data.csv").read_text().replace("temperature", "thermal.temperature")
    )
    (folder / "data.csv").write_text(data)
    digest = hashlib.sha256(data.encode()).hexdigest()
    found = json.loads((folder / "fit.json").read_text()) | {"data_sha256": digest}
    del found["parameters"]["thermal.kT"]
    (folder / "fit.json").write_text(json.dumps(found))
    fitted_with(folder, load(folder / "run.toml"))
    done = call(folder, "--for", "thresholds.n", "--next", 1, "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["at"] == {}


@pytest.mark.parametrize("swapped", [False, True])
def test_measurements_belong_to_the_set_whose_scale_is_asked_for(folder, swapped):
    """Else to the first one; and the order of the rows does not count."""
    head, *rows = (folder / "data.csv").read_text().splitlines()
    half = len(rows) // 2
    rows = [f"{row},{'ab'[i >= half]}" for i, row in enumerate(rows)]
    rows = rows[half:] + rows[:half] if swapped else rows
    data = "\n".join([f"{head},set", *rows])
    (folder / "data.csv").write_text(data)
    summary = json.loads((folder / "fit.json").read_text())
    del summary["parameters"]["fit.scale"]
    for name in "ab":
        summary["parameters"][f"fit.scale.{name}"] = {"estimate": 1.0}
    summary["data_sha256"] = hashlib.sha256(data.encode()).hexdigest()
    (folder / "fit.json").write_text(json.dumps(summary))
    found = design(load(folder / "run.toml"), folder, "fit.scale.b", 2)
    assert found.set == "b"
    assert found.now == pytest.approx(0.251808, rel=1e-5, abs=0)
    first = found.steps[0]  # in set a it would be another
    assert first.velocity == pytest.approx(3.11388e-4, rel=1e-5, abs=0)
    assert first.sd == pytest.approx(0.125380, rel=1e-5, abs=0)
    other = design(load(folder / "run.toml"), folder, "thermal.kT", 1)
    assert other.set == "ab"[swapped]
    done = call(folder, "--for", "fit.scale.b", "--next", "1")
    assert "of set b" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--for", "thermal.KT"], 'did you mean "thermal.kT"'),
        (["--for", "thermal.kT", "--velocity", "1"], "must be two numbers, LOW,HIGH"),
        (["--for", "thermal.kT", "--velocity", "2,1"], "--velocity 2,1: the first"),
        (["--for", "thermal.kT", "--temperature", "0,1"], "--temperature = 0"),
        (["--for", "thermal.kT", "--next", "0"], "--next = 0"),
        (["--for", "thermal.kT", "--fit", "nowhere"], "holds no fit.json"),
        (
            ["--for", "thermal.kT", "--set", "fit.data='other.csv'"],
            "is a fit of other data",
        ),
        (["--for", "thermal.kT", "--set", "fit.scale=1.0"], "has other free keys"),
    ],
)
def test_bad_input(folder, arguments, said):
    (folder / "other.csv").write_text((folder / "data.csv").read_text() + "\n")
    result = call(folder, *arguments)
    assert result.exit_code == 2
    assert said in result.output
    assert len(result.output.splitlines()) == 1


@pytest.mark.verification
@pytest.mark.parametrize("name", coverage.COVERED)
def test_intervals_cover(name):
    """60 data sets: counts of 68 and 95 % for four keys are within the binomial range
    of 99.9 % each, which fails by chance in less than 8 of a thousand cases; intervals
    at a third of their levels do not (negative control)."""
    every = list(coverage.rises(coverage.COVERED[name](), 60, 1))
    for part, holds in ((1.0, all), (1 / 3, lambda found: not all(found))):
        checked = []
        for level, rise in LEVELS.items():
            low, high = coverage.binomial(60, int(level) / 100)
            for key in every[0]:
                checked.append(
                    low <= np.mean([one[key] < part * rise for one in every]) <= high
                )
        assert holds(checked)


def test_exact_data_are_fitted_exactly():
    """Chi-square of data without noise is 0, from another start: below 1e-6, which is a
    thousandth of a standard error, the largest of which is .54."""
    problem = coverage.problem(
        coverage.Case("annealed", 5.0, "uniform", 4.0, (1.0, 1.3))
    )
    found = minimise(problem, problem.start + 0.3)
    assert found.converged
    assert found.chi2 < 1e-6
    np.testing.assert_allclose(found.u, problem.start, rtol=0, atol=6e-4)


def test_a_record_has_no_next_measurement():
    file = load(RUNS / "fit-velocity-step.toml")
    with pytest.raises(InputError, match=r"fit\.data: must be a table of averages"):
        design(file, Path("none"), "thermal.kT")
