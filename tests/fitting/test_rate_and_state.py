"""Rate-and-state friction: its curve against other solvers, and fits to records."""

import json
import math
import re
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares
from typer.testing import CliRunner

from analysis import coverage
from eqsim import (
    Elastic,
    InputError,
    Programme,
    RateAndState,
    Segment,
    fit_rate_and_state,
    record_of,
)
from eqsim.cli.app import app
from eqsim.fitting import rate_and_state
from eqsim.fitting.estimate import minimise
from eqsim.fitting.fit import goodness, measured
from eqsim.fitting.profiles import LEVELS
from eqsim.fitting.section import section_of
from eqsim.io.runfile import check

LONG, param = pytest.mark.verification, pytest.param
RUNS = Path(__file__).parents[2] / "runs"
# A step, a hold and a reload.
PROGRAMME = Programme(
    [
        Segment(1.0, time=10.0),
        Segment(10.0, time=20.0),
        Segment(time=50.0),
        Segment(1.0, time=50.0),
    ]
)
LAW = RateAndState(a=0.01, b=0.015, D_c=10.0, stiffness=0.01, mu_0=0.6)


def slopes(law, load):
    """mu' and theta' as they are printed, in mu and theta, and V from these."""

    def rates(t, state):
        mu, theta = state
        rest = mu - law.mu_0 - law.b * math.log(theta / law.D_c)
        log_v = rest / law.a
        if law.damping:
            log_v = brentq(
                lambda y: law.a * y + law.damping * math.expm1(y) - rest,
                *(-500.0, 50.0),
                xtol=1e-14,
            )
        v = math.exp(log_v)
        u = v * theta / law.D_c
        aging = law.law == "aging"
        return law.stiffness * (load - v), 1 - u if aging else -u * math.log(u)

    return rates


