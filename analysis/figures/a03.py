"""Figure A03: friction of aging contacts that re-attach after a delay (D = 0.1, kT = k
x_*f^2).

The paper divides f_k(v) by 1 + v/v_d at fixed v_d. But v_d = C(v)/tau, and C falls at
low velocity; with a fixed delay tau the pinned fraction is lower there. Both are drawn;
tau = x_*i/(C_0 v_d), so that they meet at high velocity, where C is that of newborn
thresholds.
"""

import math

import pandas as pd
from matplotlib.figure import Figure

from eqsim.master.closed_forms import C_0

from .common import (
    MODEL_TITLES,
    MODELS,
    SCORES_LABEL,
    SERIES,
    WIDTH,
    X_INITIAL,
    Curve,
    aging_contacts,
    draw,
    formula,
    log_grid,
    scores,
    solved,
)

DELAYS = (math.inf, 10.0, 1.0, 0.1)  # v_d
STYLES = dict(zip(DELAYS, (SERIES[0], SERIES[3], SERIES[2], SERIES[4]), strict=True))


def name(model: str, v_d: float) -> str:
    """Name of a curve at fixed tau."""
    return f"{model}, tau = {X_INITIAL / C_0 / v_d:.4g}"


def curves() -> list[Curve]:
    """Curves of all models at fixed tau."""
    return [
        Curve(
            name(model, v_d),
            aging_contacts(model, 0.1, 1.0, X_INITIAL / C_0 / v_d),
            log_grid(1e-3, 1e2, 31),
            log_grid(1e-3, 1e2, 11),
        )
        for model in MODELS
        for v_d in DELAYS
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """f_k/(1 + v/v_d) at fixed v_d, as printed."""
    rows = []
    for model in MODELS:
        bare = solved(table, name(model, math.inf))
        for v_d in DELAYS[1:]:
            friction = bare.friction / (1 + bare.velocity / v_d)
            rows.append(
                formula(f"{model}, v_d = {v_d:g}", "printed", bare.velocity, friction)
            )
    return pd.concat(rows)


def plot(table: pd.DataFrame) -> Figure:
    """One column per model: semi-logarithmic, log-log, scores."""
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    rows = figure.subplots(
        3, 3, sharex=True, sharey="row", height_ratios=[2.6, 2.2, 0.8]
    )
    for column, model in zip(rows.T, MODELS, strict=True):
        for panel in column[:2]:
            for v_d, style in STYLES.items():
                label = r"$v_d = \infty$, $\tau = 0$"
                if v_d < math.inf:
                    printed = {"linewidth": 0.8, "linestyle": "--", "marker": "none"}
                    draw(panel, table, f"{model}, v_d = {v_d:g}", style, **printed)
                    label = f"$v_d = {v_d:g}$, $\\tau = {X_INITIAL / C_0 / v_d:.3g}$"
                draw(panel, table, name(model, v_d), style, label)
        column[1].set(yscale="log", ylim=(1e-5, 1))
        column[0].set(ylim=(0, 0.45), title=MODEL_TITLES[model])
        scores(
            column[2], table, {name(model, v_d): style for v_d, style in STYLES.items()}
        )
        column[2].set_xlabel(r"velocity  $v \,/\, \omega x_{*f}$")
    for panel in rows[:2, 0]:
        panel.set_ylabel(r"friction  $\langle F\rangle / (N k x_{*f})$")
    rows[2, 0].set_ylabel(SCORES_LABEL)
    handles, labels = rows[0, 0].get_legend_handles_labels()
    title = (
        r"lines: fixed $\tau$;  thin dashes: fixed $v_d$ (printed);  $v_d$ in "
        r"$\omega x_{*f}$, $\tau$ in $1/\omega$"
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=4, title=title)
    figure.align_ylabels()
    return figure
