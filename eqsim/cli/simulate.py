"""Commands that compute one ensemble: run, steady, reference."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from eqsim.cli.options import (
    Changes,
    Formats,
    MaxLives,
    RunFilePath,
    Shown,
    Threads,
    complain,
    cores,
    pictured,
    results_folder,
)
from eqsim.errors import InputError, require_integer, require_number
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.estimate import Estimate
    from eqsim.io.runfile import RunFile
    from eqsim.io.units import Quantity, Row
    from eqsim.sweeps.workers import Workers
    from eqsim.workflows.elastic import ElasticResult
    from eqsim.workflows.run import ProgrammeResult, RunResult, SliderResult

_DASK = "Split the ensemble over a dask cluster, by its scheduler's address or file: the same bits."


@dataclass(frozen=True)
class Split:
    """Who simulates the contacts, if not threads of this process."""

    workers: Annotated[
        int | None,
        Option(help="Split the ensemble over so many processes: the same bits."),
    ] = None
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
    out: Annotated[
        Path | None,
        Option(help="Results folder. Default: out/NAME beside the run file."),
    ] = None,
    *,
    changes: Changes,
    threads: Threads = None,
    split: Split,
    max_lives: MaxLives = 1e10,
    format_: Formats = None,
    shown: Shown,
) -> None:
    """Simulate the ensemble contact by contact: friction force against displacement."""
    file = changes.load(path)
    from eqsim.io import storage

    require_number("--max-lives", max_lives, above=0)
    folder = results_folder(path, out)
    storage.check_folder(folder)
    count, workers, formats = cores(threads), split.chosen(), pictured(format_)
    from eqsim.workflows.run import run as simulate

    with shown.bar("simulating", "lives") as progress:
        result = simulate(
            file,
            threads=count,
            workers=workers,
            max_lives=max_lives,
            progress=progress,
        )
    files = result.files(path.stem, formats)
    storage.publish(folder, files)
    shown.doubt(result.ensemble, result.drive)
    shown.report(
        result.summary(),
        title=file.headline(folder.name),
        **_table(result),
        notes=[
            *_remarks(result, "workers" if workers else "threads"),
            f"{folder}/: {', '.join(files)}",
            *(
                [f"no exact curve: {reason}"]
                if (reason := getattr(result, "exact", (None, ""))[1])
                else []
            ),
        ],
    )


def _table(result: "RunResult | ProgrammeResult | ElasticResult") -> dict[str, Any]:
    """Columns and rows of what a run shows."""
    from eqsim.workflows.elastic import ElasticResult
    from eqsim.workflows.run import RunResult, SliderResult

    if isinstance(result, ElasticResult):
        return {"columns": _COUPLED, "rows": _coupled(result)}
    if isinstance(result, RunResult):
        rows = result.file.rows(result.trajectory.averages)
        return {
            "columns": (*_AVERAGES[:3], *_unit(rows), _AVERAGES[3]),
            "rows": _averages(result),
        }
    if isinstance(result, SliderResult):
        return {"columns": _SLIPS, "rows": _slips(result)}
    shown = result.file.preferred(result.trajectory.segments[0].peak)
    columns = _SEGMENTS
    if shown:
        unit = f" [{shown.unit}]" * bool(shown.unit)
        columns = (
            *_SEGMENTS[:3],
            f"{shown.symbol} then{unit}",
            "z",
            f"{shown.symbol} at its peak",
            _SEGMENTS[6],
        )
    return {"columns": columns, "rows": _segments(result, shown)}


_AVERAGES = ("", "this run", "expected", "z")
_SEGMENTS = ("", "velocity", "until t", "force then", "z", "peak", "after X or t")
_SLIPS = ("slip", "at t", "at X", "drop of the force", "takes", "over")
_CUT = "the record {} in the midst of {}: drop, time and distance (>) are those of what it shows"
_COUPLED = ("", "this run", "expected", "z")
_MOST_ROWS = 40
_FEW_CUT = 8  # slips that are named in a remark
_SHOWN = 10  # parts of a curve at whose ends it is shown


def _segments(
    result: "ProgrammeResult", shown: "Quantity | None"
) -> Iterator[tuple[str, ...]]:
    """What each segment shows, forces as a quantity of the interface, if there is one;
    z is the difference of the force at its end from the exact mean in standard errors.
    """
    from eqsim.estimate import difference

    exact, found = result.exact_segments, result.trajectory.segments
    for index, segment in enumerate(found):
        if index < _MOST_ROWS:
            z = (
                terminal.score(difference(segment.end, exact[index].end))
                if exact
                else "none"
            )
            velocity = "hold" if segment.velocity == 0 else f"{segment.velocity:.6g}"
            end, peak = (
                (shown.of(one) if shown else one) for one in (segment.end, segment.peak)
            )
            yield (
                str(index), velocity, f"{segment.t:.6g}", terminal.value_and_error(end), z,
                terminal.value_and_error(peak), terminal.value_and_error(segment.at),
            )  # fmt: skip
    if len(found) > _MOST_ROWS:
        yield ("...", *[""] * (len(_SEGMENTS) - 1))


def _slips(result: "SliderResult") -> Iterator[tuple[str, ...]]:
    """Each slip, and means of all but the first."""
    found = result.trajectory
    for index, slip in enumerate(found.slips[:_MOST_ROWS]):
        least = "" if slip.begun and slip.ended else "> "
        sizes = (
            slip.drop,
            slip.duration,
            abs(slip.distance) if least else slip.distance,
        )
        places = (f"{number:.6g}" for number in (slip.t, slip.X))
        yield str(index), *places, *(f"{least}{number:.6g}" for number in sizes)
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

    names = {
        "friction": "friction over X",
        "size": "breaks per avalanche",
        "single": "fraction of single breaks",
    }
    for name, (found, exact) in result.averages().items():
        known = "none" if exact.value is None else terminal.value_and_error(exact)
        z = "none" if exact.value is None else terminal.score(difference(found, exact))
        yield names[name], terminal.value_and_error(found), known, z


def _unit(rows: "list[tuple[str, Row]]") -> tuple[str, ...]:
    """The column of units, if the rows have one."""
    return ("unit",) * any(row.unit for _, row in rows)


def _averages(result: "RunResult") -> Iterator[tuple[str, ...]]:
    from eqsim.estimate import difference
    from eqsim.io.units import Row

    steady = result.steady.averages()
    averages = result.trajectory.averages
    for name, row in result.file.rows(averages):
        estimate = getattr(averages, name)
        without = estimate.value is None or estimate.diverges
        z = "none" if without else terminal.score(difference(estimate, steady[name]))
        both = (
            terminal.value_and_error(row.of(one)) for one in (estimate, steady[name])
        )
        yield row.label, *both, *row.unit, z
    if result.peak is None:
        return
    quantity = result.file.preferred(result.peak.force)
    length = result.file.rows(averages)[0][1].unit
    forces = (
        Row("peak_force", (quantity.unit,), quantity)
        if quantity
        else Row("peak_force", length)
    )
    for name, row in (("force", forces), ("X", Row("peak_X", length))):
        estimate, exact = (
            getattr(result.peak, name),
            getattr(result.exact_peak, name, None),
        )
        known = "none" if exact is None else terminal.value_and_error(row.of(exact))
        z = (
            "none"
            if exact is None or estimate.value is None
            else terminal.score(difference(estimate, exact))
        )
        yield row.label, terminal.value_and_error(row.of(estimate)), known, *row.unit, z


def _remarks(
    result: "RunResult | ProgrammeResult | ElasticResult", who: str
) -> Iterator[str]:
    from eqsim.workflows.elastic import ElasticResult

    if isinstance(result, ElasticResult):
        yield from _remarks_on_blocks(result)
        return
    found, contacts = (
        result.trajectory,
        result.ensemble.count * result.file.output.replicas,
    )
    averages = getattr(found, "averages", None)
    if averages and result.ensemble.divergence:
        yield result.ensemble.divergence
    if averages and not all(
        estimate.reliable
        for estimate in averages.averages().values()
        if not estimate.diverges
    ):
        yield "unreliable: the steady state was not reached before the second half, or too few contacts broke in it"
    for index, segment in enumerate(getattr(found, "segments", ())[:_MOST_ROWS]):
        if segment.step:
            shown = (
                (name, getattr(segment.step, name))
                for name in ("direct", "evolution", "memory")
            )
            effects = ", ".join(
                f"{name} {terminal.value_and_error(estimate)}"
                for name, estimate in shown
            )
            yield f"velocity step of segment {index}, effects per ln v and length: {effects}"
    if getattr(result, "peak", None):
        yield "averages: over the second half of the run; peak: the first maximum of the force after the start"
    slips = getattr(found, "slips", None)
    if slips is not None:
        yield f"{len(slips)} slips" if slips else "no slip in this run"
        for verb, whole in (("begins", "begun"), ("ends", "ended")):
            cut = [
                str(index)
                for index, slip in enumerate(slips)
                if not getattr(slip, whole)
            ]
            if cut:
                named = ", ".join(cut[:_FEW_CUT]) + ", ..." * (len(cut) > _FEW_CUT)
                yield _CUT.format(verb, f"slip{'s' * (len(cut) > 1)} {named}")
        if not found.force_reliable:
            yield "force_stderr: that of contacts at this X; how far X differs between ensembles takes 8 replicas"
    elif not found.force_reliable:
        yield "force_stderr: not to be trusted, forces this heavy-tailed need more contacts"
    lives = terminal.lives(
        found.lives, found.engine_seconds, f" of {terminal.count(contacts)} contacts"
    )
    yield f"{lives}, {found.threads} {who}, seed {found.seed}"


def _remarks_on_blocks(result: "ElasticResult") -> Iterator[str]:
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
    yield "exact: friction of any contacts, avalanches of infinitely many; errors: what n contacts a block may change"
    contacts = f" of {terminal.count(result.ensemble.count * result.file.output.replicas)} contacts"
    lives = terminal.lives(found.lives, found.engine_seconds, contacts)
    yield f"{lives}, {found.threads} threads, seed {found.seed}"


def steady(
    path: RunFilePath,
    rel_error: Annotated[
        float, Option(help="Relative standard error of all observables.")
    ] = 1e-3,
    *,
    changes: Changes,
    threads: Threads = None,
    max_lives: MaxLives = 1e10,
    shown: Shown,
) -> None:
    """Steady friction, pinned fraction and stretch at breaking, to a requested relative
    error."""
    file = changes.load(path)
    ensemble, drive, count = (
        file.ensemble,
        file.constant_drive,
        cores(threads),
    )
    from eqsim.engine.steady import steady as estimate_steady
    from eqsim.master.steady import reference as solve
    from eqsim.workflows.run import if_any

    with shown.bar("simulating", "lives") as progress:
        result = estimate_steady(
            ensemble, drive, rel_error=rel_error, seed=file.output.seed, threads=count, max_lives=max_lives,
            progress=terminal.announcing(progress, shown.note),
        )  # fmt: skip
    shown.doubt(ensemble)
    if not result.reached and not shown.quiet:
        complain(f"relative error {rel_error:g} was not reached")
    exact, reason = if_any(
        lambda: solve(ensemble, drive, variance=result.force_variance.value is not None)
    )
    found, levels = result.averages(), exact.averages() if exact else {}
    values = {name: levels[name].value if exact else None for name in found}
    z, rows = _scores(found, levels), file.rows(result)
    shown.report(
        {
            **{name: estimate.as_dict() for name, estimate in found.items()},
            **{"lives": result.lives, "seed": result.seed, "reached": result.reached},
            **({"divergence": ensemble.divergence} if ensemble.divergence else {}),
            **{"reference": values, "z": {name: z.get(name) for name in found}},
            **file.physical(result.friction, values["friction"]),
        },
        title=file.headline(path.stem),
        columns=("", "contacts", *_unit(rows), "relative error", "reference", "z"),
        rows=[
            (row.label, terminal.value_and_error(row.of(found[name])), *row.unit,
             terminal.relative_error(found[name]), row.exact(levels.get(name), ".9g"),
             "none" if values[name] is None or found[name].diverges else terminal.score(z.get(name)))
            for name, row in rows
        ],
        notes=[
            *([f"no reference: {reason}"] if reason else []),
            *filter(None, [ensemble.divergence]),
            f"{terminal.lives(result.lives, result.engine_seconds)}, seed {result.seed}",
        ],
    )  # fmt: skip


def _scores(
    found: "dict[str, Estimate]", exact: "dict[str, Estimate]"
) -> dict[str, float | None]:
    """z of each estimate that has an exact value."""
    from eqsim.estimate import z_score

    return {
        name: None
        if level.value is None
        else z_score(found[name], level.value, level.stderr or 0.0)
        for name, level in exact.items()
    }


_CURVE_FOLDER = "Folder for table and picture of --transient or --closure. Default: out/NAME beside the run file."


def reference(
    path: RunFilePath,
    transient: Annotated[
        bool, Option("--transient", help="F(X) and pinned(X) from the run's start.")
    ] = False,
    closure: Annotated[
        bool,
        Option(
            "--closure",
            help="F(X) of annealed contacts whose pool of thresholds ages from newborn.",
        ),
    ] = False,
    out: Annotated[Path | None, Option(help=_CURVE_FOLDER)] = None,
    *,
    changes: Changes,
    threads: Threads = None,
    format_: Formats = None,
    shown: Shown,
) -> None:
    """Exact averages from the master equation, without random numbers."""
    if transient and closure:
        raise InputError("--transient, --closure: only one of them")
    for option, given in (("--out", out), ("--format", format_)):
        if given and not (transient or closure):
            raise InputError(
                f"{option}: is for the table and the picture of --transient or --closure"
            )
    file = changes.load(path)
    cores(threads)
    if transient or closure:
        _curve(path, file, closure, out, pictured(format_), shown)
        return
    ensemble = file.ensemble
    from eqsim.master.steady import reference as solve

    result = solve(ensemble, file.constant_drive, variance=shown.json)
    shown.doubt(ensemble)
    found, rows = {**result.averages(), "f_k": result.f_k}, file.rows(result)
    errors = {name: estimate.stderr for name, estimate in found.items()}
    shown.report(
        {
            **{name: estimate.value for name, estimate in found.items()},
            **{"error": errors, "method": result.method},
            **({"divergence": ensemble.divergence} if ensemble.divergence else {}),
            **file.physical(result.friction),
        },
        title=file.headline(path.stem),
        columns=("", "value", *_unit(rows), "error"),
        rows=[
            (
                row.label,
                row.exact(found[name], ".10g"),
                *row.unit,
                f"{row.of(found[name]).stderr or 0.0:.1e}",
            )
            for name, row in [*rows, ("f_k", rows[0][1]._replace(label="f_k"))]
        ],
        notes=[
            f"method: {result.method}",
            "error: bound of the solver's; f_k: F/(N_c k), friction per pinned contact",
            *filter(None, [ensemble.divergence]),
        ],
    )


def _curve(
    path: Path,
    file: "RunFile",
    closure: bool,
    out: Path | None,
    formats: tuple[str, ...],
    shown: Shown,
) -> None:
    """An exact curve as a table and a picture in a folder, unless only JSON is wanted,
    and some of its rows."""
    from eqsim.io import storage
    from eqsim.io.plots import curve_picture
    from eqsim.io.style import pictures
    from eqsim.workflows.curve import curve

    folder = None if shown.json and out is None else results_folder(path, out)
    if folder is not None:
        storage.check_folder(folder)
    columns, notes = curve(file, closure=closure), []
    if folder is not None:
        name = "closure" if closure else "transient"
        origin = storage.provenance(
            "reference", file.settings, file.text, file.output.seed, path.parent
        )
        files = {f"{name}.parquet": storage.parquet(columns, origin)}
        files |= pictures(name, curve_picture(file, path.stem, columns), formats)
        storage.publish(folder, files)
        said = f"{folder}/: {', '.join(files)}, {len(columns['X'])} rows"
        notes = ["columns end in _error: bound of the solver's", said]
    wanted = [
        name
        for name in (
            "t",
            "X",
            "stage",
            "force",
            "force_error",
            "pinned",
            "pinned_error",
        )
        if name in columns
    ]
    last = len(columns["X"]) - 1
    some = sorted({round(last * part / _SHOWN) for part in range(_SHOWN + 1)})
    title = file.title or path.stem
    rows = [
        tuple(
            f"{columns[name][row]:{'.1e' if name.endswith('_error') else '.8g'}}"
            for name in wanted
        )
        for row in some
    ]
    shown.report(columns, title=title, columns=wanted, rows=rows, notes=notes)
