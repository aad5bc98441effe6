"""One way of calling for all that simulates or solves: contacts and a drive, or a run
file.

Engine and reference take an `Ensemble` and a `Drive`. `accepts_run_file` makes
functions of them that take a run file as well, and results that know its units:

    steady(Ensemble(), Drive(velocity=0.1))
    steady("x.toml", changes={"thermal.kT": 0.1})
"""

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar, cast, overload

from numpy.typing import ArrayLike

from eqsim.engine.records import ProgrammeTrajectory, Trajectory
from eqsim.errors import InputError, shown
from eqsim.io.runfile import RunFile, opened
from eqsim.io.units import Interface, Quantity, Units, quantities
from eqsim.master.velocities import Curve
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import tell_quantities
from eqsim.sweeps.plan import Plan
from eqsim.workflows.fluctuations import default_lag

Source = RunFile | Path | str
Changes = dict[str, Any]
P = ParamSpec("P")
Driven = TypeVar("Driven")
Found = TypeVar("Found")
Source_contra = TypeVar("Source_contra", contravariant=True)
Driven_contra = TypeVar("Driven_contra", contravariant=True)
Found_co = TypeVar("Found_co", covariant=True)

_OUTPUT = ("points", "seed", "replicas")  # keys of [output] that are options
_ENSEMBLE = "    ensemble : Ensemble\n"
_OR_FILE = """    ensemble : Ensemble, RunFile, Path or str
        Contacts; or a run file, or the path of one, in whose units the result then is,
        and which gives {given} unless they are given here.
"""
_CHANGES = """    changes : dict, optional
        Values that replace those of the run file: {"thermal.kT": 0.1}.
"""


