"""What results have in common: a version, a short text, a table in notebooks, a
DataFrame, a picture, and friction in a laboratory's units."""

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


class Physical(NamedTuple):
    """A force, shear stress or friction coefficient: its value and standard error,
    which are arrays along a curve, and its unit."""

    value: Any
    stderr: Any
    unit: str


# What F/(N k) is, given `units` and `interface`; None is that of the run file.
Quantities = Callable[[Any, Any], Iterable[Any]]


class Listed:
    """An object whose completion by tab lists what a user means: `dir` names neither
    private helpers nor what is there for tables and pictures alone."""

    unlisted: ClassVar[tuple[str, ...]] = ("unlisted",)

    def __dir__(self) -> list[str]:
        every, hidden = super().__dir__(), {*self.unlisted, "unlisted"}
        return [
            name
            for name in every
            if name not in hidden and (name[0] != "_" or name.startswith("__"))
        ]


class Result(Listed):
    """A frozen dataclass of numbers, estimates and arrays. Those that are curves say in
    `drawn` what they draw."""

    unlisted = ("drawn", "names", "shown")
    drawn: ClassVar[Drawn | None] = None
    _quantities: ClassVar[Quantities | None] = None  # each result has its own

    def in_units(self, units: Any = None, interface: Any = None) -> dict[str, Physical]:
        """Give friction F/(N k), a length, as a force, a shear stress and a coefficient,
        as the command line does. Other numbers are in the units of the run file, or of
        the ensemble and the drive.

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
        told: Any = self._quantities
        found = list(told(units, interface)) if told else []
        if not found:
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
            for one in found
        }

    def _force(self) -> tuple[Any, Any]:
        """F/(N k) and its standard error, arrays of a curve."""
        if self.drawn is not None and self.drawn.y in ("force", "friction"):
            return getattr(self, self.drawn.y), getattr(self, self.drawn.error)
        if self.drawn is None and hasattr(self, "friction"):
            return self.friction.value, self.friction.stderr
        raise TypeError(f"{type(self).__name__} has no force F/(N k)")

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


def tell_quantities(result: Any, quantities: Quantities) -> None:
    """Let a result and its parts know what F/(N k) is."""
    if isinstance(result, Result):
        object.__setattr__(result, "_quantities", quantities)
    for field in fields(result):
        part = getattr(result, field.name)
        if isinstance(part, Result):
            tell_quantities(part, quantities)


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


class OfTrajectory(Listed):
    """A result of a run `file` that is shown by its `trajectory`, and drawn with the
    `exact` mean, if there is one, which is a result or None and why."""

    file: Any
    trajectory: Any
    exact: Any = (None, "")

    def __post_init__(self) -> None:
        tell_quantities(self, self.file.quantities_in)

    def in_units(self, units: Any = None, interface: Any = None) -> dict[str, Physical]:
        """The force of the trajectory as `Result.in_units` gives it."""
        found: dict[str, Physical] = self.trajectory.in_units(units, interface)
        return found

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
