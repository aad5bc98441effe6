"""The equation that describes contacts, and its solution."""

from collections.abc import Sequence

from eqsim.laws.aging import Langevin, Unaged
from eqsim.master.annealed import annealed_moments
from eqsim.master.flow import moments_along_paths
from eqsim.master.fokker_planck import fluctuating_moments
from eqsim.master.newborn import stretched_moments
from eqsim.master.quenched import LifeMoments, quenched_moments
from eqsim.model.reduced import Reduced

PUBLISHED = "published master equation"
JOINT = "joint kinetic equation"


def method_of(contacts: Reduced) -> str:
    """The name of the equation."""
    if contacts.newborn.active:
        one_sided = f"{PUBLISHED}, births R(x)"
        return one_sided if contacts.one_sided else f"{JOINT}, births stretched"
    if contacts.annealed:
        return PUBLISHED
    if isinstance(contacts.aging, Langevin):
        return "Fokker-Planck equation"
    along = "" if contacts.aging.closed else " along flowing thresholds"
    return JOINT + along


def moments_of(every: Sequence[Reduced], *, square: bool = False) -> list[LifeMoments]:
    """Moments of lives, one for each of `every`, which differ in velocity only; with
    the mean square of force where lives are known in closed form. Raises InputError."""
    contacts = every[0]
    if contacts.newborn.active:
        return [stretched_moments(s) for s in every]
    if contacts.annealed:
        return annealed_moments(every)
    if isinstance(contacts.aging, Unaged):
        return quenched_moments(every, square=square)
    fluctuates = isinstance(contacts.aging, Langevin)
    solve = fluctuating_moments if fluctuates else moments_along_paths
    return [solve(s) for s in every]
