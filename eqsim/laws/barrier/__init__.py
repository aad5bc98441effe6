"""Thermally activated breaking of a pinned contact: one file for each barrier. This is
where they are listed."""

from eqsim.laws.barrier.base import Barrier
from eqsim.laws.barrier.bell import Bell
from eqsim.laws.barrier.catch_slip import CatchSlip
from eqsim.laws.barrier.cusp import Cusp
from eqsim.laws.barrier.mechanical import Mechanical
from eqsim.laws.barrier.soft import Soft
from eqsim.laws.barrier.stiff import Stiff

BARRIERS: dict[str, type[Barrier]] = {
    "soft": Soft,
    "stiff": Stiff,
    "cusp": Cusp,
    "bell": Bell,
    "catch-slip": CatchSlip,
}

__all__ = ["BARRIERS", "Barrier", "Mechanical"]
