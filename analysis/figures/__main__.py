"""The figures of Braun and Peyrard (2011), from the folder of the repository:

    python -m analysis.figures [A01 ...] [--out DIR] [--quick] [--workers N]
    python -m analysis.figures --replay FILE

Options, messages and exit codes are those of `eqsim`.
"""

import sys

from eqsim.io import signals


def main() -> None:
    """Run the command, which an interrupt may end while it is still imported."""
    with signals.interruptible():
        from analysis.figures.command import app

        app(["figures", *sys.argv[1:]])


if __name__ == "__main__":
    main()
