"""Options that commands share, what they print, and options in groups."""

import copy
import functools
import inspect
import os
import re
import sys
import tomllib
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

from rich.markup import escape
from typer import Argument, BadParameter, Option

from eqsim.errors import InputError, require_choice, require_integer
from eqsim.io import terminal
from eqsim.lazy import lazily

with lazily():
    from eqsim.io import runfile, storage, surface
    from eqsim.model import groups
    from eqsim.workflows import report as results

Progress = Callable[[int, float], None]
RunFilePath = Annotated[
    Path, Argument(metavar="RUN.toml", help="Run file.", show_default=False)
]
Threads = Annotated[
    int | None, Option(help="Threads; no result depends on them. Default: all cores.")
]
Processes = Annotated[
    int | None, Option(help="Processes on this machine. Default: all cores.")
]
_MOST = "Refuse work that needs more lives than this."
MaxLives = Annotated[float, Option(help=_MOST, show_default="1e10")]
_FORMATS = "Pictures also as pdf or svg, beside png; repeatable."
_Format = Option("--format", metavar="FORMAT", help=_FORMATS)
Formats = Annotated[list[str] | None, _Format]
_CHANGE = "Change a key of the run file, as section.key=value; repeatable."
_OTHER_SEED = "Random seed, instead of the run file's."
_SetKey = Option("--set", metavar="KEY=VALUE", help=_CHANGE)


@dataclass(frozen=True)
class Changes:
    """Options that change keys of a run file."""

    set_: Annotated[list[str] | None, _SetKey] = None
    seed: Annotated[int | None, Option(help=_OTHER_SEED)] = None

    def given(self) -> dict[str, tuple[Any, str]]:
        """New value and the option it comes from, by key."""
        changes: dict[str, tuple[Any, str]] = {}
        for item in self.set_ or []:
            if any("\ud800" <= c <= "\udfff" for c in item):  # undecodable bytes
                raise InputError(f"--set {item}: is not text in UTF-8")
            key, equals, text = item.partition("=")
            if not equals or not all(map(str.strip, key.split("."))):
                raise InputError(f"--set {item}: must be section.key=value")
            try:
                parsed = tomllib.loads(f"value = {text}")
            except (ValueError, RecursionError):
                parsed = {}
            value = parsed["value"] if len(parsed) == 1 else text
            changes[key.strip()] = value, f"--set {item}"
        if self.seed is not None:
            require_integer("--seed", self.seed, 0, 2**63 - 1)
            changes["output.seed"] = self.seed, "--seed"
        return changes

    def load(self, path: Path) -> "runfile.RunFile":
        """The run file with its changes."""
        changes = {key: value for key, (value, _) in self.given().items()}
        return runfile.load(path, changes)


@dataclass(frozen=True)
class Shown:
    """Options of what is printed, and the printing."""

    json: Annotated[bool, Option("--json", help="Print JSON for machines.")] = False
    quiet: Annotated[bool, Option("--quiet", help="Print errors only.")] = False

    def bar(self, title: str, unit: str = "") -> AbstractContextManager[Progress]:
        """A progress bar, unless JSON or errors only are printed."""
        return terminal.bar(title, self.quiet or self.json, unit)

    def note(self, line: str) -> None:
        """Print a line about progress, where a bar would be shown."""
        if not (self.quiet or self.json):
            print(line, flush=True)

    def doubt(self, file: "runfile.RunFile", drive: Any = None) -> None:
        """Warn on standard error about numbers whose units were probably mixed, and what
        was assumed for a surface in units."""
        lines = [*groups.doubts(file.ensemble, drive), *surface.doubts(file)]
        for line in lines if not self.quiet else ():
            complain(f"warning: {line}")

    def report(self, data: Any, **more: Any) -> None:
        """Print a result; the arguments are those of `terminal.Report`."""
        terminal.Report(data, **more).show(self.json, self.quiet)

    def result(
        self,
        result: "results.FileResult",
        name: str,
        out: Path | None = None,
        formats: tuple[str, ...] = ("png",),
    ) -> None:
        """Print a result, titled `name` without a title; write files to `out`."""
        more = []
        if out is not None:
            with self.bar(result.phase):
                files = result.files(name, formats)
            storage.publish(out, files)
            more = [f"{out}/: {result.written(list(files))}"]
            if left := storage.left_over(out, result.command, files):
                more.append(f"{out}/ also holds {', '.join(left)} of an earlier run")
        result.report(name, *more).show(self.json, self.quiet)


