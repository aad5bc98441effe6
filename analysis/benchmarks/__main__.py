"""python -m analysis.benchmarks: how many times faster eqsim is than its rivals, measured side by side.

Contenders take turns within one run, and a ratio is the median over the turns, so that a machine that is slow for a
while is slow for all of them. Jobs: a trajectory from a fresh start, and the steady friction to a relative error.
"""

import math
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd
import typer
from rich.console import Console

from analysis.benchmarks import report, scalar, stepped
from analysis.benchmarks.cases import CASES, QUICK, VELOCITY, Case, Sizes
from eqsim.engine.steady import steady
from eqsim.engine.trajectory import trajectory
from eqsim.ensemble import Drive


class Outcome(NamedTuple):
    """Friction as a contender found it."""

    value: float
    stderr: float
    lives: int = 0


Contender = Callable[[int], Outcome]  # from a seed
Turns = dict[str, list[tuple[float, Outcome]]]  # seconds and outcome of every turn


def take_turns(contenders: dict[str, Contender], repeats: int, seed: int) -> Turns:
    """Time every contender `repeats` times, there and back again, each time from another seed."""
    turns: Turns = {name: [] for name in contenders}
    for repeat in range(repeats):
        for name in list(contenders)[:: 1 if repeat % 2 == 0 else -1]:
            begin = time.perf_counter()
            outcome = contenders[name](seed + repeat)
            turns[name].append((time.perf_counter() - begin, outcome))
    return turns


def ratios(turns: Turns, rival: str, factor: float = 1.0) -> dict[str, float]:
    """Seconds of a rival over those of eqsim, times `factor`: median, least and greatest over the turns."""
    found = [factor * there / here for (there, _), (here, _) in zip(turns[rival], turns["eqsim"], strict=True)]
    return {rival: statistics.median(found), f"{rival}_low": min(found), f"{rival}_high": max(found)}


def pooled(turns: Turns, name: str) -> tuple[float, float]:
    """Mean of the frictions of all turns, and its standard error."""
    outcomes = [outcome for _, outcome in turns[name]]
    error = math.sqrt(sum(outcome.stderr**2 for outcome in outcomes)) / len(outcomes)
    return statistics.fmean(outcome.value for outcome in outcomes), error


def z_score(turns: Turns, name: str) -> float:
    (value, error), (truth, its_error) = pooled(turns, name), pooled(turns, "eqsim")
    return (value - truth) / math.hypot(error, its_error)


def row(job: str, case: Case, turns: Turns) -> dict[str, object]:
    """What both jobs report."""
    seconds = statistics.median(seconds for seconds, _ in turns["eqsim"])
    outcomes = [outcome for _, outcome in turns["eqsim"]]
    lives = statistics.median(outcome.lives for outcome in outcomes)
    reached = statistics.median(outcome.stderr / outcome.value for outcome in outcomes)
    threaded = {f"threads{key[7:]}": 1 / value for key, value in ratios(turns, "threads").items()}
    shared = {"job": job, "case": case.name, "seconds": seconds, "lives": lives, "lives_per_second": lives / seconds}
    return shared | {"rel_error": reached, "z_of_B": z_score(turns, "B")} | threaded


def time_trajectory(case: Case, sizes: Sizes, threads: int, seed: int) -> dict[str, object]:
    """Trajectory: rival A is scaled up by contact-steps, and its bias printed, relative to eqsim's friction."""
    ensemble, drive = case.ensemble(sizes.contacts), Drive(VELOCITY, sizes.distance)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        found = trajectory(ensemble, drive, points=sizes.points, seed=seed, threads=threads)
        return Outcome(found.friction.value or math.nan, found.friction.stderr or math.nan, found.lives)

    turns = take_turns(
        {
            "eqsim": eqsim,
            "threads": lambda seed: eqsim(seed, threads),
            "A": lambda seed: Outcome(*stepped.friction(case, sizes.stepped_contacts, sizes.stepped_distance, seed)),
            "B": lambda seed: Outcome(*scalar.friction(case, sizes.contacts, sizes.distance, sizes.points, seed)),
        },
        sizes.repeats,
        seed,
    )
    (value, error), (truth, its_error) = pooled(turns, "A"), pooled(turns, "eqsim")
    bias = {"bias_of_A": value / truth - 1, "bias_stderr": math.hypot(error / value, its_error / truth)}
    return row("trajectory", case, turns) | ratios(turns, "A", sizes.contact_steps) | ratios(turns, "B") | bias


def time_steady(case: Case, sizes: Sizes, threads: int, seed: int, rel_error: float) -> dict[str, object]:
    """Steady friction: rival B, plain Monte Carlo, is scaled to as many lives as `rel_error` asks of it."""
    ensemble = case.ensemble(1)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        found = steady(ensemble, VELOCITY, rel_error=rel_error, seed=seed, threads=threads)
        return Outcome(found.friction.value or math.nan, found.friction.stderr or math.nan, found.lives)

    contenders: dict[str, Contender] = {
        "eqsim": eqsim,
        "threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(*scalar.steady_friction(case, sizes.lives, seed)),
    }
    turns = take_turns(contenders, sizes.repeats, seed)
    shared = row(f"steady to {rel_error:g}", case, turns)
    value, error = pooled(turns, "B")
    needed = sizes.repeats * (error / value / rel_error) ** 2  # in units of sizes.lives
    per_life = ratios(turns, "B", float(shared["lives"]) / sizes.lives)["B"]  # type: ignore[arg-type]
    return shared | ratios(turns, "B", needed) | {"B_per_life": per_life, "B_lives": needed * sizes.lives}


def measure(sizes: Sizes, threads: int, console: Console) -> pd.DataFrame:
    """One row per job and case."""
    small = Sizes(320, 10.0, 11, 10, 1.0, 320, (1e-2,), 1)
    for case in CASES:  # compile
        time_trajectory(case, small, threads, 1)
        time_steady(case, small, threads, 1, 1e-2)
    rows = []
    for index, case in enumerate(CASES):
        with console.status(case.name):
            seed = 1000 * (index + 1)  # cases must not share random numbers
            rows.append(time_trajectory(case, sizes, threads, seed))
            rows += [time_steady(case, sizes, threads, seed, error) for error in sizes.errors]
    figures = pd.DataFrame(rows)
    figures = figures.sort_values("job", key=lambda job: job.map({j: i for i, j in enumerate(report.jobs(sizes))}), kind="stable")
    about = {name: version(name) for name in ("eqsim", "numba", "numpy")}
    return figures.assign(thread_count=threads, repeats=sizes.repeats, contacts=sizes.contacts, **about)
