"""Fits of records: force against time under a programme, through a spring, with
correlated errors."""

import json
import math
import re
import tomllib
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from analysis import coverage
from eqsim import InputError, load
from eqsim.cli.app import app
from eqsim.fitting import report
from eqsim.fitting.estimate import Minimum, covariance, minimise
from eqsim.fitting.fit import (
    FitResult,
    compared,
    fit,
    goodness,
    prepare,
    rival_of,
)
from eqsim.fitting.model import Problem
from eqsim.fitting.pictures import data_figure
from eqsim.fitting.profiles import LEVELS, Side
from eqsim.fitting.record import RecordForward, correlated, settle_steps, shapes
from eqsim.fitting.section import Parameter, section_of
from eqsim.io.runfile import at, check
from eqsim.master.transient import transient

ROOT = Path(__file__).parents[2]
RUN = (
    coverage.RECORD.replace(
        'file = ""', 'file = "record.csv", time = "t", force = "force"'
    )
    .replace('"drive.stage.stiffness" = { bounds = [0.05, 5.0] }\n', "")
    .replace("[fit]", "[output]\npoints = 81\n[fit]")
)
TIMES = np.linspace(0.0, 5.0, 81)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run.toml").write_text(RUN)
    write(tmp_path, np.ones(TIMES.size))
    return tmp_path


def write(folder, force, times=TIMES):
    lines = [f"{t:.12g},{F:.12g}" for t, F in zip(times, force, strict=True)]
    (folder / "record.csv").write_text(
        "# a record\nt,force\n" + "\n".join(lines) + "\n"
    )


def markov(rho, seed, size):
    return coverage.markov(np.random.default_rng(seed), size, rho)


def test_prediction_is_the_mean_field(folder):
    """With its correction within the errors that both solves quote, and three times
    nearer than coarse steps."""
    file = load(folder / "run.toml")
    exact = transient(file.ensemble, file.drive, 81)
    write(folder, np.ones(exact.t.size), exact.t)
    forward = prepare(file, None, False).problem.forward
    coarse, _ = forward.predict({})
    better, error = forward.corrected({}).predict({})
    assert np.all(np.abs(better - exact.force) <= error + exact.force_error)
    assert np.abs(better - exact.force).max() < 0.3 * np.abs(coarse - exact.force).max()


AHEAD = {"velocity": 0.5, "time": 4.0}
BACK = {"velocity": -0.5, "time": 8.0}


@pytest.mark.parametrize(
    ("start", "programme"),
    [
        ({"start": "fresh"}, [AHEAD]),
        pytest.param(
            {"start": "stationary", "velocity": 0.5},
            [AHEAD, BACK],
            marks=pytest.mark.verification,
        ),
    ],
)
def test_forces_may_be_0(folder, start, programme):
    """From a fresh start, whose force is 0, or through 0 after a reversal: what coarse
    steps miss, found with other thresholds, does more good than harm; the error that is
    left at those thresholds themselves is 10 times smaller. Relative to the force itself
    it would be 0/0, or 7 times too large."""
    base = {"contacts": {"stiffness_law": "uniform"}, "thermal": {"kT": 0.05}}
    drive = {**start, "programme": programme, "stage": {"stiffness": 0.5}}
    base |= {"drive": drive}

    def exact(x_star):
        file = check(base | {"thresholds": {"x_star": x_star}})
        return transient(file.ensemble, file.drive, 81)

    write(folder, np.ones(81), exact(1.0).t)
    free = {"thresholds.x_star": {"bounds": [0.2, 5.0]}}
    section = {"record": {"file": "record.csv"}, "noise": {"absolute": 0.003}}
    file = check(base | {"fit": {**section, "free": free}}, folder)
    problem = prepare(file, None, False).problem
    problem = settle_steps(problem, problem.start)
    coarse = problem.forward
    forward = coarse.corrected({"thresholds.x_star": 1.0})
    off = {}
    for x_star in (0.7, 1.0):
        force = exact(x_star).force
        for name, one in (("coarse", coarse), ("corrected", forward)):
            predicted, _ = one.predict({"thresholds.x_star": x_star})
            off[name, x_star] = np.abs(predicted - force).max()
    assert off["corrected", 0.7] < off["coarse", 0.7]
    assert off["corrected", 1.0] < 0.1 * off["coarse", 1.0]


