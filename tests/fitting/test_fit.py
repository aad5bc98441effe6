"""`eqsim fit` on tables of steady observables: what it says, what it refuses, and that
its intervals are right."""

import itertools
import json
import math
import os
import signal
import subprocess
import sys
import time
import tomllib
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from cases import chosen
from command_line import call
from scipy import stats

import eqsim
from eqsim import Ensemble, Gamma, InputError, Thermal
from eqsim.fitting import estimate, profiles, report, symmetry
from eqsim.fitting.data import read_table
from eqsim.fitting.estimate import (
    Minimum,
    covariance,
    ladder,
    minimise,
    search,
    starts,
)
from eqsim.fitting.fit import compared, fit, goodness, prepare, rival_of
from eqsim.fitting.model import Problem
from eqsim.fitting.pictures import band, data_figure
from eqsim.fitting.section import NormalPrior, Parameter, parameters_of, section_of
from eqsim.io.parameters import parameters
from eqsim.io.runfile import at, check, load
from eqsim.master.steady import curve

VELOCITIES = np.geomspace(1e-3, 10.0, 12)
RUN = """
title = "small"
disorder = "annealed"
[contacts]
stiffness_law = "uniform"
[thermal]
kT = 0.2
[thresholds]
n = 1.0
[fit]
data = "data.csv"
scale = { start = 1.0, bounds = [0.01, 100.0] }
noise = { relative = 0.05 }
[fit.free]
"thermal.kT" = { bounds = [1e-3, 20.0] }
"""
TRUTH = {"kT": 0.1, "scale": 3.0}


def measured(seed, relative=0.05, velocities=VELOCITIES, heat=1.0, **laws):
    """Friction with errors: a table's lines."""
    laws = {"disorder": "annealed", "stiffness_law": "uniform", **laws}
    known = curve(
        Ensemble(Gamma(1.0), Thermal(TRUTH["kT"] * heat), **laws), velocities
    ).friction
    noise = np.random.default_rng(seed).standard_normal(velocities.size)
    return zip(
        velocities, TRUTH["scale"] * known * (1.0 + relative * noise), strict=True
    )


@pytest.fixture
def folder(tmp_path):
    lines = [f"{v:.10g},{F:.10g}" for v, F in measured(1)]
    (tmp_path / "data.csv").write_text(
        "drive.velocity,friction\n" + "\n".join(lines) + "\n"
    )
    (tmp_path / "run.toml").write_text(RUN)
    return tmp_path


def test_command(folder):
    """Files, a table, a run file of the best fit that the reference accepts; and the
    same from two processes."""
    out = folder / "out"
    command = "fit", folder / "run.toml", "--starts", "2", "--workers"
    result = call(*command, "1", "--out", out)
    assert result.exit_code == 0, result.output
    assert "thermal.kT" in result.output
    assert "determined" in result.output
    assert {path.name for path in out.iterdir()} == {
        "fit.json", "fitted.parquet", "profiles.parquet", "run.toml", "fit.png", "profiles.png", "identifiability.png",
    }  # fmt: skip
    found = json.loads((out / "fit.json").read_text())
    kT = found["parameters"]["thermal.kT"]
    assert kT["status"] == "determined"
    assert (
        kT["interval_95"][0]
        < kT["interval_68"][0]
        < kT["estimate"]
        < kT["interval_68"][1]
        < kT["interval_95"][1]
    )
    assert found["dof"] == 10
    assert len(found["starts"]) == 2
    assert len(found["eigenvalues"]) == 2
    assert (
        found["derived"]["F0 = N k x_*"] == found["parameters"]["fit.scale"]["estimate"]
    )
    assert len(found["data_sha256"]) == 64
    table = pq.read_table(out / "fitted.parquet").to_pandas()
    assert np.sum(table["residual"] ** 2) == pytest.approx(
        found["chi2"], rel=1e-9, abs=0
    )
    rises = pq.read_table(out / "profiles.parquet").to_pandas()
    assert set(rises["key"]) == {"thermal.kT", "fit.scale"}
    done = call("reference", out / "run.toml", "--json")
    assert done.exit_code == 0, done.output
    best = load(out / "run.toml")
    assert best["thermal.kT"] == kT["estimate"]
    assert json.loads(done.output)["friction"] > 0
    twice = call(*command, "2", "--out", folder / "twice", "--json")
    assert twice.exit_code == 0, twice.output
    assert json.loads(twice.output) == found
    assert (folder / "twice" / "profiles.parquet").read_bytes() == (
        out / "profiles.parquet"
    ).read_bytes()


def test_a_stopped_fit_goes_on(folder, monkeypatch):
    """What was finished is not computed again, the result is that of a fit which was
    not stopped, and nothing of it stays in the folder; another fit does not take it for
    its own."""
    file, out, calls = load(folder / "run.toml"), folder / "out", []

    def counted(function, most):
        def call(*args):
            calls.append(function.__name__)
            if len(calls) > most:
                raise KeyboardInterrupt
            return function(*args)

        return call

    whole = fit(file, folder, starts=2)
    for module, name in ((estimate, "search"), (profiles, "side")):
        monkeypatch.setattr(module, name, counted(getattr(module, name), 4))
    with pytest.raises(KeyboardInterrupt):
        fit(file, folder, starts=2, keep=out)
    assert calls == ["search"] * 2 + ["side"] * 3
    monkeypatch.undo()
    calls.clear()
    monkeypatch.setattr(profiles, "side", counted(profiles.side, 99))
    other = load(folder / "run.toml", {"output.seed": 2})
    fit(other, folder, starts=2, keep=out)
    assert len(calls) == 4
    calls.clear()
    longer = folder / "data.csv"
    text = longer.read_text()
    longer.write_text(text.replace("\n0.001,", "\n0.00100001,"))
    fit(file, folder, starts=2, keep=out)
    assert len(calls) == 4  # other data
    longer.write_text(text)
    calls.clear()
    again = fit(file, folder, starts=2, keep=out)
    assert len(calls) == 2
    assert again.intervals == whole.intervals
    assert again.minima[0].chi2 == whole.minima[0].chi2
    assert not list(out.iterdir())


TWO = """
disorder = "annealed"
contacts.stiffness_law = "uniform"
thermal.kT = 0.1
[[population]]
share = 0.7
thermal.kT = 0.05
[[population]]
share = 0.3
stiffness = 3.0
thermal.kT = 0.5
[fit]
scale = { start = 1.0, bounds = [0.01, 100.0] }
[fit.free]
"population.0.thermal.kT" = { bounds = [1e-3, 20.0] }
"population.1.thermal.kT" = { bounds = [1e-3, 20.0] }
"population.1.share" = { bounds = [0.01, 10.0] }
"""


@pytest.mark.verification
def test_two_populations_are_fitted(tmp_path):
    """Friction without noise of other shares and temperatures is found to 3e-3, where
    the search ends; the best fit's run file has it, too."""
    truth = {"population.0.thermal.kT": 0.03, "population.1.thermal.kT": 1.0}
    truth |= {"population.1.share": 0.2, "contacts.count": 10**12}
    exact = check(tomllib.loads(TWO), tmp_path)
    velocities = VELOCITIES[::2]
    friction = curve(at(exact, truth).ensemble, velocities).friction
    lines = [
        f"{v},{3.0 * F},{1e-3 * F}" for v, F in zip(velocities, friction, strict=True)
    ]
    lines.insert(0, "drive.velocity,friction,friction_stderr")
    (tmp_path / "data.csv").write_text("\n".join(lines))
    found = fit(exact, data=tmp_path / "data.csv", starts=1, allow_degenerate=True)
    for key in list(truth)[:3]:
        assert found.values[key] == pytest.approx(truth[key], rel=3e-3, abs=0)
    assert found.goodness.chi2 < 1e-3
    report.write(found, tmp_path / "out", final=False)
    best = load(tmp_path / "out" / "run.toml")
    assert best["population.1.share"] == found.values["population.1.share"]


