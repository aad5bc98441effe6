"""The engine against the master equation over the parameter space: the verdict.

A suite draws parameter points (`points`) and compares, point by point, what contacts
estimate with what the master equation says, each difference as a score z in units of
the quoted errors (`scores`).

What is asked for and not scored is counted by reason: refused by the program, called
unreliable by it, or too vague, an error that leaves nothing to compare; too few
contacts, too many lives, no reference. A suite in which the program declines (the first
three) more of a kind than is scored does not pass.

Scores of one kind are independent. A kind passes if the sum of squares of even ones has
a chi-square probability above 1e-4 on both sides, and the largest |z| a probability
above 1e-4 given their number. With twenty kinds and two probabilities each a correct
program fails a suite once in some 250 seeds or less often, whatever the correlations
between kinds (Bonferroni).
"""

import html
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from eqsim.errors import InputError
from eqsim.model.ensemble import Ensemble
from eqsim.validation import pulled
from eqsim.validation.comparison import (
    DECLINED,
    Found,
    Point,
    Score,
    Unscored,
    columns,
    stream,
)
from eqsim.validation.points import SUITES, WHOLE, Part, sample
from eqsim.validation.scores import KINDS as RIGID
from eqsim.validation.scores import compared

KINDS = (*RIGID, *pulled.KINDS)

ALARM = 1e-4

Mutation = Callable[[Ensemble], Ensemble]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Verdict:
    """Of the `count` scores of a kind, `even` of which make its chi-square: both
    probabilities, the largest |z|, and whether it passes."""

    kind: str
    count: int
    even: int
    chi_square: float
    p_chi_square: float
    largest: float
    p_largest: float
    passed: bool


@dataclass(frozen=True, repr=False)
class Validation:
    """What a suite found.

    Attributes
    ----------
    suite, seed
        As they were asked for.
    scores : list of Score
    verdicts : list of Verdict
        One for each of `KINDS`.
    unscored : list of Unscored
        What was left out, and why.
    """

    suite: str
    seed: int
    scores: list[Score]
    verdicts: list[Verdict]
    unscored: list[Unscored]

    def to_pandas(self) -> Any:
        """A DataFrame of all comparisons, one a row."""
        import pandas as pd

        return pd.DataFrame(columns(self.scores))

    def __repr__(self) -> str:
        said = "passed" if self.passed else "FAILED"
        return f"Validation(suite {self.suite}, seed {self.seed}: {said}, {len(self.scores)} comparisons)"

    def _repr_html_(self) -> str:
        """The verdict on each kind."""
        import pandas as pd

        shown: str = pd.DataFrame(
            [asdict(verdict) for verdict in self.verdicts]
        ).to_html(index=False)
        return f"{html.escape(repr(self))}{shown}"

    @property
    def passed(self) -> bool:
        """Whether every kind passes, and the program declined no more of any than it
        made."""
        return all(verdict.passed for verdict in self.verdicts) and not self.declined

    @property
    def declined(self) -> list[str]:
        """Kinds of which the program refused more than was scored."""
        left = left_out(self.unscored)
        return [
            verdict.kind
            for verdict in self.verdicts
            if declined(verdict.kind, verdict.count, left)
        ]

    @property
    def p_overall(self) -> float:
        """Probability of a p-value as small as the smallest of all kinds, or an upper
        bound of it (Bonferroni)."""
        return p_overall(self.verdicts)


def left_out(unscored: list[Unscored]) -> dict[str, dict[str, int]]:
    """How many comparisons were not made, by kind and reason."""
    found: dict[str, dict[str, int]] = {}
    for (kind, reason), count in Counter(
        (one.kind, one.reason) for one in unscored
    ).items():
        found.setdefault(kind, {})[reason] = count
    return found


def declined(kind: str, scores: int, left: dict[str, dict[str, int]]) -> bool:
    """Whether the program would not do, or not be trusted with, more comparisons of a
    kind than were made."""
    return sum(left.get(kind, {}).get(reason, 0) for reason in DECLINED) > scores


def p_overall(verdicts: list[Verdict]) -> float:
    """`Validation.p_overall` of these verdicts."""
    p = [
        p
        for verdict in verdicts
        if verdict.count
        for p in (verdict.p_chi_square, verdict.p_largest)
    ]
    return min(1.0, len(p) * min(p, default=1.0))


def judge(kind: str, scores: list[Score]) -> Verdict:
    """Chi-square of the even scores of a kind, and largest |z| of all."""
    of_kind = [score for score in scores if score.kind == kind]
    if not of_kind:
        return Verdict(kind, 0, 0, 0.0, 1.0, 0.0, 1.0, True)
    z = np.array([score.z for score in of_kind])
    even = z[[score.even for score in of_kind]]
    total, largest = float(np.sum(even**2)), float(np.abs(z).max())
    p_square = (
        2 * min(stats.chi2.cdf(total, even.size), stats.chi2.sf(total, even.size))
        if even.size
        else 1.0
    )
    p_largest = -math.expm1(
        z.size * math.log1p(-min(2 * stats.norm.sf(largest), 1 - 1e-16))
    )
    passed = bool(p_square > ALARM and p_largest > ALARM)
    return Verdict(
        kind, z.size, even.size, total, float(p_square), largest, p_largest, passed
    )


def validate(
    suite: str = "quick",
    *,
    seed: int = 1,
    threads: int = 1,
    wrong: Mutation | None = None,
    part: Part = WHOLE,
    progress: Progress | None = None,
) -> Validation:
    """Compare contacts with the master equation over the parameter space.

    Parameters
    ----------
    suite : str
        "quick" (32 points), "full" (240) or "verification" (1008).
    seed : int
        Of the points and of the lives.
    threads : int
        Changes speed only.
    wrong : callable, optional
        Changes the ensemble that the engine sees but not the reference's: a suite that
        then still passes is worthless.
    part : Part or (int, int)
        (i, m) does every m-th point from the i-th on; the scores of all parts are those
        of the suite.
    progress : callable, optional
        Called with the number of points done and of all.

    Returns
    -------
    Validation

    Raises
    ------
    InputError
        For an unknown suite.

    Examples
    --------
    >>> from eqsim import validate
    >>> validate("quick").passed  # in minutes  # doctest: +SKIP
    True
    >>> validate("long")
    Traceback (most recent call last):
    eqsim.errors.InputError: suite = 'long': must be one of "quick", "full", "verification"
    """
    if suite not in SUITES:
        raise InputError(
            f"suite = {suite!r}: must be one of "
            + ", ".join(f'"{name}"' for name in SUITES)
        )
    plan = SUITES[suite]
    first, step = part
    total = len(range(first, plan.points, step))
    found: Found = []
    for done, (index, ensemble, v) in enumerate(sample(plan.points, seed, part), 1):
        shown = wrong(ensemble) if wrong else ensemble
        own = stream(seed, index)
        point = Point(index, ensemble, shown, v, own, seed, threads)
        found += compared(point, plan) + pulled.compared(point, plan)
        if progress:
            progress(done, total)
    scores = [one for one in found if isinstance(one, Score)]
    unscored = [one for one in found if isinstance(one, Unscored)]
    return Validation(
        suite, seed, scores, [judge(kind, scores) for kind in KINDS], unscored
    )
