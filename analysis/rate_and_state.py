"""Find a, b and D_c of rate-and-state friction that contacts have.

    python -m analysis.rate_and_state

prints a table and draws `rate-and-state-contacts.png`: warm contacts, with and without
strengthening as ln t, over velocity and temperature, in three ways.

- Derivatives of steady friction f(v, t_c), t_c the cutoff time of aging. Contacts of a
  given strength at each stretch have v t_c fixed; so a = d f/d ln v at fixed v t_c, and
  b = -d f/d ln t_c is what strength loses, with a - b = d f/d ln v (derived).
- The exact force after a step of the velocity by a factor 1.65, a rigid slider: a is
  the peak above the level before, a - b the level after, over ln 1.65, and the memory
  the path on which the way from the peak to the level after falls to 1/e.
- A fit of rate-and-state friction (slip law) to this force, by which a laboratory would
  describe it; k, free, is then the stiffness of the contacts. Errors are those for which
  chi-square would be what it should.

All in units of f; lengths in x_*. Beside them, what Harpers et al. (2024) measured.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure

from eqsim import (
    Aging,
    Drive,
    Ensemble,
    Programme,
    Segment,
    Thermal,
    reference,
    transient,
)
from eqsim.fitting import estimate
from eqsim.fitting import rate_and_state as rates
from eqsim.fitting.data import MeasuredAt, Measurements
from eqsim.io.runfile import check
from eqsim.plots import style

MEASURED = Path(__file__).parent / "data" / "harpers-2024-velocity-steps.csv"
TEMPERATURES = (0.02, 0.05, 0.2)  # kT in k x_*^2
VELOCITIES = (1e-4, 1e-3, 1e-2, 1e-1)  # in omega x_*
BETAS = (0.0, 0.01)  # of aging; measured b over mu is about 0.01
CUTOFF_TIME = 10.0  # of aging, in 1/omega
STEP = 0.5  # of ln v
DIFFERENCE = 0.1  # of ln v, of derivatives
PATH = 6.0  # after the step, in x_*


def contacts(kT: float, beta: float, cutoff_time: float = CUTOFF_TIME) -> Ensemble:
    """Quenched contacts of equal stiffness, n = 0."""
    aging = Aging("logarithmic", beta=beta, cutoff_time=cutoff_time)
    return Ensemble(
        thermal=Thermal(kT),
        stiffness_law="uniform",
        aging=aging if beta else Aging(),
    )


def by_derivative(kT: float, beta: float, v: float) -> dict[str, float]:
    """a and b by derivatives of steady friction, over friction."""

    def friction(log_v: float, log_cutoff: float) -> float:
        ensemble = contacts(kT, beta, CUTOFF_TIME * math.exp(log_cutoff))
        found = reference(ensemble, Drive(v * math.exp(log_v))).friction.value
        assert found is not None  # it does not diverge
        return found

    h, f = DIFFERENCE, friction(0.0, 0.0)
    direct = (friction(h, -h) - friction(-h, h)) / (2 * h * f)
    whole = (friction(h, 0.0) - friction(-h, 0.0)) / (2 * h * f)
    return {"f": f, "a": direct, "b": direct - whole, "a-b": whole}


def step_of(v: float) -> Programme:
    """A step of the velocity, from steady sliding."""
    before = Segment(v, distance=0.5, points=10)
    after = Segment(v * math.exp(STEP), distance=PATH, points=240)
    return Programme([before, after], "stationary", v)


def by_step(X: np.ndarray, f: np.ndarray) -> dict[str, float]:
    """a, b and memory of the force after a step, over friction before."""
    change = (f / f[0] - 1.0) / STEP
    after = X >= 0.5
    x, y = X[after] - 0.5, change[after]
    top, level = int(np.argmax(y)), float(y[-1])
    peak, way = float(y[top]), (y[top:] - level) / (y[top] - level)
    below = int(np.argmax(way < 1.0 / math.e))
    last = slice(below - 1, below + 1)
    memory = float(np.interp(-1.0 / math.e, -way[last], x[top:][last]) - x[top])
    return {"a": peak, "b": peak - level, "a-b": level, "D_c": memory}


def by_fit(X: np.ndarray, f: np.ndarray) -> dict[str, float]:
    """a, b, D_c and k of a fit to the force after a step, over friction before, their
    standard deviations, and the root of the mean squared misfit over a."""
    moving = [
        {"velocity": 1.0, "distance": 0.5},
        {"velocity": math.exp(STEP), "distance": PATH},
    ]
    drive = {"start": "stationary", "velocity": 1.0, "programme": moving}
    t = np.interp(
        X, [0.0, 0.5, 0.5 + PATH], np.cumsum([0.0, 0.5, PATH / math.exp(STEP)])
    )
    sigma = np.full(t.size, 1e-3)
    rows, names = [MeasuredAt()] * t.size, ["friction"] * t.size
    table = Measurements(rows, names, f / f[0], sigma, [], "", t)
    problem = rates.problem_of(check({"drive": drive}), table, "slip", {})
    ends = [estimate.minimise(problem, u) for u in estimate.starts(problem, 8, 1)]
    best = min(ends, key=lambda one: one.chi2)
    values = problem.values(best.u)
    misfit = 1e-3 * math.sqrt(best.chi2 / (t.size - len(problem.parameters)))
    spread = estimate.covariance(problem.jacobian(best.u)) * (misfit / 1e-3) ** 2
    sd = dict(zip(problem.keys, np.sqrt(np.diag(spread)), strict=True))
    found = {key: values[key] for key in ("a", "b", "D_c", "k")}
    found |= {f"{key}_sd": values[key] * sd[key] for key in found}
    return found | {"a-b": values["a"] - values["b"], "misfit": misfit / values["a"]}


def row(case: tuple[float, float, float]) -> dict[str, float]:
    """Everything about contacts with an aging of beta, at a temperature and velocity."""
    beta, kT, v = case
    exact = transient(contacts(kT, beta), step_of(v))
    named = {"beta": beta, "kT": kT, "v": v}
    for name, found in (
        ("derivative", by_derivative(kT, beta, v)),
        ("step", by_step(exact.X, exact.force)),
        ("fit", by_fit(exact.X, exact.force)),
    ):
        named |= {f"{name} {key}": value for key, value in found.items()}
    return named


def measured() -> pd.DataFrame:
    """Measured a, b and D_c, a and b over friction."""
    found = pd.read_csv(MEASURED, comment="#")
    return found.assign(a=found.a / found.mu_0, b=found.b / found.mu_0)


METHODS: dict[str, dict[str, Any]] = {
    "derivative": {"linestyle": ":"},
    "step": {"linestyle": "-", "marker": "o", "markersize": 4},
    "fit": {"linestyle": "none", "marker": "x", "markersize": 6},
}
LABELS = {"a": "a / f", "b": "b / f", "D_c": "$D_c$ or memory / $x_*$"}


@style.styled
def draw(found: pd.DataFrame, laboratory: pd.DataFrame) -> Figure:
    """a, b and D_c over velocity, without and with aging."""
    figure = Figure(figsize=(8, 8))
    panels: Any = figure.subplots(3, 2, sharex=True, sharey="row")
    for (column, beta), (line, name) in product(enumerate(BETAS), enumerate(LABELS)):
        axes = panels[line, column]
        if name != "D_c":
            low, high = laboratory[name].quantile([0.1, 0.9])
            axes.axhspan(low, high, color="0.85", label="granite (10 to 90 %)")
        for (number, kT), (method, look) in product(
            enumerate(TEMPERATURES), METHODS.items()
        ):
            part = found[(found.beta == beta) & (found.kT == kT)]
            if f"{method} {name}" not in part:
                continue
            error = part[f"fit {name}_sd"] if method == "fit" else None
            label = f"{method}, kT = {kT:g}"
            given = {"yerr": error, "label": label, "color": f"C{number}", **look}
            axes.errorbar(part.v, part[f"{method} {name}"], **given)
        axes.set(xscale="log", yscale="linear" if name == "D_c" else "log")
        if not column:
            axes.set_ylabel(LABELS[name])
        if name == "D_c":
            axes.set_xlabel(r"velocity  $v/(\omega x_*)$")
    for axes, beta in zip(panels[0], BETAS, strict=True):
        axes.set_title(f"aging: beta = {beta:g}" if beta else "no aging")
    panels[2, 0].set_ylim(bottom=0.0)
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=4, loc="outside lower center", frameon=False)
    return figure


def main(
    out: Annotated[Path, typer.Option(help="folder of the picture")] = Path(),
    workers: Annotated[int, typer.Option(help="processes")] = 2,
) -> None:
    """Compute, print and draw."""
    cases = list(product(BETAS, TEMPERATURES, VELOCITIES))
    with ProcessPoolExecutor(workers) as executor:
        found = pd.DataFrame(executor.map(row, cases))
    laboratory = measured()
    shown = [name for name in found if not name.endswith("_sd")]
    print(found[shown].to_string(index=False, float_format=lambda x: f"{x:.3g}"))
    fitted = ["a", "b", "D_c", "k"]
    worst = (
        found[[f"fit {x}_sd" for x in fitted]].values
        / found[[f"fit {x}" for x in fitted]].values
    ).max()
    print(f"standard deviations of fits: at most {worst:.0%} of a, b, D_c and k")
    print("granite, a/mu_0, b/mu_0 and D_c [um]: 10, 50 and 90 % of 149 steps")
    print(
        laboratory[["a", "b", "D_c_um"]]
        .quantile([0.1, 0.5, 0.9])
        .to_string(float_format=lambda x: f"{x:.3g}")
    )
    (out / "rate-and-state-contacts.png").write_bytes(
        style.saved(draw(found, laboratory))
    )


if __name__ == "__main__":
    typer.run(main)