@pytest.mark.verification
def test_estimates_come_before_profiles(folder, monkeypatch):
    """A fit that is stopped in its second key has written and printed its estimates, and
    the interval of the first; the same command then ends with the files of a fit that was
    not stopped."""
    command = "fit", folder / "run.toml", "--starts", "1", "--workers", "1", "--out"
    assert call(*command, folder / "whole").exit_code == 0
    followed, calls, out = profiles.side, [], folder / "out"

    def stopped(*given):
        calls.append(given)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return followed(*given)

    monkeypatch.setattr(profiles, "side", stopped)
    stop = call(*command, out)
    assert stop.exit_code == 130
    names = {path.name for path in out.iterdir() if not path.name.startswith(".")}
    assert names == {"fit.json", "fitted.parquet", "run.toml"}
    first = json.loads((out / "fit.json").read_text())["parameters"]
    monkeypatch.undo()
    assert call(*command, out).exit_code == 0
    for path in (folder / "whole").iterdir():
        assert (out / path.name).read_bytes() == path.read_bytes(), path.name
    last = json.loads((out / "fit.json").read_text())["parameters"]
    assert first["thermal.kT"] == last["thermal.kT"]
    assert first["fit.scale"]["estimate"] == last["fit.scale"]["estimate"]
    assert first["fit.scale"]["status"] == "profile to come"
    assert "interval_95" not in first["fit.scale"]
    for key in first:
        assert f"{key} = {last[key]['estimate']:.4g} (log: sd" in stop.output


@pytest.mark.verification
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_killed_command_goes_on(folder, number):
    """With two processes, at once when the estimates are there."""
    words = [sys.executable, "-m", "eqsim", "fit", "run.toml", "--starts", "1"]
    words += ["--workers", "2", "--out"]
    subprocess.run([*words, "whole"], cwd=folder, check=True)
    process = subprocess.Popen([*words, "out"], cwd=folder, start_new_session=True)
    while not (folder / "out" / "fit.json").exists():
        time.sleep(0.001)
    os.killpg(process.pid, number)
    assert process.wait(60) in (128 + number, -number)
    subprocess.run([*words, "out"], cwd=folder, check=True)
    for path in (folder / "whole").iterdir():
        assert (folder / "out" / path.name).read_bytes() == path.read_bytes()
    assert not list((folder / "out").glob(".unfinished-*"))


def test_a_stopped_fit_is_forgotten_after_a_month(folder):
    """Its results are removed by the next fit to the same folder; those of a fit that
    was stopped four weeks ago are not."""
    now = time.time()
    for name, days in (("old", 31), ("new", 28)):
        (folder / f".unfinished-{name}").mkdir()
        os.utime(folder / f".unfinished-{name}", (now - 86400 * days,) * 2)
    fit(load(folder / "run.toml"), folder, starts=1, keep=folder)
    assert [path.name for path in folder.glob(".unf*")] == [".unfinished-new"]


def test_intervals_are_those_of_the_likelihood(folder):
    """At the ends of an interval chi-square, with the scale at its best, is above its
    least value by the levels of its law, found on a grid of kT (to .02 by which the
    ends are sought)."""
    found = fit(load(folder / "run.toml"), folder, starts=1)
    kT = found.intervals[0]

    def chi2(value):
        f = curve(
            Ensemble(
                Gamma(1.0), Thermal(value), disorder="annealed", stiffness_law="uniform"
            ),
            VELOCITIES,
        )
        a, b = found.table.value / found.table.sigma, f.friction / found.table.sigma
        return np.sum((a - b * (a @ b) / (b @ b)) ** 2)

    for name, level in (
        ("68", stats.chi2.ppf(0.68, 1)),
        ("95", stats.chi2.ppf(0.95, 1)),
    ):
        for end in kT.intervals[name]:
            assert chi2(end) - found.goodness.chi2 == pytest.approx(level, abs=0.03)
    grid = np.exp(np.linspace(-0.05, 0.05, 21)) * kT.estimate
    assert abs(np.argmin([chi2(value) for value in grid]) - 10) <= 1


def test_errors_of_measurements(folder):
    """A column of standard errors counts, and where a cell of it is empty the noise,
    whose parts add in quadrature."""
    (folder / "data.csv").write_text(
        "drive.velocity,friction,friction_stderr\n1,2,0.7\n2,4,\n"
    )
    file = load(folder / "run.toml", {"fit.noise": {"relative": 0.05, "absolute": 0.1}})
    table = read_table(folder / "data.csv", file, section_of(file))
    assert table.sigma == pytest.approx([0.7, math.hypot(0.2, 0.1)], rel=1e-12, abs=0)


def test_particles(folder):
    """The committed data of simulated contacts, 24 points to about 1 %: every key
    within 4 standard deviations of what made them, and a fit that is not rejected."""
    path = Path(__file__).parents[2] / "runs" / "fit-synthetic.toml"
    problem = prepare(load(path), None, False).problem
    found = minimise(problem, problem.start)
    truth = np.array([math.log(0.1), 0.0, math.log(2.0), math.log(3.0)])
    sd = np.sqrt(np.diag(covariance(problem.jacobian(found.u))))
    assert np.all(np.abs(found.u - truth) < 4.0 * sd)
    assert np.all(sd < 0.1)
    assert goodness(problem, found.u).p > 1e-3


def test_levels():
    for name, level in profiles.LEVELS.items():
        assert level == pytest.approx(
            stats.chi2.ppf(int(name) / 100, 1), rel=1e-4, abs=0
        )


def test_open_sides(folder):
    """Far above v_* nothing depends on kT: the profile is flat and reaches both bounds.
    A second temperature is proposed, but not of a record, nor of rows that have one."""
    lines = [f"{v},{F}" for v, F in measured(1, velocities=np.geomspace(1e3, 1e5, 8))]
    (folder / "data.csv").write_text("drive.velocity,friction\n" + "\n".join(lines))
    refused = call("fit", folder / "run.toml", "--out", folder / "out")
    assert refused.exit_code == 2
    assert "do not separate thermal.kT" in refused.output
    found = fit(load(folder / "run.toml"), folder, starts=2, allow_degenerate=True)
    assert found.warnings
    kT, scale = found.intervals
    assert (kT.intervals["68"], kT.intervals["95"], kT.status) == (
        (None, None),
        (None, None),
        "degenerate",
    )
    assert scale.status == "determined"
    assert report.summary(found)["eigenvalues"][-1]["ratio"] < 1e-7

    def proposed(table):
        lines = report.remarks(replace(found, table=table))
        return any("data of one temperature" in line for line in lines)

    table = found.table
    rows = [
        row._replace(changes=(*row.changes, ("thermal.kT", kT)))
        for row, kT in zip(table.conditions, np.geomspace(0.1, 1.0, 8), strict=True)
    ]
    assert proposed(table)
    assert not proposed(table._replace(conditions=rows))
    assert not proposed(table._replace(time=np.arange(8.0)))


