"""Reference pages that are made from the program: keys of run files, commands, observables, public names.

What a key means is in `eqsim/catalogue.toml`.
"""

import inspect
import types
import typing
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.models import ArgumentInfo

from eqsim import OBSERVABLES, api, catalogue
from eqsim.cli.app import app as command_line
from eqsim.io.schema import Key, keys_of
from eqsim.laws.aging import RULES
from eqsim.laws.barrier import BARRIERS
from eqsim.laws.delay import DELAYS
from eqsim.laws.newborn import LAWS
from eqsim.laws.stiffness import StiffnessLaw
from eqsim.model.drive import Start
from eqsim.model.elastic import Edges
from eqsim.model.ensemble import Disorder
from eqsim.paper import EQUATIONS, FIGURES

CHOICES = {
    "disorder": typing.get_args(Disorder),
    "contacts.stiffness_law": typing.get_args(StiffnessLaw),
    "thermal.barrier": tuple(BARRIERS),
    "aging.rule": ("none", *RULES),
    "newborn.law": ("unstressed", *LAWS),
    "delay.law": tuple(DELAYS),
    "drive.start": typing.get_args(Start),
    "elastic.edges": typing.get_args(Edges),
}
KINDS = {float: "number", int: "whole number", bool: "`true`, `false`", str: "text"}


def allowed(name: str, key: Key) -> str:
    """The values that a key may have, in Markdown."""
    choices = CHOICES.get(name) or [
        choice
        for kind in parts(key.annotation)
        if typing.get_origin(kind) is typing.Literal
        for choice in typing.get_args(kind)
    ]
    if choices:
        return ", ".join(f'`"{choice}"`' for choice in choices)
    return catalogue.KEYS[name].values or KINDS[key.kind]


def parts(annotation: Any) -> list[Any]:
    """A type, what a union is made of, and what lists are of."""
    if typing.get_origin(annotation) is list:
        return [annotation, *parts(typing.get_args(annotation)[0])]
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) in (
        typing.Union,
        typing.Annotated,
    ):
        return [part for one in typing.get_args(annotation) for part in parts(one)]
    return [annotation]


def default(value: Any) -> str:
    if value is ...:
        return "required"
    if isinstance(value, str):
        return f'`"{value}"`'
    return "" if value in (None, {}) else f"`{str(value).lower()}`"


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> list[str]:
    """Lines of Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    return [
        "| "
        + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in line)
        + " |"
        for line in lines
    ]


def plain(text: str | None) -> str:
    """A text of help on one line, without what escapes rich's markup."""
    return " ".join((text or "").replace("\\[", "[").split())


def option(name: str, kind: Any, about: Any, begins: Any) -> tuple[str, str]:
    """An argument or an option of a command, and what it means."""
    meaning = plain(about.help)
    needed = begins is inspect.Parameter.empty or begins is ...
    if isinstance(about, ArgumentInfo):
        return f"`{about.metavar or name.upper()}`", meaning
    first = (
        (about.default,)
        if isinstance(about.default, str) and about.default.startswith("-")
        else ()
    )  # of Annotated
    declared = (*first, *(about.param_decls or ())) or (f"--{name.replace('_', '-')}",)
    names = [part for one in declared for part in one.split("/")]
    kinds = [part for part in parts(kind) if part is not types.NoneType]
    value = (
        ""
        if kinds[0] is bool
        else " " + (about.metavar or getattr(kinds[-1], "__name__", "value").upper())
    )
    shown = about.show_default if isinstance(about.show_default, str) else begins
    said = (
        needed
        or begins is None
        or begins is False
        or "Default" in meaning
        or about.show_default is False
    )
    tail = " Required." if needed else "" if said else f" Default: `{shown}`."
    return ", ".join(f"`{one.strip()}{value}`" for one in names), meaning + tail


class FromProgram(SphinxDirective):
    """A directive whose content is Markdown that the program's own declarations make."""

    has_content = True

    def markdown(self) -> list[str]:
        raise NotImplementedError

    def run(self) -> list[Any]:
        return self.parse_text_to_nodes(
            "\n".join(self.markdown()), allow_section_headings=True
        )


