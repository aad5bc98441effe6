"""Where the `eqsim` command and `python -m eqsim` begin: signals are answered before anything large is imported."""

import sys

from eqsim import interrupts


def main() -> None:
    """Entry point of the `eqsim` command."""
    try:
        interrupts.listen()
        from eqsim import cli

        cli.main()
    except BaseException:
        if interrupts.unheard():
            print(f"eqsim: {interrupts.WHOLE}", file=sys.stderr)
            interrupts.leave(None)
        raise


if __name__ == "__main__":
    main()
