"""Steady averages by renewal-reward: contacts at constant velocity are independent
renewal processes, so averages over whole lives are averages over time (derived):

    friction = E[int_y^{x_b} (k_i/k) x dx] / (E[l] + v<tau>) + (eta v/k)(1 - pinned)
    pinned   = E[l] / (E[l] + v<tau>)                (eq:ncnf, for any law of the delay)
    travel   = E[l] = C[P, R],    break_stretch = E[x_b] = travel + E[y]                            (Gamma0)
    force_variance = E[int_y^{x_b} (k_i x/k)^2 dx] / (E[l] + v<tau>)
                     + (eta v/k)^2 (1 - pinned) - friction^2

with y the stretch at birth and l = x_b - y the travel.

Lives are sampled by randomised quasi-Monte Carlo (`engine.randomise`): 32 independently
scrambled Sobol sequences, whose scatter is the error, from densities made for these
averages (`engine.proposal`); `engine.errorbars` adds the errors that the scatter does
not show. The path of a `langevin` threshold is plain Monte Carlo on top of it, with
steps so short that their error is at most a third of the one asked for.

Annealed contacts that age are born with thresholds whose age is set by their own mean
pinned time C/v. Each randomisation finds its own fixed point C = E[x_b; C], to first
order from lives at two values of C near it, so that the errors quoted hold the error of
C.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.errorbars import Unseen, hidden_errors, table_errors
from eqsim.engine.langevin import STEP, step_error
from eqsim.engine.proposal import FEWEST_LIVES, RANDOMISATIONS, proposal_of
from eqsim.engine.randomise import SteadyJob, randomise
from eqsim.engine.sample import rough_stretch
from eqsim.errors import InputError, require_number
from eqsim.estimate import Averages, Estimate, infinite, known
from eqsim.laws.aging.base import stiffness_varies
from eqsim.laws.delay import Waits
from eqsim.model.drive import Drive, Output, require_drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.mixture import mixed_averages, summed
from eqsim.model.reduced import bare, drag_of
from eqsim.numerics.streams import name_of
from eqsim.numerics.tables import Array

# relative error asked for, from which on half as many lives will do at first: errors
# are then a hundredth of what is asked
_COARSE_ERROR = 1e-2
# error ~ lives^-decay, assumed when lives are predicted: between Monte Carlo and smooth
# integrands
_DECAY = 0.75
# relative change of C that shows how births respond to it; the fixed point is
# linearised within its square
_NUDGE = 1e-2
_SETTLED_ERROR = 3e-5  # relative error of the C that a trajectory's births are given
# where a single life makes up more of a sum, others like it were probably not met
_DOMINANT_SHARE = 0.02
# likewise where a variance has a greater relative error: squares have heavier tails
# than the force
_BROAD = 0.05


@dataclass(frozen=True, repr=False)
class Steady(Averages):
    """Steady averages as estimated.

    Attributes
    ----------
    friction, pinned, break_stretch, travel, birth_stretch, force_variance : Estimate
        Estimates as in `Averages`. `force_variance` has no value where the stiffness of
        a contact follows its aging threshold, and is infinite where it diverges
        (`Ensemble.divergence`).
    lives : int
        Lives of contacts that were simulated.
    seed, engine_seconds
        Seed of the random numbers, and seconds that it took.
    reached : bool
        True if the error is at most the one asked for.
    hidden : float
        Bound on the relative error of means over lives that the scatter does not show.
    """

    lives: int
    seed: int
    engine_seconds: float
    reached: bool
    hidden: float


def steady(
    ensemble: Ensemble,
    drive: Drive,
    *,
    rel_error: float = 1e-3,
    seed: int = 1,
    threads: int = 1,
    max_lives: float = 1e10,
    progress: Callable[[int, int], None] | None = None,
    plain: bool = False,
) -> Steady:
    """Estimate steady averages by renewal-reward over whole lives of contacts.

    Friction is F/(N k), a length, for N contacts of stiffness k; the number of contacts
    makes no difference. Multiply by N k for newtons.

    Parameters
    ----------
    ensemble : Ensemble
    drive : Drive
        Its velocity (length/time) is all that matters: a drive with a programme, a
        stage or blocks is refused, since it has no steady state of this kind.
    rel_error : float
        Relative standard error asked of all observables.
    seed : int
        Seed of the random numbers.
    threads : int
        Changes speed only.
    max_lives : float
        Work that would need more lives of contacts is refused before it starts.
    progress : callable, optional
        `progress(done, total)` is called with the lives of an attempt; each attempt
        begins with done = 0.
    plain : bool
        Draw independent lives as they are born, without Sobol sequences and weights:
        slower, a check of the default, and unreliable where tails are heavy.

    Returns
    -------
    Steady

    Raises
    ------
    InputError
        For arguments out of range, and if more than `max_lives` lives would be needed.

    Examples
    --------
    >>> from eqsim import Drive, Ensemble, steady
    >>> found = steady(Ensemble(), Drive(velocity=0.1), rel_error=1e-2)
    >>> print(f"{found.friction.value:.2f}")  # <F>/(N k), a length
    0.88
    """
    require_drive(drive)
    require_number("rel_error", rel_error, above=0)
    require_number("max_lives", max_lives, above=0)
    Output(seed=seed)
    threads = max(1, threads)
    if ensemble.populations:
        options: Any = {"rel_error": rel_error, "threads": threads, "plain": plain}
        options |= {"max_lives": max_lives, "progress": progress}
        kinds = ensemble.kinds
        each = [steady(x.contacts, drive, seed=x.seed(seed), **options) for x in kinds]
        mixed = mixed_averages(kinds, each, drive.velocity)
        hidden = max(found.hidden for found in each)
        total: Steady = summed(kinds, each, **mixed, seed=seed, hidden=hidden)
        return total
    velocity, divergence = drive.velocity, ensemble.divergence
    rough = rough_stretch(ensemble, velocity)
    c = contacts(ensemble, velocity, rough)
    proposal = None if plain else proposal_of(bare(ensemble), velocity, rough)
    # parameters enter the streams, so that the errors of many parameter sets at one
    # seed are independent; as they were declared, because a table's last bits are the
    # processor's
    identity = name_of(*ensemble.declared(velocity))
    step = STEP
    if c.aging.fluctuates and proposal:
        step *= min(1.0, math.sqrt(rel_error / (3.0 * step_error(c.aging))))
    job = SteadyJob(
        ensemble, velocity, proposal, identity, seed, threads, progress, step
    )
    begin = time.perf_counter()
    tables = table_errors(ensemble, c, step)
    drag, unit = drag_of(ensemble, velocity), ensemble.thresholds.scale
    response: Array | None = None
    size, done = FEWEST_LIVES, 0
    # plain lives and random paths have larger errors
    if proposal and rel_error >= _COARSE_ERROR and not c.aging.fluctuates:
        size //= 2
    while True:
        count = RANDOMISATIONS * size
        if count > max_lives:
            raise InputError(
                f"this needs {count:.3g} lives, more than max_lives = {max_lives:.3g}"
            )
        if rough is None:
            sums, lives_used = randomise(job, c, size), count
        else:
            found = _self_consistent(job, rough, response, size)
            sums, rough, response, lives_used = found
        done += lives_used
        unseen = hidden_errors(c, proposal, count, tables, bool(divergence))
        covered = proposal is None or proposal.covered
        result = _averages(c, sums, drag, unit, size, covered, unseen)
        if divergence:
            result = (*result[:-1], infinite(count))
        error = _relative(result)
        # more lives do not improve a table
        excess = error / max(rel_error, 1.5 * tables.means)
        # the next attempt aims at less than what was asked for, so that stopping hardly
        # selects lucky error bars
        aim, decay = (1.3, 0.5) if plain or c.aging.fluctuates else (2.0, _DECAY)
        more = max(size * (aim * excess) ** (1 / decay), 2.0 * size)
        needed = 2 ** math.ceil(math.log2(more))
        enough = excess <= 1 and (size >= FEWEST_LIVES or result[0].reliable)
        late = done > 2 * RANDOMISATIONS * FEWEST_LIVES
        if enough or (late and RANDOMISATIONS * needed > max_lives):
            seconds, reached = time.perf_counter() - begin, error <= rel_error
            how_computed = done, seed, seconds, reached, unseen.means
            return Steady(*result, *how_computed)  # type: ignore[call-arg,arg-type]
        size = needed


def settled(
    ensemble: Ensemble, drive: Drive, seed: int, threads: int = 1
) -> float | None:
    """The mean stretch at breaking that births of annealed contacts that age depend on,
    by a steady estimate; None for all others."""
    if not ensemble.self_consistent:
        return None
    found = steady(
        ensemble, drive, rel_error=_SETTLED_ERROR, seed=seed, threads=threads
    )
    return known(found.break_stretch)


def _self_consistent(
    job: SteadyJob, stretch: float, response: Array | None, size: int
) -> tuple[Array, float, Array, int]:
    """Sums of each randomisation at its own fixed point of C, the mean fixed point, the
    response of the sums to C (measured unless it is known), and the lives this took."""
    used, unit = 0, job.ensemble.thresholds.scale

    def sums(stretch: float) -> Array:
        nonlocal used
        used += RANDOMISATIONS * size
        return randomise(job, contacts(job.ensemble, job.velocity, stretch), size)

    if response is None:
        near, far = (sums(stretch * by).mean(axis=0) for by in (1.0, 1.0 + _NUDGE))
        response = (far - near) / (_NUDGE * stretch / unit)
    for _ in range(20):
        rows = sums(stretch)
        shift = (rows[:, 1] - stretch / unit) / (1.0 - response[1])
        stretch += float(shift.mean()) * unit
        if abs(shift.mean()) * unit < _NUDGE * _NUDGE * stretch:
            break
    rows[:, :4] += shift[:, None] * response[:4]
    return rows, stretch, response, used


def _relative(found: tuple[Estimate, ...]) -> float:
    """The largest relative error; of friction and stretch, where births along the
    motion and against it cancel, over a thousandth and a tenth of the root of the
    variance of forces at least."""
    friction, pinned, stretch, travel, birth, variance = found
    force = 0.0
    if variance.stderr is not None:
        force = math.sqrt(abs(variance.value or 0.0))
    size = max(abs(known(friction)), 1e-3 * force) or 1.0
    relative = [(e.stderr or 0.0) / (e.value or 1.0) for e in (pinned, travel)]
    relative.append((friction.stderr or 0.0) / size)
    if birth.stderr or birth.value:  # else it is the travel
        size = max(abs(known(stretch)), 0.1 * force)
        relative.append((stretch.stderr or 0.0) / size)
    return max(relative)


def _averages(
    c: Contacts,
    sums: Array,
    drag: float,
    unit: float,
    size: int,
    covered: bool,
    unseen: Unseen,
) -> tuple[Estimate, ...]:
    """Delta-method estimates from the randomisations, in the order of `OBSERVABLES`;
    `drag` is eta v/k and `unit` that of length."""
    if c.delay.mean == math.inf:  # in the end all contacts are detached
        of_lives = c._replace(delay=Waits(0.0, 0.0))
        found = _averages(of_lives, sums, drag, unit, size, covered, unseen)
        known_ones = (drag * unit, 0.0, 0.0)
        of_all = [Estimate(value, 0.0, found[1].n) for value in known_ones]
        return of_all[0], of_all[1], *found[2:5], of_all[2]
    reliable = covered and float(sums[:, 4].max()) < _DOMINANT_SHARE
    n, delay, hidden = RANDOMISATIONS * size, c.delay.mean, unseen.means
    work, travel, square, birth = sums[:, :4].T
    cycle = travel + delay
    friction = float((work.mean() + drag * delay) / cycle.mean())
    pinned = float(travel.mean() / cycle.mean())

    def estimate(value: float, residual: Array, error: float, unit: float) -> Estimate:
        scatter = float(np.std(residual, ddof=1)) / math.sqrt(RANDOMISATIONS)
        stderr = math.hypot(scatter, error)
        return Estimate(value * unit, stderr * unit, n, RANDOMISATIONS - 1, reliable)

    of_friction = (work + drag * delay - friction * cycle) / cycle.mean()
    of_pinned = (travel - pinned * cycle) / cycle.mean()
    # laws may be so broad that there is no variance
    with np.errstate(over="ignore", invalid="ignore"):
        second = float((square.mean() + drag**2 * delay) / cycle.mean())
        # among all randomisations: in one alone few lives make much of its mean square
        largest = float((sums[:, 5] * square).max() / square.sum())
        of_second = (square + drag**2 * delay - second * cycle) / cycle.mean()
        value, error = second - friction**2, unseen.squares * second
        of_variance = of_second - 2.0 * friction * of_friction
        variance = estimate(value, of_variance, error, unit * unit)
    value, stderr = known(variance), variance.stderr or 0.0
    finite = math.isfinite(value) and math.isfinite(stderr)
    if stiffness_varies(c.aging, c.springs) or not finite:
        variance = Estimate(None, None, n)
    elif stderr > _BROAD * abs(value) or largest >= _DOMINANT_SHARE:
        variance = replace(variance, reliable=False)
    # births along the motion and against it cancel; <|f|>^2 <= pinned <f^2>
    force = max(abs(friction), math.sqrt(second * pinned) if birth.any() else 0.0)
    gone, begun = float(np.mean(np.abs(travel))), float(np.mean(np.abs(birth)))
    waiting = hidden * pinned * (delay / float(cycle.mean()))
    reached, mean_travel = travel + birth, float(travel.mean())
    return (
        estimate(friction, of_friction, hidden * force, unit),
        estimate(pinned, of_pinned, waiting, 1.0),
        estimate(float(reached.mean()), reached, hidden * (gone + begun), unit),
        estimate(mean_travel, travel, hidden * mean_travel, unit),
        estimate(float(birth.mean()), birth, hidden * begun, unit),
        variance,
    )
