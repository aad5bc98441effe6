"""The long statistical run: a thousand parameter points, flat p-values, and one wrong
thing at a time.

    pytest -m verification

leaves runs/out/verification/{report.md, scores.parquet, verification.png}. Verdicts on
all points, and on all seeds, are given by the test that finishes last; what the same
code has done before is kept until its test is run again. False alarms of a correct
program: all points together once in 500 runs, flatness once in 500, any of all p-values
of all seeds once in 500, single scores beyond 6.5 once in a million.
"""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from report import PARTS, SEED, SEEDS, leave, publish
from scipy import stats

from eqsim import Distribution, Gamma, InputError, Table, validate
from eqsim.engine.stationary import stationary
from eqsim.laws.threshold import FIRST_OCTAVE, LAST_OCTAVE
from eqsim.numerics.tables import octave_edges, octave_table
from eqsim.validation import scores, verdict
from eqsim.validation.comparison import columns
from eqsim.validation.points import SUITES, Suite, sample
from eqsim.validation.verdict import ALARM, KINDS, declined, left_out

pytestmark = pytest.mark.verification

FAR = 6.5  # 8e-11 of a normal score
# kinds all of whose errors may be bounds, so that no score counts as even
BOUNDED = {"steps"}


@pytest.mark.parametrize("part", range(PARTS))
def test_parameter_space(part):
    """Engine against master equation at 1008 points: means (Z), variances (Y), hazards,
    covariances. As many scores as were declined are made, and even ones of every kind.
    """
    begin = time.perf_counter()
    result = validate("verification", seed=SEED, part=(part, PARTS))
    leave(
        f"space-{part:02d}",
        begin,
        columns(result.scores),
        left_out=left_out(result.unscored),
    )
    found = publish()
    far = [score for score in result.scores if not abs(score.z) < FAR]
    assert not far
    if "space" in found.complete:
        assert [v for v in found.verdicts if not v.passed] == []
        assert (
            min(v.count if v.kind in BOUNDED else v.even for v in found.verdicts) >= 50
        )
        assert [
            v.kind for v in found.verdicts if declined(v.kind, v.count, found.left_out)
        ] == []


@pytest.mark.parametrize("seed", SEEDS)
def test_p_values_are_flat(seed, monkeypatch):
    """Over seeds the p-value of the chi-square of every kind is uniform, that of the
    largest score, which bounds only make smaller, is at least not too often small, and
    none is too small for so many."""
    begin = time.perf_counter()
    monkeypatch.setitem(SUITES, "flat", Suite(15, 5, ((20, 2000), (100, 1000))))
    result = validate("flat", seed=seed)
    leave(
        f"flat-{seed}",
        begin,
        verdicts=[dataclasses.asdict(v) for v in result.verdicts if v.even],
    )
    found = publish()
    assert [
        v
        for v in result.verdicts
        if not min(v.p_chi_square, v.p_largest) > ALARM / len(SEEDS)
    ] == []
    if "flat" in found.complete:
        assert {kind for kind, _ in found.flatness} >= set(KINDS) - BOUNDED
        assert [at for at, p in found.flatness.items() if not p > ALARM] == []


# ------------------------------------------------------------------------------------------------
# negative controls


class Control(NamedTuple):
    """A law, what is wrong with it in the engine, the kinds that must fail; the
    ensembles it applies to, how many."""

    law: str
    wrong: str
    change: Callable
    kinds: set
    of: Callable = lambda ensemble: True
    points: int = 18


def set_(**changes):
    return lambda e: dataclasses.replace(e, **changes)


def part(name, **factors):
    """Some numbers of a part of the ensemble multiplied."""

    def change(e):
        old = getattr(e, name)
        new = {key: factor * getattr(old, key) for key, factor in factors.items()}
        return dataclasses.replace(e, **{name: dataclasses.replace(old, **new)})

    return change


def of_part(name, **changes):
    return lambda e: dataclasses.replace(
        e, **{name: dataclasses.replace(getattr(e, name), **changes)}
    )


def shape(e):
    return dataclasses.replace(
        e, thresholds=dataclasses.replace(e.thresholds, n=1.03 * e.thresholds.n + 0.01)
    )


def gamma(e):
    return isinstance(e.thresholds, Gamma)


def few(e):
    return isinstance(e.thresholds, Table) and e.thresholds.steps.size <= 12


def one_off(e):
    """The greatest threshold of a table."""
    steps = e.thresholds.steps
    return dataclasses.replace(e, thresholds=Table([*steps[:-1], 1.02 * steps[-1]]))


