"""The command about fluctuations of the force."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from eqsim.cli.options import Changes, RunFilePath, Shown, Threads, cores
from eqsim.errors import require_integer
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.workflows.fluctuations import FluctuationsResult

_OUT = "Folder for fluctuations.parquet, summary.json and a picture."
_LAG = "Greatest lag. Default: five mean cycles of pinned and detached."
_COLUMNS = ("lag", "exact", "simulated", "z")
_ROWS = 8


def fluctuations(
    path: RunFilePath,
    out: Annotated[Path | None, Option(help=_OUT)] = None,
    lag: Annotated[float | None, Option(help=_LAG, show_default=False)] = None,
    points: Annotated[int, Option(help="Lags, from 0 on.")] = 101,
    lives: Annotated[
        float,
        Option(help="About how many lives are simulated; 0: none.", show_default="1e6"),
    ] = 1e6,
    *,
    changes: Changes,
    threads: Threads = None,
    shown: Shown,
) -> None:
    """Variance and autocovariance of the steady force over displacement: exact, and of
    simulated contacts."""
    file, count = changes.load(path), cores(threads)
    require_integer("--points", points, 2, 10_000)
    from eqsim.io import storage

    if out is not None:
        storage.check_folder(out)
    from eqsim.workflows.fluctuations import run_fluctuations

    found = run_fluctuations(file, lag=lag, points=points, lives=lives, threads=count)
    notes = list(_remarks(found))
    if out is not None:
        storage.publish(out, found.files(path.stem))
        notes.append(f"{out}/: {', '.join(found.names)}")
    title = file.headline(path.stem)
    shown.report(
        found.summary(), title=title, columns=_COLUMNS, rows=_rows(found), notes=notes
    )


def _rows(found: "FluctuationsResult") -> Iterator[tuple[str, ...]]:
    """Some lags, from 0, where it is the variance, on."""
    from eqsim.estimate import Estimate

    exact, sample, z = found.exact, found.sample, found.z
    last = exact.lag.size - 1
    for i in sorted({round(last * row / (_ROWS - 1)) for row in range(_ROWS)}):
        simulated = "none"
        if sample is not None:
            value, stderr = float(sample.covariance[i]), float(sample.stderr[i])
            simulated = terminal.value_and_error(
                Estimate(value, stderr, sample.ensembles, reliable=sample.reliable)
            )
        score = "none" if sample is None else terminal.score(z[i])
        yield f"{exact.lag[i]:.6g}", f"{exact.covariance[i]:.6g}", simulated, score


def _remarks(found: "FluctuationsResult") -> Iterator[str]:
    said = found.summary()
    contacts = f"{terminal.count(found.ensemble.count)} contacts"
    yield "N times the autocovariance of F/(N k) over a lag in displacement; at lag 0 the variance"
    yield f"standard deviation of F/(N k) with {contacts}: {said['force_std']:.6g}"
    yield f"correlation length, the integral over these lags over the variance: {found.correlation_length:.6g}"
    if found.sample is None:
        yield f"nothing simulated: {found.reason}"
    else:
        lives = terminal.count(found.sample.lives)
        ensembles = (
            f"{found.sample.ensembles} ensembles of {found.sample.contacts} contacts"
        )
        yield f"{ensembles}, {lives} lives, seed {said['seed']}"
        if not found.sample.reliable:
            yield "unreliable: a few ensembles make the scatter; forces this heavy-tailed need more --lives"
