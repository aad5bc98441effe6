"""Common parts of pictures: captions, a scale in units to the right, and panels of
differences in standard errors."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from eqsim.catalogue import LENGTH, Dimension
from eqsim.estimate import Estimate
from eqsim.io.labels import FORCE, axis, described, plain, unit_text, with_unit
from eqsim.io.runfile import RunFile
from eqsim.io.units import Quantity, Units
from eqsim.numerics.tables import Array

_BINS_PER_DECADE = 8  # bins of a histogram of sizes
EXACT: dict[str, Any] = {"color": "k", "linewidth": 0.8, "linestyle": ":", "zorder": 3}
DOTS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4}


class Caption(NamedTuple):
    """Texts of a picture of a run: its title, what is simulated (mathtext), units, the
    quantity that friction is at the interface, and numbers of contacts and replicas."""

    title: str
    detail: str = ""
    units: Units = Units()
    quantity: Quantity | None = None
    contacts: int = 0
    replicas: int = 1

    @classmethod
    def of(cls, file: RunFile, name: str = "", force: float | None = None) -> "Caption":
        """Caption of a run file, titled `name` if it has no title; the size of a
        typical `force` chooses the unit of the quantity."""
        ensemble, units = file.ensemble, file.units
        quantity = file.preferred(Estimate(force, None, 0))
        size = ensemble.count, file.output.replicas
        detail = described(ensemble, units, tex=True)
        return cls(file.title or name, detail, units, quantity, *size)

    @property
    def heading(self) -> str:
        """The title above what is simulated."""
        return "\n".join(filter(None, (plain(self.title), self.detail)))

    @property
    def force(self) -> str:
        """Label of a friction force per contact."""
        return self.length(FORCE)

    def length(self, text: str) -> str:
        """Label of a vertical axis that shows a length."""
        label = with_unit(text, unit_text(self.units, LENGTH))
        return label if self.units.length else label.replace("  [", "\n[")

    def unit(
        self, text: str, dimension: Dimension = LENGTH, *, unknown: bool = False
    ) -> str:
        """Label with a unit; without one if that is not known, unless `unknown`."""
        return with_unit(text, unit_text(self.units, dimension, unknown))

    @property
    def means(self) -> str:
        """Title of a legend of lines that are means over replicas; "" of a single
        one."""
        return f"means of {self.replicas} replicas" if self.replicas > 1 else ""

    @property
    def band(self) -> str:
        """Legend of a force with its error band."""
        if self.replicas > 1:
            return f"mean of {self.replicas} simulated ensembles, ± 2 standard errors"
        count = f"{self.contacts:,}".replace(",", " ")
        between = f"± 2 standard deviations between ensembles of N = {count}"
        return f"one simulated ensemble, {between}"

    def along(self, name: str) -> str:
        """Label of an axis by its name, such as "X" or "time"."""
        return axis(name, self.units)

    def beside(self, axes: Axes) -> None:
        """Show the quantity at the interface on an axis to the right."""
        if self.quantity is None:
            return
        factor, text = self.quantity.factor, self.quantity.label
        both = (lambda y: y * factor), (lambda y: y / factor)
        right = axes.secondary_yaxis("right", functions=both)
        right.set_ylabel(with_unit(text, plain(self.quantity.unit)))
        right.grid(False)


def draw_difference(axes: Axes, x: Array, run: Any, exact: Any) -> None:
    """Draw the difference of two forces in standard errors; 0 where there is no error."""
    sigma = np.hypot(run.force_stderr, exact.force_error)
    z = np.zeros(sigma.size)
    np.divide(run.force - exact.force, sigma, out=z, where=sigma > 0)
    scores(axes, z)
    axes.plot(x, z, linewidth=0.8)


def scores(axes: Axes, z: Array, label: str = "difference") -> None:
    """Prepare a panel of differences `z` in standard errors, on a grey band of two."""
    limit = max(4.0, 1.1 * np.abs(z).max())
    axes.axhspan(-2, 2, color="0.9")
    axes.set(ylim=(-limit, limit), ylabel=f"{label}\n[standard errors]")
    # Labels of half numbers come and go with the height of the panel: the layout, which
    # changes it, would leave them no room.
    axes.yaxis.set_major_locator(MaxNLocator("auto", integer=True))


def draw_sizes(
    axes: Axes, breaks: Array, per: int, law: Array, name: str
) -> tuple[Array, Array]:
    """Draw numbers of avalanches or bursts of each size over `per`, beside the `law` of
    sizes 1, 2, ...; returns edges of bins and their centres."""
    most = int(breaks.max(initial=1))
    count = int(np.ceil(_BINS_PER_DECADE * np.log10(most + 1.0))) + 1
    edges = np.unique(np.rint(np.geomspace(1, most + 1, count)).astype(int)) - 0.5
    width, centre = np.diff(edges), np.sqrt((edges[:-1] + 0.5) * (edges[1:] - 0.5))
    seen = np.histogram(breaks, edges)[0]
    shown = seen > 0
    share = (1.0 / max(per, 1) / width)[shown]
    density, error = share * seen[shown], 2 * share * np.sqrt(seen[shown])
    label = f"{breaks.size} simulated {name} ± 2 roots of their number"
    axes.errorbar(centre[shown], density, error, color="C0", label=label, **DOTS)
    if law.size:
        exact = "infinitely many contacts, exact"
        axes.plot(np.arange(1, law.size + 1), law, color="k", label=exact)
    lowest = max(0.2 * density.min(initial=1.0), 1e-300)
    highest = 2.0 * density.max(initial=1.0)
    axes.set(xscale="log", yscale="log", ylim=(lowest, highest))
    axes.set_xlim(0.8, 1.3 * most)
    return edges, centre


def legend_below(figure: Figure, drawn: dict[str, Any], title: str = "") -> None:
    """Show a legend below all panels, where it covers nothing."""
    place: dict[str, Any] = {"loc": "outside lower center", "frameon": False}
    figure.legend([*drawn.values()], [*drawn], ncols=2, title=title or None, **place)