class Call(Protocol[Driven_contra, P, Found_co]):
    """A function of contacts and a drive, or of a run file."""

    @overload
    def __call__(
        self,
        ensemble: Ensemble | Source,
        drive: Driven_contra,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Found_co: ...
    @overload
    def __call__(
        self,
        file: Source,
        changes: Changes | None = None,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Found_co: ...


class TrajectoryCall(Protocol[P]):
    """`trajectory`, whose results depend on the drive."""

    @overload
    def __call__(
        self, ensemble: Ensemble, drive: Drive, *args: P.args, **kwargs: P.kwargs
    ) -> Trajectory: ...
    @overload
    def __call__(
        self, ensemble: Ensemble, drive: Programme, *args: P.args, **kwargs: P.kwargs
    ) -> ProgrammeTrajectory: ...
    @overload
    def __call__(
        self,
        file: Source,
        changes: Changes | None = None,
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Trajectory | ProgrammeTrajectory: ...


class CurveCall(Protocol):
    """`curve`, which takes velocities in the place of a drive."""

    def __call__(
        self,
        ensemble: Ensemble | Source,
        velocities: ArrayLike | None = None,
        *,
        changes: Changes | None = None,
    ) -> Curve: ...


class FileCall(Protocol[Source_contra, P, Found_co]):
    """A function of a run file."""

    @overload
    def __call__(
        self, file: Source_contra, *args: P.args, **kwargs: P.kwargs
    ) -> Found_co: ...
    @overload
    def __call__(
        self, file: Source_contra, *args: Any, changes: Changes, **kwargs: Any
    ) -> Found_co: ...


def _quantities(
    ensemble: Ensemble, units: Units | None, interface: Interface | None
) -> tuple[Quantity, ...]:
    """What the friction of an ensemble is in these units."""
    return quantities(ensemble, units or Units(), interface or Interface())


def accepts_run_file(
    function: Callable[Concatenate[Ensemble, Driven, P], Found],
    drive_of: Callable[[RunFile], Any] = attrgetter("drive"),
    output: tuple[str, ...] = _OUTPUT,
) -> Call[Driven, P, Found]:
    """Let a function of contacts and a drive take a run file, too.

    Parameters
    ----------
    function : callable
        `function(ensemble, drive, ...)`.
    drive_of : callable
        The second argument that a run file stands for.
    output : tuple of str
        Options of the function that are keys of [output].
    """
    signature = inspect.signature(function)
    _, second, *_ = signature.parameters
    options = [name for name in output if name in signature.parameters]

    @functools.wraps(function)
    def call(
        ensemble: Any = None,
        drive: Any = None,
        *args: Any,
        file: Any = None,
        changes: Changes | None = None,
        **given: Any,
    ) -> Any:
        source = ensemble if file is None else file
        # `velocity` is what the drive of `fresh_slip` was called
        for name in (second, "velocity"):
            drive = given.pop(name, drive)
        if isinstance(source, Ensemble):
            if changes is not None:
                raise InputError(
                    f"changes = {shown(changes)}: are those of a run file; "
                    "dataclasses.replace changes an Ensemble"
                )
            found: Any = function(source, drive, *args, **given)
            tell_quantities(found, functools.partial(_quantities, source))
            return found
        if not isinstance(source, RunFile | Path | str):
            raise InputError(
                f"ensemble = {shown(source)}: must be an Ensemble, a run file, or the "
                "path of one"
            )
        if isinstance(drive, dict):
            drive, changes = None, drive
        file = opened(source, changes=changes)
        known = signature.bind_partial(None, None, *args, **given).arguments
        given |= {x: getattr(file.output, x) for x in options if x not in known}
        drive = drive_of(file) if drive is None else drive
        found = function(file.ensemble, drive, *args, **given)
        tell_quantities(found, file.quantities_in)
        return found

    first, drive = signature.parameters["ensemble"], signature.parameters[second]
    said = _OR_FILE.format(given=" and ".join(f"`{x}`" for x in (second, *options)))
    return _presented(
        call,
        (function.__doc__ or "").replace(_ENSEMBLE, said),
        first.replace(annotation=Ensemble | Source),
        drive.replace(annotation=drive.annotation | None, default=None),
    )


def accepts_changes(
    function: Callable[Concatenate[Source_contra, P], Found],
) -> FileCall[Source_contra, P, Found]:
    """Let a function of a run file take `changes` of its keys, too."""

    @functools.wraps(function)
    def call(
        file: Any, *args: Any, changes: Changes | None = None, **given: Any
    ) -> Found:
        if changes and isinstance(file, dict):
            file = file | changes
        elif changes:
            file = opened(file, changes=changes)
        return function(file, *args, **given)

    return _presented(call, function.__doc__ or "")


def _presented(call: Any, text: str, *changed: inspect.Parameter) -> Any:
    """A function with `changes` in its signature and its `text`, and these parameters
    changed."""
    signature = inspect.signature(call)
    changes = inspect.Parameter(
        "changes",
        inspect.Parameter.KEYWORD_ONLY,
        default=None,
        annotation=Changes | None,
    )
    new = {one.name: one for one in (*changed, changes)}
    call.__signature__ = signature.replace(
        parameters=[*(signature.parameters | new).values()]
    )
    call.__module__ = "eqsim.api"  # where pickle finds it
    head, returns, rest = text.partition("\n    Returns\n")
    call.__doc__ = head.rstrip() + "\n" + _CHANGES + returns + rest
    return call


def trajectory_of_drives(
    function: Callable[Concatenate[Ensemble, Drive, P], Trajectory],
) -> TrajectoryCall[P]:
    """`accepts_run_file` for `trajectory`."""
    return cast(Any, accepts_run_file(function))


def curve_with_velocities(
    function: Callable[[Ensemble, Any], Curve],
) -> CurveCall:
    """`accepts_run_file` for `curve`: velocities of a run file are those of its sweep,
    or else that of its drive."""

    def velocities_of(file: RunFile) -> list[float]:
        axes = Plan(file).axes if file.sweep else []
        rows = [row for axis in axes for row in axis]
        key = "drive.velocity"
        found = list(dict.fromkeys(row[key] for row in rows if key in row))
        return found or [file.constant_drive.velocity]

    return cast(Any, accepts_run_file(function, velocities_of))


def fluctuations_over_cycles(
    function: Callable[Concatenate[Ensemble, Drive, P], Found],
) -> Call[Drive, P, Found]:
    """`accepts_run_file` for `fluctuations`: lags of a run file are those of the
    command line."""

    def drive_of(file: RunFile) -> Drive:
        drive = file.constant_drive
        return replace(drive, distance=default_lag(file.ensemble, drive))

    return accepts_run_file(function, drive_of, output=())
