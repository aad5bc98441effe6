"""What results have in common: a version, a short text, a table in notebooks, a
DataFrame and a picture."""

from dataclasses import fields
from html import escape
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.numerics.tables import Array

# Version of the numbers that parameters and a seed give: lives, averages, references.
# Identities and seeds of a sweep's points depend on it. Raise it by one when any of
# these numbers changes by more than rounding, and not otherwise: all sweeps then start
# anew. Libraries have no part in it: with other releases of these the same random
# numbers are drawn, and `tests/test_portable.py` would notice if they were not.
RESULTS_VERSION = 1
_MARKED = 50  # points of a curve up to which each is marked
_ALONG = {"t": "time  $t$", "X": "displacement  $X$"}


class Drawn(NamedTuple):
    """Which columns `Result.plot` draws, with the error of the second one if it has
    one, and how the axes are labelled; `log`: on a logarithmic x axis; `dots`: no line.
    """

    x: str
    y: str
    error: str
    x_label: str
    y_label: str
    log: bool = False
    dots: bool = False


class Result:
    """A frozen dataclass of numbers, estimates and arrays. Those that are curves say in
    `drawn` what they draw."""

    drawn: ClassVar[Drawn | None] = None

    def columns(self) -> dict[str, Array]:
        """Its arrays of one length by name."""
        every = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        arrays = {name: x for name, x in every.items() if isinstance(x, np.ndarray)}
        return {name: x for name, x in arrays.items() if x.ndim == 1}

    def estimates(self, *, brief: bool = False) -> dict[str, Any]:
        """Its single numbers with error bars by name, also of the parts that have some;
        if `brief`, not those that say nothing here."""
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
        """Draw it with a band of two standard errors.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            Where; by default axes of a new figure, so that one result can be drawn on
            another's.
        x : str, optional
            Another column to draw it against, such as "t".
        **style
            Passed to `Axes.plot`: label, color, ...

        Returns
        -------
        matplotlib Axes

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
        """What the text of it says."""
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


def new_axes(**size: Any) -> Any:
    """Axes of a new figure, as `plot` of a result begins one."""
    from matplotlib import pyplot

    axes = pyplot.subplots(layout="constrained", **size)[1]
    axes.grid(alpha=0.3)
    return axes


def draw_band(axes: Any, x: Array, y: Array, error: Array, **line: Any) -> Any:
    """Draw a curve with a band of an error to either side; both, for a legend."""
    (curve,) = axes.plot(x, y, **line)
    look = {"color": curve.get_color(), "alpha": 0.3, "linewidth": 0}
    return axes.fill_between(x, y - error, y + error, **look), curve


def _with_symbol(label: str) -> str:
    """A label of an axis, with what follows two spaces set as mathematics."""
    words, _, symbol = label.partition("  ")
    if not symbol:
        return words
    symbol = symbol.replace("<", r"\langle ").replace(">", r" \rangle")
    return f"{words}  ${symbol}$"
