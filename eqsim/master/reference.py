"""Steady averages of either ensemble from the master equation, as the engine reports them."""

import math
from dataclasses import dataclass

from eqsim.ensemble import Ensemble
from eqsim.errors import require_number
from eqsim.estimate import Averages, Estimate
from eqsim.master import kinetic, published


@dataclass(frozen=True)
class Reference(Averages):
    """Exact steady averages; `stderr` of each estimate is the error estimate of the solver (absolute).

    `f_k` is the elastic part of the friction per pinned contact; `method` names the solver.
    """

    f_k: Estimate
    method: str


def reference(ensemble: Ensemble, velocity: float) -> Reference:
    """The steady averages of an ensemble at constant velocity, by quadrature. Raises InputError."""
    require_number("velocity", velocity, above=0)
    law, thermal, unit = ensemble.thresholds, ensemble.thermal, ensemble.thresholds.scale
    cold = thermal.attempt_frequency == 0 or math.isinf(ensemble.b)
    log_w = -math.inf if cold else math.log(thermal.attempt_frequency) + math.log(unit) - math.log(velocity)
    annealed = ensemble.disorder == "annealed" and law.steps.size != 1 and not cold
    if annealed:
        method = "published master equation"
        moments = published.stationary(law, ensemble.stiffness_law, thermal.barrier, ensemble.b, log_w)
    else:
        method = "joint kinetic equation"
        barrier = None if cold else thermal.barrier
        moments = kinetic.stationary(law, ensemble.stiffness_law, barrier, ensemble.b, log_w)
    stretch, work = moments.stretch, moments.work
    delay = velocity * ensemble.delay.time / unit
    drag = ensemble.eta * velocity / ensemble.stiffness / unit
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
