"""Steady averages of a run file as commands show them: simulated beside exact, and
exact alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from eqsim.engine.steady import Steady, steady
from eqsim.estimate import known, z_score
from eqsim.io import terminal
from eqsim.io.runfile import RunFile
from eqsim.io.units import Row
from eqsim.master.steady import Reference, reference
from eqsim.model.drive import Drive, Programme, require_drive
from eqsim.workflows.report import FileResult, Solved, if_any


@dataclass(frozen=True)
class SteadyResult(FileResult):
    """Simulated steady averages beside the exact ones, if those are known."""

    file: RunFile
    steady: Steady
    exact: Solved[Reference]

    def scores(self) -> dict[str, float | None]:
        """z of each average, None where there is no exact value."""
        scores: dict[str, float | None] = {}
        for name, found in self.steady.averages().items():
            level: Any = getattr(self.exact.solution, name, None)
            known = level is not None and level.value is not None
            exact = (level.value, level.stderr or 0.0) if known else None
            scores[name] = exact and z_score(found, *exact)
        return scores

    def summary(self) -> dict[str, Any]:
        steady, exact = self.steady, self.exact.solution
        averages, divergence = steady.averages(), self.ensemble.divergence
        values = {k: getattr(exact, k).value if exact else None for k in averages}
        return {
            **{name: estimate.as_dict() for name, estimate in averages.items()},
            **{"lives": steady.lives, "seed": steady.seed, "reached": steady.reached},
            **({"divergence": divergence} if divergence else {}),
            **{"reference": values, "z": self.scores()},
            **self.file.physical(steady.friction, values["friction"]),
        }

    def rows(self) -> Iterator[tuple[Any, ...]]:
        exact, rows = self.exact.solution, self.file.rows(self.steady)
        z = self.scores()
        yield "", "contacts", *unit_column(rows), "relative error", "reference", "z"
        for name, row in rows:
            found, level = getattr(self.steady, name), getattr(exact, name, None)
            without = level is None or level.value is None or found.diverges
            yield (
                *(row.label, row.of(found), *row.unit, terminal.relative_error(found)),
                row.exact(level, ".9g"),
                "none" if without else terminal.score(z[name]),
            )

    def notes(self) -> Iterator[str]:
        if self.exact.reason:
            yield f"no reference: {self.exact.reason}"
        if self.ensemble.divergence:
            yield self.ensemble.divergence
        speed = terminal.lives(self.steady.lives, self.steady.engine_seconds)
        yield f"{speed}, seed {self.steady.seed}"


@dataclass(frozen=True)
class ReferenceResult(FileResult):
    """Exact steady averages."""

    file: RunFile
    exact: Reference

    def summary(self) -> dict[str, Any]:
        averages = {**self.exact.averages(), "f_k": self.exact.f_k}
        errors = {name: estimate.stderr for name, estimate in averages.items()}
        divergence, velocity = self.ensemble.divergence, self.exact.velocity
        return {
            **{name: estimate.value for name, estimate in averages.items()},
            **{"error": errors, "method": self.exact.method},
            **({"divergence": divergence} if divergence else {}),
            **self.file.physical(self.exact.friction),
            **({"velocity": known(velocity)} if velocity else {}),
        }

    def rows(self) -> Iterator[tuple[Any, ...]]:
        rows = self.file.rows(self.exact)
        yield "", "value", *unit_column(rows), "error"
        for name, row in [*rows, ("f_k", rows[0][1]._replace(label="f_k"))]:
            found = getattr(self.exact, name)
            error = f"{row.of(found).stderr or 0.0:.1e}"
            yield row.label, row.exact(found, ".10g"), *row.unit, error

    def notes(self) -> Iterator[str]:
        yield f"method: {self.exact.method}"
        if velocity := self.exact.velocity:
            others = f", one of {len(self.exact.roots)} steady ones"
            others *= len(self.exact.roots) > 1
            yield f"velocity: {known(velocity):.10g}{others}"
        yield "error: bound of the numerical error; f_k: F/(N_c k), friction per pinned contact"
        if self.ensemble.divergence:
            yield self.ensemble.divergence


def simulated(file: RunFile, **settings: Any) -> SteadyResult:
    """Simulated steady averages of a run file, and the exact ones; `settings` are those
    of `steady`. Raises InputError."""
    ensemble, drive = file.ensemble, file.drive
    if isinstance(drive, Programme) and drive.motor:
        driven = reference(ensemble, drive).velocity
        assert driven is not None
        drive = Drive(known(driven))
    drive = require_drive(drive)
    found = steady(ensemble, drive, seed=file.output.seed, **settings)
    variance = found.force_variance.value is not None
    exact = if_any(lambda: reference(ensemble, drive, variance=variance))
    return SteadyResult(file, found, exact)


def exact(file: RunFile, variance: bool) -> ReferenceResult:
    """Exact steady averages of a run file. Raises InputError."""
    return ReferenceResult(
        file, reference(file.ensemble, file.drive, variance=variance)
    )


def unit_column(rows: list[tuple[str, Row]]) -> tuple[str, ...]:
    """Heading of the column of units, if the rows have one."""
    return ("unit",) * any(row.unit for _, row in rows)
