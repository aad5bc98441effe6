"""Figure A04: f_k(v) of aging contacts against the expansion in D_v = D/v (star4),
printed and corrected."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from eqsim.master.closed_forms import PublishedAging
from eqsim.paper import printed

from .common import RATES as ALL_RATES
from .common import (
    SERIES,
    WIDTH,
    X_FINAL,
    X_INITIAL,
    Curve,
    aging_contacts,
    aging_name,
    draw,
    formula,
    log_grid,
    solved,
)

RATES = (1.0, 0.1, 0.01, 0.001)
STYLES = dict(zip(ALL_RATES, SERIES, strict=True))
VELOCITIES, POINTS = log_grid(1e-2, 1e4, 49), log_grid(1e-1, 1e3, 5)
MODELS = ("annealed", "flow")
LOOKS = {
    "printed": {"color": "0.6", "linewidth": 1.0, "linestyle": (0, (3, 1))},
    "corrected": {"color": "black", "linewidth": 0.7, "linestyle": "-"},
}
SMALL = 2.0  # the expansion is drawn where S_2 and S_3 are less


def curves() -> list[Curve]:
    """Curves of the published master equation, and of literal contacts whose thresholds
    flow."""
    return [
        Curve(
            aging_name(model, D, 1.0), aging_contacts(model, D, 1.0), VELOCITIES, POINTS
        )
        for model in MODELS
        for D in RATES
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """star4b with star4a, as printed and corrected."""
    rows = []
    for D in RATES:
        paper = PublishedAging(D, X_INITIAL, X_FINAL, kT=1.0)
        v = solved(table, aging_name("annealed", D, 1.0)).velocity.to_numpy()
        v = v[np.maximum(paper.S_3(v), paper.S_2(v)) < SMALL]
        for source in ("printed", "corrected"):
            rows.append(
                formula(
                    f"star4, D = {D:g}, {source}",
                    source,
                    v,
                    paper.f_k(v, printed=source == "printed"),
                )
            )
    return pd.concat(rows)


def plot(table: pd.DataFrame) -> Figure:
    """f_k with both expansions, their deviation from the exact curve, and quenched
    contacts."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    (exact, literal), (left, right) = figure.subplots(2, 2, sharex=True, sharey="row")
    for D in RATES:
        style, name = STYLES[D], aging_name("annealed", D, 1.0)
        draw(exact, table, name, style, f"$D = {D:g}$")
        draw(literal, table, aging_name("flow", D, 1.0), style)
        truth = solved(table, name).set_index("velocity").friction
        for panel, source in ((left, "printed"), (right, "corrected")):
            line = solved(table, f"star4, D = {D:g}, {source}")
            exact.plot(line.velocity, line.friction, **LOOKS[source])
            deviation = (line.friction / truth.loc[line.velocity].to_numpy() - 1).abs()
            panel.plot(
                line.velocity,
                deviation,
                color=style["color"],
                linestyle=style["linestyle"],
            )
    exact.set(
        xscale="log",
        yscale="log",
        ylim=(0.04, 1),
        title=f"annealed (published), with {printed('star4')}",
    )
    exact.set_ylabel(r"kinetic friction  $f_k \,/\, x_{*f}$")
    for source, look in LOOKS.items():
        exact.plot([], [], label=f"{printed('star4')}, {source}", **look)
    literal.set_title("quenched, flow")
    for panel, source in ((left, "printed"), (right, "corrected")):
        power = 1 if source == "printed" else 2
        v = np.array([1e3, 1e4])
        panel.plot(v, 0.3 * (v / 1e3) ** -power, color="0.7", linewidth=2.5, zorder=0)
        panel.annotate(
            f"$v^{{-{power}}}$",
            (1e3, 0.3),
            (-24, -4),
            color="0.4",
            textcoords="offset points",
        )
        panel.set(
            yscale="log", ylim=(1e-9, 1), xlabel=r"velocity  $v \,/\, \omega x_{*f}$"
        )
        panel.set_title(f"{printed('star4')} against the exact curve: {source}")
    left.set_ylabel(r"|approximate / exact $-$ 1|")
    handles, labels = exact.get_legend_handles_labels()
    title = (
        r"$k_BT = k x_{*f}^2$;  $D$ in $\omega x_{*f}^2$;  $x_{*i} = 0.1\, "
        r"x_{*f}$;  markers: simulated contacts"
    )
    figure.legend(handles, labels, loc="outside lower center", ncols=6, title=title)
    figure.align_ylabels()
    return figure
