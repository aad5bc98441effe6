"""Pictures."""

import io
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eqsim.errors import InputError, meant
from eqsim.estimate import OBSERVABLES, Estimate
from eqsim.numerics.tables import Array

if TYPE_CHECKING:
    from eqsim.engine.elastic import ElasticTrajectory
    from eqsim.engine.records import ProgrammeTrajectory, SliderTrajectory, Trajectory
    from eqsim.engine.steady import Steady
    from eqsim.master.stability import Stability
    from eqsim.master.transient import Fluctuations, Transient
    from eqsim.validation import Validation

Points = Any  # a pandas DataFrame, one point of a sweep a row
Column = Any  # a pandas Series

_MARKERS, _DASHES = "os^DvPX<>ph*", ("-", "--", "-.", ":")
_MOST_HOLDS, _MOST_MARKS = 4, 60  # of a programme that are drawn in panels of their own, and marked
_SPREAD = 30.0  # an axis whose values span a greater factor is logarithmic
_BINS_PER_DECADE = 8  # of a picture of sizes
_BRIGHTEST = 0.999  # quantile of an image that is the end of its scale
_MOST_ROWS = 1000  # of an image in space and time, along each side
_PLATE = "displacement of the plate  D  [length unit of the run file]"
_UNITS = {"length": "  [length unit of the run files]", "length^2": "  [its square]", "": ""}
_LABELS = {name: label + _UNITS[unit] for name, (label, unit) in OBSERVABLES.items()}
_LABELS["drive.velocity"] = "driving velocity  drive.velocity  [units of the run files]"


