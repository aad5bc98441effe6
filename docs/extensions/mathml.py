"""Formulas as MathML, which browsers draw themselves: no script from elsewhere, and LaTeX is checked by the build."""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging


def converted(node: nodes.Element, display: str) -> str:
    """MathML of a formula; a warning if it cannot be converted."""
    source = node.astext().replace(
        "{aligned}", "{split}"
    )  # the same, and known to the converter
    try:
        found = convert(source, display=display)
    except Exception as error:
        found = f"<code>{source}</code>"
        logging.getLogger(__name__).warning("%s in %s", error, source, location=node)
    found = re.sub(
        "(<mi>(?:ln|exp|max|min)</mi>)(?=<m(?:i|n|sup|sub)>)",
        r'\1<mspace width="0.17em" />',
        found,
    )
    unknown = re.search(r">(\\[A-Za-z]+|&)<", found)
    if unknown:
        logging.getLogger(__name__).warning(
            "%s is unknown in %s", unknown[1], source, location=node
        )
    return found


def inline(self: Any, node: nodes.Element) -> None:
    self.body.append(converted(node, "inline"))
    raise nodes.SkipNode


def block(self: Any, node: nodes.Element) -> None:
    self.body.append(f'<div class="formula">{converted(node, "block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
