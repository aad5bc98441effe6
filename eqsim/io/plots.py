"""Pictures of runs."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eqsim.catalogue import AREA, LENGTH, TIME, VELOCITY
from eqsim.estimate import Estimate
from eqsim.io.labels import FORCE, axis, described, plain, unit_text, with_unit
from eqsim.io.style import styled
from eqsim.io.units import Quantity, Units
from eqsim.model.drive import Drive
from eqsim.numerics.tables import Array

if TYPE_CHECKING:
    from eqsim.engine.records import (
        ElasticTrajectory,
        ProgrammeTrajectory,
        SliderTrajectory,
        Trajectory,
    )
    from eqsim.engine.steady import Steady
    from eqsim.io.runfile import RunFile
    from eqsim.master.stability import Stability
    from eqsim.master.transient import Fluctuations, Transient
    from eqsim.validation import Validation

# velocities of the stage, from which on those of slips need a logarithmic axis
_FAST = 3.0
_MOST_HOLDS, _MOST_MARKS = (
    4,
    60,
)  # of a programme that are drawn in panels of their own, and marked
_BINS_PER_DECADE = 8  # of a picture of sizes
_BRIGHTEST = 0.999  # quantile of an image that is the end of its scale
_MOST_ROWS = 1000  # of an image in space and time, along each side
_FIRST = 6.0  # mean thresholds that a panel of the transient shows, of a run that is longer by another factor of
_LONG = 4.0
_EXACT = "exact mean (renewal equation)"


class Caption(NamedTuple):
    """What a picture of a run says besides its curves: the title, what is simulated
    (mathtext), units, what friction is at the interface, and of how many contacts and
    replicas it is."""

    title: str
    detail: str = ""
    units: Units = Units()
    quantity: Quantity | None = None
    contacts: int = 0
    replicas: int = 1

    @property
    def heading(self) -> str:
        """The title above what is simulated."""
        return "\n".join(filter(None, (plain(self.title), self.detail)))

    @property
    def force(self) -> str:
        """Label of a friction force per contact."""
        return self.length(FORCE)

    def length(self, text: str) -> str:
        """Label of a length up an axis."""
        label = with_unit(text, unit_text(self.units, LENGTH))
        return label if self.units.length else label.replace("  [", "\n[")

    @property
    def band(self) -> str:
        """What a force is whose error band is drawn."""
        if self.replicas > 1:
            return f"mean of {self.replicas} simulated ensembles, ± 2 standard errors"
        count = f"{self.contacts:,}".replace(",", " ")
        return f"one simulated ensemble, ± 2 standard deviations between ensembles of N = {count}"

    def along(self, name: str) -> str:
        """Label of another axis, such as "X" or "time"."""
        return axis(name, self.units)

    def beside(self, axes: Axes) -> None:
        """What friction is at the interface, on an axis to the right."""
        if self.quantity is None:
            return
        factor, text = self.quantity.factor, self.quantity.label

        def there(y: Any) -> Any:
            return y * factor

        def back(y: Any) -> Any:
            return y / factor

        right = axes.secondary_yaxis("right", functions=(there, back))
        right.set_ylabel(with_unit(text, plain(self.quantity.unit)))


def caption(file: "RunFile", friction: Estimate, name: str = "") -> Caption:
    """Of a run file whose friction is about so large; `name` if it has no title."""
    ensemble, units = file.ensemble, file.units
    return Caption(
        file.title or name, described(ensemble, units, tex=True), units, file.preferred(friction),
        ensemble.count, file.output.replicas,
    )  # fmt: skip


@styled
def trajectory_figure(
    run: "Trajectory", steady: "Steady", exact: "Transient | None", caption: Caption
) -> Figure:
    """F(X) with its error band, the exact mean over it and the steady value; below, the
    difference from the exact mean in standard errors, and the pinned fraction where
    contacts spend time detached. Of a long run the first thresholds have panels of
    their own."""
    delayed = steady.pinned.value is not None and steady.pinned.value < 1
    heights = [2.6] + [1.0] * ((exact is not None) + delayed)
    first = _FIRST * (steady.break_stretch.value or 0.0)
    wide = (
        [1.0, 2.0]
        if 0.0 < _LONG * first < run.X[-1] and np.count_nonzero(first > run.X) > 10
        else [1.0]
    )
    figure = Figure(figsize=(9, 2.3 + sum(heights)), layout="constrained")
    columns = figure.subplots(
        len(heights),
        len(wide),
        sharex="col",
        sharey="row",
        squeeze=False,
        height_ratios=heights,
        width_ratios=wide,
    ).T
    drawn: dict[str, Any] = {}
    z, sigma = np.zeros(run.X.size), np.zeros(run.X.size)
    if exact is not None:
        sigma = np.hypot(run.force_stderr, exact.force_error)
        z = np.divide(run.force - exact.force, sigma, out=z, where=sigma > 0)
    for panels in columns:
        top = panels[0]
        if run.force_replica_std is not None:
            spread = run.force_replica_std
            band = top.fill_between(
                run.X, run.force - spread, run.force + spread, color="0.85"
            )
            drawn["± standard deviation between replicas"] = band
        drawn |= _compare(top, run, "force", "C0", steady.friction, exact)
        if exact is not None:
            panels[1].axhspan(-2, 2, color="0.9")
            panels[1].plot(run.X, z, color="C0", linewidth=0.8)
        if delayed:
            drawn |= _compare(panels[-1], run, "pinned", "C2", steady.pinned, exact)
        panels[-1].set(xlim=(run.X[0], run.X[-1]))
        for panel in panels:
            panel.grid(alpha=0.3)
    left = columns[0]
    if len(wide) > 1:
        left[-1].set(
            xlim=(0.0, first),
            xlabel=with_unit("$X$", unit_text(caption.units, LENGTH, unknown=False)),
        )
        left[0].set_title("the first thresholds")
        columns[1][0].set_title("the whole run")
    columns[-1][-1].set_xlabel(caption.along("X"))
    left[0].set(ylabel=caption.force)
    if run.force.min() >= 0:
        left[0].set_ylim(bottom=0)
    if exact is not None:
        limit = max(4.0, 1.1 * np.abs(z).max())
        left[1].set(ylim=(-limit, limit), ylabel="difference\n[standard errors]")
    if delayed:
        left[-1].set(ylabel="pinned fraction\n$N_c / N$", ylim=(0, 1.05))
    caption.beside(columns[-1][0])
    figure.suptitle(caption.heading, fontsize=10)
    names = {
        "simulated": f"force: {caption.band}" if delayed else caption.band,
        "simulated pinned": "pinned fraction",
    }
    _legend_below(
        figure, {names.get(name, name): handle for name, handle in drawn.items()}
    )
    figure.align_ylabels(list(left))
    return figure


def _legend_below(figure: Figure, drawn: dict[str, Any]) -> None:
    """A legend below all panels, where it covers nothing."""
    figure.legend(
        [*drawn.values()], [*drawn], loc="outside lower center", ncols=2, frameon=False
    )


@styled
def programme_figure(
    run: "ProgrammeTrajectory", exact: "Transient | None", caption: Caption
) -> Figure:
    """F along a programme with its error band and the exact mean, against t with the
    segments marked, and against X; each hold in a panel of its own, where time begins
    anew and is logarithmic; and the difference from the exact mean in standard errors.
    """
    holds = [
        index for index, segment in enumerate(run.segments) if segment.velocity == 0
    ][:_MOST_HOLDS]
    rows = [2.2, 2.2] + [1.0] * (exact is not None)
    figure = Figure(
        figsize=(9, 2.2 + sum(rows) + 2.4 * bool(holds)), layout="constrained"
    )
    upper: Any = figure
    lower: Any = None
    if holds:
        parts: Any = figure.subfigures(2, 1, height_ratios=[sum(rows), 2.4])
        upper, lower = parts
    panels = list(upper.subplots(len(rows), 1, height_ratios=rows))
    drawn = _band(panels[0], run.t, run, exact)
    names = {"simulated": caption.band}
    _legend_below(
        figure, {names.get(name, name): handle for name, handle in drawn.items()}
    )
    panels[0].set(
        xlabel=caption.along("time"), ylabel=caption.force, xlim=(run.t[0], run.t[-1])
    )
    panels[0].set_title(caption.heading)
    _band(panels[1], run.X, run, exact)
    panels[1].set(xlabel=caption.along("X"), ylabel=caption.force)
    for panel in panels[:2]:
        caption.beside(panel)
    if exact is not None:
        sigma = np.hypot(run.force_stderr, exact.force_error)
        z = np.divide(
            run.force - exact.force, sigma, out=np.zeros_like(sigma), where=sigma > 0
        )
        limit = max(4.0, 1.1 * np.abs(z).max())
        panels[2].axhspan(-2, 2, color="0.9")
        panels[2].plot(run.t, z, color="C0", linewidth=0.8)
        panels[2].set(
            ylim=(-limit, limit),
            xlim=(run.t[0], run.t[-1]),
            xlabel=caption.along("time"),
        )
        panels[2].set_ylabel("difference\n[standard errors]")
    marked = [panels[0], *panels[2:]]
    for segment in run.segments[:-1] if len(run.segments) <= _MOST_MARKS else ():
        for panel in marked:
            panel.axvline(segment.t, color="0.6", linewidth=0.7)
    below = (
        lower.subplots(1, len(holds), squeeze=False, sharey=True)[0] if lower else ()
    )
    for axes, index in zip(below, holds, strict=True):
        here = np.flatnonzero(run.segment == index)
        begin = run.t[here[0] - 1] if index else 0.0
        _band(axes, run.t - begin, run, exact, here)
        axes.set_xscale("log")
        axes.set(
            xlabel=with_unit(
                f"time held, segment {index}", unit_text(caption.units, TIME)
            )
        )
        panels.append(axes)
    if lower:
        panels[-len(holds)].set(ylabel=caption.force)
    for panel in panels:
        panel.grid(alpha=0.3)
    return figure


@styled
def slider_figure(
    run: "SliderTrajectory", exact: "Transient | None", caption: Caption
) -> Figure:
    """The force of the spring and friction against t, with slips marked; slider and
    stage against t; and the force of the spring against the velocity of the slider."""
    figure = Figure(figsize=(9, 8.8), layout="constrained")
    force, place, phase = figure.subplots(3, 1, height_ratios=[1.2, 1.0, 1.2])
    low, high = run.force - 2 * run.force_stderr, run.force + 2 * run.force_stderr
    band = force.fill_between(run.t, low, high, color="C0", alpha=0.3, linewidth=0)
    drawn: dict[str, Any] = {
        "friction of the contacts, ± 2 standard errors at the same X": (
            band,
            force.plot(run.t, run.force, color="C0", linewidth=1)[0],
        ),
        "force of the spring; displacement of the stage": force.plot(
            run.t, run.spring, color="C3", linewidth=1
        )[0],
    }
    if exact is not None:
        drawn["friction, mean field"] = force.plot(
            run.t, exact.force, color="k", linewidth=0.8, linestyle=":"
        )[0]
    if len(run.slips) <= _MOST_MARKS:
        for slip in run.slips:
            force.axvline(slip.t, color="0.7", linewidth=0.7, zorder=0)
    force.set(ylabel=caption.length("force / $(N k)$"), xlim=(run.t[0], run.t[-1]))
    caption.beside(force)
    force.set_title(caption.heading)
    place.plot(run.t, run.stage, color="C3", linewidth=1)
    drawn["displacement of the slider"] = place.plot(
        run.t, run.X, color="C0", linestyle="--", linewidth=1
    )[0]
    place.set(ylabel=caption.length("displacement"), xlim=(run.t[0], run.t[-1]))
    velocity = np.gradient(run.X, run.t)
    phase.plot(velocity, run.spring, color="C3", linewidth=0.7)
    speed = with_unit(
        "velocity of the slider, between two records",
        unit_text(caption.units, VELOCITY),
    )
    phase.set(xlabel=speed, ylabel=caption.length("force of the spring / $(N k)$"))
    driven = np.abs(np.diff(run.stage) / np.diff(run.t)).max()
    if np.abs(velocity).max() > _FAST * driven > 0:
        phase.set_xscale("symlog", linthresh=driven)
    for panel in (force, place):
        panel.set_xlabel(caption.along("time"))
    for panel in (force, place, phase):
        panel.grid(alpha=0.3)
    _legend_below(figure, drawn)
    return figure


@styled
def curve_figure(columns: dict[str, Array], along: str, caption: Caption) -> Figure:
    """An exact curve with its error band along the column X or t: the force; below, the
    pinned fraction where contacts spend time detached, the mean threshold of a closure,
    or slider and stage of a spring."""
    below = [
        name
        for name in ("pinned", "mean_threshold")
        if name in columns
        and np.ptp(columns[name]) > 2 * columns[f"{name}_error"].max()
    ]
    panels = ["force", *below, *(["X"] if "stage" in columns else [])]
    heights = [2.4] + [1.3] * (len(panels) - 1)
    figure = Figure(figsize=(8, 1.2 + 1.2 * sum(heights)), layout="constrained")
    every = figure.subplots(
        len(panels), 1, sharex=True, squeeze=False, height_ratios=heights
    )[:, 0]
    x = columns[along]
    labels = {
        "force": caption.force, "pinned": "pinned fraction\n$N_c / N$", "X": caption.length("displacement"),
        "mean_threshold": caption.length("mean threshold"),
    }  # fmt: skip
    for axes, name in zip(every, panels, strict=True):
        y, error = columns[name], columns[f"{name}_error"]
        axes.fill_between(x, y - error, y + error, color="C0", alpha=0.3, linewidth=0)
        axes.plot(x, y, color="C0", linewidth=1.2, label="slider")
        axes.set(ylabel=labels[name], xlim=(x[0], x[-1]))
        axes.grid(alpha=0.3)
    if columns["force"][0] == 0 <= columns["force"].min():
        every[0].set_ylim(bottom=0)
    if "pinned" in panels:
        every[1].set_ylim(0, 1.05)
    if "stage" in columns:
        every[-1].plot(x, columns["stage"], color="C3", linewidth=1, label="stage")
        every[-1].legend(loc="upper left")
    every[0].set_title(caption.heading)
    caption.beside(every[0])
    every[-1].set_xlabel(caption.along("time" if along == "t" else along))
    figure.align_ylabels(list(every))
    return figure


def curve_picture(file: "RunFile", name: str, columns: dict[str, Array]) -> Figure:
    """The exact curve of a run file, titled with its `name` unless it has a title."""
    level = Estimate(float(columns["force"][-1]), None, 0)
    along = "X" if isinstance(file.drive, Drive) else "t"
    return curve_figure(columns, along, caption(file, level, name))


@styled
def stability_figure(
    found: "Stability", borders: dict[str, Any], caption: Caption
) -> Figure:
    """The critical stiffness over velocity, of steady sliding and of the first slip,
    and the run's own point."""
    figure = Figure(figsize=(7, 5), layout="constrained")
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
        axes.plot(
            velocity[known],
            steady[known],
            color="C3",
            marker=".",
            label="steady sliding is unstable below",
        )
        axes.fill_between(
            velocity, 0, np.where(known, steady, 0), color="C3", alpha=0.12, linewidth=0
        )
    if shown.any():
        axes.plot(
            velocity[shown],
            fresh[shown],
            color="C0",
            linestyle="--",
            marker=".",
            label="a fresh start jumps below",
        )
    axes.plot(
        [found.velocity],
        [found.stiffness],
        "k*",
        markersize=12,
        label=f"this run, {found.verdict}",
    )
    axes.set(xscale="log", yscale="log", xlabel=caption.along("drive.velocity"))
    axes.set_ylabel(caption.along("drive.stage.stiffness"))
    values = np.concatenate((steady[known], fresh[shown], [found.stiffness]))
    axes.set_ylim(0.3 * values.min(), 3.0 * values.max())
    axes.set_title(caption.heading)
    axes.legend(loc="best", fontsize=8)
    axes.grid(alpha=0.3)
    return figure


