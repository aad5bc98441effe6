"""Pictures."""

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.engine.steady import Steady
from eqsim.engine.trajectory import Trajectory
from eqsim.estimate import Estimate
from eqsim.laws.octaves import Array
from eqsim.master.transient import Transient
from eqsim.validation import Validation


def trajectory_png(run: Trajectory, steady: Steady, exact: Transient | None, title: str) -> bytes:
    """F(X) with its error band, the exact mean over it and the steady value; below, the difference from the exact mean
    in standard errors, and the pinned fraction where contacts spend time detached."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    heights = [2.6] + [1.0] * ((exact is not None) + delayed)
    figure = Figure(figsize=(8, 2 + sum(heights)), dpi=150, layout="constrained")
    panels = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    top = panels[0]
    handles, labels = [], []
    if run.force_replica_std is not None:
        spread = run.force_replica_std
        handles.append(top.fill_between(run.X, run.force - spread, run.force + spread, color="0.85"))
        labels.append("± standard deviation between replicas")
    handles.append(_curve(top, run.X, run.force, run.force_stderr, "C0"))
    handles.append(_level(top, steady.friction))
    labels += ["particles, mean ± 2 standard errors", "steady value (renewal-reward) ± 2 standard errors"]
    if exact is not None:
        handles.append(top.plot(run.X, exact.force, color="k", linewidth=0.8, linestyle=":")[0])
        labels.append("exact mean (renewal equation)")
        below = panels[1]
        sigma = np.hypot(run.force_stderr, exact.force_error)
        z = np.divide(run.force - exact.force, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        below.axhspan(-2, 2, color="0.9")
        below.plot(run.X, z, color="C0", linewidth=0.8)
        below.set_ylim(-max(4.0, 1.1 * np.abs(z).max()), max(4.0, 1.1 * np.abs(z).max()))
        below.set_ylabel("difference\n[standard errors]")
    top.set_ylabel("friction force  F / (N k)\n[length unit of the run file]")
    top.set_ylim(bottom=0)
    top.set_title(title, fontsize=10)
    # below the curve there is always room: forces start at 0 or stay near the steady value
    top.legend(handles, labels, loc="lower right", fontsize=8, framealpha=1)
    if delayed:
        last = panels[-1]
        _curve(last, run.X, run.pinned, run.pinned_stderr, "C2")
        _level(last, steady.pinned)
        if exact is not None:
            last.plot(run.X, exact.pinned, color="k", linewidth=0.8, linestyle=":")
        last.set_ylabel("pinned fraction\nN_c / N")
        last.set_ylim(0, 1.05)
    panels[-1].set_xlabel("slider displacement  X  [length unit of the run file]")
    panels[-1].set_xlim(run.X[0], run.X[-1])
    figure.align_ylabels(panels)
    for panel in panels:
        panel.grid(alpha=0.3)
    return _png(figure)


def validation_png(result: Validation) -> bytes:
    """Every score of a suite by kind, ensemble by colour, and all of them against the normal law."""
    figure = Figure(figsize=(11, 5), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
    rng = np.random.default_rng(0)
    styles = {"quenched": ("C0", "o"), "annealed": ("C1", "^")}
    for disorder, (color, marker) in styles.items():
        shown = [score for score in result.scores if score.ensemble.disorder == disorder]
        x = [[v.kind for v in result.verdicts].index(score.kind) for score in shown] + rng.uniform(
            -0.3, 0.3, len(shown)
        )
        z = np.clip([score.z for score in shown], -8, 8)
        left.scatter(x, z, s=9, color=color, marker=marker, alpha=0.6, label=disorder)
    names = [f"{v.kind}\n{v.count} scores\n{'passed' if v.passed else 'FAILED'}" for v in result.verdicts]
    left.set_xticks(range(len(names)), names, fontsize=8)
    left.set_ylabel("z = (engine - master) / standard error")
    left.set_title(f"suite {result.suite}, seed {result.seed}: {'passed' if result.passed else 'FAILED'}", fontsize=10)
    left.legend(fontsize=8, loc="upper right")
    grid = np.linspace(-8, 8, 401)
    every = np.clip([score.z for score in result.scores], -8, 8)
    right.hist(every, bins=np.arange(-8, 8.5, 0.5), density=True, orientation="horizontal", color="0.8")
    right.plot(np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), grid, color="k", linewidth=1, label="standard normal")
    right.set_xlabel(f"density of all {every.size} scores")
    right.legend(fontsize=8, loc="upper right")
    for axes in (left, right):
        axes.axhline(0, color="0.5", linewidth=0.5)
        axes.grid(alpha=0.3)
    low, high = min(-4.5, every.min() - 0.5), max(4.5, every.max() + 0.5)
    left.set_ylim(low, high)
    return _png(figure)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": "eqsim"})
    return buffer.getvalue()


def _curve(axes: Axes, x: Array, y: Array, stderr: Array, color: str) -> Any:
    band = axes.fill_between(x, y - 2 * stderr, y + 2 * stderr, color=color, alpha=0.3, linewidth=0)
    return band, axes.plot(x, y, color=color, linewidth=1)[0]


def _level(axes: Axes, estimate: Estimate) -> Any:
    value, stderr = estimate.value or 0.0, estimate.stderr or 0.0
    band = axes.axhspan(value - 2 * stderr, value + 2 * stderr, color="C3", alpha=0.25, linewidth=0)
    return band, axes.axhline(value, color="C3", linewidth=1, linestyle="--")
