"""Runs whose numbers never change: the digests of tests/data/digests.json, on one thread, on two, and in processes.

A digest is that of the number of lives, which is exact, and of all columns rounded to single precision, 24 of 53 bits:
the last bits of a quantile's or an inverse hazard's table may differ between versions of SciPy. (Where thresholds age
these bits also decide which of equally good samples `steady` draws.) A change of streams or of the order of draws
changes every digest, and must be meant: `python tests/test_digests.py` writes them anew.
"""

import hashlib
import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from eqsim import Aging, Delay, Delta, Drive, Ensemble, Gamma, Table, Thermal, steady, trajectory

PATH = Path(__file__).parent / "data" / "digests.json"
WARM, STIFF = Thermal(kT=0.1), Thermal(kT=0.1, barrier="stiff")
UNIFORM, ANNEALED = {"stiffness_law": "uniform"}, {"disorder": "annealed"}
FRESH, STANDING = Drive(0.1, 7.0), Drive(0.1, 7.0, "stationary")
CASES = {
    "T = 0": (Ensemble(**UNIFORM), FRESH, 1),
    "T = 0, sqrt": (Ensemble(), FRESH, 1),
    "T = 0, delay": (Ensemble(delay=Delay(5.0)), FRESH, 1),
    "T = 0, n = 0": (Ensemble(Gamma(0.0)), FRESH, 1),
    "T = 0, n = 2.5": (Ensemble(Gamma(2.5, 0.3)), FRESH, 1),
    "delta": (Ensemble(Delta(1.5), WARM), FRESH, 1),
    "table": (Ensemble(Table([0.5, 1.0, 1.0, 2.0]), STIFF), FRESH, 1),
    "soft": (Ensemble(thermal=WARM, **UNIFORM), FRESH, 1),
    "soft, sqrt, exponential delay": (Ensemble(thermal=WARM, delay=Delay(5.0, "exponential")), FRESH, 1),
    "soft, stationary": (Ensemble(thermal=WARM, delay=Delay(5.0), eta=1.0), STANDING, 1),
    "soft, b = 5e8": (Ensemble(thermal=Thermal(kT=1e-9)), Drive(1e-9, 7.0), 1),
    "stiff": (Ensemble(thermal=STIFF), FRESH, 1),
    "stiff, replicas": (Ensemble(thermal=STIFF, delay=Delay(1.0)), FRESH, 3),
    "annealed": (Ensemble(thermal=WARM, **ANNEALED), FRESH, 1),
    "annealed, stiff, stationary": (Ensemble(thermal=STIFF, **UNIFORM, **ANNEALED), STANDING, 1),
    "annealed, aging": (Ensemble(thermal=WARM, aging=Aging("flow", 0.1, 2.0), **UNIFORM, **ANNEALED), FRESH, 1),
    "flow": (Ensemble(thermal=WARM, aging=Aging("flow", 0.1, 2.0)), FRESH, 1),
    "flow, stationary": (Ensemble(aging=Aging("flow", 0.1, 0.5), **UNIFORM), STANDING, 1),
    "langevin": (Ensemble(aging=Aging("langevin", 0.01, 2.0), **UNIFORM), FRESH, 1),
    "langevin, warm, sqrt": (Ensemble(thermal=WARM, aging=Aging("langevin", 0.01, 2.0)), FRESH, 1),
}


def digest(name, threads=1, executor=None):
    """Of 500 contacts, and of the steady averages of the same ensemble."""
    ensemble, drive, replicas = CASES[name]
    ensemble = Ensemble(**{**vars(ensemble), "count": 500})
    run = trajectory(ensemble, drive, points=29, seed=3, replicas=replicas, threads=threads, executor=executor)
    found = steady(ensemble, drive.velocity, rel_error=0.1, seed=3, threads=threads)
    content = hashlib.sha256(f"{run.lives} {found.lives}".encode())
    averages = [found.friction.value, found.pinned.value, found.break_stretch.value]
    for column in (*run.columns().values(), np.array(averages)):
        content.update(column.astype("<f4").tobytes())
    return content.hexdigest()[:32]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("threads", [1, 2])
def test_digest(name, threads):
    assert digest(name, threads) == json.loads(PATH.read_text())[name]


def test_in_processes():
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for name in ("soft, sqrt, exponential delay", "langevin"):
            assert digest(name, 2, pool) == json.loads(PATH.read_text())[name]


def test_digests_tell_runs_apart():
    assert len(set(json.loads(PATH.read_text()).values())) == len(CASES) == 20


if __name__ == "__main__":
    PATH.write_text(json.dumps({name: digest(name) for name in CASES}, indent=1) + "\n")
