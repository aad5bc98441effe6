"""Normal load that steps or grows: reference against closed forms, simulation against
the reference, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import call
from scipy import integrate

from eqsim import (
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    NoThresholds,
    Programme,
    Segment,
    Stage,
    Thermal,
    trajectory,
    transient,
)
from eqsim.errors import InputError
from eqsim.fitting.record import means_along

# equal thresholds of 1 at T = 0: steady friction is 1/2, that after birth X mod 1
EQUAL = Ensemble(Delta(1.0), stiffness_law="uniform", count=2000)
SLIDE = Segment(0.1, distance=0.5)


def test_steps_by_closed_form():
    """A step up adds its share of contacts that are born unstressed, a step down thins
    all; both within the error that is told, next to falls of the force too."""
    up, down = (
        Segment(0.1, distance=2.0, load=1.2),
        Segment(0.1, distance=1.0, load=0.6),
    )
    exact = transient(EQUAL, Programme([SLIDE, up, down], "stationary", 0.1), 352)
    X = exact.X
    born = np.mod(X - 0.5, 1.0) * (X > 0.5)
    known = (0.5 + 0.2 * born) * np.where(X > 2.5, 0.5, 1.0)
    away = np.abs(exact.X * 2.0 - np.round(exact.X * 2.0)) > 0.04  # from falls
    assert np.abs(exact.force - known)[away].max() < 1e-9
    assert np.all(np.abs(exact.force - known) < exact.force_error + 1e-9)
    assert np.abs(exact.pinned - 1.0).max() < 1e-12


def test_a_run_file_with_a_load(tmp_path):
    """Contacts that heat may break are simulated beside the exact mean."""
    path = tmp_path / "run.toml"
    path.write_text("""
