"""eqsim: the stochastic earthquake model of multi-contact friction, exact in time, with honest error bars."""

from importlib import import_module
from typing import Any

_HOMES = {
    "Ensemble": "eqsim.model.ensemble",
    "Drive": "eqsim.model.drive",
    "Gamma": "eqsim.laws.threshold",
    "Delta": "eqsim.laws.threshold",
    "Table": "eqsim.laws.threshold",
    "Distribution": "eqsim.laws.threshold",
    "Thermal": "eqsim.laws.thermal",
    "Delay": "eqsim.laws.delay",
    "Aging": "eqsim.laws.aging",
    "Estimate": "eqsim.estimate",
    "Steady": "eqsim.engine.steady",
    "steady": "eqsim.engine.steady",
    "Reference": "eqsim.master.steady",
    "reference": "eqsim.master.steady",
    "validate": "eqsim.validation.suite",
    "Trajectory": "eqsim.engine.trajectory",
    "trajectory": "eqsim.engine.trajectory",
    "InputError": "eqsim.errors",
    "load": "eqsim.io.runfile",
}
__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the command line answers --help without numba."""
    if name not in _HOMES:
        raise AttributeError(f"module 'eqsim' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
