"""Cost of a sweep beyond its points: `python -m analysis.sweep_overhead` runs a grid
of velocity, temperature and delay (quenched contacts, relative error 1e-2) on all cores
and prints time per point, in the engine and the reference, and in everything else
(start of the workers included)."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer


def main(
    points: Annotated[int, typer.Option(help="About how many points.")] = 10_000,
) -> None:
    """Run the sweep in a temporary folder."""
    side = max(2, round((points / 10) ** 0.5))
    axes = f"""[sweep]
"drive.velocity" = {{ log = [1e-3, 1e1, {side}] }}
"thermal.kT" = {{ linear = [0.0, 0.3, {side}] }}
"delay.time" = {{ linear = [0.0, 1.0, 10] }}
"""
    workers = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sweep.toml"
        path.write_text(axes, encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "eqsim",
            "sweep",
            str(path),
            "--out",
            f"{folder}/out",
            "--json",
        ]
        report = json.loads(
            subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        )
    inside = report["point_seconds"] / report["points"]
    outside = (report["seconds"] * workers - report["point_seconds"]) / report["points"]
    print(
        f"{report['points']} points in {report['seconds']:.0f} s on {workers} workers, "
        f"{report['failed']} failed"
    )
    print(
        f"per point and worker: {1e3 * inside:.1f} ms engine and reference, "
        f"{1e3 * outside:.1f} ms everything else"
    )


if __name__ == "__main__":
    typer.run(main)
