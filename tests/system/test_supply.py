"""What eqsim stands on: dependencies that are declared, used and free, their lowest
versions, and a wheel that needs nothing of the source tree."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# ask for no more than a notice
FREE = re.compile(
    r"MIT|BSD|Apache|PSF|Python Software Foundation|ISC|Zlib|CC0|HPND|Unlicense"
)
BOUND = re.compile(
    r"GPL|AGPL|SSPL|Commons Clause|Proprietary|Non-?Commercial", re.IGNORECASE
)


def imported(*folders):
    """Top-level packages that the sources import, wherever in a file."""
    found = set()
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).split(".")[0])
    return found


def names(requirements):
    return {Requirement(line).name for line in requirements}


def test_dependencies_are_used_and_declared():
    """No declared dependency that the package does not import, and no import that is
    not declared."""
    declared, found = names(PROJECT["dependencies"]), imported("eqsim", "analysis")
    assert declared - found == set()
    # imported where it is asked for
    optional = names(PROJECT["optional-dependencies"]["dask"])
    assert found - declared - optional <= set(sys.stdlib_module_names) | {
        "eqsim",
        "analysis",
    }


def closure(name, seen):
    """`name` and all that it requires, without extras."""
    name = re.sub(r"[-_.]+", "-", name).lower()
    if name in seen:
        return
    seen[name] = metadata.metadata(name)
    for line in metadata.requires(name) or []:
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
            closure(requirement.name, seen)


def licence(about):
    """What a package says of its licence: an expression, or else a classifier, or else
    free text."""
    classifiers = [
        line
        for line in about.get_all("Classifier") or []
        if line.startswith("License ::")
    ]
    return (
        about.get("License-Expression")
        or " ".join(classifiers)
        or about.get("License")
        or "none"
    )


def test_licences():
    """All that is installed with eqsim may be used, changed and passed on by anybody."""
    seen = {}
    closure("eqsim", seen)
    assert len(seen) > 20
    for name, about in seen.items():
        said = licence(about)
        assert FREE.search(said), f"{name}: {said}"
        assert not BOUND.search(said), f"{name}: {said}"
    # negative control
    assert BOUND.search(
        "License :: OSI Approved :: GNU General Public License v3 (GPLv3)"
    )


def python_of(folder):
    """The interpreter of a new virtual environment."""
    venv.create(folder, with_pip=True)
    return folder / "bin" / "python"


def call(*command, **options):
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "NUMBA_CACHE_DIR")
    }
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        env=environment,
        **options,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


def wheel(folder):
    """eqsim's wheel, built from a copy of what is in version control."""
    source = folder / "source"
    for name in subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    call(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, source)
    shutil.rmtree(source)
    (found,) = folder.glob("eqsim-*.whl")
    return found


@pytest.mark.long
def test_wheel_needs_no_source(tmp_path):
    """Built, and installed where nothing else is but the dependencies; then a run, and
    a figure's script."""
    python = python_of(tmp_path / "venv")
    call(python, "-m", "pip", "install", "-q", "--no-deps", wheel(tmp_path))
    site = Path(
        call(
            python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])"
        ).strip()
    )
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"])
    shutil.copy(ROOT / "runs" / "quickstart.toml", tmp_path)
    where = call(
        python,
        "-c",
        "import eqsim; print(eqsim.__file__)",
        cwd=tmp_path,
    )
    assert all(Path(path).is_relative_to(site) for path in where.split())
    eqsim = python.with_name("eqsim")
    call(
        eqsim,
        "run",
        "quickstart.toml",
        "--set",
        "contacts.count=1000",
        "--out",
        "found",
        cwd=tmp_path,
    )
    assert (tmp_path / "found" / "trajectory.parquet").exists()


@pytest.mark.long
def test_lowest_versions(tmp_path):
    """The lowest version of every dependency that is declared, and a part of the tests
    with them."""
    python = python_of(tmp_path / "venv")
    lowest = [line.replace(">=", "==") for line in PROJECT["dependencies"]]
    tools = [
        line
        for line in PROJECT["optional-dependencies"]["test"]
        if re.match("pytest|hypothesis|mpmath", line)
    ]
    call(python, "-m", "pip", "install", "-q", *lowest, *tools)
    call(python, "-m", "pip", "install", "-q", "--no-deps", wheel(tmp_path))
    for name, version in (line.split("==") for line in lowest):
        found = call(
            python,
            "-c",
            f"from importlib.metadata import version; print(version('{name}'))",
        ).strip()
        assert f"{found}.0.0".startswith(f"{version}.")
    for folder in ("tests", "runs"):
        shutil.copytree(
            ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("out")
        )
    files = [
        "runfile",
        "elementary",
        "octaves",
        "lives",
        "reference",
        "materials",
        "portable",
    ]
    tests = tmp_path / "tests"
    paths = [path for name in files for path in tests.rglob(f"test_{name}.py")]
    call(
        python,
        "-m",
        "pytest",
        "-q",
        "-n",
        "2",
        "-o",
        "pythonpath=. tests",
        "--rootdir",
        tmp_path,
        *paths,
        cwd=tmp_path,
    )
