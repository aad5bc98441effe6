"""What the documentation shows: commands and Python, run page by page, and compared
with the output that is shown.

    python tests/pages.py [PAGE.md ...]

runs the pages (all of them without a name), writes the outputs that differ and the
pictures anew, to be looked at before a commit.

A page is Markdown. Of its blocks, in their order and in one folder per page, which
holds a copy of `runs/`:

- `console`: lines that begin with `$ ` are run, the others are their output;
- `python`: is run, all blocks of a page in one namespace; an `output` block right after it is what it prints;
- any block with a `:caption:` that is the name of a file is written there.

In outputs, `...` stands for anything; numbers that Python prints are not compared where
it says that they differ from version to version; times and speeds, and errors of
rounding (below 1e-9), are not compared.
"""

import io
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import tomllib
import traceback
from contextlib import redirect_stdout
from pathlib import Path
from typing import NamedTuple

from PIL import Image

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
WIDTH = 92  # of a terminal, in characters: what a page has room for
FENCE = re.compile(
    r"^```(?:\{code-block\} *)?(?P<kind>[\w-]+) *\n(?P<options>(?::\w+:[^\n]*\n)*)(?P<body>.*?)^``` *$",
    re.DOTALL | re.MULTILINE,
)
VARIES = "# differs from version to version"  # in Python whose output has the random numbers of a sweep
NOT_RUN = (
    "pip install",
    "git clone",
    "sbatch",
    "python -m venv",
    "dask_jobqueue",
    "pytest",
    "sphinx-build",
    "gh ",
)


class Block(NamedTuple):
    """A fenced block of a page: where its body begins and ends in the text."""

    kind: str
    caption: str
    body: str
    begin: int
    end: int
    line: int


def blocks(text: str) -> list[Block]:
    """The blocks of a page, in their order."""
    found = []
    for match in FENCE.finditer(text):
        caption = re.search(r":caption: *(.+)", match["options"])
        line = text.count("\n", 0, match.start("body")) + 1
        name = caption[1].strip() if caption else ""
        found.append(
            Block(
                match["kind"],
                name,
                match["body"],
                match.start("body"),
                match.end("body"),
                line,
            )
        )
    return found


def commands(body: str) -> list[tuple[str, str]]:
    """What is typed in a console block, and the output that is shown of it. A line that
    ends in a backslash goes on."""
    found: list[tuple[str, str]] = []
    continued = False
    for line in body.splitlines(keepends=True):
        if continued:
            found[-1] = found[-1][0] + line, ""
        elif line.startswith("$ "):
            found.append((line, ""))
        elif found:
            found[-1] = found[-1][0], found[-1][1] + line
        else:
            raise ValueError(f"output before a command: {line!r}")
        continued = line.endswith("\\\n") and not found[-1][1]
    return found


def typed(shown: str) -> str:
    """The command of what is typed after a prompt."""
    return shown.removeprefix("$ ").replace("\\\n", " ").strip()


def is_run(text: str) -> bool:
    """Whether a command or a block of Python can be run in a test at all."""
    return not any(part in text for part in NOT_RUN)


def plain(output: str) -> str:
    """An output without what differs from run to run and from machine to machine."""
    # of what takes long
    output = re.sub(r"^about .+ to go: .+\n", "", output, flags=re.MULTILINE)
    output = re.sub(r"\d[\d.]* ?[kMG]?/s", "#/s", output)
    output = re.sub(r"\d[\d.]* (s|ms|min)\b", "# s", output)
    output = re.sub(r"\b\d+ (threads?|workers?)\b", r"# \1", output)
    output = re.sub(
        r"-?\d(\.\d+)?e-(1[0-9]|09)\b(?=.*│|$)", "#", output, flags=re.MULTILINE
    )
    return "\n".join(line.rstrip() for line in output.strip("\n").splitlines())


def shape(output: str) -> str:
    """An output without its numbers."""
    return " ".join(re.sub(r"-?\d+(\.\d+)?|NaN", "#", output).split())


def agree(shown: str, found: str) -> bool:
    """Whether an output is the one that is shown."""
    parts = [re.escape(part) for part in plain(shown).split("...")]
    return re.fullmatch(".*?".join(parts), plain(found), re.DOTALL) is not None


class Difference(NamedTuple):
    """An output that is not what a page shows."""

    page: str
    line: int
    what: str
    shown: str
    found: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.what}\n--- shown\n{self.shown}\n--- found\n{self.found}"


