"""`eqsim sweep` from Python: a grid in, a table out."""

import tempfile
import warnings
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from eqsim.errors import InputError, require_integer, shown
from eqsim.io import storage, terminal
from eqsim.io.content import copied, plain
from eqsim.io.runfile import RunFile, at, check, opened
from eqsim.sweeps import scheduler
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.rows import Asked
from eqsim.sweeps.workers import Workers
from eqsim.workflows.report import Progress


def sweep(
    file: RunFile | Path | str | dict[str, Any],
    grid: dict[str, Any] | None = None,
    *,
    out: Path | str | None = None,
    rel_error: float = 1e-2,
    transient: bool = False,
    workers: int = 0,
    max_lives: float = 1e10,
    progress: bool | Progress = True,
) -> Any:
    """Simulate a grid of points beside their references, as `eqsim sweep` does: the
    same numbers.

    Parameters
    ----------
    file : RunFile, Path, str or dict
        A run file, the path of one, or values by "section.key": {"thermal.kT": 0.1}.
    grid : dict, optional
        The axes, instead of those of the run file's [sweep] table: a list or array of
        values by "section.key", or what else that table may hold, such as {"log":
        [first, last, count]}. The grid is their product, the last one fastest.
    out : Path or str, optional
        Folder that keeps finished points, so that the same call continues after an
        interruption; by default none does.
    rel_error : float
        Relative standard error of all observables.
    transient : bool
        Average over the second half of the run's distance instead of the steady state.
    workers : int
        Processes; 0 computes in this one. A script that asks for processes calls this
        below `if __name__ == "__main__":`, as they begin by importing it.
    max_lives : float
        Largest number of lives that a point may need.
    progress : bool or callable
        Whether to show a progress bar on a terminal, or `progress(done, total)`.

    Returns
    -------
    pandas.DataFrame
        One row a point: the keys of the run file, and each observable with `_stderr`,
        `_reference`, `_z`, ...; where a point failed, about which a warning is given,
        `message` says why.

    Raises
    ------
    InputError
        For a grid that cannot be used, and a folder that holds something else.

    Examples
    --------
    >>> from eqsim import sweep
    >>> grid = {"drive.velocity": [0.1, 1.0]}
    >>> found = sweep({"contacts.count": 100}, grid, rel_error=0.1, progress=False)
    >>> found["friction_reference"].round(4).tolist()
    [0.8839, 0.8839]
    """
    require_integer("workers", workers, 0, 1024)
    if out is not None and not str(out).strip():
        raise InputError(f"out = {shown(out)}: must be the name of a folder")
    base = at(check({}), file) if isinstance(file, dict) else opened(file)
    if grid is not None:
        base = _with_grid(base, grid)
    plan, asked = Plan(base), Asked(rel_error, max_lives, transient)
    asked.require_effect(plan.runs)
    bar = terminal.bar("sweeping", progress is not True, "points")
    kept = tempfile.TemporaryDirectory() if out is None else nullcontext(out)
    with bar as shown_on, kept as folder:
        report = progress if callable(progress) else shown_on
        found = scheduler.sweep(
            plan, Path(folder), asked=asked, workers=Workers(workers), progress=report
        )
        rows = storage.read_parquet((Path(folder) / storage.SWEEP_TABLE).read_bytes())
        table = rows.to_pandas(use_threads=False)
    for failure in found.failures[:1]:
        first = f"the first at {failure['changes']}: {failure['message']}"
        said = f"{found.failed} of {found.points} points failed, {first}"
        warnings.warn(said, stacklevel=3)
    return table


def _with_grid(file: RunFile, grid: dict[str, Any]) -> RunFile:
    """The run file with other axes. Raises InputError."""
    if not isinstance(grid, dict):
        said = 'must be values by key, such as {"drive.velocity": [0.1, 1.0]}'
        raise InputError(f"grid = {shown(grid)}: {said}")
    content = {**copied(file.given, without=("fit",)), "sweep": plain(grid)}
    return replace(check(content, file.folder), text=file.text)