@styled
def fluctuations_figure(exact: "Fluctuations", sample: Any, caption: Caption) -> Figure:
    """The exact autocovariance over the lag, and that of simulated contacts with error
    bars, if there is a `sample`."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.axhline(0.0, color="0.6", linewidth=0.7)
    axes.plot(
        exact.lag, exact.covariance, color="k", linewidth=1, label="exact", zorder=3
    )
    if sample is not None:
        every = max(1, exact.lag.size // 30)
        bars: dict[str, Any] = {
            "color": "C0",
            "linestyle": "none",
            "marker": "o",
            "markersize": 4,
            "capsize": 2,
        }
        label = f"{sample.ensembles} ensembles of {sample.contacts} contacts ± 2 standard errors"
        axes.errorbar(
            exact.lag[::every],
            sample.covariance[::every],
            2 * sample.stderr[::every],
            label=label,
            **bars,
        )
    axes.set(
        xlabel=with_unit("lag in displacement", unit_text(caption.units, LENGTH)),
        xlim=(0, exact.lag[-1]),
    )
    covariance = r"autocovariance  $N\,\mathrm{Cov}(F, F') / (N k)^2$"
    axes.set(
        ylabel=with_unit(covariance, unit_text(caption.units, AREA, unknown=False))
    )
    axes.set_title(caption.heading)
    axes.legend(loc="upper right")
    return figure


@styled
def elastic_figure(
    run: "ElasticTrajectory", friction: Estimate, caption: Caption
) -> Figure:
    """F(D) with its error band and the exact mean over displacement; below, how far
    blocks are apart."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    top, low = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1.0])
    if run.force_replica_std is not None:
        low_edge, high_edge = (
            run.force - run.force_replica_std,
            run.force + run.force_replica_std,
        )
        top.fill_between(
            run.D,
            low_edge,
            high_edge,
            color="0.85",
            linewidth=0,
            label="± standard deviation between replicas",
        )
    error, of = (
        2 * run.force_stderr,
        "" if run.force_replica_std is not None else " of contacts at the same X",
    )
    said = f"simulated contacts, mean ± 2 standard errors{of}"
    top.fill_between(
        run.D, run.force - error, run.force + error, color="C0", alpha=0.3, linewidth=0
    )
    top.plot(run.D, run.force, color="C0", linewidth=1, label=said)
    label = "exact mean over displacement, steady sliding"
    top.axhline(
        friction.value or 0.0, color="C3", linewidth=1, linestyle="--", label=label
    )
    top.set(ylabel=caption.force, ylim=(0, None))
    caption.beside(top)
    top.set_title(caption.heading)
    top.legend(loc="lower right", fontsize=8)
    X = _in_space(run, "X")
    low.plot(run.D, X.std(axis=1), color="C2", linewidth=1)
    low.set(
        xlabel=caption.along("D"),
        ylabel=with_unit(
            "standard deviation\nof $X$ between blocks",
            unit_text(caption.units, LENGTH, unknown=False),
        ),
        xlim=(run.D[0], run.D[-1]),
        ylim=(0, None),
    )
    for axes in (top, low):
        axes.grid(alpha=0.3)
    return figure


