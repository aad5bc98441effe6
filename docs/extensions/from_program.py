"""Documentation of public names, from their docstrings."""

from typing import Any

from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import eqsim
from eqsim import api


class PublicNames(SphinxDirective):
    """Check that the page documents every public name: its content lists them in groups."""

    has_content = True

    def run(self) -> list[Any]:
        lines, named = [], []
        for line in self.content:
            name = line.strip()
            if not name or name.startswith("#"):
                lines += ["", name]
                continue
            module, _, last = name.rpartition(".")
            what = (
                getattr(api, name, None)
                if not module
                else getattr(__import__(f"eqsim.{module}", fromlist=[last]), last)
            )
            named += [] if module else [name]
            kind = (
                "autoclass"
                if isinstance(what, type)
                else "autofunction"
                if callable(what)
                else "autodata"
            )
            lines += [
                "```{eval-rst}",
                f".. {kind}:: eqsim.{name}",
                *(["   :members:"] if kind == "autoclass" else []),
                "```",
            ]
        if sorted(named) != sorted(eqsim.__all__):
            raise self.error(
                f"public names and this page differ in {sorted(set(named) ^ set(eqsim.__all__))}"
            )
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("public-names", PublicNames)
    return {"parallel_read_safe": True}
