"""How pictures look: one palette for eyes that confuse colours and for print in grey,
no hidden offsets, 150 dpi."""

import functools
import io
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec

import matplotlib
from matplotlib.figure import Figure
from matplotlib.rcsetup import cycler

from eqsim.errors import require_choice

# Okabe and Ito (2008), colours that all kinds of colour vision tell apart, without the
# yellow that paper swallows.
BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
)
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
_UNDATED: dict[str, dict[str, Any]] = {
    "png": {"Software": "eqsim"}, "pdf": {"CreationDate": None, "Creator": "eqsim"}, "svg": {"Date": None},
}  # fmt: skip
_FLAT = 1e-5  # an axis whose values differ relatively by less shows a band of 1 % around them
Arguments = ParamSpec("Arguments")


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """A function that draws, in this style."""

    @functools.wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return drawn


def saved(figure: Figure, form: str = "png") -> bytes:
    """A picture as the content of a file. Raises InputError unless `form` is one of
    `FORMATS`."""
    require_choice("format", form, FORMATS)
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        for axes in figure.axes:
            _not_flat(axes)
        figure.savefig(buffer, format=form, metadata=_UNDATED[form])
    return buffer.getvalue()


def pictures(
    name: str, figure: Figure, formats: Sequence[str] = ("png",)
) -> dict[str, bytes]:
    """A picture in some formats, by the names of the files."""
    return {f"{name}.{form}": saved(figure, form) for form in formats}


def _not_flat(axes: Any) -> None:
    """Widen limits between which there is nothing but rounding."""
    low, high = axes.get_ylim()
    size = max(abs(low), abs(high))
    if axes.get_yscale() == "linear" and 0 < abs(high - low) < _FLAT * size:
        axes.set_ylim(
            0.5 * (low + high) - 0.005 * size, 0.5 * (low + high) + 0.005 * size
        )
