"""Results of `eqsim run` for coupled blocks, beside exact numbers."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from eqsim.engine.elastic import check_elastic, simulate_blocks
from eqsim.engine.records import ElasticTrajectory
from eqsim.engine.trajectory import guarded
from eqsim.estimate import Estimate, score
from eqsim.io.runfile import RunFile
from eqsim.lazy import lazily
from eqsim.master.avalanche_sizes import averages_of_blocks, size_law
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Programme
from eqsim.model.elastic import Elastic
from eqsim.numerics.tables import Array
from eqsim.workflows.report import How, SimulatedFile, Solved, difference_of

with lazily():
    from eqsim.plots import blocks as draw
    from eqsim.plots import panels


_LARGEST_SIZE = 1000  # size of avalanches up to which the law is drawn
_AVERAGE_ROWS = {
    "friction": "friction {}",
    "size": "breaks per avalanche",
    "single": "fraction of single breaks",
}


@dataclass(frozen=True, repr=False)
class ElasticResult(SimulatedFile):
    """Simulation of a run file with coupled blocks."""

    file: RunFile
    trajectory: ElasticTrajectory
    exact = Solved(None)
    exact_name = "writing"

    @property
    def elastic(self) -> Elastic:
        """The blocks."""
        return cast(Elastic, self.drive.elastic)

    @cached_property
    def sizes(self) -> Array:
        """P(1), P(2), ... of infinitely many contacts, (1000,); empty for a discrete
        law, with heat, and where blocks differ."""
        if self.in_time or self.ensemble.thresholds.steps.size:
            return np.empty(0)
        return size_law(self.ensemble.thresholds, self.elastic.branching, _LARGEST_SIZE)

    @property
    def in_time(self) -> bool:
        """True if averages are those over time, and have no exact value."""
        programme = isinstance(self.drive, Programme)
        return programme or self.elastic.follows_events(self.ensemble.thermal.active)

    @cached_property
    def starts(self) -> Array:
        """Avalanches in the second half that start in each block, (rows, columns)."""
        run, (columns, rows) = self.trajectory, self.elastic.shape
        late = run.avalanches["D"] > 0.5 * run.D[-1]
        first = run.avalanches["block"][late]
        return np.bincount(first, minlength=rows * columns).reshape(rows, columns)

    @cached_property
    def rigid(self) -> Estimate:
        """Exact friction of a rigid slider, and that over displacement."""
        return reference(self.ensemble, replace(self.drive, elastic=None)).friction

    @property
    def friction(self) -> Estimate:
        """Exact friction over displacement, if it is known."""
        return Estimate(None, None, 0, reliable=False) if self.in_time else self.rigid

    def averages(self) -> dict[str, tuple[Estimate, Estimate]]:
        """Averages over the second half of the plate's way, and their exact values, by
        name; over time, without exact values, with heat and where blocks differ.

        Friction over displacement (length) is exact for any number of contacts. Breaks
        per avalanche and the fraction of single breaks are those of infinitely many
        contacts (`master.avalanche_sizes.averages_of_blocks`).
        """
        unknown = Estimate(None, None, 0, reliable=False)
        exact = {"friction": self.friction, "size": unknown, "single": unknown}
        if not self.in_time:
            law, count = self.ensemble.thresholds, self.ensemble.count
            exact |= averages_of_blocks(law, self.elastic, count)
        run = self.trajectory
        return {name: (getattr(run, name), value) for name, value in exact.items()}

    def summary(self) -> dict[str, Any]:
        run, averages = self.trajectory, self.averages()
        friction, exact = averages["friction"]
        return {
            "title": self.file.title,
            **{name: estimate.as_dict() for name, (estimate, _) in averages.items()},
            "force_reliable": run.force_reliable,
            "reference": {name: exact.value for name, (_, exact) in averages.items()},
            **self.file.physical(friction, exact.value),
            "z": {name: score(*pair) for name, pair in averages.items()},
            "avalanches": len(run.avalanches["breaks"]),
            "starts": {
                "mean": float(self.starts.mean()),
                "std": float(self.starts.std()),
                "most": int(self.starts.max()),
                "block": int(self.starts.argmax()),
            },
            **self.made(),
        }

    def tables(self) -> dict[str, Any]:
        run = self.trajectory
        more = {"avalanches": run.avalanches, "blocks": run.blocks}
        return {"trajectory": run.columns(), **more}

    def figures(self, title: str) -> dict[str, Any]:
        run = self.trajectory
        caption = panels.Caption.of(self.file, title, self.friction.value)
        figures = {"force": draw.elastic_figure(run, self.friction, caption)}
        if self.starts.any():
            shown = self.starts, self.sizes, caption
            figures["avalanches"] = draw.avalanches_figure(run, *shown)
        fronts = draw.fronts_figure(run, *self.elastic.shape, caption)
        return figures | {"fronts": fronts}

    def rows(self) -> Iterator[tuple[Any, ...]]:
        yield "", "this run", "expected", "z"
        over = "over time" if self.in_time else "over X"
        for name, (found, exact) in self.averages().items():
            known = "none" if exact.value is None else exact
            z = difference_of(found, exact)
            yield _AVERAGE_ROWS[name].format(over), found, known, z

    def notes(self) -> Iterator[str]:
        run = self.trajectory
        breaks, blocks = run.avalanches["breaks"], run.avalanches["blocks"]
        if not run.friction.reliable:
            yield "unreliable: the second half is too short to forget the fresh start, or to tell its errors"
        if breaks.size:
            yield (
                f"{breaks.size} avalanches, the largest of {breaks.max()} breaks; "
                f"{blocks.mean():.3g} of {self.elastic.count} blocks take part in the "
                f"mean, {blocks.max()} at most"
            )
            starts = self.starts
            yield (
                f"over the second half {starts.mean():.4g} start in a block in the mean, "
                f"with a standard deviation of {starts.std():.3g} between blocks; "
                f"{starts.max()} in block {starts.argmax()}"
            )
        if self.in_time:
            yield "averages: over time, in the second half of the run or of its last segment"
        if self.in_time and isinstance(self.drive, Drive):
            yield f"a rigid slider has a friction of {self.rigid.value:.6g} at this velocity"
        elif not self.in_time:
            yield (
                "expected: friction of any number of contacts, avalanches of infinitely "
                "many; errors: the change for n contacts per block"
            )
        yield from self.speed()


def run_elastic(file: RunFile, how: How) -> ElasticResult:
    """Simulate a run file whose `drive` has coupled blocks. Raises InputError."""
    ensemble, drive, output = file.ensemble, file.drive, file.output
    _, expected = check_elastic(ensemble, drive, output, how.max_lives)
    how.progress(0, expected)

    def told(lives: int) -> None:
        how.progress(lives, max(lives, expected))

    guard = guarded(told, expected, how.max_lives)
    found = simulate_blocks(ensemble, drive, output, how.threads, guard, how.keep)
    return ElasticResult(file, found)
