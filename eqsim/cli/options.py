"""Options that commands share, and commands whose options come in groups."""

import dataclasses
import functools
import inspect
import os
import re
import sys
import tomllib
import typing
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eqsim.errors import InputError, require_integer
from eqsim.io import terminal

if TYPE_CHECKING:
    from eqsim.io.runfile import RunFile

RunFilePath = Annotated[Path, typer.Argument(metavar="RUN.toml", help="Run file.", show_default=False)]
Threads = Annotated[
    int | None,
    typer.Option(help="Threads: speed only, never a number. Default: all cores.", show_default=False),
]
Processes = Annotated[
    int | None, typer.Option(help="Processes on this machine. Default: all cores.", show_default=False)
]
MaxLives = Annotated[float, typer.Option(help="Refuse work that needs more lives than this.", show_default="1e10")]


@dataclasses.dataclass(frozen=True)
class Changes:
    """What the command line changes in a run file."""

    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change a key of the run file, as section.key=value; repeatable."
        ),
    ] = None
    seed: Annotated[int | None, typer.Option(help="Random seed, instead of the run file's.", show_default=False)] = None

    def given(self) -> dict[str, tuple[Any, str]]:
        """Value and option by key."""
        changes: dict[str, tuple[Any, str]] = {}
        for item in self.set_ or []:
            if not item.isascii() and any("\ud800" <= c <= "\udfff" for c in item):  # bytes that are no UTF-8
                raise InputError(f"--set {item}: is not text in UTF-8")
            key, equals, text = item.partition("=")
            if not equals or not all(map(str.strip, key.split("."))):
                raise InputError(f"--set {item}: must be section.key=value")
            try:
                parsed = tomllib.loads(f"value = {text}")
                value = parsed["value"] if len(parsed) == 1 else text
            except (ValueError, RecursionError):
                value = text
            changes[key.strip()] = value, f"--set {item}"
        if self.seed is not None:
            require_integer("--seed", self.seed, 0, 2**63 - 1)
            changes["output.seed"] = self.seed, "--seed"
        return changes

    def load(self, path: Path) -> "RunFile":
        """The run file with its changes."""
        changes = {key: value for key, (value, _) in self.given().items()}
        from eqsim.io.runfile import load

        file = load(path, changes)
        file.check_output()
        return file


@dataclasses.dataclass(frozen=True)
class Shown:
    """What of a result is shown, and how."""

    json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False

    def bar(self, title: str, unit: str) -> AbstractContextManager[Callable[[int, float], None]]:
        """A progress bar, unless there is nobody to see it."""
        return terminal.bar(title, self.quiet or self.json, unit)

    def note(self, line: str) -> None:
        """A line about what is going on."""
        if not (self.quiet or self.json):
            print(line)

    def report(self, data: Any, **more: Any) -> None:
        """The result, as in `terminal.Report`."""
        terminal.Report(data, **more).show(self.json, self.quiet)


def complain(message: str) -> None:
    """One line on standard error."""
    print("eqsim: " + " ".join(message.split()), file=sys.stderr)


def typed(message: str) -> str:
    """A message in which arguments of functions have the names of the options they come from."""
    names = r"(?<![\w.-])(rel_error|max_lives|temperature|velocity)(?= (= |was ))"
    return re.sub(names, lambda found: "--" + found[1].replace("_", "-"), message)


def cores(asked: int | None = None) -> int:
    """So many threads as are asked for, or as there are cores. Raises InputError."""
    if asked is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    require_integer("--threads", asked, 1, 1024)
    return asked


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """A command for typer, with the fields of a dataclass as options where `command` takes the dataclass."""
    hints = typing.get_type_hints(command, include_extras=True)
    groups = {name: kind for name, kind in hints.items() if dataclasses.is_dataclass(kind)}
    options = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name in groups:
            kinds = typing.get_type_hints(groups[name], include_extras=True)
            options += [
                inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=kind)
                for field in dataclasses.fields(groups[name])
                if (kind := kinds[field.name])
            ]
        else:
            options.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[name]))

    @functools.wraps(command)
    def call(**values: Any) -> None:
        for name, kind in groups.items():
            values[name] = kind(**{field.name: values.pop(field.name) for field in dataclasses.fields(kind)})
        command(**values)

    call.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    call.__annotations__ = {option.name: option.annotation for option in options}
    return call
