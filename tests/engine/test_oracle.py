"""The event-driven engine against a time-stepped simulation of the same contacts, as
the time step goes to 0."""

import functools

import numpy as np
import pytest
from cases import chosen
from oracle import Contacts, settled, simulate

from eqsim import Delay, Drive, Ensemble, Gamma, Programme, Segment, Thermal, trajectory
from eqsim.laws.aging import Aging

# finer step of the oracle, in units of x_*; the coarser one is twice as long
STEP = 0.02
COUNT, ENGINE_COUNT = 30_000, 250_000  # four times as many with -m verification
RECORDS, SPACING = 6, 0.6  # compared at X = 0.6, 1.2 .. 3.6 x_*
LIMIT = 4.5
# What extrapolation leaves. The expectation of the oracle obeys a renewal equation in
# steps; solved for all the cases with steps 2h, h, h/2 and h/4 (h = STEP) it gives
# errors of first order up to 1.3e-2 at step h, and of second order up to 1.9e-4,
# falling by 3.96 to 4.02 when h is halved, after extrapolation: 0.1 of the standard
# errors below.
REMAINDER = 2e-4

HOLD, BACK = (1.0, 0.0, 1.0, 0.25, 0.0, 1.0), (1.0, 1.0, -1.0, -0.5, 0.0, -1.0)

