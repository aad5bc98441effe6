"""The suite of interfaces, and what must fail it: one thing wrong in what chains are
compared with, or in the contacts."""

import numpy as np
import pytest

from eqsim import validate
from eqsim.validation import chains
from eqsim.validation.points import SUITES, Suite

CREEP = {"chain creep", "chain force", "chain energy"}


def failed(monkeypatch, part=(1, 4), **how):
    """Kinds that fail of two points in eight, by default chains in creep."""
    monkeypatch.setitem(SUITES, "few", Suite(0, 0, chains=8))
    found = validate("few", part=part, **how)
    assert {score.kind for score in found.scores} == (
        {"front"} if part[0] == 3 else CREEP
    )
    return {verdict.kind for verdict in found.verdicts if not verdict.passed}


def test_chains_in_creep(monkeypatch):
    assert failed(monkeypatch) == set()


def as_if(monkeypatch, change):
    """The reference of another motion."""
    right = chains.creep_of

    def creep_of(chain):
        creep = right(chain)
        return creep._replace(**change(creep.laplacian))

    monkeypatch.setattr(chains, "creep_of", creep_of)


def repelling(laplacian):
    """Springs between neighbours that push."""
    return {"laplacian": -laplacian}


def without_a_neighbour(laplacian):
    """The first block lacks its spring."""
    first = np.zeros_like(laplacian)
    first[:2, :2] = [[1.0, -1.0], [-1.0, 1.0]]
    return {"laplacian": laplacian - first}


def without_losses(laplacian):
    """Breaks take no energy."""
    return {"counted": 0.0}


@pytest.mark.parametrize(
    ("wrong", "kinds"),
    [
        (repelling, CREEP),
        (without_a_neighbour, {"chain creep", "chain energy"}),
        (without_losses, {"chain energy"}),
    ],
)
def test_creep_of_another_chain(wrong, kinds, monkeypatch):
    as_if(monkeypatch, wrong)
    assert failed(monkeypatch) >= kinds


@pytest.mark.verification
def test_fronts(monkeypatch):
    """Fronts pass, and fail where they are 15 % slower than they should be, as they are
    without a mass if what steps miss is not given back in time."""
    assert failed(monkeypatch, (3, 4)) == set()
    exact = chains.front_prestress
    monkeypatch.setattr(
        chains,
        "front_prestress",
        lambda speed, K, **links: exact(speed / 0.85, K, **links),
    )
    assert failed(monkeypatch, (3, 4)) == {"front"}
