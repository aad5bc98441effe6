"""An interface of N contacts and how it is driven; where both are lowered to plain numbers for the kernels."""

import functools
import math
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_choice, require_integer, require_number
from eqsim.laws.aging import FLOW, LANGEVIN, UNAGED, Aging, Pooled, flow_work_table
from eqsim.laws.delay import Delay
from eqsim.laws.octaves import Array
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.laws.thermal import (
    MECHANICAL,
    MOST_POOLED_STEPS,
    NO_POOL,
    POOLED,
    SOFT,
    STIFF,
    PooledHazard,
    Thermal,
    erfi_inverse_table,
    pooled_hazard,
)
from eqsim.laws.threshold import NO_TABLE, Gamma, ThresholdLaw, exponentials_of

Disorder = Literal["quenched", "annealed"]
Start = Literal["fresh", "stationary"]

_LEAST_B = 1e-100  # b below which the barrier is 0
_FLAT_OUT = {"soft": 1e16, "stiff": 1e18}  # and above which a quenched contact breaks at its threshold, to 1e-10
_LARGEST_POOLED_B = 1e15  # above it a pooled hazard would be made of differences between neighbouring numbers
_MOST_ALPHA = 1e6  # relaxations of a `langevin` threshold while its contact slides x_*: steps, and time, grow with it


@dataclass(frozen=True)
class Ensemble:
    """N contacts of one kind (section 1 of Braun and Peyrard, 2011).

    `count` N; `stiffness` k (force/length), the mean of the ensemble's k_i at the mean threshold force, with
    `stiffness_law` "sqrt" (k_i ~ sqrt(f_si)) or "uniform"; `eta`, viscous coefficient of a detached contact
    (force eta v); `disorder` "quenched" (a contact keeps its threshold for life, or its threshold ages: the literal
    model) or "annealed" (every thermal attempt draws a fresh threshold: the published master equation). Raises
    InputError.
    """

    thresholds: ThresholdLaw = field(default_factory=Gamma)
    thermal: Thermal = field(default_factory=Thermal)
    delay: Delay = field(default_factory=Delay)
    aging: Aging = field(default_factory=Aging)
    count: int = 100_000
    stiffness: float = 1.0
    stiffness_law: StiffnessLaw = "sqrt"
    disorder: Disorder = "quenched"
    eta: float = 0.0

    def __post_init__(self) -> None:
        require_integer("count", self.count, 1, 10**12)
        require_number("stiffness", self.stiffness, **POSITIVE)
        require_choice("stiffness_law", self.stiffness_law, ("sqrt", "uniform"))
        require_choice("disorder", self.disorder, ("quenched", "annealed"))
        require_number("eta", self.eta, **NOT_NEGATIVE)
        self.aging.check(self.thresholds, self.disorder)

    def declared(self, velocity: float) -> tuple[Any, ...]:
        """What a life depends on, as it was declared, for the names of random streams: texts and dimensionless numbers,
        which are products and ratios and so the same in other units and on other machines."""
        thermal, delay, aging = self.thermal, self.delay, self.aging
        unit, *law = self.thresholds.declared
        heat = thermal.barrier, thermal.kT / (self.stiffness * unit * unit), thermal.attempt_frequency * unit / velocity
        rule = "pooled" if self.disorder == "annealed" else aging.rule
        ages = (rule, aging.rate / (unit * velocity), aging.x_star_final / unit) if aging.active else ()
        return (self.disorder, self.stiffness_law, *law, *heat, delay.law, delay.time * velocity / unit, *ages)

    @property
    def self_consistent(self) -> bool:
        """Whether births depend on the mean pinned time: annealed contacts that age at a finite rate."""
        return self.disorder == "annealed" and self.aging.active and self.aging.rate < math.inf

    @property
    def fluctuates(self) -> bool:
        """Whether thresholds fluctuate while pinned: quenched contacts that age by `langevin`."""
        return self.disorder == "quenched" and self.aging.active and self.aging.rule == "langevin"

    def births(self, velocity: float, mean_stretch: float | None = None) -> ThresholdLaw:
        """Law of thresholds at birth: newborn ones, final ones if they age at once, or those of star1 for annealed
        contacts with `mean_stretch` = C (length). Raises InputError."""
        law, aging = self.thresholds, self.aging
        if not aging.active or not isinstance(law, Gamma):
            return law
        if aging.rate == math.inf:
            return Pooled(law, aging.x_star_final, math.inf)
        if self.disorder == "quenched":
            return law
        if mean_stretch is None:
            raise ValueError("annealed contacts that age need their mean stretch at breaking")
        return Pooled(law, aging.x_star_final, aging.alpha(law.x_star, velocity) * mean_stretch / law.x_star)

    @property
    def b(self) -> float:
        """k x_*^2 / (2 kT) (nt08a); x_* is the scale of the threshold law. Infinite at kT = 0."""
        energy = 0.5 * self.stiffness * self.thresholds.scale * self.thresholds.scale
        return energy / self.thermal.kT if self.thermal.kT > energy * 1e-300 else math.inf

    def heated(self, velocity: float) -> bool:
        """Whether heat breaks contacts, to 1e-10 of any average. Raises InputError for annealed contacts if it does and
        b is beyond 1e15."""
        thermal, b = self.thermal, self.b
        if thermal.attempt_frequency == 0 or math.isinf(b):
            return False
        if self.disorder == "quenched":
            return b < _FLAT_OUT[thermal.barrier]
        if b <= _LARGEST_POOLED_B:
            return True
        attempts = thermal.attempt_frequency / velocity * self.thresholds.scale
        if attempts < 1e-11 * b:  # a life's hazard is below attempts/b
            return False
        raise InputError(f"k x_*^2/(2 kT) = {b:.3g}: must be <= {_LARGEST_POOLED_B:g} for annealed contacts")

    def drag(self, velocity: float) -> float:
        """eta v/(k x_*), force of a detached contact. Raises InputError if it is beyond 1e100."""
        drag = self.eta / self.stiffness * velocity / self.thresholds.scale
        require_number("eta * velocity / (stiffness * threshold)", drag, **NOT_NEGATIVE)
        return drag

    @property
    def crossover_velocity(self) -> float:
        """v_* of the annealed ensemble, where Delta U(inf) = 1: nt12 (S_0 = 1) for n = 1, soft, uniform; the same
        definition for every other law (derived), of newborn thresholds. 0 at kT = 0."""
        thermal = self.thermal
        if math.isinf(self.b) or thermal.attempt_frequency == 0:
            return 0.0
        pool = pooled_hazard_of(self.thresholds, self.stiffness_law, thermal.barrier, self.b)
        total = pool.G[-1] if pool.G.size else 0.0  # no attempt succeeds at very low temperature
        return float(thermal.attempt_frequency * self.thresholds.scale * total)


