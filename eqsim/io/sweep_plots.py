"""Pictures of sweeps."""

import json
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eqsim.errors import InputError, meant
from eqsim.estimate import Estimate
from eqsim.io import storage
from eqsim.io.export import RENAMED_COLUMNS
from eqsim.io.labels import axis, plain, symbol
from eqsim.io.plots import Caption
from eqsim.io.runfile import RunFile, at, keys, stored
from eqsim.io.style import COLORS, DASHES, MARKERS, styled
from eqsim.io.units import Quantity, Units
from eqsim.numerics.tables import Array

Points = Any  # a pandas DataFrame, one point of a sweep a row
Column = Any  # a pandas Series

_SPREAD = 30.0  # an axis whose values span a greater factor is logarithmic
_FLAT = 0.01  # of its values, the least height of the y axis
_PRINTED = {
    "mu": "friction_coefficient",
    "force": "friction_force",
}  # columns that tables of the terminal call otherwise
_MOST_SERIES = len(COLORS)  # that a legend names; more have a colour bar
_FINE, _COARSE = (
    120,
    40,
)  # points of a reference curve against velocity, which costs one solve, and against other keys
_MOST_SOLVES = 600
_REFERENCES = ("friction", "pinned", "break_stretch")


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
        """Whether stretches of the newborn are fractions of their thresholds."""
        return self.file is not None and self.file["newborn.of"] == "threshold"

    @property
    def unfinished(self) -> str:
        """What is to be said of a sweep that goes on."""
        done = len(self.table)
        return (
            f"{done} of {self.planned} points so far"
            if self.planned and done < self.planned
            else ""
        )


def read_sweep(folder: Path) -> Sweep:
    """The points of a sweep, finished or not, from a folder of Parquet files. Raises
    InputError."""
    import pyarrow
    from pyarrow import parquet as pq

    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder of Parquet files")
    planned = None
    with suppress(OSError, ValueError, KeyError, TypeError):
        planned = int(
            json.loads((folder / storage.SWEEP_MANIFEST).read_bytes())["points"]
        )
    files = storage.sweep_files(folder)
    if files is not None and not files:
        raise InputError(
            f"{folder}: holds no point yet" + (f", of {planned}" if planned else "")
        )
    try:
        found = pq.read_table(folder if files is None else files)
    except (OSError, pyarrow.ArrowException) as error:
        if (folder / "summary.json").is_file():
            raise InputError(
                f"{folder}: is no sweep; the pictures of a run are in its folder already"
            ) from None
        raise InputError(
            f"{folder}: cannot be read as Parquet files ({str(error).splitlines()[0]})"
        ) from None
    table = found.to_pandas().reset_index(drop=True)
    if "friction" in table:  # a sweep of old
        table = table.rename(columns=RENAMED_COLUMNS)
    for name in table.select_dtypes("category"):  # folders named KEY=VALUE
        table[name] = table[name].astype(str)
        with suppress(ValueError):
            table[name] = table[name].astype(float)
    if not len(table):
        raise InputError(
            f"{folder}: holds no point yet" + (f", of {planned}" if planned else "")
        )
    file = None
    with suppress(InputError, ValueError, KeyError, TypeError):
        origin = json.loads((found.schema.metadata or {})[b"eqsim"])
        file = stored(origin["settings"]["sweep"], origin["folder"])
    return Sweep(table, file, planned)


def select(table: Points, where: dict[str, str]) -> Points:
    """The points at which every column named in `where` has the value given: numbers to
    1e-9, or to the digits with which they are printed. Raises InputError."""
    for name, text in where.items():
        column = _column(table, name, "--where")
        same = column.astype(str) == text
        if _numeric(column):
            with suppress(ValueError):
                same = np.isclose(column, float(text), rtol=1e-9, atol=0)
        if not np.any(same):
            texts = _texts(column)
            same = column.map(lambda value, texts=texts: texts[_plain(value)]) == text
        if not np.any(same):
            raise InputError(
                f"--where {name}={text}: no point has this value; there are {_values(column)}"
            )
        table = table[same]
    return table


