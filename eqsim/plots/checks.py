"""Pictures of borders of stability, of fluctuations, and of a validation."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from eqsim.catalogue import AREA, LENGTH, RATE
from eqsim.plots.panels import DOTS, Caption
from eqsim.plots.style import styled

if TYPE_CHECKING:
    from eqsim.master.chain_modes import Modes
    from eqsim.master.stability import Stability
    from eqsim.master.transient import Fluctuations
    from eqsim.validation import Validation

_FARTHEST = 8.0  # scores beyond so many standard errors are drawn there


@styled
def modes_figure(modes: "Modes", caption: Caption) -> Figure:
    """Draw the growth of perturbations over their wave number, and the softest mode of
    this chain."""
    figure = Figure(figsize=(7, 4.6))
    axes = figure.subplots()
    wave_number, growth = modes.wave_number, modes.growth
    if modes.softest.value is not None:  # the line leads through it
        place = np.searchsorted(wave_number, modes.lowest)
        wave_number = np.insert(wave_number, place, modes.lowest)
        growth = np.insert(growth, place, modes.softest.value)
    axes.plot(wave_number, growth, marker=".", label="perturbations")
    look: dict[str, Any] = {"color": "C3", "alpha": 0.15, "linewidth": 0}
    look |= {"where": growth > 0.0, "interpolate": True, "label": "grow"}
    axes.fill_between(wave_number, 0.0, growth, **look)
    if modes.softest.value is not None:
        label = f"softest mode of this chain, {modes.verdict}"
        axes.plot(modes.lowest, modes.softest.value, "k*", markersize=12, label=label)
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    rate = caption.unit("growth rate", RATE, unknown=True)
    axes.set(xlabel="wave number  $q$  [1/block]", ylabel=rate)
    axes.set_title(caption.heading)
    axes.legend()
    return figure


@styled
def stability_figure(
    found: "Stability", borders: dict[str, Any], caption: Caption
) -> Figure:
    """Draw the critical stiffness over velocity, of steady sliding and of the first
    slip, and the run's own point."""
    figure = Figure(figsize=(7, 5))
    axes = figure.subplots()
    critical = found.critical_stiffness.value, found.fresh.critical_stiffness.value
    names = "critical_stiffness", "fresh_critical_stiffness"
    velocity = np.append(borders.get("velocity", ()), found.velocity)
    order = np.argsort(velocity)
    velocity = velocity[order]
    steady, fresh = (
        np.append(borders.get(name, ()), stiffness or 0.0)[order]
        for name, stiffness in zip(names, critical, strict=True)
    )
    known, shown = (np.isfinite(border) & (border > 0) for border in (steady, fresh))
    line: dict[str, Any] = {"marker": ".", "linewidth": 1.5}
    if known.any():
        label = "steady sliding is unstable below"
        axes.plot(velocity[known], steady[known], color="C3", label=label, **line)
        below = np.where(known, steady, 0)
        axes.fill_between(velocity, 0, below, color="C3", alpha=0.12, linewidth=0)
    if shown.any():
        line |= {"linestyle": "--", "label": "a fresh start jumps below"}
        axes.plot(velocity[shown], fresh[shown], color="C0", **line)
        low = np.where(known, steady, 0.0)
        high = np.maximum(np.where(shown, fresh, 0.0), low)
        axes.fill_between(velocity, low, high, color="C0", alpha=0.12, linewidth=0)
    label = f"this run, {found.verdict}"
    axes.plot([found.velocity], [found.stiffness], "k*", markersize=12, label=label)
    axes.set(xscale="log", yscale="log", xlabel=caption.along("drive.velocity"))
    axes.set_ylabel(caption.along("drive.stage.stiffness"))
    values = np.concatenate((steady[known], fresh[shown], [found.stiffness]))
    axes.set_ylim(0.3 * values.min(), 3.0 * values.max())
    axes.margins(x=0)
    axes.text(0.03, 0.95, "smooth", va="top", transform=axes.transAxes)
    slips = "sticks and slips" if known.any() else "slips at its start"
    axes.text(0.03, 0.04, slips, transform=axes.transAxes)
    axes.set_title(caption.heading)
    axes.legend(loc="best")
    return figure


@styled
def fluctuations_figure(exact: "Fluctuations", sample: Any, caption: Caption) -> Figure:
    """Draw the exact autocovariance over the lag, and that of simulated contacts with
    error bars, if there is a `sample`."""
    figure = Figure(figsize=(8, 4.6))
    axes = figure.subplots()
    axes.axhline(0.0, color="0.6", linewidth=0.7)
    axes.plot(exact.lag, exact.covariance, color="k", label="exact", zorder=3)
    if sample is not None:
        thinned = slice(None, None, max(1, exact.lag.size // 30))
        ensembles = f"{sample.ensembles} ensembles of {sample.contacts} contacts"
        bars: dict[str, Any] = {"label": f"{ensembles} ± 2 standard errors", **DOTS}
        error = 2 * sample.stderr[thinned]
        points = exact.lag[thinned], sample.covariance[thinned], error
        axes.errorbar(*points, color="C0", capsize=2, **bars)
    lag = caption.unit("lag in displacement", LENGTH, unknown=True)
    axes.set(xlabel=lag, xlim=(0, exact.lag[-1]))
    covariance = r"autocovariance  $N\,\mathrm{Cov}(F, F') / (N k)^2$"
    axes.set(ylabel=caption.unit(covariance, AREA))
    axes.set_title(caption.heading)
    axes.legend(loc="upper right")
    return figure


@styled
def validation_figure(result: "Validation") -> Figure:
    """Draw every score of a suite by kind, ensemble by colour, and all of them against
    the normal law."""
    figure = Figure(figsize=(11, 5))
    left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
    kinds = [verdict.kind for verdict in result.verdicts]
    column = np.array([kinds.index(score.kind) for score in result.scores])
    scores = [score.z for score in result.scores]
    z = np.clip(scores, -_FARTHEST, _FARTHEST)
    disorder = np.array([score.ensemble.disorder for score in result.scores])
    jitter = np.random.default_rng(0).uniform(-0.3, 0.3, z.size)
    for name, color, marker in (("quenched", "C0", "o"), ("annealed", "C1", "^")):
        members = disorder == name
        look: dict[str, Any] = {"color": color, "marker": marker, "alpha": 0.6}
        left.scatter((column + jitter)[members], z[members], s=9, label=name, **look)
    said = {True: "passed", False: "FAILED"}
    names = [
        f"{v.kind.replace('_', ' ')}, {v.count}: {said[v.passed]}"
        for v in result.verdicts
    ]
    turned = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
    left.set_xticks(range(len(names)), names, fontsize=8, **turned)
    left.set_xlabel("kind of comparison, how many, verdict")
    left.set_ylabel("$z$ = (engine - master) / standard error")
    left.set_title(f"suite {result.suite}, seed {result.seed}: {said[result.passed]}")
    bins = np.arange(-_FARTHEST, _FARTHEST + 0.5, 0.5)
    across: dict[str, Any] = {"density": True, "orientation": "horizontal"}
    right.hist(z, bins=bins, color="0.8", **across)
    grid = np.linspace(-_FARTHEST, _FARTHEST, 401)
    normal = np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi)
    right.plot(normal, grid, color="k", label="standard normal")
    right.set_xlabel(f"density of all {z.size} scores")
    for axes in (left, right):
        axes.legend(loc="upper right")
        axes.axhline(0, color="0.5", linewidth=0.5)
    left.set_ylim(min(-4.5, z.min() - 0.5), max(4.5, z.max() + 0.5))
    return figure
