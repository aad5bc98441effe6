"""Jobs that eqsim and its rivals share. Contenders are timed in interleaved rounds
within one run, and a ratio is the median over the rounds, so that a machine that is
slow for a while is slow for all of them."""

import math
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest.mock import patch

from analysis.benchmarks import scalar, stepped, tuned
from analysis.benchmarks.cases import VELOCITY, Case, Sizes
from eqsim import Drive, Ensemble, Estimate, steady, trajectory

WANTED = 0.75  # least seconds of rival C over those of eqsim


class Outcome(NamedTuple):
    """Friction by a contender, with its standard error, and lives."""

    value: float
    stderr: float
    lives: int = 0

    @classmethod
    def of(cls, friction: Estimate, lives: int) -> "Outcome":
        return cls(friction.value or math.nan, friction.stderr or math.nan, lives)


Contender = Callable[[int], Outcome]
# seconds and outcome of each contender in every round
Rounds = dict[str, list[tuple[float, Outcome]]]


def interleaved(contenders: dict[str, Contender], repeats: int, seed: int) -> Rounds:
    """Time every contender `repeats` times, in alternating order, each time from
    another seed."""
    rounds: Rounds = {name: [] for name in contenders}
    for repeat in range(repeats):
        for name in list(contenders)[:: (-1) ** repeat]:
            begin = time.perf_counter()
            outcome = contenders[name](seed + repeat)
            rounds[name].append((time.perf_counter() - begin, outcome))
    return rounds


def accuracy(ensemble: Ensemble, velocity: float, lives: int) -> float:
    """Relative error that takes between 0.7 and 1.4 times `lives` plainly drawn
    lives."""
    friction = steady(ensemble, Drive(velocity), rel_error=1.0, plain=True).friction
    return (
        1.3 * friction.stderr / friction.value * math.sqrt(friction.n / (0.7 * lives))
    )


def plain(
    ensemble: Ensemble, velocity: float, rel_error: float, seed: int, threads: int = 1
) -> Outcome:
    """Friction of plainly drawn lives of eqsim, by renewal-reward."""
    found = steady(
        ensemble,
        Drive(velocity),
        rel_error=rel_error,
        seed=seed,
        threads=threads,
        plain=True,
    )
    return Outcome.of(found.friction, found.lives)


def time_trajectory(
    case: Case, sizes: Sizes, threads: int, seed: int
) -> dict[str, Any]:
    """The force from a fresh start. Rival A does less of it, and its time is scaled up
    by contact-steps."""
    ensemble, drive = case.ensemble(sizes.contacts), Drive(VELOCITY, sizes.distance)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        found = trajectory(
            ensemble, drive, points=sizes.points, seed=seed, threads=threads
        )
        return Outcome.of(found.averages.friction, found.lives)

    def by_hand(seed: int, threads: int = 1) -> Outcome:
        found = tuned.run(
            case, sizes.contacts, sizes.distance, sizes.points, seed, threads
        )
        return Outcome(found.friction, found.stderr, found.lives)

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "A": lambda seed: Outcome(
            *stepped.friction(
                case, sizes.stepped_contacts, sizes.stepped_distance, seed
            )
        ),
        "B": lambda seed: Outcome(
            *scalar.friction(case, sizes.contacts, sizes.distance, sizes.points, seed)
        ),
    }
    if tuned.available():
        contenders |= {"C": by_hand, "C, threads": lambda seed: by_hand(seed, threads)}
    rounds = interleaved(contenders, sizes.repeats, seed)
    (value, error), (truth, its_error) = pooled(rounds, "A"), pooled(rounds, "eqsim")
    bias = {
        "A_bias": value / truth - 1,
        "A_bias_stderr": math.hypot(error, its_error) / truth,
    }
    return (
        summary(case, rounds)
        | ratios("A", rounds, "A", "eqsim", sizes.contact_steps)
        | bias
        | {"wanted": WANTED}
    )


def time_plain(case: Case, sizes: Sizes, threads: int, seed: int) -> dict[str, Any]:
    """Steady friction from about `sizes.lives` plainly drawn lives; times are compared
    per life."""
    ensemble = case.ensemble(1)
    rel_error = accuracy(ensemble, VELOCITY, sizes.lives)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        return plain(ensemble, VELOCITY, rel_error, seed, threads)

    def by_hand(seed: int, threads: int = 1) -> Outcome:
        return Outcome(*tuned.steady(case, sizes.lives, seed, threads), sizes.lives)

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(
            *scalar.steady_friction(case, sizes.scalar_lives, seed), sizes.scalar_lives
        ),
    }
    if tuned.available():
        contenders |= {"C": by_hand, "C, threads": lambda seed: by_hand(seed, threads)}
    rounds = interleaved(contenders, sizes.plain_repeats, seed)
    return summary(case, rounds, per_life=True) | {"wanted": WANTED}


