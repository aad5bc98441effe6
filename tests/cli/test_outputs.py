"""Series of replicas, breaks one by one, and fluctuations: against the run that they
belong to, and exact values."""

import json
import math

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from command_line import call
from scipy.integrate import simpson

from eqsim import (
    Aging,
    Delay,
    Drive,
    Ensemble,
    InputError,
    Lognormal,
    Newborn,
    Programme,
    Segment,
    Thermal,
    breaks,
    fluctuations,
    trajectory,
)
from eqsim.engine.breaks import MOST_BREAKS
from eqsim.io.parameters import keys
from eqsim.io.runfile import check
from eqsim.workflows.fluctuations import run_fluctuations

DRIVE = Drive(0.1, 12.0)
RUN = "[contacts]\ncount = 60\n[drive]\nvelocity = 0.1\ndistance = 8.0\n[output]\npoints = 41\nreplicas = 3\n"


# --------------------------------------------------------------------------------------------------------
# series


def test_series_of_replicas():
    """Mean and scatter are those of the record, threads change no bit, and a replica is
    what it is whoever is there."""
    contacts = Ensemble(count=200, thermal=Thermal(0.1), delay=Delay(0.3))
    for drive in (
        DRIVE,
        Programme([Segment(0.1, distance=3.0), Segment(0.0, time=5.0)]),
    ):
        found = trajectory(contacts, drive, points=31, replicas=4)
        np.testing.assert_allclose(
            found.force_replicas.mean(0), found.force, rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(
            found.force_replicas.std(0, ddof=1),
            found.force_replica_std,
            rtol=1e-6,
            atol=1e-9,
        )
        same = trajectory(contacts, drive, points=31, replicas=4, threads=3)
        np.testing.assert_array_equal(found.force_replicas, same.force_replicas)
        fewer = trajectory(contacts, drive, points=31, replicas=2)
        np.testing.assert_allclose(
            fewer.force_replicas, found.force_replicas[:2], rtol=1e-9, atol=1e-12
        )
        table = found.replicas()
        np.testing.assert_array_equal(
            table["force"].reshape(4, -1), found.force_replicas
        )
        np.testing.assert_array_equal(
            table["replica"], np.repeat(np.arange(4), found.t.size)
        )
    with pytest.raises(InputError, match=r"^replicas: there is one ensemble only"):
        trajectory(contacts, DRIVE, points=31).replicas()


# --------------------------------------------------------------------------------------------------------
# breaks

LAWS = {
    "uniform": Ensemble(stiffness_law="uniform"),
    "warm": Ensemble(Lognormal(0.5), Thermal(0.1), Delay(0.5, "exponential")),
    "annealed": Ensemble(
        thermal=Thermal(0.1, barrier="stiff"), delay=Delay(0.5), disorder="annealed"
    ),
    "stretched": Ensemble(
        thermal=Thermal(0.1), newborn=Newborn("uniform", low=-0.2, high=0.4)
    ),
    "growing": Ensemble(
        aging=Aging("logarithmic", beta=0.1, cutoff_time=1.0), stiffness_law="uniform"
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        name
        if name in ("uniform", "warm")
        else pytest.param(name, marks=pytest.mark.verification)
        for name in LAWS
    ],
)
def test_breaks_make_the_force(name):
    """Stretch, travel and stiffness of every break give the force and the pinned
    contacts of the run of the same seed, from the start to where all that is pinned
    breaks before the end; rounding of some 1e4 sums."""
    contacts = Ensemble(**{**vars(LAWS[name]), "count": 120})
    found, record = (
        breaks(contacts, DRIVE, seed=5),
        trajectory(contacts, DRIVE, points=61, seed=5),
    )
    assert np.all(np.diff(found.X) >= 0)
    assert found.X[-1] <= 12.0
    np.testing.assert_allclose(found.t, found.X / 0.1, rtol=1e-15)
    births = found.X - found.travel
    last = {contact: X for contact, X in zip(found.contact, found.X, strict=True)}
    far = min(last[contact] for contact in range(120)) > record.X
    assert far.sum() > 20
    X = record.X[far][:, None]
    pinned = (births <= X + 1e-12) & (found.X > X)
    force = (
        np.where(pinned, found.stiffness * (found.stretch - (found.X - X)), 0.0).sum(
            axis=1
        )
        / 120
    )
    np.testing.assert_allclose(
        pinned.sum(axis=1) / 120, record.pinned[far], atol=1e-12, rtol=0
    )
    np.testing.assert_allclose(force, record.force[far], atol=1e-11, rtol=0)
    wrong = (
        np.where(
            pinned, 1.01 * found.stiffness * (found.stretch - (found.X - X)), 0.0
        ).sum(axis=1)
        / 120
    )
    assert np.abs(wrong - record.force[far]).max() > 1e-3


def test_breaks_do_not_depend_on_threads_or_on_room(monkeypatch):
    """Nor on how many were expected: a block that has more is done again."""
    contacts = Ensemble(count=900, thermal=Thermal(0.1))
    one, many = (
        breaks(contacts, DRIVE, replicas=3, threads=threads).to_pandas()
        for threads in (1, 3)
    )
    pd.testing.assert_frame_equal(one, many)
    monkeypatch.setattr("eqsim.engine.breaks._MARGIN", 0.01)
    pd.testing.assert_frame_equal(one, breaks(contacts, DRIVE, replicas=3).to_pandas())
    assert set(one["replica"]) == {0, 1, 2}
    assert one.groupby("replica")["contact"].nunique().eq(900).all()
    stretched = scipy.stats.ks_2samp(
        one["stretch"][one["replica"] == 0], one["stretch"][one["replica"] == 1]
    )
    assert stretched.pvalue > 1e-4


@pytest.mark.parametrize(
    ("contacts", "drive", "message"),
    [
        (
            Ensemble(),
            Drive(0.1, 10.0, "stationary"),
            'drive.start = "stationary": breaks are listed from a fresh start',
        ),
        (
            Ensemble(aging=Aging("langevin", 0.1, 2.0)),
            DRIVE,
            'aging.rule = "langevin": breaks are not listed',
        ),
        (Ensemble(count=10**8), DRIVE, "breaks: there are about 1e.09; at most 2e.07"),
        (
            Ensemble(),
            Programme([Segment(0.1, distance=1.0)]),
            "drive.programme, drive.file or drive.time: has no steady state",
        ),
    ],
    ids=["stationary", "langevin", "many", "programme"],
)
def test_breaks_that_are_not_listed(contacts, drive, message):
    with pytest.raises(InputError, match="^" + message):
        breaks(contacts, drive)
    assert MOST_BREAKS == 2e7


def test_outputs_of_a_run(tmp_path):
    """Files are written when they are asked for, and each can be made again."""
    (tmp_path / "run.toml").write_text(RUN)
    asked = ("--set", "output.series=true", "--set", "output.breaks=true")
    done = call("run", tmp_path / "run.toml", "--out", tmp_path / "out", *asked)
    assert done.exit_code == 0, done.output
    assert "replicas.parquet, breaks.parquet" in " ".join(done.output.split())
    series, listed = (
        pd.read_parquet(tmp_path / "out" / f"{name}.parquet")
        for name in ("replicas", "breaks")
    )
    mean = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")["force"]
    np.testing.assert_allclose(
        series["force"].to_numpy().reshape(3, 41).mean(0), mean, rtol=1e-9, atol=1e-12
    )
    assert list(listed) == [
        "replica",
        "contact",
        "t",
        "X",
        "stretch",
        "travel",
        "stiffness",
    ]
    for name in ("replicas", "breaks", "trajectory"):
        again = call("replay", tmp_path / "out" / f"{name}.parquet")
        assert again.exit_code == 0, again.output
    call("run", tmp_path / "run.toml", "--out", tmp_path / "plain")
    assert {path.name for path in (tmp_path / "plain").iterdir()} == {
        "trajectory.parquet",
        "summary.json",
        "force.png",
    }
    assert not {"output.series", "output.breaks"} & set(keys())  # they change no number


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"output": {"series": True}},
            "output.series: writes the force of every replica; needs output.replicas of 2",
        ),
        (
            {"output": {"series": True, "replicas": 10**6}},
            "output.series: output.replicas x output.points = 2e+09; at",
        ),
        ({"output": {"breaks": 1}}, "output.breaks = 1: must be a valid boolean"),
        (
            {"output": {"breaks": True}, "drive": {"programme": [{"hold": 1.0}]}},
            "output.breaks: breaks are listed at a",
        ),
        (
            {
                "output": {"breaks": True},
                "elastic": {"blocks": 2, "coupling": 1.0, "drive_stiffness": 1.0},
            },
            "output.breaks: not with [elastic]",
        ),
    ],
    ids=str,
)
def test_bad_outputs(given, message):
    with pytest.raises(InputError) as caught:
        check({"drive": {"velocity": 0.1}, **given})
    assert str(caught.value).startswith(message)


