"""Pictures of sweeps."""

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import pandas as pd
import pyarrow
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pyarrow import parquet as pq

from eqsim.errors import InputError, meant
from eqsim.estimate import Estimate
from eqsim.io import storage
from eqsim.io.content import DERIVED, of_population
from eqsim.io.export import RENAMED_COLUMNS
from eqsim.io.labels import axis, column_unit, plain, symbol
from eqsim.io.parameters import keys, parameters
from eqsim.io.runfile import RunFile, at, stored
from eqsim.io.units import Quantity, Units
from eqsim.master.steady import curve
from eqsim.model.healing import Healing, healing_law
from eqsim.numerics.tables import Array
from eqsim.plots.panels import Caption
from eqsim.plots.runs import draw_healing
from eqsim.plots.style import (
    COLORS,
    DASHES,
    MARKERS,
    PANELS,
    PAPER,
    STYLE,
    not_flat,
    wrapped,
)

Points = Any  # a pandas DataFrame, one point of a sweep a row
Column = Any  # a pandas Series

_SPREAD = 30.0  # an axis whose values span a greater factor is logarithmic
# Columns by the names that tables on a terminal give them.
PRINTED = {"mu": "friction_coefficient", "force": "friction_force"}
_MOST_SERIES = len(COLORS)  # series in a legend; more have a colour bar
_FINE_CURVE = 120  # points of a reference curve against velocity, which costs one solve
_COARSE_CURVE = 40  # points of one against another key
_MOST_SOLVES = 600  # solves for the reference curves of a picture
_REFERENCES = ("friction", "pinned", "break_stretch")
_POINT_LOOK: dict[str, Any] = {"marker": "o", "markersize": 5.5}
_DASH: dict[str, Any] = {"linestyle": "none", "marker": "_"}
# Marks that a legend explains, in order: what they are, and their looks.
_EXPLAINED: dict[str, tuple[str, dict[str, Any]]] = {
    "points": ("simulated", _DASH | _POINT_LOOK),
    "lines": ("master equation", {}),
    "dashes": ("master equation", {**_DASH, "markersize": 11}),
    "bars": ("± 2 standard errors", {**_DASH, "marker": "|", "markersize": 11}),
    "open": ("unreliable", _DASH | _POINT_LOOK | {"markerfacecolor": "white"}),
}


class Sweep(NamedTuple):
    """The points of a sweep, one a row, the run file they came from, if it is known,
    and how many points there will be."""

    table: Points
    file: RunFile | None = None
    planned: int | None = None

    @property
    def units(self) -> Units:
        return self.file.units if self.file else Units()

    @property
    def fractions(self) -> bool:
        """True if stretches of the newborn are fractions of their thresholds."""
        return self.file is not None and self.file["newborn.of"] == "threshold"

    @property
    def unfinished(self) -> str:
        """Note on a sweep that is not finished."""
        done, planned = len(self.table), self.planned
        return f"{done} of {planned} points so far" if done < (planned or 0) else ""

    @property
    def usual(self) -> str:
        """The column that is drawn if none is named: friction, as a force where the run
        file has a unit of force."""
        known = self.units.force and "friction_force" in self.table
        return "friction_force" if known else "friction"


class _Levels(NamedTuple):
    """Distinct values of a column in order, missing ones last, as they are printed; and
    which of them each row has."""

    codes: Array
    values: Any
    texts: list[str]

    @classmethod
    def of(cls, column: Column) -> "_Levels":
        """Print numbers with six digits, or as many as tell neighbours apart."""
        codes, values = pd.factorize(column, sort=True, use_na_sentinel=False)
        texts = [_printed(value, 6) for value in values]
        for digits in range(7, 18):
            count = Counter(texts)
            texts = [
                _printed(value, digits) if count[text] > 1 else text
                for value, text in zip(values, texts, strict=True)
            ]
        return cls(codes, values, texts)

    def __str__(self) -> str:
        """Some of them, to choose from in a message."""
        return ", ".join(self.texts[:8] + ["..."] * (len(self.texts) > 8))


