"""Pictures of fits: data with the fitted curve and residuals, profiles, and the ladder
of directions."""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.interpolate import PchipInterpolator

from eqsim.catalogue import COLUMNS, LENGTH, TIME, Dimension
from eqsim.errors import require_package
from eqsim.fitting.data import MEASURED
from eqsim.fitting.estimate import DEGENERATE, inverse_root
from eqsim.fitting.model import AVERAGES, Problem, SteadyForward, velocity_of
from eqsim.fitting.posterior import SHARES
from eqsim.fitting.profiles import LEVELS, WIDE
from eqsim.fitting.rate_and_state import RateAndStateForward
from eqsim.io.labels import axis, plain, unit_text, with_unit
from eqsim.model.drive import Programme
from eqsim.numerics.tables import Array
from eqsim.plots.panels import scores
from eqsim.plots.style import DASHES, MARKERS, styled, wrap_titles

if TYPE_CHECKING:
    from eqsim.fitting.fit import FitResult, Prepared
    from eqsim.fitting.posterior import Posterior

# Points of a curve between neighbouring velocities.
_BETWEEN = 8
# Singular values of J below which, relative to the largest, a direction has no effect.
_NO_EFFECT = 1e-6
_OBSERVABLE_LABELS = {
    "friction": "friction (unit of the data)",
    "pinned": "pinned fraction",
    "break_stretch": "mean stretch at breaking",
    "force_std": "standard deviation of the force",
    "peak_ratio": "first peak over steady force",
    "peak_X": "displacement of the first peak",
}


def band(problem: Problem, result: "FitResult") -> tuple[Array, Array]:
    """Predictions of `problem` with the parameters of a fit, and their standard
    deviations by linear propagation of the covariance of the fit, without directions
    that have no effect."""
    u, steps = result.best.u, problem.steps(result.best.u)
    values, columns = problem.given(u), []
    for i, signed in enumerate(np.where(u + steps <= problem.high, steps, -steps)):
        moved = u + signed * (np.arange(u.size) == i)
        columns.append((problem.given(moved) - values) / signed)
    root, _ = inverse_root(result.jacobian, _NO_EFFECT)
    return values, np.sqrt(((np.array(columns).T @ root) ** 2).sum(axis=1))


def _unit(result: "FitResult | Prepared", of: Dimension) -> str:
    """The unit of a record, given or natural; a model without contacts has none of the
    latter."""
    units = result.file.units
    if not isinstance(result.problem.forward, RateAndStateForward):
        return unit_text(units, of)
    return unit_text(replace(units, natural=()), of, unknown=False)


class _Abscissa(NamedTuple):
    """The abscissa of measurements: values, a label, and whether they are velocities or
    times, along which a fit is drawn as a curve."""

    values: Array
    label: str
    velocities: bool
    times: bool

    @classmethod
    def of(cls, result: "FitResult | Prepared") -> "_Abscissa":
        """Time of a record, the velocity if it changes, else the measurement's number."""
        table, units = result.table, result.file.units
        if table.time is not None:
            label = with_unit(COLUMNS["time"].mathtext, _unit(result, TIME))
            return cls(table.time, label, False, True)
        given = map(velocity_of, table.conditions)
        steady = result.file["drive.velocity"]
        velocity = np.array([steady if v is None else v for v in given], float)
        if np.unique(velocity[np.isfinite(velocity)]).size > 1:
            return cls(velocity, axis("drive.velocity", units), True, False)
        return cls(np.arange(1.0, table.value.size + 1), "measurement", False, False)


@styled
def fit_figure(result: "FitResult", title: str) -> Figure:
    """Draw each observable against time, velocity or number of the measurement, with
    the fitted curves and their bands; below, residuals."""
    shown = [name for name in MEASURED if name in result.table.observable]
    figure = Figure(figsize=(8, 1.0 + 4.6 * len(shown)))
    heights = [2.6, 1.0] * len(shown)
    panels: Any = figure.subplots(len(heights), 1, height_ratios=heights)
    x = _Abscissa.of(result)
    for name, top, below in zip(shown, panels[::2], panels[1::2], strict=True):
        _draw_observable(result, name, x, top, below)
    good = result.goodness
    p = "" if good.p is None else f", p = {good.p:.2g}"
    fit = f"chi-square {good.chi2:.1f} of {good.dof} degrees of freedom{p}"
    bars = "bars: 1 standard error, bands: 68 and 95 %"
    panels[0].set_title(plain(f"{title}\n{fit}; {bars}"))
    figure.align_ylabels(panels)
    return figure


