"""Errors in a user's input: one line that names the field, its value and what is
allowed."""

import difflib
import functools
import math
import reprlib
import types
import typing
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib import import_module
from typing import Annotated, Any, Literal, NamedTuple

# Bounds of dimensional quantities: their products stay finite.
POSITIVE = {"above": 0.0, "least": 1e-100, "most": 1e100}
NOT_NEGATIVE = {"least": 0.0, "most": 1e100}


class Limits(NamedTuple):
    """Bounds of a number, in the type of a field of a `Checked` dataclass."""

    least: float | None = None
    most: float = math.inf
    above: float | None = None

    def __repr__(self) -> str:
        lower = [] if self.above is None else [f"> {self.above:g}"]
        lower += [] if self.least is None else [f">= {self.least:g}"]
        upper = [f"<= {self.most:g}"] if math.isfinite(self.most) else []
        return " and ".join([", ".join(lower), *upper])


Positive = Annotated[float, Limits(**POSITIVE)]
NotNegative = Annotated[float, Limits(**NOT_NEGATIVE)]


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
    try:  # an array of one number passes for a float, but cannot be hashed
        ok = type(value).__hash__ is not None and math.isfinite(value)
        number = float(value) if ok else 0.0  # limits may overflow in single precision
        ok = ok and (above is None or number > above)
        ok = ok and (least is None or number >= least) and number <= most
    except (TypeError, OverflowError):
        ok = False
    if not ok:
        allowed = f"a finite number {Limits(least, most, above)!r}".rstrip()
        raise InputError(f"{field} = {shown(value)}: must be {allowed}")


def require_number_or_infinity(field: str, value: float, **limits: float) -> None:
    """Raise InputError unless `value` is infinity, or within `limits` as for
    `require_number`."""
    if type(value).__hash__ is None or value != math.inf:
        require_number(field, value, **limits)


def require_integer(field: str, value: int, least: int, most: int) -> None:
    """Raise InputError unless `value` is an integer in [least, most]."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not whole or not least <= value <= most:
        raise InputError(
            f"{field} = {shown(value)}: must be an integer from {least} to {most}"
        )


def require_threads(threads: Any) -> None:
    """Raise InputError unless `threads` is an integer from 0, which is one as well, to
    1024; an executor with its number of workers passes."""
    if not isinstance(threads, tuple):
        require_integer("threads", threads, 0, 1024)


def require_choice(field: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise InputError unless `value` is one of `allowed`."""
    if value not in allowed:
        listed = ", ".join(f'"{name}"' for name in allowed)
        raise InputError(f"{field} = {shown(value)}: must be one of {listed}")


class Checked:
    """Base of frozen dataclasses whose fields are checked when one is made, by their
    types: a number is finite and within its `Limits`, a `Literal` one of its choices,
    and a dataclass is one, unless they have their defaults. Raises InputError."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for field, hint in _field_types(kind).items():
            value, default = getattr(self, field), getattr(kind, field, ...)
            usual = value == default if isinstance(value, float) else value is default
            if not usual:
                _require(field, value, hint)


@functools.cache
def _field_types(kind: Any) -> dict[str, Any]:
    """The types of the fields of a dataclass, of a union the first one."""
    hints = typing.get_type_hints(kind, include_extras=True).items()
    unions = types.UnionType, typing.Union
    return {
        field: typing.get_args(hint)[0] if typing.get_origin(hint) in unions else hint
        for field, hint in hints
        if typing.get_origin(hint) is not typing.ClassVar
    }


def _require(field: str, value: Any, hint: Any) -> None:
    """Raise InputError unless the value of a field fits its type."""
    origin, given = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        require_choice(field, value, given)
    elif origin is Annotated and given[0] is int:
        require_integer(field, value, given[1].least, given[1].most)
    elif hint is float or origin is Annotated:
        limits = given[1] if given else Limits()
        require_number(field, value, **limits._asdict())
    elif isinstance(hint, type) and is_dataclass(hint) and not isinstance(value, hint):
        raise InputError(f"{field} = {shown(value)}: must be {hint.__name__}(...)")
