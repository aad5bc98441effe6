"""Errors in a user's input: one line that names the field, its value and what is
allowed."""

import difflib
import math
import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

# Bounds of dimensional quantities: their products stay finite.
POSITIVE = {"above": 0.0, "least": 1e-100, "most": 1e100}
NOT_NEGATIVE = {"least": 0.0, "most": 1e100}


class InputError(ValueError):
    """Unusable input of a user; the message is a single line, printed as it is."""

    def __init__(self, message: str = "") -> None:
        super().__init__(
            "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
        )


class _Brief(reprlib.Repr):
    """`repr` of bounded length."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 60
        self.maxlevel = 3

    def repr_int(self, x: int, level: int) -> str:
        if abs(x) < 10**20:
            return repr(x)
        # Python itself prints some thousand digits at most.
        digits = math.floor(abs(x).bit_length() * math.log10(2.0))
        return f"{'-' if x < 0 else ''}about 1e{digits}"


def shown(value: Any) -> str:
    """A value in a message: its `repr`, shortened in the middle."""
    return _Brief().repr(value)


def meant(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """A hint about the one of the `known` keys, section.key or bare, that is closest to
    `name`. If none is close it lists all after the words `otherwise`, or is empty."""
    known = list(known)
    last = name.rpartition(".")[2].lower()
    close = [key for key in known if key.rpartition(".")[2].lower() == last]
    close += difflib.get_close_matches(name, known, 1)
    if close:
        return f'did you mean "{close[0]}"?'
    return otherwise and otherwise + ", ".join(known)


@contextmanager
def under(section: str) -> Iterator[None]:
    """Put `section.` before the field that an InputError raised inside names."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{section}.{error}") from None


def require_package(extra: str, *packages: str) -> Any:
    """Import packages of an extra of eqsim, and return the last. Raises InputError, which
    names the option of the same name, unless all are installed."""
    for package in packages:
        try:
            module = import_module(package)
        except ImportError:
            said = f'needs the package "{package}" (pip install "eqsim[{extra}]")'
            raise InputError(f"--{extra}: {said}") from None
    return module


def require_number(
    field: str,
    value: float,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float = math.inf,
) -> None:
    """Raise InputError unless `value` is a finite real number greater than `above`, not
    less than `least` and not more than `most`."""
    lower = [] if above is None else [f" > {above:g}"]
    lower += [] if least is None else [f" >= {least:g}"]
    upper = f" and <= {most:g}" if math.isfinite(most) else ""
    try:  # an array of one number passes for a float, but cannot be hashed
        ok = type(value).__hash__ is not None and math.isfinite(value)
        ok = ok and (above is None or value > above)
        ok = ok and (least is None or value >= least) and value <= most
    except (TypeError, OverflowError):
        ok = False
    if not ok:
        allowed = f"a finite number{','.join(lower)}{upper}"
        raise InputError(f"{field} = {shown(value)}: must be {allowed}")


def require_integer(field: str, value: int, least: int, most: int) -> None:
    """Raise InputError unless `value` is an integer in [least, most]."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not whole or not least <= value <= most:
        raise InputError(
            f"{field} = {shown(value)}: must be an integer from {least} to {most}"
        )


def require_choice(field: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise InputError unless `value` is one of `allowed`."""
    if value not in allowed:
        listed = ", ".join(f'"{name}"' for name in allowed)
        raise InputError(f"{field} = {shown(value)}: must be one of {listed}")
