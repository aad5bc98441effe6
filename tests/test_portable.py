"""Results that are the same on every machine: those of tests/data/results.json, on
threads, in processes, and on other processors.

Random numbers depend on declared parameters and the seed alone. On one machine results
are the same to the last bit; on two of different make, NumPy's exponentials, quantiles
and inverse hazards differ in their last bits, results by some 1e-12, and numbers of
lives not at all. Allowed are 1e-9, and 1e-6 where thresholds fluctuate, whose paths may
amplify rounding with every step; a single draw out of place makes 1e-5 at the least. A
change of streams, or of the order of draws, changes every result, and must be meant:
`python tests/test_portable.py` writes them anew, and `eqsim.results.RESULTS_VERSION` is
raised.
"""

import hashlib
import json
import math
import os
import platform
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from cases import chosen
from numpy._core import _multiarray_umath as built

from eqsim import (
    Aging,
    Delay,
    Delta,
    Drive,
    Ensemble,
    Gamma,
    Table,
    Thermal,
    load,
    steady,
    trajectory,
)
from eqsim.laws import threshold
from eqsim.laws.aging import flow, pooled
from eqsim.laws.barrier import soft
from eqsim.laws.barrier.pooled import pooled_hazard_of
from eqsim.laws.barrier.soft import erfi_inverse_table
from eqsim.laws.threshold import for_kernels
from eqsim.numerics.tables import octave_table
from eqsim.results import RESULTS_VERSION
from eqsim.sweeps.plan import Plan

PATH = Path(__file__).parent / "data" / "results.json"
WARM, STIFF = Thermal(kT=0.1), Thermal(kT=0.1, barrier="stiff")
UNIFORM, ANNEALED = {"stiffness_law": "uniform"}, {"disorder": "annealed"}
FRESH, STATIONARY = Drive(0.1, 7.0), Drive(0.1, 7.0, "stationary")
CASES = {
    "T = 0": (Ensemble(**UNIFORM), FRESH, 1),
    "T = 0, sqrt": (Ensemble(), FRESH, 1),
    "T = 0, delay": (Ensemble(delay=Delay(5.0)), FRESH, 1),
    "T = 0, n = 0": (Ensemble(Gamma(0.0)), FRESH, 1),
    "T = 0, n = 2.5": (Ensemble(Gamma(2.5, 0.3)), FRESH, 1),
    "delta": (Ensemble(Delta(1.5), WARM), FRESH, 1),
    "table": (Ensemble(Table([0.5, 1.0, 1.0, 2.0]), STIFF), FRESH, 1),
    "soft": (Ensemble(thermal=WARM, **UNIFORM), FRESH, 1),
    "soft, sqrt, exponential delay": (
        Ensemble(thermal=WARM, delay=Delay(5.0, "exponential")),
        FRESH,
        1,
    ),
    "soft, stationary": (
        Ensemble(thermal=WARM, delay=Delay(5.0), eta=1.0),
        STATIONARY,
        1,
    ),
    "soft, b = 5e8": (Ensemble(thermal=Thermal(kT=1e-9)), Drive(1e-9, 7.0), 1),
    "stiff": (Ensemble(thermal=STIFF), FRESH, 1),
    "stiff, replicas": (Ensemble(thermal=STIFF, delay=Delay(1.0)), FRESH, 3),
    "annealed": (Ensemble(thermal=WARM, **ANNEALED), FRESH, 1),
    "annealed, stiff, stationary": (
        Ensemble(thermal=STIFF, **UNIFORM, **ANNEALED),
        STATIONARY,
        1,
    ),
    "annealed, aging": (
        Ensemble(thermal=WARM, aging=Aging("flow", 0.1, 2.0), **UNIFORM, **ANNEALED),
        FRESH,
        1,
    ),
    "flow": (Ensemble(thermal=WARM, aging=Aging("flow", 0.1, 2.0)), FRESH, 1),
    "flow, stationary": (
        Ensemble(aging=Aging("flow", 0.1, 0.5), **UNIFORM),
        STATIONARY,
        1,
    ),
    "langevin": (Ensemble(aging=Aging("langevin", 0.01, 2.0), **UNIFORM), FRESH, 1),
    "langevin, warm, sqrt": (
        Ensemble(thermal=WARM, aging=Aging("langevin", 0.01, 2.0)),
        FRESH,
        1,
    ),
}
# Digests of the stored results of each `RESULTS_VERSION`. Results that change get a new
# version and a new line; where cases are added, and all others stay, the last line
# changes.
VERSIONS = {1: "632e38acfab6a2df"}
COLUMNS = ("force", "pinned", "force_stderr", "pinned_stderr", "force_replica_std")