def many(e):
    return isinstance(e.thresholds, Table) and e.thresholds.steps.size > 12


def all_off(e):
    return dataclasses.replace(e, thresholds=Table(1.002 * e.thresholds.steps))


def of_scipy(name):
    def known(e):
        return (
            isinstance(e.thresholds, Distribution)
            and getattr(e.thresholds.frozen, "dist", stats.norm).name == name
        )

    return known


def shape_off(e):
    """Of a law of SciPy, which may have two parameters, a shape and a scale, or place
    and width."""
    frozen = e.thresholds.frozen
    law = frozen.dist(1.02 * frozen.args[0], *frozen.args[1:], **frozen.kwds)
    return dataclasses.replace(e, thresholds=Distribution(law))


def histogram(e):
    return isinstance(e.thresholds, Distribution) and isinstance(
        e.thresholds.frozen, stats.rv_histogram
    )


def bin_off(e):
    """The height of the last bin."""
    edges = e.thresholds.breakpoints
    heights = e.thresholds.pdf(0.5 * (edges[1:] + edges[:-1]))
    law = stats.rv_histogram(([*heights[:-1], 1.05 * heights[-1]], edges), density=True)
    return dataclasses.replace(e, thresholds=Distribution(law))


def soft(e):
    return e.thermal.barrier == "soft"


def stiff(e):
    return e.thermal.barrier == "stiff"


def barrier(name):
    return lambda e: e.thermal.barrier == name and e.thermal.active


def catch_off(e):
    """The rate of the pathway that force closes."""
    catch = e.thermal.catch._replace(rate=1.05 * e.thermal.catch.rate)
    return dataclasses.replace(e, thermal=dataclasses.replace(e.thermal, catch=catch))


def hot(e):
    return e.thermal.kT > 0


def langevin(e):
    return e.disorder == "quenched" and e.aging.active and e.aging.rule == "langevin"


def flow(e):
    return e.disorder == "quenched" and e.aging.active and e.aging.rule == "flow"


def slow(e):
    return flow(e) and math.isfinite(e.aging.rate)


def pooled(e):
    return e.disorder == "annealed" and e.aging.active


STEADY = {"friction", "break_stretch"}
CONTROLS = [
    Control(
        "thresholds",
        "x_* 2 % too large",
        part("thresholds", x_star=1.02),
        {*STEADY, "transient"},
        gamma,
    ),
    Control("thresholds", "n 3 % and 0.01 too large", shape, STEADY, gamma),
    Control("table", "the greatest of a few 2 % too large", one_off, STEADY, few),
    # few points: programmes of tables of many thresholds take a minute each
    Control("table", "all of many 0.2 % too large", all_off, STEADY, many, 9),
    Control("lognormal", "s 2 % too large", shape_off, STEADY, of_scipy("lognorm")),
    Control(
        "Weibull", "exponent 2 % too large", shape_off, STEADY, of_scipy("weibull_min")
    ),
    Control("Pareto", "exponent 2 % too large", shape_off, STEADY, of_scipy("pareto")),
    Control(
        "uniform",
        "least threshold 2 % too large",
        shape_off,
        STEADY,
        of_scipy("uniform"),
    ),
    Control("histogram", "last bin 5 % too likely", bin_off, STEADY, histogram),
    Control("stiffness", "k 2 % too large", set_(stiffness=1.02), STEADY),
    Control(
        "stiffness",
        "uniform instead of sqrt",
        set_(stiffness_law="uniform"),
        {"friction", "transient variance"},
    ),
    Control(
        "attempts",
        "omega 2 % too large",
        part("thermal", attempt_frequency=1.02),
        STEADY,
        hot,
    ),
    Control(
        "stiffness",
        "sqrt instead of uniform",
        set_(stiffness_law="sqrt"),
        {"friction", "transient variance"},
    ),
    Control(
        "soft",
        "stiff instead",
        of_part("thermal", barrier="stiff"),
        {*STEADY, "hazard law"},
        soft,
    ),
    Control("soft", "kT 2 % too high", part("thermal", kT=1.02), STEADY, soft),
    Control(
        "stiff",
        "soft instead",
        of_part("thermal", barrier="soft"),
        {*STEADY, "hazard law"},
        stiff,
    ),
    Control("stiff", "kT 2 % too high", part("thermal", kT=1.02), STEADY, stiff),
    Control(
        "cusp",
        "stiff instead",
        of_part("thermal", barrier="stiff"),
        STEADY,
        barrier("cusp"),
    ),
    Control(
        "Bell",
        "f_b 2 % too large",
        part("thermal", force_scale=1.02),
        STEADY,
        barrier("bell"),
    ),
    Control(
        "catch-slip", "k_c 5 % too large", catch_off, STEADY, barrier("catch-slip")
    ),
    Control("delay", "2 % too long", part("delay", time=1.02), {"friction", "pinned"}),
    Control(
        "delay",
        "exponential instead of fixed",  # nothing where delays are much shorter or longer than lives
        of_part("delay", law="exponential"),
        {"transient", "transient variance"},
        points=72,
    ),
    Control(
        "viscosity",
        "eta 5 % too large",
        lambda e: dataclasses.replace(e, eta=1.05 * e.eta),
        {"friction"},
    ),
    Control("langevin", "D 10 % too large", part("aging", rate=1.1), STEADY, langevin),
    Control(
        "langevin", "flow instead", of_part("aging", rule="flow"), STEADY, langevin
    ),
    Control("flow", "D 10 % too large", part("aging", rate=1.1), STEADY, flow),
    Control(
        "flow", "x_*f 2 % too large", part("aging", x_star_final=1.02), STEADY, flow
    ),
    Control(
        "flow", "langevin instead", of_part("aging", rule="langevin"), STEADY, slow
    ),
    Control(
        "pooled",
        "own thresholds instead",
        set_(disorder="quenched"),
        {*STEADY, "hazard law"},
    ),
    Control(
        "pooled", "births age 10 % faster", part("aging", rate=1.1), STEADY, pooled
    ),
]


