"""The numbers of equations and figures in the published article, beside the labels that
the code cites."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from eqsim.cli.app import app
from eqsim.paper import EQUATIONS, FIGURES, equation, figure, numbered, printed

ROOT = Path(__file__).parents[2]
LABEL = re.compile(r"\b(nt\d\d[ab]?|star\d[abc]?|temper\d+|Q\d+[abG]*|eq:\w+)\b")


def test_every_label_that_the_code_cites_has_a_number():
    """Of groups, such as star4, all their members."""
    cited = set()
    for folder in ("eqsim", "analysis"):
        for path in (ROOT / folder).rglob("*.py"):
            cited |= set(LABEL.findall(path.read_text(encoding="utf-8")))
    assert len(cited) > 20
    assert {
        label
        for label in cited
        if not re.fullmatch(r"Eqs?\. \d+(-\d+)?", printed(label))
    } == set()


def test_numbers():
    """From one on, each once; the article refers to b as Eq. 21 and to the crossover
    velocity as Eq. 26."""
    assert sorted(EQUATIONS.values()) == list(range(1, 50))
    assert sorted(FIGURES.values()) == list(range(1, 8))
    assert equation("nt08a") == "Eq. 21, nt08a"
    assert printed("star4") == "Eqs. 45-47"
    assert figure("A03") == "A03 (Fig. 6)"
    assert numbered("nt16, printed") == "Eq. 31, printed"
    assert numbered("x_star, annealed") == "x_star, annealed"
    with pytest.raises(LookupError):
        printed("nt99")


def test_where_they_are_shown(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "a.toml").write_text("[thermal]\nkT = 0.1\n[drive]\nvelocity = 0.1\n")
    for command in (["info", str(tmp_path / "a.toml")], ["material", "steel"]):
        shown = CliRunner().invoke(app, command).stdout
        assert "Eq. 21, nt08a" in shown
        assert "Phys. Rev. E 83, 046129 (2011)" in shown
