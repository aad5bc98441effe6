"""Steady states of a motor on a rigid substrate."""

import dataclasses
import json
import math

import pytest
from typer.testing import CliRunner

from eqsim import (
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    InputError,
    Newborn,
    NoThresholds,
    Programme,
    Segment,
    Stage,
    Thermal,
    curve,
    reference,
    transient,
)
from eqsim.cli.app import app


def motor(velocity, stall, **more):
    return Programme([Segment(velocity, time=1.0)], stall_force=stall, **more)


# breaks at the rate 1/2, whatever the stretch, and is pinned at the rate 1
CONSTANT = Ensemble(Delta(1e4), Thermal(1e30, 0.5), Delay(1.0, "exponential"))


@pytest.mark.parametrize("u", [1e-6, 10.0, 120.0])
@pytest.mark.parametrize("s", [0.01, 3.0, 1e4])
def test_constant_rate_of_breaks(u, s):
    """v = u/(1 + u g/s), g = k_on/(k_off (k_on + k_off)) = 4/3."""
    found = reference(CONSTANT, motor(u, s))
    v = u / (1.0 + u * 4.0 / 3.0 / s)
    assert found.velocity.value == pytest.approx(v, rel=1e-10, abs=0)
    assert found.friction.value == pytest.approx(4.0 / 3.0 * v, rel=1e-10, abs=0)
    assert found.roots == (found.velocity.value,)
    assert abs(found.velocity.value - v) < 3.0 * found.velocity.stderr + 1e-14 * v


@pytest.mark.parametrize(
    ("u", "s", "v", "friction"),
    [
        (10.0, 3.0, 4.3679193448, 1.6896241966),
        (120.0, 2.0, 78.619767032, 0.68967054947),
    ],
)
def test_bell_bonds(u, s, v, friction):
    """Ten digits are given; fixed delays of the same mean make no difference. Negative
    control: a mean delay 1 % longer does."""
    bonds = Ensemble(
        NoThresholds(),
        Thermal(barrier="bell", off_rate=0.1, force_scale=2.0),
        Delay(1.0, "exponential"),
    )
    found = reference(bonds, motor(u, s))
    assert found.velocity.value == pytest.approx(v, rel=1e-10, abs=0)
    assert found.friction.value == pytest.approx(friction, rel=1e-10, abs=0)
    fixed = reference(dataclasses.replace(bonds, delay=Delay(1.0)), motor(u, s))
    assert fixed.velocity.value == pytest.approx(v, rel=1e-10, abs=0)
    longer = reference(dataclasses.replace(bonds, delay=Delay(1.01)), motor(u, s))
    assert abs(longer.velocity.value / v - 1.0) > 1e-4


def test_quoted_number():
    found = reference(CONSTANT, motor(10.0, 3.0))
    assert found.velocity.value == pytest.approx(1.8367346939, rel=1e-10, abs=0)
    wrong = reference(CONSTANT, motor(10.0, 3.001)).velocity
    assert abs(wrong.value - 1.8367346939) > 1e4 * wrong.stderr


@pytest.mark.parametrize("kT", [0.0, 0.1])
def test_balance_of_motor_and_friction(kT):
    contacts = Ensemble(Gamma(), Thermal(kT), Delay(0.3), eta=0.1)
    found = reference(contacts, motor(0.5, 1.5))
    v = found.velocity.value
    assert v == pytest.approx(
        0.5 * (1.0 - found.friction.value / 1.5), rel=1e-12, abs=0
    )
    alone = reference(contacts, Drive(v))
    assert found.friction.value == alone.friction.value
    assert found.friction.stderr >= alone.friction.stderr


def test_several_steady_velocities():
    """Friction that falls with the velocity: a motor that is strong enough to move fast
    among contacts that are mostly detached stops at a slow one. Of the two velocities
    at which forces balance it returns to the faster one."""
    contacts = Ensemble(Gamma(), Thermal(0.05), Delay(3.0))
    found = reference(contacts, motor(3.0, 0.9))
    assert len(found.roots) == 2
    assert found.velocity.value == found.roots[1]
    for v in found.roots:
        balance = v / 3.0 + curve(contacts, [v]).friction[0] / 0.9
        assert balance == pytest.approx(1.0, rel=1e-8, abs=0)