def test_sets_have_their_own_scale(folder):
    """Two sets that differ by a factor: two scales, and kT from both. What follows from a
    scale is said of each set."""
    lines = [f"{v},{F},a" for v, F in measured(1)] + [
        f"{v},{10 * F},b" for v, F in measured(2)
    ]
    (folder / "data.csv").write_text("drive.velocity,friction,set\n" + "\n".join(lines))
    found = fit(load(folder / "run.toml"), folder, starts=1)
    values = found.values
    assert values["fit.scale.b"] / values["fit.scale.a"] == pytest.approx(
        10.0, rel=0.2, abs=0
    )
    assert found.goodness.dof == 21
    derived = {key for key in found.derived if key.startswith("F0")}
    assert derived == {"F0 of set a = N k x_*", "F0 of set b = N k x_*"}
    assert found.derived["F0 of set b = N k x_*"] == values["fit.scale.b"]


DELTA = """
[thresholds]
law = "delta"
[delay]
time = 0.5
[drive]
velocity = 1.0
[fit]
data = "data.csv"
scale = { start = 1.0, bounds = [0.01, 100.0] }
[fit.free]
"thresholds.x_star" = { bounds = [0.1, 10.0] }
"""


def test_an_empty_velocity_is_that_of_the_run_file(folder):
    """In the picture, too, so that the command writes all its files."""
    lines = [
        "drive.velocity,friction,friction_stderr",
        "0.1,0.48,0.01",
        ",0.33,0.01",
        "2,0.25,0.01",
        "4,0.17,0.01",
    ]
    (folder / "data.csv").write_text("\n".join(lines))
    (folder / "run.toml").write_text(DELTA)
    done = call("fit", folder / "run.toml", "--out", folder / "out", "--starts", "1")
    assert done.exit_code == 0, done.output
    assert (folder / "out" / "fit.png").exists()
    (panel,) = data_figure(prepare(load(folder / "run.toml"), None, False), "").axes
    assert list(panel.lines[0].get_xdata()) == [0.1, 1.0, 2.0, 4.0]


def test_sets_without_a_force_have_no_scale(folder):
    """Shares of pinned contacts tell no scale; and all rows name their set, or none."""
    lines = ["drive.velocity,friction,friction_stderr,pinned,pinned_stderr,set"]
    lines += [
        "0.1,0.466,0.01,,,a",
        "1,0.343,0.01,,,a",
        "2,0.26,0.01,,,a",
        "8,,,0.11,0.01,b",
    ]
    (folder / "data.csv").write_text("\n".join(lines))
    (folder / "run.toml").write_text(DELTA)
    problem = prepare(load(folder / "run.toml"), None, False).problem
    assert problem.keys == ["thresholds.x_star", "fit.scale"]
    assert problem.scale_of.tolist() == [1, 1, 1, -1]
    (folder / "data.csv").write_text("\n".join([*lines, "4,0.16,0.01,,,"]))
    refused = call("fit", folder / "run.toml", "--out", folder / "out")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "line 6: set: must have a name in all rows, or in none" in refused.stderr


def test_outliers(folder):
    """Two of 12 points off by a factor 4: Student's law keeps kT within 3 of its
    standard deviations, Gauss's not."""
    rows = [[v, F] for v, F in measured(1)]
    rows[2][1] *= 4.0
    rows[7][1] /= 4.0
    (folder / "data.csv").write_text(
        "drive.velocity,friction\n" + "\n".join(f"{v},{F}" for v, F in rows)
    )
    off = {}
    for loss in ("gaussian", "student"):
        found = fit(load(folder / "run.toml", {"fit.loss": loss}), folder, starts=2)
        off[loss] = (
            abs(math.log(found.values["thermal.kT"] / TRUTH["kT"]))
            / found.intervals[0].sd
        )
        assert found.rejected
    assert off["student"] < 3.0 < off["gaussian"]


def test_temperatures(folder):
    """kT of a row is thermal.kT T/reference_temperature, and empty cells are the run
    file's values."""
    lines = [
        f"{v},{300 * heat},{F}"
        for heat in (1.0, 1.3)
        for v, F in measured(round(10 * heat), heat=heat)
    ]
    lines[0] = lines[0].replace(f"{VELOCITIES[0]}", "", 1)
    (folder / "data.csv").write_text(
        "drive.velocity,temperature,friction\n" + "\n".join(lines)
    )
    changes = {
        "fit.temperature": "temperature",
        "fit.reference_temperature": 300.0,
        "drive.velocity": VELOCITIES[0],
    }
    found = fit(load(folder / "run.toml", changes), folder, starts=1)
    assert (
        abs(math.log(found.values["thermal.kT"] / TRUTH["kT"]))
        < 4.0 * found.intervals[0].sd
    )
    assert not found.rejected


def test_the_temperature_of_a_run_file_is_the_reference(tmp_path):
    """A row at the temperature of the run file has its kT, and another in proportion;
    where kT is free the reference is the section's."""
    rows = "drive.velocity,T,friction\n1,300,1\n1,450,1\n"
    (tmp_path / "data.csv").write_text(rows)
    section = {"data": "data.csv", "noise": {"relative": 0.05}, "temperature": "T"}

    def heats(**more):
        file = check({**AT_300_K, "fit": {**section, **more}}, tmp_path)
        return [row.heat for row in prepare(file, None, True).table.conditions]

    assert heats(free=bounds("thresholds.x_star")) == [1.0, 1.5]
    free = bounds("thermal.kT", low=1e-22, high=1e-20)
    assert heats(free=free, reference_temperature=150.0) == [2.0, 3.0]


def test_compared_at_the_same_temperatures(folder):
    """The same model in a run file whose kT is that at another temperature has the same
    chi-square, to rounding; keys that are columns of the data are not free, and
    temperatures of one run file alone are refused."""
    rows = ["drive.velocity,temperature,delay.time,friction"]
    rows += [f"{v},{T},0.1,{F}" for T in (260, 300) for v, F in measured(1)]
    (folder / "data.csv").write_text("\n".join(rows))
    content = tomllib.loads(RUN)
    content["fit"] |= {"temperature": "temperature", "reference_temperature": 260.0}
    content["fit"]["free"] = bounds("thermal.attempt_frequency")

    def other(kT=0.2, reference=260.0, **free):
        changes = deepcopy(content)
        changes["thermal"]["kT"] = kT
        changes["fit"]["reference_temperature"] = reference
        changes["fit"]["free"] |= free
        return check(changes, folder)

    prepared = prepare(other(), None, False)
    first = SimpleNamespace(**prepared._asdict())

    def rival(file):
        return rival_of(first.fit, first.table, file, 1)

    same = compared(first, *rival(other()))
    moved = compared(first, *rival(other(0.2 * 300.0 / 260.0, 300.0)))
    assert moved.chi2 == pytest.approx(same.chi2, rel=1e-6, abs=0)
    with pytest.raises(InputError, match=r"delay\.time: is a column of the data"):
        rival(other(**{"delay.time": {"bounds": [1e-3, 1.0]}}))
    with pytest.raises(InputError, match=r"fit\.temperature must be the same"):
        rival(load(folder / "run.toml"))
    with pytest.raises(
        InputError, match=r"temperature: has no effect with thermal\.kT"
    ):
        prepare(other(kT=0.0), None, True)
    content["drive"] = {"programme": [{"velocity": 1.0, "distance": 1.0}]}
    with pytest.raises(InputError, match=r"drive\.programme: not allowed"):
        rival(other())


