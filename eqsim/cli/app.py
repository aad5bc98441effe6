"""The command line: arguments and what is printed."""

import dataclasses
import io
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, cast

import typer
from typer.core import TyperGroup

from eqsim.io import signals, terminal
from eqsim.errors import InputError, require_choice, require_integer, require_number, shown, under

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from eqsim.engine.steady import Steady
    from eqsim.model.ensemble import Disorder
    from eqsim.io.runfile import RunFile


class _Commands(TyperGroup):
    """Turns what a user can cause into one line and an exit code: 2 for bad input, 130 for Ctrl-C, 143 for SIGTERM."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        try:
            code = super().main(*args, **{**kwargs, "prog_name": "eqsim", "standalone_mode": False})
        except cast(type[typer.BadParameter], typer.BadParameter.__base__) as error:  # any error of usage
            said = error.format_message().removesuffix(".")
            for problem in getattr(error.__cause__, "errors", list)():  # typer's, which do not tell the value
                said = said.replace("Input should be", f"{shown(problem['input'])} must be")
            code = _say(f"{said}; see `{error.ctx.command_path if error.ctx else 'eqsim'} --help`", 2)
        except SystemExit as error:  # rich's, if the reader has left
            if not isinstance(error.__context__, BrokenPipeError):
                raise
            code = 0
        except OSError as error:
            code = _say(f"{error.filename or 'file system'}: {error.strerror or error}", 2)
        sys.exit(code)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            _fail(_as_typed(str(error)), 2)
        except MemoryError:
            _fail("not enough memory; fewer output.points need less", 2)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has left; nothing to say
        except KeyboardInterrupt:
            _fail(signals.WHOLE, signals.heard())


app = typer.Typer(
    cls=_Commands,
    help="Stochastic earthquake-model simulator of multi-contact friction.",
    add_completion=False,
    pretty_exceptions_enable=False,
)

Path_ = Annotated[Path, typer.Argument(metavar="RUN.toml", help="Run file.", show_default=False)]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the run file, as section.key=value; repeatable."),
]
Seed = Annotated[int | None, typer.Option(help="Random seed, instead of the run file's.", show_default=False)]
Threads = Annotated[
    int | None,
    typer.Option(help="Threads: speed only, never a number. Default: all cores.", show_default=False),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
MaxLives = Annotated[float, typer.Option(help="Refuse work that needs more lives than this.", show_default="1e10")]


def _say(message: str, code: int) -> int:
    print("eqsim: " + " ".join(message.split()), file=sys.stderr)
    return code


def _as_typed(message: str) -> str:
    """Arguments of functions by the options they come from."""
    names = r"(?<![\w.-])(rel_error|max_lives|temperature|velocity)(?= (= |was ))"
    return re.sub(names, lambda found: "--" + found[1].replace("_", "-"), message)


def _fail(message: str, code: int) -> NoReturn:
    raise typer.Exit(_say(message, code))


@app.command()
def run(
    path: Path_,
    out: Annotated[
        Path | None,
        typer.Option(help="Results folder. Default: out/NAME beside the run file.", show_default=False),
    ] = None,
    set_: Set = None,
    seed: Seed = None,
    threads: Threads = None,
    workers: Annotated[
        int | None, typer.Option(help="Split the ensemble over so many processes: the same bits.", show_default=False)
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            show_default=False,
            help="Split the ensemble over a dask cluster, by its scheduler's address or file: the same bits.",
        ),
    ] = None,
    max_lives: MaxLives = 1e10,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate the ensemble contact by contact: friction force against displacement."""
    file, text = _load(path, set_, seed)
    from eqsim.io import storage

    require_number("--max-lives", max_lives, above=0)
    if out is None and not path.is_file():
        raise InputError(f"--out: is required, because {path} is not a file with a folder of its own")
    folder = out or path.parent / "out" / path.stem
    storage.check_folder(folder)
    ensemble, drive = file.ensemble(path.parent), file.driven()
    cores = _threads(threads)
    from eqsim.engine.steady import steady
    from eqsim.engine.trajectory import check_run, trajectory

    output = file.output
    expected = check_run(ensemble, drive, output.points, output.seed, output.replicas, max_lives)
    bar = terminal.bar("simulating", quiet or json, "lives", expected)
    with _executor(workers, dask, cores) as (executor, many), bar as progress:
        rough = 5e-3 if ensemble.fluctuates else 1e-3
        level = steady(ensemble, drive.velocity, rel_error=rough, seed=output.seed, threads=cores, max_lives=max_lives)
        result = trajectory(
            ensemble, drive, points=output.points, seed=output.seed, replicas=output.replicas, threads=many,
            max_lives=max_lives, progress=progress, executor=executor,
        )  # fmt: skip
    origin = storage.provenance("run", file.model_dump(), text, output.seed, path.parent)
    averages = {"friction": result.friction, "pinned": result.pinned_fraction, "break_stretch": result.break_stretch}
    summary = {
        "title": file.title,
        **{name: estimate.as_dict() for name, estimate in averages.items()},
        "force_reliable": result.force_reliable,
        "steady": {name: getattr(level, name).as_dict() for name in averages},
        "lives": result.lives,
        "engine_seconds": result.engine_seconds,
        "threads": result.threads,
        "seed": result.seed,
        "versions": storage.versions(),
    }
    from eqsim.master.transient import expected as exact_run
    from eqsim.io.plots import trajectory_png

    exact, reason = _if_any(lambda: exact_run(ensemble, drive, output.points))
    storage.publish(
        folder,
        {
            "trajectory.parquet": storage.parquet(result.columns(), origin),
            "summary.json": storage.to_json(summary).encode(),
            "force.png": trajectory_png(result, level, exact, _plain(file.title or path.stem)),
        },
    )
    if json:
        print(storage.to_json(summary))
    elif not quiet:
        _print_run(file, ensemble, averages, level, result, folder, "workers" if executor else "threads")
        if reason:
            print(f"no exact curve: {reason}")