@pytest.mark.parametrize("law", ["slip", "aging"])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_curve_is_that_of_radau(law, damping):
    """Through a step, a hold and a reload, with an implicit solver in other variables
    of relative error 1e-10 a step: to 1e-9, where both were seen to agree to 4e-11."""
    law = replace(LAW, law=law, damping=damping)
    state, begin, times, exact = (0.6, 10.0), 0.0, [], []
    for segment in PROGRAMME.segments:
        found = solve_ivp(
            slopes(law, segment.velocity),
            (0.0, segment.duration),
            state,
            "Radau",
            np.linspace(0.0, segment.duration, 11),
            rtol=1e-10,  # of mu and theta, which are .6 and 10
            atol=1e-12,  # what counts is rtol
        )
        times += (begin + found.t[1:]).tolist()
        exact += found.y[0, 1:].tolist()
        state, begin = found.y[:, -1], begin + segment.duration
    np.testing.assert_allclose(law.friction(PROGRAMME, times), exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("law", ["slip", "aging"])
def test_curve_is_that_of_a_taylor_series(law):
    """Half a unit of time after a step, with mpmath's solver: to its tolerance, 1e-10."""
    law, step = replace(LAW, law=law), Programme([Segment(3.0, time=0.5)], velocity=1.0)

    def rates(t, state):
        log_v, log_theta = state
        v = mpmath.exp(log_v)
        change = mpmath.exp(-log_theta) - v
        if law.law == "slip":
            change = -v * (log_v + log_theta)
        growth = change / law.D_c
        return [(law.stiffness * (3 - v) - law.b * growth) / law.a, growth]

    log_v, log_theta = mpmath.odefun(rates, 0, [0, 0], tol=1e-12)(0.5)
    exact = law.mu_0 + law.a * float(log_v) + law.b * float(log_theta)
    start = replace(step, start="stationary")
    assert law.friction(start, [0.5])[0] == pytest.approx(exact, rel=0, abs=1e-10)


@pytest.mark.parametrize("law", ["slip", "aging"])
def test_sliding_is_stable_above_the_critical_stiffness(law):
    """A kick of 1e-6 decays at 1.2 of (b - a)/D_c and grows at .8 of it."""
    kick = Programme([Segment(1.0 + 1e-6, time=2000.0)], "stationary", 1.0)
    t = np.linspace(0.0, 2000.0, 2001)
    for factor, grows in ((0.8, True), (1.2, False)):
        k = factor * LAW.critical_stiffness
        mu = replace(LAW, law=law, stiffness=k).friction(kick, t) - 0.6
        assert (np.ptp(mu[1500:]) > np.ptp(mu[:500])) == grows


@pytest.mark.parametrize("law", ["slip", "aging"])
def test_damping_lowers_the_critical_stiffness(law):
    """It adds damping V to a: a kick of 1e-6 grows or decays at .8 and 1.2 of the
    border, V = 1."""
    kick = Programme([Segment(1.0 + 1e-6, time=3000.0)], "stationary", 1.0)
    t = np.linspace(0.0, 3000.0, 3001)
    damping = 0.4 * (LAW.b - LAW.a)
    border = (LAW.b - LAW.a - damping) / LAW.D_c
    for factor, grows in ((0.8, True), (1.2, False)):
        damped = replace(LAW, law=law, stiffness=factor * border, damping=damping)
        mu = damped.friction(kick, t) - 0.6
        assert (np.ptp(mu[2500:]) > np.ptp(mu[:500])) == grows


def test_segments_may_be_split():
    """A segment in 30 pieces, whose ends add up to rounding, is the whole one."""
    whole = Programme([Segment(3.0, time=3.0)], "stationary", 1.0)
    pieces = Programme([Segment(3.0, distance=0.3)] * 30, "stationary", 1.0)
    t = np.linspace(0.0, 3.0, 61)
    curves = [LAW.friction(programme, t) for programme in (whole, pieces)]
    np.testing.assert_allclose(*curves, rtol=0, atol=1e-9)  # as for Radau


def test_what_comes_later_does_not_count(monkeypatch):
    """Friction before stick-slip that would take too many steps, which is refused where
    it is asked for; and with fewer times it is the same, to what a cycle amplifies."""
    law = RateAndState(0.005, 0.015, 10.0, 0.0005, "aging", 0.6, damping=1e-3)
    step = Segment(1.2, time=2000.0)
    long, late = Programme([step, Segment(1.3, time=1e9)], velocity=1.0), 2000.0
    times = [*np.linspace(0.0, late, 1001), late + 1.0]
    fine = law.friction(long, times)
    np.testing.assert_allclose(
        law.friction(long, [0.0, 20.0, late, late + 1.0]),
        fine[[0, 10, -2, -1]],
        rtol=0,
        atol=1e-7,  # 6 000 steps, 1e-10 each of a logarithm times b: 1e-8; tenfold for phases
    )
    assert np.ptp(fine) > 0.02  # it does slip
    monkeypatch.setattr("eqsim.rate_and_state._MOST_STEPS", 1000)
    again = law.friction(long, times)
    np.testing.assert_allclose(again, fine, rtol=0, atol=1e-12)  # to rounding: the same
    with pytest.raises(
        InputError, match="times: stick-slip takes more than 1000 steps"
    ):
        law.friction(long, [late])


def written(folder, seed, law="slip", **changes):
    """The run file of a synthetic record: 81 points with errors of 3e-4, and a trend of
    1e-6 per length."""
    step = Programme([Segment(1.0, time=60.0), Segment(10.0, time=20.0)])
    t = np.concatenate((np.linspace(0.0, 59.0, 21), np.linspace(60.2, 80.0, 60)))
    mu = replace(LAW, law=law, **changes).friction(step, t) + 1e-6 * step.position(t)
    mu += 3e-4 * np.random.default_rng(seed).standard_normal(t.size)
    lines = [f"{x:.12g},{y:.12g}" for x, y in zip(t, mu, strict=True)]
    (folder / "step.csv").write_text("t,mu\n" + "\n".join(lines) + "\n")
    return record_of(folder / "step.csv", velocities=[1, 10], at=[60.0], noise=3e-4)


@pytest.mark.parametrize("law", ["slip", param("aging", marks=LONG)])
def test_truth_is_recovered(law, tmp_path):
    """Within 4 standard deviations: 1 of 2000 fair fits fails. Profiles of a - b and
    (b - a)/D_c are as wide as their covariance says. The same record with a third of its
    errors is rejected."""
    record = written(tmp_path, 1, law)
    found = fit_rate_and_state(record, law, starts=1)
    truth = {"a": 0.01, "b": 0.015, "D_c": 10.0, "k": 0.01, "trend": 1e-6}
    truth |= {"a-b": -0.005, "(b-a)/D_c": 5e-4}
    for one in found.intervals:
        if one in found.differences:  # nearly normal: twice 1.96 sd, to a quarter
            low, high = one.intervals["95"]
            assert high - low == pytest.approx(3.92 * one.sd, rel=0.25, abs=0)
        if one.key in truth:
            off = one.estimate - truth[one.key]
            off = math.log1p(off / truth[one.key]) if one.transform == "log" else off
            assert abs(off) < 4.0 * one.sd, one
            assert one.intervals["95"][0] < one.estimate < one.intervals["95"][1]
    assert not found.rejected
    problem = replace(found.problem, sigma=found.problem.sigma / 3.0)
    assert goodness(problem, found.best.u).p < 1e-6


def test_outliers(tmp_path):
    """fit.loss = "student" holds for both laws, too: with five points that are off by 30
    errors D_c is true to 4 standard deviations, 1 of 2000 fair fits fails, and not with
    the normal law. Chi-square with errors as given is that of the same scores."""
    record, off = written(tmp_path, 1), {}
    text = (tmp_path / "step.csv").read_text().splitlines()
    for row in (10, 30, 35, 40, 60):
        t, mu = map(float, text[row].split(","))
        text[row] = f"{t},{mu + 0.009}"
    (tmp_path / "step.csv").write_text("\n".join(text))
    for loss in ("gaussian", "student"):
        content = deepcopy(record.given)
        content["fit"]["loss"] = loss
        found = fit_rate_and_state(check(content, tmp_path), starts=1)
        (D_c,) = (one for one in found.intervals if one.key == "D_c")
        off[loss] = abs(math.log(D_c.estimate / 10.0)) / D_c.sd
        uncorrelated = replace(found.problem, correlation=None)
        least = goodness(uncorrelated, found.best.u).chi2
        assert found.chi2_as_given <= least
        assert found.chi2_as_given > 0.9 * least
    assert off["student"] < 4.0 < off["gaussian"]


def test_intervals_where_b_may_be_0(tmp_path):
    """A record that hardly shows b: the interval of (b - a)/D_c holds a value at which
    chi-square, least squares over b, D_c and mu_0 with a = b + 5e-4 D_c, is below its
    level. An interval that ends where b is 0 with the a of the best fit does not."""
    step = Programme([Segment(1.0, time=60.0), Segment(10.0, time=20.0)])
    t = np.concatenate((np.linspace(0.0, 59.0, 21), np.linspace(60.2, 80.0, 60)))
    exact = replace(LAW, b=0.001).friction(step, t)
    mu = exact + 1e-3 * np.random.default_rng(2).standard_normal(t.size)
    lines = [f"{x:.12g},{y:.12g}" for x, y in zip(t, mu, strict=True)]
    (tmp_path / "step.csv").write_text("t,mu\n" + "\n".join(lines) + "\n")
    record = record_of(tmp_path / "step.csv", velocities=[1, 10], at=[60.0], noise=1e-3)
    found = fit_rate_and_state(record, stiffness=0.01, trend="none", starts=1)

    def residuals(u):
        b, D_c = np.exp(u[:2])
        law = replace(LAW, a=b + 5e-4 * D_c, b=b, D_c=D_c, mu_0=u[2])
        return (law.friction(step, t) - mu) / 1e-3

    held = least_squares(residuals, [math.log(1e-4), math.log(18.0), 0.6])
    assert 2.0 * held.cost - found.best.chi2 < LEVELS["95"]
    low, high = found.differences[1].intervals["95"]
    assert low < -5e-4 < high < 0.0


@pytest.mark.parametrize("law", ["slip", "aging"])
def test_the_wrong_law_is_rejected(law):
    """The exact record of one law, with errors of 1e-5, that of the other."""
    exact, other = coverage.rate_and_state("slip"), coverage.rate_and_state("aging")
    if law == "aging":
        exact, other = other, exact
    both = [
        replace(one, value=exact.value, sigma=1e-5 * np.ones(121))
        for one in (exact, other)
    ]
    right, wrong = (minimise(one, one.start) for one in both)
    assert right.chi2 < 1e-6  # of rounding
    assert wrong.converged
    assert goodness(both[1], wrong.u).p < 1e-6


def first_step(folder):
    """The record of the first step of p655 alone."""
    text = (RUNS / "p655-velocity-steps.csv").read_text()
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    kept = rows[:1] + [row for row in rows[1:] if float(row.split(",")[0]) < 10.5]
    (folder / "p655.csv").write_text("\n".join(kept) + "\n")
    return record_of(folder / "p655.csv", velocities=[2.33, 22.85], at=[3.352])


def test_the_published_fit_of_p655(tmp_path):
    """a, b and D_c that the experimenters' own program found for the first step, without
    a trend, at K = 1.6e-3/um, lie in the 95 % intervals."""
    published = {"a": 0.006005, "b": 0.00423, "D_c": 17.7}
    how = {"stiffness": 1.6e-3, "trend": "none", "starts": 1}
    found = fit_rate_and_state(first_step(tmp_path), **how)
    ends = {one.key: one.intervals["95"] for one in found.intervals}
    for key, value in published.items():
        assert ends[key][0] < value < ends[key][1]


def test_command(tmp_path):
    """The least chi-square that an independent program found, 108.0 of 88; a folder with
    files; and JSON."""
    words = ["rsf", str(RUNS / "fit-basalt-step.toml"), "--trend", "time"]
    words += ["--law", "slip", "--starts", "1", "--workers", "1", "--json"]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)["slip law"]
    assert data["chi2_as_given"] == pytest.approx(108.0, rel=0, abs=0.05)
    assert data["dof"] == 88
    files = {path.suffix[1:]: path for path in tmp_path.iterdir()}
    assert files.keys() == {"json", "parquet", "png"}
    assert json.loads(files["json"].read_text())["slip law"] == data


