"""Timings as a table and as a picture."""

import math
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich import box
from rich.table import Table

from analysis.benchmarks.cases import Sizes
from analysis.benchmarks.stepped import STEP


def short(ratio: float) -> str:
    """Three digits, in full from 1000 on."""
    return f"{ratio:,.0f}" if ratio >= 999.5 else f"{ratio:.3g}"


def target(row: pd.Series) -> str:
    """Wanted ratio of C to eqsim, and if it is met on one thread and on several."""
    met = [row["C"] >= row["wanted"], row["C_both_threads"] >= row["wanted"]]
    said = "met" if all(met) else "in part" if any(met) else "missed"
    return f"{row['wanted']:.2f} {said}"


def bias(row: pd.Series) -> str:
    return f"{row['A_bias']:+.1%}±{row['A_bias_stderr']:.1%}"


def column(
    name: str, form: Callable[[float], str]
) -> tuple[str, Callable[[pd.Series], str]]:
    return name, lambda row: form(row[name])


# heading: a figure that the column needs, and its format
COLUMNS: dict[str, tuple[str, Callable[[pd.Series], str]]] = {
    "s": column("seconds", "{:.3g}".format),
    "ns": column("ns_per_life", short),
    "ns/step": column("ns_per_step", short),
    "thr.": column("threads", "{:.2f}".format),
    "P": column("P", "{:.2f}".format),
    "A": column("A", short),
    "B": column("B", short),
    "C": column("C", "{:.2f}".format),
    "C on thr.": column("C_both_threads", "{:.2f}".format),
    "wanted": ("C", target),
    "C ns": column("C_ns_per_life", short),
    "C thr.": column("C_threads", "{:.2f}".format),
    "bias of A": ("A_bias", bias),
    "z of B": column("B_z", "{:+.1f}".format),
    "z of C": column("C_z", "{:+.1f}".format),
    "singly": column("singly", short),
    "solves": column("solves", "{:.0f}".format),
    "ms/solve": column("ms_per_solve", "{:.3g}".format),
    "bytes": column("bytes", "{:.1f}".format),
}
BARS = {  # figure: label and colour
    "A": ("A: NumPy script", "#b0b7bf"),
    "B": ("B: scalar numba kernel", "#4878a8"),
    "C": ("C: by hand in C", "#5a9a68"),
    "C_both_threads": ("C over eqsim, both on threads", "#a9d0b0"),
    "threads": ("eqsim on threads", "#e08a3c"),
}


def notes(sizes: Sizes, threads: int) -> str:
    """Explanation of the columns, below the tables."""
    return (
        f"Medians over {sizes.repeats} interleaved rounds (plain averages: "
        f"{sizes.plain_repeats}). A, B, C: seconds "
        "per second of eqsim, one thread each.\n"
        f"A: NumPy script in steps of {STEP} x_*, {sizes.stepped_contacts} contacts "
        f"over {sizes.stepped_distance:g} "
        f"x_*, scaled by contact-steps (x{sizes.contact_steps:g}).\n"
        f"B: scalar numba kernel of the same algorithm, mean force only; steady "
        f"averages: plain Monte Carlo of "
        f"{sizes.scalar_lives:.0e} lives,\n   compared per life, or scaled to as many "
        f"as the asked error takes.\n"
        "C: the same work by hand in C: eqsim's generator, exact lives, all that "
        "eqsim records; the limit of the "
        "machine. wanted: least C.\n"
        f"s, ns: seconds of eqsim, nanoseconds per life. thr.: seconds on {threads} "
        f"threads over seconds on one "
        f"({1 / threads:.2f} is ideal).\n"
        f"Programme: B follows {sizes.scalar_contacts} contacts from event to event "
        f"(scaled by contacts) and keeps the "
        "forces at the ends of segments;\n   z: the farthest from 0 of these ten. P: "
        "time per life over that of a "
        "constant drive.\n"
        f"Spring: {sizes.pulled_contacts} contacts, no slips; B follows all of them, "
        f"too, in as many steps as eqsim "
        "takes, but of one length,\n   and by the rate in the middle of a step. "
        "ns/step: nanoseconds of eqsim per step "
        "and contact.\n"
        "C on thr.: seconds of C per second of eqsim, both on so many threads.\n"
        "bias, z: of the rival's friction against eqsim's.\n"
        "singly: seconds of twelve single solves over those of one for all. bytes: "
        "how much more peak memory "
        f"{sizes.many:.0e} contacts take than 1000, per contact."
    )