@styled
def avalanches_figure(run: "ElasticTrajectory", law: Array, caption: Caption) -> Figure:
    """Sizes of avalanches over the second half of the plate's way on the exact law,
    P(1), P(2), ... ; and how many blocks take part."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
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
    if law.size:
        left.plot(
            np.arange(1, law.size + 1),
            law,
            color="k",
            linewidth=1,
            label="infinitely many contacts (M/G/1)",
        )
    lowest = max(0.2 * (seen * share)[shown].min(initial=1.0), 1e-300)
    left.set(
        xscale="log",
        yscale="log",
        xlabel="breaks of an avalanche  $s$",
        ylabel="probability  $P(s)$",
    )
    left.set(xlim=(0.8, 1.3 * most), ylim=(lowest, 2.0))
    left.legend(loc="lower left", fontsize=8)
    mean = np.bincount(which, blocks, minlength=seen.size)[shown] / seen[shown]
    right.plot(
        centre[shown],
        mean,
        "s",
        markersize=4,
        color="C1",
        label="mean of the avalanches of that size",
    )
    right.plot(
        [1, most],
        [1, most],
        color="0.6",
        linewidth=0.8,
        linestyle=":",
        label="every break in another block",
    )
    right.set(
        xscale="log",
        yscale="log",
        xlabel="breaks of an avalanche  $s$",
        ylabel="blocks that take part",
    )
    right.legend(loc="upper left", fontsize=8)
    figure.suptitle(caption.heading, fontsize=10)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


@styled
def fronts_figure(
    run: "ElasticTrajectory", nx: int, ny: int, caption: Caption
) -> Figure:
    """Draw the first replica in space and time: how far each block is beyond the mean,
    and breaks between records; of a sheet of `ny` rows of `nx` blocks along its middle
    row, and the whole sheet at the end."""
    figure = Figure(figsize=(10, 4.6 if ny == 1 else 8.4), layout="constrained")
    panels = figure.subplots(2 if ny > 1 else 1, 2, squeeze=False)
    X, breaks = _in_space(run, "X"), _in_space(run, "breaks")
    row = slice(ny // 2 * nx, (ny // 2 + 1) * nx)
    beyond, active = X - X.mean(axis=1, keepdims=True), np.diff(breaks, axis=0)
    across = "block" if ny == 1 else f"block of row {ny // 2}"
    label = with_unit(
        "$X$ beyond the mean of all blocks",
        unit_text(caption.units, LENGTH, unknown=False),
    )
    _image(panels[0, 0], beyond[:, row], nx, run.D[-1], label, spread=True)
    _image(panels[0, 1], active[:, row], nx, run.D[-1], "breaks between two records")
    for axes in panels[0]:
        axes.set(xlabel=across, ylabel=caption.length("displacement of the plate  $D$"))
    if ny > 1:
        _image(
            panels[1, 0],
            beyond[-1].reshape(ny, nx),
            nx,
            ny,
            label + ", at the end",
            spread=True,
        )
        force = _in_space(run, "force")[-1].reshape(ny, nx)
        _image(
            panels[1, 1],
            force,
            nx,
            ny,
            with_unit(
                "force $F / (n k)$, at the end",
                unit_text(caption.units, LENGTH, unknown=False),
            ),
        )
        for axes in panels[1]:
            axes.set(xlabel="column", ylabel="row")
    figure.suptitle(caption.heading, fontsize=10)
    return figure


def _in_space(run: "ElasticTrajectory", name: str) -> Array:
    """A column of the records of blocks of the first replica, shape (points, B)."""
    points = run.D.size
    blocks = int(run.blocks["block"][-1]) + 1
    return np.asarray(run.blocks[name][: points * blocks].reshape(points, blocks))


def _image(
    axes: Axes,
    values: Array,
    width: float,
    height: float,
    label: str,
    spread: bool = False,
) -> None:
    """Draw values over space and time, or over space, thinned to what can be seen;
    `width` and `height` are those of all values in the units of the axes."""
    step = [max(1, -(-size // _MOST_ROWS)) for size in values.shape]
    values = values[:: step[0], :: step[1]]
    limit = float(np.abs(values).max(initial=0.0)) or 1.0
    look: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
    if not spread:  # a few large values would leave all others in the dark
        look = {
            "cmap": "magma",
            "vmin": values.min(),
            "vmax": float(np.quantile(values, _BRIGHTEST)) or 1.0,
        }
    extent = (0.0, width, 0.0, height)
    image = axes.imshow(
        values,
        origin="lower",
        aspect="auto",
        extent=extent,
        interpolation="nearest",
        **look,
    )
    axes.figure.colorbar(
        image, ax=axes, label=label, extend="neither" if spread else "max"
    )


def _band(
    axes: Axes,
    x: Any,
    run: "ProgrammeTrajectory",
    exact: "Transient | None",
    here: Any = slice(None),
) -> dict[str, Any]:
    """The force against `x` with its error band, and the exact mean; what the legend
    needs."""
    force, error = run.force[here], 2 * run.force_stderr[here]
    band = axes.fill_between(
        x[here], force - error, force + error, color="C0", alpha=0.3, linewidth=0
    )
    line = axes.plot(x[here], force, color="C0", linewidth=1)[0]
    drawn: dict[str, Any] = {"simulated": (band, line)}
    if exact is not None:
        drawn[_EXACT] = axes.plot(
            x[here], exact.force[here], color="k", linewidth=0.8, linestyle=":"
        )[0]
    return drawn


def _compare(
    axes: Axes,
    run: "Trajectory",
    name: str,
    color: str,
    steady: Estimate,
    exact: "Transient | None",
) -> dict[str, Any]:
    """A curve with its error band, the steady value and the exact mean; what the legend
    needs."""
    y, error = getattr(run, name), 2 * getattr(run, f"{name}_stderr")
    value, stderr = steady.value or 0.0, steady.stderr or 0.0
    band = axes.fill_between(
        run.X, y - error, y + error, color=color, alpha=0.3, linewidth=0
    )
    simulated = "simulated" if name == "force" else f"simulated {name}"
    drawn: dict[str, Any] = {
        simulated: (band, axes.plot(run.X, y, color=color, linewidth=1)[0])
    }
    span = axes.axhspan(
        value - 2 * stderr, value + 2 * stderr, color="C3", alpha=0.25, linewidth=0
    )
    level = axes.axhline(value, color="C3", linewidth=1, linestyle="--")
    drawn["steady value (renewal-reward), ± 2 standard errors"] = span, level
    if exact is not None:
        line = axes.plot(
            run.X, getattr(exact, name), color="k", linewidth=0.8, linestyle=":"
        )[0]
        drawn[_EXACT] = line
    return drawn


@styled
def validation_figure(result: "Validation") -> Figure:
    """Every score of a suite by kind, ensemble by colour, and all of them against the
    normal law."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
    rng = np.random.default_rng(0)
    kinds = [verdict.kind for verdict in result.verdicts]
    for disorder, color, marker in (("quenched", "C0", "o"), ("annealed", "C1", "^")):
        shown = [
            score for score in result.scores if score.ensemble.disorder == disorder
        ]
        x = [kinds.index(score.kind) for score in shown] + rng.uniform(
            -0.3, 0.3, len(shown)
        )
        z = np.clip([score.z for score in shown], -8, 8)
        left.scatter(x, z, s=9, color=color, marker=marker, alpha=0.6, label=disorder)
    said = {True: "passed", False: "FAILED"}
    names = [
        f"{v.kind.replace('_', ' ')}, {v.count}: {said[v.passed]}"
        for v in result.verdicts
    ]
    left.set_xticks(
        range(len(names)),
        names,
        fontsize=8,
        rotation=40,
        ha="right",
        rotation_mode="anchor",
    )
    left.set_xlabel("kind of comparison, how many, verdict")
    left.set_ylabel("$z$ = (engine - master) / standard error")
    left.set_title(
        f"suite {result.suite}, seed {result.seed}: {said[result.passed]}", fontsize=10
    )
    grid = np.linspace(-8, 8, 401)
    every = np.clip([score.z for score in result.scores], -8, 8)
    right.hist(
        every,
        bins=np.arange(-8, 8.5, 0.5),
        density=True,
        orientation="horizontal",
        color="0.8",
    )
    right.plot(
        np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi),
        grid,
        color="k",
        linewidth=1,
        label="standard normal",
    )
    right.set_xlabel(f"density of all {every.size} scores")
    for axes in (left, right):
        axes.legend(fontsize=8, loc="upper right")
        axes.axhline(0, color="0.5", linewidth=0.5)
        axes.grid(alpha=0.3)
    left.set_ylim(min(-4.5, every.min() - 0.5), max(4.5, every.max() + 0.5))
    return figure