@dataclass(frozen=True)
class Drive:
    """Rigid slider at constant `velocity` over `distance` (default: 200 mean newborn thresholds).

    `start` "fresh": all contacts pinned and unstretched at X = 0; "stationary": the steady state. Raises InputError.
    """

    velocity: float
    distance: float | None = None
    start: Start = "fresh"

    def __post_init__(self) -> None:
        require_number("velocity", self.velocity, **POSITIVE)
        if self.distance is not None:
            require_number("distance", self.distance, **POSITIVE)
        require_choice("start", self.start, ("fresh", "stationary"))

    def over(self, ensemble: Ensemble) -> float:
        """The distance, with its default filled in."""
        return 200.0 * ensemble.thresholds.mean if self.distance is None else self.distance


def check_output(points: int, seed: int, replicas: int) -> None:
    """Raise InputError unless the size and seed of a recording can be used."""
    require_integer("points", points, 2, 2 * 10**7)
    require_integer("seed", seed, 0, 2**63 - 1)
    require_integer("replicas", replicas, 1, 10**9)


class Group(NamedTuple):
    """A dimensionless group, or a scale, of a run: its usual name, value and meaning."""

    name: str
    value: float | str
    meaning: str


def groups(ensemble: Ensemble, drive: Drive) -> list[Group]:
    """What decides the regime of a run."""
    law, thermal = ensemble.thresholds, ensemble.thermal
    unit, b, v = law.scale, ensemble.b, drive.velocity
    found = [
        Group("disorder", ensemble.disorder, "quenched: literal contacts; annealed: the published master equation"),
        Group("x_star", unit, "unit of length: x_* of the threshold law, or its mean"),
        Group("b", b, "k x_*^2 / (2 kT), barrier over temperature (nt08a)"),
        Group("T/T_*", 0.0 if math.isinf(b) else 1.0 / b, "temperature over its crossover (nt09a)"),
    ]
    if thermal.attempt_frequency > 0:
        reduced = v / (thermal.attempt_frequency * unit)
        found.append(Group("v/(omega x_*)", reduced, "velocity in x_* per attempt"))
    star = ensemble.crossover_velocity if law.steps.size <= MOST_POOLED_STEPS else 0.0
    if star > 0:
        not_here = "" if ensemble.disorder == "annealed" else ", not of these quenched contacts"
        found += [
            Group(
                "v_*", star, f"crossover velocity of the annealed ensemble{not_here}, Delta U(inf) = 1 (nt12, derived)"
            ),
            Group("v/v_*", v / star, "below 1, thermal breaking decides (annealed ensemble only)"),
        ]
    aging = ensemble.aging
    if aging.active:
        found.append(Group("x_*f/x_*i", aging.x_star_final / unit, "final over newborn threshold scale"))
        found.append(Group("D/(v x_*f)", aging.rate / (v * aging.x_star_final), "D_v, aging over sliding"))
    if ensemble.delay.time > 0:
        found.append(Group("v tau/x_*", v * ensemble.delay.time / unit, "distance slid while detached"))
    if ensemble.eta > 0:
        found.append(Group("eta v/(k x_*)", ensemble.drag(v), "viscous force, detached"))
    found.append(Group("distance/x_*", drive.over(ensemble) / unit, "how far the run slides"))
    if thermal.kT > 0 and ensemble.disorder == "quenched" and not law.steps.size:
        if ensemble.stiffness_law == "sqrt":
            text = "at every kT: k_i grows with the threshold, so barriers outgrow their rarity"
        else:
            text = "b >= 1/2: rare strong contacts dominate time" if b >= 0.5 else "no: b < 1/2, linear creep at low v"
        found.append(Group("heavy tails", "yes" if b >= 0.5 or ensemble.stiffness_law == "sqrt" else "no", text))
    return found


