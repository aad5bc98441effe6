"""A comparison at a point of the parameter space, its score, and reasons for none."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from eqsim.errors import InputError
from eqsim.estimate import Estimate, known, z_score
from eqsim.laws.aging import RULES, Aging
from eqsim.model.chain import Chain
from eqsim.model.drive import Drive, Stage, Start
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.streams import seed_named
from eqsim.numerics.tables import Array
from eqsim.validation.points import Suite, law_text

# Reasons why a comparison is left out; the first three are the program's own.
DECLINED = ("refused", "unreliable", "vague")
REASONS = (*DECLINED, "few contacts", "too many lives", "no reference")
# Bound over quoted error up to which a score is even: scatter then makes 98 % of it.
_BOUND_OF_ERROR = 0.2
# A bound, relative to what it bounds, that leaves nothing to compare.
_VAGUE = 0.1


class LeftOut(Exception):
    """No comparison can be made, for one of `REASONS`."""


@dataclass(frozen=True)
class Score:
    """A comparison: its kind, the ensemble and velocity, the `value` of the engine, the
    `reference` of the master equation, the error `sigma` of their difference, and z;
    `even` if sigma is scatter, so that z is normal; elsewhere bounds add to it, and z is
    small.

    For a hazard law the numbers are the distance of Kolmogorov and Smirnov, 0, and
    n^(-1/2) of n lives. For a slider that a stage pulls there are the `stage`, the
    `count` of its contacts, and the `time` of the hold or pull; for blocks that move in
    time there is the `chain`."""

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
    chain: Chain | None = None


class Unscored(NamedTuple):
    """A comparison that was asked for and not made, with one of `REASONS`, and the
    program's message."""

    kind: str
    ensemble: Ensemble
    velocity: float
    reason: str
    message: str = ""


Found = list[Score | Unscored]


class Point(NamedTuple):
    """A point of the parameter space: its number, the ensemble of the reference, the one
    `shown` to the engine, its seed and that of the suite, and the threads that simulate
    it; of a slider that a stage pulls, or of a chain, also the last fields of
    `Score`."""

    number: int
    ensemble: Ensemble
    shown: Ensemble
    velocity: float
    seed: int
    suite_seed: int
    threads: int = 1
    stage: Stage | None = None
    contacts: int = 0
    time: float = math.nan
    chain: Chain | None = None

    def stream(self, *numbers: int) -> int:
        """A seed for this point and these numbers."""
        return seed_named(self.seed, *numbers)

    def rng(self, number: int) -> np.random.Generator:
        """A generator for this point and this number."""
        return np.random.default_rng((self.seed, number))

    def drive(self, distance: float, start: Start = "fresh") -> Drive:
        """A drive at the velocity of this point."""
        return Drive(self.velocity, distance, start)

    def without(self, kinds: tuple[str, ...], reason: str, message: str = "") -> Found:
        """Leave out comparisons of these kinds."""
        where = self.ensemble, self.velocity
        return [Unscored(kind, *where, reason, message) for kind in kinds]

    def score(
        self, kind: str, ours: Estimate, exact: Estimate, bound: float | None = None
    ) -> Score | Unscored:
        """Score an estimate against an exact value with its error. The `bound` is what
        both errors have beside scatter, by default the error of the exact value."""
        value, error = known(exact), exact.stderr or 0.0
        sigma, z = math.hypot(ours.stderr or 0.0, error), z_score(ours, value, error)
        bound = error if bound is None else bound
        even, where = bound <= _BOUND_OF_ERROR * sigma, (self.ensemble, self.velocity)
        if not even and bound > _VAGUE * abs(value):
            return Unscored(kind, *where, "vague")
        score = math.inf if z is None else z
        numbers = known(ours), value, sigma, score
        pulled: dict[str, Any] = {"stage": self.stage, "count": self.contacts}
        pulled |= {"time": self.time, "chain": self.chain}
        return Score(kind, *where, *numbers, even, **pulled)

    def uniform(self, share: Array) -> Score:
        """Test whether shares are uniform in (0, 1)."""
        distance, p = stats.kstest(share, "uniform")
        # negative if shares are spaced more evenly than at random
        z = float(stats.norm.isf(np.clip(p, 1e-300, 1 - 1e-16)))
        root, where = 1 / math.sqrt(share.size), (self.ensemble, self.velocity)
        return Score("hazard law", *where, float(distance), 0.0, root, z)


@dataclass(frozen=True)
class Comparison:
    """A function that makes comparisons at a point, `each` of every kind."""

    kinds: tuple[str, ...]
    each: int
    make: Callable[[Point, Suite], Found]

    def __call__(self, point: Point, plan: Suite) -> Found:
        """Make the comparisons; if refused or left out, all are unscored."""
        try:
            return self.make(point, plan)
        except LeftOut as reason:
            return self.without(point, str(reason))
        except InputError as error:
            return self.without(point, "refused", str(error))

    def without(self, point: Point, reason: str, message: str = "") -> Found:
        """Leave out all comparisons."""
        return point.without(self.each * self.kinds, reason, message)


def compares(
    *kinds: str, each: int = 1
) -> Callable[[Callable[[Point, Suite], Found]], Comparison]:
    """Decorate a function that scores these kinds: it becomes a `Comparison`."""
    return lambda make: Comparison(kinds, each, make)


def columns(scores: list[Score]) -> dict[str, list[Any]]:
    """The scores as columns of a table, one row per comparison; NaN where a column does
    not apply."""
    rows = [_table_row(score) for score in scores]
    return {name: [row[name] for row in rows] for name in rows[0]} if rows else {}


def _table_row(score: Score) -> dict[str, Any]:
    ensemble = score.ensemble
    thermal, aging = ensemble.thermal, ensemble.aging
    takes = RULES[aging.rule].keys if aging.rule in RULES else ()
    others = [field.name for field in fields(Aging)[2:]]
    row: dict[str, Any] = {"kind": score.kind, "disorder": ensemble.disorder}
    row |= {"barrier": thermal.barrier, "stiffness_law": ensemble.stiffness_law}
    row |= {"thresholds": law_text(ensemble.thresholds), "kT": thermal.kT}
    row |= {"off_rate": thermal.off_rate, "force_scale": thermal.force_scale}
    for name in ("catch", "slip"):
        path = getattr(thermal, name)
        row[f"{name}_rate"] = getattr(path, "rate", None)
        row[f"{name}_force"] = getattr(path, "force", None)
    row |= {"aging": aging.rule, "aging_rate": aging.rate}
    row |= {name: getattr(aging, name) if name in takes else None for name in others}
    delay, newborn = ensemble.delay, ensemble.newborn
    row |= {"delay": delay.time, "delay_law": delay.law, "eta": ensemble.eta}
    row |= {"delay_shape": delay.shape, "delay_sigma": delay.sigma}
    row |= {name: getattr(score, name) for name in ("velocity", "value", "reference")}
    row |= {"sigma": score.sigma, "z": score.z, "even": score.even}
    row |= {"contacts": score.count, "time": score.time}
    row |= {f"newborn_{name}": value for name, value in vars(newborn).items()}
    for name in ("stiffness", "damping", "preload"):
        row[f"stage_{name}"] = getattr(score.stage, name, None)
    row["chain"] = repr(score.chain) if score.chain else ""
    return {name: math.nan if x is None else x for name, x in row.items()}
