"""One signature for all simulations and references: contacts and a drive, or a run file,
`steady(Ensemble(), Drive(0.1))` or `steady("x.toml", changes={"thermal.kT": 1})`.

Engine and reference take an `Ensemble` and a `Drive`. `accepts_run_file` wraps their
functions so that they take a run file as well, and results know its units.
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
from eqsim.errors import InputError, require_threads, shown
from eqsim.io.runfile import RunFile, opened
from eqsim.io.units import Interface, Quantity, Units, quantities
from eqsim.master.steady import Curve
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import tell_quantities
from eqsim.sweeps.plan import Plan
from eqsim.workflows.fluctuations import default_lag

File = RunFile | Path | str
Contacts = Ensemble | File
Changes = dict[str, Any] | None
P = ParamSpec("P")
F = TypeVar("F", contravariant=True)  # type of a run file
D = TypeVar("D", contravariant=True)  # type of a drive
R = TypeVar("R", covariant=True)  # type of a result

_CONTACTS = "    ensemble : Ensemble\n"
_CONTACTS_OR_FILE = """    ensemble : Ensemble, RunFile, Path or str
        Contacts; or a run file, or the path of one, in whose units the result then is,
        and which gives {given} unless they are given here.
"""
_CHANGES = """    changes : dict, optional
        Values that replace those of the run file: {"thermal.kT": 0.1}.
"""


class Call(Protocol[D, P, R]):
    """A function of contacts and a drive, or of a run file."""

    @overload
    def __call__(
        self, ensemble: Contacts, drive: D, *a: P.args, **k: P.kwargs
    ) -> R: ...
    @overload
    def __call__(
        self, file: File, changes: Changes = None, *a: P.args, **k: P.kwargs
    ) -> R: ...


class TrajectoryCall(Protocol[P]):
    """`trajectory`, whose results depend on the drive."""

    @overload
    def __call__(
        self, ensemble: Contacts, drive: Drive, *a: P.args, **k: P.kwargs
    ) -> Trajectory: ...
    @overload
    def __call__(
        self, ensemble: Contacts, drive: Programme, *a: P.args, **k: P.kwargs
    ) -> ProgrammeTrajectory: ...
    @overload
    def __call__(
        self, file: File, changes: Changes = None, *a: P.args, **k: P.kwargs
    ) -> Trajectory | ProgrammeTrajectory: ...


class CurveCall(Protocol):
    """`curve`, which takes velocities in the place of a drive."""

    def __call__(
        self,
        ensemble: Contacts,
        velocities: ArrayLike | None = None,
        *,
        changes: Changes = None,
    ) -> Curve: ...


class FileCall(Protocol[F, P, R]):
    """A function of a run file."""

    @overload
    def __call__(self, file: F, *a: P.args, **k: P.kwargs) -> R: ...
    @overload
    def __call__(self, file: F, *a: Any, changes: Changes, **k: Any) -> R: ...


def accepts_run_file(
    function: Callable[Concatenate[Ensemble, D, P], R],
    drive_of: Callable[[RunFile], Any] = attrgetter("drive"),
    output: tuple[str, ...] = ("points", "seed", "replicas"),
) -> Call[D, P, R]:
    """Let a function of contacts and a drive take a run file, too. `drive_of` finds its
    second argument in a run file; options named in `output` are keys of [output]."""
    signature = inspect.signature(function)
    _, second, *_ = signature.parameters
    options = [name for name in output if name in signature.parameters]

    @functools.wraps(function)
    def call(
        ensemble: Any = None,
        drive: Any = None,
        *args: Any,
        file: Any = None,
        changes: Changes = None,
        **given: Any,
    ) -> Any:
        source = ensemble if file is None else file
        drive = given.pop(second, drive)
        if isinstance(source, (RunFile, Path, str)):
            if isinstance(drive, dict):
                drive, changes = None, drive
            file = opened(source, changes=changes)
            known = signature.bind_partial(None, None, *args, **given).arguments
            given |= {x: getattr(file.output, x) for x in options if x not in known}
            drive = drive_of(file) if drive is None else drive
            source, told = file.ensemble, file.quantities_in
        else:
            told = functools.partial(_quantities, source)
        if not isinstance(source, Ensemble):
            said = "must be an Ensemble, a run file, or the path of one"
            raise InputError(f"ensemble = {shown(source)}: {said}")
        if changes is not None and file is None:
            said = "those of a run file; dataclasses.replace changes an Ensemble"
            raise InputError(f"changes = {shown(changes)}: are {said}")
        require_threads(given.get("threads", 1))
        result: Any = function(source, drive, *args, **given)
        tell_quantities(result, told)
        return result

    first, driven = signature.parameters["ensemble"], signature.parameters[second]
    given = " and ".join(f"`{name}`" for name in (second, *options))
    either = _CONTACTS_OR_FILE.format(given=given)
    text = (function.__doc__ or "").replace(_CONTACTS, either)
    first = first.replace(annotation=Contacts)
    driven = driven.replace(annotation=driven.annotation | None, default=None)
    return _presented(call, text, first, driven)


def accepts_changes(function: Callable[Concatenate[F, P], R]) -> FileCall[F, P, R]:
    """Let a function of a run file take `changes` of its keys, too."""

    @functools.wraps(function)
    def call(file: Any, *args: Any, changes: Changes = None, **given: Any) -> R:
        if changes and isinstance(file, dict):
            file = file | changes
        elif changes:
            file = opened(file, changes=changes)
        return function(file, *args, **given)

    return _presented(call, function.__doc__ or "")


def _presented(call: Any, text: str, *others: inspect.Parameter) -> Any:
    """The function with `changes` and `others` in its signature, documented by `text`."""
    signature, keyword = inspect.signature(call), inspect.Parameter.KEYWORD_ONLY
    changes = inspect.Parameter("changes", keyword, default=None, annotation=Changes)
    known = signature.parameters | {one.name: one for one in (*others, changes)}
    call.__signature__ = signature.replace(parameters=[*known.values()])
    call.__module__ = "eqsim.api"  # where pickle finds it
    head, returns, rest = text.partition("\n    Returns\n")
    call.__doc__ = f"{head.rstrip()}\n{_CHANGES}{returns}{rest}"
    return call


def depends_on_drive(
    function: Callable[Concatenate[Ensemble, Drive, P], Trajectory],
) -> TrajectoryCall[P]:
    """`accepts_run_file` for `trajectory`, with its types."""
    return cast(Any, accepts_run_file(function))


def _quantities(
    ensemble: Ensemble, units: Units | None, interface: Interface | None
) -> tuple[Quantity, ...]:
    return quantities(ensemble, units or Units(), interface or Interface())


def swept_velocities(file: RunFile) -> list[float]:
    """Velocities of a run file's sweep, or that of its drive. Raises InputError."""
    axes, key = Plan(file).axes if file.sweep else [], "drive.velocity"
    swept = dict.fromkeys(row[key] for axis in axes for row in axis if key in row)
    return list(swept) or [file.constant_drive.velocity]


def over_cycles(file: RunFile) -> Drive:
    """The drive over the lags that the command line shows. Raises InputError."""
    drive = file.constant_drive
    return replace(drive, distance=default_lag(file.ensemble, drive))