@styled
def data_figure(prepared: "Prepared", title: str) -> Figure:
    """Draw what was read: each observable against time, velocity or number of the
    measurement; of a record also the rows before block means, in grey, and where
    segments of the programme end."""
    shown = [name for name in MEASURED if name in prepared.table.observable]
    figure = Figure(figsize=(8, 1.0 + 3.6 * len(shown)))
    panels: Any = figure.subplots(len(shown), 1, squeeze=False).ravel()
    x = _Abscissa.of(prepared)
    for name, panel in zip(shown, panels, strict=True):
        _draw_data(panel, prepared, name, x)
        panel.set_xlabel(x.label)
    if prepared.table.read is not None and isinstance(prepared.file.drive, Programme):
        t, force = prepared.table.read
        if t.size > prepared.table.value.size:
            panels[0].plot(t, force, color="0.8", linewidth=0.4, zorder=0)
        for end in prepared.file.drive.corners[0][1:]:
            panels[0].axvline(end, color="0.6", linestyle=":", linewidth=0.7)
    panels[0].set_title(plain(f"{title}\n{'; '.join(prepared.table.said)}"))
    return figure


def _draw_data(
    panel: Any, result: "FitResult | Prepared", name: str, x: _Abscissa
) -> list[tuple[list[int], dict[str, Any]]]:
    """Draw the measurements of an observable with their errors; return the members of
    each series and the look of its points."""
    here = np.array(result.table.observable) == name
    series, size, drawn = _series(result, here), 2 if x.times else 4, []
    for number, (label, members) in enumerate(series.items()):
        look = {"color": f"C{number % 8}", "marker": MARKERS[number % len(MARKERS)]}
        style = {**look, "markersize": size, "linestyle": "none"}
        data = result.table.value[members], result.table.sigma[members]
        panel.errorbar(x.values[members], *data, label=label, capsize=size - 2, **style)
        drawn.append((members, style))
    value = result.table.value[here]
    if np.all(value > 0) and np.ptp(np.log(value)) > np.log(8.0):
        panel.set_yscale("log")
    if x.velocities:
        panel.set_xscale("log")
    if len(series) > 1:
        panel.legend()
    panel.set(ylabel=_OBSERVABLE_LABELS[name])
    return drawn


def _draw_observable(
    result: "FitResult", name: str, x: _Abscissa, top: Any, below: Any
) -> None:
    """Draw an observable and its fit into one panel, and residuals into another."""
    problem = result.problem
    r = (problem.value - problem.given(result.best.u)) / result.table.sigma
    for number, (members, style) in enumerate(_draw_data(top, result, name, x)):
        below.plot(x.values[members], r[members], **style)
        if x.times or x.velocities:
            along, y, sd = _fitted_curve(result, members, x)
            color, dashes = style["color"], DASHES[number % len(DASHES)]
            top.plot(along, y, color=color, linestyle=dashes)
            for level, alpha in (("95", 0.15), ("68", 0.3)):
                low, high = (y + s * np.sqrt(LEVELS[level]) * sd for s in (-1.0, 1.0))
                look = {"color": color, "alpha": alpha, "linewidth": 0}
                top.fill_between(along, low, high, **look)
    scores(below, r[np.array(result.table.observable) == name], "residual")
    below.axhline(0, color="0.6", linewidth=0.7)
    below.set(xlabel=x.label, xscale=top.get_xscale())


def _series(result: "FitResult | Prepared", here: Array) -> dict[str, list[int]]:
    """Group measurements that differ in velocity only; keys are labels of the rest."""
    table, series = result.table, dict[str, list[int]]()
    for index in np.flatnonzero(here).tolist():
        row = table.conditions[index]
        shared = [f"{k} = {v:g}" for k, v in row.changes if k != "drive.velocity"]
        if result.fit.temperature is not None:
            shared.insert(0, f"T = {row.kelvin:g} K")
        if row.set:
            shared.append(f"set {row.set}")
        series.setdefault(", ".join(shared), []).append(index)
    return series


