"""Style of pictures: a palette for all kinds of colour vision and for print in grey,
axes without offsets, 150 dpi."""

import functools
import io
import re
import textwrap
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
# Settings of a picture whose width on paper is given.
PAPER: dict[str, Any] = {
    "font.size": 7,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "axes.linewidth": 0.6,
    "figure.titlesize": 8,
    "grid.linewidth": 0.4,
    "legend.fontsize": 7,
    "lines.linewidth": 0.8,
    "savefig.dpi": 600,
    "xtick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7,
    "ytick.major.width": 0.6,
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
    """Let a function draw in this style, with titles that fit on the page."""

    @functools.wraps(draw)
    def drawn(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        with matplotlib.rc_context(STYLE | PANELS):
            figure = draw(*args, **kwargs)
            if isinstance(figure, Figure):  # no film
                wrap_titles(figure)
            return figure

    return drawn


def saved(
    figure: Figure, form: str = "png", settings: dict[str, Any] | None = None
) -> bytes:
    """Render a picture as the content of a file, with other `settings` if it was drawn
    with them. Raises InputError unless `form` is one of `FORMATS`."""
    require_choice("format", form, FORMATS)
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE | (settings or {})):
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


def wrapped(text: str, inches: float) -> str:
    """Break a title or label into lines of about so many inches; formulas and units in
    brackets stay whole."""
    whole: list[str] = []

    def kept(found: re.Match[str]) -> str:
        whole.append(found[0])
        return "\0" * len(re.sub(r"\\[a-z]+|[${}^_ ]+", "\0", found[0]))

    text = re.sub(r"(?<!\\)\$[^$]*\$|\[.*?\](?= |$)", kept, text)
    letter = 0.55 * matplotlib.rcParams["axes.titlesize"] / 72.0  # mean width, inches
    options: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    wide = max(1, int(inches / letter))
    lines = (textwrap.fill(line, wide, **options) for line in text.split("\n"))
    return re.sub("\0+", lambda found: whole.pop(0), "\n".join(lines))


def wrap_titles(figure: Figure) -> None:
    """Break titles that are wider than the page into lines, for which it grows."""
    titles = [axes.title for axes in figure.axes]
    if heading := figure.get_suptitle():
        titles.append(figure.suptitle(heading))
    for title in titles:
        before = title.get_window_extent()
        if before.width > 0.9 * figure.bbox.width:
            title.set_text(wrapped(title.get_text(), 0.75 * figure.get_figwidth()))
            grown = title.get_window_extent().height - before.height
            figure.set_figheight(figure.get_figheight() + grown / figure.dpi)


def not_flat(axes: Any) -> None:
    """Widen a linear axis to 1 % of its values, so that a flat curve looks flat."""
    low, high = axes.get_ylim()
    least = 0.01 * max(abs(low), abs(high))
    if axes.get_yscale() == "linear" and abs(high - low) < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)
