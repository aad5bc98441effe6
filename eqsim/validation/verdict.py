"""Verdict on the engine, compared with the master equation over the parameter space.

A suite draws parameter points (`points`) and compares, point by point, estimates from
contacts with values of the master equation, each difference as a score z in units of
the quoted errors (`scores`).

Comparisons that are not scored are counted by reason: refused by the program, called
unreliable by it, or too vague, with an error that leaves nothing to compare; too few
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
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from eqsim.errors import InputError, require_choice, require_threads, shown
from eqsim.model.drive import Output
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.streams import seed_named
from eqsim.validation import chains, pulled, scores
from eqsim.validation.comparison import (
    DECLINED,
    Found,
    Point,
    Score,
    Unscored,
    columns,
)
from eqsim.validation.points import SUITES, WHOLE, Part, sample

KINDS = (*scores.DRIVEN_KINDS, *pulled.PULLED_KINDS)

# Probability of a kind's scores below which it fails.
ALARM = 1e-4

Mutation = Callable[[Ensemble], Ensemble]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Verdict:
    """The `count` scores of a kind, `even` of which make its chi-square: both
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
    """Result of a suite.

    Attributes
    ----------
    suite, seed
        Arguments of `validate`.
    scores : list of Score
    verdicts : list of Verdict
        One for each of `KINDS`, or of `chains.CHAIN_KINDS`.
    unscored : list of Unscored
        Comparisons left out, with reasons.
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
        said = said if self.scores else "nothing compared"
        count = f"{len(self.scores)} comparisons"
        return f"Validation(suite {self.suite}, seed {self.seed}: {said}, {count})"

    def _repr_html_(self) -> str:
        """The verdict on each kind."""
        import pandas as pd

        verdicts = pd.DataFrame([asdict(verdict) for verdict in self.verdicts])
        return f"{html.escape(repr(self))}{verdicts.to_html(index=False)}"

    @property
    def passed(self) -> bool:
        """True if anything was compared, every kind passes, and the program declined no
        more comparisons of any kind than were scored."""
        kinds = all(verdict.passed for verdict in self.verdicts)
        return bool(self.scores) and kinds and not self.declined

    @property
    def declined(self) -> list[str]:
        """Kinds of which the program declined more comparisons than were scored."""
        left = left_out(self.unscored)
        return [v.kind for v in self.verdicts if declined(v.kind, v.count, left)]

    @property
    def p_overall(self) -> float:
        """Upper bound (Bonferroni) of the probability of a p-value as small as the
        smallest of all kinds."""
        return p_overall(self.verdicts)


def left_out(unscored: list[Unscored]) -> dict[str, dict[str, int]]:
    """Numbers of comparisons that were not made, by kind and reason."""
    found: dict[str, dict[str, int]] = {}
    for one in unscored:
        reasons = found.setdefault(one.kind, {})
        reasons[one.reason] = reasons.get(one.reason, 0) + 1
    return found


def declined(kind: str, count: int, left: dict[str, dict[str, int]]) -> bool:
    """True if more comparisons of a kind were declined by the program (`DECLINED`) than
    the `count` made."""
    return sum(left.get(kind, {}).get(reason, 0) for reason in DECLINED) > count


def p_overall(verdicts: list[Verdict]) -> float:
    """`Validation.p_overall` of these verdicts; 1 if nothing was compared."""
    pairs = [(v.p_chi_square, v.p_largest) for v in verdicts if v.count]
    return min(1.0, 2 * len(pairs) * min(map(min, pairs))) if pairs else 1.0


def judge(kind: str, scores: list[Score]) -> Verdict:
    """Chi-square of the even scores of a kind, and largest |z| of all."""
    of_kind = [score for score in scores if score.kind == kind]
    if not of_kind:
        return Verdict(kind, 0, 0, 0.0, 1.0, 0.0, 1.0, True)
    z = np.array([score.z for score in of_kind])
    even = z[[score.even for score in of_kind]]
    total, largest, p_square = float(np.sum(even**2)), float(np.abs(z).max()), 1.0
    if even.size:
        tails = stats.chi2.cdf(total, even.size), stats.chi2.sf(total, even.size)
        p_square = float(2 * min(tails))
    beyond = min(2 * stats.norm.sf(largest), 1 - 1e-16)
    p_largest = -math.expm1(z.size * math.log1p(-beyond))
    passed = bool(p_square > ALARM and p_largest > ALARM)
    sizes = kind, z.size, even.size
    return Verdict(*sizes, total, p_square, largest, p_largest, passed)


def _part_of(part: Part | tuple[int, int], points: int) -> Part:
    """A part of a suite of so many points. Raises InputError."""
    whole = isinstance(part, tuple | list) and [type(n) for n in part] == [int, int]
    if not (whole and 0 <= part[0] < points and part[1] >= 1):
        said = f"must be integers (i, m) with i from 0 to {points - 1} and m from 1 on"
        raise InputError(f"part = {shown(part)}: {said}")
    return Part(*part)


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
        "quick" (32 points), "full" (240) or "verification" (1008); or "interface", 16
        chains of blocks against their linear creep and exact speeds of fronts.
    seed : int
        Seed of the points and of the lives.
    threads : int
        Number of threads; it changes speed only.
    wrong : callable, optional
        Changes the ensemble that the engine sees but not the reference's, to check that
        the suite then fails.
    part : Part or (int, int)
        (i, m) does every m-th point from the i-th on, of those from 0; the scores of
        the parts (0, m) to (m - 1, m) are those of the suite.
    progress : callable, optional
        Called with the number of points done and of all.

    Returns
    -------
    Validation

    Raises
    ------
    InputError
        For an unknown suite, and arguments out of range.

    Examples
    --------
    >>> from eqsim import validate
    >>> validate("quick").passed  # in minutes  # doctest: +SKIP
    True
    >>> validate("long")
    Traceback (most recent call last):
    eqsim.errors.InputError: suite = 'long': must be one of "quick", "full", "interface", "verification"
    """
    require_choice("suite", suite, (*SUITES,))
    Output(seed=seed)
    require_threads(threads)
    plan, every = SUITES[suite], Found()
    part = first, step = _part_of(part, plan.points + plan.chains)
    linked = range(first, plan.chains, step)
    total = len(range(first, plan.points, step)) + len(linked)
    drawn_at = sample(plan.points, seed, part, plan.solids)
    for done, (index, ensemble, v) in enumerate(drawn_at, 1):
        simulated = wrong(ensemble) if wrong else ensemble
        drawn = seed_named(seed, index)
        point = Point(index, ensemble, simulated, v, drawn, seed, threads)
        every += scores.compare_driven(point, plan) + pulled.compare_pulled(point, plan)
        if progress:
            progress(done, total)
    for done, index in enumerate(linked, 1):
        ensemble = chains.contacts_of(index)
        simulated = wrong(ensemble) if wrong else ensemble
        drawn = seed_named(seed, index)
        point = Point(index, ensemble, simulated, math.nan, drawn, seed, threads)
        every += chains.compare_chain(point, plan)
        if progress:
            progress(done, total)
    made = [one for one in every if isinstance(one, Score)]
    unscored = [one for one in every if isinstance(one, Unscored)]
    kinds = chains.CHAIN_KINDS if plan.chains else KINDS
    verdicts = [judge(kind, made) for kind in kinds]
    return Validation(suite, seed, made, verdicts, unscored)
