"""The jobs, and how contenders are timed: they take turns within one run, and a ratio is the median over the turns,
so that a machine that is slow for a while is slow for all of them."""

import math
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from analysis.benchmarks import scalar, stepped
from analysis.benchmarks.cases import VELOCITY, Case, Sizes
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import Trajectory, trajectory
from eqsim.ensemble import Drive


class Outcome(NamedTuple):
    """Friction as a contender found it."""

    value: float
    stderr: float
    lives: int = 0

    @classmethod
    def of(cls, found: Trajectory | Steady) -> "Outcome":
        return cls(found.friction.value or math.nan, found.friction.stderr or math.nan, found.lives)


Turns = dict[str, list[tuple[float, Outcome]]]  # seconds and outcome of every turn of a contender


def take_turns(contenders: dict[str, Callable[[int], Outcome]], repeats: int, seed: int) -> Turns:
    """Time every contender `repeats` times, in alternating order, each time from another seed."""
    turns: Turns = {name: [] for name in contenders}
    for repeat in range(repeats):
        for name in list(contenders)[:: (-1) ** repeat]:
            begin = time.perf_counter()
            outcome = contenders[name](seed + repeat)
            turns[name].append((time.perf_counter() - begin, outcome))
    return turns


def time_trajectory(case: Case, sizes: Sizes, threads: int, seed: int) -> dict[str, Any]:
    """The force from a fresh start. Rival A does less of it, and its time is scaled up by contact-steps."""
    ensemble, drive = case.ensemble(sizes.contacts), Drive(VELOCITY, sizes.distance)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return Outcome.of(trajectory(ensemble, drive, points=sizes.points, seed=seed, threads=threads))

    contenders = {
        "eqsim": eqsim,
        "threads": lambda seed: eqsim(seed, threads),
        "A": lambda seed: Outcome(*stepped.friction(case, sizes.stepped_contacts, sizes.stepped_distance, seed)),
        "B": lambda seed: Outcome(*scalar.friction(case, sizes.contacts, sizes.distance, sizes.points, seed)),
    }
    turns = take_turns(contenders, sizes.repeats, seed)
    (value, error), (truth, its_error) = pooled(turns, "A"), pooled(turns, "eqsim")
    bias = {"A_bias": value / truth - 1, "A_bias_stderr": math.hypot(error, its_error) / truth}
    return summary(case, turns) | ratios(turns, "A", sizes.contact_steps) | ratios(turns, "B") | bias


def time_steady(case: Case, sizes: Sizes, threads: int, seed: int, rel_error: float) -> dict[str, Any]:
    """Steady friction. Rival B averages plainly, and its time is scaled to the lives it needs for `rel_error`."""
    ensemble = case.ensemble(1)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return Outcome.of(steady(ensemble, VELOCITY, rel_error=rel_error, seed=seed, threads=threads))

    contenders = {
        "eqsim": eqsim,
        "threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(*scalar.steady_friction(case, sizes.lives, seed)),
    }
    turns = take_turns(contenders, sizes.repeats, seed)
    shared = summary(case, turns)
    value, error = pooled(turns, "B")
    needed = sizes.repeats * (error / value / rel_error) ** 2  # runs of sizes.lives
    per_life = ratios(turns, "B", shared["lives"] / sizes.lives)["B"]
    return shared | ratios(turns, "B", needed) | {"B_per_life": per_life, "B_lives": needed * sizes.lives}


def summary(case: Case, turns: Turns) -> dict[str, Any]:
    """Speed and error of eqsim, what threads gain, and the score of rival B's friction against eqsim's."""
    seconds = statistics.median(seconds for seconds, _ in turns["eqsim"])
    lives = statistics.median(outcome.lives for _, outcome in turns["eqsim"])
    reached = statistics.median(outcome.stderr / outcome.value for _, outcome in turns["eqsim"])
    (value, error), (truth, its_error) = pooled(turns, "B"), pooled(turns, "eqsim")
    figures = {"case": case.name, "seconds": seconds, "lives": lives, "lives_per_microsecond": 1e-6 * lives / seconds}
    figures |= {"rel_error": reached, "B_z": (value - truth) / math.hypot(error, its_error)}
    return figures | ratios(turns, "threads")


def ratios(turns: Turns, rival: str, factor: float = 1.0) -> dict[str, float]:
    """Seconds of a rival over those of eqsim, times `factor`: median, least and greatest over the turns."""
    found = [factor * there / here for (there, _), (here, _) in zip(turns[rival], turns["eqsim"], strict=True)]
    return {rival: statistics.median(found), f"{rival}_low": min(found), f"{rival}_high": max(found)}


def pooled(turns: Turns, name: str) -> tuple[float, float]:
    """Mean of the frictions of all turns, and its standard error."""
    outcomes = [outcome for _, outcome in turns[name]]
    error = math.sqrt(sum(outcome.stderr**2 for outcome in outcomes)) / len(outcomes)
    return statistics.fmean(outcome.value for outcome in outcomes), error
