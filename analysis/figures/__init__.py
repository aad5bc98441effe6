"""The figures of Braun and Peyrard (2011), recomputed, with particles on them.

One module per figure, named in lower case, with `curves()`, what is to be computed; `formulas(table)`, the rows of
approximations and fits; and `plot(table)`. Every velocity of every curve comes from the master equation of its model,
every marker from an estimate by particles (`eqsim.steady`). Installed as `eqsim_figures`, for `eqsim figures`.
"""

import io
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, as_completed
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from eqsim import reference, steady, tables
from eqsim.errors import require_choice
from eqsim.estimate import z_score

from .common import STYLE, Curve

NAMES = ("A01", "A01num", "A02", "A02ab", "A03", "A04", "A05")


class Made(NamedTuple):
    """A figure that was written: how many curves, how many particle estimates, their largest |z| and chi-square p."""

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
    """The names in the order of the paper, all if none is given. Raises InputError."""
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
    """Compute the named figures on the `executor`, each point once, and write NAME.pdf, NAME.png and
    NAME.parquet to `out`, one figure after the other. `quick`: a quarter of the points. Raises InputError."""
    for name, table in tabulate(names, quick=quick, executor=executor, progress=progress).items():
        with matplotlib.rc_context(STYLE):
            figure = _module(name).plot(table)
            files = {f"{name}.{form}": _saved(figure, form) for form in ("pdf", "png")}
        origin = tables.provenance("figures", {"figure": name, "quick": quick}, "", 1)
        tables.publish(out, {**files, f"{name}.parquet": tables.parquet(table, origin)})
        z = table.z.dropna()
        p = float(stats.chi2.sf((z**2).sum(), len(z)))
        yield Made(name, table.curve.nunique(), len(z), float(z.abs().max()), p)


def tabulate(
    names: list[str],
    *,
    quick: bool = False,
    executor: Executor,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, pd.DataFrame]:
    """Every row of the named figures: curves, particles and formulas."""
    curves = {name: [curve.thinned(4 if quick else 1) for curve in _module(name).curves()] for name in names}
    found = compute(curves, executor, progress)
    return {name: pd.concat([rows, _module(name).formulas(rows)], ignore_index=True) for name, rows in found.items()}


def _module(name: str) -> Any:
    return import_module(f".{name.lower()}", __name__)


def compute(
    curves: dict[str, list[Curve]], executor: Executor, progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, pd.DataFrame]:
    """A table of the curves of each figure: one row per velocity and source, each point computed once."""
    jobs = dict.fromkeys(job for every in curves.values() for curve in every for job in _jobs(curve))
    pending = {executor.submit(_compute, job): job for job in jobs}
    found: dict[_Job, dict[str, Any]] = {}
    for future in as_completed(pending):
        found[pending[future]] = future.result()
        progress(len(found), len(jobs))
    return {
        name: pd.DataFrame([curve.row() | found[job] for curve in every for job in _jobs(curve)])
        for name, every in curves.items()
    }


def _jobs(curve: Curve) -> list[_Job]:
    solved = [_Job(False, curve.ensemble, v) for v in curve.velocities]
    return solved + [_Job(True, curve.ensemble, v) for v in curve.points]


def _compute(job: _Job) -> dict[str, Any]:
    """Friction at a velocity, by the master equation or by particles; z compares the two."""
    exact = reference(job.ensemble, job.velocity).friction
    if not job.particles:
        row = {"source": "master equation", "friction": exact.value, "error": exact.stderr}
        return {"velocity": job.velocity, **row, "reliable": True, "z": None}
    rel_error = 5e-3 if job.ensemble.fluctuates else 2e-3
    particles = steady(job.ensemble, job.velocity, rel_error=rel_error).friction
    row = {"source": "particles", "friction": particles.value, "error": particles.stderr}
    z = z_score(particles, exact.value, exact.stderr)
    return {"velocity": job.velocity, **row, "reliable": particles.reliable, "z": z}


def _saved(figure: Figure, form: str) -> bytes:
    buffer = io.BytesIO()
    undated = {"pdf": {"CreationDate": None, "Creator": "eqsim"}, "png": {"Software": "eqsim"}}
    figure.savefig(buffer, format=form, metadata=undated[form])
    return buffer.getvalue()
