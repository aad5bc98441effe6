"""Draws from the posterior of a fit: against exact quantiles, and what the command
makes of them."""

import json
import math
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import stats
from test_fit import RUN
from typer.testing import CliRunner

from eqsim.cli.app import app
from eqsim.fitting import posterior
from eqsim.fitting.model import Problem
from eqsim.fitting.section import NormalPrior, Parameter

KEYS = ("thermal.kT", "thermal.attempt_frequency")
# the second variable ends half a sd above its mean
MEAN, SD, UPPER = (np.array([1.0, 3.0]), np.array([0.5, 2.0]), 4.0)


class Logarithms:
    """Predictions that are linear in the variables."""

    scaled = False

    def predict(self, changes):
        return np.log([changes[key] for key in KEYS]), np.zeros(2)


@pytest.fixture
def line():
    parameters = [
        Parameter(KEYS[0], "log", -20.0, 20.0, 0.0),
        Parameter(KEYS[1], "log", -20.0, UPPER, 0.0),
    ]
    none = np.array([-1, -1])
    return Problem(Logarithms(), parameters, MEAN, SD, none, np.ones(2), none > 0)


def drawn(problem, **more):
    return posterior.draw_posterior(
        problem, MEAN, np.diag(SD**2), np.random.default_rng(1), **more
    )


def scores(found):
    """Of the quantiles that intervals end at: exact share of the posterior below less
    what it should be, in standard errors of as many independent draws."""
    laws = (
        stats.norm(MEAN[0], SD[0]),
        stats.truncnorm(-np.inf, (UPPER - MEAN[1]) / SD[1], MEAN[1], SD[1]),
    )
    for key, law in zip(KEYS, laws, strict=True):
        known = found.intervals[key]
        ends = [(0.5, known["median"])]
        ends += [
            pair
            for name in ("68", "95")
            for pair in zip(posterior.SHARES[name], known[name], strict=True)
        ]
        for share, value in ends:
            error = math.sqrt(share * (1.0 - share) / found.effective)
            yield (law.cdf(math.log(value)) - share) / error


def test_quantiles(line):
    """Ten quantiles: a fair sampler has one beyond 4 in a thousand times at most; with
    errors 1.4 times too large in the likelihood the outermost ends miss by more (2.5 %
    become 0.3 %)."""
    found = drawn(line)
    assert found.converged
    assert max(map(abs, scores(found))) < 4.0
    assert max(map(abs, scores(drawn(replace(line, sigma=1.4 * SD))))) > 4.0


def test_shares_are_those_of_their_names():
    """Intervals leave as much of the posterior below as above, to rounding, 1e-16."""
    for name, (low, high) in posterior.SHARES.items():
        assert high - low == pytest.approx(int(name) / 100, rel=1e-12, abs=0)
        assert low + high == pytest.approx(1.0, rel=1e-12, abs=0)


def test_any_number_of_workers(line):
    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(
            drawn(line).points, drawn(line, executor=pool).points
        )


def test_a_short_chain_has_no_intervals(line, monkeypatch):
    monkeypatch.setattr(posterior, "_STEPS_AT_MOST", 100)
    found = drawn(line)
    assert not found.converged
    assert found.intervals[KEYS[0]] == {"median": None, "68": None, "95": None}
    assert "TOO SHORT" in repr(found)


def test_priors_and_bounds(line):
    """The density is that of the likelihood, times a prior where there is one, and zero
    beyond the bounds."""
    with_prior = replace(
        line,
        parameters=[
            line.parameters[0]._replace(prior=NormalPrior(0.0, 2.0)),
            line.parameters[1],
        ],
    )
    u = np.array([2.0, 1.0])
    likelihood = -0.5 * (((u - MEAN) / SD) ** 2).sum()
    assert line.density(u) == pytest.approx(likelihood, abs=1e-12)
    assert with_prior.density(u) == pytest.approx(likelihood - 0.5, abs=1e-12)
    assert line.density(np.array([2.0, UPPER + 1e-9])) == -math.inf


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "data.csv").write_text(
        "drive.velocity,friction\n0.003,0.06\n0.03,0.3\n0.3,0.6\n3,0.73\n10,0.74\n"
    )
    (tmp_path / "run.toml").write_text(RUN)
    return tmp_path


def call(folder, *more):
    return CliRunner().invoke(
        app,
        ["fit", f"{folder}/run.toml", "--out", f"{folder}/out", "--starts", "1", *more],
    )


@pytest.mark.verification
def test_command(folder, monkeypatch):
    monkeypatch.setattr(posterior, "_ENOUGH_TIMES", 3.0)
    done = call(folder, "--posterior", "--workers", "1", "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.output)["posterior"]
    assert said == json.loads((folder / "out/fit.json").read_text())["posterior"]
    assert said["converged"]
    low, high = said["parameters"]["thermal.kT"]["interval_95"]
    assert low < said["parameters"]["thermal.kT"]["median"] < high
    table = pq.read_table(folder / "out/posterior.parquet").to_pandas()
    assert list(table) == ["thermal.kT", "fit.scale", "log_density"]
    assert (folder / "out/posterior.png").stat().st_size > 10_000
    assert call(folder, "--workers", "1").exit_code == 0
    assert not list((folder / "out").glob("posterior.*"))  # of another fit


def test_without_the_package(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "emcee", None)
    done = call(folder, "--posterior")
    assert done.exit_code == 2
    assert 'pip install "eqsim[posterior]"' in done.output
    assert not (folder / "out").exists()
