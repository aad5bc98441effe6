"""The command line in the process of a test."""

from typer.testing import CliRunner

from eqsim.cli.app import app


def call(*arguments):
    """The result of `eqsim` with arguments, which become text."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])