def _fitted_curve(
    result: "FitResult", members: list[int], x: _Abscissa
) -> tuple[Array, Array, Array]:
    """The fit along a record, or over the velocities of the `members` of a series:
    abscissa, prediction and its standard deviation."""
    problem = result.problem
    if x.times:
        y, sd = band(problem, result)
        return x.values, y + result.fixed, sd
    assert isinstance(problem.forward, SteadyForward)
    fine = np.unique(x.values[members])
    if problem.forward.observable[members[0]] in AVERAGES:  # others take a solve each
        fine = np.geomspace(fine[0], fine[-1], _BETWEEN * max(fine.size - 1, 2) + 1)
    like = problem.forward.rows[members[0]]
    shared = tuple(item for item in like.changes if item[0] != "drive.velocity")
    rows = [
        like._replace(changes=(*shared, ("drive.velocity", v))) for v in fine.tolist()
    ]
    return fine, *band(problem.elsewhere(members[0], rows), result)


@styled
def compared_figure(models: "Mapping[str, FitResult]", title: str) -> Figure:
    """Draw a record against the displacement of the load point (against time if it is
    held) with the curves of several models, and the residuals of each below."""
    first = next(iter(models.values()))
    x, programme = _Abscissa.of(first), first.file.drive
    assert isinstance(programme, Programme)
    if all(segment.velocity for segment in programme.segments):
        label = with_unit("displacement of the load point", _unit(first, LENGTH))
        x = x._replace(values=programme.position(x.values), label=label)
    figure = Figure(figsize=(8, 3.6 + 1.5 * len(models)))
    heights = [2.4, *[1.0] * len(models)]
    top, *below = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    table, bars = first.table, {"color": "0.55", "markersize": 2, "fmt": "o"}
    top.errorbar(x.values, table.value, table.sigma, label="record", zorder=1, **bars)
    for number, ((name, one), panel) in enumerate(
        zip(models.items(), below, strict=True)
    ):
        predicted = one.problem.solved(one.best.u).predicted
        line = {"color": f"C{number}", "linestyle": DASHES[number % len(DASHES)]}
        top.plot(x.values, predicted + one.fixed, label=name, **line)
        r = (one.problem.value - predicted) / table.sigma
        marks = {"color": f"C{number}", "marker": "o", "markersize": 2}
        panel.plot(x.values, r, linestyle="none", **marks)
        scores(panel, r, "residual")
        said = f"{name}: chi-square {one.chi2_as_given:.1f} of {one.goodness.dof}"
        panel.set_title(plain(said), fontsize=8, loc="left")
    top.set_ylabel(_OBSERVABLE_LABELS["friction"])
    top.legend()
    figure.axes[-1].set_xlabel(x.label)
    top.set_title(plain(f"{title}\nbars: 1 standard error; chi-square with these"))
    figure.align_ylabels(figure.axes)
    return figure


