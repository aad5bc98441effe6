"""Contacts as kernels see them: the laws of `eqsim.laws` and their tables."""

from typing import Any, NamedTuple

from eqsim.laws.barrier.pooled import Pooled, pooled_hazard_of
from eqsim.laws.delay import Waits
from eqsim.laws.newborn import Unstressed, stretched
from eqsim.laws.stiffness import Springs
from eqsim.laws.threshold import Thresholds, for_kernels
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import Reduced, reduced
from eqsim.numerics.tables import Array


class Contacts(NamedTuple):
    """The laws of a contact, each a NamedTuple by whose type kernels are compiled;
    lengths in units of the threshold law's scale, time as displacement.

    Attributes
    ----------
    thresholds : Thresholds
    springs : Springs
    barrier : a `Barrier`, or `Pooled` if attempts draw fresh thresholds
    barrier_table, hazard_table : ndarray
        What `laws.barrier.base.stretch` and `hazard` look up.
    aging : AgingLaw
    aging_table : ndarray
        What `laws.aging.base.work` looks up.
    delay : Waits
    newborn : `Unstressed` or `Stretched`
    """

    thresholds: Thresholds
    springs: Springs
    barrier: Any
    barrier_table: Array
    hazard_table: Array
    aging: Any
    aging_table: Array
    delay: Waits
    newborn: Any


def lower(s: Reduced) -> Contacts:
    """Dimensionless numbers as kernel arguments. Raises InputError where there is no
    table for them."""
    barrier: Any = s.barrier
    if s.annealed:
        pool = pooled_hazard_of(s.law, s.stiffness, type(s.barrier), s.barrier.b)  # type: ignore[arg-type]
        barrier = Pooled(s.barrier.log_w, pool.x, pool.G, pool.slopes)
    born = (
        stretched(s.newborn, s.law, not s.one_sided)
        if s.newborn.active
        else Unstressed()
    )
    return Contacts(
        for_kernels(s.law), s.springs, barrier, s.barrier.table(), s.barrier.hazard_table(), s.aging,
        s.aging.table(s.springs), s.delay.for_kernels(), born,
    )  # fmt: skip


def contacts(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None = None
) -> Contacts:
    """An ensemble at `velocity` for kernels; `mean_stretch` as in `reduced`. Raises
    InputError."""
    return lower(reduced(ensemble, velocity, mean_stretch))
