"""Contacts as kernels see them: the laws of `eqsim.laws` and their tables."""

from typing import Any, NamedTuple

from eqsim.laws.barrier.pooled import Pooled, pooled_hazard_of
from eqsim.laws.newborn import Stretched, Unstressed, stretched
from eqsim.laws.stiffness import Springs
from eqsim.laws.threshold import Thresholds, for_kernels
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import reduced
from eqsim.numerics.tables import Array


class Contacts(NamedTuple):
    """The laws of a contact, each a NamedTuple by whose type kernels are compiled;
    lengths in units of the threshold law's scale, time as displacement."""

    thresholds: Thresholds
    springs: Springs
    barrier: Any  # a `Barrier`, or `Pooled` if attempts draw fresh thresholds
    barrier_table: Array  # for `laws.barrier.base.stretch`
    hazard_table: Array  # for `laws.barrier.base.hazard`
    aging: Any  # an `AgingLaw`
    aging_table: Array  # for `laws.aging.base.work`
    delay: Any  # `Waits` or `DrawnWaits`
    newborn: Any  # `Unstressed` or `Stretched`


def contacts(
    ensemble: Ensemble, velocity: float, mean_stretch: float | None = None
) -> Contacts:
    """An ensemble at `velocity` for kernels; `mean_stretch` as in `reduced`. Raises
    InputError, also where there is no table for these numbers."""
    s = reduced(ensemble, velocity, mean_stretch)
    barrier: Any = s.barrier
    if s.annealed:
        # the pool does not depend on the velocity, which is in log_w
        bare = barrier._replace(log_w=0.0)
        pool = pooled_hazard_of(s.law, s.stiffness, bare, s.barrier.b)
        barrier = Pooled(s.barrier.log_w, *pool)
    born: Unstressed | Stretched = Unstressed()
    if s.newborn.active:
        born = stretched(s.newborn, s.law, not s.one_sided)
    return Contacts(
        thresholds=for_kernels(s.law),
        springs=s.springs,
        barrier=barrier,
        barrier_table=s.barrier.table(),
        hazard_table=s.barrier.hazard_table(),
        aging=s.aging,
        aging_table=s.aging.table(s.springs),
        delay=s.delay.for_kernels(),
        newborn=born,
    )
