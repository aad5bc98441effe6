"""Exact steady values at 90 parameter points of both ensembles, and the ensembles they
belong to."""

from pathlib import Path

import pandas as pd

from eqsim import Aging, Delay, Ensemble, Gamma, Thermal

BASIC = ("friction", "pinned", "break_stretch")  # observables of the article
REFERENCE = pd.read_csv(Path(__file__).parent / "data" / "steady_reference.csv")


def basic(averages):
    """Names and estimates of these."""
    return [(name, getattr(averages, name)) for name in BASIC]


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
