"""The jobs that eqsim and its rivals share, and how contenders are timed: they take turns within one run, and a ratio
is the median over the turns, so that a machine that is slow for a while is slow for all of them."""

import math
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from analysis.benchmarks import scalar, stepped, tuned
from analysis.benchmarks.cases import VELOCITY, Case, Sizes
from eqsim.engine.lanes import LANES, ROUNDS, plain_sums
from eqsim.engine.langevin import path_law
from eqsim.engine.steady import Steady, steady
from eqsim.numerics.streams import STEADY, key
from eqsim.engine.trajectory import Trajectory, trajectory
from eqsim.model.ensemble import Drive, Ensemble, lower

BATCHES = 64  # of a plain average


class Outcome(NamedTuple):
    """Friction as a contender found it."""

    value: float
    stderr: float
    lives: int = 0

    @classmethod
    def of(cls, found: Trajectory | Steady) -> "Outcome":
        return cls(found.friction.value or math.nan, found.friction.stderr or math.nan, found.lives)


Contender = Callable[[int], Outcome]
Turns = dict[str, list[tuple[float, Outcome]]]  # seconds and outcome of every turn of a contender


def take_turns(contenders: dict[str, Contender], repeats: int, seed: int) -> Turns:
    """Time every contender `repeats` times, in alternating order, each time from another seed."""
    turns: Turns = {name: [] for name in contenders}
    for repeat in range(repeats):
        for name in list(contenders)[:: (-1) ** repeat]:
            begin = time.perf_counter()
            outcome = contenders[name](seed + repeat)
            turns[name].append((time.perf_counter() - begin, outcome))
    return turns


def plain(ensemble: Ensemble, velocity: float, lives: int, seed: int, threads: int) -> Outcome:
    """Friction of eqsim's lives, plainly drawn, by renewal-reward."""
    c, turns = lower(ensemble, velocity), -(-lives // (BATCHES * LANES * ROUNDS))
    size = turns * LANES * ROUNDS

    def sums(batch: int) -> tuple[float, float]:
        work, stretch, *_ = plain_sums(c, path_law(c), key(seed, STEADY), batch * LANES, 0, turns)
        return work, stretch

    with ThreadPoolExecutor(threads) as pool:
        work, stretch = np.array(list(pool.map(sums, range(BATCHES)))).T
    cycle, unit = stretch + size * c.delay, ensemble.thresholds.scale
    value = work.sum() / cycle.sum()
    error = float((work - value * cycle).std(ddof=1)) * math.sqrt(BATCHES) / float(cycle.sum())
    return Outcome(float(value) * unit, error * unit, size * BATCHES)


def time_trajectory(case: Case, sizes: Sizes, threads: int, seed: int) -> dict[str, Any]:
    """The force from a fresh start. Rival A does less of it, and its time is scaled up by contact-steps."""
    ensemble, drive = case.ensemble(sizes.contacts), Drive(VELOCITY, sizes.distance)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return Outcome.of(trajectory(ensemble, drive, points=sizes.points, seed=seed, threads=threads))

    def by_hand(seed: int, threads: int = 1) -> Outcome:
        found = tuned.run(case, sizes.contacts, sizes.distance, sizes.points, seed, threads)
        return Outcome(found.friction, found.stderr, found.lives)

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "A": lambda seed: Outcome(*stepped.friction(case, sizes.stepped_contacts, sizes.stepped_distance, seed)),
        "B": lambda seed: Outcome(*scalar.friction(case, sizes.contacts, sizes.distance, sizes.points, seed)),
    }
    if tuned.available():
        contenders |= {"C": by_hand, "C, threads": lambda seed: by_hand(seed, threads)}
    turns = take_turns(contenders, sizes.repeats, seed)
    (value, error), (truth, its_error) = pooled(turns, "A"), pooled(turns, "eqsim")
    bias = {"A_bias": value / truth - 1, "A_bias_stderr": math.hypot(error, its_error) / truth}
    wanted = {"wanted": 0.80 if case.kT else 0.85}
    return summary(case, turns) | ratios("A", turns, "A", "eqsim", sizes.contact_steps) | bias | wanted


