"""Common parts of the figures: curves to compute, models of aging contacts, and the
looks of curves, particles and scores."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from eqsim import Aging, Delay, Ensemble, Gamma, Thermal
from eqsim.plots.style import BLUE, GREEN, ORANGE, VERMILION
from eqsim.plots.style import STYLE as HOUSE

WIDTH = 7.0  # inches, of a figure across two columns
STYLE = HOUSE | {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 4.5,
    "legend.framealpha": 0.9,
}
BLACK = "black"
ANNEALED: dict[str, Any] = {"color": BLACK, "linestyle": "-", "marker": "o"}
QUENCHED: dict[str, Any] = {"color": ORANGE, "linestyle": "--", "marker": "s"}
# of curves with several values of one parameter
SERIES: list[dict[str, Any]] = [
    {"color": "#000000", "linestyle": "-", "marker": "o"},
    {"color": GREEN, "linestyle": (0, (6, 1.5)), "marker": "s"},
    {"color": BLUE, "linestyle": (0, (4, 1, 1, 1)), "marker": "^"},
    {"color": VERMILION, "linestyle": (0, (1.2, 1)), "marker": "D"},
    {"color": ORANGE, "linestyle": (0, (6, 1, 1, 1, 1, 1)), "marker": "v"},
    {"color": "#9A9A9A", "linestyle": "-", "marker": "P"},
]
# the published master equation, and two kinds of literal contacts
MODELS = ("annealed", "flow", "langevin")
MODEL_TITLES = {
    "annealed": "annealed (published)",
    "flow": "quenched, flow",
    "langevin": "quenched, langevin",
}
RATES = (math.inf, 1.0, 0.1, 0.01, 0.001, 0.0)  # D, in omega x_*f^2
X_INITIAL, X_FINAL = 0.1, 1.0  # x_*i and x_*f of the aging figures


@dataclass(frozen=True)
class Curve:
    """Contacts against velocity: the master equation at `velocities`, particles at
    `points`."""

    name: str
    ensemble: Ensemble
    velocities: tuple[float, ...]
    points: tuple[float, ...] = ()

    def thinned(self) -> "Curve":
        """A quarter of the points; where each takes a second, a sixth."""
        every = 6 if self.ensemble.aging.active else 4
        return replace(
            self,
            velocities=self.velocities[::every],
            points=self.points[every // 2 :: every],
        )

    def row(self) -> dict[str, Any]:
        """Columns of the table that identify the curve."""
        contacts = self.ensemble
        aging = contacts.aging if contacts.aging.active else Aging()
        return {
            "curve": self.name,
            "disorder": contacts.disorder,
            "barrier": contacts.thermal.barrier,
            "kT": contacts.thermal.kT,
            "aging": aging.rule,
            "D": aging.rate,
            "tau": contacts.delay.time,
        }


def log_grid(low: float, high: float, count: int) -> tuple[float, ...]:
    """`count` velocities, equally spaced in their logarithm."""
    return tuple(float(v) for v in np.geomspace(low, high, count))


def aging_contacts(model: str, D: float, kT: float, tau: float = 0.0) -> Ensemble:
    """Contacts of figures A02-A04: soft, uniform, n = 1, k = omega = 1, thresholds that
    age from x_*i to x_*f."""
    aging = (
        Aging("langevin" if model == "langevin" else "flow", D, X_FINAL)
        if D > 0
        else Aging()
    )
    disorder = "annealed" if model == "annealed" else "quenched"
    thresholds = Gamma(1.0, X_INITIAL)
    return Ensemble(
        thresholds,
        Thermal(kT=kT),
        Delay(tau),
        aging=aging,
        stiffness_law="uniform",
        disorder=disorder,
    )


def aging_name(model: str, D: float, kT: float) -> str:
    """Name of a curve of figure A02."""
    return f"{model}, D = {D:g}, kT = {kT:g}"


def formula(
    name: str, source: str, velocity: Any, friction: Any, **more: Any
) -> pd.DataFrame:
    """Rows of a closed form or a fit; `source` is "printed", "corrected" or "fit"."""
    return pd.DataFrame(
        {
            "curve": name,
            "source": source,
            "velocity": velocity,
            "friction": friction,
            **more,
        }
    )


def solved(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """The master equation's rows of a curve, by velocity."""
    rows = table[(table.curve == name) & (table.source != "particles")]
    return rows.sort_values("velocity")


def draw(
    axes: Axes,
    table: pd.DataFrame,
    name: str,
    style: dict[str, Any],
    label: str | None = None,
    y: str = "friction",
    **more: Any,
) -> None:
    """Draw a curve as a line, and its particles as open markers with bars of two
    standard errors."""
    line, look = solved(table, name), style | more
    marker = look.pop("marker", "none")
    axes.plot(line.velocity, line[y], label=label, **look)
    points = table[(table.curve == name) & (table.source == "particles")]
    scale = points[y] / points.friction
    axes.errorbar(
        points.velocity,
        points[y],
        2 * points.error * scale,
        fmt=marker,
        color=look["color"],
        markerfacecolor="white",
        markeredgewidth=0.9,
        elinewidth=0.9,
        capsize=2,
        zorder=3,
    )


def scores(axes: Axes, table: pd.DataFrame, styles: dict[str, dict[str, Any]]) -> None:
    """Draw (particles - master equation) in standard errors, and a band of two."""
    axes.axhspan(-2, 2, color="0.9", linewidth=0)
    for name, style in styles.items():
        points = table[(table.curve == name) & (table.source == "particles")]
        axes.plot(
            points.velocity,
            points.z.astype(float),
            linestyle="none",
            color=style["color"],
            marker=style["marker"],
            markerfacecolor="white",
            markersize=3.5,
            markeredgewidth=0.8,
        )
    limit = max(3.5, 1.15 * table.z.abs().max())
    axes.set(ylim=(-limit, limit), yticks=(-2, 0, 2), xscale="log")


SCORES_LABEL = "score  $z$"
