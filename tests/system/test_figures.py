"""The paper's figures: what the corrected and the printed forms on them must show, and
the command that makes them."""

import dataclasses
import json
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from analysis.figures import a01, a02, a02ab, a04, a05
from analysis.figures.command import app
from analysis.figures.common import Curve
from analysis.figures.compute import NAMES, check, compute, make
from eqsim.estimate import Estimate


class Here(Executor):
    """Computes at once, in this process."""

    def submit(self, function, /, *args, **kwargs):
        future = Future()
        future.set_result(function(*args, **kwargs))
        return future


def tabulated(curves, velocities):
    """The master equation's rows of some curves, at other velocities and without
    particles."""
    curves = [
        dataclasses.replace(curve, velocities=velocities, points=()) for curve in curves
    ]
    return dict(compute({"figure": curves}, Here()))["figure"]


def slope(table, name, exact):
    """Of ln |approximate/exact - 1| against ln v."""
    line = table[table.curve == name].sort_values("velocity")
    truth = exact.set_index("velocity").friction.loc[line.velocity].to_numpy()
    return np.polyfit(np.log(line.velocity), np.log(abs(line.friction / truth - 1)), 1)[
        0
    ]


def test_high_velocity_form_meets_the_curve_only_as_corrected():
    """nt16 leaves S_2^3 when corrected and S_2 as printed (erratum 3): slopes -3 and
    -1, to the next order in S_2 = 1/(2.25 v) < .045."""
    table = tabulated(
        [curve for curve in a01.curves() if curve.name == "annealed"],
        (10.0, 20.0, 40.0),
    )
    forms = a01.formulas(pd.concat([table, table.assign(velocity=[0.5, 0.7, 0.9])]))
    forms = forms[forms.velocity >= 10.0]
    assert slope(forms, "nt16, corrected", table) == pytest.approx(-3, abs=0.1)
    assert slope(forms, "nt16, printed", table) == pytest.approx(-1, abs=0.1)


def test_small_aging_form_meets_the_curve_only_as_corrected():
    """star4 leaves second-order terms when corrected and first-order ones as printed
    (errata 2, 3): slopes -2 and -1 to the next order, S_3 < .006."""
    table = tabulated(
        [
            curve
            for curve in a04.curves()
            if curve.name.startswith("annealed, D = 0.01")
        ],
        (1e2, 3e2, 1e3),
    )
    every = pd.concat(
        [table.assign(curve=f"annealed, D = {D:g}, kT = 1") for D in a04.RATES]
    )
    forms = a04.formulas(every)
    assert slope(forms, "star4, D = 0.01, corrected", table) == pytest.approx(
        -2, abs=0.05
    )
    assert slope(forms, "star4, D = 0.01, printed", table) == pytest.approx(
        -1, abs=0.05
    )


