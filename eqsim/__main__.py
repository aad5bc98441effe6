"""The `eqsim` command and `python -m eqsim`: handlers of signals are installed before anything large is imported."""

from eqsim.io import signals


def main() -> None:
    """Entry point of the `eqsim` command."""
    with signals.interruptible():
        from eqsim.cli.app import main as command

        command()


if __name__ == "__main__":
    main()