def time_steady(
    case: Case, sizes: Sizes, threads: int, seed: int, rel_error: float
) -> dict[str, Any]:
    """Steady friction to an error. Rival B averages plainly, and its time is scaled to
    the lives this takes."""
    ensemble = case.ensemble(1)

    def eqsim(seed: int, threads: int = 1) -> Outcome:
        found = steady(
            ensemble, Drive(VELOCITY), rel_error=rel_error, seed=seed, threads=threads
        )
        return Outcome.of(found.friction, found.lives)

    contenders = {
        "eqsim": eqsim,
        "eqsim, threads": lambda seed: eqsim(seed, threads),
        "B": lambda seed: Outcome(
            *scalar.steady_friction(case, sizes.scalar_lives, seed)
        ),
    }
    rounds = interleaved(contenders, sizes.repeats, seed)
    value, error = pooled(rounds, "B")
    # runs of sizes.scalar_lives
    needed = sizes.repeats * (error / value / rel_error) ** 2
    return summary(case, rounds, needed) | {"B_lives": needed * sizes.scalar_lives}


def summary(
    case: Case, rounds: Rounds, b_factor: float = 1.0, per_life: bool = False
) -> dict[str, Any]:
    """Speed and error of eqsim, gain by threads, and speed and score of rivals B and C,
    as far as they took part."""
    cost = rounds
    if per_life:
        cost = {
            name: [(seconds / outcome.lives, outcome) for seconds, outcome in timed]
            for name, timed in rounds.items()
        }
    figures: dict[str, Any] = {"case": case.name} | speed(rounds, "eqsim", "")
    figures |= ratios("threads", cost, "eqsim, threads", "eqsim") | ratios(
        "B", cost, "B", "eqsim", b_factor
    )
    figures["rel_error"] = statistics.median(
        outcome.stderr / outcome.value for _, outcome in rounds["eqsim"]
    )
    truth, its_error = pooled(rounds, "eqsim")
    for name in ("B", "C"):
        if name in rounds:
            value, error = pooled(rounds, name)
            figures[f"{name}_z"] = (value - truth) / math.hypot(error, its_error)
    if "C" in rounds:
        figures |= speed(rounds, "C", "C_") | ratios("C", cost, "C", "eqsim")
        figures |= ratios("C_both_threads", cost, "C, threads", "eqsim, threads")
        figures |= ratios("C_threads", cost, "C, threads", "C")
    return figures


def calls(owner: type, name: str, run: Callable[[], object]) -> int:
    """Number of times that `run` calls a method of a class."""
    with patch.object(
        owner, name, autospec=True, side_effect=getattr(owner, name)
    ) as counted:
        run()
    return counted.call_count


def speed(rounds: Rounds, name: str, prefix: str) -> dict[str, float]:
    """Median seconds, lives and nanoseconds per life."""
    seconds = statistics.median(seconds for seconds, _ in rounds[name])
    lives = statistics.median(outcome.lives for _, outcome in rounds[name])
    figures = {f"{prefix}seconds": seconds, f"{prefix}lives": lives}
    return figures | ({f"{prefix}ns_per_life": 1e9 * seconds / lives} if lives else {})


def ratios(
    figure: str, rounds: Rounds, this: str, that: str, factor: float = 1.0
) -> dict[str, float]:
    """Seconds of `this` over those of `that`, times `factor`: median, least and
    greatest over the rounds."""
    values = [
        factor * seconds / other
        for (seconds, _), (other, _) in zip(rounds[this], rounds[that], strict=True)
    ]
    return {
        figure: statistics.median(values),
        f"{figure}_low": min(values),
        f"{figure}_high": max(values),
    }


def pooled(rounds: Rounds, name: str) -> tuple[float, float]:
    """Mean of the frictions of all rounds, and its standard error."""
    outcomes = [outcome for _, outcome in rounds[name]]
    error = math.sqrt(sum(outcome.stderr**2 for outcome in outcomes)) / len(outcomes)
    return statistics.fmean(outcome.value for outcome in outcomes), error
