"""Speeds of fronts against numbers found twice, closed forms, slow limits and chains of
blocks followed in time."""

import math

import numpy as np
import pytest

from eqsim import InputError, front_prestress, front_speed
from eqsim.master.chain_fronts import decay


def chain(K, K_d, M, eta):
    return {"coupling": K, "drive_stiffness": K_d, "mass": M, "damping": eta}


REATTACHED = [
    (chain(1, 0, 0, 1), 0.5, 0.74675611),
    (chain(20, 0, 0, 1), 5.0, 0.75580050),
    (chain(20, 0, 1, 1), 3.0, 0.71613861),
    (chain(1, 0, 1, 0.1), 0.8, 0.66217306),
]
DETACHED = [
    (chain(20, 0.25, 0, 1), 2.0, 0.57600164),
    (chain(20, 0.25, 1, 0.5), 4.0, 0.73345375),
    (chain(5, 0.5, 1, 2), 1.5, 0.86758195),
]
RIGID = [(0.5, 1, 0.85365), (0.3, 1, 0.56648), (0.5, 5, 0.24685), (0.8, 2, 1.27159)]


@pytest.mark.parametrize(
    ("contacts", "blocks", "speed", "prestress"),
    [("reattached", *row) for row in REATTACHED]
    + [("detached", *row) for row in DETACHED],
)
def test_prestress_and_speed_of_contacts_with_stiffness(
    contacts, blocks, speed, prestress
):
    found = front_prestress(speed, **blocks, contacts=contacts)
    assert found.value == pytest.approx(prestress, rel=0, abs=6e-9)
    assert found.stderr < 1e-9
    back = front_speed(found.value, **blocks, contacts=contacts)
    assert back.value == pytest.approx(speed, rel=1e-9, abs=0)


def test_speeds_of_blocks_with_static_and_kinetic_friction():
    for prestress, damping, speed in RIGID:
        found = front_speed(prestress, 1.0, mass=1.0, damping=damping, contacts="rigid")
        assert found.value == pytest.approx(speed, rel=0, abs=6e-6)
    other = chain(6.0, 0.0, 1.5, 3.0 * damping)  # other units of time and force
    scaled = front_speed(prestress, **other, contacts="rigid")
    assert scaled.value == pytest.approx(2.0 * found.value, rel=1e-9, abs=0)
    for prestress in (0.6, 0.8):
        found = front_speed(prestress, 4.0, mass=1.0, contacts="rigid")
        sound = 2.0 / math.sqrt(1.0 - prestress**2)
        assert found.value == pytest.approx(sound, rel=1e-10, abs=0)


def test_fronts_faster_than_sound():
    known = {(1.0, 0.5): 1.03878, (1.0, 0.8): 1.13890, (0.1, 0.5): 1.01288}
    for (k0, prestress), speed in known.items():
        blocks = {"coupling": 1.0 / k0, "mass": 1.0 / k0, "contacts": "detached"}
        found = front_speed(prestress, **blocks)
        assert found.value == pytest.approx(speed, rel=0, abs=6e-6)
        # the closed form is the limit of the integral, to 20 eta^2
        rough, fine = (
            front_prestress(found.value, **blocks, damping=eta).value
            for eta in (2e-3, 1e-3)
        )
        assert 2.0 * fine - rough == pytest.approx(prestress, rel=0, abs=1e-4)


def trapping_prestress(coupling, drive_stiffness=0.0, contacts="reattached"):
    """Prestress below which a chain without inertia traps a front: stretches fall by z
    at each block, a + 2 K = K (z + 1/z), a = 1 + K_d ahead, and behind "detached"
    contacts with a = K_d; 0 without plate springs, as a force that does not fall breaks
    any contacts in the end."""
    ahead = 1.0 + drive_stiffness
    if contacts == "reattached":
        return 1.0 - 0.5 / ahead + 0.5 / math.sqrt(ahead**2 + 4.0 * ahead * coupling)
    z_a, z_b = decay(coupling, ahead), decay(coupling, drive_stiffness)
    return 1.0 / (1.0 + z_a * (1.0 - z_b) / ((1.0 - z_a * z_b) * drive_stiffness))


