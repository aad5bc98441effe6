"""Friction in the units of a laboratory, from any result that has a force."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple

from eqsim.errors import InputError


class Physical(NamedTuple):
    """A force, shear stress or friction coefficient: its value and standard error,
    which are arrays along a curve, and its unit."""

    value: Any
    stderr: Any
    unit: str


# What F/(N k) is, given `units` and `interface`; None is that of the run file.
Quantities = Callable[[Any, Any], Iterable[Any]]


class Listed:
    """An object whose completion by tab lists what a user means: `dir` names neither
    private helpers nor what is there for tables and pictures alone."""

    unlisted: ClassVar[tuple[str, ...]] = ("unlisted",)

    def __dir__(self) -> list[str]:
        every, hidden = super().__dir__(), {*self.unlisted, "unlisted"}
        return [
            name
            for name in every
            if name not in hidden and (name[0] != "_" or name.startswith("__"))
        ]


class Measured(Listed):
    """A result that knows what its force F/(N k) is in a laboratory."""

    unlisted = ("drawn", "names", "shown")
    _quantities: ClassVar[Quantities | None] = None  # each result has its own

    def in_units(self, units: Any = None, interface: Any = None) -> dict[str, Physical]:
        """Give friction F/(N k), a length, as a force, a shear stress and a coefficient,
        as the command line does. Other numbers are in the units of the run file, or of
        the ensemble and the drive.

        Parameters
        ----------
        units : Units, optional
            Units of length, time and force; by default those of the run file.
        interface : Interface, optional
            Area, contacts per area, and load; by default those of the run file.

        Returns
        -------
        dict of Physical
            `force`, `shear_stress` and `friction_coefficient`, as far as they are known,
            with `value`, `stderr` (arrays along a curve) and `unit`.

        Raises
        ------
        InputError
            If neither units nor an interface are known.
        TypeError
            For a result without a force.

        Examples
        --------
        >>> from eqsim import Drive, Ensemble, Interface, Units, reference
        >>> exact = reference(Ensemble(count=1000, stiffness=2.0), Drive(velocity=0.1))
        >>> found = exact.in_units(Units(force="N"), Interface(normal_load=5000.0))
        >>> force, mu = found["force"], found["friction_coefficient"]
        >>> print(f"{force.value:.1f} {force.unit}, mu = {mu.value:.3f}")
        1767.8 N, mu = 0.354
        """
        value, stderr = self._force()
        told: Any = self._quantities
        found = list(told(units, interface)) if told else []
        if not found:
            raise InputError(
                "in_units: neither a unit of force nor an interface is known; give "
                "Units(...) and Interface(...), or a run file with [units]"
            )
        return {
            one.name: Physical(
                None if value is None else one.factor * value,
                None if stderr is None else one.factor * stderr,
                one.unit,
            )
            for one in found
        }

    def _force(self) -> tuple[Any, Any]:
        """F/(N k) and its standard error, arrays of a curve."""
        drawn = getattr(self, "drawn", None)
        if drawn is not None and drawn.y in ("force", "friction"):
            return getattr(self, drawn.y), getattr(self, drawn.error)
        if drawn is None and hasattr(self, "friction"):
            return self.friction.value, self.friction.stderr
        raise TypeError(f"{type(self).__name__} has no force F/(N k)")


def tell_quantities(result: Any, quantities: Quantities) -> None:
    """Let a result and its parts know what F/(N k) is."""
    if isinstance(result, Measured):
        object.__setattr__(result, "_quantities", quantities)
    for field in fields(result):
        part = getattr(result, field.name)
        if isinstance(part, Measured):
            tell_quantities(part, quantities)
