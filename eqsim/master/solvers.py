"""Which equation describes an ensemble."""

from typing import Protocol

from eqsim.laws.aging import Flow, Langevin, Logarithmic, Unaged
from eqsim.master import annealed, flow, fokker_planck, newborn, quenched
from eqsim.master.quenched import Moments
from eqsim.model.reduced import Reduced


class Solver(Protocol):
    """The functions that the module of each equation has."""

    METHOD: str

    def stationary(self, contacts: Reduced) -> Moments:
        """Moments of lives."""


_SOLVERS: dict[type, Solver] = {  # of quenched contacts
    Unaged: quenched,
    Flow: flow,
    Logarithmic: flow,
    Langevin: fokker_planck,
}


def solver(contacts: Reduced) -> Solver:
    """Which equation describes these contacts."""
    if contacts.newborn.active:
        return newborn
    return annealed if contacts.annealed else _SOLVERS[type(contacts.aging)]
