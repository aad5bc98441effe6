"""Commands that check and hand on results: validate, replay, export."""

import os
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option

from eqsim.cli.options import Shown, Threads, cores
from eqsim.errors import InputError, require_integer
from eqsim.lazy import lazily

with lazily():
    from eqsim import validation as comparing
    from eqsim.io import export as tables
    from eqsim.io import storage
    from eqsim.workflows import replay as repeating
    from eqsim.workflows import validation

_File = Argument(metavar="FILE", help="Parquet file that eqsim wrote.")
_SUITE = '"quick" (1 to 3 minutes), "full" (10 to 20 minutes), or "interface" (chains of blocks, half a minute).'
_SCORES = "Folder for the table of scores and the picture."
_SUITE_SEED = "Random seed of parameter points and lives."
_PARQUET = "Parquet file, or the folder of a run, sweep or fit."
_CSV = "CSV file, or folder for several. Default: NAME.csv beside NAME.parquet, DIR.csv beside the folder of a sweep."


def validate(
    suite: Annotated[str, Argument(help=_SUITE)] = "quick",
    out: Annotated[Path, Option(help=_SCORES)] = Path("runs/out/validation"),
    seed: Annotated[int, Option(help=_SUITE_SEED)] = 1,
    threads: Threads = None,
    *,
    shown: Shown,
) -> None:
    """Compare simulated contacts with the master equation over the parameter space;
    exit code 1 if they disagree.

    Points differ in thresholds, heat, delay, aging and velocity. Compared are steady
    averages, transients, programmes (steps, holds, crawls, jitter, reversals), hazards,
    fluctuations, and sliders behind a spring. "interface" compares the creep of chains
    of blocks, and fronts, with exact ones.
    """
    require_integer("--seed", seed, 0, 2**63 - 1)
    count = cores(threads)
    storage.check_folder(out)
    with shown.bar("validating", "points") as progress:
        how: dict[str, Any] = {"threads": count, "progress": progress}
        found = comparing.validate(suite, seed=seed, **how)
    shown.result(validation.ValidationResult(found), suite, out)
    if not found.passed:
        raise Exit(1)


def replay(
    path: Annotated[Path, _File], threads: Threads = None, *, shown: Shown
) -> None:
    """Repeat the call that made a file, from its provenance alone, and compare bit by
    bit; exit code 1 if they differ."""
    report_replay(path, cores(threads), shown)


def report_replay(path: Path, workers: int, shown: Shown, others: Any = None) -> None:
    """Replay a table and print where the two differ; `others` repeat tables of other
    programs (`workflows.replay`). Raises Exit if they differ."""
    with shown.bar("repeating", "units") as progress:
        how: dict[str, Any] = {"progress": progress, "others": others}
        found = repeating.replay(path, workers=workers, **how)
    shown.report({**asdict(found), "same": found.same}, notes=_compared(path, found))
    if not found.same:
        raise Exit(1)


def _compared(path: Path, found: "repeating.Replay") -> Iterator[str]:
    for name, (then, now) in found.versions.items():
        yield f"{name} was {then}, is {now}"
    if found.same:
        yield f"{path}: `eqsim {found.command}` gives the same {found.rows} rows, to the last bit"
    for name, (rows, most) in found.differences.items():
        by = f", by up to {most:.3g}" if most else ""
        yield f"{path}: {name} differs in {rows} of {max(rows, found.rows)} rows{by}"


def export(
    path: Annotated[Path, Argument(metavar="PATH", help=_PARQUET)],
    out: Annotated[Path | None, Option(metavar="FILE.csv", help=_CSV)] = None,
    *,
    shown: Shown,
) -> None:
    """Write tables as CSV; comment lines hold the run file and what columns mean:
    pandas.read_csv(FILE, comment="#")."""
    found = tables.tables(path)
    if len(found) > 1 and out and out.suffix == ".csv" and not out.is_dir():
        said = f"must be a folder, for {len(found)} tables"
        raise InputError(f"--out {out}: {said}")
    first = next(iter(found.values()))[0]
    sweep = tables.sweep_of(first)
    dataset = sweep or first.parent
    alone = out if out and len(found) == 1 and not out.is_dir() else None
    beside = dataset.absolute().parent if sweep else dataset
    folder = alone.parent if alone else out or beside
    if sweep:
        storage.check_outside(dataset, folder, out)
    storage.check_folder(folder)
    files = {
        alone.name if alone else f"{name}.csv": tables.as_csv(parts)
        for name, parts in found.items()
    }
    written = [folder / name for name in files]
    sources = {part.resolve() for part in chain(*found.values())}
    for place in written:
        if place.resolve() in sources:
            raise InputError(f"--out {place}: is the table that is exported")
    storage.publish(folder, files)
    names = list(map(os.path.relpath, written))
    shown.report({"files": names}, notes=names)
