"""Steady averages of either ensemble from the master equation, as the engine reports them."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from eqsim.ensemble import Ensemble
from eqsim.errors import POSITIVE, require_number
from eqsim.estimate import Averages, Estimate
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.laws.thermal import Barrier
from eqsim.laws.threshold import ThresholdLaw
from eqsim.master import kinetic, published

PUBLISHED, KINETIC = "published master equation", "joint kinetic equation"


@dataclass(frozen=True)
class Reference(Averages):
    """Exact steady averages; `stderr` of each estimate is the error estimate of the solver (absolute).

    `f_k` is the elastic part of the friction per pinned contact; `method` names the solver.
    """

    f_k: Estimate
    method: str


class Setting(NamedTuple):
    """An ensemble at a velocity as the solvers see it: lengths in units of `law.scale`, barrier None at T = 0,
    `delay` v<tau>, `drag` eta v/k; `annealed` only where it makes a difference."""

    law: ThresholdLaw
    stiffness: StiffnessLaw
    barrier: Barrier | None
    b: float
    log_w: float
    delay: float
    exponential: bool
    drag: float
    annealed: bool


def setting(ensemble: Ensemble, velocity: float) -> Setting:
    """What the solvers need to know. Raises InputError if a dimensionless group is beyond 1e+-100."""
    require_number("velocity", velocity, **POSITIVE)
    law, thermal, unit = ensemble.thresholds, ensemble.thermal, ensemble.thresholds.scale
    cold = thermal.attempt_frequency == 0 or math.isinf(ensemble.b)
    log_w = 0.0 if cold else math.log(thermal.attempt_frequency) + math.log(unit) - math.log(velocity)
    require_number("ln(attempt_frequency * threshold / velocity)", log_w, least=-230, most=230)
    delay = velocity * ensemble.delay.time / unit
    require_number("velocity * delay / threshold", delay, least=0, most=1e100)
    return Setting(
        law=law,
        stiffness=ensemble.stiffness_law,
        barrier=None if cold else thermal.barrier,
        b=max(ensemble.b, 1e-100),
        log_w=log_w,
        delay=delay,
        exponential=ensemble.delay.law == "exponential",
        drag=ensemble.drag(velocity),
        annealed=ensemble.disorder == "annealed" and law.steps.size != 1 and not cold,
    )


def reference(ensemble: Ensemble, velocity: float) -> Reference:
    """The steady averages of an ensemble at constant velocity, by quadrature. Raises InputError."""
    s = setting(ensemble, velocity)
    if s.annealed and s.barrier is not None:
        method, moments = PUBLISHED, published.stationary(s.law, s.stiffness, s.barrier, s.b, s.log_w)
    else:
        method, moments = KINETIC, kinetic.stationary(s.law, s.stiffness, s.barrier, s.b, s.log_w)
    unit, delay, drag = s.law.scale, s.delay, s.drag
    stretch, work = moments.stretch, moments.work
    relative = moments.stretch_error / stretch + moments.work_error / work
    pinned = stretch / (stretch + delay)
    pinned_error = pinned * (1.0 - pinned) * moments.stretch_error / stretch
    elastic = work / (stretch + delay)
    friction, error = elastic + drag * (1.0 - pinned), elastic * relative + drag * pinned_error
    return Reference(
        friction=Estimate(friction * unit, error * unit, 0),
        pinned=Estimate(pinned, pinned_error, 0),
        break_stretch=Estimate(stretch * unit, moments.stretch_error * unit, 0),
        f_k=Estimate(work / stretch * unit, work / stretch * relative * unit, 0),
        method=method,
    )
