"""Results of contacts of several kinds from those of each kind (derived).

Contacts of a slider that moves as it is told do not act on each other. With s_p = N_p/N
the share of kind p and w_p = s_p k_p/k its share of the mean stiffness k = sum s_p k_p,

    F/(N k) = sum w_p F_p/(N_p k_p),    pinned = sum s_p pinned_p,
    N Var(F/(N k)) = sum (w_p^2/s_p) N_p Var(F_p/(N_p k_p)).

Travel and stretches are means over breaks. Kind p has a share q_p of these that is in
proportion to s_p r_p, with r_p = 1/(E[l]_p + v<tau>_p) its breaks per displacement, so
that a longer travel of a kind also lowers its share.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eqsim.estimate import OBSERVABLES, Averages, Estimate, infinite
from eqsim.model.ensemble import Kind
from eqsim.numerics.tables import Array


def summed(
    kinds: Sequence[Kind], results: Sequence[Any], by: Mapping[str, str], power: int = 1
) -> dict[str, Any]:
    """Sum columns of results over kinds, each column times the field of `Kind` that `by`
    names for it, to a `power`; None where a kind has no such column."""
    found: dict[str, Any] = {}
    for name, factor in by.items():
        factors = [getattr(kind, factor) ** power for kind in kinds]
        columns = [getattr(result, name) for result in results]
        pairs = zip(factors, columns, strict=True)
        known = all(column is not None for column in columns)
        found[name] = sum(x * column**power for x, column in pairs) if known else None
    return found


def mixed_averages(
    kinds: Sequence[Kind],
    found: Sequence[Averages],
    velocity: float,
    bounds: bool = False,
) -> dict[str, Estimate]:
    """Average over all contacts at a velocity. Errors of kinds are independent, or if
    they are `bounds` they add up; degrees of freedom are those of Welch and
    Satterthwaite."""
    share, weight = np.array([(kind.share, kind.weight) for kind in kinds]).T
    laws = [(kind.contacts.delay, kind.contacts.thresholds.scale) for kind in kinds]
    wait = [delay.reduced(velocity, unit).mean * unit for delay, unit in laws]

    def column(name: str, of: str) -> Array:
        # None becomes NaN
        return np.array([getattr(getattr(x, name), of) for x in found], float)

    def estimate(name: str, value: float, errors: Array) -> Estimate:
        every = [getattr(averages, name) for averages in found]
        lives, reliable = sum(x.n for x in every), all(x.reliable for x in every)
        if any(x.diverges for x in every):
            return infinite(lives)
        stderr = float(np.sum(errors) if bounds else np.sqrt(np.sum(errors**2)))
        dofs = column(name, "dof")
        spread = float(np.nansum(errors**4 / dofs))
        dof = math.floor(stderr**4 / spread) if spread > 0.0 else None
        none = None if math.isnan(stderr) else stderr
        return Estimate(
            None if math.isnan(value) else value, none, lives, dof, reliable
        )

    mixed = {}
    linear = {"friction": weight, "pinned": share, "force_variance": weight**2 / share}
    for name, factor in linear.items():
        value, error = column(name, "value"), column(name, "stderr")
        mixed[name] = estimate(name, float(factor @ value), factor * error)
    rate = 1.0 / (column("travel", "value") + wait)
    of_breaks = share * rate / float(share @ rate)
    of_travel, of_birth = column("travel", "stderr"), column("birth_stretch", "stderr")
    for name in ("break_stretch", "travel", "birth_stretch"):
        value = column(name, "value")
        mean = float(of_breaks @ value)
        slope = float(name != "birth_stretch") - rate * (value - mean)
        errors = np.abs(slope) * of_travel + float(name != "travel") * of_birth
        mixed[name] = estimate(name, mean, of_breaks * errors)
    return {name: mixed[name] for name in OBSERVABLES}