def test_slip_that_was_recorded_drives_the_slider(tmp_path):
    """Contacts know the slider's way alone: driven along the slip of a run behind a
    spring, without one, they have its force at T = 0, where no time passes, within the
    errors of both; driven along the load point (control) they have not."""
    spring = {"stiffness": 0.5}
    drive = {"programme": [{"velocity": 0.1, "time": 40.0}]}
    base = {"contacts": {"stiffness_law": "uniform"}}
    file = check(base | {"drive": drive | {"stage": spring}})
    exact = transient(file.ensemble, file.drive, 41)
    table = np.c_[exact.t, exact.X, exact.stage, exact.force]
    head = {"header": "t,slip,load_point,force", "comments": "", "delimiter": ","}
    np.savetxt(tmp_path / "slip.csv", table, "%.15g", **head)
    drive = {"file": "slip.csv"}
    fit = {
        "record": {"file": "slip.csv"},
        "noise": {"absolute": 0.005},
        "free": {"thresholds.x_star": {"bounds": [0.1, 10.0]}},
    }
    off = {}
    for name in ("slip", "load_point"):
        given = {"drive": drive | {"record": {"displacement": name}}, "fit": fit}
        forward = prepare(check(base | given, tmp_path), None, False).problem.forward
        force, error = forward.predict({})
        sigma = error + exact.force_error
        off[name] = float(np.abs((force - exact.force) / sigma).max())
    assert off["slip"] < 1.0, off
    assert off["load_point"] > 100.0, off


def test_machine_stiffness_is_that_of_the_stage(folder):
    """K = scale kappa_s."""
    file = load(folder / "run.toml")
    plain = prepare(file, None, False).problem
    content = deepcopy(file.given)
    content["fit"]["record"]["machine_stiffness"] = 0.5 * 3.0
    given = prepare(check(content, folder), None, False).problem
    assert not given.linear[1]
    assert plain.linear[1]
    np.testing.assert_array_equal(
        given.forward.predict({"fit.scale": 3.0})[0], plain.forward.predict({})[0]
    )
    other = given.forward.predict({"fit.scale": 1.0})[0]
    assert np.abs(other - plain.forward.predict({})[0]).max() > 0.004  # of 1
    del content["drive"]["stage"]
    with pytest.raises(InputError, match=r"drive.stage: is required with machine"):
        prepare(check(content, folder), None, False)


@pytest.mark.parametrize("scale", [3.0, {"start": 3.0, "bounds": [0.1, 10.0]}])
def test_the_run_file_of_a_fit_is_the_best_one(tmp_path, scale):
    """Its stage is K/scale, and its tables of thresholds and drives are found, those of
    populations, too."""
    (tmp_path / "xi.csv").write_text("1\n2\n")
    (tmp_path / "X.csv").write_text("t,X\n0,0\n5,1\n")
    write(tmp_path, np.ones(TIMES.size))
    table = {"law": "table", "file": "xi.csv"}
    content = tomllib.loads(RUN)
    del content["drive"]["programme"]
    content["drive"]["file"] = "X.csv"
    content["population"] = [{"share": 1.0, "thresholds": table}, {"share": 1.0}]
    content["fit"]["record"]["machine_stiffness"] = 0.9
    content["fit"]["scale"] = scale
    file = check(content, tmp_path)
    section, table, problem = prepare(file, None, False)[1:4]
    best = Minimum(problem.start, 1.0, True, 1)
    found = FitResult(file, section, problem, table, best, np.eye(1), [best], {}, [])
    out = tmp_path / "results" / "of"
    out.mkdir(parents=True)
    (out / "run.toml").write_text(report.run_toml(found, out))
    again = load(out / "run.toml")
    assert again["drive.stage.stiffness"] == pytest.approx(0.3, rel=1e-14, abs=0)
    assert again.ensemble.populations[0].thresholds.mean == 1.5
    assert again.drive == at(file, found.changes).drive


def test_populations_on_a_machine_in_its_own_units():
    """K/(N k) with the N of the run file, beside shares that are not rounded to it."""
    kinds = [{"share": 1.0, "stiffness": 1e3}, {"share": 2.0, "stiffness": 4e3}]
    machine = {"machine_stiffness": "50 N/mm", "radiation_damping": "100 N s/m"}
    drive = {"start": "stationary", "velocity": 1.0, "stage": machine}
    file = check(
        {
            "units": {"length": "m", "time": "s", "force": "N"},
            "interface": {"normal_load": 10.0},
            "contacts": {"count": 1000},
            "population": kinds,
            "drive": drive | {"programme": [{"velocity": 1.0, "time": 1.0}]},
        }
    )
    course = RecordForward(file, np.array([0.0, 1.0]), None, 1.0).course({})
    assert course.programme.stage == file.drive.stage
    assert file.drive.stage.stiffness == pytest.approx(5e4 / 3e6, rel=1e-3, abs=0)
    weights = [kind.weight for kind in course.ensemble.kinds]
    assert weights == pytest.approx([1.0 / 9.0, 8.0 / 9.0], rel=1e-11, abs=0)


