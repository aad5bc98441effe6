"""Exact curves of a run file: the mean force and the pinned fraction on the way, as
columns."""

from dataclasses import fields
from typing import Any

from eqsim.io.runfile import RunFile
from eqsim.master.closure import closure as solve_closure
from eqsim.master.transient import transient
from eqsim.numerics.tables import Array


def curve(file: RunFile, *, closure: bool = False) -> dict[str, Array]:
    """The exact mean of a run (`master.transient`), or the closure of annealed contacts
    that age (`master.closure`).

    Parameters
    ----------
    file : RunFile
    closure : bool

    Returns
    -------
    dict of ndarray, shape (points,)
        The fields of `Transient` or `Closure` that are known, by name.

    Raises
    ------
    InputError
        Where there is no such curve.
    """
    ensemble, points = file.ensemble, file.output.points
    found: Any = (
        solve_closure(ensemble, file.constant_drive, points)
        if closure
        else transient(ensemble, file.drive, points)
    )
    every = {field.name: getattr(found, field.name) for field in fields(found)}
    return {name: column for name, column in every.items() if column is not None}