class RunFileKeys(FromProgram):
    """Tables of all keys of run files, one for each section."""

    def markdown(self) -> list[str]:
        self.env.note_dependency(str(Path(catalogue.__file__).with_suffix(".toml")))
        lines: list[str] = []
        for section, about in catalogue.SECTIONS.items():
            rows = []
            for last, key in keys_of(section).items():
                name = f"{section}.{last}".removeprefix(".")
                entry = catalogue.KEYS[name]
                if not entry.meaning:
                    raise self.error(f"catalogue.toml says no meaning of {name}")
                begins = entry.default or default(key.default)
                rows.append((f"`{last}`", begins, allowed(name, key), entry.meaning))
            heading = about.get("heading", f"`[{section}]`")
            lines += [f"## {heading}", "", about["about"], ""]
            lines += [*table(("key", "default", "values", "meaning"), rows), ""]
        return lines


class Commands(FromProgram):
    """All commands with their arguments and options."""

    def markdown(self) -> list[str]:
        lines: list[str] = []
        for command in command_line.registered_commands:
            assert command.callback
            arguments, options = [], []
            for name, given in inspect.signature(command.callback).parameters.items():
                (kind, *_), (about, *_) = (
                    typing.get_args(given.annotation)[:1],
                    given.annotation.__metadata__,
                )
                begins = (
                    given.default
                    if about.default is ...
                    or given.default is not inspect.Parameter.empty
                    else about.default
                )
                row = option(name, kind, about, begins)
                (arguments if isinstance(about, ArgumentInfo) else options).append(row)
            name = command.name or command.callback.__name__
            lines += [f"## `eqsim {name}`", "", plain(command.callback.__doc__), ""]
            lines += [
                "```text",
                " ".join(
                    [
                        f"eqsim {name}",
                        *(row[0].strip("`") for row in arguments),
                        "[OPTIONS]",
                    ]
                ),
                "```",
                "",
            ]
            lines += [
                *table(("argument or option", "meaning"), [*arguments, *options]),
                "",
            ]
        return lines


class Observables(FromProgram):
    """The table of observables, as they are declared."""

    def markdown(self) -> list[str]:
        rows = [
            (f"`{name}`", what.label, what.unit or "number")
            for name, what in OBSERVABLES.items()
        ]
        return table(("name", "what it is", "unit"), rows)


class PaperLabels(FromProgram):
    """Numbers of the paper's equations and figures, by their labels."""

    def markdown(self) -> list[str]:
        cells = [(f"`{label}`", f"({number})") for label, number in EQUATIONS.items()]
        columns = 4
        length = -(-len(cells) // columns)
        rows = [
            tuple(part for cell in cells[i::length] for part in cell)
            for i in range(length)
        ]
        rows = [row + ("",) * (2 * columns - len(row)) for row in rows]
        figures = ", ".join(
            f"`{label}` is {number}" for label, number in FIGURES.items()
        )
        return [
            *table(("label", "number") * columns, rows),
            "",
            f"Of the figures {figures}.",
        ]


class PublicNames(FromProgram):
    """Check that the page documents every public name: its content lists them in groups."""

    def markdown(self) -> list[str]:
        lines, named = [], []
        for line in self.content:
            name = line.strip()
            if not name or name.startswith("#"):
                lines += ["", name]
                continue
            module, _, last = name.rpartition(".")
            what = (
                getattr(api, name, None)
                if not module
                else getattr(__import__(f"eqsim.{module}", fromlist=[last]), last)
            )
            named += [] if module else [name]
            kind = (
                "autoclass"
                if isinstance(what, type)
                else "autofunction"
                if callable(what)
                else "autodata"
            )
            lines += [
                "```{eval-rst}",
                f".. {kind}:: eqsim.{name}",
                *(["   :members:"] if kind == "autoclass" else []),
                "```",
            ]
        if sorted(named) != sorted(api.__all__):
            raise self.error(
                f"public names and this page differ in {sorted(set(named) ^ set(api.__all__))}"
            )
        return lines


def setup(app: Sphinx) -> dict[str, bool]:
    for name, directive in (
        ("run-file-keys", RunFileKeys),
        ("commands", Commands),
        ("observables", Observables),
        ("paper-labels", PaperLabels),
        ("public-names", PublicNames),
    ):
        app.add_directive(name, directive)
    return {"parallel_read_safe": True}