def test_truth_is_recovered(folder):
    """Of a record with correlated errors, a scale and a drift: within 4 standard
    deviations, not rejected, and the correlation of neighbours within three of its
    standard errors, .09 for 81 points. Its own run file as another model has the same
    chi-square, to what two searches leave that end at relative changes of 1e-5; without
    the correction it would be 3e-3 less."""
    file = load(folder / "run.toml")
    exact = transient(file.ensemble, file.drive, 81)
    force = 2.0 * np.interp(TIMES, exact.t, exact.force) + 0.01 * (TIMES - 2.5)
    write(folder, force + 0.003 * markov(0.6, 1, TIMES.size))
    found = fit(file, folder, starts=1)
    for one, truth in zip(found.intervals, (0.05, 2.0, 0.01), strict=True):
        off = (
            math.log(one.estimate / truth)
            if one.transform == "log"
            else one.estimate - truth
        )
        assert abs(off) < 4.0 * one.sd, one
    assert not found.rejected
    assert math.exp(-0.0625 / found.correlation.time) == pytest.approx(0.6, abs=0.27)
    assert found.correlation.effective < 40
    assert found.floor < 0.5
    same = compared(found, *rival_of(found.fit, found.table, file, 1))
    assert same.chi2 == pytest.approx(found.goodness.chi2, rel=1e-4, abs=0)


def test_whitened_errors_are_independent(folder):
    """1000 points of correlation .8: whitened they have none (to .1, 3 standard
    errors), and a variance of 1 (to .15); the effective number is that of the mean, n
    (1 - rho)/(1 + rho)."""
    problem = prepare(load(folder / "run.toml"), None, False).problem
    r = markov(0.8, 3, 1000)
    w = replace(problem, correlation=np.full(999, 0.8)).white(r)
    assert abs(w[1:] @ w[:-1]) / 1000 < 0.1
    assert w @ w / 1000 == pytest.approx(1.0, abs=0.15)
    assert abs(r[1:] @ r[:-1]) / 1000 > 0.7
    u = problem.start
    exact = problem.given(u)
    noisy = replace(problem, value=exact + problem.sigma * markov(0.8, 4, exact.size))
    _, correlation = correlated(noisy, u, TIMES)
    rho = math.exp(-0.0625 / correlation.time)
    assert correlation.effective == pytest.approx(
        1 + 80 * (1 - rho) / (1 + rho), rel=1e-9, abs=0
    )
    independent = replace(
        problem, value=exact + problem.sigma * markov(0.0, 5, exact.size)
    )
    assert correlated(independent, u, TIMES)[1].effective > 50


@dataclass(frozen=True)
class Nothing(RecordForward):
    """A record of its offset alone."""

    def predict(self, changes):
        return np.zeros(self.time.size), np.zeros(self.time.size)

    def settle_steps(self, changes):
        return self

    def corrected(self, changes, each=map):
        return self


def test_neighbours_are_correlated_where_points_are_dense():
    """200 records of an offset, 0, most of whose points are ten correlation times apart
    and the others a tenth of one: 95 % intervals miss it in more than 24 fair cases once
    in 10 000 times; if the former points made all errors independent, about 98 would."""
    t = np.concatenate((np.arange(0.0, 1200.0, 10.0), 1200.0 + 0.1 * np.arange(80)))
    rho, missed = np.exp(-np.diff(t)), 0
    free = [Parameter("fit.offset", "linear", -10.0, 10.0, 0.0, linear=True)]
    none, ones = np.full(t.size, -1), np.ones(t.size)
    for seed in range(200):
        r = np.random.default_rng(seed).standard_normal(t.size)
        for i, past in enumerate(rho, 1):
            r[i] = past * r[i - 1] + math.sqrt(1.0 - past**2) * r[i]
        forward = Nothing(None, t, None, 1.0)
        problem = Problem(forward, free, r, ones, none, ones, none > 0)
        problem = replace(problem, nuisance={"fit.offset": ones})
        problem, _ = correlated(problem, minimise(problem, problem.start).u, t)
        best = minimise(problem, problem.start)
        sd = math.sqrt(covariance(problem.jacobian(best.u))[0, 0])
        missed += abs(best.u[0]) > 1.96 * sd
    assert missed <= 24


