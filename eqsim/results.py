"""Base of all results: a version, a short text, a table in notebooks, a DataFrame, a
picture, and friction in a laboratory's units."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from html import escape
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.errors import InputError
from eqsim.numerics.tables import Array

# Version of the numbers that parameters and a seed give: lives, averages, references.
# Identities and seeds of a sweep's points depend on it. Raise it by one when any of
# these numbers changes by more than rounding, and not otherwise: all sweeps then start
# anew. Other releases of libraries do not change it: they draw the same random numbers,
# which `tests/test_portable.py` checks.
RESULTS_VERSION = 1
_MARKED = 50  # a curve of at most so many points has a marker at each
_ALONG = {"t": "time  $t$", "X": "displacement  $X$"}


class Drawn(NamedTuple):
    """Columns that `Result.plot` draws: `x`, `y`, and the `error` of y or ""; and labels
    of the axes. `log`: the x axis is logarithmic; `dots`: points without a line."""

    x: str
    y: str
    error: str
    x_label: str
    y_label: str
    log: bool = False
    dots: bool = False


class Physical(NamedTuple):
    """A force, shear stress or friction coefficient: its value and standard error,
    which are arrays along a curve, and its unit."""

    value: Any
    stderr: Any
    unit: str


# Quantities that F/(N k) is converted to by `units` and `interface` (None: run file's).
Quantities = Callable[[Any, Any], Iterable[Any]]


class Listed:
    """An object whose tab completion is short: `dir` leaves out private names, and those
    `unlisted`, which serve tables and pictures alone."""

    unlisted: ClassVar[tuple[str, ...]] = ("unlisted",)

    def __dir__(self) -> list[str]:
        every, hidden = super().__dir__(), {*self.unlisted, "unlisted"}
        return [
            name
            for name in every
            if name not in hidden and (name[0] != "_" or name.startswith("__"))
        ]


class Result(Listed):
    """A frozen dataclass of numbers, estimates and arrays. That of a curve names in
    `drawn` the columns of its picture."""

    unlisted = ("drawn", "names", "shown")
    drawn: ClassVar[Drawn | None] = None
    _quantities: ClassVar[Quantities | None] = None  # each result has its own

    def in_units(self, units: Any = None, interface: Any = None) -> dict[str, Physical]:
        """Convert friction F/(N k), a length, to a force, a shear stress and a
        coefficient, as the command line does. Other numbers are in the units of the run
        file, or of the ensemble and the drive.

        Parameters
        ----------
        units : Units, optional
            Units of length, time and force; by default those of the run file.
        interface : Interface, optional
            Area, contacts per area, and load; by default those of the run file.

        Returns
        -------
        dict of Physical
            `force`, `shear_stress` and `friction_coefficient`, as far as they are known,
            with `value`, `stderr` (arrays along a curve) and `unit`.

        Raises
        ------
        InputError
            If neither units nor an interface are known.
        TypeError
            For a result without a force.

        Examples
        --------
        >>> from eqsim import Drive, Ensemble, Interface, Units, reference
        >>> exact = reference(Ensemble(count=1000, stiffness=2.0), Drive(velocity=0.1))
        >>> found = exact.in_units(Units(force="N"), Interface(normal_load=5000.0))
        >>> force, mu = found["force"], found["friction_coefficient"]
        >>> print(f"{force.value:.1f} {force.unit}, mu = {mu.value:.3f}")
        1767.8 N, mu = 0.354
        """
        value, stderr = self._force()
        convert: Any = self._quantities
        quantities = list(convert(units, interface)) if convert else []
        if not quantities:
            raise InputError(
                "in_units: neither a unit of force nor an interface is known; give "
                "Units(...) and Interface(...), or a run file with [units]"
            )
        return {
            one.name: Physical(
                None if value is None else one.factor * value,
                None if stderr is None else one.factor * stderr,
                one.unit,
            )
            for one in quantities
        }

    def _force(self) -> tuple[Any, Any]:
        """F/(N k) and its standard error, arrays of a curve."""
        if self.drawn is not None and self.drawn.y in ("force", "friction"):
            return getattr(self, self.drawn.y), getattr(self, self.drawn.error)
        if self.drawn is None and hasattr(self, "friction"):
            return self.friction.value, self.friction.stderr
        raise TypeError(f"{type(self).__name__} has no force F/(N k)")

    def columns(self) -> dict[str, Array]:
        """One-dimensional arrays by name."""
        every = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        arrays = {name: x for name, x in every.items() if isinstance(x, np.ndarray)}
        return {name: x for name, x in arrays.items() if x.ndim == 1}

    def estimates(self, *, brief: bool = False) -> dict[str, Any]:
        """Single numbers with error bars by name, also those of results among the fields;
        if `brief`, without those that a table hides."""
        found: dict[str, Any] = {}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, Result):
                found |= value.estimates(brief=brief)
            elif hasattr(value, "stderr"):
                found[field.name] = value
        return found

    def to_pandas(self) -> Any:
        """A DataFrame of the columns of a curve, or of the estimates, one a row, with
        value, stderr, n, dof and reliable."""
        import pandas as pd

        if self.drawn is not None:
            return pd.DataFrame(self.columns())
        rows = {name: estimate.as_dict() for name, estimate in self.estimates().items()}
        return pd.DataFrame.from_dict(rows, orient="index")

    def plot(self, axes: Any = None, *, x: str = "", **style: Any) -> Any:
        """Draw the curve with a band of two standard errors.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            Axes to draw on, such as those of another result; by default those of a new
            figure.
        x : str, optional
            Another column for the x axis, such as "t".
        **style
            Passed to `Axes.plot`: label, color, ...

        Raises
        ------
        TypeError
            For a result that is neither a curve nor averages.
        ValueError
            If `x` is none of its columns.
        """
        name, drawn = type(self).__name__, self.drawn
        if drawn is None:
            raise TypeError(
                f"{name} has no picture; to_pandas() has its numbers in a table"
            )
        columns = self.columns()
        if x and x not in columns:
            known = ", ".join(columns)
            raise ValueError(f"x = {x!r}: must be a column of {name}: {known}")
        if axes is None:
            axes = new_axes()
            label = _with_symbol(drawn.x_label)
            if x and x != drawn.x:
                label = _ALONG.get(x, x.replace("_", " "))
            axes.set(xlabel=label, ylabel=_with_symbol(drawn.y_label))
            axes.ticklabel_format(useOffset=False)
            if drawn.log:
                axes.set_xscale("log")
        along, y = getattr(self, x or drawn.x), getattr(self, drawn.y)
        error = getattr(self, drawn.error) if drawn.error else None
        look: dict[str, Any] = {"linewidth": 1.2}
        if drawn.dots:
            look = {"linestyle": "", "marker": ".", "markersize": 2}
        elif along.size <= _MARKED:
            look |= {"marker": "."}
        # velocities come in any order
        order = np.argsort(along, kind="stable") if drawn.log else slice(None)
        if error is None:
            axes.plot(along[order], y[order], **{**look, **style})
        else:
            draw_band(axes, along[order], y[order], 2 * error[order], **look | style)
        if "label" in style:
            axes.legend()
        return axes

    def _said(self) -> list[str]:
        """Parts of the text of a result."""
        said = [
            f"{name} {' '.join(str(estimate).split())}"
            for name, estimate in self.estimates(brief=True).items()
            if estimate.value is not None
        ]
        if self.drawn is None:
            return said
        curve = {name: getattr(self, name) for name in self.drawn[:2]}
        points = curve[self.drawn.x].size
        ranges = [
            f"{name} {values.min():.5g} to {values.max():.5g}"
            for name, values in curve.items()
            if points
        ]
        return [f"{points} points", *ranges, *said]

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(self._said())})"

    def _repr_html_(self) -> str:
        """For notebooks: the estimates with their errors, and the first and last rows
        of a curve."""
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(str(estimate))}</td></tr>"
            for name, estimate in self.estimates(brief=True).items()
        )
        shown = f"<b>{escape(type(self).__name__)}</b>"
        shown += f"<table>{rows}</table>" if rows else ""
        table = "" if self.drawn is None else self.to_pandas().to_html(max_rows=6)
        return shown + table


def tell_quantities(result: Any, quantities: Quantities) -> None:
    """Give a result, and results among its fields, the quantities of `in_units`."""
    if isinstance(result, Result):
        object.__setattr__(result, "_quantities", quantities)
    for field in fields(result):
        part = getattr(result, field.name)
        if isinstance(part, Result):
            tell_quantities(part, quantities)


def new_axes(**size: Any) -> Any:
    """Axes of a new figure in the style of `Result.plot`."""
    from matplotlib import pyplot

    axes = pyplot.subplots(layout="constrained", **size)[1]
    axes.grid(alpha=0.3)
    return axes


def draw_band(axes: Any, x: Array, y: Array, error: Array, **line: Any) -> Any:
    """Draw a curve with a band of an error to either side; return band and curve, for a
    legend."""
    (curve,) = axes.plot(x, y, **line)
    look = {"color": curve.get_color(), "alpha": 0.3, "linewidth": 0}
    return axes.fill_between(x, y - error, y + error, **look), curve


def _with_symbol(label: str) -> str:
    """A label of an axis; the symbol after two spaces is set as mathematics."""
    words, _, symbol = label.partition("  ")
    if not symbol:
        return words
    symbol = symbol.replace("<", r"\langle ").replace(">", r" \rangle")
    return f"{words}  ${symbol}$"