@styled
def profiles_figure(result: "FitResult", title: str) -> Figure:
    """Draw chi-square over each parameter with all others at their best, and the levels
    of the intervals."""
    count = len(result.intervals)
    wide = min(3, count)
    tall = -(-count // wide)
    figure = Figure(figsize=(4.0 * wide, 0.6 + 3.0 * tall))
    panels: Any = figure.subplots(tall, wide, squeeze=False, sharey=True).ravel()
    for index in range(count):
        _draw_profile(result, index, panels[index])
    for panel in panels[count:]:
        panel.set_visible(False)
    for panel in panels[::wide]:
        panel.set_ylabel("chi-square above the least")
    legend = "orange: best fit; thick black: a bound reached first"
    figure.suptitle(plain(f"{title}: profile likelihood ({legend})"))
    return figure


def _draw_profile(result: "FitResult", index: int, panel: Any) -> None:
    """Draw the profile of a parameter."""
    parameter, known = result.problem.parameters[index], result.intervals[index]
    low, high = result.profiles[parameter.key]
    u = np.concatenate((low.points[::-1, index], high.points[1:, index]))
    rise = np.concatenate((low.rise[::-1], high.rise[1:]))
    value, top = parameter.value(u), 1.35 * max(LEVELS.values())
    panel.plot(value, rise, color="C0", marker=".", linestyle="none")
    if np.all(np.diff(u) > 0):  # nearly a straight line of the signed root
        fine = np.linspace(u[0], u[-1], 200)
        signed = np.sqrt(np.maximum(rise, 0.0)) * np.sign(u - result.best.u[index])
        smooth = PchipInterpolator(u, signed)(fine) ** 2
        panel.plot(parameter.value(fine), smooth, color="C0")
    place = {"xycoords": ("axes fraction", "data"), "ha": "left", "va": "center"}
    for name, level in LEVELS.items():
        panel.axhline(level, color="0.5", linewidth=0.8, linestyle=":")
        panel.annotate(f"{name} %", (1.01, level), fontsize=7, color="0.4", **place)
    panel.axvline(known.estimate, color="C3", linewidth=0.8)
    for side, bound in ((low, parameter.low), (high, parameter.high)):
        if side.ends["95"] is None:
            panel.axvline(float(parameter.value(bound)), color="k", linewidth=1.5)
    panel.locator_params(axis="x", nbins=5)
    positive = parameter.transform != "linear" and value.min() > 0
    if positive and np.ptp(np.log10(value)) > 1.5:
        panel.set_xscale("log")
        panel.xaxis.set_minor_formatter(NullFormatter())
    label = axis(parameter.key, result.file.units, unknown=False)
    panel.set(ylim=(-0.03 * top, top), xlabel=f"{label}: {known.status}")


@styled
def identifiability_figure(result: "FitResult", title: str) -> Figure:
    """Standard deviation of the parameters along each eigenvector of J'J, and components
    of these."""
    rungs, keys = result.ladder, result.problem.keys
    size = (4.5 + 1.1 * len(keys), 1.8 + 0.6 * len(keys))
    figure = Figure(figsize=size)
    ratios = [1.1, max(1.0, 0.35 * len(keys))]
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=ratios)
    sd = np.array([min(rung.sd, 1e6) for rung in rungs])
    colors = [
        "C3" if rung.ratio < DEGENERATE else "C1" if rung.sd > WIDE else "C0"
        for rung in rungs
    ]
    rows = np.arange(len(rungs))
    left.barh(rows, sd, left=1e-4, color=colors, height=0.6)
    left.axvline(WIDE, color="k", linestyle=":")
    left.set(xscale="log", xlim=(1e-4, max(10, 3 * sd.max())), ylabel="direction")
    left.set_xlabel("standard deviation along it\n(dotted: 1.1, a factor 3)")
    left.set_yticks(rows, [str(number + 1) for number in rows])
    components = np.array([[rung.components[key] for key in keys] for rung in rungs])
    image = right.imshow(components, vmin=-1, vmax=1, cmap="RdBu_r", aspect="auto")
    for (row, column), component in np.ndenumerate(components):
        style = {"ha": "center", "va": "center", "fontsize": 8}
        color = "w" if abs(component) > 0.6 else "k"
        right.text(column, row, f"{component:+.2f}", color=color, **style)
    right.grid(False)
    right.set_xticks(np.arange(len(keys)), keys, rotation=30, ha="right", fontsize=8)
    figure.colorbar(image, ax=right, label="component")
    figure.suptitle(plain(f"{title}: what the data determine, best first"))
    return figure


@styled
def posterior_figure(sampled: "Posterior", title: str) -> Figure:
    """Draw samples of the posterior by pairs of keys, in the variables that were fitted,
    with the quantiles of intervals. Raises InputError without corner."""
    corner = require_package("posterior", "corner")
    labels = [one.variable_name for one in sampled.problem.parameters]
    size = 2.2 * len(labels) + 0.8
    by_corner: dict[str, Any] = {"layout": "none"}
    figure = Figure(figsize=(size, size), **by_corner)
    style = {"label_kwargs": {"fontsize": 8}, "color": "C0", "max_n_ticks": 4}
    quantiles = SHARES["95"]
    corner.corner(
        sampled.points, labels=labels, quantiles=quantiles, fig=figure, **style
    )
    for panel in figure.axes:
        panel.grid(False)
    heading = f"{title}: posterior".removeprefix(": ") + " (dashed: 95 %)"
    figure.suptitle(plain(heading))
    wrap_titles(figure)
    share, place = size / figure.get_figheight(), figure.subplotpars
    figure.subplots_adjust(bottom=share * place.bottom, top=share * place.top)
    return figure