def time_plain(case: Case, sizes: Sizes, threads: int, seed: int) -> dict[str, Any]:
    """Steady friction from so many lives, plainly drawn. Rival B takes fewer, and its time is scaled up."""

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return plain(case.ensemble(1), VELOCITY, sizes.lives, seed, threads)

    def by_hand(seed: int, threads: int = 1) -> Outcome:
        return Outcome(*tuned.steady(case, sizes.lives, seed, threads), sizes.lives)

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(*scalar.steady_friction(case, sizes.scalar_lives, seed), sizes.scalar_lives),
    }
    if tuned.available():
        contenders |= {"C": by_hand, "C, threads": lambda seed: by_hand(seed, threads)}
    turns = take_turns(contenders, sizes.plain_repeats, seed)
    wanted = {"wanted": 0.70 if case.kT else 0.80}
    return summary(case, turns, sizes.lives / sizes.scalar_lives) | wanted


def time_steady(case: Case, sizes: Sizes, threads: int, seed: int, rel_error: float) -> dict[str, Any]:
    """Steady friction to an error. Rival B averages plainly, and its time is scaled to the lives this takes."""
    ensemble = case.ensemble(1)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return Outcome.of(steady(ensemble, Drive(VELOCITY), rel_error=rel_error, seed=seed, threads=threads))

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(*scalar.steady_friction(case, sizes.scalar_lives, seed)),
    }
    turns = take_turns(contenders, sizes.repeats, seed)
    value, error = pooled(turns, "B")
    needed = sizes.repeats * (error / value / rel_error) ** 2  # runs of sizes.scalar_lives
    return summary(case, turns, needed) | {"B_lives": needed * sizes.scalar_lives}


def summary(case: Case, turns: Turns, b_factor: float = 1.0) -> dict[str, Any]:
    """Speed and error of eqsim, what threads gain, and speed and score of rivals B and C, as far as they took part."""
    figures: dict[str, Any] = {"case": case.name} | speed(turns, "eqsim", "")
    figures |= ratios("threads", turns, "eqsim, threads", "eqsim") | ratios("B", turns, "B", "eqsim", b_factor)
    figures["rel_error"] = statistics.median(outcome.stderr / outcome.value for _, outcome in turns["eqsim"])
    truth, its_error = pooled(turns, "eqsim")
    for name in ("B", "C"):
        if name in turns:
            value, error = pooled(turns, name)
            figures[f"{name}_z"] = (value - truth) / math.hypot(error, its_error)
    if "C" in turns:
        figures |= speed(turns, "C", "C_") | ratios("C", turns, "C", "eqsim")
        figures |= ratios("C_both_threads", turns, "C, threads", "eqsim, threads")
        figures |= ratios("C_threads", turns, "C, threads", "C")
    return figures


def speed(turns: Turns, name: str, prefix: str) -> dict[str, float]:
    """Median seconds, lives and nanoseconds per life."""
    seconds = statistics.median(seconds for seconds, _ in turns[name])
    found = statistics.median(outcome.lives for _, outcome in turns[name])
    figures = {f"{prefix}seconds": seconds, f"{prefix}lives": found}
    return figures | ({f"{prefix}ns_per_life": 1e9 * seconds / found} if found else {})


def ratios(figure: str, turns: Turns, this: str, that: str, factor: float = 1.0) -> dict[str, float]:
    """Seconds of `this` over those of `that`, times `factor`: median, least and greatest over the turns."""
    found = [factor * one / other for (one, _), (other, _) in zip(turns[this], turns[that], strict=True)]
    return {figure: statistics.median(found), f"{figure}_low": min(found), f"{figure}_high": max(found)}


def pooled(turns: Turns, name: str) -> tuple[float, float]:
    """Mean of the frictions of all turns, and its standard error."""
    outcomes = [outcome for _, outcome in turns[name]]
    error = math.sqrt(sum(outcome.stderr**2 for outcome in outcomes)) / len(outcomes)
    return statistics.fmean(outcome.value for outcome in outcomes), error
