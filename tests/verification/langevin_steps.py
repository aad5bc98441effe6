"""A study: how the error of `langevin` lives goes with the accuracy of their steps
(`step` of `eqsim.engine.langevin`).

Lives drawn with step = 0.2, 0.35 (the default), 0.5 and 0.7 against the Fokker-Planck
equation, from thresholds that hardly fluctuate to ones that fluctuate a hundred times
faster than the slider moves: relative errors of friction and of the mean stretch at
breaking, with standard errors. `python tests/verification/langevin_steps.py` writes
langevin_steps.png and langevin_steps.parquet.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure
from rich.progress import track
from scipy.stats import qmc

from eqsim import Aging, Drive, Ensemble, Gamma, Thermal, reference
from eqsim.engine.contacts import contacts
from eqsim.engine.langevin import STEP
from eqsim.engine.sample import Source, lives
from eqsim.numerics.streams import key

STEPS = (0.2, STEP, 0.5, 0.7)
RANDOMISATIONS = 32
NEWBORN, FINAL = 0.1, 1.0
CASES = {  # kT/(k x_*i^2), stiffness law, barrier, and D/(v x_*f)
    "T = 0, uniform": (
        0.0,
        "uniform",
        "soft",
        (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0),
    ),
    "kT = k x_*i^2, uniform, soft": (1.0, "uniform", "soft", (1e-4, 1e-2, 1.0, 100.0)),
    "kT = k x_*i^2, uniform, stiff": (
        1.0,
        "uniform",
        "stiff",
        (1e-4, 1e-2, 1.0, 100.0),
    ),
    "kT = 0.1 k x_*i^2, sqrt, soft": (0.1, "sqrt", "soft", (1e-4, 1e-2, 1.0, 100.0)),
}


def ensemble(case: str, D_v: float) -> Ensemble:
    """x_*i = 0.1, x_*f = 1, n = 1, k = omega = v = 1."""
    kT, law, barrier, _ = CASES[case]
    return Ensemble(
        Gamma(1.0, NEWBORN),
        Thermal(kT * NEWBORN**2, 1.0, barrier),
        aging=Aging("langevin", D_v * FINAL, FINAL),
        stiffness_law=law,
    )


def measured(
    ages: Ensemble, step: float, size: int, seed: int
) -> tuple[np.ndarray, float]:
    """Mean work over k and mean stretch at breaking in units of x_*i, shape
    (RANDOMISATIONS, 2), from scrambled Sobol births and independent paths; and seconds
    that a life takes."""
    c = contacts(ages, 1.0)
    lives(c, Source(key(0, 0), 0, step), *np.full((2, 1), 0.5))  # compiles

    def one(index: int) -> tuple[float, float, float]:
        u, clock = (
            qmc.Sobol(2, rng=np.random.default_rng((seed, index))).random(size)
            + 2.0**-31
        ).T
        begin = time.thread_time()
        work, stretch, *_ = lives(c, Source(key(seed, index), 0, step), u, clock)
        return work.mean(), stretch.mean(), (time.thread_time() - begin) / size

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = np.array(list(pool.map(one, range(RANDOMISATIONS))))
    return found[:, :2], float(found[:, 2].mean())


def table(size: int) -> pd.DataFrame:
    """One row per case, D_v and step: errors relative to the reference, with both
    standard errors in quadrature, and lives per second of one core's time; `size` lives
    of each randomisation."""
    jobs = [
        (case, D_v, step)
        for case, (*_, rates) in CASES.items()
        for D_v in rates
        for step in STEPS
    ]
    rows = []
    for seed, (case, D_v, step) in enumerate(track(jobs, description="drawing lives")):
        ages = ensemble(case, D_v)
        exact = reference(ages, Drive(1.0))
        means, seconds = measured(ages, step, size, seed)
        work, stretch = means.T
        found = {
            "friction": (
                means[:, 0].mean() / stretch.mean(),
                (work / work.mean() - stretch / stretch.mean()),
            ),
            "break_stretch": (stretch.mean(), stretch / stretch.mean() - 1),
        }
        row = {"case": case, "D_v": D_v, "step": step, "lives": size * RANDOMISATIONS}
        for name, (value, scatter) in found.items():
            theirs = getattr(exact, name)
            row[f"{name}_error"] = value * NEWBORN / theirs.value - 1
            row[f"{name}_stderr"] = np.hypot(
                scatter.std(ddof=1) / np.sqrt(RANDOMISATIONS),
                theirs.stderr / theirs.value,
            )
        rows.append(row | {"lives_per_second": 1.0 / seconds})
    return pd.DataFrame(rows)


def picture(frame: pd.DataFrame) -> Figure:
    """Errors against step, one column per case and one row per observable, in per
    mille."""
    figure = Figure(figsize=(14, 6.4), dpi=150, layout="constrained")
    panels = figure.subplots(2, len(CASES), sharex=True, sharey="row")
    for column, case in zip(panels.T, CASES, strict=True):
        of_case = frame[frame.case == case]
        rates = sorted(of_case.D_v.unique())
        for axes, name in zip(column, ("friction", "break_stretch"), strict=True):
            axes.axhspan(-1, 1, color="0.92")
            axes.axhline(0, color="0.5", linewidth=0.5)
            axes.axvline(STEP, color="0.5", linewidth=0.5, linestyle="--")
            for index, D_v in enumerate(rates):
                rows = of_case[of_case.D_v == D_v]
                # so that error bars stay apart
                aside = rows.step + 0.012 * (index - (len(rates) - 1) / 2)
                axes.errorbar(
                    aside,
                    1e3 * rows[f"{name}_error"],
                    1e3 * rows[f"{name}_stderr"],
                    marker="o",
                    markersize=3,
                    linewidth=0.8,
                    color=f"C{round(np.log10(D_v)) + 4}",
                    label=f"D/(v x_*f) = {D_v:g}",
                )
        column[0].set_title(case, fontsize=10)
        column[1].set_xlabel("step")
    for axes, name in zip(panels[:, 0], ("friction", "break_stretch"), strict=True):
        axes.set_ylabel(f"relative error of {name}\n[per mille]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(handles), fontsize=8
    )
    return figure


def main(
    out: Annotated[
        Path, typer.Option(help="Folder for the picture and the table.")
    ] = Path("runs/out/verification"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer lives: error bars twice as long.")
    ] = False,
) -> None:
    """Draw lives, save, draw the picture, say what the default is worth."""
    out.mkdir(parents=True, exist_ok=True)
    frame = table(2**12 if quick else 2**14)
    frame.to_parquet(out / "langevin_steps.parquet", index=False)
    picture(frame).savefig(out / "langevin_steps.png")
    default = frame[frame.step == STEP]
    for name in ("friction", "break_stretch"):
        worst = default.loc[default[f"{name}_error"].abs().idxmax()]
        upper = (default[f"{name}_error"].abs() + 2 * default[f"{name}_stderr"]).max()
        print(
            f"{name}, step {STEP}: largest error {worst[f'{name}_error']:+.1e} ± {worst[f'{name}_stderr']:.1e} "
            f"({worst.case}, D_v = {worst.D_v:g}); all errors, two standard errors included, within {upper:.1e}"
        )
    bound = (default.friction_error.abs() + 2 * default.friction_stderr).max()
    print(
        "the bias of friction is "
        + ("below 1e-3 everywhere" if bound < 1e-3 else "not shown to be below 1e-3")
    )
    speed = default[
        (default.case == "T = 0, uniform") & (default.D_v == 0.1)
    ].lives_per_second.item()
    print(f"{speed:.2g} lives per second and core at D_v = 0.1, T = 0")


if __name__ == "__main__":
    typer.run(main)
