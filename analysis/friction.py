"""The picture of the README: friction against displacement and against velocity, at
three temperatures.

    python -m analysis.friction

writes `analysis/figures/friction.png`. Lines are the master equation of each ensemble,
markers are simulated contacts.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eqsim import Drive, Ensemble, Thermal, reference, steady, trajectory, transient
from eqsim.plots import style

OUT = Path(__file__).parent / "figures" / "friction.png"
TEMPERATURES = (0.02, 0.2, 1.0)  # kT in k x_*^2
VELOCITY = 0.1  # of the run, in omega x_*
ENSEMBLES = {"quenched": ("-", "o"), "annealed": ("--", "s")}
COLORS = dict(
    zip(TEMPERATURES, (style.BLUE, style.GREEN, style.VERMILION), strict=True)
)


def contacts(disorder: str, kT: float) -> Ensemble:
    """10 000 contacts, lengths in units of x_*."""
    return Ensemble(
        thermal=Thermal(kT), count=10_000, stiffness_law="uniform", disorder=disorder
    )


@style.styled
def plot(points: int = 11, fine: int = 61) -> Figure:
    """F(X) on the left, F(v) on the right, at `points` simulated velocities and with
    `fine` velocities in each line."""
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    velocities, lines = np.geomspace(1e-3, 10.0, points), np.geomspace(1e-3, 10.0, fine)
    for disorder, (dashes, marker) in ENSEMBLES.items():
        for kT, color in COLORS.items():
            ensemble = contacts(disorder, kT)
            line = {"color": color, "linestyle": dashes, "linewidth": 1.1}
            mark = {
                "color": color,
                "fmt": marker,
                "markersize": 4,
                "markerfacecolor": "white",
                "capsize": 2,
            }
            drive = Drive(VELOCITY, distance=5.0)
            exact, simulated = (
                transient(ensemble, drive, 201),
                trajectory(ensemble, drive, points=26),
            )
            left.plot(exact.X, exact.force, **line)
            left.errorbar(
                simulated.X,
                simulated.force,
                2 * simulated.force_stderr,
                elinewidth=0.8,
                zorder=3,
                **mark,
            )
            right.plot(
                lines,
                [reference(ensemble, Drive(v)).friction.value for v in lines],
                **line,
            )
            estimates = [
                steady(ensemble, Drive(v), rel_error=5e-3).friction for v in velocities
            ]
            right.errorbar(
                velocities,
                [e.value for e in estimates],
                [2 * e.stderr for e in estimates],
                zorder=3,
                **mark,
            )
    left.set(
        xlabel="displacement  $X / x_*$",
        ylabel="friction  $F / (N k x_*)$",
        xlim=(0, 5),
        ylim=(0, None),
    )
    left.set_title(rf"from a fresh start, $v = {VELOCITY:g}\,\omega x_*$")
    right.set(xlabel=r"velocity  $v / (\omega x_*)$", xscale="log")
    right.set_title("steady sliding")
    right.axvline(VELOCITY, color="0.8", linewidth=0.8, zorder=0)
    heat = [
        Line2D([], [], color=color, label=rf"$k_B T = {kT:g}\,k x_*^2$")
        for kT, color in COLORS.items()
    ]
    names = {
        "quenched": "literal contacts (quenched)",
        "annealed": "published master equation (annealed)",
    }
    kinds = [
        Line2D(
            [],
            [],
            color="0.3",
            linestyle=dashes,
            marker=marker,
            markerfacecolor="white",
            label=names[disorder],
        )
        for disorder, (dashes, marker) in ENSEMBLES.items()
    ]
    title = "lines: exact; markers: simulated, ± 2 standard errors"
    figure.legend(
        handles=[*heat, *kinds],
        ncols=5,
        loc="outside lower center",
        frameon=False,
        handlelength=3,
        title=title,
    )
    for panel in (left, right):
        panel.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    OUT.write_bytes(style.saved(plot()))