def tables(figures: pd.DataFrame) -> list[Table]:
    """Tables of the jobs with rivals, and of the others."""
    compared = figures["B"].notna()
    return [table(figures[compared]), table(figures[~compared])]


def table(figures: pd.DataFrame) -> Table:
    """One section per job, and the columns that are known of some."""
    columns = {
        heading: made
        for heading, made in COLUMNS.items()
        if made[0] in figures and figures[made[0]].notna().any()
    }
    shown = Table(box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    shown.add_column("case", no_wrap=True, min_width=figures["case"].str.len().max())
    for heading in columns:
        shown.add_column(heading, justify="right", no_wrap=True)
    for job, rows in figures.groupby("job", sort=False):
        shown.add_row(f"[bold]{job}")
        for _, row in rows.iterrows():
            cells = (
                "" if pd.isna(row.get(name, np.nan)) else form(row)
                for name, form in columns.values()
            )
            shown.add_row(row["case"], *cells)
        shown.add_section()
    return shown


def picture(figures: pd.DataFrame, path: Path) -> None:
    """One panel per job with rivals; bars reach from 1, lines from the least round to
    the greatest."""
    compared = figures[figures["B"].notna()]
    jobs = compared["job"].unique()
    plt.rcParams.update(
        {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    )
    columns = math.ceil(len(jobs) / 2)
    figure, panels = plt.subplots(
        2, columns, figsize=(5.6 * columns, 13), layout="constrained", squeeze=False
    )
    for panel in panels.flat[len(jobs) :]:
        panel.remove()
    for panel, job in zip(panels.flat, jobs, strict=False):
        _bars(panel, compared[compared["job"] == job])
        panel.set_title(job)
        panel.invert_yaxis()
    handles = [Patch(color=color, label=label) for label, color in BARS.values()]
    handles.append(
        Line2D([], [], color="#c03030", lw=2, ls=":", label="wanted of C, at least")
    )
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), frameon=False
    )
    figure.supxlabel(
        "seconds per second of eqsim (right of 1: slower than eqsim)", fontsize=10
    )
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _bars(panel: Axes, rows: pd.DataFrame) -> None:
    names = [name for name in BARS if name in rows and rows[name].notna().all()]
    height = 0.8 / len(names)
    for index, name in enumerate(names):
        value, low, high = (
            rows[column].to_numpy(float)
            for column in (name, f"{name}_low", f"{name}_high")
        )
        y = [at + height * (index - (len(names) - 1) / 2) for at in range(len(rows))]
        panel.barh(y, value - 1, height * 0.92, left=1, color=BARS[name][1])
        panel.hlines(y, low, high, color="#333333", lw=1)
        for at, ratio, end in zip(y, value, high, strict=True):
            panel.annotate(
                short(ratio),
                (max(end, 1.0), at),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
            )
        if name.startswith("C"):
            panel.vlines(
                rows["wanted"],
                np.subtract(y, height / 2),
                np.add(y, height / 2),
                color="#c03030",
                ls=":",
                lw=2,
            )
    ends = rows[[f"{name}_{end}" for name in names for end in ("low", "high")]]
    least, most = ends.min(axis=None), ends.max(axis=None)
    panel.set_xscale("log")
    # room for the last number
    panel.set_xlim(0.7 * least, 1.25 * most * (most / least) ** 0.15)
    panel.axvline(1, color="#333333", lw=1)
    panel.xaxis.set_major_formatter("{x:,g}")
    panel.xaxis.set_minor_formatter("")
    panel.set_yticks(range(len(rows)), rows["case"])
    panel.tick_params(axis="y", length=0)
