"""Commands that check and hand on results: validate, replay, export."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Exit, Option

from eqsim.cli.options import Shown, Threads, cores
from eqsim.errors import InputError, require_integer

if TYPE_CHECKING:
    from eqsim.validation.verdict import Verdict
    from eqsim.workflows.replay import Repeat, Replay

_OUT = Path("runs/out/validation")
_CSV = "Of several tables their folder. Default: NAME.csv beside NAME.parquet, DIR.csv beside the folder of a sweep."


def validate(
    suite: Annotated[
        str, Argument(help='"quick" (seconds) or "full" (minutes).')
    ] = "quick",
    out: Annotated[
        Path, Option(help="Folder for the table of scores and the picture.")
    ] = _OUT,
    seed: Annotated[
        int, Option(help="Random seed: other parameter points, other lives.")
    ] = 1,
    threads: Threads = None,
    *,
    shown: Shown,
) -> None:
    """Particles against the master equation over the parameter space; exit code 1 if
    they disagree.

    Points differ in thresholds, heat, delay, aging and velocity. Compared are steady
    averages, transients, programmes (steps, holds, crawls, jitter, reversals), hazards,
    fluctuations, and sliders behind a spring.
    """
    require_integer("--seed", seed, 0, 2**63 - 1)
    count = cores(threads)
    from eqsim import validation
    from eqsim.io import storage
    from eqsim.io.plots import validation_figure
    from eqsim.io.style import saved

    storage.check_folder(out)
    with shown.bar("validating", "points") as progress:
        result = validation.validate(suite, seed=seed, threads=count, progress=progress)
    absent = validation.left_out(result.unscored)
    refused = {
        (validation.law_text(one.ensemble.thresholds), one.message)
        for one in result.unscored
        if one.message
    }
    summary = {
        "suite": suite,
        "seed": seed,
        "passed": result.passed,
        "verdicts": [asdict(verdict) for verdict in result.verdicts],
        "declined": result.declined,
        "left_out": absent,
        "refused": sorted(refused),
        "versions": storage.versions(),
    }
    table = storage.parquet(
        validation.columns(result.scores),
        storage.provenance("validate", {"suite": suite}, "", seed),
    )
    files = {
        "scores.parquet": table,
        "validation.png": saved(validation_figure(result)),
    }
    storage.publish(out, {**files, "summary.json": storage.to_json(summary).encode()})
    reasons = [
        f"{sum(of.get(reason, 0) for of in absent.values())} {reason}"
        for reason in validation.REASONS
    ]
    shown.report(
        summary,
        title=f"suite {suite}: {len(result.scores)} comparisons, each p must exceed {validation.ALARM:g}",
        columns=("kind", "scores", "chi-square", "p", "largest |z|", "p (of so many)", "verdict"),
        rows=[_verdict_row(v, v.kind in result.declined) for v in result.verdicts],
        notes=["left out: " + ", ".join(reasons), f"{out}/: scores.parquet, summary.json, validation.png"],
    )  # fmt: skip
    if not result.passed:
        raise Exit(1)


def _verdict_row(v: "Verdict", declined: bool) -> tuple[str, ...]:
    passed = "passed" if v.passed and not declined else "FAILED"
    chi_square = f"{v.chi_square:.1f}/{v.even}", f"{v.p_chi_square:.2g}"
    return (
        v.kind,
        str(v.count),
        *chi_square,
        f"{v.largest:.2f}",
        f"{v.p_largest:.2g}",
        passed,
    )


def replay(
    path: Annotated[
        Path, Argument(metavar="FILE", help="Parquet file that eqsim wrote.")
    ],
    threads: Threads = None,
    *,
    shown: Shown,
) -> None:
    """Run again what made a file, from its provenance alone, and compare bit by bit;
    exit code 1 if they differ."""
    report_replay(path, cores(threads), shown)


def report_replay(
    path: Path,
    workers: int,
    shown: Shown,
    others: "Mapping[str, Repeat] | None" = None,
) -> None:
    """Replay a table and say where the two differ; `others` repeat what programs beside
    this one have written. Raises Exit if they differ."""
    from eqsim.workflows.replay import replay as repeat

    with shown.bar("repeating", "units") as progress:
        found = repeat(path, workers=workers, progress=progress, others=others)
    shown.report({**asdict(found), "same": found.same}, notes=_compared(path, found))
    if not found.same:
        raise Exit(1)


def _compared(path: Path, found: "Replay") -> Iterator[str]:
    for name, (then, now) in found.versions.items():
        yield f"{name} was {then}, is {now}"
    if found.same:
        yield f"{path}: `eqsim {found.command}` gives the same {found.rows} rows, to the last bit"
    for name, (rows, most) in found.differences.items():
        by = f", by up to {most:.3g}" if most else ""
        yield f"{path}: {name} differs in {rows} of {max(rows, found.rows)} rows{by}"


def export(
    path: Annotated[
        Path,
        Argument(
            metavar="PATH", help="Parquet file, or the folder of a run, sweep or fit."
        ),
    ],
    out: Annotated[Path | None, Option(metavar="FILE.csv", help=_CSV)] = None,
    *,
    shown: Shown,
) -> None:
    """Tables as CSV; comment lines hold the run file and what columns mean:
    pandas.read_csv(FILE, comment="#")."""
    from eqsim.io import export as tables
    from eqsim.io import storage

    found = tables.tables(path)
    first = next(iter(found.values()))[0]
    sweep = tables.sweep_of(first)
    dataset = sweep or first.parent
    alone = len(found) == 1 and out is not None and not out.is_dir()
    folder = (
        out.parent
        if alone and out
        else out or (dataset.absolute().parent if sweep else dataset)
    )
    if sweep and folder.resolve().is_relative_to(dataset.resolve()):
        raise InputError(
            f"--out {out}: must be outside {dataset}, where everything is read as points"
        )
    storage.check_folder(folder)
    names = {name: out.name if alone and out else f"{name}.csv" for name in found}
    storage.publish(
        folder, {names[name]: tables.as_csv(files) for name, files in found.items()}
    )
    written = [os.path.relpath(folder / name) for name in names.values()]
    shown.report({"files": written}, notes=written)