@app.command()
def steady(
    path: Path_,
    rel_error: Annotated[float, typer.Option(help="Relative standard error of all three observables.")] = 1e-3,
    set_: Set = None,
    seed: Seed = None,
    threads: Threads = None,
    max_lives: MaxLives = 1e10,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Steady friction, pinned fraction and stretch at breaking, to a requested relative error."""
    file, _ = _load(path, set_, seed)
    ensemble, drive = file.ensemble(path.parent), file.driven()
    cores = _threads(threads)
    from eqsim.io import storage
    from eqsim.engine.steady import steady as estimate_steady

    with terminal.bar("simulating", quiet or json, "lives") as progress:
        result = estimate_steady(
            ensemble, drive.velocity, rel_error=rel_error, seed=file.output.seed, threads=cores, max_lives=max_lives,
            progress=terminal.foretold(progress, (lambda _: None) if quiet or json else print),
        )  # fmt: skip
    if not result.reached and not quiet:
        print(f"eqsim: relative error {rel_error:g} was not reached", file=sys.stderr)
    from eqsim.estimate import OBSERVABLES, z_score
    from eqsim.master.steady import reference as solve

    exact, reason = _if_any(lambda: solve(ensemble, drive.velocity))
    rows = {name: (getattr(result, name), getattr(exact, name, None)) for name in OBSERVABLES}
    z = {name: known and z_score(found, known.value, known.stderr) for name, (found, known) in rows.items()}
    if json:
        out = {name: found.as_dict() for name, (found, _) in rows.items()}
        values = {name: known and known.value for name, (_, known) in rows.items()}
        more = {"lives": result.lives, "seed": result.seed, "reached": result.reached, "reference": values, "z": z}
        print(storage.to_json({**out, **more}))
    elif not quiet:
        table = terminal.table("", "particles", "relative error", "reference", "z")
        for name, (found, known) in rows.items():
            value = f"{known.value:.9g}" if known else "none"
            both = terminal.value_and_error(found), terminal.relative_error(found)
            table.add_row(name, *both, value, terminal.scores(z[name]))
        terminal.show(file.title or path.stem, table)
        if reason:
            print(f"no reference: {reason}")
        speed = result.lives / max(result.engine_seconds, 1e-9)
        print(
            f"{terminal.many(result.lives)} lives in {result.engine_seconds:.2f} s ({terminal.many(speed)}/s), "
            f"seed {result.seed}"
        )


@app.command()
def reference(
    path: Path_,
    transient: Annotated[bool, typer.Option("--transient", help="F(X) and pinned(X) from the run's start.")] = False,
    closure: Annotated[
        bool, typer.Option("--closure", help="F(X) of annealed contacts whose pool of thresholds ages from newborn.")
    ] = False,
    set_: Set = None,
    seed: Seed = None,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Exact averages from the master equation, without random numbers."""
    if transient and closure:
        raise InputError("--transient, --closure: only one of them")
    file, _ = _load(path, set_, seed)
    _threads(threads)
    ensemble, drive = file.ensemble(path.parent), file.driven()
    from eqsim.io import storage
    from eqsim.estimate import OBSERVABLES
    from eqsim.master.steady import reference as solve

    if transient or closure:
        from eqsim.master.closure import closure as solve_closure
        from eqsim.master.transient import expected

        curve = (solve_closure if closure else expected)(ensemble, drive, file.output.points)
        columns = {field.name: getattr(curve, field.name) for field in dataclasses.fields(curve)}
        if json:
            print(storage.to_json({name: column.tolist() for name, column in columns.items()}))
        elif not quiet:
            print(*columns, sep="\t")
            for row in zip(*columns.values(), strict=True):
                print(*(f"{number:.10g}" for number in row), sep="\t")
        return
    result = solve(ensemble, drive.velocity)
    found = {name: getattr(result, name) for name in (*OBSERVABLES, "f_k")}
    if json:
        errors = {name: estimate.stderr for name, estimate in found.items()}
        values = {name: estimate.value for name, estimate in found.items()}
        print(storage.to_json({**values, "error": errors, "method": result.method}))
    elif not quiet:
        table = terminal.table("", "value", "error of the solver")
        for name, estimate in found.items():
            table.add_row(name, f"{estimate.value:.10g}", f"{estimate.stderr:.1e}")
        terminal.show(file.title or path.stem, table)
        print(f"method: {result.method}")


@app.command()
def validate(
    suite: Annotated[str, typer.Argument(help='"quick" (seconds) or "full" (minutes).')] = "quick",
    out: Annotated[Path, typer.Option(help="Folder for the table of scores and the picture.")] = Path(
        "runs/out/validation"
    ),
    seed: Annotated[int, typer.Option(help="Random seed: other parameter points, other lives.")] = 1,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Particles against the master equation over the parameter space; exit code 1 if they disagree."""
    require_integer("--seed", seed, 0, 2**63 - 1)
    cores = _threads(threads)
    from eqsim.io import storage
    from eqsim.validation.suite import ALARM, REASONS, columns, law_text, left_out
    from eqsim.validation.suite import validate as run_suite

    storage.check_folder(out)
    with terminal.bar("validating", quiet or json, "points") as progress:
        result = run_suite(suite, seed=seed, threads=cores, progress=progress)
    from eqsim.io.plots import validation_png

    origin = storage.provenance("validate", {"suite": suite}, "", seed)
    left = left_out(result.unscored)
    summary = {
        "suite": suite,
        "seed": seed,
        "passed": result.passed,
        "verdicts": [dataclasses.asdict(verdict) for verdict in result.verdicts],
        "declined": result.declined,
        "left_out": left,
        "refused": sorted({(law_text(one.ensemble.thresholds), one.message) for one in result.unscored if one.message}),
        "versions": storage.versions(),
    }
    table = storage.parquet(columns(result.scores), origin)
    files = {"scores.parquet": table, "validation.png": validation_png(result)}
    storage.publish(out, {**files, "summary.json": storage.to_json(summary).encode()})
    if json:
        print(storage.to_json(summary))
    elif not quiet:
        shown = terminal.table("kind", "scores", "chi-square", "p", "largest |z|", "p (of so many)", "verdict")
        for v in result.verdicts:
            numbers = (
                str(v.count),
                f"{v.chi_square:.1f}/{v.even}",
                f"{v.p_chi_square:.2g}",
                f"{v.largest:.2f}",
                f"{v.p_largest:.2g}",
            )
            shown.add_row(v.kind, *numbers, "passed" if v.passed and v.kind not in result.declined else "FAILED")
        terminal.show(f"suite {suite}: {len(result.scores)} comparisons, each p must exceed {ALARM:g}", shown)
        reasons = [f"{sum(of.get(reason, 0) for of in left.values())} {reason}" for reason in REASONS]
        print("left out: " + ", ".join(reasons))
        print(f"{out}/: scores.parquet, summary.json, validation.png")
    if not result.passed:
        raise typer.Exit(1)


@app.command()
def sweep(
    path: Path_,
    out: Annotated[Path, typer.Option(help="Folder of the dataset; the same command continues it.")],
    rel_error: Annotated[float, typer.Option(help="Relative standard error of all three observables.")] = 1e-2,
    transient: Annotated[
        bool, typer.Option("--transient", help="Second half of the run's distance instead of steady averages.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine. Default: all cores.", show_default=False)
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Scheduler (or its file) of a dask.distributed cluster to compute on."),
    ] = None,
    set_: Set = None,
    seed: Seed = None,
    threads: Annotated[
        int | None, typer.Option(help="Threads per process. Default: cores that are left.", show_default=False)
    ] = None,
    max_lives: Annotated[float, typer.Option(help="Most lives per point.", show_default="1e10")] = 1e10,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """A grid of points, the "sweep" table of the run file: a resumable Parquet dataset, one row per point."""
    file, text = _load(path, set_, seed)
    if dask is not None and workers is not None:
        raise InputError("--workers: not with --dask, whose cluster has its own")
    cores, each = _threads(None), None if threads is None else _threads(threads)
    if workers is None:
        workers = max(1, cores // (each or 1))
    require_integer("--workers", workers, 1, 1024)
    each = each or (1 if dask else max(1, cores // workers))
    from eqsim.io import storage
    from eqsim.sweep.plan import swept
    from eqsim.sweep.scheduler import Asked, Store
    from eqsim.sweep.scheduler import sweep as compute

    given = {item.partition("=")[0].strip(): f"--set {item}" for item in set_ or []}
    given |= {} if seed is None else {"output.seed": "--seed"}
    for key in sorted(given.keys() & swept(file, path.parent)):
        said = f"the [sweep] table sets {key} at every point; --set sweep.{key}=[...] sets other values there"
        raise InputError(f"{given[key]}: has no effect, {said}")
    asked, silent = Asked(rel_error, max_lives, transient), quiet or json
    stores: list[Store] = []
    try:
        with terminal.bar("sweeping", silent, "points") as progress:
            found = compute(
                file, path.parent, out, asked=asked, text=text, workers=workers, threads=each, dask=dask,
                progress=progress, note=(lambda _: None) if silent else print, opened=stores.append,
            )  # fmt: skip
    except KeyboardInterrupt:
        code = signals.heard()  # no further one can break off the writing of what is finished
        kept = stores[0].kept() if stores else "this call has computed nothing"
        _fail(f"interrupted; {kept}; the same command continues", code)
    failures = found.failures[:10]
    if json:
        print(storage.to_json({**dataclasses.asdict(found), "failures": failures, "out": str(out)}))
    elif not quiet:
        doubtful = f", {found.unreliable} unreliable" if found.unreliable else ""
        failed = f", {found.failed} FAILED" if found.failed else ""
        print(f"{out}/: sweep.parquet, {found.points} points: {found.ok} ok{doubtful}{failed}")
        if found.computed:
            each_ms = found.point_seconds / found.computed * 1e3
            print(f"{found.computed} computed in {found.seconds:.1f} s, {each_ms:.3g} ms of engine and reference each")
    if found.failed:
        for failure in failures if not json else []:
            values = ", ".join(f"{key} = {value}" for key, value in failure["changes"].items())
            said = _as_typed(failure["message"])
            print(f"eqsim: point {failure['point']} ({values}) failed: {said}", file=sys.stderr)
        raise typer.Exit(1)


@app.command()
def info(
    path: Path_,
    set_: Set = None,
    seed: Seed = None,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Dimensionless groups and regime of a run file, without simulating it."""
    file, _ = _load(path, set_, seed)
    _threads(threads)
    ensemble, drive = file.ensemble(path.parent), file.driven()
    from eqsim.io import storage
    from eqsim.model.reduced import groups

    found = groups(ensemble, drive)
    from eqsim.engine.trajectory import predicted_lives

    lives = predicted_lives(ensemble, drive, file.output.replicas)
    if json:
        print(storage.to_json({**{g.name: g.value for g in found}, "lives": lives}))
    elif not quiet:
        table = terminal.table("group", "value", "meaning")
        for group in found:
            table.add_row(
                group.name, group.value if isinstance(group.value, str) else f"{group.value:.6g}", group.meaning
            )
        table.add_row("lives", terminal.many(lives), "predicted for `eqsim run`")
        terminal.show(file.title or path.stem, table)


@app.command()
def plot(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of Parquet files, one point a row.", show_default=False)
    ],
    x: Annotated[str, typer.Option(help="Column along the x axis.")] = "drive.velocity",
    y: Annotated[str, typer.Option(help="Column along the y axis.")] = "friction",
    by: Annotated[
        str | None, typer.Option(help="Column of which every value is a series of its own.", show_default=False)
    ] = None,
    where: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Only points at which a column has this value; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Default: DIR.png beside DIR.", show_default=False)
    ] = None,
    log_x: Annotated[
        bool | None,
        typer.Option("--log-x/--linear-x", help="Default: logarithmic above a factor 30.", show_default=False),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Draw a sweep: an observable against a parameter, with error bars and the reference."""
    pairs = [item.partition("=") for item in where or []]
    for item, (key, equals, _) in zip(where or [], pairs, strict=True):
        if not key.strip() or not equals:
            raise InputError(f"--where {item}: must be KEY=VALUE")
    place = folder.absolute()
    file = out or place.parent / f"{place.name}.png"
    if file.suffix != ".png":
        raise InputError(f"--out {file}: must end in .png")
    if file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"--out {file}: must be outside {folder}, where everything is read as points")
    from eqsim.io import storage
    from eqsim.io.plots import read_points, select, sweep_png

    storage.check_folder(file.parent)
    points = select(read_points(folder), {key.strip(): value.strip() for key, _, value in pairs})
    png, notes = sweep_png(points, x, y, by, log_x, _plain(", ".join([place.name, *(where or [])])))
    storage.publish(file.parent, {file.name: png})
    if json:
        print(storage.to_json({"file": str(file), "points": len(points), "notes": notes}))
    elif not quiet:
        print("; ".join([os.path.relpath(file), *notes]))


@app.command()
def figures(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Of A01, A01num, A02, A02ab, A03, A04, A05. Default: all."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for NAME.pdf, NAME.png and NAME.parquet.")] = Path(
        "runs/out/figures"
    ),
    quick: Annotated[
        bool, typer.Option("--quick", help="Few points: coarse, under a minute of one core each.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine. Default: all cores.", show_default=False)
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """The figures of Braun and Peyrard (2011) recomputed, with particles on them; minutes for all."""
    from importlib import import_module

    from eqsim.io import storage
    from eqsim.sweep.workers import unbroken

    scripts = import_module("eqsim_figures")  # analysis/figures
    wanted = scripts.check(names or [])
    workers = workers if workers is not None else _threads(None)
    require_integer("--workers", workers, 1, 1024)
    storage.check_folder(out)
    made: list[Any] = []
    try:
        with unbroken(workers, None) as crew, terminal.bar("computing", quiet or json, "points") as progress:
            for figure in scripts.make(wanted, out, quick=quick, executor=crew.pool, progress=progress):
                made.append(figure)
    except KeyboardInterrupt:
        code = signals.heard()
        finished = ", ".join(figure.name for figure in made)
        _fail(f"interrupted; finished in {out}/: {finished}" if made else signals.WHOLE, code)
    made.sort(key=lambda figure: wanted.index(figure.name))
    if json:
        print(storage.to_json({"out": str(out), "figures": [figure._asdict() for figure in made]}))
    elif not quiet:
        shown = terminal.table("", "curves", "particle estimates", "largest |z|", "chi-square p")
        for name, curves, particles, largest, p in made:
            shown.add_row(name, str(curves), str(particles), f"{largest:.2f}", f"{p:.2g}")
        terminal.show("figures: particles against the master equation of their ensemble", shown)
        print(f"{out}/: {', '.join(figure.name for figure in made)}, each .pdf, .png and .parquet")


@app.command()
def replay(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Parquet file that eqsim wrote.", show_default=False)],
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run again what made a file, from its provenance alone, and compare bit by bit; exit code 1 if they differ."""
    from eqsim.io import storage
    from eqsim.workflows.replay import replay as repeat

    with terminal.bar("repeating", quiet or json, "units") as progress:
        found = repeat(path, workers=_threads(threads), progress=progress)
    if json:
        print(storage.to_json({**dataclasses.asdict(found), "same": found.same}))
    elif not quiet:
        for name, (then, now) in found.versions.items():
            print(f"{name} was {then}, is {now}")
        if found.same:
            print(f"{path}: `eqsim {found.command}` gives the same {found.rows} rows, to the last bit")
        for name, (rows, most) in found.differences.items():
            print(
                f"{path}: {name} differs in {rows} of {max(rows, found.rows)} rows"
                + (f", by up to {most:.3g}" if most else "")
            )
    if not found.same:
        raise typer.Exit(1)


@app.command()
def material(
    name: Annotated[str, typer.Argument(metavar="NAME", help='"steel" or "octamethylcyclotetrasiloxane".')],
    temperature: Annotated[
        float | None, typer.Option(help="Kelvin. Default: 289.7, kT = 4e-21 J as in the paper.", show_default=False)
    ] = None,
    toml: Annotated[bool, typer.Option("--toml", help="Print a run file instead.")] = False,
    disorder: Annotated[
        str | None, typer.Option(help='Of the run file. Default: "quenched".', show_default=False)
    ] = None,
    velocity: Annotated[
        float | None,
        typer.Option(help="Of the run file, m/s. Default: v_* at 289.7 K, at any temperature.", show_default=False),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """SI parameters of a real interface, from its material constants."""
    from eqsim.io import storage
    from eqsim.materials import MATERIALS, ROOM_TEMPERATURE, parameters, run_file_text

    require_choice("NAME", name, tuple(MATERIALS))
    found, kelvin = MATERIALS[name], ROOM_TEMPERATURE if temperature is None else temperature
    if toml:
        if json:
            raise InputError("--toml: prints a run file; it cannot be asked for with --json")
        require_choice("--disorder", kind := disorder or "quenched", ("quenched", "annealed"))
        text = run_file_text(found, kelvin, velocity, disorder=cast("Disorder", kind))
        if not quiet:
            print(text, end="")
        return
    for option, value in (("--disorder", disorder), ("--velocity", velocity)):
        if value is not None:
            raise InputError(f"{option} {value}: is of the run file that --toml prints")
    rows = parameters(found, kelvin)
    if json:
        print(storage.to_json({row.name: row.value for row in rows}))
    elif not quiet:
        table = terminal.table("", "value", "unit", "meaning")
        for row in rows:
            table.add_row(row.name, f"{row.value:.5g}", row.unit, row.meaning)
        terminal.show(f"{name} at {kelvin:.4g} K", table)


def _load(path: Path, set_: list[str] | None, seed: int | None) -> tuple["RunFile", str]:
    """The run file with its changes, and its text with a note of what was changed on the command line."""
    changes: dict[str, Any] = {}
    for item in set_ or []:
        if not item.isascii() and any("\ud800" <= c <= "\udfff" for c in item):  # bytes that are no UTF-8
            raise InputError(f"--set {item}: is not text in UTF-8")
        key, equals, text = item.partition("=")
        if not equals or not all(map(str.strip, key.split("."))):
            raise InputError(f"--set {item}: must be section.key=value")
        try:
            parsed = tomllib.loads(f"value = {text}")
            changes[key.strip()] = parsed["value"] if len(parsed) == 1 else text
        except (ValueError, RecursionError):
            changes[key.strip()] = text
    if seed is not None:
        require_integer("--seed", seed, 0, 2**63 - 1)
        changes["output.seed"] = seed
    from eqsim.model.drive import check_output
    from eqsim.io.runfile import load, read

    text = read(path)
    file = load(path, changes, text)
    with under("output"):
        check_output(file.output.points, file.output.seed, file.output.replicas)
    return file, text + "".join(f"# --set {key}={value!r}\n" for key, value in changes.items())


def _if_any(solve: Callable[[], Any]) -> tuple[Any, str]:
    """The reference, or None and why there is none."""
    try:
        return solve(), ""
    except InputError as error:
        return None, str(error)


def _plain(title: str) -> str:
    """A title for a picture: no mathematics, nothing that no font has."""
    return title.encode(errors="backslashreplace").decode().replace("$", r"\$")


def _threads(asked: int | None) -> int:
    if asked is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    require_integer("--threads", asked, 1, 1024)
    return asked


@contextmanager
def _executor(workers: int | None, dask: str | None, threads: int) -> Iterator[tuple["Executor | None", int]]:
    """Who simulates the contacts, and how many they are: threads of this process (None), worker processes, or dask."""
    if workers is not None and dask is not None:
        raise InputError("--workers, --dask: only one of them")
    if workers is not None:
        require_integer("--workers", workers, 1, 1024)
    elif dask is None:
        yield None, threads
        return
    from eqsim.sweep.workers import unbroken

    with unbroken(workers or 1, dask) as crew:
        yield crew.pool, crew.slots()


def _print_run(file: Any, ensemble: Any, averages: Any, level: "Steady", result: Any, folder: Path, who: str) -> None:
    from eqsim.estimate import difference

    table = terminal.table("", "second half of the run", "steady value", "difference / s.e.")
    for name, estimate in averages.items():
        other = getattr(level, name)
        both = terminal.value_and_error(estimate), terminal.value_and_error(other)
        z = "none" if estimate.value is None else terminal.scores(difference(estimate, other))
        table.add_row(name, *both, z)
    terminal.show(file.title or folder.name, table)
    if not all(estimate.reliable for estimate in averages.values()):
        print("unreliable: the steady state was not reached before the second half, or too few contacts broke in it")
    if not result.force_reliable:
        print("force_stderr: not to be trusted, forces this heavy-tailed need more contacts")
    print(
        f"{terminal.many(result.lives)} lives of {terminal.many(ensemble.count * file.output.replicas)} contacts in "
        f"{result.engine_seconds:.2f} s ({terminal.many(result.lives / max(result.engine_seconds, 1e-9))}/s), "
        f"{result.threads} {who}, seed {result.seed}"
    )
    print(f"{folder}/: trajectory.parquet, summary.json, force.png")


def main() -> None:
    """The command, from its arguments to its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # of names that the terminal cannot show
    code: Any = None
    try:
        signals.listen()
        app(sys.argv[1:] or ["--help"])
    except SystemExit as end:
        code = end.code
    finally:
        if signals.unheard():
            _say(signals.WHOLE, 0)
        signals.leave(code)
    sys.exit(code)