CASES = {
    "mechanical sqrt": Contacts(),
    "mechanical uniform, n=0, fixed delay, viscous": Contacts(n=0.0, stiffness_law="uniform", delay=0.48, eta=0.8),
    "quenched soft sqrt": Contacts(kT=1.0, velocity=0.5),
    "quenched soft uniform, units, fixed delay, viscous": Contacts(
        2.5, 2.0, 0.5, "uniform", 0.9, 1.5, delay=0.16, eta=0.1, velocity=3.0
    ),
    "quenched stiff sqrt, n=0": Contacts(n=0.0, kT=0.4, barrier="stiff", velocity=0.4),
    "quenched stiff uniform, exponential delay": Contacts(
        stiffness_law="uniform", kT=0.5, barrier="stiff", delay=0.5, delay_law="exponential", velocity=0.8
    ),
    "annealed soft uniform": Contacts(stiffness_law="uniform", kT=1.0, disorder="annealed", velocity=0.5),
    "annealed soft sqrt, exponential delay, viscous": Contacts(
        kT=0.5, disorder="annealed", delay=0.7, delay_law="exponential", eta=1.0, velocity=0.7
    ),
    "annealed stiff uniform, n=0, fixed delay": Contacts(
        n=0.0, stiffness_law="uniform", kT=0.3, barrier="stiff", disorder="annealed", delay=0.4, velocity=0.6
    ),
    "annealed stiff sqrt": Contacts(kT=0.3, barrier="stiff", disorder="annealed", velocity=0.5),
    "flow sqrt, soft": Contacts(kT=0.5, velocity=0.5, aging="flow", rate=0.3, x_star_final=2.0),
    "flow uniform, weaker, exponential delay": Contacts(
        n=0.0, stiffness_law="uniform", delay=0.4, delay_law="exponential", aging="flow", rate=0.2, x_star_final=0.4
    ),
    "langevin sqrt": Contacts(aging="langevin", rate=0.15, x_star_final=1.5),
    "langevin uniform, n=0.5, stiff, fixed delay": Contacts(
        n=0.5, stiffness_law="uniform", kT=0.3, barrier="stiff", delay=0.48, aging="langevin", rate=0.1
    ),
    "annealed aging uniform, soft": Contacts(
        stiffness_law="uniform", kT=0.5, disorder="annealed", aging="flow", rate=0.3, x_star_final=2.0
    ),
    "annealed aging sqrt, fixed delay": Contacts(
        delay=0.4, disorder="annealed", aging="flow", rate=1.0, x_star_final=0.5
    ),
    "logarithmic uniform, stiff, fixed delay": Contacts(
        n=0.0, stiffness_law="uniform", kT=0.3, barrier="stiff", delay=0.48, aging="logarithmic", beta=0.3
    ),
    "logarithmic, mechanical, exponential delay": Contacts(
        delay=0.4, delay_law="exponential", velocity=0.5, aging="logarithmic", beta=0.1, cutoff_time=0.2
    ),
    "logarithmic sqrt, soft": Contacts(kT=0.3, velocity=0.5, aging="logarithmic", beta=0.2, cutoff_time=0.5),
    "hold and steps, soft sqrt": Contacts(kT=0.5, velocity=0.5, factors=HOLD),
    "reversal, stiff uniform, exponential delay, viscous": Contacts(
        n=0.0, stiffness_law="uniform", kT=0.3, barrier="stiff", delay=0.4, delay_law="exponential", eta=0.5,
        velocity=0.6, factors=BACK,
    ),
    "reversal, annealed soft sqrt, fixed delay": Contacts(
        kT=0.5, disorder="annealed", delay=0.48, velocity=0.7, factors=BACK
    ),
    "hold and steps, logarithmic": Contacts(
        kT=0.3, velocity=0.5, aging="logarithmic", beta=0.2, cutoff_time=0.5, factors=HOLD
    ),
    "reversal, flow": Contacts(kT=0.4, velocity=0.5, aging="flow", rate=0.3, x_star_final=2.0, factors=BACK),
    "reversal, flow, weaker": Contacts(
        stiffness_law="uniform", kT=0.4, velocity=0.5, aging="flow", rate=0.2, x_star_final=0.4, factors=BACK
    ),
    "hold and steps, mechanical logarithmic": Contacts(aging="logarithmic", beta=0.3, cutoff_time=0.2, factors=HOLD),
    "hold and steps, langevin sqrt, soft": Contacts(
        kT=0.3, velocity=0.5, aging="langevin", rate=0.15, x_star_final=1.5, factors=HOLD
    ),
    "hold and steps, mechanical langevin uniform, n=0": Contacts(
        n=0.0, stiffness_law="uniform", aging="langevin", rate=0.2, x_star_final=0.8, factors=HOLD
    ),
    "reversal, mechanical langevin sqrt": Contacts(aging="langevin", rate=0.15, x_star_final=1.5, factors=BACK),
    "reversal, langevin uniform, soft, exponential delay": Contacts(
        stiffness_law="uniform", kT=0.3, delay=0.4, delay_law="exponential", velocity=0.5, aging="langevin", rate=0.15,
        x_star_final=1.5, factors=BACK,
    ),
    "reversal, langevin uniform, n=0.5, stiff, fixed delay, viscous": Contacts(
        n=0.5, stiffness_law="uniform", kT=0.3, barrier="stiff", delay=0.48, eta=0.5, aging="langevin", rate=0.1,
        x_star_final=0.7, factors=BACK,
    ),
}  # fmt: skip


# By default each kind of kernel that other tests compile, too; four times as many
# contacts of all with -m verification.
CHOSEN = [
    "mechanical sqrt",
    "quenched soft uniform, units, fixed delay, viscous",
    "annealed soft uniform",
    "hold and steps, soft sqrt",
    "hold and steps, langevin sqrt, soft",
    "langevin sqrt",  # with -m verification: its kernels are those of no other test
]
WRONG = [
    ("mechanical sqrt", {"stiffness_law": "uniform"}),
    ("mechanical uniform, n=0, fixed delay, viscous", {"delay_law": "exponential"}),
    ("quenched soft sqrt", {"disorder": "annealed"}),
    ("langevin sqrt", {"aging": "flow"}),
    ("hold and steps, soft sqrt", {"factors": (1.0, 0.05, 1.0, 0.25, 0.0, 1.0)}),
    ("mechanical uniform, n=0, fixed delay, viscous", {"eta": 0.7}),
    ("quenched stiff sqrt, n=0", {"kT": 0.6}),
    ("annealed soft uniform", {"kT": 0.8}),
    ("annealed aging uniform, soft", {"rate": 0.2}),
    ("logarithmic sqrt, soft", {"cutoff_time": 0.8}),
    ("hold and steps, langevin sqrt, soft", {"frozen": True}),
    (
        "reversal, annealed soft sqrt, fixed delay",
        {"factors": (1.0, 1.0, 1.0, 0.5, 0.0, 1.0)},
    ),
]


