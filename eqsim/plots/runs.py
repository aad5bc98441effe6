"""Pictures of runs and of exact curves."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.catalogue import LENGTH, TIME, VELOCITY
from eqsim.estimate import Estimate
from eqsim.io.labels import unit_text
from eqsim.numerics.tables import Array
from eqsim.plots.panels import (
    EXACT,
    Caption,
    draw_difference,
    draw_sizes,
    legend_below,
)
from eqsim.plots.style import styled, wrapped
from eqsim.results import draw_band

if TYPE_CHECKING:
    from eqsim.engine.records import ProgrammeTrajectory, SliderTrajectory, Trajectory
    from eqsim.engine.steady import Steady
    from eqsim.master.programme import Transient
    from eqsim.model.healing import Healing

# A slider faster than so many times the stage has a logarithmic axis of velocity.
_FAST = 3.0
_MOST_HOLDS = 4  # holds of a programme that have panels of their own
_MOST_MARKS = 60  # segments or slips that are marked
# Mean stretches at breaking that a panel of the transient shows, if the run is longer
# than that by a factor of `_LONG_RUN`.
_FIRST_THRESHOLDS = 6.0
_LONG_RUN = 4.0
# What pulls a slider in a legend, and what else has the same line.
_PULLS = {
    "stage": ("force of the spring", "; displacement of the stage"),
    "force": ("driving force", ""),
    "motor": ("force of the motor", ""),
}
_MEAN = "exact mean (renewal equation)"
_STEADY = "steady value (renewal-reward), ± 2 standard errors"


@styled
def trajectory_figure(
    run: "Trajectory", steady: "Steady", exact: "Transient | None", caption: Caption
) -> Figure:
    """Draw F(X) with its error band, the exact mean over it and the steady value;
    below, the difference from the exact mean in standard errors, and the pinned
    fraction where contacts spend time detached. Of a long run the first thresholds have
    panels of their own."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    heights = [2.6] + [1.0] * ((exact is not None) + delayed)
    first = _FIRST_THRESHOLDS * (steady.break_stretch.value or 0.0)
    several = np.count_nonzero(first > run.X) > 10 and _LONG_RUN * first < run.X[-1]
    wide = [1.0, 2.0] if several else [1.0]
    figure = Figure(figsize=(9, 2.3 + sum(heights)))
    grid: dict[str, Any] = {"sharex": "col", "sharey": "row", "squeeze": False}
    ratios: dict[str, Any] = {"height_ratios": heights, "width_ratios": wide}
    columns = figure.subplots(len(heights), len(wide), **grid, **ratios).T
    names = {"force": f"force: {caption.band}" if delayed else caption.band}
    names["pinned"] = "pinned fraction"
    drawn: dict[str, Any] = {}
    for panels in columns:
        drawn |= replica_spread(panels[0], run.X, run)
        looks = [(panels[0], "force", "C0", steady.friction)]
        looks += [(panels[-1], "pinned", "C2", steady.pinned)] if delayed else []
        for panel, name, color, level in looks:
            course = _draw_course(panel, run.X, run, exact, name, color=color)
            drawn |= {names[name]: course.pop(""), _STEADY: _draw_steady(panel, level)}
            drawn |= course
        if exact is not None:
            draw_difference(panels[1], run.X, run, exact)
        panels[-1].set(xlim=(run.X[0], run.X[-1]))
    left = columns[0]
    if several:
        left[-1].set(xlim=(0.0, first), xlabel=caption.unit("$X$"))
        left[0].set_title("the first thresholds")
        columns[1][0].set_title("the whole run")
        for panel in columns[1]:
            panel.set_ylabel("")
    columns[-1][-1].set_xlabel(caption.along("X"))
    left[0].set(ylabel=caption.force)
    if run.force.min() >= 0:
        left[0].set_ylim(bottom=0)
    if delayed:
        left[-1].set(ylabel="pinned fraction\n$N_c / N$", ylim=(0, 1.05))
    caption.beside(columns[-1][0])
    figure.suptitle(caption.heading)
    legend_below(figure, drawn)
    figure.align_ylabels(list(left))
    return figure


def replica_spread(axes: Axes, x: Array, run: Any) -> dict[str, Any]:
    """Draw how much replicas differ, if there are several; return legend entries."""
    if run.force_replica_std is None:
        return {}
    low, high = (run.force + sign * run.force_replica_std for sign in (-1, 1))
    band = axes.fill_between(x, low, high, color="0.85", linewidth=0)
    return {"± standard deviation between replicas": band}


def _draw_course(
    axes: Axes,
    x: Array,
    run: Any,
    exact: "Transient | None",
    name: str = "force",
    here: Any = slice(None),
    **look: Any,
) -> dict[str, Any]:
    """Draw a column of a run with its error band, and the exact mean; return legend
    entries."""
    y, error = getattr(run, name)[here], 2 * getattr(run, f"{name}_stderr")[here]
    drawn: dict[str, Any] = {"": draw_band(axes, x[here], y, error, **look)}
    if exact is not None:
        drawn[_MEAN] = axes.plot(x[here], getattr(exact, name)[here], **EXACT)[0]
    return drawn


