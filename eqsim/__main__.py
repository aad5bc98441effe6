"""Where the `eqsim` command and `python -m eqsim` begin: signals are answered before anything large is imported."""

import sys

from eqsim.io import signals


def main() -> None:
    """Entry point of the `eqsim` command."""
    try:
        signals.listen()
        from eqsim.cli import app as cli

        cli.main()
    except BaseException:
        if signals.unheard():
            print(f"eqsim: {signals.WHOLE}", file=sys.stderr)
            signals.leave(None)
        raise


if __name__ == "__main__":
    main()
