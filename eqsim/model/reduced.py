"""Reduction of ensemble and drive to dimensionless numbers: the only place, for the
engine and the reference alike.

Lengths are in units of the threshold law's scale x_* (of a named law its x_* or unit,
else the mean threshold), time is displacement at the velocity v, stiffness is in units
of k and energy in units of kT. What a key of a run file is called afterwards, and where:

    thermal.kT                 b         k x_*^2/(2 kT)         barrier, `Ensemble.b`
    thermal.attempt_frequency  log_w     ln(omega x_*/v)        barrier
    thermal.force_scale        b         k x_*/f_b              barrier
    thermal.off_rate           log_w     ln(k_0 x_*/v)          barrier
    thermal.catch, .slip       the same, and ratios             `CatchSlip`
    aging.rate                 alpha     4 D x_*/(v x_*f^2)     aging, `Aging.alpha`
    aging.x_star_final         final2    (x_*f/x_*)^2           aging
    aging.cutoff_time          per_time  x_*/(v t_c)            aging
    delay.time                 mean      v tau/x_*, `Delay.at`  delay
    viscosity.*                drag      eta v/(k x_*)          `drag_of`
    newborn.*                  the same  y/x_*, or y/xi         `Newborn.reduced`
    drive.stage.damping        damping   eta_s v/x_*            `Pull`
    drive.stage.mass           mass      m v^2/x_*^2            `Pull`
    drive.velocity             pace      of a segment           `Leg`
    drive.force                forces    f/x_*                  `Pull`
    drive.force_rate           rates     f'/v                   `Pull`
    drive.stall_force          stall     s/x_*                  `Pull`
    output.seed                key       words of a stream      `numerics.streams.key`

At constant velocity v is a part of log_w, alpha, per_time, mean and drag only. Other
keys keep their names: n, beta, the stage's stiffness, counts and choices.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_number, under
from eqsim.laws.aging import AgingLaw, Unaged
from eqsim.laws.barrier import BARRIERS, Barrier, Mechanical
from eqsim.laws.barrier.base import require_whole
from eqsim.laws.delay import Delay, DelayLaw
from eqsim.laws.newborn import Newborn
from eqsim.laws.no_thresholds import BEYOND, NoThresholds
from eqsim.laws.stiffness import Springs, StiffnessLaw
from eqsim.laws.threshold import Gamma, ThresholdLaw
from eqsim.laws.viscosity import Viscosity
from eqsim.model.drive import QUASISTATIC, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# Hazard that no contact outlives.
_SPENT = 100.0
# b below which the barrier is 0.
_LEAST_B = 1e-100
# Relative difference of times that are the same but for rounding.
_SAME_TIME = 1e-12
# b up to which rates that rise to exp(`laws.barrier.bell.MOST`) break all bonds.
_MOST_OVER_FORCE = 1e80
# b above which a pooled hazard would be made of differences between neighbouring
# numbers.
_LARGEST_POOLED_B = 1e15


class Reduced(NamedTuple):
    """An ensemble at constant velocity in dimensionless numbers; lengths are in units
    of `law.scale`, but for those of the laws of thresholds and births, the user's.

    The barrier has b = k x_*^2/(2 kT) (nt08a) and log_w = ln(omega x_*/v), and is
    `Mechanical` where heat breaks no contact. If `one_sided`, the threshold of a
    newborn contact has to be above y, not |y|: the published master equation.
    """

    law: ThresholdLaw  # at birth
    stiffness: StiffnessLaw
    annealed: bool  # attempts draw fresh thresholds, and it makes a difference
    barrier: Barrier
    aging: AgingLaw  # of quenched contacts
    delay: DelayLaw  # with mean v<tau>/x_*
    drag: float  # force of a detached contact over k x_*, such as eta v/(k x_*)
    newborn: Newborn = Newborn()
    one_sided: bool = False

    @property
    def rms(self) -> float:
        """sqrt(<xi^2>), where k_i = k under the sqrt law."""
        return self.law.rms / self.law.scale

    @property
    def springs(self) -> Springs:
        """k_i/k for kernels."""
        if self.stiffness == "uniform":
            return Springs(1.0, 0.0)
        return Springs(0.0, self.law.scale / self.law.rms)


def bare(ensemble: Ensemble) -> Ensemble:
    """Without what plays no part in lives: the delay, drag and count."""
    return replace(ensemble, delay=Delay(), eta=0.0, viscosity=Viscosity(), count=1)


# The law of annealed contacts that age takes 50 ms, and engine and reference ask for it
# several times.
@functools.lru_cache(maxsize=64)
def reduced(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None = None
) -> Reduced:
    """The dimensionless numbers of an ensemble at `velocity`; births of annealed
    contacts that age at a finite rate need their `mean_stretch` C at breaking (length).

    Raises
    ------
    InputError
        If a dimensionless number is out of range: the one set of limits; and for
        contacts of several kinds, which have numbers of their own each.
    """
    require_number("velocity", velocity, **POSITIVE)
    if ensemble.populations:
        raise InputError("population: this needs contacts of one kind")
    law, aging = births(ensemble, velocity, mean_stretch), ensemble.aging
    unit, newborn = law.scale, law is ensemble.thresholds
    barrier = _barrier(ensemble, velocity, unit)
    if isinstance(law, NoThresholds):
        _check_unlimited(law, barrier)
    annealed = ensemble.disorder == "annealed"
    return Reduced(
        law=law,
        stiffness=ensemble.stiffness_law,
        # identical contacts cannot tell a fresh threshold from their own
        annealed=annealed and law.steps.size != 1 and barrier.thermal,
        barrier=barrier,
        # births that have aged age no more
        aging=aging.law(law, velocity) if newborn else Unaged(),
        delay=delay_of(ensemble, velocity),
        drag=drag_of(ensemble, velocity),
        newborn=ensemble.newborn,
        one_sided=annealed and ensemble.newborn.of == "length",
    )


class Leg(NamedTuple):
    """A segment of a programme in dimensionless numbers. Its time counts as
    displacement at the `pace` |v|, in a hold that of a segment that moves."""

    sign: int  # of the velocity; 0 in a hold
    pace: float  # (length/time)
    length: float  # its time at that pace, in units of the threshold law's scale


def legs(ensemble: Ensemble, programme: Programme) -> list[Leg]:
    """The segments of a programme. Raises InputError if one is out of range, and for
    the steady state of contacts that never form again, and delays that depend on the
    velocity unless there is but one speed, and a stage with such a drag."""
    speeds = {abs(segment.velocity) for segment in programme.segments}
    if programme.start == "stationary":
        speeds.add(programme.velocity or 0.0)
    several = len(speeds) > 1 or 0.0 in speeds
    if ensemble.delay.velocity_exponent and (several or programme.pulled):
        raise InputError(
            f"delay.velocity_exponent = {ensemble.delay.velocity_exponent:g}: must be 0 "
            "with a stage, a hold, and segments of several velocities"
        )
    if programme.start == "stationary":
        ensemble.require_steady_state(programme.velocity or 0.0)
    drag = ensemble.viscosity
    bent = ensemble.eta * (drag.exponent - 1.0)
    for name, wrong, allowed in (("force", drag.force, 0), ("exponent", bent, 1)):
        if wrong and programme.pulled:
            raise InputError(
                f"viscosity.{name} = {getattr(drag, name):g}: must be {allowed} with "
                "drive.stage, whose slider has a drag in proportion to its velocity"
            )
    unit, segments = ensemble.thresholds.scale, programme.segments
    moving = [abs(segment.velocity) for segment in segments if segment.velocity]
    idle = programme.velocity or next(iter(moving), unit / segments[0].duration)
    found = []
    for index, segment in enumerate(segments):
        pace = abs(segment.velocity) or idle
        length = (segment.path or pace * segment.duration) / unit
        with under(f"programme.{index}"):
            require_number("distance / threshold", length, least=1e-100, most=1e100)
        sign = int(segment.velocity > 0) - int(segment.velocity < 0)
        found.append(Leg(sign, pace, length))
    return found


class Pull(NamedTuple):
    """Pull on a slider, in dimensionless numbers: time is displacement at `pace`
    (length/time). It obeys

        m X'' + c X' = kappa (Y - X) + f(t) - F

    with the end of the spring at Y. Without a spring, kappa = 0.
    """

    pace: float  # that of the fastest segment
    stiffness: float  # kappa_s
    damping: float  # eta_s v/x_* at that pace
    mass: float  # m v^2/x_*^2 at that pace
    ends: Sequence[float]  # when segments end
    speeds: Sequence[float]  # of the stage or unloaded motor in each, over the pace
    forces: Sequence[float] = ()  # f at the beginning of each; 0 without a force
    force_rates: Sequence[float] = ()  # change of f per time in each
    stall: float = math.inf  # stall force s of a motor

    @property
    def motor(self) -> bool:
        """True if a motor with a finite stall force drives."""
        return self.stall < math.inf

    @property
    def forced(self) -> bool:
        """True if a force pulls the slider itself."""
        return self.stiffness == 0.0 and not self.motor

    def force_at(self, t: Array) -> Array:
        """f at times t (any shape); at the end of a segment that of this segment."""
        last = len(self.ends) - 1
        i = np.minimum(np.searchsorted(self.ends, t * (1.0 - _SAME_TIME)), last)
        since = t - np.append(0.0, self.ends)[i]
        return np.asarray(
            np.array(self.forces)[i] + np.array(self.force_rates)[i] * since
        )

    @property
    def knots(self) -> tuple[Array, Array]:
        """Times and forces at the ends of straight pieces of f(t), from 0 and 0 on."""
        begins = np.append(0.0, self.ends[:-1])
        t = np.stack((begins, self.ends), axis=1).ravel()
        f = np.stack((self.forces, self.force_at(np.array(self.ends))), axis=1).ravel()
        return np.append(0.0, t), np.append(0.0, f)

    @property
    def slow(self) -> bool:
        """True if the force never falls, and never jumps."""
        dt, df = map(np.diff, self.knots)
        return bool(np.all((df == 0.0) | ((df > 0.0) & (dt > 0.0))))


def pull_of(ensemble: Ensemble, programme: Programme) -> Pull:
    """Find the pull on the slider of a programme. Raises InputError if nothing does, or
    a number is out of range."""
    stage, unit = programme.stage, ensemble.thresholds.scale
    if programme.chain:
        said = "a chain of blocks is simulated by `trajectory` and `eqsim run` alone"
        raise InputError(f"drive.chain: {said}; this needs a rigid slider")
    if programme.elastic:
        raise InputError(f"drive.elastic: {QUASISTATIC}")
    if not programme.pulled:
        raise InputError("drive.stage: is required")
    pace = max(leg.pace for leg in legs(ensemble, programme))
    stiffness = damping = mass = 0.0
    if stage:
        stiffness, damping = stage.stiffness, stage.damping * pace / unit
        mass = stage.mass * (pace / unit) ** 2
    force, forces, rates = 0.0, [], []
    for segment in programme.segments:
        force = force if segment.force is None else segment.force
        forces.append(force / unit)
        rates.append((segment.force_rate or 0.0) / pace)
        force += (segment.force_rate or 0.0) * segment.duration
    for name, values in (
        ("force / threshold", forces),
        ("force_rate / velocity", rates),
    ):
        require_number(name, max(map(abs, values)), **NOT_NEGATIVE)
    stall = programme.stall_force / unit
    if stall != math.inf:
        require_number("stall_force / threshold", stall, least=1e-100, most=1e100)
    with under("stage"):
        require_number("damping * velocity / threshold", damping, **NOT_NEGATIVE)
        require_number("mass * velocity^2 / threshold^2", mass, **NOT_NEGATIVE)
    lasting = (segment.duration * pace / unit for segment in programme.segments)
    speeds = tuple(segment.velocity / pace for segment in programme.segments)
    spring = pace, stiffness, damping, mass
    course = tuple(accumulate(lasting)), speeds, tuple(forces), tuple(rates)
    return Pull(*spring, *course, stall)


def births(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None = None
) -> ThresholdLaw:
    """Law of thresholds at birth: newborn ones, final ones if they age at once, or
    those of star1 for annealed contacts of mean stretch C at breaking (length). Raises
    InputError where C is needed and not given."""
    law, aging = ensemble.thresholds, ensemble.aging
    if not aging.active or not isinstance(law, Gamma):
        return law
    if aging.rate == math.inf:
        return aging.pooled(law, math.inf)
    if ensemble.disorder == "quenched":
        return law
    if mean_stretch is None:
        raise InputError(
            "aging: that of annealed contacts is defined at constant velocity only"
        )
    decay = aging.alpha(law.x_star, velocity) * mean_stretch / law.x_star
    return aging.pooled(law, decay)


def delay_of(ensemble: Ensemble, velocity: float) -> DelayLaw:
    """The law of v tau/x_*. Raises InputError if its mean, if finite, is over 1e100."""
    delay = ensemble.delay.at(ensemble.thermal.kT, velocity)
    law = delay.reduced(velocity, ensemble.thresholds.scale)
    if law.mean != math.inf:
        require_number("velocity * delay / threshold", law.mean, least=0, most=1e100)
    return law


def drag_of(ensemble: Ensemble, velocity: float) -> float:
    """Force of a detached contact over k x_*, eta v/(k x_*) unless `Viscosity` has
    more. Raises InputError if it is beyond 1e100."""
    unit, law = ensemble.thresholds.scale, ensemble.viscosity
    drag = ensemble.eta / ensemble.mean_stiffness * velocity / unit
    if drag and law.exponent != 1.0:
        drag *= law.factor(velocity)
    drag += law.force / ensemble.mean_stiffness / unit
    require_number("eta * velocity / (stiffness * threshold)", drag, **NOT_NEGATIVE)
    return drag


def _check_unlimited(law: NoThresholds, barrier: Barrier) -> None:
    """Raise InputError unless contacts without thresholds break before `BEYOND`."""
    if not barrier.thermal:
        raise InputError(
            'thresholds.law = "none": needs a rate > 0 that breaks contacts'
        )
    if barrier.whole_hazard(np.array([BEYOND]), np.ones(1))[0] < _SPENT:
        said = f"contacts outlive {BEYOND:g} of it; give about velocity/rate"
        raise InputError(f"thresholds.x_star = {law.scale:g}: {said}")


def _barrier(ensemble: Ensemble, velocity: float, unit: float) -> Barrier:
    """The barrier, or none where heat breaks contacts too rarely to change any average
    by 1e-10. Raises InputError for annealed contacts if it does and b is beyond
    1e15."""
    thermal = ensemble.thermal
    law: Any = BARRIERS[thermal.barrier]
    b, rate, *others = law.numbers(thermal, ensemble.stiffness, unit)
    if rate == 0 or math.isinf(b):
        return Mechanical()
    if law.by_force:
        require_number(law.b_words, b, least=0.0, most=_MOST_OVER_FORCE)
    if ensemble.disorder == "quenched":
        if b >= law.flat_out:
            return Mechanical()
    elif b > _LARGEST_POOLED_B:
        # a life's hazard is below attempts/b
        if rate / velocity * unit < 1e-11 * b and not law.by_force:
            return Mechanical()
        said = f"must be <= {_LARGEST_POOLED_B:g} for annealed contacts"
        raise InputError(f"{law.b_words} = {b:.3g}: {said}")
    log_w = math.log(rate) + math.log(unit) - math.log(velocity)
    name = f"ln({law.keys[1]} * threshold / velocity)"
    require_number(name, log_w, least=-230, most=230)
    # every law is a NamedTuple that begins with these two
    barrier: Barrier = law(max(b, _LEAST_B), log_w, *others)
    require_whole(thermal.barrier, barrier)
    return barrier
