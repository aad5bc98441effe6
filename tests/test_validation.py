"""The validation program itself: it passes for the right engine and fails when one thing is wrong."""

import dataclasses
import json
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from eqsim import Delay, Ensemble, InputError
from eqsim.cli import app
from eqsim.validation import KINDS, Score, _hazard, sample, validate, verdict


def changed(**changes):
    return lambda ensemble: dataclasses.replace(ensemble, **changes)


def faster(ensemble):
    """omega 2 % too high."""
    omega = 1.02 * ensemble.thermal.attempt_frequency
    return dataclasses.replace(ensemble, thermal=dataclasses.replace(ensemble.thermal, attempt_frequency=omega))


@pytest.mark.parametrize(
    ("wrong", "kinds"),
    [
        (changed(stiffness_law="uniform"), {"friction", "transient"}),
        (changed(disorder="quenched"), {"friction", "break_stretch", "transient", "hazard", "hazard law"}),
        (faster, {"friction", "break_stretch"}),
        (changed(delay=Delay(0.0)), {"friction", "pinned", "transient"}),
    ],
    ids=["uniform instead of sqrt", "quenched instead of annealed", "omega 2 % off", "delay ignored"],
)
def test_negative_controls(wrong, kinds):
    """One thing wrong in the engine alone: the suite fails, where it should."""
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
    np.testing.assert_allclose(np.var(z), 1.0, atol=5 * math.sqrt(2 / z.size))
    assert (tmp_path / "v" / "validation.png").stat().st_size > 10_000


@pytest.mark.parametrize(("was", "wrong"), [("stiff", "soft"), ("soft", "stiff")])
def test_hazard(was, wrong):
    """One barrier instead of the other: the number of thermal breaks and the law of hazards both fail; the right one
    passes (false alarm 4e-4 for a fresh seed)."""
    passed, failed = [], []
    for index, (ensemble, v) in enumerate(sample(32, 1)):
        if index % 3 == 1 and ensemble.thermal.barrier == was:
            other = dataclasses.replace(ensemble, thermal=dataclasses.replace(ensemble.thermal, barrier=wrong))
            passed += _hazard(ensemble, ensemble, v, index)
            failed += _hazard(ensemble, other, v, index)
    for kind in ("hazard", "hazard law"):
        assert verdict(kind, passed).count >= 4
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
