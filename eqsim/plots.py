"""Pictures."""

import io
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.engine.steady import Steady
from eqsim.engine.trajectory import Trajectory
from eqsim.estimate import Estimate
from eqsim.laws.octaves import Array


def trajectory_png(run: Trajectory, steady: Steady, title: str) -> bytes:
    """F(X) with its error band and the steady value, and the pinned fraction below where contacts spend time
    detached."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    figure = Figure(figsize=(8, 6 if delayed else 4.6), dpi=150, layout="constrained")
    heights = [2, 1] if delayed else [1]
    panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    top = panels[0, 0]
    handles, labels = [], []
    if run.force_replica_std is not None:
        spread = run.force_replica_std
        handles.append(top.fill_between(run.X, run.force - spread, run.force + spread, color="0.85"))
        labels.append("± standard deviation between replicas")
    handles.append(_curve(top, run.X, run.force, run.force_stderr, "C0"))
    handles.append(_level(top, steady.friction))
    labels += ["particles, mean ± 2 standard errors", "steady value (renewal-reward) ± 2 standard errors"]
    top.set_ylabel("friction force  F / (N k)\n[length unit of the run file]")
    top.set_ylim(bottom=0)
    top.set_title(title, fontsize=10)
    # below the curve there is always room: forces start at 0 or stay near the steady value
    top.legend(handles, labels, loc="lower right", fontsize=8, framealpha=1)
    if delayed:
        low = panels[1, 0]
        _curve(low, run.X, run.pinned, run.pinned_stderr, "C2")
        _level(low, steady.pinned)
        low.set_ylabel("pinned fraction  N_c / N")
        low.set_ylim(0, 1.05)
    panels[-1, 0].set_xlabel("slider displacement  X  [length unit of the run file]")
    panels[-1, 0].set_xlim(run.X[0], run.X[-1])
    for panel in panels[:, 0]:
        panel.grid(alpha=0.3)
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
