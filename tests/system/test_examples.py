"""The examples of docstrings run, and give what they say."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

import eqsim
from eqsim.paper import EQUATIONS
from eqsim.results import Result
from eqsim.workflows.report import FileResult

ROOT = Path(__file__).parents[2]
# classes of which functions make the instances, as they make results
MADE = {
    "FitResult",
    "InputError",
    "Posterior",
    "RateAndStateFit",
    "Replay",
    "RunFile",
    "Slip",
    "Validation",
}


def modules() -> list[str]:
    """Modules of the package with an example."""
    files = sorted((ROOT / "eqsim").rglob("*.py"))
    found = [path.relative_to(ROOT) for path in files if ">>> " in path.read_text()]
    return [".".join(path.with_suffix("").parts) for path in found]


@pytest.mark.parametrize("name", modules())
def test_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name.removesuffix(".__init__"))
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    failed, tried = doctest.testmod(module, optionflags=flags)
    assert tried
    assert not failed


def public():
    """Public names, but for results and constants."""
    known = {name: getattr(eqsim, name) for name in eqsim.__all__}
    return {
        name: one
        for name, one in known.items()
        if name not in MADE
        and callable(one)
        and not (isinstance(one, type) and issubclass(one, Result | FileResult))
    }


def test_what_a_user_calls_has_an_example_and_says_what_it_raises():
    found = public()
    assert len(found) > 40
    for name, one in found.items():
        assert "\n    Examples\n    --------\n    >>> " in one.__doc__, name
    quiet = {"z_score", "Estimate"}  # and take anything
    assert {x for x, one in found.items() if "InputError" not in one.__doc__} == quiet


def test_public_docstrings_can_be_read_alone():
    """They cite equations of the paper by number, not by the labels of its source."""
    labels = re.compile(rf"(?<![\w.])({'|'.join(sorted(EQUATIONS)[::-1])})(?!\w)")
    every = {name: getattr(eqsim, name) for name in eqsim.__all__}
    for name, one in vars(eqsim.materials).items():
        if getattr(one, "__module__", "") == "eqsim.materials":
            every[name] = one
    for name, one in every.items():
        docs = [one.__doc__ or ""]
        if isinstance(one, type):
            docs += [part.__doc__ or "" for part in vars(one).values()]
        for text in docs:
            assert not set(labels.findall(text)) - {"L", "Bx"}, (name, text)
