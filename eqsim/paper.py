"""Equations and figures of the paper: labels of its source text, which the code cites,
and the printed numbers.

Numbered displays and figures are counted as they follow one another in the source.
"""

import re

ARTICLE = "O. M. Braun and M. Peyrard, Phys. Rev. E 83, 046129 (2011)"
NOTE = f"Eq.: of {ARTICLE}; beside it the label in its source"

# Labels of the displays by sections; five without labels follow.
_DISPLAYS = """
II   Q5a PcP Q5aG Q6 Q11a Gamma0 eq:pcf PxPf2 nt01 nt02 nt03 nt03a nt03b nt05 nt06 nt07
III  temper4 temper11 temper12 nt08 nt08a nt09a nt09 nt10 nt11 nt12 nt13 nt14 nt15
     nt15a nt16
IV   L Bx Q15 Q15a Q15b star1 star1a star1b star2 star2a star3a star3b star3c star4a
     star4b star4c
V    eq:ncnf
VI   eq:omeg
"""
_LABELS = re.findall(r"[\w:]+", re.sub(r"\n[IV]+ ", "\n", _DISPLAYS))
EQUATIONS = {label: number for number, label in enumerate(_LABELS, 1)}
_FIGURES = ("A01", "A01num", "A02", "A02ab", "A04", "A03", "A05")
FIGURES = {label: number for number, label in enumerate(_FIGURES, 1)}


def printed(label: str) -> str:
    """The printed number of an equation, "Eq. 21", or of a group, "Eqs. 45-47"."""
    group = [number for one, number in EQUATIONS.items() if one[:-1] == label]
    found = [EQUATIONS[label]] if label in EQUATIONS else group
    return f"Eq. {found[0]}" if len(found) == 1 else f"Eqs. {found[0]}-{found[-1]}"


def equation(label: str) -> str:
    """The citation of an equation: "Eq. 21, nt08a"."""
    return f"{printed(label)}, {label}"


def numbered(text: str) -> str:
    """A text with printed numbers in the place of labels, as in a legend."""
    return re.sub(
        r"\b(nt\d\d[ab]?|star\d[abc]?)\b", lambda found: printed(found[1]), text
    )


def figure(label: str) -> str:
    """The citation of a figure: "A01 (Fig. 1)"."""
    return f"{label} (Fig. {FIGURES[label]})"
