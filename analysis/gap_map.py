"""Map of where the published master equation can be used for literal contacts.

Quenched over annealed friction on a plane of velocity and temperature, for both
stiffness laws (n = 1, soft, no delay), from the two exact references: `python -m
analysis.gap_map` writes gap_map.png and gap_map.parquet.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from rich.progress import track

from eqsim import Drive, Ensemble, Thermal, reference
from eqsim.plots import style


def table(points: int) -> pd.DataFrame:
    """One row per stiffness law, velocity (omega x_*) and temperature (k x_*^2): both
    frictions and their ratio."""
    plane = [
        (law, kT, v)
        for law in ("sqrt", "uniform")
        for kT in np.geomspace(0.01, 10, points)
        for v in np.geomspace(1e-6, 1e2, points)
    ]
    rows = []
    for law, kT, v in track(plane, description="solving"):
        friction = {
            disorder: reference(
                Ensemble(thermal=Thermal(kT), stiffness_law=law, disorder=disorder),
                Drive(v),
            ).friction
            for disorder in ("quenched", "annealed")
        }
        row = {f"friction_{name}": exact.value for name, exact in friction.items()}
        row |= {f"error_{name}": exact.stderr for name, exact in friction.items()}
        rows.append({"stiffness_law": law, "kT": kT, "velocity": v, **row})
    frame = pd.DataFrame(rows)
    frame["ratio"] = frame.friction_quenched / frame.friction_annealed
    return frame


@style.styled
def picture(frame: pd.DataFrame) -> Figure:
    """Decimal logarithm of the ratio, with lines where the ensembles differ by 1 and by
    10 per cent."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    norm = TwoSlopeNorm(
        0.0, min(-0.1, np.log10(frame.ratio.min())), np.log10(frame.ratio.max())
    )
    for axes, law in zip(panels, ("uniform", "sqrt"), strict=True):
        grid = frame[frame.stiffness_law == law].pivot(
            index="kT", columns="velocity", values="ratio"
        )
        axes.grid(False)
        mesh = axes.pcolormesh(
            grid.columns,
            grid.index,
            np.log10(grid),
            norm=norm,
            cmap="RdBu_r",
            shading="nearest",
        )
        for level, dashes in ((0.01, ":"), (0.1, "-")):
            axes.contour(
                grid.columns,
                grid.index,
                abs(grid - 1),
                levels=[level],
                colors="k",
                linestyles=dashes,
            )
            axes.plot(
                [], [], color="k", linestyle=dashes, label=f"differ by {level:.0%}"
            )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel=r"velocity  $v / (\omega x_*)$",
            title=f"{law} stiffness",
        )
    panels[0].legend(fontsize=8, loc="lower right")
    panels[0].set_ylabel(r"temperature  $k_B T / (k x_*^2)$")
    figure.colorbar(
        mesh, ax=panels, label=r"$\log_{10}$ (quenched friction / annealed friction)"
    )
    return figure


def main(
    out: Annotated[
        Path, typer.Option(help="Folder for the picture and the table.")
    ] = Path("analysis/out"),
    points: Annotated[int, typer.Option(help="Points along each axis.")] = 33,
) -> None:
    """Solve, save, draw."""
    out.mkdir(parents=True, exist_ok=True)
    frame = table(points)
    frame.to_parquet(out / "gap_map.parquet", index=False)
    (out / "gap_map.png").write_bytes(style.saved(picture(frame)))
    close = (frame.ratio - 1).abs() < 0.01
    print(
        f"the ensembles agree to 1 % at {close.mean():.0%} of the plane; ratio up to "
        f"{frame.ratio.max():.3g}"
    )


if __name__ == "__main__":
    typer.run(main)
