"""Laws that hold everywhere in the parameter space: units scale out, what is proven to
rise rises, limits are reached, no contact gets lost, and nothing is ever NaN. A few
examples here, many more with -m verification."""

import dataclasses
import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rows import BASIC

from eqsim import (
    Aging,
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    Table,
    Thermal,
    load,
    reference,
    steady,
    trajectory,
)
from eqsim.estimate import Estimate, z_score
from eqsim.io.parameters import parameters
from eqsim.io.runfile import check
from eqsim.io.storage import to_json
from eqsim.materials import MATERIALS, run_file_text


def everywhere(few, many, **strategies):
    """Two tests of a property: `few` examples always, `many` with -m verification."""

    def tests_of(body):
        for name, number, mark in (
            (f"test_{body.__name__}", few, lambda test: test),
            (f"test_many_{body.__name__}", many, pytest.mark.verification),
        ):
            rules = settings(
                max_examples=number, derandomize=True, deadline=None, database=None
            )
            globals()[name] = mark(rules(given(**strategies)(body)))
        return body

    return tests_of


def logarithmic(low, high):
    """Numbers equally likely in each decade."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda x: 10.0**x)


LAWS = st.sampled_from(
    [Gamma(0.0), Gamma(1.0), Gamma(2.5), Delta(), Table([0.4, 1.0, 0.7, 2.0])]
)
TEMPERATURES = st.one_of(st.just(0.0), logarithmic(0.02, 2.0))
AGINGS = st.one_of(
    st.just(Aging()),
    st.builds(Aging, st.just("flow"), logarithmic(0.01, 10.0), st.floats(0.5, 2.0)),
)
VELOCITIES = logarithmic(0.05, 20.0)


@st.composite
def ensembles(
    draw,
    laws=LAWS,
    temperatures=TEMPERATURES,
    agings=AGINGS,
    disorder=("quenched", "annealed"),
):
    """Contacts with k = omega = x_* = 1; only gamma laws age."""
    law = draw(laws)
    return Ensemble(
        law,
        Thermal(draw(temperatures), 1.0, draw(st.sampled_from(["soft", "stiff"]))),
        Delay(
            draw(st.sampled_from([0.0, 0.5, 3.0])),
            draw(st.sampled_from(["fixed", "exponential"])),
        ),
        draw(agings) if isinstance(law, Gamma) else Aging(),
        count=draw(st.integers(1, 40)),
        stiffness_law=draw(st.sampled_from(["sqrt", "uniform"])),
        disorder=draw(st.sampled_from(disorder)),
        eta=draw(st.sampled_from([0.0, 0.7])),
    )


def values(result):
    return np.array([getattr(result, name).value for name in BASIC])


def errors(result):
    return np.array([getattr(result, name).stderr for name in BASIC])


def close(one, other, relative):
    """Two exact answers, within their own errors and `relative` of rounding."""
    far = np.abs(values(one) - values(other))
    assert np.all(
        far <= errors(one) + errors(other) + relative * np.abs(values(other))
    ), (one, other)


# ---- units ----


def in_units(e, velocity, length, time, force, aging_too=True):
    """The same contacts and drive in other units; `aging_too` False forgets the rate D."""
    law = e.thresholds
    law = (
        Table(law.steps * length)
        if isinstance(law, Table)
        else dataclasses.replace(law, x_star=law.x_star * length)
    )
    rate = e.aging.rate * (length**2 / time if aging_too else 1.0)
    return (
        dataclasses.replace(
            e,
            thresholds=law,
            thermal=Thermal(
                e.thermal.kT * force * length,
                e.thermal.attempt_frequency / time,
                e.thermal.barrier,
            ),
            delay=Delay(e.delay.time * time, e.delay.law),
            aging=dataclasses.replace(
                e.aging, rate=rate, x_star_final=e.aging.x_star_final * length
            )
            if e.aging.active
            else e.aging,
            stiffness=e.stiffness * force / length,
            eta=e.eta * force * time / length,
        ),
        Drive(velocity * length / time),
    )


SCALES = logarithmic(1e-12, 1e12)


@everywhere(
    15,
    300,
    e=ensembles(),
    velocity=VELOCITIES,
    length=SCALES,
    time=SCALES,
    force=SCALES,
)
def units_scale_out_of_the_reference(e, velocity, length, time, force):
    """Rounding of the groups, some 1e-15, grows by b <= 25 times a few in the
    exponents: far below 1e-10. At T = 0 and T > 0, delay, drag and aging alike."""
    ours, theirs = (
        reference(e, Drive(velocity)),
        reference(*in_units(e, velocity, length, time, force)),
    )
    np.testing.assert_allclose(
        values(theirs), values(ours) * [length, 1.0, length], rtol=1e-10
    )


def test_units_of_the_aging_rate_matter():
    """Negative control: the property above fails where D is not scaled."""
    e = Ensemble(aging=Aging("flow", 0.3, 2.0))
    ours, theirs = (
        reference(e, Drive(1.0)),
        reference(*in_units(e, 1.0, 2.0, 1.0, 1.0, aging_too=False)),
    )
    assert abs(theirs.friction.value / ours.friction.value / 2.0 - 1.0) > 1e-3


POWERS = st.integers(-40, 40).map(lambda power: 2.0**power)


@everywhere(
    4,
    100,
    e=ensembles().filter(lambda e: not e.self_consistent),
    velocity=VELOCITIES,
    length=POWERS,
    time=POWERS,
    force=POWERS,
)
def powers_of_two_change_no_bit_of_the_engine(e, velocity, length, time, force):
    """All groups are the same floating-point numbers, but ln(omega x_*/v), which is a
    sum of rounded logarithms: at T > 0 lengths and times stay as they are. Annealed
    contacts that age are found by iterations that stop at rounding errors: left out."""
    if e.thermal.kT > 0:
        length = time = 1.0
    other, faster = in_units(e, velocity, length, time, force)
    ours, theirs = (
        steady(x, drive, rel_error=0.05)
        for x, drive in ((e, Drive(velocity)), (other, faster))
    )
    assert [*values(theirs)] == [*(values(ours) * [length, 1.0, length])]
    assert [*errors(theirs)] == [*(errors(ours) * [length, 1.0, length])]
    drive = Drive(velocity, 5.0)
    run = trajectory(e, drive, points=21)
    same = trajectory(other, Drive(faster.velocity, 5.0 * length), points=21)
    assert np.array_equal(run.force * length, same.force)
    assert np.array_equal(run.pinned, same.pinned)


# ---- what rises and what falls ----

FRESH = st.just(Aging())
WARM = logarithmic(0.02, 2.0)


@everywhere(
    15,
    200,
    e=ensembles(temperatures=WARM, agings=FRESH, disorder=("annealed",)),
    velocity=VELOCITIES,
    factor=st.floats(1.05, 20.0),
)
def annealed_friction_rises_with_velocity(e, velocity, factor):
    """f_k of the published master equation without aging and with k_i = k: f_k' > 0, up
    to the errors of both."""
    e = dataclasses.replace(e, stiffness_law="uniform")
    slow, fast = (reference(e, Drive(v)).f_k for v in (velocity, velocity * factor))
    assert fast.value >= slow.value - slow.stderr - fast.stderr


def test_literal_friction_may_fall_with_velocity():
    """Negative control: quenched contacts with the sqrt law, given as 1.031 and .886."""
    e = Ensemble(thermal=Thermal(1.0))
    slow, fast = (reference(e, Drive(v)).f_k.value for v in (1e-4, 1e-3))
    assert fast < slow - 0.1


@everywhere(
    15,
    200,
    e=ensembles(),
    velocity=VELOCITIES,
    tau=logarithmic(1e-3, 1e3),
    factor=st.floats(1.05, 20.0),
)
def pinned_falls_with_delay(e, velocity, tau, factor):
    """And is C/(C + v tau) (eq:ncnf) with the C of no delay, to rounding; friction
    without drag likewise."""
    e = dataclasses.replace(e, eta=0.0)
    delays = [Delay(time, e.delay.law) for time in (0.0, tau, factor * tau)]
    none, short, long = (
        reference(dataclasses.replace(e, delay=delay), Drive(velocity))
        for delay in delays
    )
    assert long.pinned.value < short.pinned.value < none.pinned.value == 1.0
    C = none.break_stretch.value
    assert short.break_stretch.value == pytest.approx(C, rel=1e-12, abs=0)
    assert short.pinned.value == pytest.approx(
        C / (C + velocity * tau), rel=1e-12, abs=0
    )
    assert short.friction.value == pytest.approx(
        none.friction.value * C / (C + velocity * tau), rel=1e-12, abs=0
    )


@everywhere(
    10,
    100,
    e=ensembles(temperatures=st.just(0.0), agings=FRESH),
    velocity=VELOCITIES,
    other=VELOCITIES,
)
def velocity_is_nothing_to_cold_friction(e, velocity, other):
    """f_k at T = 0 without aging, whatever the delay; both ensembles are the same
    there."""
    one, two = reference(e, Drive(velocity)), reference(e, Drive(other))
    flipped = dataclasses.replace(
        e, disorder="annealed" if e.disorder == "quenched" else "quenched"
    )
    assert one.f_k.value == pytest.approx(two.f_k.value, rel=1e-12, abs=0)
    assert one.f_k.value == pytest.approx(
        reference(flipped, Drive(velocity)).f_k.value, rel=1e-12, abs=0
    )


# ---- limits ----


@everywhere(
    12,
    150,
    e=ensembles(laws=st.sampled_from([Gamma(1.0), Gamma(2.5), Delta()]), agings=FRESH),
    v=VELOCITIES,
)
def no_temperature(e, v):
    """At b = 5e8, kT = 1e-9. A contact breaks where its barrier is ln(w b) or less, w =
    omega x_*/v <= 20: at xi^2 - x^2 ~ ln(w b)/b (soft) or (1 - x/xi)^1.5 ~ ln(w b)/b
    (stiff), and annealed ones meet w times as many weak ones; <xi^-3> <= sqrt(pi) for
    the laws here. Ten times that."""
    b, w = 5e8, 1.0 / v
    cold = dataclasses.replace(e, thermal=Thermal(0.0, 1.0, e.thermal.barrier))
    cool = dataclasses.replace(e, thermal=Thermal(1e-9, 1.0, e.thermal.barrier))
    early = (5.0 + math.log(b) + abs(math.log(w)) + w) / b
    relative = 10.0 * early ** (1.0 if e.thermal.barrier == "soft" else 2.0 / 3.0)
    close(reference(cool, Drive(v)), reference(cold, Drive(v)), relative)


@everywhere(
    12,
    150,
    e=ensembles(temperatures=WARM, agings=FRESH),
    rarely=logarithmic(1e-9, 1e-5),
)
def no_attempts(e, rarely):
    """omega -> 0 and v -> inf: the hazard of a life is at most omega x/v, which changes
    work and stretch by a share of at most omega <xi^3>/(v <xi^2>) < 4 omega/v for the
    laws here. No attempts at all are T = 0 to the bit."""
    cold = dataclasses.replace(e, thermal=Thermal(0.0, 1.0, e.thermal.barrier))
    never = dataclasses.replace(
        e, thermal=Thermal(e.thermal.kT, 0.0, e.thermal.barrier)
    )
    seldom = dataclasses.replace(
        e, thermal=Thermal(e.thermal.kT, rarely, e.thermal.barrier)
    )
    assert reference(never, Drive(1.0)) == reference(cold, Drive(1.0))
    close(reference(seldom, Drive(1.0)), reference(cold, Drive(1.0)), 8.0 * rarely)
    still = dataclasses.replace(e, delay=Delay(), eta=0.0)
    close(
        reference(still, Drive(1.0 / rarely)),
        reference(
            dataclasses.replace(cold, delay=Delay(), eta=0.0), Drive(1.0 / rarely)
        ),
        8.0 * rarely,
    )


@everywhere(
    8,
    60,
    e=ensembles(
        laws=st.sampled_from([Gamma(0.0), Gamma(1.0), Gamma(2.5)]), agings=FRESH
    ),
    velocity=VELOCITIES,
    rate=logarithmic(1e-3, 1e3),
)
def aging_to_the_same_law_is_none(e, velocity, rate):
    """x_*f = x_*i, along the flow and for annealed contacts, whose pooled law is a
    spline good to 2e-8 in P_c."""
    aged = dataclasses.replace(e, aging=Aging("flow", rate, 1.0))
    close(
        reference(aged, Drive(velocity)),
        reference(e, Drive(velocity)),
        2e-7 if e.disorder == "annealed" else 1e-8,
    )


@everywhere(
    8, 60, velocity=VELOCITIES, rate=logarithmic(0.05, 1.0), final=st.floats(1.1, 2.0)
)
def aging_to_another_law_is_some(velocity, rate, final):
    """Negative control of the above: stronger contacts carry more."""
    plain, aged = Ensemble(Gamma()), Ensemble(Gamma(), aging=Aging("flow", rate, final))
    weak, strong = (reference(e, Drive(velocity)).friction.value for e in (plain, aged))
    assert strong > weak + 1e-5


# ---- order and number ----

TABLES = st.lists(logarithmic(0.01, 100.0), min_size=1, max_size=12)


@everywhere(
    8,
    80,
    steps=TABLES,
    e=ensembles(laws=st.just(Delta()), agings=FRESH),
    v=VELOCITIES,
    chance=st.randoms(),
)
def order_of_a_table_is_nothing(steps, e, v, chance):
    """The same bits in any order; twice the same contacts are the same law, but for the
    rounding of means over them: that of the thresholds, the unit of length, is off by
    an eps or two, which exponents may multiply."""
    shuffled = steps.copy()
    chance.shuffle(shuffled)
    one, other, twice = (
        dataclasses.replace(e, thresholds=Table(x))
        for x in (steps, shuffled, steps + shuffled)
    )
    drive = Drive(v)
    assert reference(one, drive) == reference(other, drive)
    assert [*values(steady(one, drive, rel_error=0.1))] == [
        *values(steady(other, drive, rel_error=0.1))
    ]
    np.testing.assert_allclose(
        values(reference(twice, drive)), values(reference(one, drive)), rtol=1e-12
    )


@everywhere(
    4,
    300,
    e=ensembles(),
    velocity=VELOCITIES,
    distance=logarithmic(0.1, 30.0),
    start=st.sampled_from(["fresh", "stationary"]),
    replicas=st.integers(1, 3),
    seed=st.integers(0, 2**63 - 1),
)
def no_contact_is_lost(e, velocity, distance, start, replicas, seed):
    """At every point a whole number of contacts is pinned, from none to all; all at a
    fresh start, all forever without delay; and no value is NaN. A share of 120 contacts
    is a whole number to 120 roundings of 1e-16."""
    run = trajectory(
        e, Drive(velocity, distance, start), points=31, seed=seed, replicas=replicas
    )
    pinned = run.pinned * e.count * replicas
    assert np.all(np.abs(pinned - np.rint(pinned)) < 1e-12)
    assert run.pinned.min() >= 0
    assert run.pinned.max() <= 1
    if start == "fresh":
        assert (run.pinned[0], run.force[0]) == (1.0, 0.0)
    if e.delay.time == 0:
        assert np.all(run.pinned == 1.0)
    for array in (
        run.X,
        run.t,
        run.force,
        run.force_stderr,
        run.pinned,
        run.pinned_stderr,
    ):
        assert np.all(np.isfinite(array))
    assert np.all(run.force >= -1e-12)
    summary = [estimate.as_dict() for estimate in run.averages.averages().values()]
    assert not any(
        isinstance(x, float) and math.isnan(x)
        for part in summary
        for x in part.values()
    )


# ---- run files ----

CONTENT = st.fixed_dictionaries(
    {"drive": st.fixed_dictionaries({"velocity": logarithmic(1e-90, 1e90)})},
    optional={
        "title": st.text(
            st.characters(codec="utf-8", exclude_characters="\x7f"), max_size=50
        ),
        "disorder": st.sampled_from(["quenched", "annealed"]),
        "contacts": st.fixed_dictionaries(
            {}, optional={"count": st.integers(1, 10**12), "stiffness": SCALES}
        ),
        "thresholds": st.fixed_dictionaries(
            {}, optional={"n": st.floats(0.0, 1e3), "x_star": SCALES}
        ),
        "thermal": st.fixed_dictionaries(
            {}, optional={"kT": st.floats(0.0, 1e90), "barrier": st.just("stiff")}
        ),
        "delay": st.fixed_dictionaries(
            {}, optional={"time": st.floats(0.0, 1e90), "law": st.just("exponential")}
        ),
        "output": st.fixed_dictionaries(
            {}, optional={"seed": st.integers(0, 2**63 - 1)}
        ),
    },
)


def toml(content):
    """Sections of numbers and text, which JSON writes as TOML does."""
    lines = [
        f"{key} = {json.dumps(value, ensure_ascii=False)}"
        for key, value in content.items()
        if not (value is None or isinstance(value, dict))
    ]
    for section, part in content.items():
        if isinstance(part, dict):
            lines += [
                f"[{section}]",
                *(
                    f"{key} = {json.dumps(x)}"
                    for key, x in part.items()
                    if x is not None
                ),
            ]
    return "\n".join(lines) + "\n"


@everywhere(100, 2000, content=CONTENT)
def a_run_file_survives_a_round_trip(content):
    """Content, checked, dumped and checked again: the same file, contacts and drive to
    the bit; -0.0 is 0.0."""
    file = check(content)
    again = check(file.settings)
    assert again == file
    assert parameters(again) == parameters(file)
    assert again.ensemble == file.ensemble
    assert again.drive == file.drive


@everywhere(60, 500, content=CONTENT)
def a_run_file_survives_its_text(content):
    """The same through TOML on disk."""

    file = check(content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.toml"
        path.write_text(toml(file.settings | {"sweep": {}}), encoding="utf-8")
        # files are equal if their texts are, too
        assert load(path).settings == file.settings


@everywhere(
    20,
    200,
    name=st.sampled_from(sorted(MATERIALS)),
    kelvin=st.floats(1.0, 2000.0),
    v=logarithmic(1e-12, 1e3),
    disorder=st.sampled_from(["quenched", "annealed"]),
)
def a_material_survives_its_run_file(name, kelvin, v, disorder):

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.toml"
        path.write_text(
            run_file_text(MATERIALS[name], kelvin, v, disorder=disorder),
            encoding="utf-8",
        )
        file = load(path)
    assert file.ensemble == MATERIALS[name].ensemble(kelvin, disorder=disorder)
    distance = 20.0 * MATERIALS[name].x_star
    assert file.drive == Drive(v, float(f"{distance:.15g}"))


# ---- no NaN ----

NUMBERS = st.one_of(st.floats(-1e100, 1e100), st.just(0.0))
SIGMAS = st.floats(0.0, 1e100)


@everywhere(
    200,
    5000,
    value=NUMBERS,
    stderr=SIGMAS,
    exact=NUMBERS,
    error=SIGMAS,
    dof=st.one_of(st.none(), st.integers(1, 63)),
)
def a_score_is_never_nan(value, stderr, exact, error, dof):
    """For whatever lies in the range of results; none at all if both errors are 0; of
    the sign of the difference."""
    z = z_score(Estimate(value, stderr, 1, dof), exact, error)
    assert (z is None) == (math.hypot(stderr, error) == 0)
    assert z is None or not math.isnan(z)
    assert z is None or z * (value - exact) >= 0


JSON = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text(max_size=3), inner, max_size=4),
    ),
    max_leaves=12,
)


@everywhere(200, 2000, data=JSON)
def json_is_never_nan(data):
    """Strict readers take it, and what is finite comes back."""

    def refuse(name):
        raise AssertionError(name)

    def plain(x):
        if isinstance(x, dict):
            return {key: plain(part) for key, part in x.items()}
        if isinstance(x, list):
            return [plain(part) for part in x]
        return None if isinstance(x, float) and not math.isfinite(x) else x

    assert json.loads(to_json(data), parse_constant=refuse) == plain(data)
