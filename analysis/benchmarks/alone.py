"""Jobs without rivals: fluctuating thresholds, programmes, reference solves, and how long the program takes to
start."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from analysis.benchmarks.cases import CASES, VELOCITY, Case, Sizes
from analysis.benchmarks.jobs import Outcome, interleaved, plain, ratios, speed
from eqsim import Aging, Drive, Ensemble, Gamma, Programme, Segment, Thermal, reference, trajectory, transient

ROOT = Path(__file__).parents[2]
NOTHING = Outcome(0.0, 0.0)  # a job that is not about friction


def time_langevin(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """Lives along fluctuating thresholds at v = k = omega = 1, x_*: 0.1 -> 1 with D_v = D/(v x_*f) = 0.1."""
    rows = []
    for kT in (0.0, 0.1):
        for law in ("uniform", "sqrt"):
            thermal, aging = Thermal(kT=kT), Aging("langevin", rate=0.1, x_star_final=1.0)
            ensemble = Ensemble(Gamma(1.0, 0.1), thermal, aging=aging, stiffness_law=law)

            def run(seed: int, threads: int = 1, ensemble: Ensemble = ensemble) -> Outcome:
                return plain(ensemble, 1.0, 1.0, seed, threads)  # the fewest lives there are, 65 536

            run(seed)  # compiles
            contenders = {"eqsim": run, "eqsim, threads": lambda seed, run=run: run(seed, threads)}
            rounds = interleaved(contenders, sizes.repeats, seed)
            case = f"{f'soft kT={kT:g}' if kT else 'T=0'}, {law} k"
            gain = ratios("threads", rounds, "eqsim, threads", "eqsim")
            rows.append({"job": "langevin lives, D_v = 0.1", "case": case} | speed(rounds, "eqsim", "") | gain)
    return rows


def time_programmes(sizes: Sizes, threads: int, seed: int) -> list[dict[str, Any]]:
    """A programme of ten segments: steps, two holds, two reversals, as far in all as the constant drive it is compared
    with, per life."""
    pace, part = 10 * VELOCITY, 0.125 * sizes.distance
    velocities = (pace, 0.0, 10 * pace, -pace, pace, 0.0, 10 * pace, -pace, pace, 0.1 * pace)
    segments = [Segment(v, distance=part) if v else Segment(0.0, time=10.0 / VELOCITY) for v in velocities]
    rows = []
    for case in (case for case in CASES if case.kT):
        ensemble = case.ensemble(sizes.contacts)

        def run(seed: int, drive: Drive | Programme, threads: int = 1, ensemble: Ensemble = ensemble) -> Outcome:
            found = trajectory(ensemble, drive, points=sizes.points, seed=seed, threads=threads)
            return Outcome(0.0, 0.0, found.lives)

        programme, constant = Programme(tuple(segments)), Drive(pace, sizes.distance)
        contenders = {
            "eqsim": lambda seed, run=run, drive=programme: run(seed, drive),
            "eqsim, threads": lambda seed, run=run, drive=programme: run(seed, drive, threads),
            "constant": lambda seed, run=run, drive=constant: run(seed, drive),
        }
        for contender in contenders.values():
            contender(seed)  # compiles
        rounds = interleaved(contenders, sizes.repeats, seed)
        cost = {name: [(seconds / found.lives, found) for seconds, found in of] for name, of in rounds.items()}
        row = speed(rounds, "eqsim", "") | ratios("threads", rounds, "eqsim, threads", "eqsim")
        rows.append(
            {"job": "programme of ten segments", "case": case.name} | row | ratios("P", cost, "eqsim", "constant")
        )
    return rows


def time_references(sizes: Sizes) -> list[dict[str, Any]]:
    """Stationary averages and transients from the master equation; kernels and tables are warm, answers are not:
    each round has its own velocity."""
    chosen = [case for case in CASES if not case.general] + [Case(0.1, "soft", True)]
    rows = []
    for disorder in ("quenched", "annealed"):
        for case in chosen:
            ensemble = replace(case.ensemble(1), disorder=disorder)

            def averages(number: int, ensemble: Ensemble = ensemble) -> Outcome:
                reference(ensemble, Drive(VELOCITY * (1 + 1e-3 * number)))
                return NOTHING

            def force(number: int, ensemble: Ensemble = ensemble) -> Outcome:
                transient(ensemble, Drive(VELOCITY * (1 + 1e-3 * number), sizes.distance), sizes.points)
                return NOTHING

            averages(0), force(0)
            rounds = interleaved({"stationary": averages, "transient": force}, sizes.repeats, 1)
            rows += [
                {"job": f"reference, {job}, {disorder}", "case": case.name} | speed(rounds, job, "")
                for job in ("stationary", "transient")
            ]
    return sorted(rows, key=lambda row: row["job"])


def time_start(sizes: Sizes) -> list[dict[str, Any]]:
    """`eqsim` as a process of its own: the help page, and the quickstart with and without compiled kernels."""
    with tempfile.TemporaryDirectory() as folder:

        def eqsim(*arguments: str, cache: str) -> Outcome:
            command = [sys.executable, "-m", "eqsim", *arguments]
            path = os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", "")))
            environment = os.environ | {"NUMBA_CACHE_DIR": f"{folder}/{cache}", "PYTHONPATH": path}
            subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True)
            return NOTHING

        def quickstart(cache: str) -> Outcome:
            return eqsim("run", "runs/quickstart.toml", "--quiet", "--out", f"{folder}/out", cache=cache)

        starts: dict[str, tuple[Callable[[int], Outcome], int]] = {
            "eqsim --help": (lambda _: eqsim("--help", cache="0"), sizes.repeats),
            "quickstart, cold": (lambda number: quickstart(str(number)), sizes.cold_starts),
            "quickstart, warm": (lambda _: quickstart("0"), sizes.repeats if sizes.cold_starts else 0),
        }
        rows = []
        for case, (start, repeats) in starts.items():
            if repeats:
                rounds = interleaved({case: start}, repeats, 0)
                rows.append({"job": "start-up", "case": case} | speed(rounds, case, ""))
    return rows
