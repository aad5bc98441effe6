"""Steady averages of either ensemble from the master equation, as the engine reports them."""

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from scipy import optimize

from eqsim.estimate import Averages, Estimate
from eqsim.laws.aging import Flow, Langevin, Logarithmic, Unaged
from eqsim.master import annealed, flow, fokker_planck, quenched
from eqsim.master.quenched import Moments
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, reduced
from eqsim.numerics.tables import Array


@dataclass(frozen=True)
class Reference(Averages):
    """Exact steady averages; `stderr` of each estimate is the error estimate of the solver (absolute).

    Attributes
    ----------
    friction, pinned, break_stretch : Estimate
        The observables of `Averages`.
    f_k : Estimate
        Elastic part of the friction per pinned contact (length).
    method : str
        The equation that was solved.
    """

    f_k: Estimate
    method: str


class Solver(Protocol):
    """What the module of each equation has."""

    METHOD: str

    def stationary(self, s: Reduced) -> Moments:
        """Moments of lives."""

    def survivors(self, s: Reduced, x: Array) -> Array:
        """S(x) = P(x_b > x), E[k_i/k; x_b > x] and E[(k_i/k)^2; x_b > x] at ascending x > 0, shape (3, n)."""


_SOLVERS: dict[type, Solver] = {  # of quenched contacts
    Unaged: quenched,
    Flow: flow,
    Logarithmic: flow,
    Langevin: fokker_planck,
}


def solver(s: Reduced) -> Solver:
    """Which equation describes these contacts."""
    return annealed if s.annealed else _SOLVERS[type(s.aging)]


class Settled(NamedTuple):
    """An ensemble at a velocity, its births included; errors of moments count `sensitivity` times."""

    reduced: Reduced
    sensitivity: float


@functools.lru_cache(maxsize=64)
def settled(ensemble: Ensemble, velocity: float) -> Settled:
    """What the solvers need to know; births of annealed contacts that age are the fixed point C = int J_c exp(-Delta U)
    dx of star1. Raises InputError."""
    if not ensemble.self_consistent:
        return Settled(reduced(ensemble, velocity), 1.0)
    unit = ensemble.thresholds.scale

    def of(log_stretch: float) -> Reduced:
        return reduced(ensemble, velocity, math.exp(log_stretch) * unit)

    def excess(log_stretch: float) -> float:
        s = of(log_stretch)
        return math.log(solver(s).stationary(s).stretch) - log_stretch

    first = math.log(ensemble.thresholds.mean / unit)
    second = first + excess(first) + 1e-3  # in case births do not age at all
    fixed = float(optimize.root_scalar(excess, method="secant", x0=first, x1=second, xtol=1e-9).root)
    slope = -(excess(fixed + 1e-3) - excess(fixed)) / 1e-3  # 1 - d ln C/d ln C of births
    return Settled(of(fixed), 1.0 / max(slope, 1e-3))


def reference(ensemble: Ensemble, drive: Drive) -> Reference:
    """The steady averages of an ensemble by quadrature (nt13, star1 and derived equations).

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Only its velocity counts.

    Returns
    -------
    Reference

    Raises
    ------
    InputError
        If a dimensionless number is out of range, and for annealed contacts of more than 1000 different thresholds.
    """
    require_drive(drive)
    s, sensitivity = settled(ensemble, drive.velocity)
    found = solver(s).stationary(s)
    published = ensemble.disorder == "annealed" and ensemble.aging.active  # also where heat breaks none
    unit, delay, drag = s.law.scale, s.delay.mean, s.drag
    stretch, work = found.stretch, found.work
    stretch_error, work_error = (sensitivity * error for error in (found.stretch_error, found.work_error))
    relative = stretch_error / stretch + work_error / work
    pinned = stretch / (stretch + delay)
    pinned_error = pinned * (1.0 - pinned) * stretch_error / stretch
    elastic = work / (stretch + delay)
    friction, error = elastic + drag * (delay / (stretch + delay)), elastic * relative + drag * pinned_error
    return Reference(
        friction=Estimate(friction * unit, error * unit, 0),
        pinned=Estimate(pinned, pinned_error, 0),
        break_stretch=Estimate(stretch * unit, stretch_error * unit, 0),
        travel=Estimate(stretch * unit, stretch_error * unit, 0),
        birth_stretch=Estimate(0.0, 0.0, 0),
        force_variance=Estimate(None, None, 0, reliable=False),
        f_k=Estimate(work / stretch * unit, work / stretch * relative * unit, 0),
        method=annealed.METHOD if published else solver(s).METHOD,
    )