def averages(name, threads=1, seed=3):
    """Steady averages: the number of lives, and values and errors."""
    ensemble, drive, _ = CASES[name]
    found = steady(ensemble, drive, rel_error=0.1, seed=seed, threads=threads)
    level = list(found.averages().values())[:3]
    return {
        "steady lives": found.lives,
        "steady": [x for e in level for x in (e.value, e.stderr)],
    }


def result(name, threads=1, seed=3):
    """Of 500 contacts, and the steady averages of the same ensemble: numbers of lives,
    and columns by name."""
    ensemble, drive, replicas = CASES[name]
    ensemble = Ensemble(**{**vars(ensemble), "count": 500})
    run = trajectory(
        ensemble, drive, points=29, seed=seed, replicas=replicas, threads=threads
    )
    half = list(run.averages.averages().values())[:3]
    columns = {
        name: run.columns()[name].tolist() for name in COLUMNS if name in run.columns()
    }
    columns |= {"second half": [x for e in half for x in (e.value, e.stderr)]}
    count = threads[1] if isinstance(threads, tuple) else threads
    return {"lives": run.lives, **columns, **averages(name, count, seed)}


def agree(name, found, stored):
    """Raise AssertionError unless lives are the same and all numbers agree."""
    for column in found:
        if column.endswith("lives"):
            assert found[column] == stored[column]
            continue
        exact = np.array(stored[column])
        relative = 1e-6 if name.startswith("langevin") else 1e-9
        # what is left of a difference of larger numbers, a variance that vanishes, is
        # rounding of these
        rounding = 1e-14 * np.abs(exact).max()
        np.testing.assert_allclose(
            found[column],
            exact,
            rtol=relative,
            atol=rounding,
            err_msg=f"{name}, {column}",
        )


def stored():
    return json.loads(PATH.read_text())


def digest(results):
    """SHA-256 of numbers and names, 16 digits, however a file is laid out."""
    return hashlib.sha256(json.dumps(results, sort_keys=True).encode()).hexdigest()[:16]


def test_results_have_a_version():
    """Stored results do not change unless the version does; a last bit of one number is
    a change."""
    results = stored()
    assert digest(results) == VERSIONS[RESULTS_VERSION]
    assert max(VERSIONS) == RESULTS_VERSION
    assert len({*VERSIONS.values()}) == len(VERSIONS)
    force = results["stiff"]["force"]
    force[3] = math.nextafter(force[3], math.inf)
    assert digest(results) != VERSIONS[RESULTS_VERSION]


@chosen(  # by default all but four, whose kernels no other test compiles
    "name",
    CASES,
    [
        name
        for name in CASES
        if name
        not in (
            "annealed, aging",
            "annealed, stiff, stationary",
            "flow, stationary",
            "langevin",
        )
    ],
)
def test_results(name):
    """As stored, and on two threads the same bits."""
    found = result(name)
    assert found.keys() == stored()[name].keys()
    agree(name, found, stored()[name])
    assert result(name, threads=2) == found


def test_in_processes():
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for name in ("soft, sqrt, exponential delay", "langevin, warm, sqrt"):
            assert result(name, (pool, 2)) == result(name)


@pytest.mark.parametrize("name", ["T = 0", "soft, stationary", "langevin, warm, sqrt"])
def test_other_draws_are_told_apart(name):
    """Negative control: with another seed no column agrees, but for what is exact."""
    found, exact = result(name, seed=4), stored()[name]
    for column in ("force", "force_stderr", "second half", "steady"):
        with pytest.raises(AssertionError):
            agree(name, {**exact, column: found[column]}, exact)


