"""What results have in common: a version, a short text, a table in notebooks, a
DataFrame and a picture."""

from dataclasses import fields
from html import escape
from typing import Any, ClassVar, NamedTuple

import numpy as np

from eqsim.numerics.tables import Array
from eqsim.physical import Measured

# Version of the numbers that parameters and a seed give: lives, averages, references.
# Identities and seeds of a sweep's points depend on it. Raise it by one when any of
# these numbers changes by more than rounding, and not otherwise: all sweeps then start
# anew. Libraries have no part in it: with other releases of these the same random
# numbers are drawn, and `tests/test_portable.py` would notice if they were not.
RESULTS_VERSION = 1
_FEW = 50  # points of a curve that are marked


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


class Result(Measured):
    """A frozen dataclass of numbers, estimates and arrays. Those that are curves say in
    `drawn` what they draw."""

    drawn: ClassVar[Drawn | None] = None

    def columns(self) -> dict[str, Array]:
        """Its arrays of one length by name."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {
            name: value
            for name, value in named.items()
            if isinstance(value, np.ndarray) and value.ndim == 1
        }

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
        if self.drawn is None:
            raise TypeError(
                f"{type(self).__name__} has no picture; to_pandas() has its numbers in a table"
            )
        if x and x not in self.columns():
            raise ValueError(
                f"x = {x!r}: must be a column of {type(self).__name__}: {', '.join(self.columns())}"
            )
        if axes is None:
            axes = new_axes()
            axes.set(
                xlabel=_with_symbol(self.drawn.x_label),
                ylabel=_with_symbol(self.drawn.y_label),
            )
            if x and x != self.drawn.x:
                axes.set_xlabel(
                    {"t": "time  $t$", "X": "displacement  $X$"}.get(
                        x, x.replace("_", " ")
                    )
                )
            axes.ticklabel_format(useOffset=False)
            if self.drawn.log:
                axes.set_xscale("log")
        along, y = (getattr(self, name) for name in (x or self.drawn.x, self.drawn.y))
        order = (
            np.argsort(along, kind="stable") if self.drawn.log else slice(None)
        )  # velocities come in any order
        look: dict[str, Any] = {"linewidth": 1.2}
        if self.drawn.dots:
            look = {"linestyle": "", "marker": ".", "markersize": 2}
        elif along.size <= _FEW:
            look |= {"marker": "."}
        (line,) = axes.plot(along[order], y[order], **{**look, **style})
        if self.drawn.error:
            low, high = (
                y + sign * 2 * getattr(self, self.drawn.error) for sign in (-1, 1)
            )
            axes.fill_between(
                along[order],
                low[order],
                high[order],
                color=line.get_color(),
                alpha=0.25,
                linewidth=0,
            )
        if "label" in style:
            axes.legend()
        return axes

    def _said(self) -> list[str]:
        """What the text of it says."""
        known = {
            name: estimate
            for name, estimate in self.estimates(brief=True).items()
            if estimate.value is not None
        }
        said = [
            f"{name} {' '.join(str(estimate).split())}"
            for name, estimate in known.items()
        ]
        if self.drawn is None:
            return said
        (x, y), points = (
            ((name, getattr(self, name)) for name in self.drawn[:2]),
            getattr(self, self.drawn.x).size,
        )
        ranges = [
            f"{name} {values.min():.5g} to {values.max():.5g}"
            for name, values in (x, y)
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
        shown = f"<b>{escape(type(self).__name__)}</b>" + (
            f"<table>{rows}</table>" if rows else ""
        )
        return (
            shown
            if self.drawn is None
            else shown + self.to_pandas().to_html(max_rows=6)
        )


def new_axes(**size: Any) -> Any:
    """Axes of a new figure, as `plot` of a result begins one."""
    from matplotlib import pyplot

    axes = pyplot.subplots(layout="constrained", **size)[1]
    axes.grid(alpha=0.3)
    return axes


def _with_symbol(label: str) -> str:
    """A label of an axis, with what follows two spaces set as mathematics."""
    words, _, symbol = label.partition("  ")
    if not symbol:
        return words
    return (
        f"{words}  $" + symbol.replace("<", r"\langle ").replace(">", r" \rangle") + "$"
    )


class OfTrajectory:
    """A result of a run `file` that is shown by its `trajectory`, and drawn with the
    `exact` mean, if there is one, which is a result or None and why."""

    file: Any
    trajectory: Any
    exact: Any = (None, "")

    @property
    def folder(self) -> Any:
        """The folder in which paths in the run file start."""
        return self.file.folder

    def to_pandas(self) -> Any:
        """A DataFrame of the trajectory."""
        return self.trajectory.to_pandas()

    def plot(self, axes: Any = None, **style: Any) -> Any:
        """Draw the trajectory, and on it the exact mean; arguments are those of
        `Result.plot`."""
        drawn, given = self.trajectory.drawn, axes
        axes = self.trajectory.plot(axes, **{"label": "simulated contacts", **style})
        if given is None:
            axes.set(**self.file.labels(drawn.x))
        if self.exact[0] is not None:
            axes.plot(
                getattr(self.exact[0], drawn.x),
                self.exact[0].force,
                "k:",
                linewidth=1,
                label="exact mean",
            )
            axes.legend()
        return axes

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.trajectory!r})"

    def _repr_html_(self) -> str:
        shown: str = self.trajectory._repr_html_()
        return shown
