"""The command line: its commands, and how errors end it."""

import io
import os
import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated, Any, NoReturn, cast

import typer
from rich.markup import escape
from typer.core import TyperGroup

from eqsim.cli import begin, check, describe, fit, simulate, survey
from eqsim.cli.options import ERROR, STDERR, Z, complain, grouped, typed
from eqsim.errors import InputError, shown
from eqsim.io import signals

# Any error of usage: typer has no name for it.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__base__)


class _Commands(TyperGroup):
    """Turns what a user can cause into one line and an exit code: 2 for bad input, 130
    for Ctrl-C, 143 for SIGTERM."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        kwargs |= {"prog_name": "eqsim", "standalone_mode": False}
        try:
            try:
                code = super().main(*args, **kwargs)
            finally:
                _flush()
        except _UsageError as error:
            said = error.format_message().removesuffix(".")
            # typer's messages, which do not tell the value
            for problem in getattr(error.__cause__, "errors", list)():
                must = f"{shown(problem['input'])} must be"
                said = said.replace("Input should be", must)
            command = error.ctx.command_path if error.ctx else "eqsim"
            complain(f"{said}; see `{command} --help`")
            code = 2
        except SystemExit as error:  # raised by rich if the reader has left
            if not isinstance(error.__context__, BrokenPipeError):
                raise
            code = 0
        except BrokenPipeError:  # the same; nothing to say
            code = 0
        except OSError as error:
            complain(f"{error.filename or 'file system'}: {error.strerror or error}")
            code = 2
        sys.exit(code)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            _fail(typed(str(error)), 2)
        except MemoryError:
            _fail("not enough memory; fewer output.points need less", 2)
        except BrokenPipeError:  # the reader has left
            _drop_output()
        except KeyboardInterrupt as stop:
            said = f"interrupted; {stop}" if str(stop) else signals.MESSAGE
            _fail(said, signals.acknowledge())


def _flush() -> None:
    """Write what was printed while a failure can still be told."""
    try:
        if sys.stdout is not None:  # a shell may have closed it
            sys.stdout.flush()
    except OSError:
        _drop_output()
        raise


def _drop_output() -> None:
    """Let what cannot be written not be tried again at the end of Python."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str, code: int) -> NoReturn:
    complain(message)
    raise typer.Exit(code)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"eqsim {version('eqsim')}")
        raise typer.Exit


_SHOW = "Show the version."
_Version = typer.Option("--version", callback=_show_version, is_eager=True, help=_SHOW)


def _top(version: Annotated[bool, _Version] = False) -> None:
    """Take the options that belong to no command."""


def new_app() -> typer.Typer:
    """A command line without commands."""
    made = typer.Typer(
        cls=_Commands,
        help="Stochastic earthquake-model simulator of multi-contact friction.",
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback()(_top)
    return made


def register(
    app: typer.Typer, command: Callable[..., None], *words: str, **settings: Any
) -> None:
    """Make a function a command, whose help ends with explanations, `words`."""
    app.command(epilog=escape("\n\n".join(words)), **settings)(grouped(command))


app = new_app()
register(app, simulate.run, Z, STDERR, simulate.PEAK)
register(app, simulate.steady, Z, STDERR)
register(app, simulate.reference, ERROR, simulate.F_K)
register(app, simulate.fluctuations)
register(app, simulate.stability)
register(app, check.validate, Z)
register(app, survey.sweep, survey.COLUMN_ENDS, STDERR, ERROR, Z)
register(app, fit.fit)
register(app, fit.design)
register(app, fit.rsf)
register(app, describe.info)
register(app, begin.new)
register(app, describe.keys)
register(app, survey.plot)
register(app, check.replay)
register(app, check.export)
register(app, describe.material)
# the message is the same for any options
_ANY_OPTION = {"ignore_unknown_options": True}
register(app, survey.figures, context_settings=_ANY_OPTION)


def main() -> None:
    """Run the command line. Raises SystemExit."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # escape letters that it lacks
            stream.reconfigure(errors="backslashreplace")
    app(sys.argv[1:] or ["--help"])