def test_likelihood_of_correlated_errors(folder):
    """-2 ln L of whitened residuals is that of a normal law with their covariance
    matrix."""
    problem = prepare(load(folder / "run.toml"), None, False).problem
    rho = np.full(80, 0.5)
    noisy = replace(
        problem,
        value=problem.given(problem.start) + 0.003 * markov(0.5, 6, 81),
        correlation=rho,
    )
    u = noisy.solved(noisy.start)[0]
    r = noisy.value - noisy.solved(u)[1]
    matrix = 0.003**2 * 0.5 ** np.abs(np.subtract.outer(np.arange(81), np.arange(81)))
    deviance = (
        r @ np.linalg.solve(matrix, r) + np.linalg.slogdet(2.0 * math.pi * matrix)[1]
    )
    assert goodness(noisy, u).deviance == pytest.approx(deviance, rel=1e-9, abs=0)


@pytest.mark.verification
def test_command(folder):
    """A record that no such model gives: its numbers, a picture, and exit code 1."""
    write(folder, 1.0 + 0.2 * np.sin(3.0 * TIMES))
    (folder / "run.toml").write_text(
        RUN.replace('"fit.drift" = { bounds = [-0.1, 0.1] }', "")
    )
    result = CliRunner().invoke(
        app,
        [
            "fit",
            str(folder / "run.toml"),
            "--out",
            str(folder / "out"),
            "--starts",
            "1",
            "--workers",
            "1",
            "--json",
        ],
    )
    assert result.exit_code == 1, result.output
    found = json.loads(result.output)
    assert found["rejected"]
    assert found["correlation"]["effective"] < 81
    assert (folder / "out" / "fit.png").stat().st_size > 10_000


def test_short_intervals_are_rough_where_time_steps_are_taken(folder):
    """Ends a twentieth of the standard deviation away are roughness of a solver that
    takes time steps. They are not where none are taken, nor where the standard deviation
    is beyond a factor 3: then the bounds of other keys end an interval."""
    file = load(folder / "run.toml")
    _, section, table, problem, _ = prepare(file, None, False)
    u = problem.start
    best = Minimum(u, 1.0, True, 1)

    def said(problem, sd):
        ends = [u[0] - 0.05 * sd, u[0] + 0.05 * sd]
        sides = [Side(u[None], np.zeros(1), {"95": x}, False) for x in ends]
        found = FitResult(
            file=file,
            fit=section,
            problem=problem,
            table=table,
            best=best,
            jacobian=np.eye(u.size) / sd,
            minima=[best],
            profiles={problem.keys[0]: sides},
            noticed=[],
        )
        return [line for line in found.warnings if "roughness" in line]

    settled = settle_steps(problem, u)
    assert len(said(settled, 0.5)) == 1
    assert said(settled, 1.2) == []
    assert said(problem, 0.5) == []


