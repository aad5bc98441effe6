"""The documentation: sphinx-build -W -b html docs docs/_build"""

import shutil
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "extensions"), str(ROOT)]

project = "eqsim"
author = "The eqsim developers"
copyright = author  # Sphinx's name for it
release = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]["version"]

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "numpydoc",
    "sphinxcontrib.bibtex",
    "from_program",
    "mathml",
]
exclude_patterns = ["_build", "jupyter_execute"]
nitpicky = True
default_role = "code"  # `name` in docstrings
templates_path: list[str] = []

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"eqsim {release}"
html_static_path = ["static"]
html_css_files = ["eqsim.css"]

nb_execution_mode = "off"  # notebooks are committed with their results
myst_enable_extensions = [
    "dollarmath",
    "amsmath",
    "deflist",
    "colon_fence",
    "attrs_inline",
]
myst_heading_anchors = 3
bibtex_bibfiles = ["../paper.bib"]
bibtex_default_style = "unsrt"

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say more: units and shapes
autodoc_class_signature = "mixed"
numpydoc_show_class_members = False  # autodoc does

# Notebooks live beside the package, where the tests run them, and texts for contributors where these look for them.
(HERE / "notebooks").mkdir(exist_ok=True)
for path in (HERE / "notebooks").glob("*.ipynb"):
    if not (ROOT / "notebooks" / path.name).exists():
        path.unlink()
for path in (ROOT / "notebooks").glob("*.ipynb"):
    shutil.copy2(path, HERE / "notebooks")
for name in ("CHANGELOG.md", "CONTRIBUTING.md"):
    text = (ROOT / name).read_text(encoding="utf-8")
    (HERE / name).write_text(text.replace("](docs/", "]("), encoding="utf-8")
