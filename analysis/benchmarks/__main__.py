"""python -m analysis.benchmarks: eqsim beside its rivals, measured within one run."""

import os
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer
from rich.console import Console

from analysis.benchmarks import report, tuned
from analysis.benchmarks.alone import (
    measure_memory,
    time_curves,
    time_fits,
    time_langevin,
    time_references,
    time_start,
)
from analysis.benchmarks.cases import CASES, COMPILE, QUICK, Case, Sizes
from analysis.benchmarks.driven import time_programmes, time_spring
from analysis.benchmarks.elastic import time_elastic
from analysis.benchmarks.jobs import time_plain, time_steady, time_trajectory

OUT = Path(__file__).parents[1] / "out"

Job = Callable[[Case, Sizes, int, int], dict[str, Any]]


def shared_jobs(sizes: Sizes) -> dict[str, Job]:
    """Jobs that rivals do too, by name."""
    steady = {
        f"steady average to {error:g}": partial(time_steady, rel_error=error)
        for error in sizes.errors
    }
    return {
        "trajectory": time_trajectory,
        f"steady average of {sizes.lives:.0e} lives": time_plain,
        **steady,
    }


def measure(sizes: Sizes, threads: int, console: Console) -> pd.DataFrame:
    """One row per job and case."""
    for job in shared_jobs(COMPILE).values():
        for case in CASES:
            job(case, COMPILE, threads, 1)
    rows: list[dict[str, Any]] = []
    for name, job in shared_jobs(sizes).items():
        for case in CASES:
            console.print(f"[dim]{name}: {case.name}")
            seed = 1000 * (len(rows) + 1)  # rows share no random numbers
            rows.append({"job": name, **job(case, sizes, threads, seed)})
    console.print("[dim]programmes, a spring, avalanches")
    rows += (
        time_programmes(sizes, threads, 1)
        + time_spring(sizes, threads, 1)
        + time_elastic(sizes, threads, 1)
    )
    console.print("[dim]langevin lives, references, fits, memory, start-up")
    rows += (
        time_langevin(sizes, threads, 1)
        + time_references(sizes)
        + time_curves(sizes)
        + time_fits(sizes)
    )
    rows += measure_memory(sizes) + time_start(sizes)
    about = {f"{name}_version": version(name) for name in ("eqsim", "numba", "numpy")}
    about["compiler"] = tuned.compiler_version()
    return pd.DataFrame(rows).assign(
        thread_count=threads,
        contacts=sizes.contacts,
        load=os.getloadavg()[0],
        **about,
    )


def main(
    out: Annotated[
        Path, typer.Option(help="Folder for benchmarks.parquet and benchmarks.png.")
    ] = OUT,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Small sizes: a smoke test, not a measurement."),
    ] = False,
    threads: Annotated[
        int,
        typer.Option(min=2, help="Threads on which eqsim and C are timed beside one."),
    ] = 2,
) -> None:
    """Time eqsim and its rivals, print a table, and write table and picture."""
    console, sizes = Console(), QUICK if quick else Sizes()
    console.width = max(console.width, 156)  # width of the table
    if not tuned.available():
        console.print("no gcc that compiles tuned.c: rival C is left out")
    figures = measure(sizes, threads, console)
    console.print(*report.tables(figures), sep="\n")
    console.print(report.notes(sizes, threads))
    out.mkdir(parents=True, exist_ok=True)
    figures.to_parquet(out / "benchmarks.parquet", index=False)
    report.picture(figures, out / "benchmarks.png")
    console.print(f"wrote benchmarks.parquet and benchmarks.png to {out}")


typer.run(main)
