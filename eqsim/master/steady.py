"""Steady averages of either ensemble from the master equation, at one velocity as the
engine reports them, or at many for fits and curves."""

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.estimate import Averages, Estimate, infinite, known
from eqsim.laws.aging import Aging, Langevin
from eqsim.laws.threshold import Gamma
from eqsim.master.annealed import Ageing, annealed_moments
from eqsim.master.profile import Profile, moments_of
from eqsim.master.quenched import LifeMoments
from eqsim.model.drive import Drive, Programme, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.mixture import mixed_averages
from eqsim.model.reduced import Reduced, bare, delay_of, drag_of, reduced
from eqsim.numerics.tables import Array
from eqsim.results import Drawn, Result

# Names of equations.
_PUBLISHED = "published master equation"
_JOINT = "joint kinetic equation"
# Slowest motor, over its velocity without a load.
_SLOWEST = 1e-12
# Velocities in a decade, between which there is one steady velocity, or none, unless
# forces are closest to a balance there.
_LOOKS = 4


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
    velocity : Estimate or None
        Of a slider that a motor drives (length/time).
    roots : tuple of float
        All its steady velocities, ascending. `velocity` is the slowest to which it
        returns: v/u + friction/s rises there.
    """

    f_k: Estimate
    method: str
    velocity: Estimate | None = None
    roots: tuple[float, ...] = ()


@dataclass(frozen=True, repr=False)
class Curve(Result):
    """Steady averages over velocity, in the user's units, and their absolute errors,
    arrays (velocities,).

    Attributes
    ----------
    velocity : ndarray
    friction, pinned, break_stretch : ndarray
        Observables of `Averages`: force/(N k), a share, and a length.
    friction_error, pinned_error, break_stretch_error : ndarray
        Error estimates of the solver.
    """

    drawn: ClassVar[Drawn] = Drawn(
        "velocity",
        "friction",
        "friction_error",
        "velocity  v",
        "friction  <F>/(N k)",
        log=True,
    )
    velocity: Array
    friction: Array
    pinned: Array
    break_stretch: Array
    friction_error: Array
    pinned_error: Array
    break_stretch_error: Array


def reference(
    ensemble: Ensemble, drive: Drive | Programme, *, variance: bool = False
) -> Reference:
    """Solve for the steady averages of an ensemble by quadrature.

    Friction is F/(N k), a length, for N contacts of stiffness k; the number of contacts
    makes no difference. Annealed contacts follow eqs. (27) and (37) of Braun and Peyrard
    (2011), quenched ones derived equations. Contacts travel from their birth at y to
    where they break; with the mean travel E[l] = 1/Gamma, eq. (6),

        pinned = E[l]/(E[l] + v<tau>),    friction = E[W]/(E[l] + v<tau>) + (eta v/k)(1 - pinned),    f_k = E[W]/E[l],

    W = int_y^{x_b} kappa x dx with kappa = k_i/k, and with V = int_y^{x_b} kappa^2 x^2 dx the variance of
    the force of one contact over k is E[V]/(E[l] + v<tau>) + (eta v/k)^2 (1 - pinned) -
    friction^2 (derived). Behind a motor the velocity v solves v = u (1 - friction/s).

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive or Programme
        Its velocity (length/time) is all that matters; of a programme with a
        `stall_force` and no stage, that of its one segment. Other programmes, a stage
        or blocks are refused, since they have no steady state of this kind.
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
        For a drive that is not constant, a motor that friction stops, if a
        dimensionless number is out of range, and for annealed contacts of more than
        1000 different thresholds.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, reference
    >>> exact = reference(Ensemble(), Drive(velocity=0.1))
    >>> print(f"{exact.friction.value:.6f}, {exact.pinned.value:.1f}")
    0.883883, 1.0
    """
    if isinstance(drive, Programme) and drive.motor:
        return _behind_motor(ensemble, drive, variance)
    drive = require_drive(drive)
    if ensemble.populations:
        return _mixed(ensemble, drive, variance)
    v, stretched = drive.velocity, ensemble.newborn.active
    divergence = ensemble.divergence if variance or stretched else ""
    square = variance and not (divergence or stretched)
    alone = bare(ensemble)
    lives = lives_of(alone, (v,), square)
    found: dict[str, Any] = {
        name: Estimate(float(value[0]), float(error[0]), 0)
        for name, (value, error) in _observables(ensemble, (v,), lives).items()
    }
    if divergence or found["force_variance"].value == math.inf:
        found["force_variance"] = infinite()
    elif np.isnan(lives.square).any():
        found["force_variance"] = Estimate(None, None, 0, None, False)
    # also where heat breaks none
    published = ensemble.disorder == "annealed" and ensemble.aging.active
    method = _PUBLISHED if published else _method_of(reduced(alone, v))
    return Reference(**found, method=method)


def _method_of(contacts: Reduced) -> str:
    """The name of the equation that describes contacts."""
    if contacts.newborn.active:
        one_sided = f"{_PUBLISHED}, births R(x)"
        return one_sided if contacts.one_sided else f"{_JOINT}, births stretched"
    if contacts.annealed:
        return _PUBLISHED
    if isinstance(contacts.aging, Langevin):
        return "Fokker-Planck equation"
    along = "" if contacts.aging.closed else " along flowing thresholds"
    return _JOINT + along


def _behind_motor(ensemble: Ensemble, drive: Programme, variance: bool) -> Reference:
    """`reference` of a slider that a motor drives. Raises InputError."""
    u, s = drive.segments[0].velocity, drive.stall_force
    if drive.stage or len(drive.segments) > 1 or u <= 0.0:
        said = "a motor has steady averages at one velocity > 0 and without a stage"
        raise InputError(f"drive.stall_force = {s:g}: {said}")

    def excess(log_v: float) -> float:
        v = math.exp(log_v) * u
        return v / u - 1.0 + known(reference(ensemble, Drive(v)).friction) / s

    fastest = 1.0
    while excess(math.log(fastest)) < 0.0:  # births against the motion drive it, too
        fastest *= 10.0
    decades = math.log10(fastest / _SLOWEST)
    log_v = math.log(10.0) * np.arange(-_LOOKS * round(decades), 1.0) / _LOOKS
    log_v += math.log(fastest)
    v = np.exp(log_v)
    e = v - 1.0 + curve(ensemble, v * u).friction / s
    # the least distance to a balance may lie between velocities
    near = np.abs(e[1:-1]) < np.minimum(np.abs(e[2:]), np.abs(e[:-2]))
    for i in 1 + np.flatnonzero(
        near & (e[1:-1] * e[2:] > 0.0) & (e[1:-1] * e[:-2] > 0.0)
    ):
        side = math.copysign(1.0, e[i])
        bounds = log_v[i - 1], log_v[i + 1]
        least = optimize.minimize_scalar(
            lambda x, side=side: side * excess(x), bounds=bounds, method="bounded"
        )
        log_v, e = np.append(log_v, least.x), np.append(e, side * least.fun)
    order = np.argsort(log_v)
    log_v, above = log_v[order], e[order] >= 0.0
    brackets = np.flatnonzero(above[1:] != above[:-1])
    roots = [
        math.exp(optimize.brentq(excess, log_v[i], log_v[i + 1], xtol=1e-14)) * u
        for i in brackets
    ]
    stable = [root for root, i in zip(roots, brackets, strict=True) if not above[i]]
    if not stable:
        said = f"friction stops the motor; it is larger down to {_SLOWEST:g} velocity"
        raise InputError(f"drive.stall_force = {s:g}: {said}")
    x, h = math.log(stable[0] / u), 1e-4
    slow, found, fast = (
        reference(ensemble, Drive(math.exp(log) * u), variance=variance)
        for log in (x - h, x, x + h)
    )
    slope = abs(excess(x + h) - excess(x - h)) / (2.0 * h)
    relative = (found.friction.stderr or 0.0) / s / slope
    every: dict[str, Any] = {"velocity": Estimate(stable[0], relative * stable[0], 0)}
    for name, value in found.estimates().items():
        rise = [getattr(one, name).value for one in (slow, fast)]
        if value.value is not None and not value.diverges and None not in rise:
            missed = abs(rise[1] - rise[0]) / (2.0 * h) * relative
            every[name] = replace(value, stderr=(value.stderr or 0.0) + missed)
    return replace(found, **every, roots=tuple(roots))


def _mixed(ensemble: Ensemble, drive: Drive, variance: bool) -> Reference:
    """`reference` of several kinds of contacts."""
    kinds, v = ensemble.kinds, drive.velocity
    each = [reference(kind.contacts, drive, variance=variance) for kind in kinds]
    found: dict[str, Any] = mixed_averages(kinds, each, v, bounds=True)
    drag = drag_of(ensemble, v) * ensemble.thresholds.scale
    friction, pinned = known(found["friction"]), known(found["pinned"])
    method = "; ".join(dict.fromkeys(one.method for one in each))
    if not pinned:  # no contact forms again
        return Reference(**found, f_k=Estimate(None, None, 0), method=method)
    f_k = (friction - drag * (1.0 - pinned)) / pinned
    error = found["friction"].stderr or 0.0
    error += abs(drag - f_k) * (found["pinned"].stderr or 0.0)
    return Reference(**found, f_k=Estimate(f_k, error / pinned, 0), method=method)


def curve(ensemble: Ensemble, velocities: Array) -> Curve:
    """Solve for the steady averages at many velocities, the same as those of
    `reference` within the errors of both. Friction is F/(N k), a length.

    Parameters
    ----------
    ensemble : Ensemble
    velocities : array_like, shape (velocities,)
        > 0 (length/time), in any order, of a slider without stage and blocks; by
        default those of a run file's sweep over drive.velocity, or of its drive.

    Returns
    -------
    Curve

    Raises
    ------
    InputError
        For velocities that are not positive, and for contacts that `reference` refuses.

    Examples
    --------
    >>> from eqsim import Ensemble, Thermal, curve
    >>> found = curve(Ensemble(thermal=Thermal(kT=0.1)), [0.01, 0.1, 1.0])
    >>> found.friction.round(4).tolist()
    [0.977, 0.9284, 0.8912]
    """
    v = np.asarray(velocities, float)
    if v.ndim != 1 or not v.size:
        raise InputError("velocities: must be a list of at least one velocity")
    every, names = tuple(v.tolist()), ("friction", "pinned", "break_stretch")
    if ensemble.populations:
        exact = [reference(ensemble, Drive(velocity)) for velocity in every]
        pairs = [[getattr(one, name) for one in exact] for name in names]
        values = [np.array([one.value for one in column]) for column in pairs]
        return Curve(v, *values, *(np.array([x.stderr for x in y]) for y in pairs))
    found = _observables(ensemble, every, lives_of(bare(ensemble), every))
    basic = [found[name] for name in names]
    return Curve(v, *(value for value, _ in basic), *(error for _, error in basic))


def _observables(
    ensemble: Ensemble, velocities: tuple[float, ...], lives: LifeMoments
) -> dict[str, tuple[Array, Array]]:
    """Values and absolute errors of observables in the user's units, arrays
    (velocities,)."""
    unit = ensemble.thresholds.scale
    delay = np.array([delay_of(ensemble, v).mean for v in velocities])
    drag = np.array([drag_of(ensemble, v) for v in velocities])
    travel, work, square = lives.stretch, lives.work, lives.square
    relative, cycle = lives.stretch_error / travel, travel + delay
    pinned = travel / cycle
    pinned_error = pinned * (1.0 - pinned) * relative
    elastic = work / cycle
    endless = np.isinf(delay)
    detached = np.where(endless, 1.0, delay / np.where(endless, 1.0, cycle))
    friction = elastic + drag * detached
    error = (lives.work_error + np.abs(work) * pinned * relative) / cycle
    error += drag * pinned_error
    f_k_error = lives.work_error / travel + np.abs(work) / travel * relative
    variance = square / cycle + drag**2 * (1.0 - pinned) - friction**2
    missed = (lives.square_error + square * pinned * relative) / cycle
    missed += drag**2 * pinned_error + 2.0 * np.abs(friction) * error
    off = lives.stretch_error * unit
    return {
        "friction": (friction * unit, error * unit),
        "pinned": (pinned, pinned_error),
        "break_stretch": ((lives.birth + travel) * unit, off),
        "travel": (travel * unit, off),
        "birth_stretch": (lives.birth * unit + 0.0 * off, 0.0 * off),
        "force_variance": (variance * unit**2, missed * unit**2),
        "f_k": (work / travel * unit, f_k_error * unit),
    }


# It takes 1 ms to 1 s, and a fit, a sweep or a reference may change the delay or the
# viscosity alone; 128 of the longest lists of velocities that are fitted are within
# 1 MB.
@functools.lru_cache(maxsize=128)
def lives_of(
    ensemble: Ensemble, velocities: tuple[float, ...], square: bool = False
) -> LifeMoments:
    """Moments of lives, whatever the delay, which only changes how
    often they begin; with the mean square of force of contacts born unstretched if
    asked, where it is finite. Raises InputError."""
    law, aging = ensemble.thresholds, ensemble.aging
    if ensemble.disorder == "annealed" and aging.active and isinstance(law, Gamma):
        plain = replace(ensemble, aging=Aging())
        every = [reduced(plain, v) for v in velocities]
        alpha = np.array([aging.alpha(law.scale, v) for v in velocities])
        found = annealed_moments(every, Ageing(alpha, aging.final(law.scale)))
    else:
        every = [reduced(ensemble, v) for v in velocities]
        found = moments_of(every, square=square)
    if square and np.isnan(found.square).any():
        squares = [
            _square_of(reduced(ensemble, v, stretch * law.scale))
            for v, stretch in zip(velocities, found.stretch.tolist(), strict=True)
        ]
        square_of, error = np.transpose(squares)
        found = found._replace(square=square_of, square_error=error)
    return found


def settled(ensemble: Ensemble, velocity: float) -> Reduced:
    """An ensemble at a velocity as the solvers need it; births of annealed contacts
    that age are the fixed point C = int J_c exp(-Delta U) dx of star1. Raises
    InputError."""
    if not ensemble.self_consistent:
        return reduced(ensemble, velocity)
    stretch = float(lives_of(bare(ensemble), (velocity,)).stretch[0])
    return reduced(ensemble, velocity, stretch * ensemble.thresholds.scale)


def _square_of(contacts: Reduced) -> tuple[float, float]:
    """E[int kappa^2 x^2 dx] of contacts born unstretched, and its error, by quadrature
    over thresholds or from the profile of a life."""
    if contacts.aging.closed and not contacts.annealed:
        closed = moments_of([contacts], square=True)
        return float(closed.square[0]), float(closed.square_error[0])
    profile = Profile(contacts)
    square = float(profile.integral(np.array([math.inf]), 2)[2, 0])
    square += float(profile.beyond[2, 2])
    # of the end of a life the square knows more than the work does, by which the
    # profile's error was judged: twice it
    return square, 2.0 * profile.error * square + float(profile.missed_beyond[2, 2])
