"""Results of contacts of several kinds from those of each kind (derived).

Contacts of a slider that moves as it is told do not act on each other. With s_p = N_p/N
the share of kind p and w_p = s_p k_p/k its share of the mean stiffness k = sum s_p k_p,

    F/(N k) = sum w_p F_p/(N_p k_p),    pinned = sum s_p pinned_p,
    N Var(F/(N k)) = sum (w_p^2/s_p) N_p Var(F_p/(N_p k_p)).

Travel and stretches are means over breaks, of which kind p makes a share q_p ~ s_p r_p,
with r_p = 1/(E[l]_p + v<tau>_p) its breaks per displacement. A longer travel of a kind
lowers this share.
"""

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from eqsim.estimate import OBSERVABLES, Averages, Estimate, infinite
from eqsim.model.ensemble import Kind
from eqsim.numerics.tables import Array

# The field of `Kind` by which a field of results is multiplied before it is summed.
_FACTORS = {
    **dict.fromkeys(("force", "force_error", "force_replicas"), "weight"),
    **dict.fromkeys(("force_stderr", "force_replica_std"), "weight"),
    **dict.fromkeys(("pinned", "pinned_error", "pinned_stderr", "breaks"), "share"),
    **dict.fromkeys(("force_variance", "force_variance_error"), "square"),
    **dict.fromkeys(("covariance", "error"), "square"),
}
_IN_QUADRATURE = ("force_stderr", "force_replica_std", "pinned_stderr")


def summed(kinds: Sequence[Any], results: Sequence[Any], **changes: Any) -> Any:
    """Sum results over kinds, `Kind` or what has its factors, which may be arrays
    (points,), with `changes` of other fields. Standard errors, which are
    of independent contacts, add up in quadrature, and bounds of errors as they are."""
    for name in [field.name for field in fields(results[0])]:
        columns = [getattr(result, name) for result in results]
        if name in ("lives", "engine_seconds"):
            changes[name] = sum(columns)
        elif name in ("force_reliable", "reached"):
            changes[name] = all(columns)
        elif name in _FACTORS and name not in changes:
            if any(column is None for column in columns):
                changes[name] = None
                continue
            factors = [getattr(kind, _FACTORS[name]) for kind in kinds]
            pairs = zip(factors, columns, strict=True)
            if name in _IN_QUADRATURE:
                changes[name] = np.sqrt(sum((x * column) ** 2 for x, column in pairs))
            else:
                changes[name] = sum(x * column for x, column in pairs)
    return replace(results[0], **changes)


def mixed_averages(
    kinds: Sequence[Kind],
    found: Sequence[Averages],
    velocity: float,
    bounds: bool = False,
) -> dict[str, Estimate]:
    """Average over all contacts at a velocity. Errors are standard errors, with the
    degrees of freedom of Welch and Satterthwaite, or `bounds`, which add up."""
    share = np.array([kind.share for kind in kinds])
    waits = [velocity * kind.contacts.delay_time(velocity) for kind in kinds]

    def column(name: str, of: str = "value") -> Array:
        # None becomes NaN
        return np.array([getattr(getattr(each, name), of) for each in found], float)

    rate = 1.0 / (column("travel") + waits)
    with np.errstate(invalid="ignore"):  # no breaks where none forms again
        of_breaks = share * rate / np.sum(share * rate)
    factors = {"friction": "weight", "pinned": "share", "force_variance": "square"}
    mixed = {}
    for name in OBSERVABLES:
        value, error = column(name), column(name, "stderr")
        if name in factors:
            factor = np.array([getattr(kind, factors[name]) for kind in kinds])
            mean, errors = float(factor @ value), factor * error
        else:
            mean = float(of_breaks @ value)
            travels, born = name != "birth_stretch", name != "travel"
            slope = np.abs(travels - rate * (value - mean))
            errors = slope * column("travel", "stderr")
            errors += born * column("birth_stretch", "stderr")
            errors *= of_breaks
        every = [getattr(each, name) for each in found]
        stderr = float(np.sum(errors) if bounds else np.sqrt(errors @ errors))
        spread = float(np.nansum(errors**4 / column(name, "dof")))
        known = math.isfinite(stderr)
        mixed[name] = Estimate(
            None if math.isnan(mean) else mean,
            stderr if known else None,
            sum(each.n for each in every),
            math.floor(stderr**4 / spread) if known and spread > 0.0 else None,
            all(each.reliable for each in every),
        )
        if any(each.diverges for each in every):
            mixed[name] = infinite(mixed[name].n)
    return mixed