# Sentences below the help of commands, about words of their tables, columns and JSON.
Z = (
    "z: difference from the expected value in standard errors, both errors in quadrature; "
    "where they come from few batches, the normal score of its Student probability."
)
STDERR = "stderr: statistical standard error of a simulated value."
ERROR = "error: bound of the error of a numerical solution."


def complain(message: str) -> None:
    """Print one line on standard error."""
    print("eqsim: " + " ".join(message.split()), file=sys.stderr)


def typed(message: str) -> str:
    """Replace names of arguments of functions in a message by those of the options,
    where it begins with one, says "more than" one or what one was, or gives one in
    brackets. Elsewhere such a name may be that of a column of a file."""
    options = "rel_error|max_lives|temperature|velocity|at|columns|trend"
    options += "|starts|workers|data"
    names = rf"(\A|(?<=more than )|(?<=\())({options})(?= = )|(?<![\w.-])({options})(?= was )"
    return re.sub(names, lambda found: "--" + found[0].replace("_", "-"), message)


def results_folder(path: Path, out: Path | None) -> Path:
    """Folder for results: `out`, or out/NAME beside the run file. Raises InputError."""
    if out is None and not path.is_file():
        why = f"because {path} is not a file with a folder of its own"
        raise InputError(f"--out: is required, {why}")
    return out or path.parent / "out" / path.stem


def cores(asked: int | None = None) -> int:
    """Number of threads: the one asked for, or that of the cores. Raises InputError."""
    if asked is None:
        affinity = getattr(os, "sched_getaffinity", None)
        return len(affinity(0)) if affinity else os.cpu_count() or 1
    require_integer("--threads", asked, 1, 1024)
    return asked


def pictured(formats: list[str] | None) -> tuple[str, ...]:
    """The formats of pictures, PNG always. Raises InputError."""
    for form in formats or []:
        require_choice("--format", form, ("png", "pdf", "svg"))
    return tuple(dict.fromkeys(("png", *(formats or []))))


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command for typer: where `command` takes a dataclass, the dataclass's
    fields are options. Brackets in help, as of a [section], are no markup."""
    given = inspect.signature(command).parameters
    annotations: dict[str, Any] = {name: one.annotation for name, one in given.items()}
    kinds: dict[str, Any] = {
        name: kind for name, kind in annotations.items() if is_dataclass(kind)
    }
    fields = {name: inspect.signature(kind).parameters for name, kind in kinds.items()}

    @functools.wraps(command)
    def call(**values: Any) -> None:
        for name, kind in kinds.items():
            values[name] = kind(**{field: values.pop(field) for field in fields[name]})
        command(**values)

    options = [
        option.replace(kind=option.KEYWORD_ONLY, annotation=_escaped(option.annotation))
        for name, parameter in given.items()
        for option in fields.get(name, {name: parameter}).values()
    ]
    call.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    call.__annotations__ = {option.name: option.annotation for option in options}
    text = escape(inspect.cleandoc(command.__doc__ or ""))
    call.__doc__ = re.sub(r"(?<!\n)\n(?!\n)", " ", text)  # typer keeps ends of lines
    return call


def _path(text: str) -> Path:
    """Parse a path; an empty one is refused, as it would be the current folder. Raises
    BadParameter."""
    if not str(text).strip():
        raise BadParameter(f"{str(text)!r} must be the name of a file or folder")
    return Path(text)


_path.__name__ = "path"  # the type that help shows


def _escaped(annotation: Any) -> Any:
    """Let help show what an option takes as written, and refuse an empty path."""
    kind, given = get_args(annotation)
    shown = copy.copy(given)
    shown.help = escape(given.help or "")
    if Path in (kind, *get_args(kind)):
        shown.parser = _path
    if kind is bool:
        shown.metavar = " "
    return Annotated[kind, shown]
