"""Pictures."""

import io

from matplotlib.figure import Figure

from eqsim.engine.steady import Steady
from eqsim.engine.trajectory import Trajectory


def trajectory_png(run: Trajectory, steady: Steady, title: str) -> bytes:
    """F(X) with its error band and the steady value, and the pinned fraction below where contacts spend time
    detached."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    figure = Figure(figsize=(8, 6 if delayed else 4.6), dpi=150, layout="constrained")
    panels = figure.subplots(2 if delayed else 1, 1, sharex=True, squeeze=False, height_ratios=[2, 1] if delayed else [1])
    top = panels[0, 0]
    if run.force_replica_std is not None:
        low, high = run.force - run.force_replica_std, run.force + run.force_replica_std
        top.fill_between(run.X, low, high, color="0.85", label="± standard deviation between replicas")
    _curve(top, run.X, run.force, run.force_stderr, "C0", "particles, mean ± 2 standard errors")
    _level(top, steady.friction.value or 0.0, steady.friction.stderr or 0.0, "steady value (renewal-reward) ± 2 s.e.")
    top.set_ylabel("friction force  F / (N k)\n[length unit of the run file]")
    top.set_ylim(bottom=0)
    top.set_title(title, fontsize=10)
    # below the curve there is always room: forces start at 0 or stay near the steady value
    top.legend(loc="lower right", fontsize=8, framealpha=1)
    if delayed:
        low = panels[1, 0]
        _curve(low, run.X, run.pinned, run.pinned_stderr, "C2", None)
        _level(low, steady.pinned.value or 0.0, steady.pinned.stderr or 0.0, None)
        low.set_ylabel("pinned fraction  N_c / N")
        low.set_ylim(0, 1.05)
    panels[-1, 0].set_xlabel("slider displacement  X  [length unit of the run file]")
    panels[-1, 0].set_xlim(run.X[0], run.X[-1])
    for panel in panels[:, 0]:
        panel.grid(alpha=0.3)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": "eqsim"})
    return buffer.getvalue()


def _curve(axes, x, y, stderr, color: str, label: str | None) -> None:  # type: ignore[no-untyped-def]
    axes.fill_between(x, y - 2 * stderr, y + 2 * stderr, color=color, alpha=0.3, linewidth=0)
    axes.plot(x, y, color=color, linewidth=1, label=label)


def _level(axes, value: float, stderr: float, label: str | None) -> None:  # type: ignore[no-untyped-def]
    axes.axhspan(value - 2 * stderr, value + 2 * stderr, color="C3", alpha=0.25, linewidth=0)
    axes.axhline(value, color="C3", linewidth=1, linestyle="--", label=label)
