"""The validation program itself: it passes for the right engine and fails when one thing is wrong."""

import dataclasses
import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from eqsim import Aging, Delay, Ensemble, Gamma, InputError, Thermal, steady
from eqsim.cli import app
from eqsim.validation import KINDS, SUITES, Score, _averages, _fluctuations, _hazard, sample, validate, verdict


def changed(**changes):
    return lambda ensemble: dataclasses.replace(ensemble, **changes)


def aged(**changes):
    """Another law of aging for those that age; D of annealed contacts that age at once stays infinite."""

    def change(ensemble):
        aging = dataclasses.replace(ensemble.aging, **changes)
        return dataclasses.replace(ensemble, aging=aging) if ensemble.aging.active else ensemble

    return change


@pytest.mark.parametrize(
    ("wrong", "kinds"),
    [
        (changed(disorder="quenched"), {"friction", "break_stretch", "transient", "hazard", "hazard law"}),
        (aged(rule="flow"), {"friction", "break_stretch"}),
        (aged(rule="none"), {"friction", "break_stretch", "hazard law"}),
    ],
    ids=[
        "quenched instead of annealed",
        "flow instead of langevin",
        "x_*f ignored",
    ],
)
def test_negative_controls(wrong, kinds):
    """One thing wrong in the engine alone: the suite fails, where it should; more under `-m verification`."""
    result = validate("quick", threads=2, wrong=wrong)
    assert not result.passed
    assert kinds <= {verdict.kind for verdict in result.verdicts if not verdict.passed}


def test_command(tmp_path):
    """The quick suite passes (false alarm 1/400 for a fresh seed) and leaves a table and a picture."""
    result = CliRunner().invoke(app, ["validate", "quick", "--out", str(tmp_path / "v"), "--seed", "3", "--json"])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["passed"]
    assert [v["kind"] for v in summary["verdicts"]] == list(KINDS)
    table = pq.read_table(tmp_path / "v" / "scores.parquet")
    assert table.num_rows == sum(v["count"] for v in summary["verdicts"]) > 150
    z = table["z"].to_numpy()
    np.testing.assert_allclose(np.var(z), 1.0, rtol=0, atol=5 * math.sqrt(2 / z.size))
    assert (tmp_path / "v" / "validation.png").stat().st_size > 10_000


@pytest.mark.parametrize(("was", "wrong"), [("stiff", "soft"), ("soft", "stiff")])
def test_hazard(was, wrong):
    """One barrier instead of the other: the number of thermal breaks and the law of hazards both fail; the right one
    passes (false alarm 4e-4 for a fresh seed)."""
    passed, failed = [], []
    for index, (ensemble, v) in enumerate(sample(96, 1)):
        if index % 3 == 1 and ensemble.thermal.barrier == was and not ensemble.aging.active:
            other = dataclasses.replace(ensemble, thermal=dataclasses.replace(ensemble.thermal, barrier=wrong))
            passed += _hazard(ensemble, ensemble, v, index)
            failed += _hazard(ensemble, other, v, index)
    for kind in ("hazard", "hazard law"):
        assert verdict(kind, passed).count >= 3
        assert verdict(kind, passed).passed
        assert not verdict(kind, failed).passed


def test_verdict():
    """Too large, too small and one far out are all refused."""

    def of(z):
        return verdict("mean", [Score("mean", Ensemble(), 1.0, 0.0, 0.0, 1.0, float(value)) for value in z])

    normal = np.random.default_rng(1).standard_normal(500)
    assert of(normal).passed
    assert not of(1.4 * normal).passed
    assert not of(0.7 * normal).passed
    assert not of(np.append(normal, 6.0)).passed
    with pytest.raises(InputError, match="suite"):
        validate("everything")


def test_sample():
    """A third of the points age, in every way there is, and all else is drawn as if they did not."""
    points = [ensemble for ensemble, _ in sample(SUITES["full"][0], 1)]
    aging = [ensemble for ensemble in points if ensemble.aging.active]
    assert len(aging) == len(points) // 3
    for name in ("disorder", "stiffness_law"):
        assert len({(getattr(e, name), e.aging.rule, e.thermal.barrier) for e in aging}) == 8
    assert {e.thermal.kT > 0 for e in aging} == {True, False}
    assert {e.aging.rate == math.inf for e in aging} == {True, False}
    ratio = np.array([e.aging.x_star_final / e.thresholds.x_star for e in aging])
    assert 0.3 <= ratio.min() < 0.5
    assert 6 < ratio.max() <= 10
    share = np.mean([e.disorder == "quenched" for e in aging])
    assert abs(share - 0.5) < 5 * math.sqrt(0.25 / len(aging))


def test_no_fluctuations_where_the_stationary_start_is_refused():
    """Most contacts break at once, a few with high thresholds live long: no score, and no end of the suite."""
    aging, rare = Aging("langevin", 1.4e-4, 7.8), Delay(1500.0)
    hot = Ensemble(Gamma(0.5), Thermal(0.92, barrier="stiff"), rare, aging, stiffness_law="uniform")
    assert _fluctuations(hot, hot, 2.2e-4, 1, (20, 2000)) == []
    warm = dataclasses.replace(hot, thermal=Thermal(0.1))
    assert _fluctuations(warm, warm, 2.2e-4, 1, (20, 2000)) != []


def test_averages_that_call_themselves_unreliable_are_not_scored():
    """Few contacts that live long carry the force, and 2^16 lives of fluctuating thresholds say that they miss some."""
    aging = Aging("langevin", 1.4e-3, 4.0)
    warm = Ensemble(Gamma(0.0), Thermal(1.9, barrier="stiff"), aging=aging, stiffness_law="uniform")
    for velocity, scored in ((2.7e-4, []), (0.1, ["friction", "break_stretch"])):
        found = steady(warm, velocity, rel_error=1.0)
        assert found.friction.reliable == bool(scored)
        assert [score.kind for score in _averages(warm, warm, velocity, found)] == scored
