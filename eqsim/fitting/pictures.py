"""Pictures of fits: data with the fitted curve and residuals, profiles, and the ladder
of directions."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.interpolate import PchipInterpolator

from eqsim.errors import require_package
from eqsim.fitting.data import MEASURED
from eqsim.fitting.estimate import DEGENERATE
from eqsim.fitting.model import Problem, SteadyForward
from eqsim.fitting.posterior import SHARES
from eqsim.fitting.profiles import LEVELS, WIDE
from eqsim.io.labels import axis, plain
from eqsim.io.style import DASHES, MARKERS, styled
from eqsim.numerics.tables import Array

if TYPE_CHECKING:
    from eqsim.fitting.fit import FitResult
    from eqsim.fitting.posterior import Posterior

_BETWEEN = 8  # points of a curve between neighbouring velocities
_LABELS = {
    "friction": "friction (unit of the data)", "pinned": "pinned fraction", "break_stretch": "mean stretch at breaking",
    "force_std": "standard deviation of the force", "peak_ratio": "first peak over steady force",
    "peak_X": "displacement of the first peak",
}  # fmt: skip


def band(problem: Problem, u: Array, covariance_root: Array) -> tuple[Array, Array]:
    """Predictions of `problem` with parameters `u` and their standard deviations, by
    their derivatives and the `covariance_root` of the fit, shape (parameters, any): J'J
    inverted but for directions that have no effect."""
    values = problem.given(u)
    columns = []
    for i in range(u.size):
        step = problem.step if u[i] + problem.step <= problem.high[i] else -problem.step
        moved = u + step * (np.arange(u.size) == i)
        columns.append((problem.given(moved) - values) / step)
    return values, np.sqrt(((np.array(columns).T @ covariance_root) ** 2).sum(axis=1))


def root(jacobian: Array) -> Array:
    """A root of the inverse of J'J, directions of a ratio below 1e-13 left out."""
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    keep = singular > 1e-6 * singular[0]
    return (rows[keep] / singular[keep, None]).T


@styled
def fit_figure(result: "FitResult", title: str) -> Figure:
    """Each observable against velocity, or against the number of the measurement if
    that does not change, with the fitted curves and their bands; below, residuals."""
    problem, table = result.problem, result.table
    shown = [name for name in MEASURED if name in table.observable]
    figure = Figure(figsize=(8, 1.0 + 4.6 * len(shown)), layout="constrained")
    panels: Any = figure.subplots(
        2 * len(shown), 1, squeeze=False, height_ratios=[2.6, 1.0] * len(shown)
    )[:, 0]
    covariance_root = root(problem.jacobian(result.best.u))
    velocity = np.array(
        [
            dict(table.rows[row].changes).get("drive.velocity", np.nan)
            for row in table.row
        ]
    )
    moving = np.unique(velocity[np.isfinite(velocity)]).size > 1
    x = (
        velocity
        if moving
        else np.arange(1.0, table.row.size + 1)
        if table.time is None
        else table.time
    )
    names = np.array(table.observable)
    r = (problem.value - problem.given(result.best.u)) / table.sigma
    for name, top, below in zip(shown, panels[::2], panels[1::2], strict=True):
        for number, (label, members) in enumerate(_series(result, names == name)):
            color, marker = f"C{number % 8}", MARKERS[number % len(MARKERS)]
            size = 4 if table.time is None else 2
            style = {
                "color": color,
                "marker": marker,
                "linestyle": "none",
                "markersize": size,
                "capsize": size - 2,
            }
            top.errorbar(
                x[members],
                problem.value[members],
                table.sigma[members],
                label=label,
                **style,
            )
            below.plot(
                x[members],
                r[members],
                color=color,
                marker=marker,
                linestyle="none",
                markersize=size,
            )
            if moving or table.time is not None:
                if table.time is not None:
                    fine, (middle, sd) = (
                        table.time,
                        band(problem, result.best.u, covariance_root),
                    )
                else:
                    fine, middle, sd = _curve(
                        result, members, velocity[members], covariance_root
                    )
                top.plot(
                    fine,
                    middle,
                    color=color,
                    linewidth=1,
                    linestyle=DASHES[number % len(DASHES)],
                )
                for level, alpha in (("95", 0.15), ("68", 0.3)):
                    wide = float(np.sqrt(LEVELS[level])) * sd
                    top.fill_between(
                        fine,
                        middle - wide,
                        middle + wide,
                        color=color,
                        alpha=alpha,
                        linewidth=0,
                    )
        positive = np.all(table.value[names == name] > 0)
        if positive and np.ptp(np.log(table.value[names == name])) > np.log(8.0):
            top.set_yscale("log")
        below.axhspan(-2, 2, color="0.9")
        below.axhline(0, color="0.6", linewidth=0.7)
        limit = max(3.0, 1.15 * np.abs(r[names == name]).max())
        below.set(ylim=(-limit, limit), ylabel="residual\n[standard errors]")
        speed, time = (
            axis(name, result.file.units) for name in ("drive.velocity", "time")
        )
        below.set_xlabel(
            speed if moving else "measurement" if table.time is None else time
        )
        top.set(ylabel=_LABELS[name])
        for panel in (top, below):
            panel.grid(alpha=0.3)
            if moving:
                panel.set_xscale("log")
        if len(_series(result, names == name)) > 1:
            top.legend(fontsize=8)
    good = result.goodness
    p = "" if good.p is None else f", p = {good.p:.2g}"
    said = f"chi-square {good.chi2:.1f} of {good.dof} degrees of freedom{p}; bars: 1 standard error, bands: 68 and 95 %"
    panels[0].set_title(plain(f"{title}\n{said}"), fontsize=10)
    figure.align_ylabels(panels)
    return figure


