"""The drive of a run file that is not a constant velocity: programmes, recorded drives,
stages, forces and motors."""

from collections.abc import Iterator
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from eqsim.errors import POSITIVE, InputError, require_number, shown, under
from eqsim.io.content import path_of
from eqsim.io.tables import DriveRecord, RecordedDrive, read_drive
from eqsim.model.chain import Chain
from eqsim.model.drive import Programme, Segment, Stage, default_distance

if TYPE_CHECKING:
    from eqsim.io.runfile import RunFile

PULLS = ("force", "force_rate")  # keys of a segment under a force


def programme_of(file: "RunFile") -> Programme:
    """The programme of a run file. Raises InputError."""
    _check(file["drive"])
    # beside a start that is given, a velocity is that of another choice of it
    if "start" not in file.given["drive"]:
        require_use(file)
    given, blocks = file["drive"], file.blocks
    names = "start", "velocity", "stall_force", "rebinding"
    more = {name: given[name] for name in names if given[name] is not None}
    more["chain" if isinstance(blocks, Chain) else "elastic"] = blocks
    with under("drive"):
        if stage := given["stage"]:
            known = {field.name: stage[field.name] for field in fields(Stage)}
            with under("stage"):
                more["stage"] = Stage(**known)
        return Programme(tuple(_segments(file)), **more)


def require_use(file: "RunFile") -> None:
    """Raise InputError for a drive.velocity that a programme does not use."""
    given = file["drive"]
    course = given["programme"] is not None or given["file"] is not None
    if course and given["velocity"] is not None and given["start"] != "stationary":
        said = 'not allowed with a programme or file, unless drive.start = "stationary"'
        raise InputError(f"drive.velocity = {given['velocity']!r}: {said}")


def _check(given: dict[str, Any]) -> None:
    """Raise InputError for keys of [drive] that do not go together."""
    if given["programme"] is not None and given["file"] is not None:
        raise InputError("drive.file: not allowed with drive.programme")
    if given["file"] is None and given["record"] is not None:
        raise InputError("drive.record: needs drive.file, the record itself")
    pulls = [name for name in PULLS if given[name] is not None]
    wrong, said = ["time", *pulls, "distance"], "with a programme or file"
    if given["programme"] is None and given["file"] is None:
        wrong = ["velocity", "distance"] if pulls else []
        said = f"with {min(pulls, default='')}, which needs a time"
        if not pulls and given["velocity"] is None:
            raise InputError("drive.velocity: is required")
    for name in wrong:
        if given[name] is not None:
            raise InputError(f"drive.{name} = {given[name]!r}: not allowed {said}")


def _segments(file: "RunFile") -> Iterator[Segment]:
    """The segments of the drive. Raises InputError."""
    given = file["drive"]
    if given["file"] is not None:
        yield from recorded_drive(file).segments
    elif given["programme"] is None:
        distance, time = given["distance"], given["time"]
        pulls = {name: given[name] for name in PULLS}
        if {distance, time, *pulls.values()} == {None}:
            distance = default_distance(file.ensemble)
        yield Segment(given["velocity"] or 0.0, distance, time, **pulls)
    for index, section in enumerate(given["programme"] or []):
        with under(f"programme.{index}"):
            yield _segment(**section)


def _segment(velocity: Any, hold: float | None, **more: Any) -> Segment:
    """A segment of a run file. Raises InputError."""
    forced = any(more[name] is not None for name in PULLS)
    if forced + (velocity is not None) + (hold is not None) != 1:
        said = "either a velocity or a hold, the time for which nothing moves"
        raise InputError(f"velocity: a segment has {said}, or a force")
    if hold is None:
        return Segment(velocity or 0.0, **more)
    for name in ("distance", "time"):
        if more[name] is not None:
            said = "not allowed with hold, which is a time"
            raise InputError(f"{name} = {shown(more[name])}: {said}")
    require_number("hold", hold, **POSITIVE)
    return Segment(0.0, **more | {"time": hold})


def recorded_drive(file: "RunFile") -> RecordedDrive:
    """The content of drive.file. Raises InputError."""
    path, how = path_of("file", file.folder, file["drive.file"]), file["drive.record"]
    units = ("", "") if file.repeats else (file.units.time, file.units.length)
    return read_drive(path, how and DriveRecord(**how), units)
