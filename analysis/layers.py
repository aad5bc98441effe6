"""Sizes of the layers of eqsim in lines, at two times, as a picture.

    python -m analysis.layers [--out layers.png]

Lines are those of the formatter at width 88, blank ones, comments and docstrings
included. Layers stand from high to low: each imports only from those below.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt

import eqsim

ROOT = Path(eqsim.__file__).parent
# Layers from high to low, and their lines before kernels were compiled by plain numba
# and each concept got one definition.
BEFORE = {
    "cli": 1879,
    "workflows": 1603,
    "fitting": 3529,
    "sweeps": 1458,
    "plots": 0,
    "io": 4077,
    "validation": 1680,
    "materials": 671,
    "engine": 7792,
    "master": 8729,
    "model": 1137,
    "laws": 4494,
    "numerics": 1526,
    "others": 858,
}


def lines() -> dict[str, int]:
    """Lines of each layer as it is."""
    sizes = dict.fromkeys(BEFORE, 0)
    for path in ROOT.rglob("*.py"):
        name = path.relative_to(ROOT).parts[0].removesuffix(".py")
        name = name if name in sizes else "others"
        sizes[name] += len(path.read_text(encoding="utf-8").splitlines())
    return sizes


def draw(path: Path) -> None:
    """Draw both, layer by layer."""
    now = lines()
    figure, axes = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
    for row, name in enumerate(BEFORE):
        for shift, sizes, color in ((-0.2, BEFORE, "0.75"), (0.2, now, "tab:blue")):
            axes.barh(row + shift, sizes[name], 0.36, color=color)
            axes.text(
                sizes[name] + 60,
                row + shift,
                f"{sizes[name]:,}".replace(",", " "),
                va="center",
                fontsize=7,
            )
    axes.set_yticks(range(len(BEFORE)), BEFORE)
    axes.invert_yaxis()
    axes.set_xlabel("lines")
    totals = [f"{sum(sizes.values()):,}".replace(",", " ") for sizes in (BEFORE, now)]
    axes.set_title(
        f"{totals[0]} lines before (grey), {totals[1]} now (blue)", fontsize=9
    )
    axes.set_xlim(0, 1.1 * max(*BEFORE.values(), *now.values()))
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("layers.png"))
    draw(parser.parse_args().out)
