"""The house rules that a machine can check: style, types, direction of imports, the README's promises."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("command", [["ruff", "check", "."], ["ruff", "format", "--check", "."], ["mypy"]])
def test_style_and_types(command):
    run(sys.executable, "-m", *command)


def test_imports_point_downward():
    run(sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()")


# What else each comparison would allow: 1e-12 (approx), 1e-8 (isclose, allclose), 1e-7 of the value (assert_allclose).
TOLERANCES = {
    "approx": {"abs"},
    "isclose": {"rtol", "atol"},
    "allclose": {"rtol", "atol"},
    "assert_allclose": {"rtol"},
    "math.isclose": {"rel_tol"},
}


def unstated(source):
    """Lines that leave a tolerance to a default, which may be wider than the one that is stated beside it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            needed = TOLERANCES.get(name) or TOLERANCES.get(name.rpartition(".")[2], set())
            if needed - {keyword.arg for keyword in node.keywords}:
                yield node.lineno


def test_tolerances_are_stated():
    found = {path.name: [*unstated(path.read_text(encoding="utf-8"))] for path in (ROOT / "tests").glob("*.py")}
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


def test_readme_commands_are_what_ci_runs():
    readme, ci = (ROOT / "README.md").read_text(), (ROOT / ".ci" / "run").read_text()
    for line in ("pip install -e . && eqsim run runs/quickstart.toml", 'pip install -e ".[test]" && pytest'):
        assert line in readme
        assert line in ci


def test_readme_names_every_room_and_every_name_it_shows_exists():
    import eqsim

    readme = (ROOT / "README.md").read_text()
    for path in (ROOT / "eqsim").rglob("*.py"):
        if path.name not in ("__init__.py",):
            assert path.name in readme, f"{path.name} is missing from the README's table of rooms"
    for name in re.findall(r"from eqsim import (.+)", readme):
        assert all(hasattr(eqsim, word.strip()) for word in name.split(","))


@pytest.mark.parametrize("path", sorted((ROOT / "runs").glob("*.toml")), ids=lambda path: path.stem)
def test_committed_run_files_are_valid(path):
    from eqsim import load

    file = load(path)
    assert file.title
    assert file.ensemble(path.parent).count > 0
    assert file.driven().velocity > 0
