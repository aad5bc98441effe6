"""Jobs without rivals: fluctuating thresholds, reference solves, fits, memory, and
start-up."""

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from analysis import coverage
from analysis.benchmarks.cases import CASES, VELOCITY, Case, Sizes
from analysis.benchmarks.driven import STAGE, ten_segments
from analysis.benchmarks.jobs import Outcome, calls, interleaved, plain, ratios, speed
from eqsim import (
    Aging,
    Drive,
    Ensemble,
    Gamma,
    Programme,
    Segment,
    Thermal,
    curve,
    fit,
    reference,
    trajectory,
    transient,
)
from eqsim.fitting.model import SteadyForward
from eqsim.fitting.record import RecordForward, search_record
from eqsim.master.steady import lives_of

ROOT = Path(__file__).parents[2]
NOTHING = Outcome(0.0, 0.0)  # a job that is not about friction


def time_langevin(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """Lives along fluctuating thresholds at v = k = omega = 1, x_*: 0.1 -> 1 with D_v =
    D/(v x_*f) = 0.1."""
    rows = []
    for kT in (0.0, 0.1):
        for law in ("uniform", "sqrt"):
            thermal, aging = (
                Thermal(kT=kT),
                Aging("langevin", rate=0.1, x_star_final=1.0),
            )
            ensemble = Ensemble(
                Gamma(1.0, 0.1), thermal, aging=aging, stiffness_law=law
            )

            def run(
                seed: int, threads: int = 1, ensemble: Ensemble = ensemble
            ) -> Outcome:
                # the fewest lives there are, 65 536
                return plain(ensemble, 1.0, 1.0, seed, threads)

            run(seed)  # compiles
            contenders = {
                "eqsim": run,
                "eqsim, threads": lambda seed, run=run: run(seed, threads),
            }
            rounds = interleaved(contenders, sizes.repeats, seed)
            case = f"{f'soft kT={kT:g}' if kT else 'T=0'}, {law} k"
            gain = ratios("threads", rounds, "eqsim, threads", "eqsim")
            rows.append(
                {"job": "langevin lives, D_v = 0.1", "case": case}
                | speed(rounds, "eqsim", "")
                | gain
            )
    return rows


def time_references(sizes: Sizes) -> list[dict[str, Any]]:
    """Stationary averages and transients from the master equation. Kernels and tables
    are cached, solutions are not: each round has its own velocity."""
    chosen = [case for case in CASES if not case.general] + [Case(0.1, "soft", True)]
    rows = []
    for disorder in ("quenched", "annealed"):
        for case in chosen:
            ensemble = replace(case.ensemble(1), disorder=disorder)

            def averages(number: int, ensemble: Ensemble = ensemble) -> Outcome:
                reference(ensemble, Drive(VELOCITY * (1 + 1e-3 * number)))
                return NOTHING

            def force(number: int, ensemble: Ensemble = ensemble) -> Outcome:
                transient(
                    ensemble,
                    Drive(VELOCITY * (1 + 1e-3 * number), sizes.distance),
                    sizes.points,
                )
                return NOTHING

            averages(0), force(0)
            rounds = interleaved(
                {"stationary": averages, "transient": force}, sizes.repeats, 1
            )
            rows += [
                {"job": f"reference, {job}, {disorder}", "case": case.name}
                | speed(rounds, job, "")
                for job in ("stationary", "transient")
            ]
    return sorted(rows, key=lambda row: row["job"])


def time_curves(sizes: Sizes) -> list[dict[str, Any]]:
    """Twelve velocities at once, as fits solve them, and one after the other; each
    round has its own."""
    warm = Case(0.1, "soft", False).ensemble(1)
    aging = Aging("flow", rate=0.1, x_star_final=1.0)
    chosen = {
        "quenched": warm,
        "annealed": replace(warm, disorder="annealed"),
        "annealed, aging": replace(
            warm, disorder="annealed", thresholds=Gamma(1.0, 0.1), aging=aging
        ),
    }
    rows = []
    for case, ensemble in chosen.items():

        def together(number: int, ensemble: Ensemble = ensemble) -> Outcome:
            curve(ensemble, (1 + 1e-3 * number) * np.logspace(-3, 1, 12))
            return NOTHING

        def singly(number: int, ensemble: Ensemble = ensemble) -> Outcome:
            for v in (1 + 1e-3 * number) * np.logspace(-3, 1, 12):
                reference(ensemble, Drive(float(v)))
            return NOTHING

        together(0), singly(0)
        rounds = interleaved(
            {"eqsim": together, "singly": singly}, sizes.plain_repeats, 1
        )
        row = speed(rounds, "eqsim", "") | ratios("singly", rounds, "singly", "eqsim")
        rows.append({"job": "twelve velocities at once", "case": case} | row)
    return rows


def time_fits(sizes: Sizes) -> list[dict[str, Any]]:
    """A whole fit, profiles and all, of 27 averages at two temperatures; and least
    squares of a record of 81 points (a velocity step at T = 0 through a spring,
    `analysis.coverage`), from a start away from the truth. A solve gives all measured
    values at one set of parameters; caches are cleared between rounds."""
    exact = coverage.record()
    record = coverage.sample(exact, np.random.default_rng(1))
    start = exact.low + 0.4 * (exact.high - exact.low)

    def whole(_: int = 0) -> Outcome:
        lives_of.cache_clear()
        fit(ROOT / "runs/fit-synthetic.toml", starts=1)
        return NOTHING

    def of_record(_: int = 0) -> Outcome:
        search_record(record, start)
        return NOTHING

    rows = []
    for case, forward, run in (
        ("27 averages, one start", SteadyForward, whole),
        ("a record, least squares", RecordForward, of_record),
    ):
        solves = calls(forward, "predict", run)
        row = speed(interleaved({"eqsim": run}, sizes.fits, 1), "eqsim", "")
        solved = {"solves": solves, "ms_per_solve": 1e3 * row["seconds"] / solves}
        rows.append({"job": "fits", "case": case} | row | solved)
    return rows


DRIVES: dict[str, Drive | Programme] = {
    "constant drive": Drive(10 * VELOCITY, 0.5),
    "programme": ten_segments(0.5),
    "spring": Programme((Segment(10 * VELOCITY, distance=0.02),), stage=STAGE),
}


def peak(name: str, contacts: int) -> int:
    """Peak memory of this process in bytes after a run of warm soft contacts with a
    delay."""
    trajectory(Case(0.1, "soft", True).ensemble(contacts), DRIVES[name], points=21)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )


def measure_memory(sizes: Sizes) -> list[dict[str, Any]]:
    """Bytes per contact, from the peak memory of many contacts less that of a thousand,
    in a process each. These are forked by a server: started by this one, they would
    report its peak."""
    rows = []
    for name in DRIVES:
        peak(name, 2048)  # compiles, which takes memory
        peaks = []
        for contacts in (1000, sizes.many):
            with ProcessPoolExecutor(1, get_context("forkserver")) as pool:
                peaks.append(pool.submit(peak, name, contacts).result())
        rows.append(
            {
                "job": "memory",
                "case": name,
                "bytes": (peaks[1] - peaks[0]) / (sizes.many - 1000),
            }
        )
    return rows


def time_start(sizes: Sizes) -> list[dict[str, Any]]:
    """`eqsim` as a process of its own: the help page, and the quickstart with and
    without compiled kernels."""
    with tempfile.TemporaryDirectory() as folder:

        def eqsim(*arguments: str, cache: str) -> Outcome:
            command = [sys.executable, "-m", "eqsim", *arguments]
            path = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
            environment = os.environ | {
                "NUMBA_CACHE_DIR": f"{folder}/{cache}",
                "PYTHONPATH": path,
            }
            subprocess.run(
                command, cwd=ROOT, env=environment, check=True, capture_output=True
            )
            return NOTHING

        def quickstart(cache: str) -> Outcome:
            return eqsim(
                "run",
                "runs/quickstart.toml",
                "--quiet",
                "--out",
                f"{folder}/out",
                cache=cache,
            )

        starts: dict[str, tuple[Callable[[int], Outcome], int]] = {
            "eqsim --help": (lambda _: eqsim("--help", cache="0"), sizes.repeats),
            "quickstart, cold": (
                lambda number: quickstart(str(number)),
                sizes.cold_starts,
            ),
            "quickstart, warm": (
                lambda _: quickstart("0"),
                sizes.repeats if sizes.cold_starts else 0,
            ),
        }
        rows = []
        for case, (start, repeats) in starts.items():
            if repeats:
                rounds = interleaved({case: start}, repeats, 0)
                rows.append({"job": "start-up", "case": case} | speed(rounds, case, ""))
    return rows
