"""The `eqsim` command and `python -m eqsim`: handlers of signals are installed before
anything large is imported."""

import atexit
import gc

from eqsim.io import signals


def main() -> None:
    """Entry point of the `eqsim` command."""
    # Imports and compilers make many objects that stay, and are searched in vain, also
    # at the end.
    gc.set_threshold(50_000, 20, 20)
    atexit.register(gc.freeze)
    with signals.interruptible():
        from eqsim.cli.app import main as command

        command()


if __name__ == "__main__":
    main()