def test_another_model_is_refused_before_the_fit(folder):
    """A model to compare with that cannot be fitted to these data is refused at once:
    nothing is written."""
    (folder / "other.toml").write_text(RUN.replace("[fit]", "[neither]"))
    for wrong in ("other.toml", "missing.toml"):
        result = call(
            "fit", folder / "run.toml", "--out", folder / "out", "--compare", folder / wrong
        )  # fmt: skip
        assert result.exit_code == 2
        assert not (folder / "out").exists()


@pytest.mark.verification
def test_compared_and_rejected(folder):
    """Data of quenched contacts, to .2 %: the annealed model is rejected, exit code 1;
    the right one is exact."""
    contacts = Ensemble(thermal=Thermal(0.1), stiffness_law="uniform")
    known = zip(VELOCITIES, curve(contacts, VELOCITIES).friction, strict=True)
    lines = [f"{v:.10g},{F:.10g},{0.002 * F:.10g}" for v, F in known]
    (folder / "data.csv").write_text(
        "drive.velocity,friction,friction_stderr\n" + "\n".join(lines)
    )
    (folder / "other.toml").write_text(RUN.replace("annealed", "quenched"))
    result = call(
        "fit", folder / "run.toml", "--out", folder / "out", "--compare", folder / "other.toml", "--starts", "1",
        "--workers", "1", "--json",
    )  # fmt: skip
    assert result.exit_code == 1, result.output
    found = json.loads(result.output)
    assert found["rejected"]
    assert found["compare"]["chi2"] < 1e-3
    assert found["compare"]["aicc"] < found["aicc"] - 100


def test_priors(folder):
    """A prior far tighter than the data is the answer, to a tenth of its width."""
    file = load(folder / "run.toml")
    content = deepcopy(file.given)
    content["fit"]["free"]["thermal.kT"]["prior"] = {"normal": [math.log(0.3), 1e-3]}
    found = fit(check(content), folder, starts=1)
    assert math.log(found.values["thermal.kT"]) == pytest.approx(
        math.log(0.3), abs=3e-3
    )
    assert found.goodness.dof == 11


def test_derived_contacts_per_area(folder):
    """scale = N k: contacts per area are scale/(k area); of a coefficient of friction,
    scale stress/k."""
    changes = {"contacts.stiffness": 2.0, "fit.area": 4.0}
    found = report.summary(fit(load(folder / "run.toml", changes), folder, starts=1))
    scale = found["parameters"]["fit.scale"]["estimate"]
    assert found["derived"]["contacts per area"] == pytest.approx(
        scale / 8.0, rel=1e-12, abs=0
    )
    assert found["derived"]["spacing of contacts"] == pytest.approx(
        math.sqrt(8.0 / scale), rel=1e-12, abs=0
    )


def test_the_interface_of_the_run_file_serves_a_fit(folder):
    """Its area or normal stress, unless the section has its own, or both are given: a
    force, or a coefficient?"""

    def seen(**changes):
        found = section_of(load(folder / "run.toml", changes))
        return found.area, found.normal_stress

    assert seen() == (None, None)
    assert seen(**{"interface.area": 4.0}) == (4.0, None)
    assert seen(
        **{"interface.contacts_per_area": 1.0, "interface.normal_stress": 2.0}
    ) == (None, 2.0)
    assert seen(**{"interface.area": 4.0, "fit.area": 3.0}) == (3.0, None)
    assert seen(**{"interface.area": 4.0, "interface.normal_stress": 2.0}) == (
        None,
        None,
    )
    units = {"units.length": "m", "units.force": "N", "thermal.temperature": 300.0}
    free = {"thermal.temperature": {"bounds": [1.0, 1e3]}}
    file = load(folder / "run.toml", {**units, "fit.free": free})
    with pytest.raises(
        InputError, match=r"fit\.free\.thermal\.temperature: must be thermal\.kT"
    ):
        parameters_of(file, section_of(file))


ALL = [
    "thermal.kT",
    "thermal.attempt_frequency",
    "contacts.stiffness",
    "thresholds.x_star",
]
DATA = "drive.velocity,friction\n0.01,0.2\n0.03,0.3\n0.1,0.5\n0.3,0.6\n1,0.7\n3,0.7\n10,0.75\n30,0.76\n"


def bounds(*keys, low=1e-3, high=1e3):
    return {key: {"bounds": [low, high]} for key in keys}


