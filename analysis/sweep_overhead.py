"""What a sweep costs beyond its points: `python -m analysis.sweep_overhead` runs a grid of velocity, temperature and
delay (quenched contacts, relative error 1e-2) on all cores and prints time per point, in the engine and the reference,
and in everything else (start of the workers included)."""

import os
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from eqsim.io.runfile import check
from eqsim.sweep.scheduler import sweep


def main(points: Annotated[int, typer.Option(help="About so many points.")] = 10_000) -> None:
    """Run the sweep in a temporary folder."""
    side = max(2, round((points / 10) ** 0.5))
    axes = {
        "drive.velocity": {"log": [1e-3, 1e1, side]},
        "thermal.kT": {"linear": [0.0, 0.3, side]},
        "delay.time": {"linear": [0.0, 1.0, 10]},
    }
    workers = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as folder:
        found = sweep(check({"sweep": axes}), Path(folder), Path(folder) / "out", workers=workers, note=print)
    inside = found.point_seconds / found.points
    outside = (found.seconds * workers - found.point_seconds) / found.points
    print(f"{found.points} points in {found.seconds:.0f} s on {workers} workers, {found.failed} failed")
    print(f"per point and worker: {1e3 * inside:.1f} ms engine and reference, {1e3 * outside:.1f} ms everything else")


if __name__ == "__main__":
    typer.run(main)
