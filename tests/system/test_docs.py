"""The documentation: it can be built without a warning, and what it shows is what
happens.

`tests/pages.py` says what a block is. By default every command that is shown is parsed
and every run file read; with -m long all of them run, and print what is shown, and the
site is built.
"""

import ast
import re
import shlex
import subprocess
import sys
import tomllib

import pages
import pytest
from suites import needed
from typer.main import get_command

from eqsim.cli.app import app
from eqsim.io.runfile import check
from eqsim.materials import from_constants

ROOT, DOCS = pages.ROOT, pages.DOCS
PAGES = pages.pages()
BLOCKS = [
    (page, block)
    for page in PAGES
    for block in pages.blocks(page.read_text(encoding="utf-8"))
]


def names(page):
    return str(page.relative_to(ROOT))


def build(source, target, *more):
    """Sphinx with warnings as errors."""
    needed("sphinx")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-b",
        "html",
        *more,
        str(source),
        str(target),
    ]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.mark.long
def test_the_site_can_be_built(tmp_path):
    """All references hold, those to keys of run files and to public names included."""
    done = build(DOCS, tmp_path)
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "reference" / "runfile.html").read_text(encoding="utf-8")
    assert "attempt_frequency" in html
    assert "eqsim stability" in (tmp_path / "reference" / "commands.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.long
def test_a_broken_reference_is_noticed(tmp_path):
    (tmp_path / "index.md").write_text("# Page\n\n[](nowhere.md)\n", encoding="utf-8")
    done = build(tmp_path, tmp_path / "out", "-C", "-D", "extensions=myst_parser")
    assert done.returncode != 0
    assert "nowhere.md" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("formula", "right"),
    [(r"\frac{a}{b}", True), (r"\frok{a}{b}", False), ("a & b", False)],
)
def test_formulas_are_checked(formula, right, monkeypatch, caplog):
    needed("sphinx")
    monkeypatch.syspath_prepend(DOCS / "extensions")
    import mathml
    from docutils import nodes

    mathml.converted(nodes.math("", formula), "inline")
    assert bool(caplog.records) is not right


def calls(text):
    """What is typed after `eqsim` in a line of a shell."""
    for part in re.split(r"&&|\||>", text):
        words = shlex.split(part)
        if words[:1] == ["eqsim"]:
            yield words[1:]


def parsed(words):
    """A command of eqsim with its options, not called. Raises what typer raises."""
    command = get_command(app).commands[words[0]]
    return command.make_context(words[0], list(words[1:]))


def test_commands_can_be_parsed():
    """Those of all pages."""
    typed = [
        words
        for page, block in BLOCKS
        if block.kind == "console"
        for shown, _ in pages.commands(block.body)
        for words in calls(pages.typed(shown))
    ]
    assert len(typed) > 40
    for words in typed:
        parsed(words)
    # each is shown, but for the one that says where figures are made
    known = get_command(app).commands.keys() - {"figures"}
    assert {words[0] for words in typed} == known
    with pytest.raises(Exception, match="--no-such"):
        parsed(["run", "x.toml", "--no-such", "1"])


@pytest.mark.parametrize(
    "block",
    [
        pytest.param(block, id=f"{page.stem}:{block.line}")
        for page, block in BLOCKS
        if block.kind == "toml"
    ],
)
def test_toml_is_valid(block):
    """Run files, whole ones and parts, and the constants of materials."""
    found = tomllib.loads(block.body)
    if "kind" in found:
        from_constants(found)
    else:
        check(found)


def test_python_is_python():
    found = [block for _, block in BLOCKS if block.kind == "python"]
    assert len(found) > 10
    for block in found:
        ast.parse(block.body)


def test_nothing_is_shown_that_is_not_run():
    """Languages that no test knows, and what cannot be run."""
    assert {block.kind for _, block in BLOCKS} <= {
        "console",
        "python",
        "output",
        "toml",
        "text",
        "diff",
    }
    left = [
        pages.typed(shown)
        for _, b in BLOCKS
        if b.kind == "console"
        for shown, _ in pages.commands(b.body)
    ]
    left = [command for command in left if not pages.is_run(command)]
    assert all(command.startswith("pip install") for command in left), left
    # Slurm
    assert (
        len([b for _, b in BLOCKS if b.kind == "python" and not pages.is_run(b.body)])
        == 1
    )


def test_pictures_are_drawn_by_commands():
    """And every picture that a page shows is there."""
    shown = {
        (page.parent / path).resolve()
        for page in [ROOT / "README.md", *DOCS.rglob("*.md")]
        for path in re.findall(r"!\[.*?\]\((.+?)\)", page.read_text(encoding="utf-8"))
    }
    assert [path for path in shown if not path.exists()] == []
    found = set((DOCS / "pictures").glob("*.png"))
    assert found - shown == set()
    measured = {"ns-by-part.png"}  # by benchmarks
    # by an analysis of minutes, and a fit of half an hour
    measured |= {"rate-and-state-contacts.png", "basalt-contacts.png"}
    measured |= {"precursors.png", "front-speeds.png"}  # by a notebook
    assert {path.name for path in found} - {"readme.png"} - measured == set(
        pages.pictures()
    )
    assert sum(path.stat().st_size for path in found) < 4_000_000


@pytest.mark.parametrize(
    ("shown", "found", "same"),
    [
        ("a 1\n", "a 1\n", True),
        (
            "65 k lives in 0.14 s (462 k/s), 2 threads\n",
            "65 k lives in 3.1 s (1.2 M/s), 16 threads\n",
            True,
        ),
        ("│ x │ 2.3e-11 │\n", "│ x │ 9.9e-13 │\n", True),
        ("friction 0.97\n", "friction 0.98\n", False),
        ("a\n...\nz\n", "a\nb\nc\nz\n", True),
        ("a\n...\nz\n", "a\nb\n", False),
        ("│ x_* │ 2.1e-09 │\n", "│ x_* │ 2.2e-08 │\n", False),
    ],
)
def test_outputs_are_compared(shown, found, same):
    assert pages.agree(shown, found) is same


def test_outputs_have_a_shape():
    assert pages.shape("v  1.5 NaN\n") == pages.shape("v -2 0.25\n")
    assert pages.shape("v 1.5\n") != pages.shape("w 1.5\n")
    assert pages.shape("v 1.5 2\n") != pages.shape("v 1.5\n")


def test_a_wrong_output_is_noticed(tmp_path):
    page = ROOT / "docs" / "x.md"
    text = "```console\n$ echo 1\n2\n$ false\n```\n\n```python\nprint(3)\n```\n\n```output\n4\n```\n"

    class Page(type(page)):
        def read_text(self, **_):
            return text

    new, differences = pages.run(Page(page), tmp_path)
    assert [one.found for one in differences] == ["1\n", "[exit code 1]\n", "3\n"]
    assert new == text.replace("2\n$", "1\n$").replace(
        "false\n", "false\n[exit code 1]\n"
    ).replace("4\n", "3\n")


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=names)
def test_what_is_shown_is_what_happens(page, tmp_path):
    """`python tests/pages.py` writes outputs anew that are meant to change."""
    _, differences = pages.run(page, tmp_path)
    assert not differences, "\n".join(map(str, differences))
