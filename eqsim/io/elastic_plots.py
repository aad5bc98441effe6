"""Pictures of coupled blocks: their force, their avalanches, and their fronts."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.estimate import Estimate
from eqsim.io.plots import plain, png
from eqsim.numerics.tables import Array

if TYPE_CHECKING:
    from eqsim.engine.elastic import ElasticTrajectory

_BINS_PER_DECADE = 8
_BRIGHTEST = 0.999  # quantile of an image that is the end of its scale
_MOST_ROWS = 1000  # of a picture of fronts, along each side
_PLATE = "displacement of the plate  D  [length unit of the run file]"


def force_png(run: "ElasticTrajectory", friction: Estimate, title: str) -> bytes:
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
    top.set_title(plain(title), fontsize=10)
    top.legend(loc="lower right", fontsize=8)
    X = _in_space(run, "X")
    low.plot(run.D, X.std(axis=1), color="C2", linewidth=1)
    low.set(xlabel=_PLATE, ylabel="standard deviation\nof X between blocks", xlim=(run.D[0], run.D[-1]), ylim=(0, None))
    for axes in (top, low):
        axes.grid(alpha=0.3)
    return png(figure)


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
    left.set_title(plain(title), fontsize=10)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return png(figure)


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
    panels[0, 0].set_title(plain(title), fontsize=10)
    return png(figure)


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
