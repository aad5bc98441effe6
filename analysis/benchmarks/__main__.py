"""python -m analysis.benchmarks: how many times faster eqsim is than its rivals, measured side by side."""

from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer
from rich.console import Console

from analysis.benchmarks import report
from analysis.benchmarks.cases import CASES, QUICK, Case, Sizes
from analysis.benchmarks.jobs import time_steady, time_trajectory

OUT = Path(__file__).parents[1] / "out"
COMPILE = Sizes(320, 10.0, 11, 10, 1.0, 320, (1e-2,), 1)

Job = Callable[[Case, Sizes, int, int], dict[str, Any]]


def jobs(sizes: Sizes) -> dict[str, Job]:
    """The jobs by name."""
    steady = {f"steady average to {error:g}": partial(time_steady, rel_error=error) for error in sizes.errors}
    return {"trajectory": time_trajectory, **steady}


def measure(sizes: Sizes, threads: int) -> pd.DataFrame:
    """One row per job and case."""
    for job in jobs(COMPILE).values():
        for case in CASES:
            job(case, COMPILE, threads, 1)
    rows = []
    for name, job in jobs(sizes).items():
        for case in CASES:
            seed = 1000 * (len(rows) + 1)  # rows share no random numbers
            rows.append({"job": name, **job(case, sizes, threads, seed)})
    about = {f"{name}_version": version(name) for name in ("eqsim", "numba", "numpy")}
    return pd.DataFrame(rows).assign(thread_count=threads, repeats=sizes.repeats, contacts=sizes.contacts, **about)


def main(
    out: Annotated[Path, typer.Option(help="Folder for benchmarks.parquet and benchmarks.png.")] = OUT,
    quick: Annotated[bool, typer.Option("--quick", help="Small sizes: a smoke test, not a measurement.")] = False,
    threads: Annotated[int, typer.Option(min=1, help="Threads eqsim is compared on with itself.")] = 2,
) -> None:
    """Time eqsim and its rivals, print a table, and write table and picture."""
    console, sizes = Console(), QUICK if quick else Sizes()
    console.width = max(console.width, 124)  # the table needs as much
    figures = measure(sizes, threads)
    console.print(report.table(figures))
    console.print(report.notes(sizes, threads))
    out.mkdir(parents=True, exist_ok=True)
    figures.to_parquet(out / "benchmarks.parquet", index=False)
    report.picture(figures, threads, out / "benchmarks.png")
    console.print(f"wrote benchmarks.parquet and benchmarks.png to {out}")


typer.run(main)
