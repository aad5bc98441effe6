"""The figures as a table and as a picture."""

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from rich import box
from rich.table import Table

from analysis.benchmarks.cases import Sizes
from analysis.benchmarks.stepped import STEP


def short(ratio: float) -> str:
    """Three digits, in full from 1000 on."""
    return f"{ratio:,.0f}" if ratio >= 999.5 else f"{ratio:.3g}"


COLUMNS = {  # heading: figure, and how to print it
    "eqsim, s": ("seconds", "{:.3f}".format),
    "lives/µs": ("lives_per_microsecond", "{:.1f}".format),
    "rel. error": ("rel_error", "{:.1e}".format),
    "A": ("A", short),
    "B": ("B", short),
    "B per life": ("B_per_life", "{:.2f}".format),
    "threads": ("threads", "{:.2f}".format),
    "bias of A": ("A_bias", "{:+.2%}".format),
    "±": ("A_bias_stderr", "{:.2%}".format),
    "z of B": ("B_z", "{:+.1f}".format),
}
BARS = {  # figure: label and colour
    "A": ("A: NumPy script", "#b0b7bf"),
    "B": ("B: scalar numba kernel", "#4878a8"),
    "threads": ("eqsim, threads = {}", "#e08a3c"),
}


def notes(sizes: Sizes, threads: int) -> str:
    """How to read the figures."""
    return (
        f"A, B, threads: seconds per second of eqsim on one thread, medians over {sizes.repeats} interleaved turns.\n"
        f"A: NumPy script in steps of {STEP} x_*, one thread, {sizes.stepped_contacts} contacts over "
        f"{sizes.stepped_distance:g} x_*, scaled by contact-steps (x{sizes.contact_steps:g}).\n"
        "B: scalar numba kernel of the same algorithm, one thread, mean force only. Steady averages: plain Monte\n"
        f"   Carlo of {sizes.lives:.1e} lives, scaled to the lives the asked error takes; per life: for equally many.\n"
        f"threads: eqsim on {threads} threads. bias, z: of the rival's friction against eqsim's. "
        "rel. error: of eqsim's friction."
    )


def table(figures: pd.DataFrame) -> Table:
    """One section per job."""
    shown = Table(box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    shown.add_column("contacts", no_wrap=True, min_width=figures["case"].str.len().max())
    for heading in COLUMNS:
        shown.add_column(heading, justify="right", no_wrap=True)
    for job, rows in figures.groupby("job", sort=False):
        shown.add_row(f"[bold]{job}")
        for _, row in rows.iterrows():
            cells = ("" if pd.isna(row[name]) else form(row[name]) for name, form in COLUMNS.values())
            shown.add_row(row["case"], *cells)
        shown.add_section()
    return shown


def picture(figures: pd.DataFrame, threads: int, path: Path) -> None:
    """One panel per job; bars reach from 1, which is eqsim on one thread, lines from the least turn to the greatest."""
    jobs = figures["job"].unique()
    plt.rcParams.update({"font.size": 10, "axes.spines.top": False, "axes.spines.right": False})
    figure, panels = plt.subplots(1, len(jobs), figsize=(4.4 * len(jobs), 5.6), sharey=True, layout="constrained")
    for panel, job in zip(panels, jobs, strict=True):
        _bars(panel, figures[figures["job"] == job])
        panel.set_title(job)
    panels[0].invert_yaxis()
    handles = [Patch(color=color, label=label.format(threads)) for label, color in BARS.values()]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(BARS), frameon=False)
    figure.supxlabel("seconds per second of eqsim on one thread (right of 1: slower than eqsim)", fontsize=10)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _bars(panel: Axes, rows: pd.DataFrame) -> None:
    names = [name for name in BARS if name in rows and rows[name].notna().all()]
    height = 0.8 / len(names)
    for index, name in enumerate(names):
        value, low, high = (rows[column].to_numpy(float) for column in (name, f"{name}_low", f"{name}_high"))
        y = [at + height * (index - (len(names) - 1) / 2) for at in range(len(rows))]
        panel.barh(y, value - 1, height * 0.92, left=1, color=BARS[name][1])
        panel.hlines(y, low, high, color="#333333", lw=1)
        for at, one, end in zip(y, value, high, strict=True):
            panel.annotate(short(one), (max(end, 1.0), at), (4, 0), textcoords="offset points", va="center", fontsize=9)
    ends = rows[[f"{name}_{end}" for name in names for end in ("low", "high")]]
    least, most = ends.min(axis=None), ends.max(axis=None)
    panel.set_xscale("log")
    panel.set_xlim(0.7 * least, 1.25 * most * (most / least) ** 0.15)  # room for the last number
    panel.axvline(1, color="#333333", lw=1)
    panel.xaxis.set_major_formatter("{x:,g}")
    panel.set_yticks(range(len(rows)), rows["case"])
    panel.tick_params(axis="y", length=0)
