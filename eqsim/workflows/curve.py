"""Exact curves of a run file: mean force and pinned fraction along the drive, as
columns."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from eqsim.io import terminal
from eqsim.io.runfile import RunFile
from eqsim.lazy import lazily
from eqsim.master.closure import closure as solve_closure
from eqsim.master.transient import transient
from eqsim.model.drive import Drive
from eqsim.numerics.tables import Array
from eqsim.workflows.report import FileResult

with lazily():
    from eqsim.plots import panels, runs


_SHOWN = ("t", "X", "stage", "force", "force_error", "pinned", "pinned_error")
_CURVE_PARTS = 10  # intervals between the rows that a table shows


@dataclass(frozen=True)
class CurveResult(FileResult):
    """An exact curve, "transient" or "closure": the fields of `Transient` or `Closure`
    that are known, by name."""

    file: RunFile
    name: str
    columns: dict[str, Array]
    command = "reference"
    summarised = False

    def summary(self) -> dict[str, Any]:
        return self.columns

    def tables(self) -> dict[str, Any]:
        return {self.name: self.columns}

    def figures(self, title: str) -> dict[str, Any]:
        force = float(self.columns["force"][-1])
        caption = panels.Caption.of(self.file, title, force)
        along = "X" if isinstance(self.drive, Drive) else "t"
        return {self.name: runs.curve_figure(self.columns, along, caption)}

    def rows(self) -> Iterator[tuple[str, ...]]:
        head = tuple(name for name in _SHOWN if name in self.columns)
        yield head
        for row in terminal.some(len(self.columns["X"]), _CURVE_PARTS):
            forms = (".1e" if "_error" in name else ".8g" for name in head)
            cells = zip(head, forms, strict=True)
            yield tuple(f"{self.columns[name][row]:{form}}" for name, form in cells)

    def notes(self) -> Iterator[str]:
        yield "columns ending in _error: bounds of the numerical error"

    def title(self, name: str) -> str:
        return self.file.title or name

    def written(self, files: Sequence[str]) -> str:
        return f"{super().written(files)}, {len(self.columns['X'])} rows"


def curve(file: RunFile, *, closure: bool = False) -> CurveResult:
    """The exact mean of a run (`master.transient`), or the closure of annealed contacts
    that age (`master.closure`). Raises InputError where there is no such curve."""
    ensemble, points = file.ensemble, file.output.points
    if closure:
        solved = solve_closure(ensemble, file.constant_drive, points)
        return CurveResult(file, "closure", solved.columns())
    return CurveResult(
        file, "transient", transient(ensemble, file.drive, points).columns()
    )