def trajectory_png(run: "Trajectory", steady: "Steady", exact: "Transient | None", title: str) -> bytes:
    """F(X) with its error band, the exact mean over it and the steady value; below, the difference from the exact mean
    in standard errors, and the pinned fraction where contacts spend time detached."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    heights = [2.6] + [1.0] * ((exact is not None) + delayed)
    figure = Figure(figsize=(8, 2 + sum(heights)), dpi=150, layout="constrained")
    panels = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    top, drawn = panels[0], {}
    if run.force_replica_std is not None:
        spread = run.force_replica_std
        band = top.fill_between(run.X, run.force - spread, run.force + spread, color="0.85")
        drawn["± standard deviation between replicas"] = band
    drawn |= _compare(top, run, "force", "C0", steady.friction, exact)
    top.set(ylabel="friction force  F / (N k)\n[length unit of the run file]")
    top.set_ylim(bottom=0)
    top.set_title(plain_title(title), fontsize=10)
    # forces start at 0 or stay near the steady value: the space below the curve is empty
    top.legend(drawn.values(), drawn.keys(), loc="lower right", fontsize=8, framealpha=1)
    if exact is not None:
        sigma = np.hypot(run.force_stderr, exact.force_error)
        z = np.divide(run.force - exact.force, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        limit = max(4.0, 1.1 * np.abs(z).max())
        panels[1].axhspan(-2, 2, color="0.9")
        panels[1].plot(run.X, z, color="C0", linewidth=0.8)
        panels[1].set(ylim=(-limit, limit), ylabel="difference\n[standard errors]")
    if delayed:
        _compare(panels[-1], run, "pinned", "C2", steady.pinned, exact)
        panels[-1].set(ylabel="pinned fraction\nN_c / N", ylim=(0, 1.05))
    panels[-1].set(xlabel="slider displacement  X  [length unit of the run file]", xlim=(run.X[0], run.X[-1]))
    figure.align_ylabels(panels)
    for panel in panels:
        panel.grid(alpha=0.3)
    return as_png(figure)


def programme_png(run: "ProgrammeTrajectory", exact: "Transient | None", title: str) -> bytes:
    """F along a programme with its error band and the exact mean, against t with the segments marked, and against X;
    each hold in a panel of its own, where time begins anew and is logarithmic; and the difference from the exact mean
    in standard errors."""
    holds = [index for index, segment in enumerate(run.segments) if segment.velocity == 0][:_MOST_HOLDS]
    rows = [2.2, 2.2] + [1.0] * (exact is not None)
    figure = Figure(figsize=(9, 2 + sum(rows) + 2.4 * bool(holds)), dpi=150, layout="constrained")
    upper: Any = figure
    lower: Any = None
    if holds:
        parts: Any = figure.subfigures(2, 1, height_ratios=[sum(rows), 2.4])
        upper, lower = parts
    panels = list(upper.subplots(len(rows), 1, height_ratios=rows))
    drawn = _band(panels[0], run.t, run, exact)
    panels[0].legend(drawn.values(), drawn.keys(), loc="best", fontsize=8)
    panels[0].set(xlabel="time  t", ylabel="friction force  F / (N k)", xlim=(run.t[0], run.t[-1]))
    panels[0].set_title(plain_title(title), fontsize=10)
    _band(panels[1], run.X, run, exact)
    panels[1].set(xlabel="slider displacement  X  [length unit of the run file]", ylabel="friction force  F / (N k)")
    if exact is not None:
        sigma = np.hypot(run.force_stderr, exact.force_error)
        z = np.divide(run.force - exact.force, sigma, out=np.zeros_like(sigma), where=sigma > 0)
        limit = max(4.0, 1.1 * np.abs(z).max())
        panels[2].axhspan(-2, 2, color="0.9")
        panels[2].plot(run.t, z, color="C0", linewidth=0.8)
        panels[2].set(
            ylim=(-limit, limit), xlim=(run.t[0], run.t[-1]), xlabel="time  t", ylabel="difference\n[standard errors]"
        )
    marked = [panels[0], *panels[2:]]
    for segment in run.segments[:-1] if len(run.segments) <= _MOST_MARKS else ():
        for panel in marked:
            panel.axvline(segment.t, color="0.6", linewidth=0.7)
    below = lower.subplots(1, len(holds), squeeze=False, sharey=True)[0] if lower else ()
    for axes, index in zip(below, holds, strict=True):
        here = np.flatnonzero(run.segment == index)
        begin = run.t[here[0] - 1] if index else 0.0
        _band(axes, run.t - begin, run, exact, here)
        axes.set_xscale("log")
        axes.set(xlabel=f"time held, segment {index}")
        panels.append(axes)
    if lower:
        panels[-len(holds)].set(ylabel="friction force  F / (N k)")
    for panel in panels:
        panel.grid(alpha=0.3)
    return as_png(figure)


def slider_png(run: "SliderTrajectory", exact: "Transient | None", title: str) -> bytes:
    """The force of the spring and friction against t, with slips marked; slider and stage against t; and the force of
    the spring against the velocity of the slider."""
    figure = Figure(figsize=(9, 8.5), dpi=150, layout="constrained")
    force, place, phase = figure.subplots(3, 1, height_ratios=[1.2, 1.0, 1.2])
    force.fill_between(
        run.t, run.force - 2 * run.force_stderr, run.force + 2 * run.force_stderr, color="C0", alpha=0.3, linewidth=0
    )
    force.plot(run.t, run.force, color="C0", linewidth=1, label="friction of the contacts, ± 2 standard errors")
    force.plot(run.t, run.spring, color="C1", linewidth=1, label="spring")
    if exact is not None:
        force.plot(run.t, exact.force, color="k", linewidth=0.8, linestyle=":", label="friction, mean field")
    if len(run.slips) <= _MOST_MARKS:
        for slip in run.slips:
            force.axvline(slip.t, color="0.7", linewidth=0.7, zorder=0)
    force.legend(loc="best", fontsize=8)
    force.set(xlabel="time  t", ylabel="force / (N k)\n[length unit of the run file]", xlim=(run.t[0], run.t[-1]))
    force.set_title(plain_title(title), fontsize=10)
    place.plot(run.t, run.stage, color="C1", linewidth=1, label="stage")
    place.plot(run.t, run.X, color="C0", linewidth=1, label="slider")
    place.legend(loc="best", fontsize=8)
    place.set(xlabel="time  t", ylabel="displacement\n[length unit of the run file]", xlim=(run.t[0], run.t[-1]))
    phase.plot(np.gradient(run.X, run.t), run.spring, color="C0", linewidth=0.7)
    phase.set(xlabel="velocity of the slider, between two records", ylabel="force of the spring / (N k)")
    phase.set_xscale("symlog", linthresh=max(np.abs(np.diff(run.stage) / np.diff(run.t)).max(), 1e-300))
    for panel in (force, place, phase):
        panel.grid(alpha=0.3)
    return as_png(figure)


def stability_png(found: "Stability", borders: dict[str, Any], title: str) -> bytes:
    """The critical stiffness over velocity, of steady sliding and of the first slip, and the run's own point."""
    figure = Figure(figsize=(7, 5), dpi=150, layout="constrained")
    axes = figure.subplots()
    velocity, steady, fresh = (
        np.append(borders.get(name, ()), own)
        for name, own in (
            ("velocity", found.velocity),
            ("critical_stiffness", found.critical_stiffness.value or 0.0),
            ("fresh_critical_stiffness", found.fresh.critical_stiffness.value or 0.0),
        )
    )
    order = np.argsort(velocity)
    velocity, steady, fresh = velocity[order], steady[order], fresh[order]
    known = np.isfinite(steady) & (steady > 0)
    shown = np.isfinite(fresh) & (fresh > 0)
    if known.any():
        axes.plot(velocity[known], steady[known], color="C3", marker=".", label="steady sliding is unstable below")
        axes.fill_between(velocity, 0, np.where(known, steady, 0), color="C3", alpha=0.12, linewidth=0)
    if shown.any():
        axes.plot(
            velocity[shown], fresh[shown], color="C0", linestyle="--", marker=".", label="a fresh start slips below"
        )
    axes.plot([found.velocity], [found.stiffness], "k*", markersize=12, label=f"this run, {found.verdict}")
    axes.set(xscale="log", yscale="log", xlabel=_LABELS["drive.velocity"], ylabel="stiffness  kappa_s = K / (N k)")
    values = np.concatenate((steady[known], fresh[shown], [found.stiffness]))
    axes.set_ylim(0.3 * values.min(), 3.0 * values.max())
    axes.set_title(plain_title(title), fontsize=10)
    axes.legend(loc="best", fontsize=8)
    axes.grid(alpha=0.3)
    return as_png(figure)