# --------------------------------------------------------------------------------------------------
# fluctuations


def sample_of(tmp_path, text, **more):
    return run_fluctuations(check(text, tmp_path), points=11, lives=2e5, **more)


@pytest.mark.parametrize(
    "text",
    [
        {"thermal": {"kT": 0.1}, "delay": {"time": 2.0, "law": "exponential"}},
        pytest.param(
            {
                "thermal": {"kT": 0.1},
                "disorder": "annealed",
                "thresholds": {"law": "weibull", "shape": 2.5},
            },
            marks=pytest.mark.verification,
        ),
    ],
    ids=["quenched", "annealed"],
)
def test_fluctuations_of_simulated_contacts(tmp_path, text):
    """Every |z| of 11 lags < 4.5 (false alarm 1e-4 for both); the theory of another
    temperature fails."""
    found = sample_of(tmp_path, {**text, "drive": {"velocity": 0.1}})
    assert found.sample.reliable
    assert max(map(abs, found.z)) < 4.5
    assert found.summary()["force_std"] == pytest.approx(
        math.sqrt(found.exact.covariance[0] / 1e5), rel=1e-12, abs=0
    )
    other = sample_of(
        tmp_path,
        {**text, "thermal": {"kT": 0.4}, "drive": {"velocity": 0.1}},
        lag=found.asked["lag"],
    )
    off = (found.sample.covariance - other.exact.covariance) / found.sample.stderr
    assert np.abs(off).max() > 4.5


