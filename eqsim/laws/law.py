"""Equality of laws."""

from typing import Any


class Law:
    """Equality of laws, which are NamedTuples of their numbers: two of them are equal
    if their types and numbers are. Tuples of equal numbers are equal, so that `Soft(b,
    log_w) == Stiff(b, log_w)` would hold, and a cache would take one law for the other.
    A law inherits from `Law` and a NamedTuple, in any order."""

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        """Give a law these methods as its own: those of tuple would go first where the
        NamedTuple is named first."""
        super().__init_subclass__()
        for method in ("__eq__", "__ne__", "__hash__"):
            setattr(cls, method, vars(Law)[method])

    def __eq__(self: Any, other: Any) -> bool:
        return type(self) is type(other) and tuple(self) == tuple(other)

    def __ne__(self: Any, other: Any) -> bool:
        return not self == other

    def __hash__(self: Any) -> int:
        return hash((type(self), *self))