def _series(result: "FitResult", here: Array) -> list[tuple[str, Array]]:
    """Measurements that differ in velocity only, and what they share."""
    table = result.table
    found: dict[str, list[int]] = {}
    for index in np.flatnonzero(here):
        row = table.rows[table.row[index]]
        rest = [
            f"{key} = {value:g}"
            for key, value in row.changes
            if key != "drive.velocity"
        ]
        if result.fit.temperature is not None:
            rest.insert(0, f"T = {table.temperatures[table.row[index]]:g} K")
        if row.set:
            rest.append(f"set {row.set}")
        found.setdefault(", ".join(rest), []).append(int(index))
    return [(label, np.array(indices)) for label, indices in found.items()]


def _curve(
    result: "FitResult", members: Array, velocity: Array, covariance_root: Array
) -> tuple[Array, Array, Array]:
    """Velocities between those of some measurements, and the fitted curve there with
    its standard deviation."""
    forward, problem = result.problem.forward, result.problem
    assert isinstance(forward, SteadyForward)
    fine = np.geomspace(
        velocity.min(),
        velocity.max(),
        _BETWEEN * max(np.unique(velocity).size - 1, 2) + 1,
    )
    if forward.observable[members[0]] not in ("friction", "pinned", "break_stretch"):
        fine = np.unique(velocity)  # these take a solve each
    like = forward.rows[forward.row[members[0]]]
    rest = tuple(change for change in like.changes if change[0] != "drive.velocity")
    rows = [like._replace(changes=(*rest, ("drive.velocity", float(v)))) for v in fine]
    names = [forward.observable[members[0]]] * fine.size
    there = SteadyForward(forward.file, rows, np.arange(fine.size), names)
    ones = np.ones(fine.size)
    many = Problem(
        there, problem.parameters, ones, ones, np.full(fine.size, problem.scale_of[members[0]]), problem.fixed_scale,
        np.full(fine.size, problem.spread[members[0]]), problem.count, problem.stiffness, loss=problem.loss,
    )  # fmt: skip
    return fine, *band(many, result.best.u, covariance_root)


