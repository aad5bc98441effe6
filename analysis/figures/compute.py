"""The figures of Braun and Peyrard (2011), recomputed, with particles on them.

Each figure has a module, named in lower case, with `curves()`, the curves to compute;
`formulas(table)`, the rows of approximations and fits; and `plot(table)`. Every
velocity of every curve comes from the master equation of its model, every marker from
an estimate by particles (`eqsim.steady`). `python -m analysis.figures` makes them.
"""

import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, as_completed
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import pandas as pd
from scipy import stats

from eqsim import Drive, Estimate, reference, steady, z_score
from eqsim.errors import require_choice
from eqsim.io import storage
from eqsim.paper import FIGURES
from eqsim.plots import style
from eqsim.sweeps.workers import Workers

from .common import STYLE, Curve

NAMES = ("A01", "A01num", "A02", "A02ab", "A03", "A04", "A05")


class Made(NamedTuple):
    """A figure that was written: how many curves, how many particle estimates, their
    largest |z| and chi-square p."""

    name: str
    curves: int
    particles: int
    largest: float
    p: float


class _Job(NamedTuple):
    particles: bool
    ensemble: Any
    velocity: float


def check(names: list[str]) -> list[str]:
    """The names in the order of the source text, all if none is given; numbers of the
    published figures are names, too. Raises InputError."""
    names = [
        next((label for label in NAMES if name == str(FIGURES[label])), name)
        for name in names
    ]
    for name in names:
        require_choice("figure", name, NAMES)
    return [name for name in NAMES if name in (names or NAMES)]


def make(
    names: list[str],
    out: Path,
    *,
    quick: bool = False,
    executor: Executor,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[Made]:
    """Compute the named figures on the `executor`, each point once, and write NAME.pdf,
    NAME.png and NAME.parquet to `out` as soon as all points of a figure are there.
    `quick`: few points. Raises InputError."""
    for name, table in tabulate(
        names, quick=quick, executor=executor, progress=progress
    ):
        with matplotlib.rc_context(STYLE):
            figure = _module(name).plot(table)
            files = style.pictures(name, figure, ("pdf", "png"))
        origin = storage.provenance("figures", {"figure": name, "quick": quick}, "", 1)
        storage.publish(
            out, {**files, f"{name}.parquet": storage.parquet(table, origin)}
        )
        z = table.z.dropna()
        p = float(stats.chi2.sf((z**2).sum(), len(z)))
        yield Made(name, table.curve.nunique(), len(z), float(z.abs().max()), p)


def tabulate(
    names: list[str],
    *,
    quick: bool = False,
    executor: Executor,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the table of each named figure once it is finished: curves, particles and
    formulas."""
    curves = {name: _module(name).curves() for name in names}
    if quick:  # lines without particles are left out
        curves = {
            name: [curve.thinned() for curve in every if curve.points]
            for name, every in curves.items()
        }
    for name, rows in compute(curves, executor, progress):
        yield name, pd.concat([rows, _module(name).formulas(rows)], ignore_index=True)


def repeat(
    origin: dict[str, Any],
    _: Any,
    workers: int,
    progress: Callable[[int, int], None],
) -> pd.DataFrame:
    """Make the table of a figure again, from its provenance."""
    name, quick = origin["settings"]["figure"], origin["settings"]["quick"]
    with Workers(workers).fixed_pool() as pool:
        means: dict[str, Any] = {"executor": pool.executor, "progress": progress}
        return dict(tabulate([name], quick=quick, **means))[name]


def _module(name: str) -> Any:
    return import_module(f".{name.lower()}", __package__)


def compute(
    curves: dict[str, list[Curve]],
    executor: Executor,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the table of the curves of each figure once it is finished: one row per
    velocity and source. Each point is computed once."""
    jobs = {
        name: [job for curve in every for job in _jobs(curve)]
        for name, every in curves.items()
    }
    pending = {
        executor.submit(_compute, job): job
        for job in dict.fromkeys(itertools.chain(*jobs.values()))
    }
    missing = {name: set(every) for name, every in jobs.items()}
    estimates: dict[_Job, Estimate] = {}
    for future in as_completed(pending):
        job = pending[future]
        estimates[job] = future.result()
        progress(len(estimates), len(pending))
        for name in [name for name, rest in missing.items() if job in rest]:
            missing[name].discard(job)
            if not missing[name]:
                yield (
                    name,
                    pd.DataFrame(
                        [
                            row
                            for curve in curves[name]
                            for row in _rows(curve, estimates)
                        ]
                    ),
                )


def _jobs(curve: Curve) -> list[_Job]:
    solved = [
        _Job(False, curve.ensemble, v)
        for v in dict.fromkeys(curve.velocities + curve.points)
    ]
    return solved + [_Job(True, curve.ensemble, v) for v in curve.points]


def _compute(job: _Job) -> Estimate:
    """Friction at a velocity, by particles or by the master equation."""
    drive = Drive(job.velocity)
    if not job.particles:
        return reference(job.ensemble, drive).friction
    rel_error = 5e-3 if job.ensemble.fluctuates else 2e-3
    return steady(job.ensemble, drive, rel_error=rel_error).friction


def _rows(curve: Curve, estimates: dict[_Job, Estimate]) -> Iterator[dict[str, Any]]:
    """The master equation along a curve, then particles; z compares the two."""
    for particles, velocities in ((False, curve.velocities), (True, curve.points)):
        for v in velocities:
            exact, value = (
                estimates[_Job(False, curve.ensemble, v)],
                estimates[_Job(particles, curve.ensemble, v)],
            )
            yield curve.row() | {
                "velocity": v,
                "source": "particles" if particles else "master equation",
                "friction": value.value,
                "error": value.stderr,
                "reliable": value.reliable,
                "z": z_score(value, exact.value, exact.stderr) if particles else None,
            }
