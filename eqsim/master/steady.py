"""Steady averages of either ensemble from the master equation, as the engine reports
them."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from eqsim.estimate import Averages, Estimate, infinite
from eqsim.master import annealed, newborn, quenched
from eqsim.master.quenched import Moments
from eqsim.master.solvers import solver
from eqsim.master.velocities import delay_of, lives_of
from eqsim.model.drive import Drive, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, bare, drag_of, reduced


@dataclass(frozen=True, repr=False)
class Reference(Averages):
    """Exact steady averages; `stderr` of each estimate is the error estimate of the
    solver (absolute).

    Attributes
    ----------
    friction, pinned, break_stretch, travel, birth_stretch, force_variance : Estimate
        The observables of `Averages`; the last without a value unless it was asked for.
    f_k : Estimate
        Elastic part of the friction per pinned contact (length).
    method : str
        The equation that was solved.
    """

    f_k: Estimate
    method: str


def settled(ensemble: Ensemble, velocity: float) -> Reduced:
    """An ensemble at a velocity as the solvers need it; births of annealed contacts
    that age are the fixed point C = int J_c exp(-Delta U) dx of star1. Raises
    InputError."""
    if not ensemble.self_consistent:
        return reduced(ensemble, velocity)
    stretch = float(lives_of(bare(ensemble), (velocity,)).stretch[0])
    return reduced(ensemble, velocity, stretch * ensemble.thresholds.scale)


def reference(ensemble: Ensemble, drive: Drive, *, variance: bool = False) -> Reference:
    """Solve for the steady averages of an ensemble by quadrature.

    Friction is F/(N k), a length, for N contacts of stiffness k; the number of contacts
    makes no difference. Annealed contacts follow eqs. (27) and (37) of Braun and Peyrard
    (2011), quenched ones derived equations. Contacts travel from their birth at y to
    where they break; with the mean travel E[l] = 1/Gamma, eq. (3),

        pinned = E[l]/(E[l] + v<tau>),    friction = E[W]/(E[l] + v<tau>) + (eta v/k)(1 - pinned),    f_k = E[W]/E[l],

    W = int_y^{x_b} kappa x dx, and with V = int_y^{x_b} kappa^2 x^2 dx the variance of
    the force of one contact over k is E[V]/(E[l] + v<tau>) + (eta v/k)^2 (1 - pinned) -
    friction^2 (derived).

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Its velocity (length/time) is all that matters: a drive with a programme, a
        stage or blocks is refused, since it has no steady state of this kind.
    variance : bool
        Whether to find the force variance of contacts born unstretched, too, which
        takes longer; it is known anyway of those born stretched. Where it is infinite
        (`Ensemble.divergence`) its value is, and `reliable` is False.

    Returns
    -------
    Reference

    Raises
    ------
    InputError
        For a drive that is not constant, if a dimensionless number is out of range, and
        for annealed contacts of more than 1000 different thresholds.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, reference
    >>> exact = reference(Ensemble(), Drive(velocity=0.1))
    >>> print(f"{exact.friction.value:.6f}, {exact.pinned.value:.1f}")
    0.883883, 1.0
    """
    require_drive(drive)
    v = drive.velocity
    if ensemble.self_consistent:
        found, method = (
            Moments(*(float(part[0]) for part in lives_of(bare(ensemble), (v,))[:4])),
            annealed.METHOD,
        )
    else:
        s = settled(ensemble, v)
        found, method = _moments(bare(ensemble), v), _method(ensemble, s)
    divergence = ensemble.divergence if variance or found.square is not None else ""
    if (
        variance
        and found.square is None
        and not (divergence or ensemble.newborn.active)
    ):
        found = _with_square(settled(ensemble, v), found)
    unit, delay, drag = (
        ensemble.thresholds.scale,
        delay_of(ensemble, v),
        drag_of(ensemble, v),
    )
    travel, work = found.stretch, found.work
    travel_error, work_error = found.stretch_error, found.work_error
    relative, cycle = travel_error / travel, travel + delay
    pinned = travel / cycle
    pinned_error = pinned * (1.0 - pinned) * relative
    elastic = work / cycle
    friction = elastic + drag * (delay / cycle)
    error = (work_error + abs(work) * pinned * relative) / cycle + drag * pinned_error
    f_k, f_k_error = work / travel, work_error / travel + abs(work) / travel * relative
    spread = Estimate(None, None, 0, None, False)
    if divergence:
        spread = infinite()
    elif found.square is not None:
        square = found.square / cycle + drag**2 * (1.0 - pinned)
        missed = (
            found.square_error + found.square * pinned * relative
        ) / cycle + drag**2 * pinned_error
        missed += 2.0 * abs(friction) * error
        spread = Estimate((square - friction**2) * unit**2, missed * unit**2, 0)
    return Reference(
        friction=Estimate(friction * unit, error * unit, 0),
        pinned=Estimate(pinned, pinned_error, 0),
        break_stretch=Estimate((found.birth + travel) * unit, travel_error * unit, 0),
        travel=Estimate(travel * unit, travel_error * unit, 0),
        birth_stretch=Estimate(found.birth * unit, 0.0, 0),
        force_variance=spread,
        f_k=Estimate(f_k * unit, f_k_error * unit, 0),
        method=method,
    )


# It takes up to 1 s, of contacts born stretched, and a fit or a sweep may change the
# delay or the viscosity alone.
@functools.lru_cache(maxsize=64)
def _moments(ensemble: Ensemble, velocity: float) -> Moments:
    """Moments of lives, whatever the delay, which only changes how often they begin."""
    s = settled(ensemble, velocity)
    return solver(s).stationary(s)


def _method(ensemble: Ensemble, contacts: Reduced) -> str:
    if contacts.newborn.active:
        return newborn.method(contacts)
    published = (
        ensemble.disorder == "annealed" and ensemble.aging.active
    )  # also where heat breaks none
    return annealed.METHOD if published else solver(contacts).METHOD


def _with_square(contacts: Reduced, moments: Moments) -> Moments:
    """Moments of contacts born unstretched with E[int kappa^2 x^2 dx]: where lives are
    known in closed form from these, else from the profile of a life."""
    if solver(contacts) is quenched:
        square, error = quenched.squares(contacts)
        return moments._replace(square=square, square_error=error)
    from eqsim.master.profile import profile_of  # which needs the solvers

    profile = profile_of(contacts)
    square = float(profile.integral(np.array([math.inf]), 2)[2, 0])
    rest, missed = quenched.integrals_beyond(
        contacts, float(profile.x[-1]), float(profile.survive[-1])
    )
    square += float(rest[2, 2])
    # of the end of a life the square knows more than the work does, by which the
    # profile's error was judged: twice it
    return moments._replace(
        square=square, square_error=2.0 * profile.error * square + float(missed[2, 2])
    )
