"""Maximum of kinetic friction against velocity that aging makes (Braun and Peyrard,
2011, section IV).

f_k(v) at kT = k x_*f^2 (soft, uniform, n = 1, x_*i = 0.1, x_*f = 1, omega = k = 1) for
D = 1, 0.1 and 0.01, of annealed contacts (the published master equation) and of literal
ones whose thresholds `flow` or fluctuate (`langevin`): at low velocity heat breaks
contacts before they carry much, at high velocity they have no time to age. Curves and
maxima come from the references, and a steady estimate from particles confirms each
maximum: `python -m analysis.aging_maximum` writes aging_maximum.png,
aging_maximum.parquet (curves) and aging_maximum_peaks.parquet.
"""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from rich.progress import track
from scipy import optimize

from eqsim import Aging, Drive, Ensemble, Gamma, Thermal, reference, steady, z_score
from eqsim.plots import style

MODELS = ("annealed", "flow", "langevin")
RATES = (1.0, 0.1, 0.01)
LOW, HIGH = 1e-4, 1e3  # velocities


def ensemble(model: str, D: float) -> Ensemble:
    """Contacts of one of the MODELS; without delay f_k is the friction."""
    rule, disorder = (
        ("flow", "annealed") if model == "annealed" else (model, "quenched")
    )
    return Ensemble(
        Gamma(1.0, 0.1),
        Thermal(kT=1.0),
        aging=Aging(rule, D, 1.0),
        stiffness_law="uniform",
        disorder=disorder,
    )


def curves(points: int) -> pd.DataFrame:
    """One row per model, D and velocity: f_k and the error of the reference."""
    jobs = [
        (model, D, v)
        for model in MODELS
        for D in RATES
        for v in np.geomspace(LOW, HIGH, points)
    ]
    rows = []
    for model, D, v in track(jobs, description="solving"):
        f_k = reference(ensemble(model, D), Drive(v)).f_k
        rows.append(
            {
                "model": model,
                "D": D,
                "velocity": v,
                "f_k": f_k.value,
                "error": f_k.stderr,
            }
        )
    return pd.DataFrame(rows)


def peaks(frame: pd.DataFrame, rel_error: float) -> pd.DataFrame:
    """One row per curve, of its maximum: velocity, height and error of the reference,
    the estimate of particles there, z, by how many per cent friction is lower at the
    ends of the curve, and whether the maximum lies inside."""
    rows = []
    for model, D in track(
        [(model, D) for model in MODELS for D in RATES], description="maxima"
    ):
        contacts = ensemble(model, D)
        curve = frame[(frame.model == model) & (frame.D == D)]
        best = int(curve.f_k.to_numpy().argmax())
        inside = 0 < best < len(curve) - 1
        v = float(curve.velocity.iloc[best])
        if inside:
            bounds = np.log(curve.velocity.iloc[[best - 1, best + 1]])
            v = math.exp(
                optimize.minimize_scalar(
                    lambda log_v, e=contacts: (
                        -reference(e, Drive(math.exp(log_v))).f_k.value
                    ),
                    bounds=bounds,
                    method="bounded",
                    options={"xatol": 1e-3},
                ).x
            )
        exact = reference(contacts, Drive(v)).f_k
        particles = steady(
            contacts,
            Drive(v),
            rel_error=1e-3 if model == "langevin" else rel_error,
            threads=2,
        ).friction
        rows.append(
            {
                "model": model,
                "D": D,
                "velocity": v,
                "f_k": exact.value,
                "error": exact.stderr,
                "particles": particles.value,
                "particles_stderr": particles.stderr,
                "z": z_score(particles, exact.value, exact.stderr),
                "fall_low": 100 * (1 - curve.f_k.iloc[0] / exact.value),
                "fall_high": 100 * (1 - curve.f_k.iloc[-1] / exact.value),
                "maximum": inside,
            }
        )
    return pd.DataFrame(rows)


@style.styled
def picture(frame: pd.DataFrame, maxima: pd.DataFrame) -> Figure:
    """f_k(v), one panel per D, with the particles' estimates at the maxima."""
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    panels = figure.subplots(1, len(RATES), sharex=True)
    for axes, D in zip(panels, RATES, strict=True):
        for color, marker, model in zip(
            (style.ORANGE, style.BLUE, style.GREEN), "^os", MODELS, strict=True
        ):
            curve = frame[(frame.model == model) & (frame.D == D)]
            top = maxima[(maxima.model == model) & (maxima.D == D)]
            drawn = pd.concat((curve, top)).sort_values("velocity")
            axes.plot(
                drawn.velocity, drawn.f_k, color=color, linewidth=1.2, label=model
            )
            axes.errorbar(
                top.velocity,
                top.particles,
                2 * top.particles_stderr,
                fmt=marker,
                color=color,
                markersize=8,
                markerfacecolor="none",
                capsize=3,
                label=f"{model}, particles",
            )
        axes.set(
            xscale="log",
            xlabel=r"velocity  $v / (\omega x_{*f})$",
            title=rf"$D = {D:g}\,\omega x_{{*f}}^2$",
        )
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel(r"$f_k / (k x_{*f})$")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9)
    return figure


def main(
    out: Annotated[
        Path, typer.Option(help="Folder for the picture and the tables.")
    ] = Path("analysis/out"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer velocities, larger errors.")
    ] = False,
) -> None:
    """Solve, find the maxima, confirm them, save, draw."""
    out.mkdir(parents=True, exist_ok=True)
    frame = curves(15 if quick else 43)
    frame.to_parquet(out / "aging_maximum.parquet", index=False)
    maxima = peaks(frame, 1e-3 if quick else 1e-4)
    maxima.to_parquet(out / "aging_maximum_peaks.parquet", index=False)
    (out / "aging_maximum.png").write_bytes(style.saved(picture(frame, maxima)))
    for row in maxima.itertuples():
        print(
            f"{row.model:9} D = {row.D:<5g} "
            + (
                f"maximum at v = {row.velocity:.4g}"
                if row.maximum
                else "no maximum inside the curve"
            )
            + f": f_k = {row.f_k:.7g} ± {row.error:.1g}, particles "
            f"{row.particles:.6g} ± {row.particles_stderr:.1g} "
            f"(z = {row.z:+.2f}); {row.fall_low:.1f} % lower at v = {LOW:g}, "
            f"{row.fall_high:.1f} % at v = {HIGH:g}"
        )


if __name__ == "__main__":
    typer.run(main)