@styled
def _figure(
    sweep: Sweep,
    table: Points,
    columns: tuple[str, str],
    by: list[str],
    log: bool,
    title: str,
) -> Figure:
    """As `sweep_figure`, of points that can be drawn."""
    x, y = columns
    quantity = _quantity(sweep, y, float(table[y].abs().max()))
    if quantity:  # of shear stress, in a unit fit for it
        scaled = [
            name
            for name in table
            if name == y or name in (f"{y}_stderr", f"{y}_reference")
        ]
        table = table.assign(**{name: table[name] * quantity.factor for name in scaled})
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    if log:
        axes.set_xscale("log")
    looks, legends, bar = _looks(table, by, sweep.units)
    kinds: set[str] = set()
    for values, part in table.groupby(by, dropna=False) if by else [((), table)]:
        style, line = looks(values)
        part = part.sort_values(x)
        fine = _curve(
            sweep,
            part,
            (x, y),
            log,
            solves=_MOST_SOLVES // max(1, table.groupby(by).ngroups if by else 1),
        )
        if fine is not None and quantity:
            fine = fine[0], fine[1] * quantity.factor
        kinds |= _draw(axes, part, (x, y), style, line, fine)
    if bar is not None:
        figure.colorbar(bar, ax=axes, label=axis(by[0], sweep.units, unknown=False))
    handles = [*legends, *_explained(table, y, kinds)]
    if handles and not by:
        axes.legend(handles=handles, fontsize=8)
    elif handles:  # outside of the axes, where it covers nothing
        look = (
            (1 + len(handles) // 26, "outside right upper")
            if bar is None
            else (4, "outside lower center")
        )
        figure.legend(handles=handles, ncols=look[0], loc=look[1])
    axes.set(
        xlabel=axis(x, sweep.units, fractions=sweep.fractions),
        ylabel=axis(y, sweep.units, quantity.unit if quantity else ""),
    )
    if y == "friction":
        beside = _beside(sweep, table)
        Caption("", quantity=beside).beside(axes)
    low, high = axes.get_ylim()
    least = _FLAT * max(abs(low), abs(high))
    if axes.get_yscale() == "linear" and high - low < least:  # a flat curve looks flat
        axes.set_ylim(0.5 * (low + high - least), 0.5 * (low + high + least))
    axes.set_title(title)
    axes.grid(alpha=0.3)
    return figure


def sweep_figure(
    sweep: Sweep,
    points: Points,
    columns: tuple[str, str],
    by: list[str] | None = None,
    log_x: bool | None = None,
    title: str = "",
) -> tuple[Figure, list[str]]:
    """Of some `points` of a sweep the second of two `columns`, y, against the first, x,
    one series for each value of the columns `by`, colours for the first of them and
    markers for the second, and notes on what was left out.

    Bars are two standard errors (column `y`_stderr). The master equation is solved anew
    for a line between the points where that takes little time, else dashes are its
    values at the points (`y`_reference); points of `status` "unreliable" are open,
    those of "failed" left out. The x axis is logarithmic if `log_x`, or by default if
    its values span more than a factor 30. More than eight series have a colour bar if
    the first column is of numbers. Raises InputError if a column is missing or is not
    of numbers, if a parameter other than `x` and `by` varies (one of `output` does not
    count: it changes no average), or if nothing is left to draw.
    """
    (x, y), by = columns, list(by or [])
    if len(by) > 2:
        raise InputError(
            f"--by {by[2]}: at most two columns, one for colours and one for markers"
        )
    table, notes = _drawable(points, x, y, by)
    low, high = float(table[x].min()), float(table[x].max())
    if log_x and low <= 0:
        raise InputError(f"--log-x: {x} = {low:g} is not above 0")
    notes = [*notes, *filter(None, [sweep.unfinished])]
    log = bool(log_x or (log_x is None and low > 0 and high > _SPREAD * low))
    heading = "\n".join(filter(None, (title, "; ".join(notes))))
    return _figure(sweep, table, (x, y), by, log, heading), notes


def heading(sweep: Sweep, name: str, where: dict[str, str]) -> str:
    """A title: that of the run file, or `name` without one, and what was chosen."""
    title = (sweep.file.title if sweep.file else "") or name
    chosen = ", ".join(
        f"{symbol(key)} = {plain(value)}" for key, value in where.items()
    )
    return plain(title) + f"\n{chosen}" * bool(chosen)


def _drawable(table: Points, x: str, y: str, by: list[str]) -> tuple[Points, list[str]]:
    """The points that can be drawn, and notes on the others."""
    for name, option in ((x, "--x"), (y, "--y")):
        if not _numeric(_column(table, name, option)):
            raise InputError(
                f"{option} {name}: is not a column of numbers but of {_values(table[name])}"
            )
    for name in by:
        _column(table, name, "--by")
    parameters = [
        name
        for name in table
        if ("." in name and not name.startswith("output.")) or name == "disorder"
    ]
    known = {x, *by}
    for one, other in (
        ("thermal.temperature", "thermal.kT"),
        ("thermal.kT", "thermal.temperature"),
    ):
        if (
            one in known
            and "thermal.temperature" in table
            and table["thermal.temperature"].notna().all()
        ):
            known.add(other)  # it follows
    if "thermal.temperature" in table and table["thermal.temperature"].notna().all():
        known |= {"thermal.kT"}
    free = [
        name
        for name in parameters
        if name not in known and table[name].nunique(dropna=False) > 1
    ]
    if free:
        several = "; ".join(f"{name} ({_values(table[name])})" for name in free)
        raise InputError(
            f"besides --x and --by other parameters vary; choose with --where KEY=VALUE: {several}"
        )
    table = table.assign(status=table.get("status", "ok"))
    failed = table["status"] == "failed"
    shown = ~failed & np.isfinite(table[[x, y]].astype(float)).all(axis=1)
    absent = (
        (failed.sum(), "failed"),
        ((~failed & ~shown).sum(), f"without a finite {x} or {y}"),
    )
    notes = [f"left out: {number} {what}" for number, what in absent if number]
    if not shown.any():
        raise InputError(
            f"--y {y}: no point to draw" + "".join(f"; {note}" for note in notes)
        )
    return table[shown], notes


def _looks(
    table: Points, by: list[str], units: Units
) -> tuple[Any, list[Line2D], ScalarMappable | None]:
    """How a series looks, given the values of the columns `by`, its entries in a
    legend, and a colour bar."""
    if not by:
        return (
            lambda values: (
                {"color": COLORS[0], "marker": "o", "markersize": 5.5},
                "-",
            ),
            [],
            None,
        )
    groups = [sorted(table[name].unique(), key=_order) for name in by]
    first, second = groups[0], groups[1] if len(by) > 1 else []
    numbers = _numeric(table[by[0]]) and bool(
        np.isfinite(np.asarray(first, float)).all()
    )
    bar = None
    colors: list[Any] = [COLORS[i % len(COLORS)] for i in range(len(first))]
    if len(first) > _MOST_SERIES:
        shades = np.linspace(0.0, 0.95, len(first))
        if numbers:
            low, high = float(first[0]), float(first[-1])
            norm = (
                LogNorm(low, high)
                if low > 0 and high > _SPREAD * low
                else Normalize(low, high)
            )
            bar = ScalarMappable(norm, "viridis")
            shades = np.asarray(norm(np.asarray(first, float)))
        colors = list(matplotlib.colormaps["viridis"](shades))

    def look(values: Any) -> tuple[dict[str, Any], Any]:
        values = values if isinstance(values, tuple) else (values,)
        i = _place(first, values[0])
        j = _place(second, values[1]) if second else i if bar is None else 0
        marker = {
            "marker": MARKERS[j % len(MARKERS)],
            "markersize": 5.5 if bar is None else 4.0,
        }
        return {"color": colors[i], **marker}, DASHES[j % len(DASHES)]

    legend: list[Line2D] = []
    for number, (name, values) in enumerate(zip(by, groups, strict=True)):
        if number == 0 and bar is not None:
            continue
        legend.append(
            Line2D([], [], linestyle="none", label=axis(name, units, unknown=False))
        )
        texts = _texts(table[name])
        for value in values:
            style, line = look(
                (value, *second[:1]) if number == 0 else (first[0], value)
            )
            if second and number == 0:
                style, line = style | {"marker": "o"}, "none"
            elif second:
                style |= {"color": "0.35"}
            legend.append(
                Line2D(
                    [],
                    [],
                    linestyle=line,
                    linewidth=1,
                    label=plain(texts[_plain(value)]),
                    **style,
                )
            )
    return look, legend, bar


def _order(value: Any) -> tuple[int, Any]:
    """Numbers before what is not there, texts by the alphabet."""
    if isinstance(value, str):
        return 1, value
    return (2, "") if value is None or value != value else (0, value)


def _place(values: list[Any], value: Any) -> int:
    """Where a value is in a list that may hold NaN."""
    return next(
        i
        for i, one in enumerate(values)
        if one is value or one == value or (one != one and value != value)
    )


def _draw(
    axes: Axes,
    part: Points,
    columns: tuple[str, str],
    style: dict[str, Any],
    line: Any,
    fine: Any,
) -> set[str]:
    """One series; returns how its reference is drawn, if it is: "line" or "dash"."""
    (x, y), color = columns, style["color"]
    kinds = set()
    if fine is not None:
        axes.plot(*fine, color=color, linewidth=1, linestyle=line, zorder=2)
        kinds.add("line")
    elif f"{y}_reference" in part and part[f"{y}_reference"].notna().any():
        known = part.drop_duplicates(x).dropna(subset=f"{y}_reference")
        axes.plot(
            known[x],
            known[f"{y}_reference"],
            color=color,
            linestyle="none",
            marker="_",
            markersize=13,
            zorder=2,
        )
        kinds.add("dash")
    bars = 2 * part[f"{y}_stderr"].astype(float) if f"{y}_stderr" in part else None
    axes.errorbar(
        part[x],
        part[y],
        bars,
        fmt="none",
        ecolor=color,
        elinewidth=1,
        capsize=2.5,
        zorder=3,
    )
    unsure = part["status"] == "unreliable"
    for points, fill in ((part[~unsure], color), (part[unsure], "white")):
        axes.plot(
            points[x],
            points[y],
            linestyle="none",
            markerfacecolor=fill,
            zorder=4,
            **style,
        )
    return kinds


def _explained(table: Points, y: str, kinds: set[str]) -> list[Line2D]:
    """What lines, dashes, bars and open markers are, where there are any."""
    lines: dict[str, Any] = {"linewidth": 1, "label": "lines: master equation"}
    dashes = {
        "linestyle": "none",
        "marker": "_",
        "markersize": 11,
        "label": "dashes: master equation",
    }
    bars = {
        "linestyle": "none",
        "marker": "|",
        "markersize": 11,
        "label": "bars: ± 2 standard errors",
    }
    open_ = {
        "linestyle": "none",
        "marker": "o",
        "markersize": 5.5,
        "markerfacecolor": "white",
    }
    looks = (
        ("line" in kinds, lines),
        ("dash" in kinds, dashes),
        (f"{y}_stderr" in table and table[f"{y}_stderr"].notna().any(), bars),
        (
            (table["status"] == "unreliable").any(),
            open_ | {"label": "open: unreliable"},
        ),
    )
    return [Line2D([], [], color="0.35", **look) for present, look in looks if present]


def _curve(
    sweep: Sweep, part: Points, columns: tuple[str, str], log: bool, solves: int
) -> tuple[Array, Array] | None:
    """The reference of a series between its points, where it takes little time."""
    from eqsim.master.steady import curve

    x, y = columns
    low, high = float(part[x].min()), float(part[x].max())
    if (
        sweep.file is None
        or f"{y}_reference" not in part
        or part[f"{y}_reference"].isna().all()
        or not low < high
    ):
        return None
    if keys(sweep.file).get(x) is not float:
        return None
    over_velocity = x == "drive.velocity"
    count = _FINE if over_velocity else min(_COARSE, solves)
    if count < 2 * len(part) and not over_velocity:
        return None
    grid = np.geomspace(low, high, count) if log else np.linspace(low, high, count)
    grid = np.unique(np.concatenate((grid[1:-1], part[x].to_numpy(float))))
    try:
        if over_velocity:
            return grid, _averages(sweep, part.iloc[0], y, {}, grid, curve)
        return grid, np.concatenate(
            [
                _averages(sweep, part.iloc[0], y, {x: float(value)}, None, curve)
                for value in grid
            ]
        )
    except InputError:
        return None


def _averages(
    sweep: Sweep,
    row: Any,
    y: str,
    more: dict[str, Any],
    velocities: Array | None,
    curve: Any,
) -> Array:
    """What a column is by the master equation at a row's parameters, at some velocities
    or the row's own. Raises InputError where it is not known, or takes long."""
    file = _point(sweep, row, more)
    if file["elastic"] or file["drive.stage"] or file["drive.programme"]:
        raise InputError("no steady state at constant velocity")
    ensemble = file.ensemble
    if (
        ensemble.newborn.active
        or ensemble.aging.active
        or ensemble.thresholds.steps.size
    ):
        raise InputError("these laws are solved one velocity at a time")
    found = curve(
        ensemble, [file["drive.velocity"]] if velocities is None else velocities
    )
    if y in _REFERENCES:
        return np.asarray(getattr(found, y))
    for one in file.quantities:
        if one.name == y:
            return np.asarray(found.friction * one.factor)
    raise InputError(f"{y}: is not known along a curve")


def _point(sweep: Sweep, row: Any, more: dict[str, Any]) -> RunFile:
    """The run file at a row of the table."""
    assert sweep.file
    changes: dict[str, Any] = {}
    for key, kind in keys(sweep.file).items():
        if (
            key in row
            and sweep.table[key].nunique(dropna=False) > 1
            and not key.startswith("output.")
        ):
            value = row[key]
            if value is not None and value == value:
                changes[key] = kind(value)
    changes |= more
    if (
        "thermal.temperature" in changes
        or sweep.file["thermal.temperature"] is not None
    ):
        changes.pop("thermal.kT", None)
    return at(sweep.file, changes)


def _quantity(sweep: Sweep, y: str, largest: float) -> Quantity | None:
    """A shear stress in a unit fit for it: `factor` times what the table holds."""
    if y != "shear_stress" or sweep.file is None:
        return None
    known = [one for one in sweep.file.quantities if one.name == y]
    return known[0]._replace(factor=1.0).near(largest) if known else None


def _beside(sweep: Sweep, table: Points) -> Quantity | None:
    """What friction is at the interface, if that is the same of all points."""
    several = [
        name
        for name in ("contacts.count", "contacts.stiffness")
        if name in table and table[name].nunique() > 1
    ]
    if sweep.file is None or several:
        return None
    with suppress(InputError):
        largest = Estimate(float(table["friction"].abs().max()), None, 0)
        return _point(sweep, table.iloc[0], {}).preferred(largest)
    return None


def _column(table: Points, name: str, option: str) -> Column:
    if name not in table:
        known = [*map(str, table)]
        hint = meant(_PRINTED.get(name, name), known) or f"there are {', '.join(known)}"
        raise InputError(f"{option} {name}: no such column; {hint}")
    return table[name]


def _numeric(column: Column) -> bool:
    return column.dtype.kind in "iuf"


def _plain(value: Any) -> Any:
    """A value as a key of a dictionary, in which NaN is found again."""
    return None if value is None or value != value else value


def _texts(column: Column) -> dict[Any, str]:
    """Its values as they are printed: numbers with six digits, or as many as tell
    neighbours apart."""
    values = [_plain(value) for value in column.drop_duplicates()]
    texts = {value: _text(value, 6) for value in values}
    for digits in range(7, 18):
        shared = {text for text, count in Counter(texts.values()).items() if count > 1}
        texts = {
            value: _text(value, digits) if text in shared else text
            for value, text in texts.items()
        }
    return texts


def _values(column: Column) -> str:
    """Some of its values, to choose from."""
    texts = _texts(column)
    found = [texts[_plain(value)] for value in column.drop_duplicates().sort_values()]
    return ", ".join(found[:8] + ["..."] * (len(found) > 8))


def _text(value: Any, digits: int) -> str:
    if value is None:
        return "none"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)
