"""A comparison at a point of the parameter space: what it is made of, how it is scored,
and what is not scored."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from eqsim.errors import InputError
from eqsim.estimate import Estimate, known, z_score
from eqsim.laws.aging import RULES
from eqsim.laws.newborn import Newborn
from eqsim.model.drive import Drive, Stage, Start
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array
from eqsim.validation.points import Suite, law_text

DECLINED = ("refused", "unreliable", "vague")
REASONS = (*DECLINED, "few contacts", "too many lives", "no reference")
_SHARE = 0.2  # of a quoted error that may be a bound: scatter then makes 98 % of it
_VAGUE = 0.1  # a bound, relative to what it bounds, that leaves nothing to compare


@dataclass(frozen=True)
class Score:
    """One comparison: its kind, the ensemble and velocity, what the engine and the
    master said, and z; `even` if sigma is scatter, so that z is normal; elsewhere
    bounds add to it, and z is small.

    Of a hazard law these are the distance of Kolmogorov and Smirnov, 0, and n^(-1/2) of
    n lives. Of a slider that a stage pulls there are the `stage`, the `count` of its
    contacts, and the `time` of the hold or pull."""

    kind: str
    ensemble: Ensemble
    velocity: float
    value: float
    reference: float
    sigma: float
    z: float
    even: bool = True
    stage: Stage | None = None
    count: int = 0
    time: float = math.nan

    def behind(self, stage: Stage, count: int, time: float) -> "Score":
        """The same score, of `count` contacts of a slider behind the spring of a stage
        after that time."""
        return dataclasses.replace(self, stage=stage, count=count, time=time)


class Unscored(NamedTuple):
    """A comparison that was asked for and not made, and why: one of `REASONS`, and what
    the program said."""

    kind: str
    ensemble: Ensemble
    velocity: float
    reason: str
    message: str = ""

    def behind(self, stage: Stage, count: int, time: float) -> "Unscored":
        """The same: it has no row in the table of scores."""
        return self


Found = list[Score | Unscored]


class Point(NamedTuple):
    """A point of the parameter space: its number, the ensemble, the one that the engine
    is shown, its seed and that of the suite, and the threads that simulate it."""

    number: int
    ensemble: Ensemble
    shown: Ensemble
    velocity: float
    seed: int
    suite_seed: int
    threads: int = 1

    def stream(self, *numbers: int) -> int:
        """A seed for something drawn here."""
        return stream(self.seed, *numbers)

    def drive(self, distance: float, start: Start = "fresh") -> Drive:
        """At the velocity of this point."""
        return Drive(self.velocity, distance, start)

    def without(self, kinds: tuple[str, ...], reason: str, message: str = "") -> Found:
        """None of these comparisons made."""
        return [
            Unscored(kind, self.ensemble, self.velocity, reason, message)
            for kind in kinds
        ]

    def score(
        self, kind: str, ours: Estimate, exact: Estimate, bound: float
    ) -> Score | Unscored:
        """An estimate against an exact value with its error; of both quoted errors, so
        much is a `bound`."""
        value, error = known(exact), exact.stderr or 0.0
        sigma, z = math.hypot(ours.stderr or 0.0, error), z_score(ours, value, error)
        even = bound <= _SHARE * sigma
        if not even and bound > _VAGUE * abs(value):
            return Unscored(kind, self.ensemble, self.velocity, "vague")
        where = kind, self.ensemble, self.velocity
        score = math.inf if z is None else z
        return Score(*where, known(ours), value, sigma, score, even)

    def uniform(self, share: Array) -> Score:
        """Test whether numbers are uniform, as they should be."""
        distance, p = stats.kstest(share, "uniform")
        # low if it is too even
        z = float(stats.norm.isf(np.clip(p, 1e-300, 1 - 1e-16)))
        root, distance = 1 / math.sqrt(share.size), float(distance)
        kind = "hazard law", self.ensemble, self.velocity
        return Score(*kind, distance, 0.0, root, z)


# Kinds of comparisons, and what makes them at a point.
Asked = tuple[tuple[str, ...], Callable[[Point, Suite], Found]]


def attempt(point: Point, plan: Suite, asked: list[Asked]) -> Found:
    """The comparisons that are asked for; those that the program refuses are unscored."""
    scores: Found = []
    for kinds, compare in asked:
        try:
            scores += compare(point, plan)
        except InputError as error:
            scores += point.without(kinds, "refused", str(error))
    return scores


def stream(*numbers: int) -> int:
    """A seed of its own for all that draws."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0] >> 1)


_COLUMNS = {
    "kind": "kind", "disorder": "ensemble.disorder", "barrier": "ensemble.thermal.barrier",
    "stiffness_law": "ensemble.stiffness_law", "thresholds": "ensemble.thresholds", "kT": "ensemble.thermal.kT",
    "aging": "ensemble.aging.rule", "aging_rate": "ensemble.aging.rate", "x_star_final": "ensemble.aging.x_star_final",
    "beta": "ensemble.aging.beta", "cutoff_time": "ensemble.aging.cutoff_time",
    "delay": "ensemble.delay.time", "delay_law": "ensemble.delay.law", "eta": "ensemble.eta", "velocity": "velocity",
    "value": "value", "reference": "reference", "sigma": "sigma", "z": "z", "even": "even",
    "contacts": "count", "time": "time",
    **{f"newborn_{field.name}": f"ensemble.newborn.{field.name}" for field in dataclasses.fields(Newborn)},
}  # fmt: skip


def columns(scores: list[Score]) -> dict[str, list[Any]]:
    """The scores as columns of a table, one row per comparison."""
    if not scores:
        return {}
    table = {
        name: [attrgetter(path)(score) for score in scores]
        for name, path in _COLUMNS.items()
    }
    table["thresholds"] = [law_text(law) for law in table["thresholds"]]
    for name in ("stiffness", "damping", "preload"):
        table[f"stage_{name}"] = [
            _number(getattr(score.stage, name, None)) for score in scores
        ]
    for name in ("x_star_final", "beta", "cutoff_time"):
        ages = zip(table["aging"], table[name], strict=True)
        table[name] = [
            value if rule in RULES and name in RULES[rule].keys else math.nan
            for rule, value in ages
        ]
    for name in (name for name in table if name.startswith("newborn_")):
        table[name] = [math.nan if value is None else value for value in table[name]]
    return table


def _number(value: float | None) -> float:
    """A number for a table, NaN if there is none."""
    return math.nan if value is None else value