def _draw_steady(axes: Axes, steady: Estimate) -> Any:
    """Draw the steady value with its error; return both for a legend."""
    value, stderr = steady.value or 0.0, 2 * (steady.stderr or 0.0)
    span: dict[str, Any] = {"color": "C3", "alpha": 0.25, "linewidth": 0}
    band = axes.axhspan(value - stderr, value + stderr, **span)
    return band, axes.axhline(value, color="C3", linestyle="--")


@styled
def programme_figure(
    run: "ProgrammeTrajectory", exact: "Transient | None", caption: Caption
) -> Figure:
    """Draw F along a programme with its error band and the exact mean, against t with
    the segments marked, and against X; each hold of several records in a panel of its
    own, where time begins anew and is logarithmic; and the difference from the exact
    mean in standard errors."""
    records = np.bincount(run.segment[1:], minlength=len(run.segments))
    held = np.array([segment.velocity == 0 for segment in run.segments])
    holds = np.flatnonzero(held & (records > 1))[:_MOST_HOLDS].tolist()
    rows = [2.2, 2.2] + [1.0] * (exact is not None)
    figure = Figure(figsize=(9, 2.2 + sum(rows) + 2.4 * bool(holds)))
    upper: Any = figure
    below: Any = ()
    if holds:
        parts: Any = figure.subfigures(2, 1, height_ratios=[sum(rows), 2.4])
        upper, lower = parts
        below = lower.subplots(1, len(holds), squeeze=False, sharey=True)[0]
    force, curve, *differences = upper.subplots(len(rows), 1, height_ratios=rows)
    drawn = _draw_course(force, run.t, run, exact)
    drawn = {caption.band: drawn.pop(""), **drawn}
    force.set_title(caption.heading)
    _draw_course(curve, run.X, run, exact)
    curve.set(xlabel=caption.along("X"))
    for panel in (force, curve):
        panel.set_ylabel(caption.force)
        caption.beside(panel)
    for panel in differences:
        draw_difference(panel, run.t, run, exact)
    for panel in (force, *differences):
        panel.set(xlabel=caption.along("time"), xlim=(run.t[0], run.t[-1]))
        for segment in run.segments[:-1] if len(run.segments) <= _MOST_MARKS else ():
            line = panel.axvline(segment.t, color="0.6", linewidth=0.7)
            drawn["ends of segments"] = line
    legend_below(figure, drawn)
    for panel, index in zip(below, holds, strict=True):
        here = np.flatnonzero(run.segment == index)
        begin = run.t[here[0] - 1] if index else 0.0
        _draw_course(panel, run.t - begin, run, exact, here=here)
        panel.set_xscale("log")
        label = caption.unit(f"time held, segment {index}", TIME, unknown=True)
        panel.set_xlabel(wrapped(label, 7.5 / len(holds)))
    if holds:
        below[0].set(ylabel=caption.force)
    return figure


@styled
def slider_figure(
    run: "SliderTrajectory",
    exact: "Transient | None",
    caption: Caption,
    pulled_by: str = "stage",
) -> Figure:
    """Draw the force that pulls and friction against t, with slips marked; slider and
    stage against t; and, unless the slider is `pulled_by` a "force", the force of the
    spring of a "stage", or of a "motor" alone, against the velocity of the slider."""
    count = 2 if pulled_by == "force" else 3
    figure = Figure(figsize=(9, 6.0 if count == 2 else 8.8))
    panels = figure.subplots(count, 1, height_ratios=[1.2, 1.0, 1.2][:count])
    force, displacement = panels[:2]
    pull, also = _PULLS[pulled_by]
    scope = "" if run.force_replica_std is not None else " at the same X"
    course = _draw_course(force, run.t, run, exact)
    drawn: dict[str, Any] = {
        f"friction of the contacts, ± 2 standard errors{scope}": course[""],
        f"{pull}{also}": force.plot(run.t, run.spring, color="C3")[0],
    }
    if exact is not None:
        drawn["friction, mean field"] = course[_MEAN]
    for slip in run.slips if len(run.slips) <= _MOST_MARKS else ():
        line = force.axvline(slip.t, color="0.7", linewidth=0.7, zorder=0)
        of = " of all replicas" * (caption.replicas > 1)
        drawn[f"slips{of}, at half of their drop"] = line
    force.set(ylabel=caption.length("force / $(N k)$"))
    caption.beside(force)
    force.set_title(caption.heading)
    if pulled_by == "stage":
        displacement.plot(run.t, run.stage, color="C3")
    (slider,) = displacement.plot(run.t, run.X, color="C0", linestyle="--")
    drawn["displacement of the slider"] = slider
    displacement.set(ylabel=caption.length("displacement"))
    for panel in (force, displacement):
        panel.set(xlabel=caption.along("time"), xlim=(run.t[0], run.t[-1]))
    for panel in panels[2:]:
        velocity = np.gradient(run.X, run.t)
        panel.plot(velocity, run.spring, color="C3", linewidth=0.7)
        speed = "velocity of the slider, between two records"
        panel.set_xlabel(caption.unit(speed, VELOCITY, unknown=True))
        panel.set_ylabel(caption.length(f"{pull} / $(N k)$"))
        stage = np.abs(np.diff(run.stage) / np.diff(run.t)).max()
        if np.abs(velocity).max() > _FAST * stage > 0:
            panel.set_xscale("symlog", linthresh=stage)
    legend_below(figure, drawn, caption.means)
    return figure


