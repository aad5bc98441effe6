"""The rules that a machine can check: style, types, direction of imports, sizes, what
the README and others promise. Commands and blocks of Python in them are those of
system/test_docs.py."""

import ast
import functools
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from analysis import reference_pages
from eqsim.numerics import kernel_folder
from tests import mutations

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
HOOKS = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))[
    "repos"
][0]["hooks"]


def run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    "hook",
    [hook for hook in HOOKS if hook["id"] != "mypy"],
    ids=lambda hook: hook["id"],
)
def test_linters(hook):
    """Those of pre-commit: style, and the direction of imports; types are those of
    system/test_api.py."""
    name, *arguments = shlex.split(hook["entry"])
    run(Path(sys.executable).with_name(name), *arguments)


def test_no_linter_is_missing():
    assert [hook["id"] for hook in HOOKS] == [
        "ruff-check",
        "ruff-format",
        "mypy",
        "import-linter",
    ]
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for hook in HOOKS:
        assert hook["entry"] in contributing


@functools.cache
def parsed(folder):
    """The syntax of every source file below a folder."""
    return {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted((ROOT / folder).rglob("*.py"))
    }


def functions(folder):
    """Every function below a folder: where it is, and its syntax."""
    for path, file in parsed(folder).items():
        for node in ast.walk(file):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{path.relative_to(ROOT)}: {node.name}", node


def values(annotation):
    """How many values a parameter brings: the members of an anonymous tuple; one of any
    other type, which has a name for what belongs together."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        return values(ast.parse(annotation.value, mode="eval").body)
    if isinstance(annotation, ast.BinOp):
        return max(values(annotation.left), values(annotation.right))
    if not isinstance(annotation, ast.Subscript) or ast.unparse(
        annotation.value
    ) not in ("tuple", "Tuple"):
        return 1
    members = (
        annotation.slice.elts
        if isinstance(annotation.slice, ast.Tuple)
        else [annotation.slice]
    )
    if any(
        isinstance(member, ast.Constant) and member.value is ... for member in members
    ):
        return 1  # as many of a kind as there are: a sequence
    return sum(map(values, members))


def count_values(node):
    """How many values a function is called with."""
    given = node.args
    arguments = [
        *given.posonlyargs,
        *given.args,
        *given.kwonlyargs,
        given.vararg,
        given.kwarg,
    ]
    return sum(
        values(one.annotation)
        for one in arguments
        if one and one.arg not in ("self", "cls")
    )


def test_functions_have_at_most_eight_values():
    """A tuple of three numbers is three values, however it is passed."""
    found = [(where, count_values(node)) for where, node in functions("eqsim")]
    assert len(found) > 500
    assert {where: count for where, count in found if count > 8} == {}
    for source, count in (
        ("def f(self, a, b: int, *c: float, d: str = '', **e): ...", 5),
        ("def f(a: tuple[int, float, tuple[Array, Array]]): ...", 4),
        ("def f(a: 'tuple[int, int] | None', b: Lives): ...", 3),
        ("def f(a: tuple[float, ...], b: dict[str, tuple[int, int]]): ...", 2),
    ):
        assert count_values(ast.parse(source).body[0]) == count, source


def test_columns_have_names():
    """What belongs together is a type with fields, not an array whose columns are
    numbered."""
    numbers = re.compile(r"= range\(\d+\)")
    found = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "eqsim").rglob("*.py")
        if numbers.search(path.read_text())
    }
    assert found == set()


def test_commands_have_at_most_seventy_lines():
    found = {
        where: node.end_lineno - node.lineno + 1
        for where, node in functions("eqsim/cli")
    }
    assert len(found) > 20
    assert {where: lines for where, lines in found.items() if lines > 70} == {}


def test_every_folder_is_a_package():
    """A folder without a module of its own would be found by some imports only."""
    folders = {path.parent for path in (ROOT / "eqsim").rglob("*.py")}
    assert all((folder / "__init__.py").exists() for folder in folders)


# Of a CITATION.cff and of the works it refers to: what the schema of version 1.2.0
# requires, and what else it knows.
REQUIRED = {"cff-version", "message", "title", "authors"}
KNOWN = REQUIRED | {
    "abstract", "commit", "contact", "date-released", "doi", "identifiers", "keywords", "license", "license-url",
    "preferred-citation", "references", "repository", "repository-artifact", "repository-code", "type", "url",
    "version",
}  # fmt: skip
PERSON = {
    "family-names",
    "given-names",
    "name-particle",
    "name-suffix",
    "affiliation",
    "orcid",
    "email",
    "alias",
}
ENTITY = {"name", "website", "email", "orcid", "alias"}


def test_citation():
    """By hand what `cffconvert --validate` says, which would bring an old jsonschema
    along."""
    found = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert found["cff-version"] == "1.2.0"
    assert REQUIRED <= found.keys() <= KNOWN
    assert (found["title"], found["version"], found["license"]) == (
        PROJECT["project"]["name"],
        PROJECT["project"]["version"],
        PROJECT["project"]["license"],
    )
    assert found["type"] in ("software", "dataset")
    assert found["keywords"] == PROJECT["project"]["keywords"]
    assert found["authors"] == PROJECT["project"]["authors"]
    for work in (found, *found["references"]):
        assert {"authors", "title", "type"} <= work.keys()
        assert all(isinstance(work[name], str) for name in ("title", "type"))
        assert work["authors"]
        assert all(
            set(who) <= PERSON or ("name" in who and set(who) <= ENTITY)
            for who in work["authors"]
        )
        assert re.fullmatch(r"10\.\d{4,9}/\S+", work.get("doi", "10.1000/none"))
    assert f'"eqsim, version {found["version"]}"' in README


# What else each comparison would allow: 1e-12 (approx), 1e-8 (isclose, allclose), 1e-7
# of the value (assert_allclose).
TOLERANCES = {
    "approx": {"abs"},
    "isclose": {"rtol", "atol"},
    "allclose": {"rtol", "atol"},
    "assert_allclose": {"rtol"},
    "math.isclose": {"rel_tol"},
}


def unstated(source):
    """Lines that leave a tolerance to a default, which may be wider than the one that
    is stated beside it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            needed = TOLERANCES.get(name) or TOLERANCES.get(
                name.rpartition(".")[2], set()
            )
            if needed - {keyword.arg for keyword in node.keywords}:
                yield node.lineno


