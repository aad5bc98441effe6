"""Dimensionless numbers for the solvers of the master equation, without an ensemble and
a velocity."""

from eqsim.laws.aging import Flow, Langevin, Unaged
from eqsim.laws.barrier import BARRIERS, Mechanical
from eqsim.laws.delay import Fixed
from eqsim.model.reduced import Reduced


def barrier_of(name, b=1.0, log_w=0.0):
    """A barrier by its name, None for none."""
    return BARRIERS[name](b, log_w) if name else Mechanical()


def contacts(
    law,
    stiffness,
    barrier=None,
    b=1.0,
    log_w=0.0,
    final=None,
    alpha=0.0,
    fluctuates=False,
):
    """Contacts without delay whose thresholds, given `final` = x_*f/x_*i, flow or
    fluctuate."""
    aging = Unaged()
    if final is not None:
        aging = (
            Langevin(final**2, alpha, law.n) if fluctuates else Flow(final**2, alpha)
        )
    return Reduced(
        law, stiffness, False, barrier_of(barrier, b, log_w), aging, Fixed(0.0), 0.0
    )
