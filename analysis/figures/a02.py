"""Figure A02: f_k(v) of aging contacts for aging rates from infinity to 0, at kT = k
x_*f^2 and at T = 0.

The published master equation has one curve for each D; literal contacts have two, since
thresholds may follow the mean drift or fluctuate. A `langevin` threshold cannot age at
an infinite rate: it would meet the stretch at once.
"""

import math

import pandas as pd
from matplotlib.figure import Figure

from .common import (
    MODEL_TITLES,
    MODELS,
    RATES,
    SCORES_LABEL,
    SERIES,
    WIDTH,
    Curve,
    aging_contacts,
    aging_name,
    draw,
    log_grid,
    scores,
)

VELOCITIES, POINTS = log_grid(1e-4, 1e2, 37), log_grid(1e-4, 1e2, 7)
LABELS = {D: r"$D = \infty$" if math.inf == D else f"$D = {D:g}$" for D in RATES}


def rates(model: str) -> list[tuple[float, dict]]:
    """Aging rates D of a model, and the styles of their curves."""
    return [
        (D, style)
        for D, style in zip(RATES, SERIES, strict=True)
        if not (model == "langevin" and math.inf == D)
    ]


def curves(temperatures: tuple[float, ...] = (1.0, 0.0)) -> list[Curve]:
    """Curves of all models and rates, with particles on the warm ones."""
    return [
        Curve(
            aging_name(model, D, kT),
            aging_contacts(model, D, kT),
            VELOCITIES,
            POINTS if kT > 0 else (),
        )
        for model in MODELS
        for D, _ in rates(model)
        for kT in temperatures
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """No rows: there is no closed form."""
    return table.iloc[:0]


def plot(table: pd.DataFrame) -> Figure:
    """One panel per model."""
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    top, bottom = figure.subplots(
        2, 3, sharex=True, sharey="row", height_ratios=[3.4, 0.8]
    )
    for panel, strip, model in zip(top, bottom, MODELS, strict=True):
        for D, style in rates(model):
            dashes = {"linewidth": 0.8, "linestyle": "--", "alpha": 0.8}
            draw(panel, table, aging_name(model, D, 0.0), style, **dashes)
            draw(panel, table, aging_name(model, D, 1.0), style, LABELS[D])
        panel.set(ylim=(0, 0.8), title=MODEL_TITLES[model])
        scores(
            strip,
            table,
            {aging_name(model, D, 1.0): style for D, style in rates(model)},
        )
        strip.set(xlabel=r"velocity  $v \,/\, \omega x_{*f}$")
    top[0].set_ylabel(r"kinetic friction  $f_k \,/\, x_{*f}$")
    bottom[0].set_ylabel(SCORES_LABEL)
    handles, labels = top[0].get_legend_handles_labels()
    cold = r" (thin dashes: $T = 0$)" if (table.kT == 0).any() else ""
    title = (
        rf"$k_BT = k x_{{*f}}^2${cold};  $D$ in $\omega x_{{*f}}^2$;  $x_{{*i}} = "
        rf"0.1\, x_{{*f}}$"
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=6, title=title)
    figure.align_ylabels()
    return figure