def test_exponents_are_those_of_a_power_law():
    v = np.geomspace(1e-2, 1e2, 21)
    curves = [curve.row() for curve in a02.curves(temperatures=(1.0,))]
    rows = [
        row | {"source": "master equation", "velocity": x, "friction": y}
        for row in curves
        for x, y in zip(v, np.minimum(v, v**-0.4), strict=True)
    ]
    found = a02ab.formulas(pd.DataFrame(rows))
    assert found.curve.nunique() == len(curves)
    assert found.exponent.to_numpy() == pytest.approx(1.4, rel=1e-9, abs=0)
    assert found.exponent_error.max() < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_curves_are_named_once_and_cover_both_ensembles(name):
    curves = import_module(f"analysis.figures.{name.lower()}").curves()
    assert len({curve.name for curve in curves}) == len(curves)
    assert {curve.ensemble.disorder for curve in curves} == {"annealed", "quenched"}
    assert sum(len(curve.points) for curve in curves) >= 20


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param("1", marks=pytest.mark.verification),
        pytest.param("12", marks=pytest.mark.long),
    ],
)
def test_command(numbers, tmp_path, monkeypatch):
    """Pictures and table of a figure with few points; with -m long, with those of
    --quick, the same bytes with other workers."""
    if numbers == "1":

        def few(curve):
            return dataclasses.replace(
                curve, velocities=curve.velocities[::10], points=curve.points[3::8]
            )

        monkeypatch.setattr(Curve, "thinned", few)
    contents = []
    for workers in numbers:
        out = tmp_path / workers
        result = CliRunner().invoke(
            app,
            [
                "figures",
                "A05",
                "--quick",
                "--json",
                "--workers",
                workers,
                "--out",
                str(out),
            ],
        )
        assert result.exit_code == 0, result.output
        (figure,) = json.loads(result.stdout)["figures"]
        assert figure["name"] == "A05"
        assert figure["p"] > 1e-4  # false alarm 1e-4
        contents.append(
            {path.name: path.read_bytes() for path in sorted(out.iterdir())}
        )
    assert sorted(contents[0]) == ["A05.parquet", "A05.pdf", "A05.png"]
    assert contents[0] == contents[-1]
    table = pd.read_parquet(tmp_path / "1" / "A05.parquet")
    assert {"curve", "disorder", "velocity", "friction", "error", "z"} <= set(table)
    quenched = table[
        (table.disorder == "quenched") & (table.source == "master equation")
    ]
    for (
        layers,
        film,
    ) in (
        a05.FILMS.items()
    ):  # heat takes (ln(v_*/v)/6 + O(1))/b of a literal contact's friction
        flat = quenched[quenched.curve == f"quenched, {layers} layers"]
        lost = (
            np.log(film.crossover_velocity() / flat.velocity.min()) / 6 + 2
        ) / film.b()
        assert 0 < np.ptp(flat.friction) / flat.friction.mean() < lost
    assert contents[0]["A05.pdf"].startswith(b"%PDF")


@pytest.mark.parametrize("name", NAMES)
def test_quick_is_quick(name):
    """Where contacts age, references of annealed and of fluctuating thresholds take
    half a second each."""
    curves = [
        curve.thinned()
        for curve in import_module(f"analysis.figures.{name.lower()}").curves()
        if curve.points
    ]
    slow = [
        curve
        for curve in curves
        if curve.ensemble.self_consistent or curve.ensemble.fluctuates
    ]
    assert sum(len(curve.velocities) + len(curve.points) for curve in slow) <= 80
    assert all(len(curve.velocities) >= 6 and curve.points for curve in curves)


def test_finished_figures_outlive_an_interrupt(tmp_path, monkeypatch):
    def stub(job):
        if job.ensemble.thresholds.x_star != 1.0:  # films are in SI units
            raise KeyboardInterrupt
        return Estimate(0.5, 0.01, 100)

    @contextmanager
    def here(*_):
        with ThreadPoolExecutor(1) as pool:
            yield SimpleNamespace(executor=pool)

    monkeypatch.setattr("analysis.figures.compute._compute", stub)
    # in the order of the paper, also if all is done by then
    monkeypatch.setattr("analysis.figures.compute.as_completed", iter)
    monkeypatch.setattr("eqsim.sweeps.workers.Workers.fixed_pool", here)
    monkeypatch.setattr("eqsim.io.signals.acknowledge", lambda: 130)
    out = tmp_path / "o"
    for names, said in (
        (["A05"], "nothing is half-written"),
        (["A05", "A01"], f"finished in {out}/: A01"),
    ):
        result = CliRunner().invoke(
            app, ["figures", *names, "--quick", "--out", str(out)]
        )
        assert (result.exit_code, result.stderr) == (
            130,
            f"eqsim: interrupted; {said}\n",
        )
    assert sorted(path.name for path in out.iterdir()) == [
        "A01.parquet",
        "A01.pdf",
        "A01.png",
    ]


def test_bad_input_is_one_line(tmp_path):
    def refused(message, *args):
        result = CliRunner().invoke(app, ["figures", *args])
        assert result.exit_code == 2
        assert message in result.stderr
        assert result.stderr.count("\n") == 1

    refused("figure = 'A06': must be one of", "A06")
    refused("--workers = 0: must be an integer", "A01", "--workers", "0")
    (tmp_path / "file").write_text("")
    refused("is not a folder", "A01", "--out", str(tmp_path / "file"))
    assert check(["A04", "A01"]) == ["A01", "A04"]
    # by the number of the published figure
    assert check(["5", "A01"]) == ["A01", "A04"]
    assert list(make([], tmp_path, executor=Here())) == []
