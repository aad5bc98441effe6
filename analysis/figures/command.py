"""The command that makes the figures."""

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from eqsim.cli.app import new_app, register
from eqsim.cli.check import report_replay
from eqsim.cli.options import Processes, Shown, Z, cores
from eqsim.errors import require_integer
from eqsim.io import signals
from eqsim.paper import ARTICLE, FIGURES, figure

Names = Annotated[
    list[str] | None,
    Argument(
        metavar="NAME",
        help=f"{', '.join(map(figure, FIGURES))}, by name or number. Default: all.",
    ),
]
Out = Annotated[Path, Option(help="Folder for NAME.pdf, NAME.png and NAME.parquet.")]
Quick = Annotated[
    bool,
    Option("--quick", help="Few points: coarse, under a minute of one core each."),
]
Replayed = Annotated[
    Path | None,
    Option(metavar="FILE", help="Make the table of a figure again, and compare."),
]


def figures(
    names: Names = None,
    out: Out = Path("runs/out/figures"),
    quick: Quick = False,
    workers: Processes = None,
    replay: Replayed = None,
    *,
    shown: Shown,
) -> None:
    """The figures of Braun and Peyrard (2011) recomputed, with simulated contacts on
    them; minutes for all."""
    from analysis.figures.compute import check, make, repeat
    from eqsim.io import storage
    from eqsim.sweeps.workers import Workers

    wanted = check(names or [])
    count = cores() if workers is None else workers
    require_integer("--workers", count, 1, 1024)
    if replay is not None:
        return report_replay(replay, count, shown, {"figures": repeat})
    storage.check_folder(out)
    made: list[Any] = []
    bar = shown.bar("computing", "points")
    try:
        with Workers(count).fixed_pool() as pool, bar as progress:
            means: dict[str, Any] = {"executor": pool.executor, "progress": progress}
            made.extend(make(wanted, out, quick=quick, **means))
    except KeyboardInterrupt:
        signals.acknowledge()
        finished = ", ".join(f.name for f in made)
        raise KeyboardInterrupt(
            f"finished in {out}/: {finished}" if made else ""
        ) from None
    made.sort(key=lambda f: wanted.index(f.name))
    shown.report(
        {"out": str(out), "figures": [f._asdict() for f in made]},
        title="figures: simulated contacts against the master equation of their "
        "ensemble",
        columns=("", "Fig.", "curves", "estimates", "largest |z|", "chi-square p"),
        rows=[
            (
                *(f.name, str(FIGURES[f.name]), str(f.curves), str(f.particles)),
                *(f"{f.largest:.2f}", f"{f.p:.2g}"),
            )
            for f in made
        ],
        notes=[
            f"{out}/: {', '.join(f.name for f in made)}, each .pdf, .png and .parquet",
            f"Fig.: of {ARTICLE}",
        ],
    )


app = new_app()
register(app, figures, Z)
