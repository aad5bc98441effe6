"""Figure A05: shear stress of octamethylcyclotetrasiloxane films of 2 to 6 layers
against the shear rate, and the crossover velocity of each (SI units)."""

import pandas as pd
from matplotlib.figure import Figure

from eqsim.materials import omcts_film

from .common import SCORES_LABEL, SERIES, WIDTH, Curve, draw, log_grid, scores

FILMS = {layers: omcts_film(layers) for layers in range(2, 7)}
STYLES = dict(zip(FILMS, SERIES, strict=False))
DISORDERS = ("annealed", "quenched")


def name(disorder: str, layers: int) -> str:
    """Name of a curve."""
    return f"{disorder}, {layers} layers"


def curves() -> list[Curve]:
    """Curves of both ensembles for all films."""
    return [
        Curve(
            name(disorder, layers),
            film.ensemble(disorder=disorder),
            tuple(film.thickness * rate for rate in log_grid(1e-1, 1e8, 46)),
            tuple(film.thickness * rate for rate in log_grid(1e-1, 1e8, 10)),
        )
        for disorder in DISORDERS
        for layers, film in FILMS.items()
    ]


def formulas(table: pd.DataFrame) -> pd.DataFrame:
    """No rows: there is no closed form."""
    return table.iloc[:0]


def plot(table: pd.DataFrame) -> Figure:
    """One panel per ensemble; the inset holds v_*, which the quenched one does not
    have."""
    film_of = {
        name(disorder, layers): film
        for disorder in DISORDERS
        for layers, film in FILMS.items()
    }
    film = table.curve.map(film_of)
    table = table.assign(
        shear_stress=[
            contacts.shear_stress(f)
            for contacts, f in zip(film, table.friction, strict=True)
        ],
        velocity=[
            v / contacts.thickness
            for contacts, v in zip(film, table.velocity, strict=True)
        ],
    )
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    top, bottom = figure.subplots(
        2, 2, sharex=True, sharey="row", height_ratios=[3.6, 0.8]
    )
    for panel, strip, disorder in zip(top, bottom, DISORDERS, strict=True):
        for layers, style in STYLES.items():
            draw(
                panel,
                table,
                name(disorder, layers),
                style,
                f"{layers} layers",
                y="shear_stress",
            )
        panel.set(xscale="log", yscale="log", ylim=(1, 1e8))
        panel.set_title(
            disorder + (" (published)" if disorder == "annealed" else " (literal)")
        )
        scores(
            strip,
            table,
            {name(disorder, layers): style for layers, style in STYLES.items()},
        )
        strip.set_xlabel(r"shear rate  $\dot\gamma = v/h$  [1/s]")
    inset = top[0].inset_axes((0.15, 0.75, 0.45, 0.17))
    inset.plot(
        list(FILMS),
        [film.crossover_velocity() * 1e6 for film in FILMS.values()],
        "o-",
        color="black",
    )
    inset.set(yscale="log", xticks=list(FILMS), ylim=(10, 500))
    inset.set_xlabel("layers", fontsize=7, labelpad=0)
    inset.set_title(r"$v_*$  [µm/s]", fontsize=7, pad=2)
    inset.tick_params(labelsize=6.5)
    top[0].set_ylabel(r"shear stress  $\sigma = \sigma_* f_k / x_*$  [Pa]")
    bottom[0].set_ylabel(SCORES_LABEL)
    handles, labels = top[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    figure.align_ylabels()
    return figure
