"""Commands that compute one ensemble: run, steady, reference."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from eqsim.cli.options import Changes, MaxLives, RunFilePath, Shown, Threads, complain, cores
from eqsim.errors import InputError, require_integer, require_number
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.sweeps.workers import Workers
    from eqsim.workflows.elastic import ElasticResult
    from eqsim.workflows.run import ProgrammeResult, RunResult, SliderResult

_DASK = "Split the ensemble over a dask cluster, by its scheduler's address or file: the same bits."


@dataclass(frozen=True)
class Split:
    """Who simulates the contacts, if not threads of this process."""

    workers: Annotated[int | None, Option(help="Split the ensemble over so many processes: the same bits.")] = None
    dask: Annotated[str | None, Option(metavar="ADDRESS", help=_DASK)] = None

    def chosen(self) -> "Workers | None":
        if self.workers is not None and self.dask is not None:
            raise InputError("--workers, --dask: only one of them")
        if self.workers is not None:
            require_integer("--workers", self.workers, 1, 1024)
        elif self.dask is None:
            return None
        from eqsim.sweeps.workers import Workers

        return Workers(self.workers or 1, dask=self.dask)


def run(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help="Results folder. Default: out/NAME beside the run file.")] = None,
    *,
    changes: Changes,
    threads: Threads = None,
    split: Split,
    max_lives: MaxLives = 1e10,
    shown: Shown,
) -> None:
    """Simulate the ensemble contact by contact: friction force against displacement."""
    file = changes.load(path)
    from eqsim.io import storage

    require_number("--max-lives", max_lives, above=0)
    if out is None and not path.is_file():
        raise InputError(f"--out: is required, because {path} is not a file with a folder of its own")
    folder = out or path.parent / "out" / path.stem
    storage.check_folder(folder)
    count, workers = cores(threads), split.chosen()
    from eqsim.workflows.run import run as simulate

    with shown.bar("simulating", "lives") as progress:
        result = simulate(file, path.parent, threads=count, workers=workers, max_lives=max_lives, progress=progress)
    storage.publish(folder, result.files(path.stem))
    shown.report(
        result.summary(),
        title=file.title or folder.name,
        **_table(result),
        notes=_remarks(result, folder, "workers" if workers else "threads"),
    )


def _table(result: "RunResult | ProgrammeResult | ElasticResult") -> dict[str, Any]:
    """Columns and rows of what a run shows."""
    from eqsim.workflows.elastic import ElasticResult
    from eqsim.workflows.run import RunResult, SliderResult

    if isinstance(result, ElasticResult):
        return {"columns": _COUPLED, "rows": _coupled(result)}
    if isinstance(result, RunResult):
        return {"columns": _AVERAGES, "rows": _averages(result)}
    if isinstance(result, SliderResult):
        return {"columns": _SLIPS, "rows": _slips(result)}
    return {"columns": _SEGMENTS, "rows": _segments(result)}


_AVERAGES = ("", "second half of the run", "steady value", "difference / s.e.")
_SEGMENTS = ("", "velocity", "until t", "force then", "z", "peak", "after X or t")
_SLIPS = ("slip", "at t", "at X", "drop of the force", "takes", "over")
_COUPLED = ("", "second half of the run", "exact", "difference / s.e.")
_MOST_ROWS = 40


def _segments(result: "ProgrammeResult") -> Iterator[tuple[str, ...]]:
    """What each segment shows; z is the difference of the force at its end from the exact mean in standard errors."""
    from eqsim.estimate import difference

    exact, found = result.exact_segments, result.trajectory.segments
    for index, segment in enumerate(found):
        if index < _MOST_ROWS:
            z = terminal.score(difference(segment.end, exact[index].end)) if exact else "none"
            velocity = "hold" if segment.velocity == 0 else f"{segment.velocity:.6g}"
            yield (
                str(index), velocity, f"{segment.t:.6g}", terminal.value_and_error(segment.end), z,
                terminal.value_and_error(segment.peak), terminal.value_and_error(segment.at),
            )  # fmt: skip
    if len(found) > _MOST_ROWS:
        yield ("...", *[""] * (len(_SEGMENTS) - 1))


def _slips(result: "SliderResult") -> Iterator[tuple[str, ...]]:
    """Each slip, and means of all but the first."""
    found = result.trajectory
    for index, slip in enumerate(found.slips[:_MOST_ROWS]):
        numbers = slip.t, slip.X, slip.drop, slip.duration, slip.distance
        yield str(index), *(f"{number:.6g}" for number in numbers)
    if len(found.slips) > _MOST_ROWS:
        yield "...", *[""] * (len(_SLIPS) - 1)
    if found.period.value is not None:
        yield (
            "mean",
            "every " + terminal.value_and_error(found.period),
            "",
            terminal.value_and_error(found.drop),
            "",
            "",
        )


def _coupled(result: "ElasticResult") -> Iterator[tuple[str, ...]]:
    """Friction and avalanches of coupled blocks beside what is exact."""
    from eqsim.estimate import difference

    names = {"friction": "friction over X", "size": "breaks per avalanche", "single": "fraction of single breaks"}
    for name, (found, exact) in result.averages().items():
        z = terminal.score(difference(found, exact))
        yield names[name], terminal.value_and_error(found), f"{exact.value:.8g}", z


def _averages(result: "RunResult") -> Iterator[tuple[str, ...]]:
    from eqsim.estimate import difference

    steady = result.steady.averages()
    averages = result.trajectory.averages
    for name in averages.shown:
        estimate = getattr(averages, name)
        z = "none" if estimate.value is None else terminal.score(difference(estimate, steady[name]))
        yield name, terminal.value_and_error(estimate), terminal.value_and_error(steady[name]), z


def _remarks(result: "RunResult | ProgrammeResult | ElasticResult", folder: Path, who: str) -> Iterator[str]:
    from eqsim.workflows.elastic import ElasticResult

    if isinstance(result, ElasticResult):
        yield from _remarks_on_blocks(result, folder)
        return
    found, contacts = result.trajectory, result.ensemble.count * result.file.output.replicas
    averages = getattr(found, "averages", None)
    if averages and not all(estimate.reliable for estimate in averages.averages().values()):
        yield "unreliable: the steady state was not reached before the second half, or too few contacts broke in it"
    for index, segment in enumerate(getattr(found, "segments", ())[:_MOST_ROWS]):
        if segment.step:
            shown = ((name, getattr(segment.step, name)) for name in ("direct", "evolution", "memory"))
            effects = ", ".join(f"{name} {terminal.value_and_error(estimate)}" for name, estimate in shown)
            yield f"velocity step of segment {index}, effects per ln v and length: {effects}"
    slips = getattr(found, "slips", None)
    if slips is not None:
        yield f"{len(slips)} slips" + ("" if slips else ": the slider follows the stage")
        if not found.force_reliable:
            yield "force_stderr: that of contacts at this X; how far X differs between ensembles takes 8 replicas"
    elif not found.force_reliable:
        yield "force_stderr: not to be trusted, forces this heavy-tailed need more contacts"
    lives = terminal.lives(found.lives, found.engine_seconds, f" of {terminal.count(contacts)} contacts")
    yield f"{lives}, {found.threads} {who}, seed {found.seed}"
    asked = {"avalanches": getattr(found, "avalanches", None), **result.file.output.model_dump()}
    tables = {"avalanches": "avalanches.parquet", "series": "replicas.parquet", "breaks": "breaks.parquet"}
    files = [*result.names, *(file for name, file in tables.items() if asked[name])]
    yield f"{folder}/: {', '.join(files)}"
    _, reason = result.exact
    if reason:
        yield f"no exact curve: {reason}"


def _remarks_on_blocks(result: "ElasticResult", folder: Path) -> Iterator[str]:
    found, elastic = result.trajectory, result.drive.elastic
    assert elastic
    breaks, blocks = found.avalanches["breaks"], found.avalanches["blocks"]
    if not found.friction.reliable:
        yield "unreliable: the second half is too short to forget the fresh start, or to tell its errors"
    if breaks.size:
        yield (
            f"{breaks.size} avalanches, the largest of {breaks.max()} breaks; "
            f"{blocks.mean():.3g} of {elastic.count} blocks take part in the mean, {blocks.max()} at most"
        )
    yield "exact: friction of any contacts, avalanches of infinitely many; n contacts to a block miss them by some 1/n"
    contacts = f" of {terminal.count(result.ensemble.count * result.file.output.replicas)} contacts"
    lives = terminal.lives(found.lives, found.engine_seconds, contacts)
    yield f"{lives}, {found.threads} threads, seed {found.seed}"
    yield f"{folder}/: {', '.join(result.names)}"


def steady(
    path: RunFilePath,
    rel_error: Annotated[float, Option(help="Relative standard error of all observables.")] = 1e-3,
    *,
    changes: Changes,
    threads: Threads = None,
    max_lives: MaxLives = 1e10,
    shown: Shown,
) -> None:
    """Steady friction, pinned fraction and stretch at breaking, to a requested relative error."""
    file = changes.load(path)
    ensemble, drive, count = file.ensemble(path.parent), file.constant(path.parent), cores(threads)
    from eqsim.engine.steady import steady as estimate_steady
    from eqsim.estimate import z_score
    from eqsim.master.steady import reference as solve
    from eqsim.workflows.run import if_any

    with shown.bar("simulating", "lives") as progress:
        result = estimate_steady(
            ensemble, drive, rel_error=rel_error, seed=file.output.seed, threads=count, max_lives=max_lives,
            progress=terminal.announcing(progress, shown.note),
        )  # fmt: skip
    if not result.reached and not shown.quiet:
        complain(f"relative error {rel_error:g} was not reached")
    exact, reason = if_any(lambda: solve(ensemble, drive))
    found, levels = result.averages(), exact.averages() if exact else {}
    values = {name: levels[name].value if exact else None for name in found}
    z = {
        name: None if level.value is None else z_score(found[name], level.value, level.stderr or 0.0)
        for name, level in levels.items()
    }
    shown.report(
        {
            **{name: estimate.as_dict() for name, estimate in found.items()},
            **{"lives": result.lives, "seed": result.seed, "reached": result.reached},
            **{"reference": values, "z": {name: z.get(name) for name in found}},
        },
        title=file.title or path.stem,
        columns=("", "contacts", "relative error", "reference", "z"),
        rows=[
            (name, terminal.value_and_error(found[name]), terminal.relative_error(found[name]),
             "none" if values[name] is None else f"{values[name]:.9g}", terminal.score(z.get(name)))
            for name in result.shown
        ],
        notes=[
            *([f"no reference: {reason}"] if reason else []),
            f"{terminal.lives(result.lives, result.engine_seconds)}, seed {result.seed}",
        ],
    )  # fmt: skip


def reference(
    path: RunFilePath,
    transient: Annotated[bool, Option("--transient", help="F(X) and pinned(X) from the run's start.")] = False,
    closure: Annotated[
        bool, Option("--closure", help="F(X) of annealed contacts whose pool of thresholds ages from newborn.")
    ] = False,
    *,
    changes: Changes,
    threads: Threads = None,
    shown: Shown,
) -> None:
    """Exact averages from the master equation, without random numbers."""
    if transient and closure:
        raise InputError("--transient, --closure: only one of them")
    file = changes.load(path)
    cores(threads)
    ensemble = file.ensemble(path.parent)
    if transient or closure:
        from eqsim.master.closure import closure as solve_closure
        from eqsim.master.transient import transient as solve_transient

        points = file.output.points
        curve: Any
        if closure:
            curve = solve_closure(ensemble, file.constant(path.parent), points)
        else:
            curve = solve_transient(ensemble, file.driven(path.parent), points)
        every = {field.name: getattr(curve, field.name) for field in fields(curve)}
        columns = {name: column for name, column in every.items() if column is not None}
        shown.report(columns, notes=_tab_separated(columns))
        return
    from eqsim.master.steady import reference as solve

    result = solve(ensemble, file.constant(path.parent), variance=shown.json)
    found = {**result.averages(), "f_k": result.f_k}
    errors = {name: estimate.stderr for name, estimate in found.items()}
    shown.report(
        {**{name: estimate.value for name, estimate in found.items()}, "error": errors, "method": result.method},
        title=file.title or path.stem,
        columns=("", "value", "error of the solver"),
        rows=[(name, f"{found[name].value:.10g}", f"{errors[name]:.1e}") for name in (*result.shown, "f_k")],
        notes=[f"method: {result.method}"],
    )


def _tab_separated(columns: dict[str, Any]) -> Iterator[str]:
    yield "\t".join(columns)
    for row in zip(*columns.values(), strict=True):
        yield "\t".join(f"{number:.10g}" for number in row)