class Session:
    """A reader who types what a page shows."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.names = folder, {"__name__": "__page__"}
        shutil.copytree(
            ROOT / "runs", folder / "runs", ignore=shutil.ignore_patterns("out")
        )
        programs = folder / ".bin"
        programs.mkdir()
        for name, module in (("eqsim", "-m eqsim"), ("python", "")):
            script = programs / name
            script.write_text(
                f'#!/bin/sh\nexec "{sys.executable}" {module} "$@"\n', encoding="utf-8"
            )
            script.chmod(script.stat().st_mode | stat.S_IXUSR)
        self.environment = os.environ | {
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": os.pathsep.join(
                (str(ROOT), os.environ.get("PYTHONPATH", ""))
            ),
            "COLUMNS": str(WIDTH),
            "MPLBACKEND": "agg",
        }

    def shell(self, command: str) -> str:
        """What a command prints; a line about its exit code if that is neither 0 nor
        explained."""
        done = subprocess.run(
            ["bash", "-c", command], cwd=self.folder, env=self.environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        refused = done.returncode == 2 and re.search(
            "^eqsim: ", done.stdout, re.MULTILINE
        )
        return done.stdout + (
            "" if refused or not done.returncode else f"[exit code {done.returncode}]\n"
        )

    def python(self, source: str, where: str) -> str:
        """What a block of Python prints, its traceback included."""
        printed, before = io.StringIO(), os.getcwd()
        os.chdir(self.folder)
        try:
            with redirect_stdout(printed):
                exec(compile(source, where, "exec"), self.names)
        except Exception:
            printed.write(traceback.format_exc())
        finally:
            os.chdir(before)
        return printed.getvalue()


def run(page: Path, folder: Path) -> tuple[str, list[Difference]]:
    """The text of a page as it should be, and what differs from what it shows."""
    text = page.read_text(encoding="utf-8")
    session, changes, differences = Session(folder), [], []
    name = str(page.relative_to(ROOT))
    every = blocks(text)

    def compare(line: int, what: str, shown: str, found: str) -> str:
        if agree(shown, found) or (VARIES in what and shape(shown) == shape(found)):
            return shown
        differences.append(Difference(name, line, what, shown, found))
        lines = "".join(part.rstrip() + "\n" for part in found.strip("\n").splitlines())
        return lines.replace(str(folder), "...")

    for index, block in enumerate(every):
        if block.caption:
            path = folder / block.caption
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.body, encoding="utf-8")
        if block.kind == "console":
            body = ""
            for shown, output in commands(block.body):
                command = typed(shown)
                if is_run(command):
                    output = compare(
                        block.line, command, output, session.shell(command)
                    )
                body += shown + output
            changes.append((block, body))
        elif block.kind == "python" and is_run(block.body):
            found = session.python(block.body, f"{name}:{block.line}")
            after = every[index + 1] if index + 1 < len(every) else None
            if after and text[block.end : after.begin].split() == ["```", "```output"]:
                changes.append(
                    (after, compare(after.line, block.body, after.body, found))
                )
            elif found:
                differences.append(
                    Difference(
                        name, block.line, "python prints what is not shown", "", found
                    )
                )
    for block, body in reversed(changes):
        text = text[: block.begin] + body + text[block.end :]
    return text, differences


def pages() -> list[Path]:
    """All pages with blocks: the README, and the documentation but for what its build
    copies there."""
    copied = {"CHANGELOG.md", "CONTRIBUTING.md"}
    found = [
        page
        for page in sorted(DOCS.rglob("*.md"))
        if "_build" not in page.parts and page.name not in copied
    ]
    return [
        page
        for page in (ROOT / "README.md", *found)
        if blocks(page.read_text(encoding="utf-8"))
    ]


def pictures() -> dict[str, list[str]]:
    """The page whose commands draw a picture, and where in its folder, by the picture's
    name."""
    return tomllib.loads(
        (DOCS / "pictures" / "sources.toml").read_text(encoding="utf-8")
    )


def store_picture(drawn: Path, target: Path) -> None:
    """Store a picture with 128 colours, which takes a third of the room."""
    with Image.open(drawn) as picture:
        plain = picture.convert("RGB")
    few = plain.quantize(128, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(target, optimize=True)


def main() -> None:
    chosen = [Path(name).resolve() for name in sys.argv[1:]] or pages()
    for page in chosen:
        with tempfile.TemporaryDirectory() as folder:
            text, differences = run(page, Path(folder))
            for name, (source, path) in pictures().items():
                if DOCS / source == page and (Path(folder) / path).exists():
                    store_picture(Path(folder) / path, DOCS / "pictures" / name)
        page.write_text(text, encoding="utf-8")
        print(f"{page.relative_to(ROOT)}: {len(differences)} outputs written anew")
        for difference in differences:
            print(difference, "\n")


if __name__ == "__main__":
    main()