def test_the_correlation_length_does_not_depend_on_points(tmp_path):
    """Force against displacement of equal cold contacts is a sawtooth, whose covariance
    has an integral of 0 over whole periods; that of warm contacts is the integral of many
    lags, by the rule of Simpson."""
    cold = {"thresholds": {"law": "delta"}, "drive": {"velocity": 0.1}}
    warm = {"thermal": {"kT": 0.1}, "drive": {"velocity": 0.1}}
    many = fluctuations(Ensemble(thermal=Thermal(0.1)), Drive(0.1, 6.0), points=6001)
    exact = simpson(many.covariance, x=many.lag) / many.covariance[0]
    for text, expected, lag in ((cold, 0.0, 3.0), (warm, exact, 6.0)):
        file = check(text, tmp_path)
        for points in (2, 7):
            asked = {"points": points, "lives": 0.0, "lag": lag}
            found = run_fluctuations(file, **asked).correlation
            assert found.value == pytest.approx(expected, rel=0, abs=found.stderr)
            assert found.stderr < 2e-3


def test_fluctuations_command(tmp_path):
    (tmp_path / "run.toml").write_text(RUN + "[thermal]\nkT = 0.1\n")
    done = call(
        "fluctuations",
        tmp_path / "run.toml",
        "--out",
        tmp_path / "out",
        "--lives",
        "5e4",
        "--points",
        "21",
    )
    assert done.exit_code == 0, done.output
    assert "over the variance: 0.431597" in done.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "fluctuations.parquet", "summary.json", "fluctuations.png",
    }  # fmt: skip
    table = pd.read_parquet(tmp_path / "out" / "fluctuations.parquet")
    assert list(table) == [
        "lag",
        "covariance",
        "error",
        "simulated",
        "simulated_stderr",
    ]
    said = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert said["variance"]["value"] == table["covariance"][0]
    assert call("replay", tmp_path / "out" / "fluctuations.parquet").exit_code == 0
    alone = call(
        "fluctuations",
        tmp_path / "run.toml",
        "--lives",
        "0",
        "--json",
        "--lag",
        "2.0",
        "--points",
        "5",
    )
    assert json.loads(alone.output)["lag"] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert json.loads(alone.output)["z"] == [None] * 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("--lag", "-1"), "--lag = -1.0: must be a finite number > 0"),
        (("--points", "1"), "--points = 1: must be an integer from 2"),
        (
            ("--set", "drive.stage={ stiffness = 0.1 }"),
            "drive.stage: a slider that a spring pulls has no steady state",
        ),
        (
            ("--set", "aging={ rule = 'langevin', rate = 0.1, x_star_final = 2.0 }"),
            'stiffness_law = "sqrt": fluctuations of aging quenched contacts need "uniform"',
        ),
    ],
    ids=["lag", "points", "stage", "theory"],
)
def test_fluctuations_that_there_are_none_of(tmp_path, change, message):
    (tmp_path / "run.toml").write_text(RUN)
    done = call(
        "fluctuations", tmp_path / "run.toml", "--out", tmp_path / "out", *change
    )
    assert done.exit_code == 2
    assert done.stderr.startswith(f"eqsim: {message}")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_tables_of_an_earlier_run_are_named(tmp_path):
    """A folder may still hold tables that this run does not write, and its pictures and
    exports in other formats; a file of the user is none of these."""
    path, out = tmp_path / "run.toml", tmp_path / "out"
    path.write_text(RUN)
    first = call("run", path, "--out", out, "--set", "output.breaks=true")
    again = call("run", path, "--out", out)
    assert "earlier run" not in first.stdout
    assert f"{out.name}/ also holds breaks.parquet" in again.stdout.replace("\n", "")
    (out / "notes.csv").write_text("mine")
    (out / "force.txt").write_text("mine")
    call("run", path, "--out", out, "--format", "pdf")
    call("export", out / "trajectory.parquet")
    said = call("run", path, "--out", out).stdout.replace("\n", "")
    names = "breaks.parquet, force.pdf, trajectory.csv"
    assert f"{out.name}/ also holds {names} of an earlier run" in said
