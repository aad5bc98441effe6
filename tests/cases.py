"""Tests with many cases, some of which run by default and all with -m verification."""

import pytest


def chosen(names, cases, default, ids=None):
    """`pytest.mark.parametrize` with all `cases`: those in `default` run by default,
    the others with -m verification. `default` holds cases, or what `ids` calls them."""
    left = list(default)
    marked = []
    for case in cases:
        meant = [case, ids(case)] if ids else [case]
        found = [
            index
            for index, choice in enumerate(left)
            if choice is case or choice in meant
        ]
        for index in found[:1]:
            del left[index]
        values = [case] if isinstance(names, str) else case
        marks = [] if found else [pytest.mark.verification]
        marked.append(pytest.param(*values, marks=marks))
    assert not left, f"{left}: no cases of this test"
    return pytest.mark.parametrize(names, marked, ids=ids)