BAD = {
    "column": ({"record": {"file": "record.csv", "time": "x"}}, None,
               'column "x" in its first line; found t, force (fit.record.time'),
    "blocks": ({"record": {"file": "record.csv", "blocks": "all"}}, None,
               "fit.record.blocks = 'all': must be \"auto\" or \"none\""),
    "size": ({"record": {"file": "record.csv", "blocks": {"per": "way", "size": 1.0}}}, None,
             "fit.record.blocks.per = 'way': must be \"displacement\" or \"time\""),
    "trend": ({"free": {"fit.trend": {"bounds": [-1.0, 1.0]}}}, None,
              'fit.trend: is required, { per = "displacement" }, or "time"'),
    "order": ({}, "t,force\n0,1\n2,1\n1,1\n", "line 4: t = 1: must be later"),
    "negative time": ({}, "t,force\n-1,1\n2,1\n", "begins before time 0"),
    "too long": ({}, "t,force\n" + "\n".join(f"{t},1" for t in range(20)), "after the programme, which takes 5"),
    "two clocks": ({"record": {"file": "record.csv", "time": "t", "displacement": "X"}}, None,
                   "fit.record.time: not allowed with fit.record.displacement"),
    "no error": ({"noise": {}}, None, "line 3: force has no error; give fit.record.stderr or fit.noise"),
    "few": ({}, "t,force\n0,1\n2,1\n", "fit.record: has 2 measurements for"),
    "temperature": ({"temperature": "T", "reference_temperature": 300.0}, None,
                    "fit.temperature: only of a table; there is fit.record"),
    "both": ({"data": "record.csv"}, None, "fit.record: not allowed with fit.data"),
    "file": ({"record": {"file": "none.csv"}}, None, "none.csv: cannot be read (No such file"),
    "two stiffnesses": (
        {"record": {"file": "record.csv", "machine_stiffness": 1.0},
         "free": {"drive.stage.stiffness": {"bounds": [0.1, 1.0]}}},
        None, "not allowed with fit.record.machine_stiffness",
    ),
    "no programme": ({}, None, "drive.programme: is required with fit.record"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input(folder, name):
    section, data, said = BAD[name]
    content = load(folder / "run.toml").given
    content["fit"] |= section
    if name == "no programme":
        content["drive"] = {"velocity": 1.0}
    if data is not None:
        (folder / "record.csv").write_text(data)
    with pytest.raises(InputError, match=re.escape(said)):
        fit(check(content), folder, starts=1)


def test_the_committed_record():
    """It is read, and says where it comes from."""
    path = ROOT / "runs" / "fit-velocity-step.toml"
    file = load(path)
    assert section_of(file).record.machine_stiffness == 1.6e-3
    prepared = prepare(file, None, False)
    assert prepared.table.time.size == 215
    text = (path.parent / "p655-velocity-steps.csv").read_text()
    assert "BSD-3-Clause" in text
    assert "LeemanGeophysicalLLC/pylook" in text


@pytest.mark.verification
def test_correlated_errors_are_not_independent(folder):
    """20 records with errors of correlation .7: taken for independent ones, 95 %
    intervals of beta miss the truth more often than whitened ones, which miss at most 5
    times (more by chance in 3 of 10 000 cases)."""
    problem = prepare(load(folder / "run.toml"), None, False).problem
    truth = np.array([math.log(0.05), 0.0, 0.0])
    exact = problem.given(truth)
    misses = {"whitened": 0, "independent": 0}
    for seed in range(20):
        noisy = replace(
            problem, value=exact + problem.sigma * markov(0.7, seed, exact.size)
        )
        white = replace(noisy, correlation=np.full(exact.size - 1, 0.7))
        for name, one in (("whitened", white), ("independent", noisy)):
            misses[name] += (
                minimise(one, truth, 0).chi2 - minimise(one, truth).chi2 > LEVELS["95"]
            )
    assert misses["whitened"] <= 5
    assert misses["independent"] > misses["whitened"]


def slope(problem, index, step):
    """Central difference of predictions with respect to a parameter."""
    forward, shift = problem.forward, step * (np.arange(problem.start.size) == index)
    up, down = (
        forward.predict(problem.changes(problem.start + sign * shift))[0]
        for sign in (1, -1)
    )
    return (up - down) / (2 * step)


def change(problem, index, step):
    """Relative change of a derivative from a step of 1e-3 to a longer one."""
    fine, coarse = slope(problem, index, 1e-3), slope(problem, index, step)
    return np.linalg.norm(coarse - fine) / np.linalg.norm(fine)


def test_given_steps_make_predictions_smooth():
    """The same numbers where steps were chosen; derivatives from a step of .05 in a
    logarithm miss what is of third order in it (.05^2/6 of what is 1), and if each
    solve chooses its own steps, more. Far away, where they do not serve, the others are
    taken."""
    exact = coverage.record()
    few = replace(exact.forward, time=exact.forward.time[::4], choices=())
    problem = settle_steps(replace(exact, forward=few), exact.start)
    rough = replace(problem, forward=few)
    changes = problem.changes(problem.start)
    own, given = (one.forward.predict(changes)[0] for one in (rough, problem))
    # rounding, 1e-16 in each of some hundred steps
    np.testing.assert_allclose(given, own, rtol=1e-12, atol=0)
    assert change(problem, 1, 0.05) < 2e-3
    assert change(rough, 1, 0.05) > 2e-3  # which own steps do not keep
    far = {"drive.stage.stiffness": 0.05, "aging.beta": 0.5}
    own, given = (one.forward.predict(far)[0] for one in (rough, problem))
    # steps that are given may miss 30 times what others do, 2e-4 of a threshold each
    # before a solve takes its own
    np.testing.assert_allclose(given, own, rtol=5e-3, atol=0)


@pytest.mark.verification
def test_warm_records_have_intervals():
    """Chi-square of a record of contacts that heat breaks rises along a profile as the
    covariance of derivatives says, to 10 %; so these must hold to half of that over a
    quarter of a standard deviation. Those of solves that choose their own steps do
    not."""
    file = load(ROOT / "runs" / "fit-basalt-step.toml")
    problem = prepare(file, None, False).problem
    smooth = settle_steps(problem, problem.start)
    smooth = replace(smooth, value=smooth.given(smooth.start))
    stage = [one.key for one in problem.parameters].index("drive.stage.stiffness")
    sd = math.sqrt(covariance(smooth.jacobian(smooth.start))[stage, stage])
    assert change(smooth, stage, 0.25 * sd) < 0.05
    assert change(problem, stage, 0.25 * sd) > 0.2
    shifted = smooth.start + 0.5 * sd * (np.arange(smooth.start.size) == stage)
    assert minimise(smooth, shifted, stage).chi2 == pytest.approx(0.25, rel=0.1, abs=0)


def test_check_reads_and_draws(folder):
    """4001 rows, more than a solve takes steps: block means, and no fit."""
    times = np.linspace(0.0, 5.0, 4001)
    noise = 0.01 * np.random.default_rng(1).standard_normal(times.size)
    write(folder, 1.0 - 0.2 * np.exp(-times) + noise, 7.0 + times)
    command = "fit", str(folder / "run.toml"), "--out", str(folder / "out"), "--check"
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code == 2
    assert (
        "fit.record.start is the time of the clock at which it begins" in refused.output
    )
    text = RUN.replace('force = "force"', 'force = "force", start = "first row"')
    (folder / "run.toml").write_text(text)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    for said in ("4001 rows", "t = 7 is 0", "no feature is smeared"):
        assert said in done.output
    assert [path.name for path in (folder / "out").iterdir()] == ["data.png"]
    prepared = prepare(load(folder / "run.toml"), None, False)
    assert prepared.table.time.size < 2000
    fixed = prepare(load(folder / "run.toml", {"fit.offset": 0.3}), None, False)
    drawn, shifted = (data_figure(one, "").axes[0].lines for one in (prepared, fixed))
    for line, other in zip(drawn, shifted, strict=True):  # rows, and their means
        assert np.array_equal(line.get_ydata(), other.get_ydata())


def test_a_drift_is_told_from_the_middle_of_a_record(folder):
    """(t - <t>) adds nothing to the mean, so that it does not move the offset."""
    file = load(folder / "run.toml")
    t = np.array([1.0, 2.0, 6.0])
    assert shapes(file, section_of(file), t)["fit.drift"].tolist() == [-2.0, -1.0, 3.0]


def test_hardening_goes_with_slip(folder):
    """Its own prediction with a trend of .2 per displacement added: with this kind free
    chi-square has 58 degrees of freedom (p > 1e-4 on both sides), and trend and beta are
    the true ones to 4 standard deviations; a trend per time, as fit.drift is, leaves
    what no noise would."""
    file = load(folder / "run.toml")
    exact = transient(file.ensemble, file.drive, 61)
    X = np.interp(exact.t, [0.0, 3.0, 5.0], [0.0, 0.3, 2.3])
    noise = 0.003 * np.random.default_rng(5).standard_normal(exact.t.size)
    write(folder, exact.force + 0.2 * X + noise, exact.t)
    chi2, off = {}, {}
    for per in ("displacement", "time"):
        content = deepcopy(file.given)
        content["fit"]["trend"] = {"per": per}
        content["fit"]["free"] = {
            "aging.beta": {"bounds": [1e-3, 0.5]},
            "fit.trend": {"bounds": [-0.5, 0.5]},
        }
        problem = prepare(check(content, folder), None, False).problem
        problem = settle_steps(problem, problem.start)
        forward = problem.forward.corrected(problem.changes(problem.start))
        problem = replace(problem, forward=forward)
        best = minimise(problem, problem.start)
        chi2[per] = best.chi2
        sd = np.sqrt(np.diag(covariance(problem.jacobian(best.u))))
        truth = {"aging.beta": math.log(0.05), "fit.trend": 0.2}
        off[per] = np.array([truth.get(key, math.nan) for key in problem.keys])
        off[per] = np.abs(best.u - off[per]) / sd
    assert 25 < chi2["displacement"] < 102
    assert np.nanmax(off["displacement"]) < 4.0
    assert chi2["time"] > 200