class Contacts(NamedTuple):
    """The plain numbers a kernel needs, lengths in units of the threshold law's scale, time as displacement.

    Thresholds come from a table, from equally likely `steps`, or, where `exponentials` is not 0, from so many uniforms.
    `breaking` says how a life ends: MECHANICAL (at its threshold), SOFT, STIFF (quenched), POOLED (annealed); `aging`
    how thresholds move: UNAGED, FLOW, LANGEVIN, with `final2` = (x_*f/x_*i)^2 and `alpha` of `laws.aging`, `shape` n,
    and `spring_work` the table of `flow_work_table`.
    """

    threshold_table: Array
    steps: Array
    exponentials: int
    kappa_slope: float
    kappa_constant: float
    breaking: int
    b: float
    log_w: float
    erfi_inverse: Array
    pool_x: Array
    pool_G: Array
    pool_slopes: Array
    delay: float
    exponential: bool
    aging: int
    final2: float
    alpha: float
    shape: float
    spring_work: Array


def lower(ensemble: Ensemble, velocity: float, mean_stretch: float | None = None) -> Contacts:
    """Ensemble and velocity as plain numbers; the only place where objects become kernel arguments. Annealed contacts
    that age need their `mean_stretch` C (length).

    Raises InputError if a dimensionless group is beyond 1e+-100.
    """
    law, thermal = ensemble.births(velocity, mean_stretch), ensemble.thermal
    unit, b = law.scale, ensemble.b
    breaking, pool = MECHANICAL, NO_POOL
    heated = ensemble.heated(velocity)
    if heated:
        # identical contacts cannot tell a fresh threshold from their own
        if ensemble.disorder == "annealed" and law.steps.size != 1:
            breaking, pool = POOLED, pooled_hazard_of(law, ensemble.stiffness_law, thermal.barrier, b)
        else:
            breaking = SOFT if thermal.barrier == "soft" else STIFF
    delay = velocity * ensemble.delay.time / unit
    require_number("velocity * delay / threshold", delay, least=0, most=1e100)
    log_w = -math.inf
    if heated:
        log_w = math.log(thermal.attempt_frequency) + math.log(unit) - math.log(velocity)
        require_number("ln(attempt_frequency * threshold / velocity)", log_w, least=-230, most=230)
    sqrt = ensemble.stiffness_law == "sqrt"
    rule, final2, alpha = UNAGED, 1.0, 0.0
    if ensemble.aging.active and law is ensemble.thresholds:
        rule = FLOW if ensemble.aging.rule == "flow" else LANGEVIN
        final2, alpha = (ensemble.aging.x_star_final / unit) ** 2, ensemble.aging.alpha(unit, velocity)
        if rule == LANGEVIN:
            require_number("4 rate x_star / (velocity x_star_final^2)", alpha, least=0, most=_MOST_ALPHA)
    return Contacts(
        threshold_table=threshold_table_of(law),
        steps=law.steps / unit,
        exponentials=exponentials_of(law),
        kappa_slope=unit / law.rms if sqrt else 0.0,
        kappa_constant=0.0 if sqrt else 1.0,
        breaking=breaking,
        b=max(b, _LEAST_B),
        log_w=log_w,
        erfi_inverse=erfi_inverse_table() if breaking == SOFT else NO_TABLE,
        pool_x=pool.x,
        pool_G=pool.G,
        pool_slopes=pool.slopes,
        delay=delay,
        exponential=ensemble.delay.law == "exponential",
        aging=rule,
        final2=final2,
        alpha=alpha,
        shape=getattr(law, "n", 0.0),
        spring_work=flow_work_table(final2) if rule == FLOW and sqrt else NO_TABLE,
    )


@functools.lru_cache(maxsize=32)
def threshold_table_of(law: ThresholdLaw) -> Array:
    """The law's table, remembered: sweeps over velocity and temperature share it."""
    return law.table()


@functools.lru_cache(maxsize=32)
def pooled_hazard_of(law: ThresholdLaw, stiffness: Any, barrier: Any, b: float) -> PooledHazard:
    """The pooled hazard, remembered: it does not depend on velocity."""
    return pooled_hazard(law, stiffness, barrier, b)