def test_tolerances_are_stated():
    found = {
        path.name: [*unstated(path.read_text(encoding="utf-8"))]
        for path in (ROOT / "tests").rglob("*.py")
    }
    assert {name: lines for name, lines in found.items() if lines} == {}
    for right in (
        "pytest.approx(y, rel=1e-9, abs=0)",
        "pytest.approx(y, abs=1e-9)",
        "math.isclose(x, y, rel_tol=1e-9)",
    ):
        assert not [*unstated(right)], right
    for wrong in (
        "pytest.approx(y)",
        "x == pytest.approx(y, rel=1e-9)",
        "x == approx(y, 1e-9)",
        "np.all(np.isclose(x, y, atol=1e-9))",
        "np.allclose(x, y, rtol=1e-9)",
        "np.testing.assert_allclose(x, y, atol=1e-9)",
        "math.isclose(x, y)",
    ):
        assert [*unstated(wrong)] == [1], wrong


@pytest.mark.long
def test_deliberate_mistakes_can_be_made():
    """Their texts are still there, once each."""
    run(sys.executable, "tests/mutations.py", "--list")


def compiled_functions():
    """File, and syntax, of every function that may become machine code."""
    for path, file in parsed("eqsim").items():
        known = mutations.compilers(file)
        for node in ast.walk(file):
            if isinstance(node, ast.FunctionDef) and mutations.is_compiled(node, known):
                yield path, node


def unknown_decorators(file, compiling):
    """Decorators of a file of which `mutations` cannot know whether they compile: they
    are made in eqsim, by a module that compiles."""
    known, suspects = mutations.compilers(file), mutations.compilers(file, compiling)
    if known:
        suspects |= {
            node.name for node in file.body if isinstance(node, ast.FunctionDef)
        }
    for node in ast.walk(file):
        if isinstance(node, ast.FunctionDef) and not mutations.is_compiled(node, known):
            for decorator in node.decorator_list:
                if suspects & {
                    inner.id
                    for inner in ast.walk(decorator)
                    if isinstance(inner, ast.Name)
                }:
                    yield f"{node.name}: {ast.unparse(decorator)}"


def test_no_decorator_is_unknown():
    """Each comes from a module that `mutations` knows to compile, or from one that does
    not compile."""
    files = parsed("eqsim")
    compiling = tuple(
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path, file in files.items()
        if mutations.compilers(file)
    )
    assert len(compiling) > 20
    for path, file in files.items():
        assert [*unknown_decorators(file, compiling)] == [], path
    for source in (
        "from eqsim.engine.lanes import vectorised\n@vectorised\ndef f(x): return x",
        "from numba import njit\ndef fast(f): return njit(f)\n@fast\ndef g(x): return x",
    ):
        assert [*unknown_decorators(ast.parse(source), compiling)], source