# Least chi-squares of an independent program, to the digits that it printed.
TABLE = {
    ("basalt", "slip", "time"): 108.0,
    ("basalt", "aging", "time"): 116.7,
    ("velocity", "slip", "time"): 1049.6,
    ("velocity", "slip", "displacement"): 917.4,
    ("velocity", "aging", "time"): 1180.1,
    ("velocity", "aging", "displacement"): 928.2,
}


@pytest.mark.verification
@pytest.mark.parametrize("case", TABLE, ids=" ".join)
def test_chi_square_of_another_program(case):
    """To rounding, from two starts."""
    record, law, trend = case
    run_file = RUNS / f"fit-{record}-step.toml"
    found = fit_rate_and_state(run_file, law, trend=trend, starts=2)
    assert found.chi2_as_given == pytest.approx(TABLE[case], rel=0, abs=0.06)


@pytest.mark.verification
def test_both_laws_beside_contacts(tmp_path):
    """A record of contacts: their fit is accepted; one table, one picture, and JSON of
    all three models."""
    exact = coverage.record()
    noise = coverage.markov(np.random.default_rng(2), exact.value.size)
    mu = exact.value + exact.sigma * noise
    rows = [f"{t},{y}" for t, y in zip(exact.forward.time, mu, strict=True)]
    (tmp_path / "step.csv").write_text("\n".join(["t,force", *rows]))
    run_file = tmp_path / "run.toml"
    run_file.write_text(coverage.RECORD.replace('file = ""', 'file = "step.csv"'))
    words = ["fit", str(run_file), "--out", str(tmp_path / "out"), "--starts", "1"]
    words += ["--workers", "1", "--compare", "rate-and-state"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "contacts" in done.output
    data = json.loads((tmp_path / "out" / "rate-and-state.json").read_text())
    assert list(data) == ["contacts", "slip law", "aging law"]
    assert not data["contacts"]["rejected"]
    assert (tmp_path / "out" / "rate-and-state.png").exists()


@pytest.mark.parametrize("free", [(), ("trend",), ("trend", "drift")])
def test_trends_of_contacts_hold_for_both_laws(tmp_path, monkeypatch, free):
    """A record of the law and a trend of 1e-3 per displacement: where that is fixed for
    the contacts what is fitted is the law's friction, to the rounding of 12 digits;
    where it is free it is free here, too."""
    step = Programme([Segment(1.0, time=20.0), Segment(10.0, time=30.0)])
    t = np.linspace(0.0, 50.0, 11)
    mu, trend = LAW.friction(step, t), 1e-3 * step.position(t)
    lines = [f"{x:.12g},{y:.12g}" for x, y in zip(t, mu + trend, strict=True)]
    (tmp_path / "step.csv").write_text("t,mu\n" + "\n".join(lines) + "\n")
    how = {"velocities": [1, 10], "at": [20.0], "noise": 1e-4}
    content = deepcopy(record_of(tmp_path / "step.csv", **how).given)
    content["fit"]["trend"] = {"per": "displacement", "value": 1e-3}
    if free:
        names = [f"fit.{name}" for name in free]
        content["fit"]["free"] = {key: {"bounds": [-1.0, 1.0]} for key in names}
    monkeypatch.setattr(rate_and_state, "_solved", lambda prepared: prepared.problem)
    problem = rate_and_state.beside(check(content, tmp_path), "slip", None)
    fitted = mu + trend if free else mu
    np.testing.assert_allclose(problem.value, fitted, rtol=0, atol=1e-11)
    along = {"trend": step.position(t), "drift": t}
    assert set(problem.nuisance) == {"mu_0", *free}
    for name in free:
        np.testing.assert_array_equal(problem.nuisance[name], along[name])


CSV = ("rsf", str(RUNS / "basalt-velocity-step.csv"))
TOML = ("rsf", str(RUNS / "fit-basalt-step.toml"))
BAD = {
    (*CSV,): "--velocity: is required with a CSV file",
    (*CSV, "--velocity", "3,x"): "--velocity 3,x: must be numbers",
    (*CSV, "--velocity", "3,10"): "--at = []: must be 1",
    (*CSV, "--velocity", "3,10", "--at", "99"): "between 0 and 51.495",
    (*CSV, "--velocity", "3,-1", "--at", "9"): "programme.1: has velocity -1",
    (*CSV, "--velocity", "0,10", "--at", "9"): "--velocity = 0: the first must be > 0",
    (
        *(*CSV, "--velocity", "3", "--columns", "time_s, nu, mu_stderr"),
    ): 'needs a column "nu" in its first line; found time_s, mu, mu_stderr '
    "(--columns = ['time_s', 'nu', 'mu_stderr'])",
    (*CSV, "--velocity", "3", "--columns", "mu"): "--columns = ['mu']: must be",
    (*CSV, "--velocity", "3", "--seed", "1"): "--set, --seed: change a run file",
    (*TOML, "--velocity", "3"): "--velocity 3: only of a CSV file",
    (*TOML, "--law", "sliding"): "--law = 'sliding': must be",
    (*TOML, "--trend", "no"): "--trend = 'no': must be",
    (*TOML, "--stiffness", "-1"): "--stiffness = -1.0: must be",
    ("rsf", str(RUNS / "fit-synthetic.toml")): "fit.record: is required",
    (
        *("fit", str(RUNS / "fit-synthetic.toml"), "--out", "out"),
        *("--compare", "rate-and-state"),
    ): "--compare rate-and-state: must be of a record",
}


@pytest.mark.parametrize("words", BAD, ids=lambda words: " ".join(words[2:]))
def test_bad_input(words):
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2
    assert re.sub(r"\s+", " ", done.stderr).count(BAD[words]) == 1


def test_bad_laws():
    for changes in ({"a": 0.0}, {"b": -1.0}, {"D_c": math.nan}, {"law": "Ruina"}):
        with pytest.raises(InputError, match=next(iter(changes))):
            replace(LAW, **changes)
    with pytest.raises(InputError, match="begins at rest"):
        LAW.friction(Programme([Segment(time=1.0)]), [0.5])
    step = Segment(1.0, time=1.0)
    for programme, said in (
        (
            Programme([step, Segment(1.0, time=1.0, load=1.5)]),
            "programme.1: has a load",
        ),
        (Programme([Segment(1.0, time=1.0, load_rate=0.1)]), "programme.0: has a load"),
        (Programme([step], stall_force=0.1), "programme: has a motor"),
        (Programme([step], elastic=Elastic(2, 1.0, 1.0)), "programme: has blocks"),
    ):
        with pytest.raises(InputError, match=said):
            LAW.friction(programme, [0.5])
    with pytest.raises(InputError, match="end at 131, after the programme"):
        LAW.friction(PROGRAMME, [131.0])
    for times in ([0.5, math.nan], [2.0, 1.0], [-1.0, 1.0], 0.5, [[0.5, 1.0]]):
        with pytest.raises(InputError, match="times: must be a list that ascends"):
            LAW.friction(PROGRAMME, times)
    with pytest.raises(InputError, match="slips without end"):
        replace(LAW, stiffness=1e-5).friction(PROGRAMME, [100.0])


def test_bad_records(tmp_path):
    (tmp_path / "step.csv").write_text("t,mu\n0,0.6\n1,0.61\n2,0.6\n")
    for velocities, noise, said in (
        ([1.0], -1e-3, "noise = -0.001: must be a finite number >= 0"),
        ([1.0], math.nan, "noise = nan: must be a finite number >= 0"),
        ([], 1e-3, "velocities"),
    ):
        with pytest.raises(InputError, match=said):
            record_of(tmp_path / "step.csv", velocities=velocities, noise=noise)
    (tmp_path / "step.csv").write_text("t,mu,T\n0,0.6,3\n1,0.61,4\n2,0.6,5\n")
    how = {"velocities": [1.0], "noise": 4.0}
    with pytest.raises(InputError, match="columns: must be given with noise, as T may"):
        record_of(tmp_path / "step.csv", **how)
    for columns, sigma in ((["t", "mu"], 4.0), (["t", "mu", "T"], 5.0)):
        record = record_of(tmp_path / "step.csv", columns=columns, **how)
        assert measured(record, section_of(record), None).sigma[0] == sigma
    (tmp_path / "step.csv").write_text("0,0.6\n1,0.61\n2,0.6\n")
    with pytest.raises(InputError, match=r"step\.csv: needs names .*; found 0, 0\.6"):
        record_of(tmp_path / "step.csv", velocities=[1.0], noise=1e-3)


def covered(sets, law, shrunk=1.0):
    """How often intervals held the truth, by level and key, in synthetic records whose
    errors are said to be smaller than they are."""
    exact = coverage.rate_and_state(law)
    every = list(coverage.rises(exact, sets, 1))
    return {
        level: {
            key: sum(one[key] < shrunk**2 * rise for one in every) for key in every[0]
        }
        for level, rise in LEVELS.items()
    }


@pytest.mark.verification
@pytest.mark.parametrize("law", ["slip", "aging"])
def test_intervals_cover(law):
    """100 records: each of 6 keys' intervals of 68 and 95 % hold the truth as often as
    they should, within ranges that one of 12 fair counts leaves in 1 of 1000 cases;
    intervals half as wide do not."""
    tail = 0.5e-3 / 12.0
    for shrunk, right in ((1.0, True), (0.5, False)):
        for level, counts in covered(100, law, shrunk).items():
            share = float(level) / 100.0
            low, high = stats.binom.ppf([tail, 1.0 - tail], 100, share)
            assert all(low <= x <= high for x in counts.values()) is right, counts
