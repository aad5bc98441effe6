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

COLUMNS = {  # heading: figure and format
    "eqsim, s": ("seconds", "{:.3g}"),
    "lives/µs": ("lives_per_microsecond", "{:.1f}"),
    "rel. error": ("rel_error", "{:.1e}"),
    "A": ("A", "{:.3g}"),
    "B": ("B", "{:.3g}"),
    "B per life": ("B_per_life", "{:.2g}"),
    "threads": ("threads", "{:.2f}"),
    "bias of A": ("A_bias", "{:+.2%}"),
    "±": ("A_bias_stderr", "{:.2%}"),
    "z of B": ("B_z", "{:+.1f}"),
}
BARS = {  # figure: label and colour
    "A": ("A: NumPy script", "#b0b7bf"),
    "B": ("B: scalar numba kernel", "#4878a8"),
    "threads": ("eqsim, {} threads", "#e08a3c"),
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
    shown = Table(box=box.SIMPLE_HEAD)
    shown.add_column("contacts", no_wrap=True, min_width=figures["case"].str.len().max())
    for heading in COLUMNS:
        shown.add_column(heading, justify="right", no_wrap=True)
    for job, rows in figures.groupby("job", sort=False):
        shown.add_row(f"[bold]{job}")
        for _, row in rows.iterrows():
            cells = [(row[name], form) for name, form in COLUMNS.values()]
            shown.add_row(row["case"], *("" if pd.isna(value) else form.format(value) for value, form in cells))
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
            text = f"{one:.2f}" if one < 1.995 else f"{one:.3g}" if one < 1000 else f"{one:,.0f}"
            panel.text(max(end, 1.0) * 1.12, at, text, va="center", fontsize=8.5)
    panel.set_xscale("log")
    panel.set_xlim(
        0.6 * min(rows[f"{name}_low"].min() for name in names), 5 * max(rows[f"{name}_high"].max() for name in names)
    )
    panel.axvline(1, color="#333333", lw=1)
    panel.xaxis.set_major_formatter("{x:g}")
    panel.set_yticks(range(len(rows)), rows["case"])
    panel.tick_params(axis="y", length=0)
