"""Steady averages of either ensemble from the master equation, as the engine reports them."""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

from scipy import optimize

from eqsim.model.ensemble import Ensemble
from eqsim.errors import POSITIVE, require_number
from eqsim.estimate import Averages, Estimate
from eqsim.laws.aging import AgingRule
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.laws.thermal import Barrier
from eqsim.laws.threshold import ThresholdLaw
from eqsim.master import flow, fokker_planck, kinetic, published
from eqsim.master.quenched import Moments

PUBLISHED, KINETIC = "published master equation", "joint kinetic equation"
FLOWING, FOKKER_PLANCK = "joint kinetic equation along flowing thresholds", "Fokker-Planck equation"


@dataclass(frozen=True)
class Reference(Averages):
    """Exact steady averages; `stderr` of each estimate is the error estimate of the solver (absolute).

    `f_k` is the elastic part of the friction per pinned contact; `method` names the solver.
    """

    f_k: Estimate
    method: str


class Setting(NamedTuple):
    """An ensemble at a velocity as the solvers see it: lengths in units of `law.scale`, barrier None at T = 0,
    `delay` v<tau>, `drag` eta v/k; `annealed` only where it makes a difference; `aging` of quenched contacts with
    `final` = x_*f/x_*i and `alpha` of `laws.aging`. Errors of moments count `sensitivity` times."""

    law: ThresholdLaw
    stiffness: StiffnessLaw
    barrier: Barrier | None
    b: float
    log_w: float
    delay: float
    exponential: bool
    drag: float
    annealed: bool
    aging: AgingRule
    final: float
    alpha: float
    sensitivity: float


@functools.lru_cache(maxsize=64)
def setting(ensemble: Ensemble, velocity: float) -> Setting:
    """What the solvers need to know. Raises InputError if a dimensionless group is beyond 1e+-100."""
    require_number("velocity", velocity, **POSITIVE)
    law, thermal, unit = ensemble.thresholds, ensemble.thermal, ensemble.thresholds.scale
    aging, moving = ensemble.aging, False
    if ensemble.aging.active and not ensemble.self_consistent:
        law = ensemble.births(velocity)
        moving = law is ensemble.thresholds
    cold = not ensemble.heated(velocity)
    log_w = 0.0 if cold else math.log(thermal.attempt_frequency) + math.log(unit) - math.log(velocity)
    require_number("ln(attempt_frequency * threshold / velocity)", log_w, least=-230, most=230)
    delay = velocity * ensemble.delay.time / unit
    require_number("velocity * delay / threshold", delay, least=0, most=1e100)
    found = Setting(
        law=law,
        stiffness=ensemble.stiffness_law,
        barrier=None if cold else thermal.barrier,
        b=max(ensemble.b, 1e-100),
        log_w=log_w,
        delay=delay,
        exponential=ensemble.delay.law == "exponential",
        drag=ensemble.drag(velocity),
        annealed=ensemble.disorder == "annealed" and law.steps.size != 1 and not cold,
        aging=aging.rule if moving else "none",
        final=aging.x_star_final / unit if moving else 1.0,
        alpha=aging.alpha(unit, velocity) if moving else 0.0,
        sensitivity=1.0,
    )
    return _settled(found, ensemble, velocity) if ensemble.self_consistent else found


def _settled(s: Setting, ensemble: Ensemble, velocity: float) -> Setting:
    """Annealed contacts that age: births at the fixed point C = int J_c exp(-Delta U) dx of star1."""
    unit = s.law.scale

    def excess(log_stretch: float) -> float:
        births = s._replace(law=ensemble.births(velocity, math.exp(log_stretch) * unit))
        return math.log(moments(births)[1].stretch) - log_stretch

    first = math.log(ensemble.thresholds.mean / unit)
    second = first + excess(first) + 1e-3  # in case births do not age at all
    fixed = float(optimize.root_scalar(excess, method="secant", x0=first, x1=second, xtol=1e-9).root)
    slope = -(excess(fixed + 1e-3) - excess(fixed)) / 1e-3  # 1 - d ln C/d ln C of births
    law = ensemble.births(velocity, math.exp(fixed) * unit)
    return s._replace(law=law, sensitivity=1.0 / max(slope, 1e-3))


def moments(s: Setting) -> tuple[str, Moments]:
    """Which equation describes these contacts, and the moments of their lives."""
    if s.annealed and s.barrier is not None:
        return PUBLISHED, published.stationary(s.law, s.stiffness, s.barrier, s.b, s.log_w)
    if s.aging == "flow":
        return FLOWING, flow.stationary(s.law, s.stiffness, s.barrier, s.b, s.log_w, s.final, s.alpha)
    if s.aging == "langevin":
        found = survival(s)
        return FOKKER_PLANCK, Moments(found.stretch, found.work, found.stretch_error, found.work_error)
    return KINETIC, kinetic.stationary(s.law, s.stiffness, s.barrier, s.b, s.log_w)


@functools.lru_cache(maxsize=16)
def survival(s: Setting) -> fokker_planck.Survival:
    """A `langevin` life in the mean, remembered: the solution takes a second."""
    n = getattr(s.law, "n", 0.0)
    return fokker_planck.survival(n, s.final, 0.25 * s.alpha * s.final**2, s.stiffness, s.barrier, s.b, s.log_w)


def reference(ensemble: Ensemble, velocity: float) -> Reference:
    """The steady averages of an ensemble at constant velocity, by quadrature. Raises InputError."""
    s = setting(ensemble, velocity)
    method, found = moments(s)
    if ensemble.disorder == "annealed" and ensemble.aging.active:
        method = PUBLISHED
    unit, delay, drag = s.law.scale, s.delay, s.drag
    stretch, work = found.stretch, found.work
    stretch_error, work_error = (s.sensitivity * error for error in (found.stretch_error, found.work_error))
    relative = stretch_error / stretch + work_error / work
    pinned = stretch / (stretch + delay)
    pinned_error = pinned * (1.0 - pinned) * stretch_error / stretch
    elastic = work / (stretch + delay)
    friction, error = elastic + drag * (delay / (stretch + delay)), elastic * relative + drag * pinned_error
    return Reference(
        friction=Estimate(friction * unit, error * unit, 0),
        pinned=Estimate(pinned, pinned_error, 0),
        break_stretch=Estimate(stretch * unit, stretch_error * unit, 0),
        f_k=Estimate(work / stretch * unit, work / stretch * relative * unit, 0),
        method=method,
    )