def fluctuations_png(exact: "Fluctuations", sample: Any, title: str) -> bytes:
    """The exact autocovariance over the lag, and that of simulated contacts with error bars, if there is a `sample`."""
    figure = Figure(figsize=(8, 4.6), dpi=150, layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="0.6", linewidth=0.7)
    axes.plot(exact.lag, exact.covariance, color="k", linewidth=1, label="exact", zorder=3)
    if sample is not None:
        every = max(1, exact.lag.size // 30)
        bars: dict[str, Any] = {"color": "C0", "linestyle": "none", "marker": "o", "markersize": 4, "capsize": 2}
        label = f"{sample.ensembles} ensembles of {sample.contacts} contacts ± 2 standard errors"
        axes.errorbar(exact.lag[::every], sample.covariance[::every], 2 * sample.stderr[::every], label=label, **bars)
    axes.set(xlabel="lag in displacement  [length unit of the run file]", xlim=(0, exact.lag[-1]))
    axes.set(ylabel="autocovariance  N Cov(F, F') / (N k)²\n[its square]")
    axes.set_title(plain_title(title), fontsize=10)
    axes.legend(loc="upper right", fontsize=8)
    axes.grid(alpha=0.3)
    return as_png(figure)


def elastic_png(run: "ElasticTrajectory", friction: Estimate, title: str) -> bytes:
    """F(D) with its error band and the exact mean over displacement; below, how far blocks are apart."""
    figure = Figure(figsize=(8, 5.5), dpi=150, layout="constrained")
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1.0])
    if run.force_replica_std is not None:
        low_edge, high_edge = run.force - run.force_replica_std, run.force + run.force_replica_std
        top.fill_between(
            run.D, low_edge, high_edge, color="0.85", linewidth=0, label="± standard deviation between replicas"
        )
    error, of = 2 * run.force_stderr, "" if run.force_replica_std is not None else " of contacts at the same X"
    said = f"simulated contacts, mean ± 2 standard errors{of}"
    top.fill_between(run.D, run.force - error, run.force + error, color="C0", alpha=0.3, linewidth=0)
    top.plot(run.D, run.force, color="C0", linewidth=1, label=said)
    label = "exact mean over displacement, steady sliding"
    top.axhline(friction.value or 0.0, color="C3", linewidth=1, linestyle="--", label=label)
    top.set(ylabel="friction force  F / (N k)\n[length unit of the run file]", ylim=(0, None))
    top.set_title(plain_title(title), fontsize=10)
    top.legend(loc="lower right", fontsize=8)
    X = _in_space(run, "X")
    low.plot(run.D, X.std(axis=1), color="C2", linewidth=1)
    low.set(xlabel=_PLATE, ylabel="standard deviation\nof X between blocks", xlim=(run.D[0], run.D[-1]), ylim=(0, None))
    for axes in (top, low):
        axes.grid(alpha=0.3)
    return as_png(figure)