def test_mistakes_in_kernels_are_judged_beside_kernels_that_have_them():
    """However a decorator of the compiler is imported, what it makes counts as
    compiled, and a mistake in its body as one in compiled code. Plain Python does not.
    """
    assert len([*compiled_functions()]) > 250
    for head, decorator in (
        ("from eqsim.numerics.compiled import kernel", "kernel"),
        ("from eqsim.numerics.compiled import by_law as choose", "choose"),
        (
            "from eqsim.numerics.compiled import by_law",
            "functools.partial(by_law, makes_arrays=True)",
        ),
        ("from eqsim.numerics import compiled", "compiled.inlined"),
        ("import eqsim.numerics.compiled", "eqsim.numerics.compiled.inlined"),
        ("from numba.extending import overload", "overload(f)"),
        ("import numba as nb", "nb.njit(cache=True)"),
        ("from eqsim.laws.barrier.base import spend", "spend.register(Law)"),
    ):
        file = ast.parse(f"{head}\n@{decorator}\ndef g(x): return x")
        assert mutations.is_compiled(file.body[-1], mutations.compilers(file)), head
    for head, decorator in (("import functools", "functools.cache"), ("", "property")):
        file = ast.parse(
            f"{head}\nfrom eqsim.numerics.compiled import kernel\n@{decorator}\ndef g(x): return x"
        )
        assert not mutations.is_compiled(file.body[-1], mutations.compilers(file)), head
    named = {mistake.name: mistake for mistake in mutations.MISTAKES}
    # of a routine that kernels share
    assert mutations.needs_kernels(named["lives: both rounds alike at T > 0"])
    assert not mutations.needs_kernels(named["gamma: rms threshold"])


def test_the_sources_of_kernels_name_their_folder(tmp_path, monkeypatch):
    """Any file with compiled code: a mistake there gets a folder of its own, where no
    kernel lacks it. A file without leaves the name as it is."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    shutil.copytree(
        ROOT / "eqsim", tmp_path / "eqsim", ignore=shutil.ignore_patterns("__pycache__")
    )
    monkeypatch.setattr(kernel_folder, "_PACKAGE", tmp_path / "eqsim")

    def name_after_an_edit(path):
        source = path.read_bytes()
        path.write_bytes(source + b"\n# edited\n")
        try:
            return kernel_folder.kernel_folder.__wrapped__()
        finally:
            path.write_bytes(source)

    parts = {tmp_path / "eqsim" / part for part in kernel_folder.KERNEL_SOURCES}
    before = kernel_folder.kernel_folder.__wrapped__()
    sources = sorted(
        {tmp_path / path.relative_to(ROOT) for path, _ in compiled_functions()}
    )
    assert len(sources) > 25
    assert all(part.exists() for part in parts)
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert all(
        f"`eqsim/{part}`" in contributing for part in kernel_folder.KERNEL_SOURCES
    )
    assert [path for path in sources if not parts & {path, *path.parents}] == []
    assert [path.name for path in sources if name_after_an_edit(path) == before] == []
    assert name_after_an_edit(tmp_path / "eqsim" / "io" / "runfile.py") == before


def test_readme_commands_are_what_ci_runs():
    ci = (ROOT / ".ci" / "run").read_text()
    for line in (
        "pip install -e . && eqsim run runs/quickstart.toml",
        'pip install -e ".[test]" && pytest',
    ):
        assert line in README
        assert line in ci


def test_every_module_has_a_place():
    """Each row of the table of the architecture begins with a folder and the modules in
    it, and none is missing."""
    table = (ROOT / "docs" / "reference" / "architecture.md").read_text(
        encoding="utf-8"
    )
    named = set()
    for row in re.findall(r"^\| (`eqsim/.*?) \|", table, re.MULTILINE):
        folder, *names = re.findall(r"`(.+?)`", row)
        assert folder.endswith("/")
        named |= {folder + name for name in names}
    found = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "eqsim").rglob("*.py")
        if path.name != "__init__.py"
    }
    assert named == found


def test_paths_and_links_exist():
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        text = re.sub(
            r"```.*?```", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL
        )
        links = [
            link.partition("#")[0]
            for link in re.findall(r"\]\(([^)]+)\)", text)
            if "://" not in link
        ]
        paths = re.findall(
            r"`((?:eqsim|analysis|tests|notebooks|runs)/[\w./-]*)`", text
        )
        for path in {*links, *paths} - {"", "eqsim/laws/barrier/linear.py"}:
            assert (ROOT / path).exists() or path.startswith(
                ("runs/out/", "analysis/out/")
            ), f"{name}: {path}"


@pytest.mark.parametrize(
    "path", sorted((ROOT / "runs").glob("*.toml")), ids=lambda path: path.stem
)
def test_committed_run_files_are_valid(path):
    from eqsim import load

    file = load(path)
    assert file.title
    assert file.ensemble.count > 0
    assert file.drive


def test_reference_pages_are_those_of_the_program():
    """`python -m analysis.reference_pages` would change nothing."""
    for page, text in reference_pages.pages().items():
        assert text == page.read_text(encoding="utf-8"), page
