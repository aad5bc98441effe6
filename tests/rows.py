"""Exact steady values at 90 parameter points of both ensembles, and the ensembles they belong to."""

from pathlib import Path

import pandas as pd

from eqsim import Aging, Delay, Ensemble, Gamma, Thermal

REFERENCE = pd.read_csv(Path(__file__).parent / "data" / "steady_reference.csv")


def ensemble_of(row, **changes):
    """The ensemble of a row, with some of its parts changed."""
    given = {
        "thresholds": Gamma(row.n, row.x_star),
        "thermal": Thermal(row.kT, row.attempt_frequency, row.barrier),
        "delay": Delay(row.delay),
        "aging": Aging(row.rule, row.rate, row.x_star_final),
        "stiffness": row.stiffness,
        "stiffness_law": row.stiffness_law,
        "disorder": row.disorder,
    }
    return Ensemble(**(given | changes))


def aging(rule):
    """The rows of quenched contacts that age by a rule."""
    return REFERENCE[(REFERENCE.rule == rule) & (REFERENCE.disorder == "quenched")]
