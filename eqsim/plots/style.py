"""Style of pictures: a palette for all kinds of colour vision and for print in grey,
axes without offsets, 150 dpi."""

import functools
import io
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec

import matplotlib
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from eqsim.errors import require_choice

# Okabe and Ito (2008), colours that all kinds of colour vision tell apart, without
# yellow, which is faint on paper.
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
COLORS = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, "#000000", "#8C8C8C")
MARKERS = "os^DvPX<>ph*"
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
FORMATS = ("png", "pdf", "svg")
STYLE: dict[str, Any] = {
    "axes.prop_cycle": cycler(color=COLORS),
    "axes.formatter.useoffset": False,
    "axes.formatter.use_mathtext": True,
    "axes.titlesize": 10,
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "legend.fontsize": 8,
    "pdf.fonttype": 42,
    "svg.hashsalt": "eqsim",  # the same picture has the same bytes
}
# More settings, of pictures that commands draw.
PANELS: dict[str, Any] = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "figure.constrained_layout.use": True,
    "figure.titlesize": 10,
    "lines.linewidth": 1.0,
}
_UNDATED: dict[str, dict[str, Any]] = {
    "png": {"Software": "eqsim"},
    "pdf": {"CreationDate": None, "Creator": "eqsim"},
    "svg": {"Date": None},
}
# An axis whose values differ relatively by less shows a band of 1 % around them.
_FLAT_AXIS = 1e-5
Arguments = ParamSpec("Arguments")


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Let a function draw in this style."""

    @functools.wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with matplotlib.rc_context(STYLE | PANELS):
            return draw(*args, **kwargs)

    return drawn


def saved(figure: Figure, form: str = "png") -> bytes:
    """Render a picture as the content of a file. Raises InputError unless `form` is one
    of `FORMATS`."""
    require_choice("format", form, FORMATS)
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        for axes in figure.axes:
            low, high = axes.get_ylim()
            if 0 < abs(high - low) < _FLAT_AXIS * max(abs(low), abs(high)):
                not_flat(axes)
        figure.savefig(buffer, format=form, metadata=_UNDATED[form])
    return buffer.getvalue()


def pictures(
    name: str, figure: Figure, formats: Sequence[str] = ("png",)
) -> dict[str, bytes]:
    """Render a picture in some formats, by the names of the files."""
    return {f"{name}.{form}": saved(figure, form) for form in formats}


def not_flat(axes: Any) -> None:
    """Widen a linear axis to 1 % of its values, so that a flat curve looks flat."""
    low, high = axes.get_ylim()
    least = 0.01 * max(abs(low), abs(high))
    if axes.get_yscale() == "linear" and abs(high - low) < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)