def run_control(law, wrong, kinds, result, begin):
    failed = {v.kind for v in result.verdicts if not v.passed}
    verdicts = [dataclasses.asdict(v) for v in result.verdicts]
    name = "".join(c if c.isalnum() else "_" for c in f"{law}_{wrong}")
    leave(
        f"control-{name}",
        begin,
        law=law,
        wrong=wrong,
        caught=kinds <= failed,
        verdicts=verdicts,
    )
    publish()
    assert kinds <= failed


@pytest.mark.parametrize(
    "control", CONTROLS, ids=[f"{c.law}: {c.wrong}" for c in CONTROLS]
)
def test_wrong_law(control, monkeypatch):
    """One law wrong in the engine alone, at all points that know it: every kind it must
    show in fails."""
    begin = time.perf_counter()
    monkeypatch.setitem(
        SUITES,
        "control",
        Suite(control.points, control.points // 3, ((20, 2000), (100, 1000))),
    )
    monkeypatch.setattr(
        verdict, "sample", lambda count, seed, *_: knowing(control, count, seed)
    )
    result = validate("control", seed=7, wrong=control.change)
    run_control(control.law, control.wrong, control.kinds, result, begin)


def knowing(control, count, seed):
    """The first `count` points that know what is wrong, and can be drawn so."""
    knows = (
        (e, v)
        for _, e, v in sample(48 * count, seed)
        if control.of(e) and changes(control, e)
    )
    return (
        (index, e, v) for index, (e, v) in enumerate(itertools.islice(knows, count))
    )


def changes(control, e):
    try:
        return control.change(e) != e
    except InputError:  # what would be wrong cannot be
        return False


def all_pinned(c):
    """No contact found waiting."""
    return stationary(c)._replace(pinned=1.0)


def births(c):
    """Thresholds of births instead of those that a snapshot finds."""
    found = stationary(c)
    edges = octave_edges(FIRST_OCTAVE, LAST_OCTAVE)
    same = octave_table(FIRST_OCTAVE, edges, np.ones(edges.size))
    return found._replace(biased=same) if found.biased.size else found


def long_lives(c):
    """Stretches from 0 to the threshold alone, evenly: an envelope that is too high is
    harmless, one too low is not."""
    found = stationary(c)
    return found._replace(life=0.8 * found.life) if found.life.size else found


START = [
    ("all pinned", all_pinned, {"mean"}),
    ("thresholds of births", births, {"mean", "variance"}),
    ("envelope 20 % too low", long_lives, {"mean"}),
]


@pytest.mark.parametrize(
    ("wrong", "start", "kinds"), START, ids=[row[0] for row in START]
)
def test_wrong_stationary_start(wrong, start, kinds, monkeypatch):
    """What the stationary start finds is wrong."""
    begin = time.perf_counter()
    monkeypatch.setitem(SUITES, "control", Suite(36, 12, ((20, 2000), (100, 1000))))
    monkeypatch.setattr(scores, "stationary", start)
    result = validate("control", seed=7)
    assert math.isfinite(sum(v.chi_square for v in result.verdicts))
    run_control("stationary start", wrong, kinds, result, begin)