@functools.cache
def engine(c, times=1):
    ensemble = Ensemble(
        Gamma(c.n, c.x_star),
        Thermal(c.kT, c.attempt_frequency, c.barrier),
        Delay(c.delay, c.delay_law),
        Aging(c.aging, beta=c.beta, cutoff_time=c.cutoff_time)
        if c.aging == "logarithmic"
        else Aging(c.aging, c.rate, c.x_star_final),
        count=times * ENGINE_COUNT // (10 if c.aging == "langevin" else 1),
        stiffness=c.stiffness,
        stiffness_law=c.stiffness_law,
        disorder=c.disorder,
        eta=c.eta,
    )
    drive = Drive(c.velocity, RECORDS * SPACING * c.x_star)
    if c.factors:
        time = SPACING * c.x_star / c.velocity
        drive = Programme(
            [Segment(factor * c.velocity, time=time, points=1) for factor in c.factors]
        )
    return trajectory(ensemble, drive, points=RECORDS + 1, seed=17, threads=2)


def oracle(c, seed=23, times=1):
    """Values at step 0 by Richardson extrapolation of two independent runs, 2 F(h) -
    F(2h), and standard errors."""
    if c.disorder == "annealed" and c.aging != "none":
        c = settled(c, times * COUNT // 2, STEP * c.x_star, seed)
    fine, coarse = (
        simulate(
            c,
            times * COUNT,
            step * c.x_star,
            round(SPACING / step),
            RECORDS,
            seed=(seed, i),
        )
        for i, step in enumerate((STEP, 2 * STEP))
    )
    return (
        2 * fine.force - coarse.force,
        np.hypot(2 * fine.force_stderr, coarse.force_stderr),
        2 * fine.pinned - coarse.pinned,
        np.hypot(2 * fine.pinned_stderr, coarse.pinned_stderr),
    )


def scores(simulated, result, x_star, more=0.0):
    """Differences of force and pinned fraction in standard errors, beyond the
    remainder."""
    force, force_stderr, pinned, pinned_stderr = simulated

    def z(value, stderr, reference, reference_stderr, remainder):
        excess = np.maximum(np.abs(value - reference) - remainder, 0.0)
        sigma = np.hypot(stderr, reference_stderr)
        return np.divide(
            excess, sigma, out=np.where(excess > 0, np.inf, 0.0), where=sigma > 0
        )

    return np.append(
        z(
            force,
            force_stderr,
            result.force[1:],
            result.force_stderr[1:],
            (REMAINDER + more) * x_star,
        ),
        z(
            pinned,
            pinned_stderr,
            result.pinned[1:],
            result.pinned_stderr[1:],
            REMAINDER + more,
        ),
    )


@chosen(
    ("times", "name"),
    [*((1, name) for name in CHOSEN), *((4, name) for name in CASES)],
    [(1, name) for name in CHOSEN[:-1]],
)
def test_engine_agrees_with_time_steps(name, times):
    """|z| < 4.5 at every X for force and, with delay, pinned fraction: 258 scores in
    all cases, false alarm 7e-6 each, 1.8e-3 together. `langevin` has a remainder of
    1e-3 more, for the steps of the engine's paths."""
    c = CASES[name]
    steps = 1e-3 if c.aging == "langevin" else 0.0
    assert (
        scores(oracle(c, times=times), engine(c, times), c.x_star, steps).max() < LIMIT
    )


@pytest.mark.verification
@chosen(("name", "wrong"), WRONG, [*WRONG[:3], WRONG[4], WRONG[10]])
def test_another_model_fails(name, wrong):
    """Negative controls: contacts of a slightly different kind do not pass for those of
    the case."""
    c = CASES[name]
    assert (
        scores(oracle(Contacts(**(vars(c) | wrong))), engine(c), c.x_star).max() > LIMIT
    )
