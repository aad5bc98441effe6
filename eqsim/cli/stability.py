"""The command that says whether sliding through a spring is stable."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from eqsim.cli.options import Changes, RunFilePath, Shown, Threads, cores
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.estimate import Estimate
    from eqsim.io.plots import Caption
    from eqsim.master.stability import Stability

_OUT = "Folder for the borders over velocity: a table, a picture and summary.json."
_CRITICAL = "Look for the critical stiffness of steady sliding also where it takes minutes, with heat or aging."
_DECADES, _POINTS, _FEW = (
    1.5,
    25,
    7,
)  # of the borders, to either side of the run's velocity
_COLUMNS = ("", "value", "meaning")
_FRESH = {
    "slips": "this run slips",
    "jumps": "this run jumps, by less than a slip",
    "slides": "this run does not",
    "undecided": "this run: undecided",
}


def stability(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help=_OUT)] = None,
    critical: Annotated[bool, Option("--critical", help=_CRITICAL)] = False,
    *,
    changes: Changes,
    threads: Threads = None,
    shown: Shown,
) -> None:
    """Whether a slider that a stage pulls through a spring slides steadily, or sticks
    and slips."""
    file = changes.load(path)
    cores(threads)
    from eqsim.io import storage

    if out is not None:
        storage.check_folder(out)
    from eqsim.master import stability as solve

    pulled = solve.pulled_by(file.ensemble, file.drive)
    with shown.bar("kicks and stiffnesses", "runs") as progress:
        found = solve.stability(
            pulled.ensemble,
            pulled.programme(),
            critical=True if critical else None,
            progress=progress,
        )
    title, notes = file.title or path.stem, list(_remarks(found))
    if out is not None:
        steady = pulled.quick or critical
        velocities = _velocities(
            found.velocity, _FEW if critical and not pulled.quick else _POINTS
        )
        with shown.bar("borders", "velocities") as progress:
            borders = solve.border(
                pulled, velocities, critical=steady, progress=progress
            )
        origin = storage.provenance(
            "stability", file.settings, file.text, file.output.seed, path.parent
        )
        from eqsim.estimate import Estimate
        from eqsim.io.plots import caption

        said = caption(file, Estimate(None, None, 0), path.stem)
        names = _publish(out, found, borders, said, origin)
        notes.append(f"{out}/: {', '.join(names)}")
    shown.report(
        _summary(found), title=title, columns=_COLUMNS, rows=_rows(found), notes=notes
    )


def _velocities(velocity: float, points: int) -> list[float]:
    """Around the run's own, which is drawn besides."""
    return [
        velocity * 10.0 ** (_DECADES * (2.0 * i / (points - 1) - 1.0))
        for i in range(points)
    ]


def _publish(
    out: Path,
    found: "Stability",
    borders: dict[str, Any],
    said: "Caption",
    origin: dict[str, Any],
) -> list[str]:
    """Write what there is, and tell the names of the files."""
    from eqsim.io import storage
    from eqsim.io.plots import stability_figure
    from eqsim.io.style import pictures

    summary = {**_summary(found), "versions": storage.versions()}
    files = {"summary.json": storage.to_json(summary).encode()}
    files |= pictures("stability", stability_figure(found, borders, said))
    files["border.parquet"] = storage.parquet(borders, origin)
    storage.publish(out, files)
    return list(files)


def _summary(found: "Stability") -> dict[str, Any]:
    said = {
        "fresh_slips": found.fresh_slips,
        "fresh_verdict": found.fresh_verdict,
        "verdict": found.verdict,
    }
    return {**asdict(found), **said}


def _rows(found: "Stability") -> Iterator[tuple[str, str, str]]:
    """What is known of the first slip, of steady sliding, and of the run."""
    yield "stiffness", f"{found.stiffness:.6g}", "kappa_s = K/(N k) of this run"
    fresh = found.fresh
    yield (
        "fresh start, critical",
        _text(fresh.critical_stiffness),
        "kappa_s below which the slider jumps",
    )
    verdict = _FRESH[found.fresh_verdict]
    yield (
        "first slip",
        _text(fresh.slip_stiffness),
        f"kappa_s below which the jump is a slip; {verdict}",
    )
    if fresh.X.value is not None:
        yield "after X", _text(fresh.X), "where friction falls most steeply"
    yield (
        "peak / steady",
        _text(fresh.peak_ratio),
        "largest friction over steady friction",
    )
    yield (
        "steady sliding",
        found.verdict,
        "of this run" if found.verdict == "neutral" else f"by {found.method}",
    )
    if found.verdict == "neutral":
        return
    if found.critical_stiffness.value is not None:
        yield (
            "critical",
            _text(found.critical_stiffness),
            "kappa_s below which it is unstable",
        )
    if found.growth.value is not None:
        yield "growth rate", _text(found.growth), "of perturbations, 1/time"
    if found.period.value is not None:
        yield "period", _text(found.period), "of perturbations, time"


def _text(estimate: "Estimate") -> str:
    if estimate.value is not None and not abs(estimate.value) < float("inf"):
        return "infinite"
    if (
        estimate.value is not None
        and estimate.stderr is not None
        and estimate.stderr < 1e-7 * abs(estimate.value)
    ):
        return f"{estimate.value:.8g}"
    return terminal.value_and_error(estimate)


def _remarks(found: "Stability") -> Iterator[str]:
    """What needs to be said."""
    if found.verdict == "neutral":
        yield f"neutral: {found.method}"
    elif found.growth.value is None and found.verdict == "stable":
        yield "no rate: perturbations decay within a fraction of a cycle, or not exponentially"
    if found.critical_stiffness.value is None:
        yield "no critical stiffness of steady sliding: not asked for (--critical, minutes), or not found"
    if found.verdict == "undecided":
        yield "undecided: the rate is not known well enough to tell its sign"