def test_slow_fronts_are_trapped():
    assert trapping_prestress(20.0) == pytest.approx(5.0 / 9.0, rel=1e-12, abs=0)
    assert trapping_prestress(1.0) == pytest.approx(0.723607, rel=1e-6, abs=0)
    for contacts in ("reattached", "detached"):
        slow = front_prestress(1e-2, **chain(20, 0.25, 0, 1), contacts=contacts).value
        least = trapping_prestress(20.0, 0.25, contacts=contacts)
        assert slow == pytest.approx(least, rel=4e-5, abs=0)


def followed(prestress, blocks, contacts, dt):
    """Speed of the front in a chain of 60 blocks of stretch `prestress`, the first 30
    of which have broken, by steps of Heun's method."""
    K, K_d, M, eta = (float(x) for x in blocks.values())
    x, u, V = np.full(60, prestress), np.zeros(60), np.zeros(60)
    hold, when = np.ones(60), np.full(60, np.nan)
    if contacts == "reattached":  # and have come to rest
        u[:30] = 1.0
    else:
        hold[:30] = 0.0

    def rates(u, x, V):
        pull = np.diff(u, prepend=u[0], append=u[-1])
        net = prestress - K_d * u - hold * x + K * np.diff(pull)
        return (V, (net - eta * V) / M) if M else (net / eta, np.zeros(60))

    for step in range(20_000):
        one = rates(u, x, V)
        two = rates(u + dt * one[0], x + dt * one[0], V + dt * one[1])
        moved = 0.5 * dt * (one[0] + two[0])
        u, x, V = u + moved, x + moved, V + 0.5 * dt * (one[1] + two[1])
        for j in np.flatnonzero((x >= 1.0) & (hold > 0.0)):
            over = (x[j] - 1.0) / moved[j]
            when[j] = when[j] if when[j] > 0.0 else (step + 1 - over) * dt
            x[j], hold[j] = over * moved[j], float(contacts == "reattached")
        if when[55] > 0.0:
            return 10.0 / (when[55] - when[45])
    return 0.0


@pytest.mark.parametrize(
    ("contacts", "row"),
    [
        ("reattached", (chain(1, 0, 1, 1), 0.6, None)),
        ("detached", DETACHED[2]),
    ],
)
def test_fronts_of_blocks_followed_in_time(contacts, row):
    """Breaks end at steps, and speeds are of first order in the step, 3e-3 or less.
    With 5 % less prestress the speed is another one."""
    blocks, speed, _ = row
    prestress = front_prestress(speed, **blocks, contacts=contacts).value
    found = followed(prestress, blocks, contacts, 0.006)
    assert found == pytest.approx(speed, rel=5e-3, abs=0)
    other = followed(0.95 * prestress, blocks, contacts, 0.03)
    assert abs(other / speed - 1.0) > 0.03


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: front_speed(0.5, 20.0, damping=1.0), "no steady front"),
        (lambda: front_speed(1.0, 20.0, damping=1.0), "prestress = 1.0"),
        (lambda: front_speed(0.5, 0.0, damping=1.0), "coupling = 0.0"),
        (lambda: front_prestress(0.0, 1.0, damping=1.0), "speed = 0.0"),
        (lambda: front_prestress(0.5, 1.0, mass=1.0, contacts="rigid"), "sqrt"),
        (lambda: front_prestress(0.5, 1.0), "damping = 0: must be > 0 without a mass"),
        (lambda: front_prestress(2.0, 1.0, mass=1.0), "damping = 0: must be > 0 where"),
        (lambda: front_prestress(1.1, 1.0, mass=1.0, damping=1.0), "break again"),
        (lambda: front_prestress(1e-5, 1.0, damping=1.0), "trapped"),
        (lambda: front_prestress(0.5, 1.0, damping=1e-200), "at least 1e-100"),
        (lambda: front_prestress(1.0, 1.0, damping=1.0, contacts="fast"), "contacts"),
        (
            lambda: front_speed(0.5, 1.0, damping=1.0, drive_stiffness=1.0, contacts="rigid"),
            "drive_stiffness = 1",
        ),
    ],
)  # fmt: skip
def test_what_is_refused_is_named(call, said):
    with pytest.raises(InputError, match=said):
        call()


