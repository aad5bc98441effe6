"""Commands that say what parameters mean: info, material."""

from typing import TYPE_CHECKING, Annotated, cast

from typer import Argument, Option

from eqsim.cli.options import Changes, RunFilePath, Shown, Threads, cores
from eqsim.errors import InputError, require_choice
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.model.ensemble import Disorder

_KELVIN = "Kelvin. Default: 289.7, kT = 4e-21 J as in the paper."
_VELOCITY = "Of the run file, m/s. Default: v_* at 289.7 K, at any temperature."


def info(path: RunFilePath, changes: Changes, threads: Threads = None, *, shown: Shown) -> None:
    """Dimensionless groups and regime of a run file, without simulating it."""
    file = changes.load(path)
    cores(threads)
    ensemble, drive = file.ensemble(path.parent), file.driven(path.parent)
    from eqsim.engine.trajectory import predicted_lives
    from eqsim.io.units import scales
    from eqsim.model.reduced import groups

    found, lives = groups(ensemble, drive), predicted_lives(ensemble, drive, file.output.replicas)
    found += scales(ensemble, file.in_units(), file.of_interface())
    rows = [(g.name, g.value if isinstance(g.value, str) else f"{g.value:.6g}", g.meaning) for g in found]
    shown.report(
        {**{group.name: group.value for group in found}, "lives": lives},
        title=file.headline(ensemble, path.stem),
        columns=("group", "value", "meaning"),
        rows=[*rows, ("lives", terminal.count(lives), "predicted for `eqsim run`")],
    )


def material(
    name: Annotated[str, Argument(metavar="NAME", help='"steel" or "octamethylcyclotetrasiloxane".')],
    temperature: Annotated[float | None, Option(help=_KELVIN)] = None,
    toml: Annotated[bool, Option("--toml", help="Print a run file instead.")] = False,
    disorder: Annotated[str | None, Option(help='Of the run file. Default: "quenched".')] = None,
    velocity: Annotated[float | None, Option(help=_VELOCITY)] = None,
    *,
    shown: Shown,
) -> None:
    """SI parameters of a real interface, from its material constants."""
    from eqsim.materials import MATERIALS, ROOM_TEMPERATURE, parameters, run_file_text

    require_choice("NAME", name, tuple(MATERIALS))
    found, kelvin = MATERIALS[name], ROOM_TEMPERATURE if temperature is None else temperature
    if toml:
        if shown.json:
            raise InputError("--toml: prints a run file; it cannot be asked for with --json")
        require_choice("--disorder", kind := disorder or "quenched", ("quenched", "annealed"))
        text = run_file_text(found, kelvin, velocity, disorder=cast("Disorder", kind))
        shown.report(None, notes=[text.removesuffix("\n")])
        return
    for option, value in (("--disorder", disorder), ("--velocity", velocity)):
        if value is not None:
            raise InputError(f"{option} {value}: is of the run file that --toml prints")
    rows = parameters(found, kelvin)
    shown.report(
        {row.name: row.value for row in rows},
        title=f"{name} at {kelvin:.4g} K",
        columns=("", "value", "unit", "meaning"),
        rows=[(row.name, f"{row.value:.5g}", row.unit, row.meaning) for row in rows],
        notes=[] if found.elastic_length else ["no elastic correlation length a^2 E/k: E of the walls is not given"],
    )