[contacts]
count = 2000
stiffness_law = "uniform"
[thermal]
kT = 0.1
[drive]
start = "fresh"
programme = [{ velocity = 0.1, distance = 1.0 }, { velocity = 0.1, distance = 1.0, load = 1.2 }]
""")
    done = call("run", path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "no exact curve" not in done.output


def test_rates_by_closed_form():
    """After a step down to 0.8 a load that grows by 1 in displacement adds X^2/2; one
    that falls in a hold takes the force along. 4.5e-16 is rounding of sums of 20 terms
    near 1."""
    start = Segment(0.1, distance=0.5, load=0.8)
    grows = Segment(0.1, distance=0.9, load_rate=0.1)
    falls = Segment(time=3.0, load_rate=-0.1)
    moves = Programme([start, grows, falls], "stationary", 0.1)
    exact = transient(EQUAL, moves, 61)
    slid, held = np.clip(exact.X - 0.5, 0.0, 0.9), np.clip(exact.t - 14.0, 0.0, 3.0)
    known = (0.4 + 0.5 * slid**2) * (1.0 - 0.1 * held / 1.7)
    known[0] = 0.5  # before the step
    assert np.abs(exact.force - known).max() < 1e-9
    grid = moves.grid(61)
    assert np.diff(grid.t[grid.segment == 2]) == pytest.approx(
        3.0 / 20, rel=1e-9, abs=0
    )
    run = trajectory(EQUAL, moves, points=61)
    assert np.abs(run.pinned - 1.0).max() < 1e-12


def test_a_step_up_after_one_down():
    """After a step down to 0.8 one up to 1.2 adds 0.4, stretched by X since then; to
    rounding."""
    down, up = (Segment(0.1, distance=0.5, load=load) for load in (0.8, 1.2))
    exact = transient(EQUAL, Programme([SLIDE, down, up], "stationary", 0.1), 31)
    known = np.where(exact.X > 0.501, 0.4, 0.5)
    known += 0.4 * np.maximum(exact.X - 1.0, 0.0)
    assert np.abs(exact.force - known).max() < 1e-9


@pytest.mark.verification
def test_simulation_beside_the_reference():
    """Forces at the ends of segments along steps and a rate, of 8 seeds: 40 scores in
    all, none above 4.5 (3e-4), their mean square 1 within 4.5 of its scatter .22; those
    beside a constant load are off."""
    contacts = Ensemble(stiffness_law="uniform", count=2000)
    moves = [
        Segment(0.1, distance=1.0, points=9),
        Segment(0.1, distance=1.0, load=1.5, points=9),
        Segment(0.1, distance=0.5, load_rate=-0.1, points=9),
        Segment(0.1, distance=1.0, load_rate=0.05, points=9),
        Segment(-0.1, distance=0.7, load=0.8, points=9),
    ]
    drive = Programme(moves, "stationary", 0.1)
    exact = transient(contacts, drive, 46)
    plain = [Segment(s.velocity, s.distance, points=9) for s in moves]
    constant = transient(contacts, Programme(plain, "stationary", 0.1), 46)
    ends = [9, 18, 27, 36, 45]
    z, wrong = [], []
    for seed in range(8):
        run = trajectory(contacts, drive, points=46, seed=seed)
        error = np.hypot(run.force_stderr, exact.force_error)
        z.append(((run.force - exact.force) / error)[ends])
        wrong.append(((run.force - constant.force) / error)[ends])
        np.testing.assert_allclose(run.pinned, 1.0, rtol=0, atol=1e-12)
        assert [s.end.value for s in run.segments] == run.force[ends].tolist()
        assert run.segment.dtype.kind == "i"
        assert run.segment[ends].tolist() == [0, 1, 2, 3, 4]
    assert np.abs(z).max() < 4.5
    assert abs(np.mean(np.square(z)) - 1.0) < 4.5 * 0.22
    assert np.abs(wrong)[:, 1:].max() > 10.0
    assert exact.t == pytest.approx(run.t, rel=1e-12, abs=0)


def test_scatter_after_a_fall():
    """A quarter of 400 contacts scatter as an interface of 100 does, times a quarter:
    400 replicas each, whose standard deviations are known to 3.5 % (|z| < 4.5 of their
    ratio, a false alarm of 7e-6)."""
    contacts = Ensemble(Gamma(1.0), count=400, stiffness_law="uniform")
    slide = Segment(1.0, distance=4.0)
    fall = Programme([slide, Segment(1.0, distance=0.5, load=0.25)])
    run = trajectory(contacts, fall, points=10, replicas=400)
    few = trajectory(replace(contacts, count=100), Drive(1.0, 4.5), replicas=400)
    ratio = run.force_replica_std[-1] / (0.25 * few.force_replica_std[-1])
    assert abs(ratio - 1.0) < 4.5 * 0.05


def test_refusals(tmp_path):
    text = "[contacts]\ncount = 100\n[drive]\nprogramme = [{velocity = 0.1, distance = 1.0, load = 1.2}]\n"
    path = tmp_path / "run.toml"
    for change, said in (
        ("drive.programme.0.load=0.0", "drive.programme.0.load = 0.0: must be"),
        ("drive.programme.0.load_rate=-1.0", "load at the end = -8.8: must be"),
        ("drive.stage.stiffness=1.0", "drive.programme.0.load: not with a stage"),
    ):
        path.write_text(text)
        done = call("run", path, "--out", tmp_path / "out", "--set", change)
        assert done.exit_code == 2
        assert said in " ".join(done.output.split()), done.output
    drive = Programme([Segment(0.1, distance=1.0, load=1.2)])
    with pytest.raises(InputError, match="a load that changes is not allowed here"):
        means_along(EQUAL, drive, drive.grid(5))
    with pytest.raises(InputError, match="not with a stage"):
        Programme(drive.segments, stage=Stage(1.0))
    even = Segment(0.1, distance=1.0, load=1.0, load_rate=0.0)  # defaults
    assert not Programme([even], stage=Stage(1.0)).loaded


@pytest.mark.parametrize(
    "after", [0.0, pytest.param(3.0, marks=pytest.mark.verification)]
)
def test_ramps_far_longer_than_a_threshold(after):
    """A ramp of 20 thresholds, and what comes later: contacts added at s are as far
    along at t as those of a fresh start at t - s. So F = F_0 + int load rate F_0 ds, by
    the trapezoidal rule over 20 001 values, off by less than 1e-6."""
    contacts = Ensemble(Gamma(n=1), stiffness_law="uniform")
    ramp = Segment(1.0, distance=20.0, load_rate=1.0 / 20.0, points=20)
    moves = [ramp, Segment(1.0, distance=after, points=6)] if after else [ramp]
    exact = transient(contacts, Programme(moves))
    fresh = transient(contacts, Drive(1.0, 20.0 + after), 20_001)
    whole = np.append(0.0, integrate.cumulative_trapezoid(fresh.force, fresh.X)) / 20.0
    later = np.interp(exact.X - 20.0, fresh.X, whole, left=0.0)
    known = np.interp(exact.X, fresh.X, fresh.force + whole) - later
    missed = np.abs(exact.force - known)
    assert np.all(missed <= exact.force_error + 1e-6)
    assert exact.force_error.max() < 5e-3
    assert exact.force_error[exact.X <= 20.0].max() < 1e-4


# bonds that break at a rate of 0.5, whatever their stretch, and form again at one of 1
BONDS = Ensemble(
    NoThresholds(200.0),
    stiffness_law="uniform",
    thermal=Thermal(barrier="bell", off_rate=0.5, force_scale=1e9),
    delay=Delay(time=1.0, law="exponential"),
    count=2000,
)


@pytest.mark.verification
def test_ramps_of_bonds():
    """Force and pinned share along a ramp, with its newest contacts, by the rate
    equations; exact means within the error that is told. Of 4 simulations 2 x 4 x 10
    scores at 5.5: one above by chance in 3e5 runs of normal errors, which also have
    what pieces of the ramp miss."""

    def change(t, y):
        return 0.1 + (1.0 + 0.1 * t) - 1.5 * y[0], y[0] - 0.5 * y[1]

    ramp = Segment(1.0, distance=20.0, load_rate=0.1)
    exact = transient(BONDS, Programme([ramp]), 11)
    numbers, force = integrate.solve_ivp(
        change, (0.0, 20.0), [1.0, 0.0], t_eval=exact.t, rtol=1e-10, atol=1e-10
    ).y
    pinned = numbers / (1.0 + 0.1 * exact.t)
    assert np.all(np.abs(exact.force - force) <= exact.force_error + 1e-8)
    assert np.all(np.abs(exact.pinned - pinned) <= exact.pinned_error + 1e-8)
    assert max(exact.force_error.max(), exact.pinned_error.max()) < 1e-3
    for seed in range(4):
        run = trajectory(BONDS, Programme([ramp]), points=11, seed=seed)
        z = (run.force - force)[1:] / run.force_stderr[1:]
        of_pinned = (run.pinned - pinned)[1:] / run.pinned_stderr[1:]
        assert np.abs([z, of_pinned]).max() < 5.5
