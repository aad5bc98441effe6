"""Parts of the documentation that the program says of itself: keys of run files, commands,
observables, labels of the paper and public names.

    python -m analysis.reference_pages

writes them between the marks `<!-- name -->` and `<!-- end of name -->` of a page. What a key means
is in `eqsim/catalogue.toml`.
"""

import inspect
import re
import types
import typing
from pathlib import Path
from typing import Any

from typer.models import ArgumentInfo

import eqsim
from eqsim import OBSERVABLES, catalogue
from eqsim.cli.app import app as command_line
from eqsim.io.schema import rows_of
from eqsim.paper import EQUATIONS, FIGURES

DOCS = Path(__file__).parents[1] / "docs"


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


def option(name: str, kind: Any, about: Any, begins: Any) -> tuple[str, str]:
    """An argument or an option of a command, and what it means."""
    meaning = plain(about.help)
    needed = begins is inspect.Parameter.empty or begins is ...
    if isinstance(about, ArgumentInfo):
        given = about.metavar or name.upper()
        if needed or begins is None or given.startswith("["):
            return f"`{given}`", meaning
        return f"`[{given}]`", f"{meaning} Default: `{begins}`."
    # of Annotated
    first = (
        (about.default,)
        if isinstance(about.default, str) and about.default.startswith("-")
        else ()
    )
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


def keys() -> list[str]:
    """Tables of all keys of run files, one for each section."""
    lines: list[str] = []
    for section, about in catalogue.SECTIONS.items():
        rows = [(f"`{row.key}`", *row[1:]) for row in rows_of(section)]
        heading = about.get("heading", f"`[{section}]`")
        lines += [f"## {heading}", "", about["about"], ""]
        lines += [*table(("key", "default", "values", "meaning"), rows), ""]
    return lines[:-1]


def commands() -> list[str]:
    """All commands with their arguments and options."""
    lines: list[str] = []
    for command in command_line.registered_commands:
        assert command.callback
        arguments, options = [], []
        for name, given in inspect.signature(command.callback).parameters.items():
            (kind, *_), (about, *_) = (
                typing.get_args(given.annotation)[:1],
                given.annotation.__metadata__,
            )
            begins = given.default
            first = about.default  # or the name of an option
            if begins is inspect.Parameter.empty and not str(first).startswith("-"):
                begins = first
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


def observables() -> list[str]:
    """The table of observables, as they are declared."""
    rows = [
        (f"`{name}`", what.label, what.unit or "number")
        for name, what in OBSERVABLES.items()
    ]
    return table(("name", "what it is", "unit"), rows)


def labels() -> list[str]:
    """Numbers of the paper's equations and figures, by their labels."""
    cells = [(f"`{label}`", f"({number})") for label, number in EQUATIONS.items()]
    columns = 4
    length = -(-len(cells) // columns)
    rows = [
        tuple(part for cell in cells[i::length] for part in cell) for i in range(length)
    ]
    rows = [row + ("",) * (2 * columns - len(row)) for row in rows]
    figures = ", ".join(f"`{label}` is {number}" for label, number in FIGURES.items())
    return [
        *table(("label", "number") * columns, rows),
        "",
        f"Of the figures {figures}.",
    ]


# Public names that may still change in any version; all others are stable.
PROVISIONAL = (
    "Bursts", "Chain", "ChainTrajectory", "FreshSlip", "Lifetime", "Modes", "Posterior",
    "Precursors", "RateAndState", "RateAndStateFit", "bursts", "chain_modes", "edge_load",
    "fit_rate_and_state", "fresh_slip", "front_prestress", "front_speed", "lifetime",
    "posterior", "precursors", "record_of",
)  # fmt: skip


def names() -> list[str]:
    """Every public name with the first sentence of its documentation, and whether it is
    stable."""
    rows = []
    for name in eqsim.__all__:  # type: ignore[attr-defined] # made when asked for
        what = getattr(eqsim, name)
        said = (
            inspect.getdoc(what)
            if callable(what)
            else "What averages are called; their words and units."
        )
        meaning = re.split(r"(?<!eq)(?<!eqs)\.(?:\s|$)", plain(said))[0] + "."
        status = "provisional" if name in PROVISIONAL else "stable"
        rows.append((f"`{name}`", status, meaning))
    return table(("name", "status", "meaning"), rows)


PARTS = {
    "reference/runfile.md": keys,
    "reference/commands.md": commands,
    "reference/results.md": observables,
    "reference/python.md": names,
    "theory/errata.md": labels,
}


def titled(text: str, page: Path) -> str:
    """Markdown whose links to other pages without words have the titles of these."""

    def title(link: re.Match[str]) -> str:
        first = (page.parent / link[1]).read_text(encoding="utf-8").partition("\n")[0]
        return f"[{first.removeprefix('# ')}]({link[1]})"

    return re.sub(r"\[\]\(([\w./-]+\.md)\)", title, text)


def filled(page: Path, name: str, lines: list[str]) -> str:
    """The text of a page with its part of that name made anew."""
    before, mark, rest = page.read_text(encoding="utf-8").partition(
        f"<!-- {name} -->\n"
    )
    _, end, after = rest.partition(f"<!-- end of {name} -->")
    assert end, f"{page}: has no part {name}"
    body = titled("\n".join(lines), page)
    return f"{before}{mark}\n{body}\n\n{end}{after}"


def pages() -> dict[Path, str]:
    """The pages with such parts, and their texts as the program makes them."""
    return {
        DOCS / name: filled(DOCS / name, make.__name__, make())
        for name, make in PARTS.items()
    }


if __name__ == "__main__":
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")
