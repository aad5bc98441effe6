"""Pictures of coupled blocks on a plate."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.estimate import Estimate
from eqsim.numerics.tables import Array
from eqsim.plots.panels import DOTS, Caption, draw_sizes
from eqsim.plots.runs import replica_spread
from eqsim.plots.style import styled
from eqsim.results import draw_band

if TYPE_CHECKING:
    from eqsim.engine.records import ElasticTrajectory

_BRIGHTEST = 0.999  # quantile of an image at which its scale ends
_MOST_PIXELS = 440  # pixels of an image along each side, fewer than a panel has


@styled
def elastic_figure(
    run: "ElasticTrajectory", friction: Estimate, caption: Caption
) -> Figure:
    """Draw F(D), or F(t) of a programme with holds, with its error band and the exact
    mean over displacement; below, how far blocks are apart."""
    figure = Figure(figsize=(8, 5.5))
    name, along = ("D", run.D) if np.all(np.diff(run.D) > 0.0) else ("time", run.t)
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1.0])
    for label, band in replica_spread(top, along, run).items():
        band.set_label(label)
    scope = "" if run.force_replica_std is not None else " of contacts at the same X"
    label = f"simulated contacts, mean ± 2 standard errors{scope}"
    draw_band(top, along, run.force, 2 * run.force_stderr, label=label)
    if friction.value is not None:
        label = "exact mean over displacement, steady sliding"
        top.axhline(friction.value, color="C3", linestyle="--", label=label)
    top.set(ylabel=caption.force, ylim=(0, None))
    caption.beside(top)
    top.set_title(caption.heading)
    top.legend(loc="lower right")
    spread = np.sqrt(_in_space(run, "X").var(axis=2).mean(axis=0))
    low.plot(along, spread, color="C2")
    low.set(xlabel=caption.along(name), xlim=(along[0], along[-1]), ylim=(0, None))
    low.set_ylabel(caption.unit("spread of $X$\nbetween blocks"))
    return figure


@styled
def avalanches_figure(
    run: "ElasticTrajectory", starts: Array, law: Array, caption: Caption
) -> Figure:
    """Draw the distribution of sizes of avalanches over the second half of the plate's
    way beside the exact law, P(1), P(2), ..., how many blocks take part, and how many
    avalanches start in each block, with as many rows as `starts`."""
    figure = Figure(figsize=(14, 4.4))
    left, right, where = figure.subplots(1, 3)
    late = run.avalanches["D"] > 0.5 * run.D[-1]
    breaks, blocks = run.avalanches["breaks"][late], run.avalanches["blocks"][late]
    edges, centre = draw_sizes(left, breaks, breaks.size, law, "avalanches")
    left.set(ylabel="probability  $P(s)$")
    seen, bins = np.histogram(breaks, edges)[0], np.digitize(breaks, edges) - 1
    shown, most = seen > 0, int(breaks.max(initial=1))
    mean = np.bincount(bins, blocks, minlength=seen.size)[shown] / seen[shown]
    label = "mean of the avalanches of that size"
    squares = DOTS | {"color": "C1", "marker": "s"}
    right.plot(centre[shown], mean, label=label, **squares)
    line: dict[str, Any] = {"color": "0.6", "linewidth": 0.8, "linestyle": ":"}
    right.plot([1, most], [1, most], label="every break in another block", **line)
    right.set(ylabel="blocks that take part")
    rows, columns = starts.shape
    if rows > 1:
        label, what = "avalanches that start there", ("rows", "columns")
        _image(where, starts, (columns, rows), label, counts_of=what)
        where.set(xlabel="column", ylabel="row")
    else:
        mean, root = starts.mean(), 2 * np.sqrt(starts.mean())
        look: dict[str, Any] = {"color": "0.85", "label": "their mean ± 2 of its roots"}
        where.axhspan(mean - root, mean + root, **look)
        where.plot(starts[0], ".", markersize=4)
        where.set(xlabel="block", ylabel="avalanches that start in a block")
        where.legend()
    for axes, place in ((left, "lower left"), (right, "upper left")):
        axes.set(xscale="log", yscale="log", xlabel="breaks of an avalanche  $s$")
        axes.legend(loc=place)
    figure.suptitle(caption.heading)
    return figure


@styled
def fronts_figure(
    run: "ElasticTrajectory", nx: int, ny: int, caption: Caption
) -> Figure:
    """Draw the first replica in space and time: how far each block is beyond the mean,
    and breaks between records. A sheet of `ny` rows of `nx` blocks is shown along its
    middle row, and as a whole at the end."""
    sheet = ny > 1
    figure = Figure(figsize=(10, 8.4 if sheet else 4.6))
    above, *below = figure.subplots(1 + sheet, 2, squeeze=False)
    X, breaks, forces = (_in_space(run, name)[0] for name in ("X", "breaks", "force"))
    row = slice(ny // 2 * nx, (ny // 2 + 1) * nx)
    beyond, active = X - X.mean(axis=1, keepdims=True), np.diff(breaks, axis=0)
    label = caption.unit("$X$ beyond the mean of all blocks")
    steps = np.diff(run.D)
    even = np.ptp(steps) < 1e-6 * steps.max()
    size = nx, float(run.D[-1]) if even else float(run.D.size)
    _image(above[0], beyond[:, row], size, label, spread=True)
    counts: dict[str, Any] = {"counts_of": ("intervals", "blocks")}
    _image(above[1], active[:, row], size, "breaks between two records", **counts)
    plate = caption.length("displacement of the plate  $D$") if even else "record"
    for axes in above:
        axes.set(xlabel=f"block of row {ny // 2}" if sheet else "block", ylabel=plate)
    for left, right in below:
        last, force = (values[-1].reshape(ny, nx) for values in (beyond, forces))
        _image(left, last, (nx, ny), f"{label}, at the end", spread=True)
        label = caption.unit("force $F / (n k)$, at the end")
        _image(right, force, (nx, ny), label)
        for axes in (left, right):
            axes.set(xlabel="column", ylabel="row")
    one = f"\nthe first of {caption.replicas} replicas" * (caption.replicas > 1)
    figure.suptitle(f"{caption.heading}{one}")
    return figure


def _in_space(run: "ElasticTrajectory", name: str) -> Array:
    """A column of the records of B blocks, shape (replicas, points, B)."""
    blocks = int(run.blocks["block"][-1]) + 1
    return np.asarray(run.blocks[name].reshape(-1, run.D.size, blocks))


def _image(
    axes: Axes,
    values: Array,
    size: tuple[float, float],
    label: str,
    spread: bool = False,
    counts_of: tuple[str, str] | None = None,
) -> None:
    """Draw values over space and time, or over space, thinned to what can be seen, or
    summed if they are counts in rows and columns of what `counts_of` names; `size` is
    that of all of them in the units of the axes."""
    whole = values.shape
    each = [max(1, -(-count // _MOST_PIXELS)) for count in whole]
    if counts_of:
        for axis, step in enumerate(each):
            begins = np.arange(0, whole[axis], step)
            values = np.add.reduceat(values, begins, axis)
        sums = zip(each, counts_of, strict=True)
        summed = " × ".join(f"{step} {name}" for step, name in sums if step > 1)
        label += f",\nsums over {summed}" * bool(summed)
    else:
        values = values[:: each[0], :: each[1]]
    limit = float(np.abs(values).max(initial=0.0)) or 1.0
    look: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    if not spread:  # a few large values would leave all others in the dark
        bright = float(np.quantile(values, _BRIGHTEST)) or 1.0
        look = {"cmap": "magma", "vmin": values.min(), "vmax": bright}
    # the last pixels may reach beyond the last value
    tall, wide = (
        length * shown * step / count
        for length, shown, step, count in zip(
            size[::-1], values.shape, each, whole, strict=True
        )
    )
    place: dict[str, Any] = {"origin": "lower", "extent": (0.0, wide, 0.0, tall)}
    how: dict[str, Any] = {"aspect": "auto", "interpolation": "nearest"}
    image = axes.imshow(values, **place, **how, **look)
    axes.set(xlim=(0.0, size[0]), ylim=(0.0, size[1]))
    axes.grid(False)
    ends = "neither" if spread else "max"
    axes.figure.colorbar(image, ax=axes, label=label, extend=ends)
