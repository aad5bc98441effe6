"""python -m analysis.benchmarks.parts: nanoseconds of each part of a life, in eqsim and
in rival C.

Both are timed with more and more parts: random words only; thresholds and clocks from
them; the stretches at which lives break; and the whole, which records lives in a
trajectory or adds them up in a steady average. The cost of a part is the difference.
Times are of the processor, one thread, the least of many short rounds in which all take
turns.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numba
import numpy as np
import pandas as pd
import typer
from matplotlib.patches import Patch
from rich import box
from rich.console import Console
from rich.table import Table

from analysis.benchmarks import tuned
from analysis.benchmarks.cases import CASES, QUICK, VELOCITY, Case, Sizes
from eqsim.engine.contacts import Contacts, contacts
from eqsim.engine.lanes import (
    LANES,
    ROUNDS,
    Lanes,
    Lives,
    carry_lives,
    draw_lives,
    follow,
    idle_lanes,
)
from eqsim.engine.programme import constant_drive
from eqsim.engine.randomise import PlainSums
from eqsim.engine.recorder import Run, Scales
from eqsim.engine.stationary import Fresh
from eqsim.laws.barrier.base import thermal
from eqsim.numerics.streams import TRAJECTORY, fill_words, key
from eqsim.numerics.threads import current_stop

OUT = Path(__file__).parents[1] / "out"
PARTS = {
    "draw": "#4878a8",
    "threshold": "#e08a3c",
    "break": "#5a9a68",
    "record": "#b0b7bf",
}
MEANING = {
    "draw": "draw (random words)", "threshold": "threshold and clock", "break": "break",
    "record": "record or add up",
}  # fmt: skip
JOBS = {"trajectory": "trajectory", "steady": "plain steady average"}

Work = Callable[[], int]  # does the work, and returns the number of lives
# as eqsim compiles
numba_options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


@numba.njit(**numba_options)
def words_only(
    c: Contacts, lanes: Lanes, lives: Lives, rounds: int
) -> None:  # pragma: no cover  # compiled
    for _ in range(rounds):
        for _ in range(ROUNDS if thermal(c.barrier) else 1):
            fill_words(lanes.key, lanes.contact, lanes.age, 0, lanes.words, LANES)
        for i in range(LANES):
            lanes.age[i] += 1


@numba.njit(**numba_options)
def drawn(
    c: Contacts, lanes: Lanes, lives: Lives, rounds: int
) -> None:  # pragma: no cover  # compiled
    for _ in range(rounds):
        draw_lives(c.newborn, c, lanes, lives, LANES)
        for i in range(LANES):
            lanes.age[i] += 1


@numba.njit(**numba_options)
def broken(
    c: Contacts, lanes: Lanes, lives: Lives, rounds: int
) -> None:  # pragma: no cover  # compiled
    for _ in range(rounds):
        draw_lives(c.newborn, c, lanes, lives, LANES)
        carry_lives(c.newborn, c, lives, LANES)
        for i in range(LANES):
            lanes.age[i] += 1


def of_eqsim(case: Case, sizes: Sizes) -> dict[str, Work]:
    """eqsim's kernels, stripped and whole."""
    c, name = (
        contacts(case.ensemble(sizes.contacts), VELOCITY, None),
        key(1, TRAJECTORY),
    )
    rounds = max(1, sizes.scalar_lives // (ROUNDS * LANES))
    lanes, lives = idle_lanes(c, name)
    lanes.contact[:] = np.arange(LANES)

    def stripped(kernel: Any) -> Work:
        def work() -> int:
            kernel(c, lanes, lives, rounds)
            return ROUNDS * LANES * rounds

        return work

    run = Run(sizes.distance, sizes.points)
    job = constant_drive(
        c, Fresh(), run, Scales.of(c, run, sizes.contacts, 1, 0.0), name, 0.0
    )

    def trajectory() -> int:
        total = job.totals(1)
        job.simulate(total, 0, sizes.contacts)
        return int(total.lives[0])

    def steady() -> int:
        sums = PlainSums.empty(0, 0, rounds, current_stop())
        follow(c, sums, 0, LANES, *idle_lanes(c, name))
        return ROUNDS * LANES * rounds

    bare = {"draw": words_only, "threshold": drawn, "break": broken}
    return {part: stripped(kernel) for part, kernel in bare.items()} | {
        "trajectory": trajectory,
        "steady": steady,
    }


def of_c(case: Case, sizes: Sizes) -> dict[str, Work]:
    """Rival C, stripped and whole."""

    def stripped(upto: int) -> Work:
        return lambda: tuned.stripped(case, upto, sizes.scalar_lives)

    def trajectory() -> int:
        return tuned.run(case, sizes.contacts, sizes.distance, sizes.points, 1).lives

    def steady() -> int:
        tuned.steady(case, sizes.scalar_lives, 1)
        return sizes.scalar_lives

    bare = {
        part: stripped(upto) for upto, part in enumerate(("draw", "threshold", "break"))
    }
    return bare | {"trajectory": trajectory, "steady": steady}


def measure(case: Case, sizes: Sizes, rounds: int) -> list[dict[str, Any]]:
    """A row for each job and contender: nanoseconds of a life by part."""
    contenders = {"eqsim": of_eqsim(case, sizes)} | (
        {"C": of_c(case, sizes)} if tuned.available() else {}
    )
    least = {(who, work): np.inf for who, works in contenders.items() for work in works}
    for number in range(rounds + 1):
        for who, work in list(least)[:: (-1) ** number]:
            begin = time.process_time()
            lives = contenders[who][work]()
            spent = 1e9 * (time.process_time() - begin) / lives
            if number > 0:  # the first compiles
                least[who, work] = min(least[who, work], spent)
    rows = []
    for job in JOBS:
        for who in contenders:
            until = [
                0.0,
                *(least[who, work] for work in ("draw", "threshold", "break", job)),
            ]
            parts = dict(zip(PARTS, np.diff(np.maximum.accumulate(until)), strict=True))
            rows.append(
                {
                    "job": JOBS[job],
                    "case": case.name,
                    "who": who,
                    **parts,
                    "whole": least[who, job],
                }
            )
    return rows


def table(figures: pd.DataFrame) -> Table:
    """Nanoseconds of a life by part, of eqsim and C, and the ratio of the wholes."""
    shown = Table(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        title="ns of a life by part",
        title_justify="left",
    )
    for heading in ("job", "contacts", "", *PARTS, "whole", "C/eqsim"):
        text = heading in ("job", "contacts", "")
        shown.add_column(heading, justify="left" if text else "right", no_wrap=text)
    for (job, case), rows in figures.groupby(["job", "case"], sort=False):
        whole = rows.set_index("who")["whole"]
        for row in rows.to_dict("records"):
            ratio = f"{whole['C'] / whole['eqsim']:.2f}" if row["who"] == "C" else ""
            cells = [f"{row[part]:.1f}" for part in (*PARTS, "whole")]
            shown.add_row(str(job), str(case), row["who"], *cells, ratio)
    return shown


def picture(figures: pd.DataFrame, path: Path) -> None:
    """One panel per job, one bar per case and contender, one colour per part."""
    jobs, cases = figures["job"].unique(), list(figures["case"].unique())
    contenders = list(figures["who"].unique())
    plt.rcParams.update(
        {"font.size": 10, "axes.spines.top": False, "axes.spines.right": False}
    )
    figure, panels = plt.subplots(
        1, len(jobs), figsize=(6.2 * len(jobs), 5.4), sharey=True, layout="constrained"
    )
    for panel, job in zip(panels, jobs, strict=True):
        rows = figures[figures["job"] == job]
        at = np.array(
            [
                cases.index(row.case) + 0.4 * (contenders.index(row.who) - 0.5)
                for row in rows.itertuples()
            ]
        )
        left = np.zeros(len(rows))
        for part, color in PARTS.items():
            panel.barh(
                at, rows[part], 0.36, left=left, color=color, edgecolor="white", lw=0.5
            )
            left += rows[part].to_numpy()
        for y, end, who in zip(at, left, rows["who"], strict=True):
            panel.annotate(
                f"{who}  {end:.1f}",
                (end, y),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
            )
        panel.set_xlim(0, 1.2 * figures["whole"].max())
        panel.set_title(job)
        panel.set_xlabel("ns of a life, one thread")
        panel.tick_params(axis="y", length=0)
    panels[0].set_yticks(range(len(cases)), cases)
    panels[0].invert_yaxis()
    handles = [Patch(color=color, label=MEANING[part]) for part, color in PARTS.items()]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=len(handles), frameon=False
    )
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(
    out: Annotated[
        Path, typer.Option(help="Folder for parts.parquet and parts.png.")
    ] = OUT,
    rounds: Annotated[
        int, typer.Option(min=1, help="Rounds, of which the least time counts.")
    ] = 15,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Small sizes: a smoke test, not a measurement."),
    ] = False,
) -> None:
    """Time eqsim and rival C part by part; print and write a table, draw a picture."""
    console, sizes = (
        Console(),
        QUICK if quick else Sizes(contacts=20_000, scalar_lives=1_000_000),
    )
    console.width = max(console.width, 120)
    if not tuned.available():
        console.print("no gcc that compiles tuned.c: rival C is left out")
    figures = pd.DataFrame(
        [row for case in CASES for row in measure(case, sizes, rounds)]
    )
    figures = figures.sort_values("job", kind="stable", ascending=False).reset_index(
        drop=True
    )
    console.print(table(figures))
    out.mkdir(parents=True, exist_ok=True)
    figures.to_parquet(out / "parts.parquet", index=False)
    picture(figures, out / "parts.png")
    console.print(f"wrote parts.parquet and parts.png to {out}")


if __name__ == "__main__":
    typer.run(main)