@pytest.mark.parametrize(
    ("speed", "coupling", "chain", "contacts", "exact"),
    [
        (80.58, 75.6, (0.0, 0.636, 0.0022), "detached", 0.97464195827142),
        (30.0, 1.0, (0.0, 1.0, 0.01), "detached", 0.99942715692565),
        (3000.0, 1.0, (0.0, 1.0, 0.0), "reattached", 0.99999994443212),
        (30.0, 1.0, (1e-4, 1.0, 0.0), "reattached", 0.99944012803045),
        (30.0, 1.0, (1e-6, 1.0, 0.0), "reattached", 0.99943390492873),
        (3.0, 1.0, (1e-4, 1.0, 0.1), "detached", 0.94164566313220),
        (3.0, 1.0, (1e-4, 1.0, 0.0), "rigid", 0.72463146277800),
    ],
)
def test_fast_fronts_of_heavily_damped_blocks(speed, coupling, chain, contacts, exact):
    """Against panels of a 32nd of a period up to 16 384 periods, and logarithmic ones
    below the first: damping outweighs springs far below a period, and inertia damping
    far beyond."""
    mass, damping, drive_stiffness = chain
    found = front_prestress(
        speed,
        coupling,
        mass=mass,
        damping=damping,
        drive_stiffness=drive_stiffness,
        contacts=contacts,
    )
    assert abs(found.value - exact) <= found.stderr + 1e-13
    assert found.stderr < 1e-6


@pytest.mark.parametrize(
    ("contacts", "blocks", "speed", "exact"),
    [
        ("reattached", chain(1, 0.1, 1, 1e-6), 0.7, 0.638761740251),
        ("reattached", chain(1, 0.1, 1, 1e-12), 0.7, 0.638761518576),
        ("reattached", chain(20, 0.5, 1, 1e-6), 3.9, 0.694888300904),
        ("reattached", chain(100, 0, 1, 1e-5), 8.0, 0.503210906287),
        ("detached", chain(8, 0.3, 2, 1e-6), 1.1, 0.485914205237),
        ("rigid", chain(1, 0, 1, 1e-6), 1.3, 0.638971239677),
        ("rigid", chain(20, 0, 1, 1e-6), 6.0, 0.666666699216),
    ],
)
def test_fronts_of_weakly_damped_blocks(contacts, blocks, speed, exact):
    """Against panels along the real axis that halve towards each root of Re Lam and of
    its derivative, to 12 digits; extrapolated to no damping for that of 1e-12."""
    found = front_prestress(speed, **blocks, contacts=contacts)
    assert abs(found.value - exact) <= found.stderr + 5e-13
    assert found.stderr < 2e-11
    back = front_speed(found.value, **blocks, contacts=contacts)
    assert back.value == pytest.approx(speed, rel=1e-9, abs=0)


@pytest.mark.parametrize("contacts", ["detached", "rigid"])
@pytest.mark.parametrize(("speed", "coupling"), [(1.3, 1.0), (9.0, 20.0)])
def test_weakly_damped_fronts_have_the_undamped_limit(contacts, speed, coupling):
    """The damping of 1e-12 shifts them by less than 1e-11, in proportion to it."""
    blocks = {"coupling": coupling, "mass": 1.0, "contacts": contacts}
    exact = front_prestress(speed, **blocks).value
    for damping in (1e-12, 1e-80):
        found = front_prestress(speed, **blocks, damping=damping)
        assert abs(found.value - exact) <= found.stderr + 1e-11


def test_a_resonance_that_begins_has_an_error():
    """Where the wave's frequency is a double root of Re Lam: against panels along the
    real axis, whose rounding is 1e-10."""
    speed = 0.9810198819672862 * (1.0 - 1e-8)
    found = front_prestress(speed, **chain(20, 0.5, 1, 1e-6))
    assert abs(found.value - 7.21604078679) <= found.stderr + 5e-10
    assert found.stderr < 1e-8


def test_a_front_that_is_all_but_trapped_has_an_error():
    found = front_prestress(2.9145698283218537e-4, 1.0, damping=1.0)
    assert 0.0 < found.stderr < 0.01
    assert abs(found.value - trapping_prestress(1.0)) < 2.0 * found.stderr