@pytest.mark.parametrize("s", [0.01, 1.0])
def test_births_against_the_motion_drive_a_motor(s):
    """Contacts that are born at -1 drive it beyond its velocity without a load, F =
    (2/3) (2 v - 1)."""
    u, births = 0.01, Newborn("delta", "length", stretch=-1.0)
    found = reference(dataclasses.replace(CONSTANT, newborn=births), motor(u, s))
    v = u * (1.0 + 2.0 / 3.0 / s) / (1.0 + u * 4.0 / 3.0 / s)
    assert found.velocity.value == pytest.approx(v, rel=1e-9, abs=0)
    assert found.friction.value == pytest.approx(
        2.0 / 3.0 * (2.0 * v - 1.0), rel=1e-9, abs=0
    )


@pytest.mark.parametrize("more", [1e-3, 1e-7])
def test_two_velocities_that_are_almost_one(more):
    """Slightly above the least stall force at which forces balance, 0.396110206870 of
    these contacts, at 1.27855. There the error of the velocity is larger, and so is that
    of the friction: u - v and F are in proportion."""
    contacts = Ensemble(Gamma(), Thermal(0.05), Delay(3.0))
    s = 0.396110206870 * (1.0 + more)
    found = reference(contacts, motor(3.0, s))
    slow, fast = found.roots
    assert slow < 1.2785527 < fast < slow * (1.0 + 4.0 * math.sqrt(more))
    assert found.velocity.value == fast
    assert found.friction.stderr >= found.velocity.stderr * s / 3.0
    assert (
        found.friction.stderr > 5.0 * reference(contacts, Drive(fast)).friction.stderr
    )


@pytest.mark.verification
def test_the_faster_velocity_is_stable():
    """The mean field stays at it."""
    contacts = Ensemble(Gamma(), Thermal(0.05), Delay(3.0))
    found = reference(contacts, motor(3.0, 0.9))
    drive = Programme(
        [Segment(3.0, time=60.0)], "stationary", found.velocity.value, stall_force=0.9
    )
    run = transient(contacts, drive, 61)
    speed = (run.X[-1] - run.X[30]) / (run.t[-1] - run.t[30])
    error = math.hypot(run.X_error[-1], run.X_error[30]) / 30.0
    assert abs(speed - found.velocity.value) < 2.0 * error + 1e-4


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        (motor(1.0, 0.5), "stall_force = 0.5: friction stops the motor"),
        (motor(1.0, 3.0, stage=Stage(1.0)), "a motor has steady averages at one"),
        (motor(-1.0, 3.0), "a motor has steady averages at one velocity > 0"),
        (motor(0.0, 3.0), "a motor has steady averages at one velocity > 0"),
    ],
)
def test_refused(drive, said):
    with pytest.raises(InputError, match=said):
        reference(Ensemble(), drive)


def test_commands(tmp_path):
    """`eqsim reference` and `eqsim steady`, which simulates at the velocity found."""
    path = tmp_path / "motor.toml"
    path.write_text(
        "[contacts]\nstiffness_law = 'uniform'\n[thermal]\nkT = 0.1\n"
        "[drive]\nvelocity = 0.5\nstall_force = 1.5\ntime = 1.0\n"
    )
    run = CliRunner().invoke(app, ["reference", str(path), "--json"])
    assert run.exit_code == 0, run.output
    known = json.loads(run.stdout)
    expected = 0.5 * (1.0 - known["friction"] / 1.5)
    assert known["velocity"] == pytest.approx(expected, rel=1e-9, abs=0)
    run = CliRunner().invoke(app, ["steady", str(path), "--json", "--quiet"])
    assert run.exit_code == 0, run.output
    assert abs(json.loads(run.stdout)["z"]["friction"]) < 4.5