@chosen(
    "name",
    ["T = 0, n = 2.5", "soft, stationary", "annealed", "flow"],
    ["T = 0, n = 2.5", "soft, stationary", "annealed"],
)
def test_last_bits_of_tables_change_no_draw(name, monkeypatch):
    """All tables an ulp larger, as another processor may find them: the same lives,
    results within rounding."""

    def larger(first, y, slope):
        table = octave_table(first, y, slope)
        table[1:] = np.nextafter(table[1:], math.inf)
        return table

    remembered = for_kernels, pooled_hazard_of, erfi_inverse_table
    exact = result(name)
    for module in (flow, pooled, soft, threshold):
        monkeypatch.setattr(module, "octave_table", larger)
    for function in remembered:
        function.cache_clear()
    found = result(name)
    for function in remembered:
        function.cache_clear()
    assert found != exact
    agree(name, found, stored()[name])


FEATURES = [name for name in built.__cpu_dispatch__ if built.__cpu_features__[name]]
PLAIN = {"NPY_DISABLE_CPU_FEATURES": " ".join(FEATURES), "OPENBLAS_CORETYPE": "Nehalem"}
# other exponentials, too
PLAIN |= {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-FMA,-FMA4"}
X86 = platform.machine() in ("x86_64", "AMD64")
OLD = PLAIN | {
    "NUMBA_CPU_NAME": "x86-64-v2" if X86 else "generic",
    "NUMBA_CPU_FEATURES": "",
}
AVX2 = {
    "OPENBLAS_CORETYPE": "Haswell",
    "NUMBA_CPU_NAME": "x86-64-v3",
    "NUMBA_CPU_FEATURES": "",
}
AVX2 |= {
    "NPY_DISABLE_CPU_FEATURES": " ".join(
        name for name in FEATURES if "512" in name or name == "X86_V4"
    )
}
PROCESSORS = {"plain": PLAIN, "old": OLD, "AVX2": AVX2}
# Of each law one. Compiled for old processors a life takes ten times as long, as they
# have no fused multiply-add.
SOME = [
    "T = 0, sqrt",
    "T = 0, n = 2.5",
    "delta",
    "table",
    "soft, sqrt, exponential delay",
    "stiff",
    "annealed",
    "flow",
]


def identities():
    """Of the points of the committed sweep: a sweep begun on one machine continues on
    another."""
    path = Path(__file__).parent.parent / "runs" / "sweep.toml"
    return Plan(load(path)).ids


def elsewhere(processor, what, names):
    """Identities and results of a process that takes its processor for another one."""
    command = [sys.executable, __file__, what, *names]
    done = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | PROCESSORS[processor]
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.long
@pytest.mark.parametrize(
    ("processor", "what", "names"),
    [
        ("plain", "result", [*SOME, "langevin, warm, sqrt", "soft, stationary"]),
        pytest.param("plain", "result", [*CASES], marks=pytest.mark.long),
        ("old", "averages", ["T = 0, sqrt", "annealed"]),
        pytest.param("old", "result", [*CASES], marks=pytest.mark.long),
        pytest.param(
            "AVX2",
            "result",
            [*CASES],
            marks=[pytest.mark.long, pytest.mark.skipif(not X86, reason="x86")],
        ),
    ],
)
def test_other_processors(processor, what, names):
    """NumPy, the mathematical library, BLAS and the compiler, without what newer
    processors have."""
    points, found = elsewhere(processor, what, names)
    assert points == identities()
    assert list(found) == names
    for name in names:
        agree(name, found[name], stored()[name])


if __name__ == "__main__":
    if sys.argv[1:]:
        found = {"result": result, "averages": averages}[sys.argv[1]]
        print(json.dumps([identities(), {name: found(name) for name in sys.argv[2:]}]))
    else:
        rows = [f"{json.dumps(name)}: {json.dumps(result(name))}" for name in CASES]
        PATH.write_text("{\n" + ",\n".join(rows) + "\n}\n")
        print(
            f"{digest(stored())}: raise RESULTS_VERSION, and enter this digest in VERSIONS"
        )
