"""Figure A01num: f_k(v) of soft and stiff contacts at low and at high temperature
(uniform, n = 1)."""

import pandas as pd
from matplotlib.figure import Figure

from eqsim import Ensemble, Thermal
from eqsim.plots.style import BLUE

from .common import SCORES_LABEL, WIDTH, Curve, draw, log_grid, scores

STYLES = {
    ("soft", 0.01): {"color": BLUE, "linestyle": ":", "marker": "^"},
    ("stiff", 0.01): {"color": BLUE, "linestyle": "-", "marker": "s"},
    ("soft", 1.0): {"color": "black", "linestyle": ":", "marker": "o"},
    ("stiff", 1.0): {"color": "black", "linestyle": "-", "marker": "D"},
}
DISORDERS = ("annealed", "quenched")


def name(disorder: str, barrier: str, kT: float) -> str:
    """Name of a curve."""
    return f"{disorder}, {barrier}, kT = {kT:g}"


def curves() -> list[Curve]:
    """Curves of both ensembles, all barriers and temperatures."""
    return [
        Curve(
            name(disorder, barrier, kT),
            Ensemble(
                thermal=Thermal(kT, barrier=barrier),
                stiffness_law="uniform",
                disorder=disorder,
            ),
            log_grid(1e-4, 1e2, 73),
            log_grid(1e-4, 1e2, 13),
        )
        for disorder in DISORDERS
        for barrier, kT in STYLES
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """No rows: there is no closed form for stiff contacts."""
    return table.iloc[:0]


def plot(table: pd.DataFrame) -> Figure:
    """One panel per ensemble."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    top, bottom = figure.subplots(
        2, 2, sharex=True, sharey="row", height_ratios=[3.2, 0.8]
    )
    for panel, strip, disorder in zip(top, bottom, DISORDERS, strict=True):
        for (barrier, kT), style in STYLES.items():
            draw(
                panel,
                table,
                name(disorder, barrier, kT),
                style,
                f"{barrier}, $k_BT = {kT:g}\\,k x_*^2$",
            )
        panel.set(
            ylim=(0, 0.82),
            title=disorder
            + (" (published)" if disorder == "annealed" else " (literal)"),
        )
        scores(
            strip, table, {name(disorder, *key): style for key, style in STYLES.items()}
        )
        strip.set(xlabel=r"velocity  $v \,/\, \omega x_*$")
    top[0].set_ylabel(r"kinetic friction  $f_k \,/\, x_*$")
    bottom[0].set_ylabel(SCORES_LABEL)
    handles, labels = top[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.align_ylabels()
    return figure