@styled
def healing_figure(
    holds: tuple[Array, Array, Array],
    exact: Array,
    law: "Healing",
    caption: Caption,
) -> Figure:
    """Draw healing with errors against the times of `holds`, beside `exact` values, if
    there are as many, and the logarithm through it."""
    hold, healing, stderr = holds
    figure = Figure(figsize=(6.5, 4.8))
    axes = figure.subplots()
    bars: dict[str, Any] = {"fmt": "o", "capsize": 2.5}
    axes.errorbar(hold, healing, 2.0 * stderr, label="± 2 standard errors", **bars)
    if exact.size == hold.size:
        axes.plot(hold, exact, "k_", markersize=13, label="exact mean")
    axes.set_xscale("log")
    units = (unit_text(caption.units, of, unknown=False) for of in (LENGTH, TIME))
    draw_healing(axes, law, hold, "C3", *units)
    axes.set(
        xlabel=caption.unit("time of the hold", TIME, unknown=True),
        ylabel=caption.length("healing: peak less force before the hold"),
        title=caption.heading,
    )
    caption.beside(axes)
    axes.legend()
    return figure


def draw_healing(
    axes: Axes,
    law: "Healing",
    hold: Array,
    color: Any,
    unit: str = "",
    time_unit: str = "",
) -> None:
    """Draw a logarithm through healing after holds, in units of healing and of time."""
    t = np.geomspace(hold.min(), hold.max(), 100)
    rate, cutoff, doubt = law.parts((unit, time_unit))
    label = f"{rate} per decade, beyond $t$ = {cutoff}{doubt}"
    axes.plot(t, law.at(t), color=color, linewidth=1, label=label)


@styled
def sizes_figure(
    breaks: Array, per: int, law: Array, caption: Caption, bursts: bool
) -> Figure:
    """Draw the sizes of avalanches behind a stage, as probabilities, or of `bursts`
    under a force, over the number of contacts, beside the exact law."""
    figure = Figure(figsize=(6.5, 4.8))
    axes = figure.subplots()
    draw_sizes(axes, breaks, per, law, "bursts" if bursts else "avalanches")
    label = "bursts over contacts  $D(s)/N$" if bursts else "probability  $P(s)$"
    axes.set(xlabel="breaks  $s$", ylabel=label, title=caption.heading)
    axes.legend(loc="lower left")
    return figure


@styled
def curve_figure(columns: dict[str, Array], along: str, caption: Caption) -> Figure:
    """Draw an exact curve with its error band along the column X or t: the force;
    below, the pinned fraction where contacts spend time detached, the mean threshold of
    a closure, or slider and stage of a spring."""
    labels = {
        "force": caption.force,
        "pinned": "pinned fraction\n$N_c / N$",
        "mean_threshold": caption.length("mean threshold"),
        "X": caption.length("displacement"),
    }
    seen = {"force": True, "X": "stage" in columns}
    for name in ("pinned", "mean_threshold"):
        if name in columns:
            error = columns[f"{name}_error"]
            seen[name] = np.ptp(columns[name]) > 2 * error.max()
    names = [name for name in labels if seen.get(name)]
    heights = [2.4] + [1.3] * (len(names) - 1)
    figure = Figure(figsize=(8, 1.2 + 1.2 * sum(heights)))
    grid: dict[str, Any] = {"sharex": True, "squeeze": False}
    panels = figure.subplots(len(names), 1, height_ratios=heights, **grid)[:, 0]
    x = columns[along]
    for axes, name in zip(panels, names, strict=True):
        line = {"linewidth": 1.2, "label": "slider"}
        draw_band(axes, x, columns[name], columns[f"{name}_error"], **line)
        axes.set(ylabel=labels[name], xlim=(x[0], x[-1]))
        if name == "pinned":
            axes.set_ylim(0, 1.05)
    if columns["force"][0] == 0 <= columns["force"].min():
        panels[0].set_ylim(bottom=0)
    if "stage" in columns:
        panels[-1].plot(x, columns["stage"], color="C3", label="stage")
        panels[-1].legend(loc="upper left")
    panels[0].set_title(caption.heading)
    caption.beside(panels[0])
    panels[-1].set_xlabel(caption.along("time" if along == "t" else along))
    figure.align_ylabels(list(panels))
    return figure
