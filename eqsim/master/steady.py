"""Steady averages of either ensemble from the master equation, as the engine reports them."""

import functools
from dataclasses import dataclass

from eqsim.estimate import Averages, Estimate
from eqsim.master import annealed
from eqsim.master.quenched import Moments
from eqsim.master.solvers import solver
from eqsim.master.velocities import bare, delay_of, lives_of
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, drag_of, reduced


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


@functools.lru_cache(maxsize=64)
def settled(ensemble: Ensemble, velocity: float) -> Reduced:
    """An ensemble at a velocity as the solvers need it; births of annealed contacts that age are the fixed point
    C = int J_c exp(-Delta U) dx of star1. Raises InputError."""
    if not ensemble.self_consistent:
        return reduced(ensemble, velocity)
    stretch = float(lives_of(bare(ensemble), (velocity,)).stretch[0])
    return reduced(ensemble, velocity, stretch * ensemble.thresholds.scale)


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
    v = drive.velocity
    published = ensemble.disorder == "annealed" and ensemble.aging.active  # also where heat breaks none
    unit, delay, drag = ensemble.thresholds.scale, delay_of(ensemble, v), drag_of(ensemble, v)
    if ensemble.self_consistent:
        found, method = Moments(*(float(part[0]) for part in lives_of(bare(ensemble), (v,)))), annealed.METHOD
    else:
        s = settled(ensemble, v)
        found, method = solver(s).stationary(s), annealed.METHOD if published else solver(s).METHOD
    stretch, work, stretch_error, work_error = found
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