def _printed(value: Any, digits: int) -> str:
    if pd.isna(value):
        return "none"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def read_sweep(folder: Path) -> Sweep:
    """Read the points of a sweep, finished or not, from a folder of Parquet files.
    Raises InputError."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder of Parquet files")
    planned = storage.planned_points(folder)
    of = f", of {planned}" if planned else ""
    files = storage.sweep_files(folder)
    if files is not None and not files:
        raise InputError(f"{folder}: holds no point yet{of}")
    try:
        read = pq.read_table
        found = storage.read_listed(folder, files, read) if files else read(folder)
    except (OSError, pyarrow.ArrowException) as error:
        said = f"cannot be read as Parquet files ({str(error).splitlines()[0]})"
        if (folder / "summary.json").is_file():
            drawn = ", ".join(sorted(path.name for path in folder.glob("*.png")))
            said = f"is no sweep; the pictures of a run are there already: {drawn}"
        raise InputError(f"{folder}: {said}") from None
    table = found.to_pandas().reset_index(drop=True)
    if "friction" in table:  # by eqsim, perhaps an old version
        known = {old: new for old, new in RENAMED_COLUMNS.items() if new not in table}
        table = table.rename(columns=known)
    for name in table.select_dtypes("category"):  # folders named KEY=VALUE
        table[name] = table[name].astype(str)
        with suppress(ValueError):
            table[name] = table[name].astype(float)
    if not len(table):
        raise InputError(f"{folder}: holds no point yet{of}")
    file = None
    with suppress(InputError, ValueError, KeyError, TypeError):
        origin = storage.origin_of(found.schema)
        file = stored(origin["settings"]["sweep"], origin["folder"])
    return Sweep(table, file, planned)


def select(table: Points, where: dict[str, str]) -> Points:
    """The points at which every column named in `where` has the value given: numbers to
    1e-9, or to the digits with which they are printed. Raises InputError."""
    for name, text in where.items():
        column = _column(table, name, "--where")
        known = _Levels.of(column)
        same = np.array(known.texts)[known.codes] == text
        if _numeric(column):
            with suppress(ValueError):
                same |= np.isclose(column, float(text), rtol=1e-9, atol=0)
        if not np.any(same):
            raise InputError(
                f"--where {name}={text}: no point has this value; there are {known}"
            )
        table = table[same]
    return table


def heading(sweep: Sweep, name: str, where: dict[str, str]) -> str:
    """A title: that of the run file, or `name` without one, and what was chosen."""
    title = (sweep.file.title if sweep.file else "") or name
    chosen = ", ".join(f"{symbol(key)} = {plain(x)}" for key, x in where.items())
    return plain(title) + f"\n{chosen}" * bool(chosen)


def sweep_figure(
    sweep: Sweep,
    points: Points,
    columns: Sequence[str],
    by: list[str] | None = None,
    log_x: bool | None = None,
    title: str = "",
    width: float | None = None,
) -> tuple[Figure, list[str]]:
    """Draw of some `points` of a sweep some `columns` against the first of them, x,
    each y in a panel of its own, one series for each value of the columns `by`, colours
    for the first of them and markers for the second; the figure, and notes on what was
    left out.

    Bars are two standard errors (column `y`_stderr). The master equation is solved anew
    for a line between the points where that takes little time, else dashes are its
    values at the points (`y`_reference); points of `status` "unreliable", or of which y
    is not reliable, are open, those of "failed" left out. The x axis is logarithmic if
    `log_x`, or by default if its values span more than a factor 30. More than eight
    series have a colour bar if the first column is of numbers. A `width` in inches is
    that on paper, where text has 7 and 8 points. Raises InputError if a column is
    missing or is not of numbers, if a parameter other than `x` and `by` varies (one of
    `output` does not count: it changes no average), or if nothing is left to draw.
    """
    x, *ys = columns
    by = list(by or [])
    if len(by) > 2:
        raise InputError(
            f"--by {by[2]}: at most two columns, one for colours and one for markers"
        )
    table, notes = _drawable(points, x, ys, by)
    low, high = float(table[x].min()), float(table[x].max())
    if log_x and low <= 0:
        raise InputError(f"--log-x: {x} = {low:g} is not above 0")
    notes = [*notes, *filter(None, [sweep.unfinished])]
    log = bool(log_x or (log_x is None and low > 0 and high > _SPREAD * low))
    heading = "\n".join(filter(None, (title, "; ".join(notes))))
    with matplotlib.rc_context(STYLE | PANELS | (PAPER if width else {})):
        figure = _figure(sweep, table, columns, by, log, heading, width)
    for y in ys if not by else ():
        if law := healing_of(table, x, y):
            notes = [*notes, f"healing: {law.told(unit=sweep.units.time)}"]
    return figure, notes


def healing_of(table: Points, x: str, y: str) -> Healing | None:
    """The logarithm through a column of healing against the hold before it; None for
    other columns. Values that are not reliable do not count."""
    hold = re.fullmatch(r"drive\.programme\.(\d+)\.hold", x)
    healing = re.match(r"segment_(\d+)_healing", y)
    if not hold or not healing or int(healing[1]) != int(hold[1]) + 1:
        return None
    if f"{y}_stderr" not in table:  # an exact value, or an error
        return None
    sure = table[~_doubtful(table, y)]
    return healing_law(*(sure[k].to_numpy(float) for k in (x, y, f"{y}_stderr")))


def _doubtful(table: Points, y: str) -> Column:
    """Rows in which the table says of `y`, or of the force over N k that it follows
    from, that it is not reliable."""
    of_force = re.sub("_?(friction_force|friction_coefficient|shear_stress)$", "", y)
    for name in (y, of_force or "friction"):
        if (reliable := f"{name}_reliable") in table:
            return table[reliable].eq(False)
    return pd.Series(False, table.index)


def _figure(
    sweep: Sweep,
    table: Points,
    columns: Sequence[str],
    by: list[str],
    log: bool,
    title: str,
    width: float | None,
) -> Figure:
    """Draw points as `sweep_figure` says, which can all be drawn."""
    x, *ys = columns
    high = min(0.62 * width, 2.5) if width else 3.8 if len(ys) == 1 else 2.9
    title = wrapped(title, 0.75 * (width or 9.0))
    head = 0.5 + 0.13 * len(title.split("\n")) if width else 1.2
    figure = Figure(figsize=(width or 9.0, head + high * len(ys)))
    panels: Any = figure.subplots(len(ys), 1, sharex=True, squeeze=False)[:, 0]
    groups = {name: _Levels.of(table[name]) for name in by}
    look, legends, bar = _looks(groups, sweep.units)
    marks: set[str] = set()
    drawn: list[Any] = []
    for axes, y in zip(panels, ys, strict=True):
        axes.set_xscale("log" if log else "linear")
        marks |= _panel(axes, sweep, table, (x, y), groups, look)
        axes.set_ylabel(wrapped(axes.get_ylabel(), high))
        drawn += axes.get_legend_handles_labels()[0]
    if bar is not None:
        label = axis(by[0], sweep.units, unknown=False)
        where = "bottom" if width else "right"
        figure.set_figheight(figure.get_figheight() + 0.6 * bool(width))
        figure.colorbar(bar, ax=list(panels), label=label, location=where)
    label = axis(x, sweep.units, fractions=sweep.fractions)
    panels[-1].set_xlabel(wrapped(label, 0.75 * figure.get_figwidth()))
    figure.align_ylabels(list(panels))
    panels[0].set_title(title)
    explained = [
        Line2D([], [], color="0.35", label=f"{mark}: {meaning}", **mark_look)
        for mark, (meaning, mark_look) in _EXPLAINED.items()
        if mark in marks
    ]
    handles = [*legends, *explained, *drawn]
    for line in [*handles, *(line for axes in panels for line in axes.lines)]:
        line.set_markersize(line.get_markersize() * (0.6 if width else 1.0))
    if handles and not by and len(ys) == 1 and not width:
        panels[0].legend(handles=handles)
    elif handles and by and bar is None and not width:  # where it covers nothing
        ncols = 1 + len(handles) // 26
        figure.legend(handles=handles, ncols=ncols, loc="outside right upper")
    elif handles:
        _legend_below(figure, handles)
    return figure


def _legend_below(figure: Figure, handles: list[Any]) -> None:
    """Add a legend below all panels, with as many columns as fit."""
    for ncols in range(4, 0, -1):
        where: dict[str, Any] = {"ncols": ncols, "loc": "outside lower center"}
        legend = figure.legend(handles=handles, **where)
        size = legend.get_window_extent()
        if size.width < 0.95 * figure.bbox.width or ncols == 1:
            figure.set_figheight(figure.get_figheight() + size.height / figure.dpi)
            return
        legend.remove()


def _panel(
    axes: Axes,
    sweep: Sweep,
    table: Points,
    columns: tuple[str, str],
    groups: dict[str, _Levels],
    look: Any,
) -> set[str]:
    """Draw one column against another; return the marks to be explained."""
    x, y = columns
    quantity = _stress(sweep, y, float(table[y].abs().max()))
    factor = quantity.factor if quantity else 1.0
    scaled = [name for name in (y, f"{y}_stderr", f"{y}_reference") if name in table]
    if quantity:
        table = table.assign(**{name: table[name] * factor for name in scaled})
    marks: set[str] = set()
    by = [levels.codes for levels in groups.values()]
    series = list(table.groupby(by)) if by else [((), table)]
    for codes, members in series:
        style, line = look(codes)
        members = members.sort_values(x)
        solves = _MOST_SOLVES // max(1, len(series))
        log = axes.get_xscale() == "log"
        fine = _reference_curve(sweep, members, columns, log, solves)
        if fine is not None:
            how: dict[str, Any] = {"color": style["color"], "linestyle": line}
            axes.plot(fine[0], fine[1] * factor, zorder=2, **how)
            marks.add("lines")
        if law := healing_of(members, x, y):
            held, shown = members[x].to_numpy(float), quantity.unit if quantity else ""
            units = (column_unit(y, sweep.units, shown), column_unit(x, sweep.units))
            draw_healing(axes, law, held, style["color"], *units)
        marks |= _draw_series(axes, members, columns, style, dashed=fine is None)
    axes.set_ylabel(axis(y, sweep.units, quantity.unit if quantity else ""))
    Caption("", quantity=_friction_beside(sweep, table, y)).beside(axes)
    not_flat(axes)
    return marks | {"points"} if marks else marks


def _drawable(
    table: Points, x: str, ys: list[str], by: list[str]
) -> tuple[Points, list[str]]:
    """The points that can be drawn, and notes on the others."""
    for name, option in ((x, "--x"), *((y, "--y") for y in ys)):
        _require_numbers(_column(table, name, option), f"{option} {name}:")
    for y in ys:
        table = _with_errors(table, y)
    for name in by:
        _column(table, name, "--by")
    known = {_source(table, name) for name in (x, *by)}
    free = [
        name
        for name in table
        if ("." in name and not name.startswith("output.")) or name == "disorder"
        if table[name].nunique(dropna=False) > 1
        if name not in known and _source(table, name) == name
    ]
    if free:
        several = "; ".join(f"{name} ({_Levels.of(table[name])})" for name in free)
        said = "besides --x and --by other parameters vary; choose with --where"
        raise InputError(f"{said} KEY=VALUE: {several}")
    table = table.assign(status=table.get("status", "ok"))
    failed = table["status"] == "failed"
    finite = {y: np.isfinite(table[[x, y]].astype(float)).all(axis=1) for y in ys}
    absent = {"failed": failed.sum()}
    absent |= {f"without a finite {x} or {y}": (~failed & ~finite[y]).sum() for y in ys}
    notes = [f"left out: {count} {why}" for why, count in absent.items() if count]
    for y in ys:
        if not (~failed & finite[y]).any():
            raise InputError("; ".join([f"--y {y}: no point to draw", *notes]))
    return table[~failed & np.logical_or.reduce([*finite.values()])], notes


def _with_errors(table: Points, y: str) -> Points:
    """The points with the error and the reference of `y` as numbers, where there are
    any. Raises InputError."""
    stderr = f"{y}_stderr"
    for name in (stderr, f"{y}_reference"):
        if name in table:
            if table[name].notna().any():
                _require_numbers(table[name], f"--y {y}: {name}")
            table = table.assign(**{name: table[name].astype(float)})
    if stderr in table and (table[stderr] < 0.0).any():
        said = f"{stderr} = {table[stderr].min():g}: must be 0 or more"
        raise InputError(f"--y {y}: {said}")
    return table


def _require_numbers(column: Column, name: str) -> None:
    """Raise InputError if a column is not of numbers."""
    if not _numeric(column):
        of = _Levels.of(column)
        raise InputError(f"{name} is not a column of numbers but of {of}")


def _source(table: Points, name: str) -> str:
    """The column of a key that another one follows from: the one at the top of the run
    file, which a population has taken over, or the one that says the same in another
    unit; else the column itself."""
    name = _top(table, name)
    population, bare = of_population(name)
    given = population + DERIVED.get(bare, bare)
    return given if given in table and table[given].notna().all() else name


def _top(table: Points, name: str) -> str:
    """The column of a key at the top of the run file, if a population has its values."""
    population, bare = of_population(name)
    shared = population and bare in table and table[bare].equals(table[name])
    return bare if shared else name


def _looks(
    groups: dict[str, _Levels], units: Units
) -> tuple[Any, list[Line2D], ScalarMappable | None]:
    """A function that gives the look of a series by its levels in each of the `groups`,
    the entries of the legend, and a colour bar. Raises InputError if there are more
    levels than markers for them."""
    if not groups:
        return lambda codes: ({"color": COLORS[0], **_POINT_LOOK}, "-"), [], None
    (name, first), *others = groups.items()
    for other, levels in others:
        if len(levels.texts) > len(MARKERS):
            said = f"{len(levels.texts)} values ({levels}) for {len(MARKERS)} markers"
            way = "choose with --where KEY=VALUE, or name it first, for colours"
            raise InputError(f"--by {other}: {said}; {way}")
    count, bar = len(first.texts), None
    colors: list[Any] = [COLORS[i % len(COLORS)] for i in range(count)]
    if count > _MOST_SERIES:
        shades = np.linspace(0.0, 0.95, count)
        if _numeric(first.values) and np.isfinite(first.values).all():
            values = first.values.astype(float)
            low, least, high = values[0], values[int(values[0] == 0)], values[-1]
            norm = Normalize(low, high)
            if least > 0 and high > _SPREAD * least:
                norm = LogNorm(low, high) if low else SymLogNorm(least, 1, low, high)
            bar = ScalarMappable(norm, "viridis")
            shades = np.asarray(norm(values))
        colors = list(matplotlib.colormaps["viridis"](shades))

    def look(codes: Any) -> tuple[dict[str, Any], Any]:
        i = codes[0]
        j = codes[1] if others else i if bar is None else 0
        style = {"color": colors[i], "marker": MARKERS[j % len(MARKERS)]}
        style["markersize"] = 5.5 if bar is None else 4.0
        return style, DASHES[j % len(DASHES)]

    legend: list[Line2D] = []
    for number, (name, levels) in enumerate(groups.items()):
        if number == 0 and bar is not None:
            continue
        head = axis(name, units, unknown=False)
        legend.append(Line2D([], [], linestyle="none", label=head))
        for code, text in enumerate(levels.texts):
            style, line = look((0, code) if number else (code, 0))
            if number:
                style["color"] = "0.35"
            elif others:
                style["marker"], line = "o", "none"
            style |= {"linestyle": line, "label": plain(text)}
            legend.append(Line2D([], [], **style))
    return look, legend, bar


def _draw_series(
    axes: Axes,
    members: Points,
    columns: tuple[str, str],
    style: dict[str, Any],
    dashed: bool,
) -> set[str]:
    """Draw one series, with dashes as references if `dashed`; return its marks."""
    (x, y), color, marks = columns, style["color"], set[str]()
    reference = f"{y}_reference"
    if dashed and reference in members and members[reference].notna().any():
        marks.add("dashes")
        known = members.dropna(subset=reference).drop_duplicates(x)
        axes.plot(
            known[x], known[reference], color=color, markersize=13, zorder=2, **_DASH
        )
    stderr = f"{y}_stderr"
    bars = 2 * members[stderr].astype(float) if stderr in members else None
    if bars is not None and bars.notna().any():
        marks.add("bars")
    bar: dict[str, Any] = {"fmt": "none", "ecolor": color, "capsize": 2.5}
    axes.errorbar(members[x], members[y], bars, zorder=3, **bar)
    unsure = (members["status"] == "unreliable") | _doubtful(members, y)
    for points, fill in ((members[~unsure], color), (members[unsure], "white")):
        how: dict[str, Any] = {"linestyle": "none", "markerfacecolor": fill, **style}
        axes.plot(points[x], points[y], zorder=4, **how)
    return marks | {"open"} if unsure.any() else marks


def _reference_curve(
    sweep: Sweep, members: Points, columns: tuple[str, str], log: bool, solves: int
) -> tuple[Array, Array] | None:
    """The reference of a series between its points, where it takes little time."""
    x, y = columns
    low, high = float(members[x].min()), float(members[x].max())
    if sweep.file is None or keys(sweep.file).get(x) is not float or not low < high:
        return None
    reference = f"{y}_reference"
    if reference not in members or members[reference].isna().all():
        return None
    over_velocity = x == "drive.velocity"
    count = _FINE_CURVE if over_velocity else min(_COARSE_CURVE, solves)
    if count < 2 * len(members) and not over_velocity:
        return None
    grid = np.geomspace(low, high, count) if log else np.linspace(low, high, count)
    grid = np.unique(np.concatenate((grid[1:-1], members[x].to_numpy(float))))
    row = members.iloc[0]
    try:
        if over_velocity:
            return grid, _curve_averages(sweep, row, y, {}, grid)
        values = [_curve_averages(sweep, row, y, {x: key}) for key in grid.tolist()]
        return grid, np.concatenate(values)
    except InputError:
        return None


def _curve_averages(
    sweep: Sweep, row: Any, y: str, more: dict[str, Any], velocities: Any = None
) -> Array:
    """Values of a column by the master equation at a row's parameters, at some
    velocities or the row's own. Raises InputError where it is not known, or takes long.
    """
    file = _point(sweep, row, more)
    if file["elastic"] or file["drive.programme"] or file.pulled:
        raise InputError("no steady state at constant velocity")
    ensemble = file.ensemble
    slow = ensemble.newborn.active or ensemble.aging.active
    if slow or ensemble.thresholds.steps.size:
        raise InputError("these laws are solved one velocity at a time")
    if velocities is None:
        velocities = np.array([file["drive.velocity"]])
    found = curve(ensemble, velocities)
    if y in _REFERENCES:
        return np.asarray(getattr(found, y))
    for quantity in file.quantities:
        if quantity.column == y:
            return np.asarray(found.friction * quantity.factor)
    raise InputError(f"{y}: is not known along a curve")


def _point(sweep: Sweep, row: Any, more: dict[str, Any]) -> RunFile:
    """The run file at a row of the table."""
    assert sweep.file
    table, base = sweep.table, parameters(sweep.file)
    known = {key: kind for key, kind in keys(sweep.file).items() if key in row}
    replaced = {_source(table, key) for key in more}
    changes: dict[str, Any] = {
        key: kind(row[key])
        for key, kind in known.items()
        if not key.startswith("output.") and pd.notna(row[key])
        if kind(row[key]) != base[key]
        if _source(table, key) == key and key not in replaced
    }
    for x, value in more.items():
        same = (key for key in known if _top(table, key) == _top(table, x))
        changes |= dict.fromkeys(same, value)
    return at(sweep.file, changes)


def _stress(sweep: Sweep, y: str, largest: float) -> Quantity | None:
    """The shear stress in a suitable unit; `factor` converts the column of the table."""
    known = sweep.file.quantities if sweep.file and y.endswith("shear_stress") else ()
    stress = (one for one in known if one.name == "shear_stress")
    return next((one._replace(factor=1.0).near(largest) for one in stress), None)


def _friction_beside(sweep: Sweep, table: Points, y: str) -> Quantity | None:
    """Another quantity that friction or the force `y` is at the interface, if all
    points have as many contacts of the same stiffnesses."""
    of_force = r"contacts\.(count|stiffness)|population\.\d+\.(share|stiffness)"
    names = filter(re.compile(of_force).fullmatch, map(str, table))
    several = any(table[name].nunique() > 1 for name in names)
    if sweep.file is None or several or y not in ("friction", "friction_force"):
        return None
    with suppress(InputError):
        file = _point(sweep, table.iloc[0], {})
        largest = Estimate(float(table["friction"].abs().max()), None, 0)
        found, drawn = file.preferred(largest), file.quantities[:1]
        if y == "friction" or not found:
            return found
        if found.name != drawn[0].name:
            return found._replace(factor=found.factor / drawn[0].factor)
    return None


def _column(table: Points, name: str, option: str) -> Column:
    if name not in table:
        known = [*map(str, table)]
        hint = meant(name, known) or f"there are {', '.join(known)}"
        raise InputError(f"{option} {name}: no such column; {hint}")
    return table[name]


def _numeric(column: Column) -> bool:
    return column.dtype.kind in "iuf"
