"""Where ensemble and drive become dimensionless numbers: the only place, for the engine
and the reference alike. The formulas of b, v tau and alpha are those of `Ensemble.b`,
`Delay.reduced` and `Aging.alpha`.

Lengths are in units of the threshold law's scale (x_* of a gamma law, else the mean
threshold), time is displacement, stiffness is in units of k and energy in units of kT.
"""

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from eqsim.errors import NOT_NEGATIVE, POSITIVE, InputError, require_number, under
from eqsim.laws.aging import AgingLaw, PooledThresholds, Unaged
from eqsim.laws.barrier import BARRIERS, Barrier, Mechanical
from eqsim.laws.barrier.base import require_whole
from eqsim.laws.barrier.pooled import MOST_POOLED_STEPS
from eqsim.laws.delay import Delay, Exponential, Fixed
from eqsim.laws.newborn import Newborn
from eqsim.laws.stiffness import Springs, StiffnessLaw
from eqsim.laws.threshold import Gamma, ThresholdLaw
from eqsim.model.drive import Drive, Programme
from eqsim.model.elastic import Elastic
from eqsim.model.ensemble import Ensemble
from eqsim.paper import equation

# b below which the barrier is 0.
_LEAST_B = 1e-100
# b, or 1/b, beyond which units were probably mixed.
_DOUBTFUL_B = 1e15
# Distance over threshold below which they probably were.
_DOUBTFUL_DISTANCE = 1e-4
# b above which a pooled hazard would be made of differences between neighbouring
# numbers.
_LARGEST_POOLED_B = 1e15


class Reduced(NamedTuple):
    """An ensemble at constant velocity in dimensionless numbers.

    Attributes
    ----------
    law : ThresholdLaw
        Thresholds at birth, in the user's unit; lengths elsewhere are in units of
        `law.scale`.
    stiffness : str
        "sqrt" or "uniform".
    annealed : bool
        Whether attempts draw fresh thresholds, and it makes a difference.
    barrier : Barrier
        With b = k x_*^2/(2 kT) (nt08a) and log_w = ln(omega x_*/v); `Mechanical` where
        heat breaks no contact.
    aging : AgingLaw
        Of quenched contacts, with the numbers of its rule (`laws.aging.base`,
        `laws.aging.logarithmic`).
    delay : Fixed | Exponential
        With mean v<tau>/x_*.
    drag : float
        eta v/(k x_*), force of a detached contact.
    newborn : Newborn
        Stretches at birth, in the user's unit.
    one_sided : bool
        Whether the threshold of a newborn contact has to be above y, not |y|: the
        published master equation.
    """

    law: ThresholdLaw
    stiffness: StiffnessLaw
    annealed: bool
    barrier: Barrier
    aging: AgingLaw
    delay: Fixed | Exponential
    drag: float
    newborn: Newborn = Newborn()
    one_sided: bool = False

    @property
    def rms(self) -> float:
        """sqrt(<xi^2>), where k_i = k under the sqrt law."""
        return self.law.rms / self.law.scale

    @property
    def springs(self) -> Springs:
        """k_i/k for kernels."""
        return (
            Springs(0.0, self.law.scale / self.law.rms)
            if self.stiffness == "sqrt"
            else Springs(1.0, 0.0)
        )