def avalanches_png(run: "ElasticTrajectory", law: Array, title: str) -> bytes:
    """Sizes of avalanches over the second half of the plate's way on the exact law, P(1), P(2), ... ; and how many
    blocks take part."""
    figure = Figure(figsize=(10, 4.4), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2)
    late = run.avalanches["D"] > 0.5 * run.D[-1]
    breaks, blocks = run.avalanches["breaks"][late], run.avalanches["blocks"][late]
    most = int(breaks.max(initial=1))
    count = int(np.ceil(_BINS_PER_DECADE * np.log10(most + 1.0))) + 1
    edges = np.unique(np.rint(np.geomspace(1, most + 1, count)).astype(int)) - 0.5
    width, centre = np.diff(edges), np.sqrt((edges[:-1] + 0.5) * (edges[1:] - 0.5))
    seen, which = np.histogram(breaks, edges)[0], np.digitize(breaks, edges) - 1
    shown = seen > 0
    share = 1.0 / max(breaks.size, 1) / width
    left.errorbar(
        centre[shown], (seen * share)[shown], 2 * (np.sqrt(seen) * share)[shown], fmt="o", markersize=4, color="C0",
        label=f"{breaks.size} simulated avalanches ± 2 roots of their number",
    )  # fmt: skip
    left.plot(np.arange(1, law.size + 1), law, color="k", linewidth=1, label="infinitely many contacts (M/G/1)")
    lowest = max(0.2 * (seen * share)[shown].min(initial=1.0), 1e-300)
    left.set(xscale="log", yscale="log", xlabel="breaks of an avalanche  s", ylabel="probability  P(s)")
    left.set(xlim=(0.8, 1.3 * most), ylim=(lowest, 2.0))
    left.legend(loc="lower left", fontsize=8)
    mean = np.bincount(which, blocks, minlength=seen.size)[shown] / seen[shown]
    right.plot(centre[shown], mean, "s", markersize=4, color="C1", label="mean of the avalanches of that size")
    right.plot([1, most], [1, most], color="0.6", linewidth=0.8, linestyle=":", label="every break in another block")
    right.set(xscale="log", yscale="log", xlabel="breaks of an avalanche  s", ylabel="blocks that take part")
    right.legend(loc="upper left", fontsize=8)
    left.set_title(plain_title(title), fontsize=10)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return as_png(figure)


