"""An interface of N contacts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple

from eqsim.errors import (
    Checked,
    InputError,
    Limits,
    NotNegative,
    Positive,
    shown,
    under,
)
from eqsim.laws.aging import RULES, Aging
from eqsim.laws.barrier import BARRIERS, Barrier
from eqsim.laws.barrier.pooled import pooled_hazard_of
from eqsim.laws.delay import Delay
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import NoThresholds
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.laws.thermal import Thermal
from eqsim.laws.threshold import Gamma, ThresholdLaw, diverges, tail_exponent
from eqsim.laws.viscosity import Viscosity
from eqsim.numerics.streams import seed_named

Disorder = Literal["quenched", "annealed"]


@dataclass(frozen=True)
class Population(Checked):
    """Contacts of one kind in an ensemble of several, such as strong and weak ones.

    Raises InputError for a share out of range.

    Parameters
    ----------
    share : float
        Share of the contacts, > 0, relative to the sum of all shares. N contacts are
        divided by largest remainders; every result is of the N_p contacts found so.
    stiffness, thresholds, thermal, delay, aging, newborn : optional
        As in `Ensemble`, and by default those of the ensemble.

    Examples
    --------
    >>> weak, strong = Population(0.9), Population(0.1, stiffness=5.0)
    >>> Ensemble(populations=(weak, strong)).mean_stiffness
    1.4
    """

    share: Positive
    stiffness: float | None = None
    thresholds: ThresholdLaw | None = None
    thermal: Thermal | None = None
    delay: Delay | None = None
    aging: Aging | None = None
    newborn: Newborn | None = None


class Kind(NamedTuple):
    """The contacts of one kind, of population `number`, alone; their shares of the
    number and of the stiffness of all contacts, s = N_p/N and w = N_p k_p/(N k), and
    w^2/s, by which variances are weighted."""

    number: int
    contacts: "Ensemble"
    share: float = 1.0
    weight: float = 1.0
    square: float = 1.0

    def seed(self, seed: int) -> int:
        """A seed for each kind; the `seed` of the ensemble for the first."""
        return seed_named(seed, self.number) if self.number else seed


def split(count: int, shares: Sequence[float]) -> list[int]:
    """Divide `count` in proportion to `shares` by largest remainders."""
    exact = [count * share / math.fsum(shares) for share in shares]
    numbers = [math.floor(number) for number in exact]
    by_rest = sorted(range(len(exact)), key=lambda i: numbers[i] - exact[i])
    for i in by_rest[: count - sum(numbers)]:
        numbers[i] += 1
    return numbers


@dataclass(frozen=True)
class Ensemble(Checked):
    """N contacts of one kind (section 1 of Braun and Peyrard, 2011), or of several.

    Raises InputError for a value out of range, or laws that do not go together.

    Parameters
    ----------
    thresholds : ThresholdLaw
        Law of newborn threshold stretches (length): `Gamma`, `Delta`, another by name
        (`Lognormal`, `Weibull`, `Exponential`, `Normal`, `Uniform`, `Pareto`), `Table`
        or `Distribution`; or `NoThresholds` of contacts that only heat breaks, which
        are alike: stiffness and disorder are "uniform" and "quenched" then.
    thermal : Thermal
        Temperature, attempt frequency and barrier.
    delay : Delay
        Between breaking and re-attachment.
    aging : Aging
        Of thresholds while pinned.
    count : int
        N.
    stiffness : float
        k (force/length), the mean of the ensemble's k_i at the mean threshold force.
    stiffness_law : str
        "sqrt" (k_i ~ sqrt(f_si)) or "uniform".
    disorder : str
        "quenched": a contact keeps its threshold for life, or its threshold ages (the
        literal model). "annealed": every thermal attempt draws a fresh threshold (the
        published master equation).
    eta : float
        Viscous coefficient of a detached contact, of force eta v.
    newborn : Newborn
        Law of their stretches at birth.
    viscosity : Viscosity
        Another drag of a detached contact.
    populations : sequence of Population
        Kinds of contacts, of which k is the mean stiffness; the values above are those
        that a population does not give.

    Examples
    --------
    >>> contacts = Ensemble(Gamma(n=1.0), Thermal(kT=0.1), count=1000)
    >>> contacts.b  # k x_*^2/(2 kT)
    5.0
    """

    thresholds: ThresholdLaw = Gamma()
    thermal: Thermal = Thermal()
    delay: Delay = Delay()
    aging: Aging = Aging()
    count: Annotated[int, Limits(1, 10**12)] = 100_000
    stiffness: Positive = 1.0
    stiffness_law: StiffnessLaw = "sqrt"
    disorder: Disorder = "quenched"
    eta: NotNegative = 0.0
    newborn: Newborn = Newborn()
    viscosity: Viscosity = Viscosity()
    populations: Sequence[Population] = ()

    def __post_init__(self) -> None:
        law, kinds = self.thresholds, self.populations
        if isinstance(law, type) or not hasattr(law, "declared"):
            said = "must be a law of thresholds, such as Gamma(1.0)"
            raise InputError(f"thresholds = {shown(law)}: {said}")
        listed = isinstance(kinds, Sequence)
        if not listed or not all(isinstance(kind, Population) for kind in kinds):
            said = "must be a sequence of Population(...)"
            raise InputError(f"populations = {shown(kinds)}: {said}")
        super().__post_init__()
        if isinstance(self.thresholds, NoThresholds):
            self._make_unlimited(self.thresholds)
        if not self.populations:  # each kind of several is checked for itself
            self.aging.check(self.thresholds, self.disorder)
            with under("newborn"):
                self.newborn.check(self.thresholds, self.disorder, self.aging.active)
        object.__setattr__(self, "populations", tuple(self.populations))  # for its hash
        _ = self.kinds

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """The kinds of contacts, but for populations that none of the N belongs to.
        Raises InputError for laws that do not go together."""
        if not self.populations:
            return (Kind(0, self),)
        numbers, alone = split(self.count, [x.share for x in self.populations]), []
        for index, population in enumerate(self.populations):
            given = {k: x for k, x in vars(population).items() if x is not None}
            given["count"] = max(numbers[index], 1)
            del given["share"]
            with under(f"population.{index}"):
                alone.append(replace(self, populations=(), **given))
        share = [n / self.count for n in numbers]
        forces = [s * x.stiffness for s, x in zip(share, alone, strict=True)]
        weight = [force / math.fsum(forces) for force in forces]
        return tuple(
            Kind(i, kind, share[i], weight[i], weight[i] ** 2 / share[i])
            for i, kind in enumerate(alone)
            if numbers[i]
        )

    @property
    def mean_stiffness(self) -> float:
        """k (force/length), the mean over all contacts."""
        return math.fsum(kind.share * kind.contacts.stiffness for kind in self.kinds)

    def _make_unlimited(self, law: NoThresholds) -> None:
        """Adapt contacts without thresholds, whose typical stretch follows from the
        bond; of several kinds that is the unit, and each of them is adapted for itself.
        Raises InputError for what needs thresholds."""
        heat, aging, newborn = self.thermal, self.aging, self.newborn
        force = heat.slip.force if heat.slip else heat.force_scale
        of_threshold = newborn.active and newborn.of == "threshold"
        for key, value, wrong in (
            ("thermal.barrier", heat.barrier, force is None),
            ("aging.rule", aging.rule, aging.rule != "none"),
            ("newborn.of", newborn.of, of_threshold),
        ):
            if wrong and not self.populations:
                said = 'not allowed with thresholds.law = "none"'
                raise InputError(f'{key} = "{value}": {said}')
        if force or not self.populations:
            with under("thresholds"):
                law = law.of_bond((force or math.inf) / self.stiffness)
        object.__setattr__(self, "thresholds", law)
        if not self.populations:
            object.__setattr__(self, "stiffness_law", "uniform")
            object.__setattr__(self, "disorder", "quenched")

    def declared(self, velocity: float) -> tuple[Any, ...]:
        """List what a life depends on, as it was declared, for the names of random
        streams: texts and dimensionless numbers, which are products and ratios and so
        the same in other units and on other machines."""
        thermal, delay, aging = self.thermal, self.delay, self.aging
        unit, *law = self.thresholds.declared
        barrier = BARRIERS[thermal.barrier]
        numbers = barrier.declared(thermal, self.stiffness, unit, velocity)
        rule = "pooled" if self.disorder == "annealed" else aging.rule
        ages = (rule, *aging.declared(unit, velocity)) if aging.active else ()
        born = self.newborn.declared if self.newborn.active else ()
        scale = 1.0 if self.newborn.of == "threshold" else unit
        births = (part if isinstance(part, str) else part / scale for part in born)
        kind = self.disorder, self.stiffness_law, *law, thermal.barrier, *numbers
        waits = self.delay_time(velocity) * velocity / unit, *delay.parameters
        return (*kind, delay.law, *waits, *ages, *births)

    def delay_time(self, velocity: float) -> float:
        """Mean delay (time) at the ensemble's temperature and a velocity."""
        return self.delay.at(self.thermal.kT, velocity).time

    def require_steady_state(self, velocity: float) -> None:
        """Raise InputError if contacts do not form again at a velocity, so that none is
        pinned in the end."""
        waits = (kind.contacts.delay_time(velocity) for kind in self.kinds)
        if math.inf in waits:
            said = "no contact forms again, and none is pinned in the steady state"
            raise InputError(f'delay.time = inf: {said}; take drive.start = "fresh"')

    @property
    def self_consistent(self) -> bool:
        """True if births depend on the mean pinned time: annealed, of finite aging."""
        finite = self.aging.active and self.aging.rate < math.inf
        return finite and self.disorder == "annealed"

    @property
    def fluctuates(self) -> bool:
        """True if thresholds fluctuate while pinned: quenched, aging by `langevin`."""
        if self.populations:
            return any(kind.contacts.fluctuates for kind in self.kinds)
        quenched, aging = self.disorder == "quenched", self.aging
        return quenched and aging.active and RULES[aging.rule].fluctuates

    @property
    def changes_at_rest(self) -> bool:
        """True if contacts may break, or be born stretched, though nothing moves."""
        if self.populations:
            return any(kind.contacts.changes_at_rest for kind in self.kinds)
        b, rate = self._barrier_numbers[:2]
        return (b < math.inf and rate > 0) or self.fluctuates or self.newborn.active

    @property
    def divergence(self) -> str:
        """Reason why the steady variance of forces is infinite, in a line; empty where it is
        finite.

        At T = 0 a life contributes k_i^2 xi^3/3. Neither heat nor age shortens the
        strongest lives by more than a factor: barriers outgrow temperature, pooled
        attempts are a finite number. But the rate of quenched bonds that depends on
        their force alone cuts lives off at a stretch that thresholds do not raise.
        """
        if self.populations:
            found = (kind.contacts.divergence for kind in self.kinds)
            return next(filter(None, found), "")
        if self.delay_time(1.0) == math.inf:
            return ""  # all contacts are detached
        rate = self._barrier_numbers[1]
        if rate > 0 and self.disorder == "quenched" and self._barrier.lasting:
            return ""
        power = 5 if self.stiffness_law == "sqrt" else 3
        if isinstance(self.thresholds, Gamma) or not diverges(self.thresholds, power):
            return ""
        exponent = tail_exponent(self.thresholds)
        mean = "<k_i^2 xi^3> ~ <xi^5>" if power == 5 else "<xi^3>"
        why = f"{mean} diverges, as P(xi > x) falls like x^-{exponent:.4g}"
        return f"the variance of forces is infinite: {why}"

    @property
    def b(self) -> float:
        """k x_*^2/(2 kT), eq. (21) of Braun and Peyrard (2011), with the scale x_* of
        the threshold law. Infinite at kT = 0. Of bonds whose rate depends on the force
        alone, k x_* over the scale of force. Raises InputError for several kinds."""
        return self._barrier_numbers[0]

    @property
    def _barrier_numbers(self) -> tuple[float, ...]:
        if self.populations:
            raise InputError("population: these are numbers of one kind; see kinds")
        law, unit = BARRIERS[self.thermal.barrier], self.thresholds.scale
        return law.numbers(self.thermal, self.stiffness, unit)

    @property
    def _barrier(self) -> Barrier:
        """The barrier in units of the law, at one attempt in a travel of its scale."""
        b, _, *others = self._barrier_numbers
        law: Any = BARRIERS[self.thermal.barrier]
        barrier: Barrier = law(b, 0.0, *others)
        return barrier

    @property
    def crossover_velocity(self) -> float:
        """v_* (length/time) of the annealed ensemble of newborn thresholds, where
        Delta U(inf) = 1: eq. (26) of Braun and Peyrard (2011) with S_0 = 1, for every
        law (derived). 0 at kT = 0, infinite without thresholds. Raises InputError for
        several kinds."""
        b, rate = self._barrier_numbers[:2]
        if math.isinf(b) or rate == 0:
            return 0.0
        if isinstance(self.thresholds, NoThresholds):
            return math.inf
        pool = pooled_hazard_of(self.thresholds, self.stiffness_law, self._barrier, b)
        # no attempt succeeds at very low temperature
        total = pool.G[-1] if pool.G.size else 0.0
        return float(rate * self.thresholds.scale * total)
