"""Figure A01: f_k(v) at kT = k x_*^2 (soft, uniform, n = 1), with the low- and
high-velocity forms and a fit of a logarithm."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim import Ensemble, Thermal
from eqsim.master.closed_forms import Published
from eqsim.paper import numbered, printed
from eqsim.plots.style import BLUE, VERMILION

from .common import (
    ANNEALED,
    QUENCHED,
    SCORES_LABEL,
    WIDTH,
    Curve,
    draw,
    formula,
    log_grid,
    scores,
    solved,
)

PAPER = Published(kT=1.0)
WINDOW = 3.0  # the fit of a logarithm reaches from v_*/3 to 3 v_*
FORMULAS = {
    "nt15, low v": {"color": BLUE, "linestyle": "-."},
    "nt16, printed": {"color": "0.55", "linestyle": (0, (5, 1.5))},
    "nt16, corrected": {"color": BLUE, "linestyle": (0, (5, 1.5))},
    "logarithm, fitted": {"color": VERMILION, "linestyle": ":"},
}


def curves() -> list[Curve]:
    """Curves of both ensembles."""
    contacts = {
        name: Ensemble(thermal=Thermal(kT=1.0), stiffness_law="uniform", disorder=name)
        for name in ("annealed", "quenched")
    }
    return [
        Curve(name, e, log_grid(1e-3, 1e2, 81), log_grid(1e-3, 1e2, 11))
        for name, e in contacts.items()
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """nt15, nt16 as printed and corrected, and a + c ln v fitted around the crossover
    velocity."""
    exact = solved(table, "annealed")
    v, f_k = exact.velocity.to_numpy(), exact.friction.to_numpy()
    high = v[v > 0.3 * PAPER.v_star]
    near = abs(np.log(v / PAPER.v_star)) <= np.log(WINDOW)
    slope, constant = np.polyfit(np.log(v[near]), f_k[near], 1)
    wide = v[abs(np.log(v / PAPER.v_star)) <= 2 * np.log(WINDOW)]
    return pd.concat(
        [
            formula("nt15, low v", "printed", v, PAPER.low_velocity(v)),
            formula(
                "nt16, printed",
                "printed",
                high,
                PAPER.high_velocity(high, printed=True),
            ),
            formula("nt16, corrected", "corrected", high, PAPER.high_velocity(high)),
            formula("logarithm, fitted", "fit", wide, constant + slope * np.log(wide)),
        ]
    )


def draw_deviations(axes: Axes, table: pd.DataFrame) -> None:
    """|approximation/exact - 1| against velocity."""
    exact = solved(table, "annealed").set_index("velocity").friction
    for name, style in FORMULAS.items():
        line = solved(table, name)
        deviation = (line.friction / exact.loc[line.velocity].to_numpy() - 1).abs()
        axes.plot(line.velocity, deviation, **style)
    axes.set(
        xscale="log",
        yscale="log",
        ylim=(1e-6, 2),
        ylabel="|approximate\n/ exact $-$ 1|",
    )


def plot(table: pd.DataFrame) -> Figure:
    """f_k, how far the closed forms are from it, and particles against the master
    equation."""
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained")
    top, middle, bottom = figure.subplots(
        3, 1, sharex=True, height_ratios=[3.2, 1.2, 0.8]
    )
    draw(
        top,
        table,
        "annealed",
        ANNEALED,
        f"annealed: the published master equation ({printed('nt13')})",
    )
    draw(top, table, "quenched", QUENCHED, "quenched: literal contacts")
    for name, style in FORMULAS.items():
        draw(top, table, name, style, numbered(name))
    top.axvline(PAPER.v_star, color="0.8", linewidth=0.8, zorder=0)
    top.annotate(
        "$v_*$", (PAPER.v_star, 0.8), (3, 0), textcoords="offset points", color="0.4"
    )
    top.set(xscale="log", ylim=(0, 0.85), ylabel=r"kinetic friction  $f_k \,/\, x_*$")
    top.legend(
        loc="lower right", title="$k_BT = k x_*^2$;  markers: simulated contacts"
    )
    draw_deviations(middle, table)
    scores(bottom, table, {"annealed": ANNEALED, "quenched": QUENCHED})
    bottom.set(xlabel=r"velocity  $v \,/\, \omega x_*$", ylabel=SCORES_LABEL)
    figure.align_ylabels()
    return figure