def fronts_png(run: "ElasticTrajectory", shape: tuple[int, int], title: str) -> bytes:
    """Of the first replica, in space and time: displacement of each block beyond the mean, and breaks between records;
    of a sheet along its middle row, and the whole sheet at the end."""
    nx, ny = shape
    figure = Figure(figsize=(10, 4.6 if ny == 1 else 8.4), dpi=150, layout="constrained")
    panels = figure.subplots(2 if ny > 1 else 1, 2, squeeze=False)
    X, breaks = _in_space(run, "X"), _in_space(run, "breaks")
    row = slice(ny // 2 * nx, (ny // 2 + 1) * nx)
    beyond, active = X - X.mean(axis=1, keepdims=True), np.diff(breaks, axis=0)
    across = "block" if ny == 1 else f"block of row {ny // 2}"
    label = "X beyond the mean of all blocks"
    _image(panels[0, 0], beyond[:, row], (0, nx, 0.0, run.D[-1]), label, spread=True)
    _image(panels[0, 1], active[:, row], (0, nx, 0.0, run.D[-1]), "breaks between two records")
    for axes in panels[0]:
        axes.set(xlabel=across, ylabel=_PLATE)
    if ny > 1:
        _image(panels[1, 0], beyond[-1].reshape(ny, nx), (0, nx, 0, ny), label + ", at the end", spread=True)
        force = _in_space(run, "force")[-1].reshape(ny, nx)
        _image(panels[1, 1], force, (0, nx, 0, ny), "force F / (n k), at the end")
        for axes in panels[1]:
            axes.set(xlabel="column", ylabel="row")
    panels[0, 0].set_title(plain_title(title), fontsize=10)
    return as_png(figure)


def _in_space(run: "ElasticTrajectory", name: str) -> Array:
    """A column of the records of blocks of the first replica, shape (points, B)."""
    points = run.D.size
    blocks = int(run.blocks["block"][-1]) + 1
    return np.asarray(run.blocks[name][: points * blocks].reshape(points, blocks))


def _image(
    axes: Axes, values: Array, extent: tuple[float, float, float, float], label: str, spread: bool = False
) -> None:
    """Values in space and time, or in space, thinned to what can be seen."""
    step = [max(1, -(-size // _MOST_ROWS)) for size in values.shape]
    values = values[:: step[0], :: step[1]]
    limit = float(np.abs(values).max(initial=0.0)) or 1.0
    look: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    if not spread:  # a few large values would leave all others in the dark
        look = {"cmap": "magma", "vmin": values.min(), "vmax": float(np.quantile(values, _BRIGHTEST)) or 1.0}
    image = axes.imshow(values, origin="lower", aspect="auto", extent=extent, interpolation="nearest", **look)
    axes.figure.colorbar(image, ax=axes, label=label, extend="neither" if spread else "max")


def _band(
    axes: Axes, x: Any, run: "ProgrammeTrajectory", exact: "Transient | None", here: Any = slice(None)
) -> dict[str, Any]:
    """The force against `x` with its error band, and the exact mean; what the legend needs."""
    force, error = run.force[here], 2 * run.force_stderr[here]
    band = axes.fill_between(x[here], force - error, force + error, color="C0", alpha=0.3, linewidth=0)
    line = axes.plot(x[here], force, color="C0", linewidth=1)[0]
    drawn: dict[str, Any] = {"simulated contacts, mean ± 2 standard errors": (band, line)}
    if exact is not None:
        drawn["exact mean (renewal equation)"] = axes.plot(
            x[here], exact.force[here], color="k", linewidth=0.8, linestyle=":"
        )[0]
    return drawn


def _compare(
    axes: Axes, run: "Trajectory", name: str, color: str, steady: Estimate, exact: "Transient | None"
) -> dict[str, Any]:
    """A curve with its error band, the steady value and the exact mean; what the legend needs."""
    y, error = getattr(run, name), 2 * getattr(run, f"{name}_stderr")
    value, stderr = steady.value or 0.0, steady.stderr or 0.0
    band = axes.fill_between(run.X, y - error, y + error, color=color, alpha=0.3, linewidth=0)
    drawn: dict[str, Any] = {
        "simulated contacts, mean ± 2 standard errors": (band, axes.plot(run.X, y, color=color, linewidth=1)[0])
    }
    span = axes.axhspan(value - 2 * stderr, value + 2 * stderr, color="C3", alpha=0.25, linewidth=0)
    level = axes.axhline(value, color="C3", linewidth=1, linestyle="--")
    drawn["steady value (renewal-reward) ± 2 standard errors"] = span, level
    if exact is not None:
        line = axes.plot(run.X, getattr(exact, name), color="k", linewidth=0.8, linestyle=":")[0]
        drawn["exact mean (renewal equation)"] = line
    return drawn


def validation_png(result: "Validation") -> bytes:
    """Every score of a suite by kind, ensemble by colour, and all of them against the normal law."""
    figure = Figure(figsize=(11, 5), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
    rng = np.random.default_rng(0)
    kinds = [verdict.kind for verdict in result.verdicts]
    for disorder, color, marker in (("quenched", "C0", "o"), ("annealed", "C1", "^")):
        shown = [score for score in result.scores if score.ensemble.disorder == disorder]
        x = [kinds.index(score.kind) for score in shown] + rng.uniform(-0.3, 0.3, len(shown))
        z = np.clip([score.z for score in shown], -8, 8)
        left.scatter(x, z, s=9, color=color, marker=marker, alpha=0.6, label=disorder)
    said = {True: "passed", False: "FAILED"}
    names = ["\n".join([*v.kind.split(), f"{v.count} scores", said[v.passed]]) for v in result.verdicts]
    left.set_xticks(range(len(names)), names, fontsize=8)
    left.set_ylabel("z = (engine - master) / standard error")
    left.set_title(f"suite {result.suite}, seed {result.seed}: {said[result.passed]}", fontsize=10)
    grid = np.linspace(-8, 8, 401)
    every = np.clip([score.z for score in result.scores], -8, 8)
    right.hist(every, bins=np.arange(-8, 8.5, 0.5), density=True, orientation="horizontal", color="0.8")
    right.plot(np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi), grid, color="k", linewidth=1, label="standard normal")
    right.set_xlabel(f"density of all {every.size} scores")
    for axes in (left, right):
        axes.legend(fontsize=8, loc="upper right")
        axes.axhline(0, color="0.5", linewidth=0.5)
        axes.grid(alpha=0.3)
    left.set_ylim(min(-4.5, every.min() - 0.5), max(4.5, every.max() + 0.5))
    return as_png(figure)


def read_points(folder: Path) -> Points:
    """The points of a sweep, one a row, from a folder of Parquet files. Raises InputError."""
    import pyarrow
    from pyarrow import parquet as pq

    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder of Parquet files")
    try:
        table = pq.read_table(folder).to_pandas().reset_index(drop=True)
    except (OSError, pyarrow.ArrowException) as error:
        raise InputError(f"{folder}: cannot be read as Parquet files ({str(error).splitlines()[0]})") from None
    for name in table.select_dtypes("category"):  # folders named KEY=VALUE
        table[name] = table[name].astype(str)
        with suppress(ValueError):
            table[name] = table[name].astype(float)
    return table


def select(table: Points, where: dict[str, str]) -> Points:
    """The points at which every column named in `where` has the value given, numbers to 1e-9. Raises InputError."""
    for name, text in where.items():
        column = _column(table, name, "--where")
        same = column.astype(str) == text
        if _numeric(column):
            with suppress(ValueError):
                same = np.isclose(column, float(text), rtol=1e-9, atol=0)
        if not np.any(same):
            raise InputError(f"--where {name}={text}: no point has this value; there are {_values(column)}")
        table = table[same]
    return table


def sweep_png(
    table: Points, x: str, y: str, by: str | None = None, log_x: bool | None = None, title: str = ""
) -> tuple[bytes, list[str]]:
    """Column `y` of a sweep's points against column `x`, one series for each value of column `by`, and notes on what
    was left out.

    Bars are two standard errors (column `y`_stderr), lines go through the master equation's values (`y`_reference),
    both where there are such columns; points of `status` "unreliable" are open, those of "failed" left out. The x axis
    is logarithmic if `log_x`, or by default if its values span more than a factor 30.
    Raises InputError if a column is missing or is not of numbers, if a parameter other than `x` and `by` varies (one of
    `output` does not count: it changes no average), or if nothing is left to draw.
    """
    table, notes = _drawable(table, x, y, by)
    low, high = float(table[x].min()), float(table[x].max())
    if log_x and low <= 0:
        raise InputError(f"--log-x: {x} = {low:g} is not above 0")
    figure = Figure(figsize=(9, 5), dpi=150, layout="constrained")
    axes = figure.subplots()
    if log_x or (log_x is None and low > 0 and high > _SPREAD * low):
        axes.set_xscale("log")
    series = list(table.groupby(by, dropna=False)) if by is not None else [(None, table)]
    colors = matplotlib.colormaps["viridis"](np.linspace(0.0, 0.8, len(series)))  # also a scale of greys
    legend = []
    for i, (value, part) in enumerate(series):
        style: dict[str, Any] = {"color": colors[i], "marker": _MARKERS[i % len(_MARKERS)], "markersize": 5.5}
        line = _DASHES[i % len(_DASHES)] if f"{y}_reference" in part else "none"
        _draw(axes, part.sort_values(x), (x, y), style, line)
        if by is not None:
            legend.append(Line2D([], [], linestyle=line, linewidth=1, label=_text(value), **style))
    legend += _explained(table, y)
    if legend:  # beside the axes, where it covers nothing
        look: dict[str, Any] = {"loc": "outside right upper", "fontsize": 8, "title_fontsize": 8}
        figure.legend(handles=legend, title=by, ncols=1 + len(legend) // 26, **look)
    axes.set(xlabel=_LABELS.get(x, f"{x}  [units of the run files]"), ylabel=_LABELS.get(y, y))
    axes.set_title("\n".join(filter(None, (plain_title(title), "; ".join(notes)))), fontsize=10)
    axes.grid(alpha=0.3)
    return as_png(figure), notes


def _drawable(table: Points, x: str, y: str, by: str | None) -> tuple[Points, list[str]]:
    """The points that can be drawn, and notes on the others."""
    for name, option in ((x, "--x"), (y, "--y")):
        if not _numeric(_column(table, name, option)):
            raise InputError(f"{option} {name}: is not a column of numbers but of {_values(table[name])}")
    if by is not None:
        _column(table, by, "--by")
    parameters = [name for name in table if ("." in name and not name.startswith("output.")) or name == "disorder"]
    free = [name for name in parameters if name not in (x, by) and table[name].nunique(dropna=False) > 1]
    if free:
        several = "; ".join(f"{name} ({_values(table[name])})" for name in free)
        raise InputError(f"besides --x and --by other parameters vary; choose with --where KEY=VALUE: {several}")
    table = table.assign(status=table.get("status", "ok"))
    failed = table["status"] == "failed"
    shown = ~failed & np.isfinite(table[[x, y]].astype(float)).all(axis=1)
    absent = ((failed.sum(), "failed"), ((~failed & ~shown).sum(), f"without a finite {x} or {y}"))
    notes = [f"left out: {number} {what}" for number, what in absent if number]
    if not shown.any():
        raise InputError(f"--y {y}: no point to draw" + "".join(f"; {note}" for note in notes))
    return table[shown], notes


def _draw(axes: Axes, part: Points, columns: tuple[str, str], style: dict[str, Any], line: str) -> None:
    """One series."""
    (x, y), color = columns, style["color"]
    if f"{y}_reference" in part:
        known = part.drop_duplicates(x).dropna(subset=f"{y}_reference")
        axes.plot(known[x], known[f"{y}_reference"], color=color, linewidth=1, linestyle=line, zorder=2)
    bars = 2 * part[f"{y}_stderr"].astype(float) if f"{y}_stderr" in part else None
    axes.errorbar(part[x], part[y], bars, fmt="none", ecolor=color, elinewidth=1, capsize=2.5, zorder=3)
    unsure = part["status"] == "unreliable"
    for points, fill in ((part[~unsure], color), (part[unsure], "white")):
        axes.plot(points[x], points[y], linestyle="none", markerfacecolor=fill, zorder=4, **style)


def _explained(table: Points, y: str) -> list[Line2D]:
    """What lines, bars and open markers are, where there are any."""
    lines: dict[str, Any] = {"linewidth": 1, "label": "lines: master equation"}
    bars = {"linestyle": "none", "marker": "|", "markersize": 11, "label": "bars: ± 2 standard errors"}
    open_ = {"linestyle": "none", "marker": "o", "markersize": 5.5, "markerfacecolor": "white"}
    looks = (
        (f"{y}_reference" in table, lines),
        (f"{y}_stderr" in table, bars),
        ((table["status"] == "unreliable").any(), open_ | {"label": "open: unreliable"}),
    )
    return [Line2D([], [], color="0.35", **look) for present, look in looks if present]


def _column(table: Points, name: str, option: str) -> Column:
    if name not in table:
        hint = meant(name, map(str, table)) or f"there are {', '.join(map(str, table))}"
        raise InputError(f"{option} {name}: no such column; {hint}")
    return table[name]


def _numeric(column: Column) -> bool:
    return column.dtype.kind in "iuf"


def _values(column: Column) -> str:
    """Some of its values, to choose from."""
    found = [_text(value) for value in column.drop_duplicates().sort_values()]
    return ", ".join(found[:8] + ["..."] * (len(found) > 8))


def _text(value: Any) -> str:
    if isinstance(value, float):
        return "none" if np.isnan(value) else f"{value:.6g}"
    return str(value)


def plain_title(title: str) -> str:
    """A title for a picture: no mathematics, nothing that no font has."""
    return title.encode(errors="backslashreplace").decode().replace("$", r"\$")


def as_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": "eqsim"})
    return buffer.getvalue()