SYMMETRIES = {
    "length": ({}, bounds(*ALL), DATA, "thresholds.x_star ~ l"),
    "energy": ({}, bounds("thermal.kT", "contacts.stiffness"), DATA, "contacts.stiffness ~ l"),
    "energy, the variance known": (
        {"scale": 1.0}, bounds("thermal.kT", "contacts.stiffness"), DATA.replace("friction", "force_std"),
        "thermal.kT ~ l",
    ),
    "no temperature": ({"kT": 0.0}, bounds("thermal.attempt_frequency"), DATA, "has no effect at thermal.kT = 0"),
    "n at T = 0": ({"kT": 0.0}, {"thresholds.n": {"bounds": [0.0, 9.0], "transform": "log1p"}}, DATA, "thresholds.n"),
    "hot": ({"kT": 10.0}, bounds("thermal.kT", low=5.0, high=50.0), DATA, "below 0.3"),
    "cold": (
        {"kT": 1e-5}, bounds("thermal.kT", "thermal.attempt_frequency", low=1e-6, high=1e-4) |
        {"thermal.attempt_frequency": {"bounds": [0.1, 10.0]}}, DATA, "above 1000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SYMMETRIES)
def test_symmetries_are_refused_by_name(tmp_path, name):
    changes, free, data, said = SYMMETRIES[name]
    (tmp_path / "data.csv").write_text(data)
    scale = changes.get("scale", {"start": 1.0, "bounds": [0.01, 100.0]})
    file = check(
        {
            "disorder": "annealed",
            "thermal": {"kT": changes.get("kT", 0.1)},
            "thresholds": {"n": 1.0, "x_star": 1.0},
            "fit": {
                "data": "data.csv",
                "noise": {"relative": 0.05},
                "scale": scale,
                "free": free,
            },
        },
        tmp_path,
    )
    with pytest.raises(InputError) as error:
        prepare(file, None, False)
    assert said in str(error.value)
    assert "--allow-degenerate" in str(error.value)
    assert prepare(file, None, True).warnings


SYMMETRIC = {
    "none": {},
    "aging": {"aging": {"rule": "flow", "rate": 0.3, "x_star_final": 2.0}},
    "newborn": {"newborn": {"law": "exponential", "mean": 0.2}},
}


@chosen(
    ("disorder", "kind", "more"),
    [
        case
        for case in itertools.product(("annealed", "quenched"), (0, 1), SYMMETRIC)
        if case[::2] != ("quenched", "aging")
    ],
    [
        *(("annealed", 0, more) for more in SYMMETRIC),
        *itertools.product(["quenched"], (0, 1), ["none"]),
    ],
)
def test_symmetries_leave_every_prediction(disorder, kind, more):
    """Measured friction of contacts with a delay and drag to 1e-9; but not if one key
    stays behind (negative control)."""
    file = check(
        {
            "disorder": disorder,
            "thermal": {"kT": 0.1, "attempt_frequency": 2.0},
            "thresholds": {"n": 0.5, "x_star": 1.5},
            "contacts": {"stiffness": 3.0},
            "delay": {"time": 0.4},
            "viscosity": {"eta": 0.7},
            **SYMMETRIC[more],
        }
    )

    def scaled(factor, left_out=None):
        known = {
            key: value * factor ** symmetry.powers_of(file, key)[kind]
            for key, value in parameters(file).items()
            if value and isinstance(value, float) and key != left_out
        }
        friction = curve(at(file, known).ensemble, VELOCITIES[::3]).friction
        return factor ** symmetry.powers_of(file, "fit.scale")[kind] * friction

    right = scaled(1.0)
    np.testing.assert_allclose(scaled(1.7), right, rtol=1e-8)
    wrong = scaled(1.7, left_out="contacts.stiffness")
    assert np.abs(wrong / right - 1.0).max() > 0.01


@pytest.mark.parametrize(
    ("free", "data"),
    [
        (ALL[:3], DATA.replace("friction", "break_stretch")),  # a fixed x_* is a length
        (["thermal.kT", "thermal.attempt_frequency"], DATA),
        (["contacts.stiffness", "thermal.attempt_frequency"], DATA),  # kT is known
    ],
)
def test_what_is_no_symmetry_is_not_refused(tmp_path, free, data):
    (tmp_path / "data.csv").write_text(data)
    scale = {"start": 1.0, "bounds": [0.01, 100.0]} if "friction" in data else 1.0
    content = {
        "disorder": "annealed",
        "thermal": {"kT": 0.1},
        "fit": {"data": "data.csv", "noise": {"relative": 0.05}},
    }
    content["fit"] |= {"scale": scale, "free": bounds(*free)}
    prepared = prepare(check(content, tmp_path), None, free == ALL[:3])
    assert len(prepared.warnings) == (free == ALL[:3])


N_FREE = {"thresholds.n": {"bounds": [0.0, 9.0], "transform": "log1p"}}
DELAYED = {
    "delay": {"law": "gamma", "time": 0.05, "shape": 2.0},
    "thresholds": {"n": 1.0},
}
KT_ROWS = "thermal.kT,drive.velocity,friction\n0,1,0.5\n0.1,1,0.4\n0.1,2,0.5\n"
TOLD = {
    "the scale by a drag": (
        {**DELAYED, "viscosity": {"eta": 0.02}}, {**N_FREE, **bounds("delay.time")}, DATA, DELAYED,
    ),
    "the scale by a constant drag": (
        {**DELAYED, "viscosity": {"force": 0.02}}, {**N_FREE, **bounds("delay.time")}, DATA, DELAYED,
    ),
    "rates by temperatures of rows": (
        {}, bounds("thermal.attempt_frequency"), KT_ROWS, KT_ROWS.replace("0.1", "0"),
    ),
    "the delay law by a peak": (
        DELAYED, bounds("delay.shape"), DATA.replace("friction", "peak_ratio"), DATA,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TOLD)
def test_keys_that_something_else_tells_are_not_refused(tmp_path, name):
    """They are without it (negative control): with other contacts or other data."""
    content, free, data, without = TOLD[name]

    def reasons(content, data):
        (tmp_path / "data.csv").write_text(data)
        section = {"data": "data.csv", "noise": {"relative": 0.05}, "free": free}
        if "peak" not in data:
            section["scale"] = {"start": 1.0, "bounds": [0.01, 100.0]}
        return prepare(
            check({**content, "fit": section}, tmp_path), None, True
        ).warnings

    assert reasons(content, data) == []
    control = (content, without) if isinstance(without, str) else (without, data)
    assert len(reasons(*control)) == 1


def test_the_standard_deviation_of_the_force_of_each_stiffness(tmp_path):
    """A column of stiffnesses: predictions are those of run files with these, to
    rounding."""
    names = "drive.velocity,contacts.stiffness,force_std\n"
    (tmp_path / "data.csv").write_text(names + "0.1,1,0.5\n0.1,4,0.5\n")
    (tmp_path / "one.csv").write_text("drive.velocity,force_std\n0.1,0.5\n0.1,0.5\n")
    content = {"thermal": {"kT": 0.1}}
    content["fit"] = {"noise": {"relative": 0.05}, "free": bounds("thermal.kT")}
    content["fit"]["scale"] = {"start": 3.0, "bounds": [0.01, 100.0]}

    def predicted(data, stiffness):
        base = deepcopy(content) | {"contacts": {"stiffness": stiffness}}
        base["fit"]["data"] = data
        problem = prepare(check(base, tmp_path), None, False).problem
        return problem.given(problem.start)

    right = [predicted("one.csv", k)[0] for k in (1.0, 4.0)]
    np.testing.assert_allclose(predicted("data.csv", 2.0), right, rtol=1e-12)


def test_the_standard_deviation_of_the_force_of_populations(tmp_path):
    """A free scale N k, with k the mean over populations, one of which has a free
    stiffness: predictions are those of a fixed scale and N contacts, to rounding."""
    (tmp_path / "data.csv").write_text("drive.velocity,force_std\n0.1,0.5\n0.2,0.5\n")
    kinds = [{"share": 1.0, "stiffness": 2.0}, {"share": 2.0, "stiffness": 4.0}]
    content = {"thermal": {"kT": 0.1}, "contacts": {"count": 900}, "population": kinds}
    section = {"data": "data.csv", "noise": {"relative": 0.05}}
    section["free"] = bounds("population.0.stiffness")
    scale = 900 * 10.0 / 3.0

    def predicted(scale):
        file = check(content | {"fit": section | {"scale": scale}}, tmp_path)
        problem = prepare(file, None, True).problem
        return problem.given(problem.start)

    free = {"start": scale, "bounds": [1.0, 1e5]}
    np.testing.assert_allclose(predicted(free), predicted(scale), rtol=1e-12)


FREE = {"thermal.kT": {"bounds": [1e-3, 20.0]}}
AT_300_K = {
    "units": {"length": "m", "time": "s", "force": "N"},
    "contacts": {"stiffness": 1e-20},
    "thermal": {"temperature": 300.0},
}
BAD = {
    "no [fit]": ({}, None, DATA, "fit: the run file has no section"),
    "empty free": ({}, {"free": {}}, DATA, "fit.free: is empty"),
    "unknown key": ({}, {"free": bounds("thermal.KT")}, DATA, 'did you mean "thermal.kT"'),
    "text": ({}, {"free": bounds("disorder")}, DATA, "fit.free.disorder: its value is text"),
    "integer": ({}, {"free": bounds("contacts.count")}, DATA, "is an integer"),
    "outside": ({}, {"free": bounds("thermal.kT", low=1.0)}, DATA, "starts at 0.1"),
    "reversed": ({}, {"free": bounds("thermal.kT", low=2.0, high=1.0)}, DATA, "first smaller"),
    "equal": ({}, {"free": bounds("thermal.kT", low=1.0, high=1.0)}, DATA, "first smaller"),
    "not finite": ({}, {"free": bounds("thermal.kT", high=math.inf)}, DATA, "two finite numbers"),
    "log of 0": ({}, {"free": bounds("thermal.kT", low=0.0)}, DATA, "must be > 0"),
    "transform": ({}, {"free": {"thermal.kT": {"bounds": [1, 2], "transform": "exp"}}}, DATA, '"log1p"'),
    "prior": ({}, {"free": {"thermal.kT": {"bounds": [1e-3, 2], "prior": {"normal": [0, 0]}}}}, DATA, "[mean, sd]"),
    "sweep": ({"sweep": {"thermal.kT": [1.0]}}, {}, DATA, "sweep: not allowed with [fit]"),
    "column": ({}, {}, DATA.replace("drive.velocity", "thermal.kT"), "fit.free.thermal.kT: is a column"),
    "unknown column": ({}, {}, DATA.replace("friction", "frictoin"), 'did you mean "friction"'),
    "no value": ({}, {}, DATA + "50,\n", "line 10: no observable has a value"),
    "error without value": ({}, {}, "drive.velocity,friction,pinned,pinned_stderr\n1,2,,0.1\n",
                            "pinned_stderr has no pinned beside it"),
    "empty column": ({}, {}, DATA.replace("friction", "friction,pinned").replace("\n", ",\n"),
                     'column "pinned" is empty'),
    "zero error": ({}, {}, "drive.velocity,friction,friction_stderr\n1,2,0\n", "friction_stderr = 0: must be"),
    "NaN error": ({}, {}, "drive.velocity,friction,friction_stderr\n1,2,nan\n", "must be finite and > 0"),
    "infinite error": ({}, {}, "drive.velocity,friction,friction_stderr\n1,2,inf\n", "must be finite and > 0"),
    "no error": ({}, {"noise": {}}, DATA, "line 2: friction has no friction_stderr"),
    "negative": ({}, {}, DATA.replace("0.5", "-0.5"), "line 4: friction = -0.5: must be > 0"),
    "few": ({}, {}, "drive.velocity,friction\n1,2\n", "1 measurements for 1 free keys; at least 2"),
    "cold": ({}, {"temperature": "T", "reference_temperature": 260.0}, DATA.replace("drive.velocity", "T") + "0,1\n",
             "T = 0: must be > 0"),
    "no temperatures": ({}, {"temperature": "T", "reference_temperature": 260.0}, DATA, "no such column"),
    "another reference": (AT_300_K, {"free": bounds("thresholds.x_star"), "temperature": "T",
                                     "reference_temperature": 260.0}, DATA,
                          "fit.reference_temperature = 260: must be thermal.temperature, 300, or left out"),
    "two temperatures": (AT_300_K, {"free": bounds("thresholds.x_star"), "temperature": "T"},
                         "T,thermal.temperature,friction\n300,300,1\n300,310,1\n",
                         "fit.temperature: not allowed with a column thermal.temperature"),
    "no reference": ({}, {"temperature": "T"}, DATA, "fit.reference_temperature: is required"),
    "decimal commas": ({}, {}, DATA.replace("0.5", "0,5"), "line 4: more values than columns (a decimal comma?)"),
    "quoted decimal commas": ({}, {}, DATA.replace("0.5", '"0,5"'), "decimal commas must be points"),
    "velocity of 0": ({}, {}, DATA + "0,1\n", "line 10: drive.velocity = 0.0: must be a finite number > 0"),
    "digits in groups": ({}, {}, DATA.replace("0.5", "0.5_0"), "line 4: friction = '0.5_0': must be a number"),
    "short": ({}, {}, DATA + "50\n", "line 10: has 1 of 2 cells"),
    "no number": ({}, {}, DATA.replace("0.5", "much"), "line 4: friction = 'much': must be a number"),
    "no velocity": ({}, {}, DATA.replace("drive.velocity", "delay.time"), "drive.velocity: is required"),
    "empty": ({}, {}, "", "is empty"),
    "no file": ({}, {"data": "none.csv"}, DATA, "none.csv: cannot be read (No such file"),
    "no data": ({}, {"data": None}, DATA, "fit.data: is required"),
    "refused start": ({}, {"free": bounds("thermal.kT", "thermal.attempt_frequency", low=1e-30, high=1e99)}, DATA,
                      "the reference refuses a start at"),
    "scale of a table": ({"thresholds": {"law": "table", "file": "data.csv"}}, {"free": bounds("thresholds.scale")},
                         DATA, "fit.free.thresholds.scale: cannot be fitted; give thresholds in"),
    "n of a table": ({"thresholds": {"law": "table", "file": "data.csv"}},
                     {"free": {"thresholds.n": {"bounds": [0, 9], "transform": "log1p"}}}, DATA,
                     'thresholds.law = "table"'),
    "no aging": ({}, {"free": bounds("aging.rate")}, DATA, 'has no effect with aging.rule = "none"'),
    "cannot age": ({"aging": {"rule": "flow", "rate": 1.0, "x_star_final": 2.0}, "thresholds": {"law": "delta"}},
                   {"free": bounds("aging.rate")}, DATA, "aging.rule"),
    "unknown setting": ({}, {"nois": {"relative": 0.1}}, DATA, 'fit.nois: unknown key; did you mean "noise"'),
    "loss": ({}, {"loss": "cauchy"}, DATA, "fit.loss = 'cauchy'"),
    "scale": ({}, {"scale": {"start": 5.0, "bounds": [1.0, 2.0]}}, DATA, "fit.scale: starts at 5"),
    "programme": ({"drive": {"programme": [{"velocity": 1.0, "distance": 1.0}]}}, {}, DATA,
                  "drive.programme: not allowed"),
    "nuisance": ({}, {"free": bounds("fit.offset")}, DATA, "only of a record"),
    "idle offset": ({}, {"offset": 0.1}, DATA, "fit.offset: only of a record; there is no fit.record"),
    "idle trend": ({}, {"trend": {"per": "time"}}, DATA, "fit.trend: only of a record; there is no fit.record"),
    "two loads": ({}, {"area": 1.0, "normal_stress": 2.0}, DATA, "fit.normal_stress: not allowed with fit.area"),
    "time": ({"drive": {"velocity": 1.0, "time": 2.0}}, {}, DATA, "drive.time: not allowed with fit.data"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input(tmp_path, name):
    """One line that names what is wrong, exit code 2, and nothing is written."""
    changes, section, data, said = BAD[name]
    (tmp_path / "data.csv").write_text(data)
    content = {"disorder": "annealed", "thermal": {"kT": 0.1}, **changes}
    if section is not None:
        given = {
            "data": "data.csv",
            "noise": {"relative": 0.05},
            "scale": {"start": 1.0, "bounds": [0.01, 100.0]},
        }
        content["fit"] = {"free": FREE, **given, **section}
        content["fit"] = {
            key: value for key, value in content["fit"].items() if value is not None
        }
    (tmp_path / "run.toml").write_text("\n".join(report.to_toml(content)))
    result = call(
        "fit", tmp_path / "run.toml", "--out", tmp_path / "out", "--workers", "1"
    )
    assert result.exit_code == 2, result.output
    assert said in result.output
    assert len(result.output.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_free_keys_of_a_stage_are_keys():
    content = {
        "drive": {
            "programme": [{"velocity": 1.0, "distance": 1.0}],
            "stage": {"stiffness": 0.1},
        }
    }
    content["fit"] = {
        "free": bounds("drive.stage.stiffness"),
        "record": {"file": "x.csv"},
    }
    file = check(content)
    assert parameters_of(file, section_of(file))[0].start == math.log(0.1)


def test_other_commands_ignore_the_section(folder):
    assert (
        call("reference", folder / "run.toml", "--set", "drive.velocity=1.0").exit_code
        == 0
    )


def test_ladder():
    """Eigenvalues and directions of a matrix made of known ones; a null direction has
    no bound."""
    turned, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    rungs = ladder({name: name for name in "abc"}, np.diag([10.0, 1.0, 0.0]) @ turned)
    assert [rung.eigenvalue for rung in rungs] == pytest.approx(
        [100.0, 1.0, 0.0], abs=1e-12
    )
    assert [rung.sd for rung in rungs][:2] == pytest.approx(
        [0.1, 1.0], rel=1e-12, abs=0
    )
    assert rungs[2].sd > 1e10
    for rung, row in zip(rungs, turned, strict=True):
        found = np.array(list(rung.components.values()))
        assert abs(found @ row) == pytest.approx(1.0, rel=1e-12, abs=0)
    assert np.all(np.isinf(covariance(np.zeros((3, 2)))))


def test_names_of_directions_have_the_errors_that_stand_beside_them():
    """The product of powers as it is printed, of draws from the law that the covariance
    describes: its logarithm has the standard deviation quoted, to six of that of a
    sample, 1 in 5e8; and hardly more than the direction itself."""
    rng = np.random.default_rng(3)
    parameters = [
        Parameter("thermal.kT", "log", -3.0, 3.0, -1.0),
        Parameter("thresholds.n", "log1p", -0.5, 2.0, 0.7),
        Parameter("fit.trend", "linear", -0.02, 0.02, 0.01),
    ]
    problem = problem_of_formula(np.ones, parameters, np.ones(3), np.ones(3))
    turned, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    jacobian = np.diag([1e4, 1e2, 10.0]) @ turned / problem.unit_of_variables
    u = rng.multivariate_normal(problem.start, covariance(jacobian), 10_000)
    values = {
        one.key: np.asarray(one.value(x))
        for one, x in zip(parameters, u.T, strict=True)
    }
    for rung in ladder(problem.factors, problem.unitless(jacobian)):
        total = np.zeros(len(u))
        for factor in rung.name.split(" * "):
            name, _, power = (
                factor.rpartition("^") if "^" in factor else (factor, "", 1)
            )
            (key,) = [key for key in values if key in name]
            if name.startswith("exp("):
                log = values[key] / float(name[:-1].rpartition("/")[2])
            else:
                log = np.log(values[key] + (1.0 if name.startswith("(1 + ") else 0.0))
            total += float(power) * log
        assert total.std() == pytest.approx(
            rung.sd_of_name, rel=6.0 / math.sqrt(2.0 * u.shape[0]), abs=0
        )
        largest = max(map(abs, rung.components.values()))
        assert rung.sd_of_name <= 1.1 * rung.sd / largest


def test_covariance_of_keys_that_only_their_product_tells():
    """Two columns of J that differ by 1e-10 of a third one, or not at all: the third
    parameter keeps its standard deviation, and the others have those of exact
    arithmetic, or none; to 1e-4, what rounding leaves of the differences."""
    a, b, c = np.random.default_rng(2).standard_normal((3, 12))
    straight = np.sqrt(np.diag(np.linalg.inv(np.array([a, b, c]) @ np.c_[a, b, c])))
    split = np.sqrt(np.diag(covariance(np.c_[a, a + 1e-10 * b, c])))
    assert split[[1, 2]] == pytest.approx(
        [1e10 * straight[1], straight[2]], rel=1e-4, abs=0
    )
    same = np.sqrt(np.diag(covariance(np.c_[a, a, 1e-20 * c])))
    assert list(np.isinf(same)) == [True, True, False]
    alone = np.sqrt(np.linalg.inv(np.array([a, c]) @ np.c_[a, c])[1, 1])
    assert same[2] == pytest.approx(1e20 * alone, rel=1e-12, abs=0)


def test_public_name():
    assert eqsim.fit.__wrapped__ is fit


def test_starts_are_spread(folder):
    """Within the bounds, the run file's first, and named by the seed."""
    problem = prepare(load(folder / "run.toml"), None, False).problem
    every = np.array(starts(problem, 8, 1))
    np.testing.assert_array_equal(every[0], problem.start)
    assert np.all((every >= problem.low) & (every <= problem.high))
    strata = np.sort(
        (every[1:, 0] - problem.low[0]) / (problem.high[0] - problem.low[0]) * 7
    ).astype(int)
    np.testing.assert_array_equal(strata, np.arange(7))
    np.testing.assert_array_equal(every, starts(problem, 8, 1))


@pytest.mark.verification
def test_intervals_cover(folder):
    """40 sets of data: how often the profile is below its level at the truth, one
    constrained fit each. The number of misses of 95 % is binomial: more than 7 have a
    probability below 1e-3, and intervals at a tenth of the level miss more often than 7
    times but with a probability of 1e-6."""
    file = load(folder / "run.toml")
    problem = prepare(file, None, False).problem
    truth = np.log([TRUTH["kT"], TRUTH["scale"]])
    exact = problem.given(truth)
    misses = {1.0: 0, 0.1: 0}
    for seed in range(40):
        noise = 0.05 * exact * np.random.default_rng(seed).standard_normal(exact.size)
        sample = replace(problem, value=exact + noise, sigma=0.05 * exact)
        rise = minimise(sample, truth, 0).chi2 - minimise(sample, truth).chi2
        for part in misses:
            misses[part] += rise > part * profiles.LEVELS["95"]
    assert misses[1.0] <= 7 < misses[0.1]


def test_a_side_of_a_parabola():
    """A profile of a problem that is linear in the variable: its ends are known."""

    class Line:
        def predict(self, changes):
            return np.array([math.log(changes["thermal.kT"]), 0.0]), np.zeros(2)

    one = Parameter("thermal.kT", "log", -3.0, 30.0, 0.0)
    none = np.array([-1, -1])
    value, sigma = np.array([2.0, 0.0]), np.full(2, 1.5)
    problem = Problem(Line(), [one], value, sigma, none, np.ones(2), none > 0)
    best = minimise(problem, np.zeros(1))
    assert best.u[0] == pytest.approx(2.0, abs=1e-6)
    slope = np.array([[-1.0 / 1.5], [0.0]])
    right = profiles.side(problem, best, 0, 1, slope)
    for name, level in profiles.LEVELS.items():
        assert right.ends[name] == pytest.approx(2.0 + 1.5 * math.sqrt(level), abs=0.01)
    left = profiles.side(problem, best, 0, -1, slope)
    assert left.ends["68"] is not None
    assert left.ends["95"] == pytest.approx(
        2.0 - 1.5 * math.sqrt(profiles.LEVELS["95"]), abs=0.01
    )
    near = Minimum(np.array([2.0]), 0.0, True, 1)
    near = profiles.side(problem, near, 0, 1, slope / 100.0)
    assert near.ends["95"] == pytest.approx(right.ends["95"], abs=0.02)


KEYS = ("thermal.kT", "thermal.attempt_frequency")


class Formula:
    """Predictions by a function of the values of keys."""

    scaled = False

    def __init__(self, function):
        self.function = function

    def predict(self, changes):
        predicted = self.function(*changes.values())
        return predicted, np.zeros(predicted.size)


def problem_of_formula(function, parameters, value, sigma, **more):
    none = np.full(value.size, -1)
    errors = np.full(value.size, sigma)
    unit = np.ones(value.size)
    forward = Formula(function)
    return Problem(forward, parameters, value, errors, none, unit, none > 0, **more)


def ends(problem, best, index):
    """The 95 % interval, in the variable."""
    jacobian = problem.jacobian(best.u)
    sides = (profiles.side(problem, best, index, s, jacobian) for s in (-1, 1))
    return [side.ends["95"] for side in sides]


def test_profiles_move_other_parameters_off_their_bounds():
    """Three linear measurements, whose best fit has the second parameter at its bound:
    where the profile of the first passes 3.8415 the second one is inside. The end is
    that of a quadratic equation; with the second kept at its bound it would be .23
    nearer."""
    A = np.array([[1.0, 1.0], [0.5, 1.0], [1.0, 0.2]])
    free = [Parameter(KEYS[0], "log", -20.0, 20.0, 0.0)]
    free += [Parameter(KEYS[1], "log", 0.0, 20.0, 0.5)]
    value = A @ [0.0, -0.3]
    problem = problem_of_formula(lambda *x: A @ np.log(x), free, value, 0.5)
    best = minimise(problem, problem.start)
    assert best.u[1] == pytest.approx(0.0, abs=1e-6)
    inverse = np.linalg.inv(A.T @ A / 0.25)  # without the bound chi-square is 0 at best
    low = -math.sqrt((best.chi2 + profiles.LEVELS["95"]) * inverse[0, 0])
    assert ends(problem, best, 0)[0] == pytest.approx(low, abs=2e-3)


@pytest.mark.parametrize("loss", ["gaussian", "student"])
@pytest.mark.parametrize("transform", ["linear", "log1p"])
@pytest.mark.parametrize("unit", [4e-21, 1e-9, 1e9])
def test_intervals_in_any_unit(unit, transform, loss):
    """A key between bounds that are small or large numbers: intervals are those of the
    same key in a unit of its size, to 1e-3 of their width."""
    x = np.linspace(0.0, 1.0, 9)
    noise = np.random.default_rng(1).standard_normal(x.size)
    value = 1.5 * np.exp(-1.2 * x) + 0.02 * noise
    variable = {"linear": float, "log1p": math.log1p}[transform]

    def intervals(unit):
        bounds = (variable(y * unit) for y in (0.01, 10.0, 2.5))
        free = [Parameter(KEYS[0], transform, *bounds)]
        free += [Parameter(KEYS[1], "log", -3.0, 3.0, 0.0)]

        def predicted(y, height):
            return height * np.exp(-y / unit * x)

        problem = problem_of_formula(predicted, free, value, 0.02, loss=loss)
        best = minimise(problem, problem.start)
        first = free[0].value(np.array(ends(problem, best, 0))) / unit
        return np.array([first, ends(problem, best, 1)])

    found, right = intervals(unit), intervals(1.0)
    assert np.all(np.abs(found - right) < 1e-3 * np.diff(right))


def decay(noise, loss):
    """Decay and height of a curve, 1.2 and 1.5, measured with `noise`."""
    x = np.linspace(0.0, 1.0, 9)
    errors = noise * np.random.default_rng(1).standard_normal(x.size)
    free = [
        Parameter(key, "log", -3.0, 3.0, start)
        for key, start in zip(KEYS, (2.5, -2.0), strict=True)
    ]
    value = 1.5 * np.exp(-1.2 * x) + errors

    def predicted(rate, height):
        return height * np.exp(-rate * x)

    return problem_of_formula(predicted, free, value, noise, loss=loss)


@pytest.mark.parametrize("loss", ["gaussian", "student"])
@pytest.mark.parametrize("noise", [0.02, 1e-7])
def test_a_start_many_standard_errors_away(noise, loss):
    """However small errors are, the truth is found, within 4.5 standard deviations of
    each of two keys: 1 of 70 000 fair sets fails."""
    problem = decay(noise, loss)
    best = search(problem, problem.start)
    sd = np.sqrt(np.diag(covariance(problem.jacobian(best.u))))
    assert best.converged
    assert np.all(np.abs(best.u - np.log([1.2, 1.5])) < 4.5 * sd)


def test_residuals_of_either_sign():
    """Data below the fit are as unlikely as data above, however far they are; to
    rounding."""
    problem = decay(0.02, "student")
    u, off = problem.start, 1e5 * problem.sigma
    exact = problem.given(u)
    sides = [replace(problem, value=exact + sign * off) for sign in (1.0, -1.0)]
    above, below = (goodness(one, u).chi2 for one in sides)
    assert above == pytest.approx(below, rel=1e-12, abs=0)


@pytest.mark.parametrize("loss", ["gaussian", "student"])
def test_standard_deviations_are_those_of_the_loss(loss):
    """A level that 1000 quantiles of the loss's own law and a prior tell equally: half
    its 95 % interval is 1.96 standard deviations, to 1 %: ends are sought to .02 of
    chi-square, .3 %, and quantiles stop short of the tails. Those of a normal law are
    8 % less with Student's loss."""
    count = 1000
    law = stats.norm() if loss == "gaussian" else stats.t(4)
    value = law.ppf((np.arange(count) + 0.5) / count)
    sd = 1.0 / math.sqrt(count)
    free = [Parameter(KEYS[0], "linear", -1.0, 1.0, 0.1, NormalPrior(0.0, sd))]
    problem = problem_of_formula(
        lambda level: np.full(count, level), free, value, 1.0, loss=loss
    )
    best = minimise(problem, problem.start)
    sd = math.sqrt(covariance(problem.jacobian(best.u))[0, 0])
    half = math.sqrt(profiles.LEVELS["95"]) * sd
    low, high = ends(problem, best, 0)
    assert 0.5 * (high - low) == pytest.approx(half, rel=0.01, abs=0)


@pytest.mark.parametrize("loss", ["gaussian", "student"])
def test_chi_square_at_the_ends_of_intervals(loss):
    """Decay, height and slope of a curve with outliers: a search with the key held at
    the end of its interval finds that chi-square has risen by the level, to .1."""
    x = np.linspace(0.0, 1.0, 15)
    noise = 0.05 * np.random.default_rng(3).standard_t(3, x.size)
    names = (*KEYS, "thresholds.x_star")
    bounds = np.log([(0.1, 30.0, 3.0), (0.3, 6.0, 1.5), (0.1, 5.0, 0.7)])
    free = [Parameter(*row) for row in zip(names, ["log"] * 3, *bounds.T, strict=True)]

    def curved(decay, height, slope):
        return height * np.exp(-decay * x) + slope * x

    value = curved(3.0, 1.5, 0.7) + noise
    problem = problem_of_formula(curved, free, value, 0.05, loss=loss)
    best = minimise(problem, problem.start)
    jacobian = problem.jacobian(best.u)
    for index, sign in itertools.product(range(3), (-1, 1)):
        side = profiles.side(problem, best, index, sign, jacobian)
        for name, level in profiles.LEVELS.items():
            u = side.points[np.argmin(np.abs(side.rise - level))].copy()
            u[index] = side.ends[name]
            rise = minimise(problem, u, index).chi2 - best.chi2
            assert rise == pytest.approx(level, abs=0.1)


@pytest.mark.parametrize("unit", [1.0, 1e-9])
def test_bands_in_any_unit(unit):
    """Forces in units of their size or in nanonewtons, with an offset: the standard
    deviation of the curve is that of the covariance, to the error of one-sided
    derivatives, some steps of 1e-4."""
    x, offset = np.linspace(0.0, 1.0, 9), np.full(9, 0.1)
    free = [Parameter(KEYS[0], "log", -5.0, 5.0, 0.0)]
    free += [Parameter(KEYS[1], "log", -1.0, 1.0, 0.0, NormalPrior(0.0, 0.1))]
    free += [Parameter("fit.offset", "linear", -unit, unit, 0.0, linear=True)]
    problem = problem_of_formula(
        lambda y, z: unit * z * np.exp(-y * x),
        free,
        unit * (np.exp(-1.3 * x) + offset),
        0.02 * unit,
        nuisance={"fit.offset": np.ones(x.size)},
    )
    best = minimise(problem, problem.start)
    jacobian = problem.jacobian(best.u)
    _, sd = band(problem, SimpleNamespace(best=best, jacobian=jacobian))
    rows = problem.sigma[:, None] * jacobian[: x.size]
    right = np.sqrt(np.diag(rows @ covariance(jacobian) @ rows.T))
    np.testing.assert_allclose(sd, right, rtol=3e-4)
