"""The `eqsim` command and `python -m eqsim`: handlers of signals are installed before
anything large is imported."""

import atexit
import gc

from eqsim.io import signals


def main() -> None:
    """Entry point of the `eqsim` command."""
    gc.set_threshold(
        50_000, 20, 20
    )  # imports and compilers make many objects that stay, and are searched in vain
    atexit.register(gc.freeze)  # nor is all of it to be searched once more at the end
    with signals.interruptible():
        from eqsim.cli.app import main as command

        command()


if __name__ == "__main__":
    main()
