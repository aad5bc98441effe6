"""Figure A02ab: the curves of A02 at kT = k x_*f^2 in log-log scale, and the effective
viscosity eta = f_k/v with fits of power laws.

The paper fits eta ~ v^-alpha past the plateau, "alpha changing from 1.5 to 1 as D
decreases". There eta is no power law: where f_k rises, alpha < 1; past its maximum,
alpha > 1; at high velocity f_k is constant and alpha = 1. The fit reaches from the
maximum of f_k (for D = 0, from where it comes within 10 % of its limit) over WINDOW
decades, and its error is the standard error of the regression, which is all that a fit
to a curve that is no power law can quote.
"""

import math

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from . import a02
from .common import (
    MODEL_TITLES,
    MODELS,
    WIDTH,
    Curve,
    aging_name,
    draw,
    formula,
    solved,
)

WINDOW = 1.0  # decades


def curves() -> list[Curve]:
    """Curves of A02 at kT = k x_*f^2."""
    return a02.curves(temperatures=(1.0,))


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Power laws of eta: rows of the fitted line, `exponent` alpha and its error."""
    rows = []
    for model in MODELS:
        for D, _ in a02.rates(model):
            name = aging_name(model, D, 1.0)
            line = solved(table, name)
            v, f_k = line.velocity.to_numpy(), line.friction.to_numpy()
            first = np.flatnonzero(
                f_k >= (0.9 if f_k[-1] == f_k.max() else 1.0) * f_k.max()
            )[0]
            near = (v >= v[first]) & (v <= v[first] * 10**WINDOW * (1 + 1e-9))
            fit = stats.linregress(np.log(v[near]), np.log(f_k[near] / v[near]))
            eta = np.exp(fit.intercept + fit.slope * np.log(v[near]))
            # a line through two points says nothing of its error
            error = fit.stderr if near.sum() > 2 else math.nan
            fitted = {
                "exponent": -fit.slope,
                "exponent_error": error,
                "D": D,
                "kT": 1.0,
            }
            rows.append(
                formula(f"{name}, power law", "fit", v[near], eta * v[near], **fitted)
            )
    return pd.concat(rows)


def plot(table: pd.DataFrame) -> Figure:
    """f_k above, eta below, one column per model; exponents in the legends."""
    table = table.assign(viscosity=table.friction / table.velocity)
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    top, bottom = figure.subplots(2, 3, sharex=True, sharey="row")
    for upper, lower, model in zip(top, bottom, MODELS, strict=True):
        for D, style in a02.rates(model):
            name = aging_name(model, D, 1.0)
            draw(upper, table, name, style, a02.LABELS[D])
            draw(lower, table, name, style, y="viscosity")
            fit = solved(table, f"{name}, power law")
            alpha, error = fit.exponent.iloc[0], fit.exponent_error.iloc[0]
            label = (
                f"${alpha:.3f} \\pm {error:.3f}$"
                if math.isfinite(error)
                else f"${alpha:.3f}$"
            )
            lower.plot(
                fit.velocity,
                2 * fit.viscosity,
                color=style["color"],
                linewidth=0.9,
                linestyle="--",
            )
            lower.plot(
                [],
                [],
                color=style["color"],
                marker=style["marker"],
                markerfacecolor="white",
                label=label,
            )
        upper.set(xscale="log", yscale="log", title=MODEL_TITLES[model])
        lower.set(
            xscale="log",
            yscale="log",
            ylim=(3e-5, 200),
            xlabel=r"velocity  $v \,/\, \omega x_{*f}$",
        )
        lower.legend(loc="lower left", title=r"$\alpha$", handlelength=1, fontsize=6.5)
    top[0].set_ylabel(r"kinetic friction  $f_k \,/\, x_{*f}$")
    bottom[0].set_ylabel(r"effective viscosity  $\eta\,\omega = f_k\,\omega/v$")
    handles, labels = top[0].get_legend_handles_labels()
    title = (
        r"$k_BT = k x_{*f}^2$;  $D$ in $\omega x_{*f}^2$;  thin dashes: fits "
        r"$\eta \propto v^{-\alpha}$, doubled"
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=6, title=title)
    figure.align_ylabels()
    return figure
