"""Packages of the extra `suites`, which only tests with -m long and -m verification
need: they would take as long to install as all others."""

import importlib

import pytest


def needed(name):
    """The module of that name; without it the test fails, and says what to install."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as missing:
        if missing.name != name:
            raise
        pytest.fail(f'needs {name}: pip install -e ".[suites]"', pytrace=False)