@styled
def profiles_figure(result: "FitResult", title: str) -> Figure:
    """Chi-square over each parameter with all others at their best, and the levels of
    the intervals."""
    parameters, units = result.problem.parameters, result.file.units
    wide = min(3, len(parameters))
    tall = -(-len(parameters) // wide)
    figure = Figure(figsize=(4.0 * wide, 0.6 + 3.0 * tall), layout="constrained")
    panels: Any = figure.subplots(tall, wide, squeeze=False, sharey=True).ravel()
    top = 1.35 * max(LEVELS.values())
    for panel, one, known in zip(panels, parameters, result.intervals, strict=False):
        low, high = result.profiles[one.key]
        index = parameters.index(one)
        u = np.concatenate((low.points[::-1, index], high.points[1:, index]))
        rise = np.concatenate((low.rise[::-1], high.rise[1:]))
        panel.plot(one.value(u), rise, color="C0", marker=".", linestyle="none")
        if np.all(np.diff(u) > 0):  # nearly a straight line of the signed root
            fine = np.linspace(u[0], u[-1], 200)
            signed = np.sqrt(np.maximum(rise, 0.0)) * np.sign(u - result.best.u[index])
            panel.plot(
                one.value(fine),
                PchipInterpolator(u, signed)(fine) ** 2,
                color="C0",
                linewidth=1,
            )
        for name, level in LEVELS.items():
            panel.axhline(level, color="0.5", linewidth=0.8, linestyle=":")
            panel.annotate(
                f"{name} %",
                (1.0, level),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize=7,
                color="0.4",
            )
        panel.axvline(known.estimate, color="C3", linewidth=0.8)
        for side, bound in ((low, one.low), (high, one.high)):
            if side.ends["95"] is None:
                panel.axvline(float(one.value(bound)), color="k", linewidth=1.5)
        panel.locator_params(axis="x", nbins=5)
        if (
            one.transform != "linear"
            and one.value(u).min() > 0
            and np.ptp(np.log10(one.value(u))) > 1.5
        ):
            panel.set_xscale("log")
            panel.xaxis.set_minor_formatter(NullFormatter())
        panel.set(
            ylim=(-0.03 * top, top),
            xlabel=f"{axis(one.key, units, unknown=False)}: {known.status}",
        )
        panel.grid(alpha=0.3)
    for panel in panels[len(parameters) :]:
        panel.set_visible(False)
    for panel in panels[::wide]:
        panel.set_ylabel("chi-square above the least")
    figure.suptitle(
        plain(
            f"{title}: profile likelihood (orange: best fit; thick black: a bound reached first)"
        ),
        fontsize=10,
    )
    return figure


@styled
def identifiability_figure(result: "FitResult", title: str) -> Figure:
    """How far parameters may move along each eigenvector of J'J, and what these consist
    of."""
    rungs, keys = result.ladder, [one.key for one in result.problem.parameters]
    figure = Figure(
        figsize=(4.5 + 1.1 * len(keys), 1.8 + 0.6 * len(keys)), layout="constrained"
    )
    left, right = figure.subplots(
        1, 2, sharey=True, width_ratios=[1.1, max(1.0, 0.35 * len(keys))]
    )
    sd = np.array([min(rung.sd, 1e6) for rung in rungs])
    at = np.arange(len(rungs))
    colors = [
        "C3" if rung.ratio < DEGENERATE else "C1" if rung.sd > WIDE else "C0"
        for rung in rungs
    ]
    left.barh(at, sd, left=1e-4, color=colors, height=0.6)
    left.axvline(WIDE, color="k", linestyle=":", linewidth=1)
    left.set(
        xscale="log",
        xlabel="standard deviation along it\n(dotted: 1.1, a factor 3)",
        xlim=(1e-4, max(10, 3 * sd.max())),
    )
    left.set_yticks(at, [str(number + 1) for number in at])
    left.set_ylabel("direction")
    parts = np.array([[rung.components[key] for key in keys] for rung in rungs])
    image = right.imshow(parts, vmin=-1, vmax=1, cmap="RdBu_r", aspect="auto")
    for row, column in np.ndindex(parts.shape):
        color = "w" if abs(parts[row, column]) > 0.6 else "k"
        right.text(
            column,
            row,
            f"{parts[row, column]:+.2f}",
            ha="center",
            va="center",
            fontsize=8,
            color=color,
        )
    right.set_xticks(np.arange(len(keys)), keys, rotation=30, ha="right", fontsize=8)
    figure.colorbar(image, ax=right, label="component")
    figure.suptitle(plain(f"{title}: what the data determine, best first"), fontsize=10)
    return figure


@styled
def posterior_figure(sampled: "Posterior", title: str) -> Figure:
    """Draws of the posterior by pairs of keys, in the variables that were fitted, with
    the quantiles of intervals. Raises InputError without corner."""
    corner = require_package("posterior", "corner")
    parameters = sampled.problem.parameters
    variables = {"log": "ln {}", "log1p": "ln(1 + {})", "linear": "{}"}
    size = 2.2 * len(parameters) + 0.8
    figure = Figure(figsize=(size, size))
    corner.corner(
        sampled.points, labels=[variables[one.transform].format(one.key) for one in parameters], quantiles=SHARES["95"],
        fig=figure, label_kwargs={"fontsize": 8}, color="C0", max_n_ticks=4,
    )  # fmt: skip
    figure.suptitle(
        plain(f"{title}: posterior".removeprefix(": ") + " (dashed: 95 %)"), fontsize=10
    )
    return figure
