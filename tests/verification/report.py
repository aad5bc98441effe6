"""What the parts of the long run leave behind, and the report that is made of them.

Every part is a file of its own in `parts/`, so that the run may be divided between
processes, and stopped and taken up again. Only parts that the same code made, by a
digest of its sources, are put together.
"""

import fcntl
import hashlib
import json
import time
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from eqsim.io import storage
from eqsim.plots import style
from eqsim.validation.comparison import REASONS, Score
from eqsim.validation.points import SUITES
from eqsim.validation.verdict import ALARM, KINDS, judge, p_overall

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "runs" / "out" / "verification"
# of the parameter space; 25, so that every part has points of all kinds
SEED, PARTS = (6211, 25)
SEEDS = range(6301, 6341)  # of the suites whose p-values are to be flat
P_VALUES = ("p_chi_square", "p_largest")


def digest():
    """Of the sources that numbers depend on."""
    folders = ("numerics", "laws", "model", "engine", "master", "validation")
    sources = [
        path
        for folder in folders
        for path in sorted((ROOT / "eqsim" / folder).rglob("*.py"))
    ]
    sources.append(ROOT / "eqsim" / "estimate.py")
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[
        :16
    ]


DIGEST = digest()


@contextmanager
def alone():
    """One process at a time puts parts together."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    with (FOLDER / ".lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def leave(name, begin, table=None, **found):
    """Save a part: its scores, columns by name, and whatever else it `found`, with the
    seconds since `begin`."""
    record = {"digest": DIGEST, "seconds": time.perf_counter() - begin, **found}
    files = {f"{name}.json": storage.to_json(record).encode()}
    if table is not None:
        files[f"{name}.parquet"] = storage.parquet(table, {"digest": DIGEST})
    storage.publish(FOLDER / "parts", files)


def parts(kind):
    """The records of all parts of a kind by name."""
    found = {}
    for path in sorted((FOLDER / "parts").glob(f"{kind}-*.json")):
        record = json.loads(path.read_text())
        if record["digest"] == DIGEST:
            found[path.stem] = record
    return found


class Report(NamedTuple):
    """Verdicts on the parameter space, its scores, what was left out by kind and
    reason, p-values by seed, their flatness, and the controls; `complete` says which of
    "space" and "flat" have all their parts."""

    verdicts: list
    scores: pd.DataFrame
    left_out: dict
    flat: pd.DataFrame
    flatness: dict
    controls: dict
    complete: set
    seconds: dict


def gather():
    """Put the parts together that there are."""
    space, seeds, controls = parts("space"), parts("flat"), parts("control")
    read = [pd.read_parquet(FOLDER / "parts" / f"{name}.parquet") for name in space]
    scores = (
        pd.concat(read, ignore_index=True)
        if read
        else pd.DataFrame({"kind": [], "z": [], "even": []})
    )
    rows = [
        Score(row.kind, None, 0.0, 0.0, 0.0, 1.0, row.z, row.even)
        for row in scores.itertuples()
    ]
    left_out = {
        kind: {
            reason: sum(
                part["left_out"].get(kind, {}).get(reason, 0) for part in space.values()
            )
            for reason in REASONS
        }
        for kind in KINDS
    }
    flat = pd.DataFrame(
        [row for record in seeds.values() for row in record["verdicts"]],
        columns=["kind", *P_VALUES],
    )
    flatness = {
        (kind, name): float(
            stats.kstest(
                flat.loc[flat["kind"] == kind, name], "uniform", alternative=side
            ).pvalue
        )
        for kind in KINDS
        for name, side in zip(P_VALUES, ("two-sided", "greater"), strict=True)
        if (flat["kind"] == kind).any()
    }
    complete = {
        name
        for name, got, all_ in (("space", space, PARTS), ("flat", seeds, len(SEEDS)))
        if len(got) == all_
    }
    records = (
        ("parameter space", space),
        ("flatness", seeds),
        ("negative controls", controls),
    )
    seconds = {
        name: sum(record["seconds"] for record in group.values())
        for name, group in records
    }
    return Report(
        [judge(kind, rows) for kind in KINDS],
        scores,
        left_out,
        flat,
        flatness,
        controls,
        complete,
        seconds,
    )


def publish():
    """Write `report.md`, `scores.parquet` and `verification.png` from the parts that
    there are."""
    with alone():
        found = gather()
        files = {"report.md": text(found).encode(), "verification.png": picture(found)}
        if not found.scores.empty:
            files["scores.parquet"] = storage.parquet(
                found.scores, {"suite": "verification", "seed": SEED}
            )
        storage.publish(FOLDER, files)
    return found


def text(found):
    """The report."""
    points = SUITES["verification"].points
    lines = [
        "# Statistical verification",
        "",
        f"Code {DIGEST}, " + ", ".join(f"{k} {v}" for k, v in versions()),
        "",
    ]
    lines += ["## Engine against master equation over the parameter space", ""]
    lines += [
        f"{len(parts('space'))} of {PARTS} parts of {points} points, seed {SEED}: {len(found.scores)} scores. Those "
        "whose errors are scatter make the chi-square.",
        "",
    ]
    lines += [
        "| kind | scores | chi-square | of | p | largest abs(z) | p (of so many) | verdict |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for v in found.verdicts:
        lines.append(
            f"| {v.kind} | {v.count} | {v.chi_square:.1f} | {v.even} | {v.p_chi_square:.2g} | {v.largest:.2f} "
            f"| {v.p_largest:.2g} | {('passed' if v.passed else 'FAILED') if v.count else 'not run'} |"
        )
    lines += [
        "",
        "What was left out:",
        "",
        "| kind | " + " | ".join(REASONS) + " |",
        "|---" * (len(REASONS) + 1) + "|",
    ]
    lines += [
        f"| {kind} | " + " | ".join(str(n) for n in of.values()) + " |"
        for kind, of in found.left_out.items()
    ]
    lines += by_law(found.scores)
    if not found.scores.empty:
        lines += [
            "",
            f"Smallest p of all kinds, Bonferroni: {p_overall(found.verdicts):.2g}.",
        ]
    lines.append("")
    lines.append(
        f"Each p must exceed {ALARM:g}: a correct program fails once in {1 / (2 * len(KINDS) * ALARM):.0f} runs."
    )
    worst = found.scores.reindex(
        found.scores["z"].abs().sort_values(ascending=False).index
    ).head(5)
    lines += ["", "The five largest:", ""]
    for _, row in worst.iterrows():
        lines.append(
            "- "
            + ", ".join(
                f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v!s:.200}"
                for k, v in row.items()
            )
        )
    lines += ["", "## Flatness of p-values over seeds", ""]
    count = found.flat.groupby("kind").size().max() if len(found.flat) else 0
    lines += [
        f"{count} of {len(SEEDS)} seeds from {SEEDS[0]}. Kolmogorov-Smirnov probability that p is uniform:",
        "",
    ]
    lines += ["| kind | p of chi-square | p of largest |", "|---|---|---|"]
    for kind in KINDS:
        if (kind, P_VALUES[0]) in found.flatness:
            lines.append(
                f"| {kind} | "
                + " | ".join(f"{found.flatness[kind, name]:.2g}" for name in P_VALUES)
                + " |"
            )
    lines += [
        "",
        f"Each must exceed {ALARM:g}: false alarm once in {1 / (2 * len(KINDS) * ALARM):.0f} runs.",
        "",
    ]
    if len(found.flat):
        smallest, least = found.flat[[*P_VALUES]].min(axis=None), ALARM / len(SEEDS)
        lines += [
            f"The smallest p of all kinds and seeds, {smallest:.2g}, must exceed {least:g}: the same chance.",
            "",
        ]
    lines += [
        "## Negative controls",
        "",
        "One thing wrong in the engine alone; chi-square/even scores of the kinds that fail.",
        "",
    ]
    lines += ["| law | what is wrong | caught | kinds that fail |", "|---|---|---|---|"]
    for record in found.controls.values():
        kinds = ", ".join(
            f"{v['kind']} {(v['chi_square'] or np.inf):.3g}/{v['even']}"
            for v in record["verdicts"]
            if not v["passed"]
        )
        lines.append(
            f"| {record['law']} | {record['wrong']} | {'yes' if record['caught'] else 'NO'} | {kinds} |"
        )
    lines += ["", "## Time", ""] + [
        f"- {name}: {seconds / 60:.1f} min" for name, seconds in found.seconds.items()
    ]
    return "\n".join(lines) + "\n"


def by_law(scores):
    """A table of scores by law of thresholds and by kind."""
    if scores.empty:
        return []
    law = scores["thresholds"].str.extract(
        r"(?:stats\.)?(\w+)\((?!stats)", expand=False
    )
    lines = [
        "",
        "By law of thresholds, scores, even ones, mean square of these, and largest abs(z):",
        "",
    ]
    lines += [
        "| law | scores | even | mean square | largest abs(z) |",
        "|---|---|---|---|---|",
    ]
    for name, of in scores.groupby(law):
        z, even = of["z"].astype(float), of["even"].astype(bool)
        lines.append(
            f"| {name} | {len(of)} | {even.sum()} | {(z[even] ** 2).mean():.3f} | {z.abs().max():.2f} |"
        )
    return lines


def versions():
    return storage.versions().items()


def picture(found):
    """Scores by kind against the normal law, and p-values against their ranks."""
    figure = Figure(figsize=(13, 5), dpi=130, layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[3, 1.4, 1.6])
    rng = np.random.default_rng(0)
    z = np.clip(found.scores["z"].astype(float), -8, 8)
    for disorder, color in (("quenched", "C0"), ("annealed", "C1")):
        of = found.scores.get("disorder", pd.Series(dtype=object)) == disorder
        x = found.scores.loc[of, "kind"].map(KINDS.index).astype(float) + rng.uniform(
            -0.35, 0.35, of.sum()
        )
        left.scatter(x, z[of], s=3, color=color, alpha=0.5, label=disorder)
    names = [
        f"{v.kind.replace(' ', chr(10)).replace('_', chr(10))}\n{v.count}\np {v.p_chi_square:.2g}"
        for v in found.verdicts
    ]
    left.set_xticks(range(len(names)), names, fontsize=7)
    left.set_ylabel("z = (engine - master) / standard error")
    passed = all(v.passed for v in found.verdicts)
    state = "passed" if passed else "FAILED"
    left.set_title(
        f"{len(found.scores)} scores over the parameter space: {state}", fontsize=10
    )
    left.legend(fontsize=8, loc="upper right", markerscale=3)
    edges, grid = np.arange(-8, 8.01, 0.25), np.linspace(-8, 8, 401)
    if z.size:
        middle.hist(z, bins=edges, density=True, color="0.8")
    middle.plot(
        grid, stats.norm.pdf(grid), color="k", linewidth=1, label="standard normal"
    )
    middle.set_yscale("log")
    middle.set_ylim(1e-5, 1)
    middle.set_xlabel("z")
    middle.set_title("density of all scores", fontsize=10)
    middle.legend(fontsize=8, loc="lower center")
    for i, kind in enumerate(KINDS):
        of = found.flat[found.flat["kind"] == kind]
        for name, dash in zip(P_VALUES, ("-", ":"), strict=True):
            p = np.sort(of[name].astype(float))
            rank = (np.arange(p.size) + 0.5) / max(p.size, 1)
            right.plot(
                p,
                rank,
                dash,
                color=f"C{i}",
                linewidth=1,
                label=kind if dash == "-" else None,
            )
    right.plot([0, 1], [0, 1], color="k", linewidth=1)
    right.set_xlabel("p of a kind (solid: chi-square, dotted: largest)")
    right.set_ylabel("share of seeds below")
    right.set_title(f"p-values of {len(parts('flat'))} seeds", fontsize=10)
    right.legend(fontsize=6, loc="upper left")
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    return style.saved(figure)
