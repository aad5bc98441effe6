"""Drag of detached contacts: a constant force, and a power of the velocity."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eqsim import (
    Delay,
    Drive,
    Elastic,
    Ensemble,
    InputError,
    Programme,
    Segment,
    Stage,
    Thermal,
    Viscosity,
    elastic_trajectory,
    reference,
    steady,
    trajectory,
    transient,
)

CONTACTS = Ensemble(thermal=Thermal(0.1), delay=Delay(1.0), count=50_000, stiffness=2.0)
LAWS = [
    (Viscosity(), 0.3, 0.3 * 0.7),
    (Viscosity(force=0.2), 0.0, 0.2),
    (Viscosity(exponent=5.0), 0.3, 0.3 * 0.7**5),
    (Viscosity(0.1, exponent=0.0, reference_velocity=2.0), 0.3, 0.1 + 0.3 * 2.0),
]


@pytest.mark.parametrize(("law", "eta", "drag"), LAWS)
def test_steady_friction(law, eta, drag):
    """Friction is that without drag and drag/k of the detached share, by the reference
    and by the engine, |z| < 4.5; without the law it is not."""
    bare = reference(CONTACTS, Drive(0.7))
    known = bare.friction.value + drag / 2.0 * (1.0 - bare.pinned.value)
    contacts = replace(CONTACTS, eta=eta, viscosity=law)
    exact = reference(contacts, Drive(0.7)).friction.value
    assert exact == pytest.approx(known, rel=1e-12, abs=0)
    found = steady(contacts, Drive(0.7), rel_error=1e-4).friction
    assert abs(found.value - known) < 4.5 * found.stderr
    assert abs(found.value - bare.friction.value) > 4.5 * found.stderr


@pytest.mark.verification
@pytest.mark.parametrize(("law", "eta", "drag"), LAWS[1:])
def test_a_programme(law, eta, drag):
    """The drag turns with the motion, and a hold has none: 5e4 contacts, |z| < 4.5 at
    60 instants. Negative control: eta v alone."""
    contacts = replace(CONTACTS, eta=eta, viscosity=law)
    segments = Segment(0.7, distance=2.0), Segment(0.0, time=1.0), Segment(-1.4, time=1)
    programme = Programme(segments)
    exact = transient(contacts, programme, points=61, variance=True)
    bare = transient(CONTACTS, programme, points=61)
    moving = np.repeat([0.0, law.force + eta * 0.7 * law.factor(0.7), 0.0], (1, 20, 20))
    added = np.append(moving, np.full(20, -(law.force + eta * 1.4 * law.factor(1.4))))
    drags = added / 2.0 * (1.0 - bare.pinned)
    np.testing.assert_allclose(exact.force, bare.force + drags, rtol=0, atol=1e-12)
    for kind, agrees in ((contacts, True), (replace(CONTACTS, eta=eta), False)):
        run = trajectory(kind, programme, points=61)
        error = np.hypot(run.force_stderr, exact.force_error)[1:]
        z = np.abs(run.force - exact.force)[1:] / error
        assert (z.max() < 4.5) == agrees
    drive = Drive(0.7, 2.0)
    constant = transient(contacts, drive, points=21).force
    known = transient(CONTACTS, drive, points=21)
    np.testing.assert_allclose(
        constant, known.force + drag / 2.0 * (1.0 - known.pinned), rtol=0, atol=1e-12
    )


def test_extremes():
    """No power overflows: refused in a line where the drag is not finite."""
    assert Viscosity(exponent=10.0).factor(1e-300) == 0.0
    contacts = replace(CONTACTS, eta=1e90, viscosity=Viscosity(exponent=10.0))
    assert math.isfinite(Viscosity(exponent=10.0).factor(1e300))
    with pytest.raises(InputError, match=r"eta \* velocity"):
        reference(contacts, Drive(1e40))


def test_refused():
    pulled = Programme([Segment(1.0, distance=1.0)], stage=Stage(1.0))
    for law, key in ((Viscosity(0.2), "force"), (Viscosity(exponent=2.0), "exponent")):
        contacts = replace(CONTACTS, eta=0.3, viscosity=law)
        for call in (trajectory, transient):
            with pytest.raises(InputError, match=rf"viscosity\.{key} = .*drive\.stage"):
                call(contacts, pulled)
    cold = Ensemble(count=1000, stiffness_law="uniform", viscosity=Viscosity(0.2))
    blocks = Drive(1.0, 1.0, elastic=Elastic(10, 0.1, 1.0))
    with pytest.raises(InputError, match=r"viscosity\.force = 0\.2: must be 0"):
        elastic_trajectory(cold, blocks)
    with pytest.raises(InputError, match=r"exponent = -1\.0"):
        Viscosity(exponent=-1.0)