def bare(ensemble: Ensemble) -> Ensemble:
    """Without what plays no part in lives: the delay, drag and count."""
    return replace(ensemble, delay=Delay(), eta=0.0, count=1)


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
        If a dimensionless number is out of range: the one set of limits.
    """
    require_number("velocity", velocity, **POSITIVE)
    law, aging = births(ensemble, velocity, mean_stretch), ensemble.aging
    unit, newborn = law.scale, law is ensemble.thresholds
    delay = ensemble.delay.reduced(velocity, unit)
    require_number("velocity * delay / threshold", delay.mean, least=0, most=1e100)
    barrier = _barrier(ensemble, velocity, unit)
    return Reduced(
        law=law,
        stiffness=ensemble.stiffness_law,
        # identical contacts cannot tell a fresh threshold from their own
        annealed=ensemble.disorder == "annealed"
        and law.steps.size != 1
        and barrier.thermal,
        barrier=barrier,
        aging=aging.law(law, velocity)
        if newborn
        else Unaged(),  # births that have aged age no more
        delay=delay,
        drag=drag_of(ensemble, velocity),
        newborn=ensemble.newborn,
        one_sided=ensemble.disorder == "annealed" and ensemble.newborn.of == "length",
    )


class Leg(NamedTuple):
    """A segment of a programme in dimensionless numbers.

    Attributes
    ----------
    sign : int
        Of the velocity; 0 in a hold.
    pace : float
        The velocity at which its time counts as displacement: |v|, in a hold that of a
        segment that moves.
    length : float
        Its time at that pace, in units of the threshold law's scale: how far the slider
        moves unless it is a hold.
    """

    sign: int
    pace: float
    length: float


def legs(ensemble: Ensemble, programme: Programme) -> list[Leg]:
    """The segments of a programme. Raises InputError if one is out of range."""
    unit, segments = ensemble.thresholds.scale, programme.segments
    moving = [abs(segment.velocity) for segment in segments if segment.velocity]
    idle = programme.velocity or next(iter(moving), unit / segments[0].duration)
    found = []
    for index, segment in enumerate(segments):
        pace = abs(segment.velocity) or idle
        length = (segment.path or pace * segment.duration) / unit
        with under(f"programme.{index}"):
            require_number("distance / threshold", length, least=1e-100, most=1e100)
        found.append(
            Leg(int(segment.velocity > 0) - int(segment.velocity < 0), pace, length)
        )
    return found


class Pull(NamedTuple):
    """A stage, its spring and the slider in dimensionless numbers: time is displacement
    at `pace` (length/time).

    Attributes
    ----------
    pace : float
        That of the fastest segment.
    stiffness, damping, mass : float
        kappa_s, eta_s v/x_* and m v^2/x_*^2 at that pace.
    ends : sequence of float
        When segments end.
    speeds : sequence of float
        Of the stage in each, in units of the pace.
    """

    pace: float
    stiffness: float
    damping: float
    mass: float
    ends: Sequence[float]
    speeds: Sequence[float]


def pull_of(ensemble: Ensemble, programme: Programme) -> Pull:
    """The stage of a programme. Raises InputError if it has none, or a number is out of
    range."""
    stage, unit = programme.stage, ensemble.thresholds.scale
    if stage is None:
        raise InputError("drive.stage: is required")
    pace = max(leg.pace for leg in legs(ensemble, programme))
    damping, mass = stage.damping * pace / unit, stage.mass * (pace / unit) ** 2
    with under("stage"):
        require_number("damping * velocity / threshold", damping, least=0, most=1e100)
        require_number("mass * velocity^2 / threshold^2", mass, least=0, most=1e100)
    ends, elapsed = [], 0.0
    for segment in programme.segments:
        elapsed += segment.duration * pace / unit
        ends.append(elapsed)
    speeds = tuple(segment.velocity / pace for segment in programme.segments)
    return Pull(pace, stage.stiffness, damping, mass, tuple(ends), speeds)


def births(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None = None
) -> ThresholdLaw:
    """Law of thresholds at birth: newborn ones, final ones if they age at once, or
    those of star1 for annealed contacts of mean stretch C at breaking (length). Raises
    InputError."""
    law, aging = ensemble.thresholds, ensemble.aging
    if not aging.active or not isinstance(law, Gamma):
        return law
    if aging.rate == math.inf:
        return PooledThresholds(law, aging.x_star_final, math.inf)
    if ensemble.disorder == "quenched":
        return law
    if mean_stretch is None:
        raise ValueError(
            "annealed contacts that age need their mean stretch at breaking"
        )
    decay = aging.alpha(law.x_star, velocity) * mean_stretch / law.x_star
    return PooledThresholds(law, aging.x_star_final, decay)


def drag_of(ensemble: Ensemble, velocity: float) -> float:
    """eta v/(k x_*), force of a detached contact. Raises InputError if it is beyond
    1e100."""
    drag = ensemble.eta / ensemble.stiffness * velocity / ensemble.thresholds.scale
    require_number("eta * velocity / (stiffness * threshold)", drag, **NOT_NEGATIVE)
    return drag


def _barrier(ensemble: Ensemble, velocity: float, unit: float) -> Barrier:
    """The barrier, or none where heat breaks contacts too rarely to change any average
    by 1e-10. Raises InputError for annealed contacts if it does and b is beyond 1e15.
    """
    thermal, b = ensemble.thermal, ensemble.b
    law = BARRIERS[thermal.barrier]
    if thermal.attempt_frequency == 0 or math.isinf(b):
        return Mechanical()
    if ensemble.disorder == "quenched":
        if b >= law.flat_out:
            return Mechanical()
    elif b > _LARGEST_POOLED_B:
        if (
            thermal.attempt_frequency / velocity * unit < 1e-11 * b
        ):  # a life's hazard is below attempts/b
            return Mechanical()
        raise InputError(
            f"k x_*^2/(2 kT) = {b:.3g}: must be <= {_LARGEST_POOLED_B:g} for annealed contacts"
        )
    log_w = math.log(thermal.attempt_frequency) + math.log(unit) - math.log(velocity)
    require_number(
        "ln(attempt_frequency * threshold / velocity)", log_w, least=-230, most=230
    )
    barrier: Barrier = law(max(b, _LEAST_B), log_w)  # type: ignore[call-arg]  # the NamedTuple that every law is
    require_whole(thermal.barrier, barrier)
    return barrier


class Group(NamedTuple):
    """A dimensionless group, or a scale, of a run: its usual name, value and meaning."""

    name: str
    value: float | str
    meaning: str


def groups(ensemble: Ensemble, drive: Drive | Programme) -> list[Group]:
    """List what decides the regime of a run; along a programme velocity is that of its
    fastest segment."""
    law, thermal = ensemble.thresholds, ensemble.thermal
    unit, b = law.scale, ensemble.b
    v = (
        drive.velocity
        if isinstance(drive, Drive)
        else max(leg.pace for leg in legs(ensemble, drive))
    )
    found = [
        Group(
            "disorder",
            ensemble.disorder,
            "quenched: literal contacts; annealed: the published master equation",
        ),
        Group("x_star", unit, "unit of length: x_* of the threshold law, or its mean"),
        Group(
            "b", b, f"k x_*^2 / (2 kT), barrier over temperature ({equation('nt08a')})"
        ),
        Group(
            "T/T_*",
            0.0 if math.isinf(b) else 1.0 / b,
            f"temperature over its crossover ({equation('nt09a')})",
        ),
    ]
    if thermal.attempt_frequency > 0:
        reduced = v / (thermal.attempt_frequency * unit)
        found.append(Group("v/(omega x_*)", reduced, "velocity in x_* per attempt"))
    star = ensemble.crossover_velocity if law.steps.size <= MOST_POOLED_STEPS else 0.0
    if star > 0:
        not_here = (
            ""
            if ensemble.disorder == "annealed"
            else ", not of these quenched contacts"
        )
        solved = f"Delta U(inf) = 1 ({equation('nt12')}; derived)"
        found += [
            Group(
                "v_*",
                star,
                f"crossover velocity of the annealed ensemble{not_here}, {solved}",
            ),
            Group(
                "v/v_*",
                v / star,
                "below 1, thermal breaking decides (annealed ensemble only)",
            ),
        ]
    aging = ensemble.aging
    if aging.active and aging.cutoff_time is not None:
        found.append(
            Group(
                "beta",
                aging.beta or 0.0,
                "growth of thresholds per e-fold of their age",
            )
        )
        found.append(
            Group(
                "v t_c/x_*",
                v / unit * aging.cutoff_time,
                "distance slid before thresholds grow",
            )
        )
    elif aging.active:
        found.append(
            Group(
                "x_*f/x_*i",
                aging.x_star_final / unit,
                "final over newborn threshold scale",
            )
        )
        found.append(
            Group(
                "D/(v x_*f)",
                aging.rate / (v * aging.x_star_final),
                "aging over sliding",
            )
        )
    if ensemble.newborn.active:
        births = ensemble.newborn.reduced(unit)
        low, high = births.range
        per = "xi" if ensemble.newborn.of == "threshold" else "x_*"
        found.append(
            Group(f"<y>/{per}", births.mean, "mean stretch of newborn contacts")
        )
        found.append(
            Group(
                f"least y/{per}",
                low,
                "of newborn contacts (1e-16 of a normal law is below)",
            )
        )
        found.append(
            Group(
                f"greatest y/{per}",
                high,
                "of newborn contacts (1e-16 of an unbounded law is above)",
            )
        )
    if ensemble.delay.time > 0:
        found.append(
            Group(
                "v tau/x_*",
                v * ensemble.delay.time / unit,
                "distance slid while detached",
            )
        )
    if ensemble.eta > 0:
        found.append(
            Group("eta v/(k x_*)", drag_of(ensemble, v), "viscous force, detached")
        )
    if isinstance(drive, Drive):
        found.append(
            Group("distance/x_*", drive.over(ensemble) / unit, "how far the run slides")
        )
        found += _of_blocks(ensemble.count, drive.elastic) if drive.elastic else []
    else:
        segments, path = drive.segments, sum(segment.path for segment in drive.segments)
        found.append(Group("segments", len(segments), "of the programme"))
        found.append(
            Group("path/x_*", path / unit, "how far the run slides, there and back")
        )
        slowest = min(
            (leg.pace for leg in legs(ensemble, drive) if leg.sign), default=v
        )
        found.append(
            Group(
                "slowest/fastest", slowest / v, "velocities of the segments that move"
            )
        )
        if drive.stage:
            pull = pull_of(ensemble, drive)
            found.append(
                Group(
                    "kappa_s",
                    pull.stiffness,
                    "spring of the stage over that of all contacts, K/(N k)",
                )
            )
            found.append(
                Group(
                    "eta_s v/x_*",
                    pull.damping,
                    "damping of the slider at that velocity",
                )
            )
            found.append(
                Group(
                    "m v^2/x_*^2", pull.mass, "inertia of the slider at that velocity"
                )
            )
    if (
        thermal.kT > 0
        and ensemble.disorder == "quenched"
        and law.support[1] < math.inf
        and not law.steps.size
    ):
        found.append(
            Group("heavy tails", "no", f"no threshold exceeds {law.support[1]:g}")
        )
    elif thermal.kT > 0 and ensemble.disorder == "quenched" and not law.steps.size:
        heavy = True
        if aging.active and aging.cutoff_time is not None:
            text = "at every kT: thresholds that grow as ln t outlive all attempts"
        elif ensemble.stiffness_law == "sqrt":
            text = "at every kT: k_i grows with the threshold, so barriers outgrow their rarity"
        else:
            heavy = b >= 0.5
            text = (
                "b >= 1/2: rare strong contacts dominate time"
                if heavy
                else "no: b < 1/2, linear creep at low v"
            )
        found.append(Group("heavy tails", "yes" if heavy else "no", text))
    return found


def doubts(ensemble: Ensemble, drive: Drive | Programme | None) -> Iterator[str]:
    """Warn about dimensionless groups so extreme that units were probably mixed, a line
    for each. Without a drive the distance does not count."""
    b, unit = ensemble.b, ensemble.thresholds.scale
    scale = (
        "; thresholds.scale = 1e-9 turns those of a table from nm into m"
        if ensemble.thresholds.steps.size
        else ""
    )
    are = f"are all numbers in the same units? Thresholds are about {unit:.3g}{scale}"
    if ensemble.thermal.kT > 0 and not 1.0 / _DOUBTFUL_B <= b <= _DOUBTFUL_B:
        yield f"b = k x_*^2/(2 kT) = {b:.3g}, energy of a contact over heat: {are}"
    if isinstance(drive, Drive):
        distance = drive.over(ensemble) / unit
        if distance < _DOUBTFUL_DISTANCE:
            yield f"drive.distance is {distance:.3g} of a threshold, so that hardly any contact breaks: {are}"


def _of_blocks(contacts: int, elastic: Elastic) -> list[Group]:
    """Groups of coupled blocks. Raises InputError unless the contacts can be divided
    among them."""
    nx, ny = elastic.shape
    shape = f"{nx}" if ny == 1 else f"{nx} x {ny}"
    return [
        Group(
            "blocks",
            shape,
            f"{'chain' if ny == 1 else 'sheet'} with {elastic.edges} edges",
        ),
        Group(
            "n",
            elastic.contacts_per_block(contacts),
            "contacts of a block, N over blocks",
        ),
        Group(
            "kappa_b/(n k)",
            elastic.coupling,
            "spring between neighbours over the contacts of a block",
        ),
        Group(
            "K_d/(n k)",
            elastic.drive_stiffness,
            "spring of a block to the plate, over the same",
        ),
        Group(
            "lambda",
            elastic.length,
            "blocks over which the displacement by a break decays",
        ),
        Group(
            "rho", elastic.load, "n k/(n k + K_d), breaks that follow from one directly"
        ),
        Group("mean size", elastic.mean_size, "1 + n k/K_d, breaks of an avalanche"),
        Group(
            "cutoff size",
            1.0 / (1.0 - elastic.load) ** 2,
            "up to which P(s) ~ s^(-3/2)",
        ),
    ]
