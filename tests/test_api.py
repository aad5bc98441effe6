"""The public names: what a type checker and a user see of them."""

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

import eqsim
from eqsim import Ensemble, InputError, Programme, Thermal

ROOT = Path(__file__).parent.parent
USER = """\
import eqsim
from eqsim import Drive, Ensemble, Thermal, reference, steady
found = steady(Ensemble(thermal=Thermal(kT=0.1)), Drive(velocity=0.1)).friction.value
reveal_type(eqsim.__version__)
reveal_type(found)
reveal_type(Ensemble)
reference(Ensemble(), 0.1)
eqsim.Ensembel
"""


@pytest.mark.long
def test_a_type_checker_sees_classes(tmp_path):
    """Their fields and mistakes in calls, also if it is strict; and no mistake in the
    package."""
    (tmp_path / "user.py").write_text(USER)
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--no-error-summary",
        "--cache-dir",
        str(tmp_path),
    ]
    done = subprocess.run(
        [*command, "eqsim", str(tmp_path / "user.py")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    said = [line.partition("user.py:")[2] for line in done.stdout.splitlines()]
    assert said[:2] == [
        '4: note: Revealed type is "str"',
        '5: note: Revealed type is "float | None"',
    ], done.stdout
    assert said[2].startswith('6: note: Revealed type is "def (thresholds: ')
    assert said[3].startswith(
        '7: error: Argument 2 to "reference" has incompatible type "float"; expected "Drive"'
    )
    assert said[4].startswith('8: error: Module has no attribute "Ensembel"')
    assert len(said) == 5


def test_public_names():
    assert eqsim.__version__ == metadata.version("eqsim")
    names: dict[str, object] = {}
    exec("from eqsim import *", names)
    assert set(eqsim.__all__) <= set(names)
    assert names["run"] is eqsim.workflows.run.run
    assert names["Newborn"] is eqsim.laws.newborn.Newborn
    with pytest.raises(
        AttributeError, match="module 'eqsim' has no attribute 'Ensembel'"
    ):
        eqsim.Ensembel  # noqa: B018


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: Ensemble(Thermal(0.1)),
            "thresholds = Thermal(kT=0.1, attempt_frequency=1.0, barrier='soft'): must be a law",
        ),
        (lambda: Ensemble(thermal=0.1), "thermal = 0.1: must be Thermal(...)"),
        (lambda: Programme([0.1]), "programme: holds 0.1; must be Segment("),
    ],
)
def test_arguments_of_another_kind_are_named(call, said):
    with pytest.raises(InputError, match=re.escape(said)):
        call()
