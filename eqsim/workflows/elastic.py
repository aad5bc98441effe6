"""Results of `eqsim run` for coupled blocks, beside exact numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eqsim.engine.elastic import check_elastic, elastic_trajectory
from eqsim.engine.records import ElasticTrajectory
from eqsim.estimate import Estimate, difference
from eqsim.io import storage
from eqsim.io.runfile import RunFile
from eqsim.master.avalanche_sizes import missed_by_few, size_law
from eqsim.master.steady import reference
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array
from eqsim.results import OfTrajectory

_SHOWN = 1000  # largest size of which the law is drawn


@dataclass(frozen=True, repr=False)
class ElasticResult(OfTrajectory):
    """Simulation of a run file with coupled blocks."""

    file: RunFile
    ensemble: Ensemble
    drive: Drive
    trajectory: ElasticTrajectory

    @cached_property
    def sizes(self) -> Array:
        """P(1), P(2), ... of infinitely many contacts, (1000,); empty for a discrete
        law."""
        assert self.drive.elastic
        if self.ensemble.thresholds.steps.size:
            return np.empty(0)
        return size_law(self.ensemble.thresholds, self.drive.elastic.load, _SHOWN)

    def averages(self) -> dict[str, tuple[Estimate, Estimate]]:
        """Averages over the second half of the plate's way, and their exact values, by
        name.

        Friction over displacement (length) is exact for any number of contacts. Breaks
        per avalanche and the fraction of single breaks are those of infinitely many
        contacts; their error is the change for a single block with its contacts. They
        have no value for a discrete law, whose equal thresholds break together from a
        fresh start on.
        """
        found, elastic = self.trajectory, self.drive.elastic
        assert elastic
        friction = reference(self.ensemble, replace(self.drive, elastic=None)).friction
        size = single = Estimate(None, None, 0, reliable=False)
        if self.sizes.size:
            contacts = elastic.contacts_per_block(self.ensemble.count)
            few = missed_by_few(self.ensemble.thresholds, elastic.load, contacts)
            size = Estimate(elastic.mean_size, abs(few.mean), 0)
            single = Estimate(float(self.sizes[0]), abs(few.single), 0)
        return {
            "friction": (found.friction, friction),
            "size": (found.size, size),
            "single": (found.single, single),
        }

    def summary(self) -> dict[str, Any]:
        """Content of `summary.json`."""
        found = self.trajectory
        names = ("lives", "engine_seconds", "threads", "seed")
        averages = self.averages()
        return {
            "title": self.file.title,
            **{name: estimate.as_dict() for name, (estimate, _) in averages.items()},
            "force_reliable": found.force_reliable,
            "reference": {name: exact.value for name, (_, exact) in averages.items()},
            **self.file.physical(
                averages["friction"][0], averages["friction"][1].value
            ),
            "z": {name: difference(*pair) for name, pair in averages.items()},
            "avalanches": len(found.avalanches["breaks"]),
            **{name: getattr(found, name) for name in names},
            "versions": storage.versions(),
        }

    def files(
        self, title: str = "", formats: Sequence[str] = ("png",)
    ) -> dict[str, bytes]:
        """Files of a results folder by name; pictures have `title` unless the file has
        one."""
        from eqsim.io.plots import (
            avalanches_figure,
            caption,
            elastic_figure,
            fronts_figure,
        )
        from eqsim.io.style import pictures

        file, found, elastic = self.file, self.trajectory, self.drive.elastic
        assert elastic
        exact = self.averages()["friction"][1]
        said = caption(file, exact, title)
        origin = storage.provenance(
            "run", file.settings, file.text, file.output.seed, file.folder
        )
        return {
            "trajectory.parquet": storage.parquet(found.columns(), origin),
            "avalanches.parquet": storage.parquet(found.avalanches, origin),
            "blocks.parquet": storage.parquet(found.blocks, origin),
            "summary.json": storage.to_json(self.summary()).encode(),
            **pictures("force", elastic_figure(found, exact, said), formats),
            **pictures(
                "avalanches", avalanches_figure(found, self.sizes, said), formats
            ),
            **pictures("fronts", fronts_figure(found, *elastic.shape, said), formats),
        }


def run_elastic(
    file: RunFile,
    drive: Drive,
    *,
    threads: int,
    max_lives: float,
    progress: Callable[[int, float], None],
) -> ElasticResult:
    """Simulate a run file with coupled blocks on a plate with this drive.

    Raises InputError.
    """
    ensemble, output = file.ensemble, file.output
    _, expected = check_elastic(ensemble, drive, output, max_lives)
    progress(0, expected)
    found = elastic_trajectory(
        ensemble, drive, points=output.points, seed=output.seed, replicas=output.replicas, threads=threads,
        max_lives=max_lives, progress=lambda lives: progress(lives, expected),
    )  # fmt: skip
    return ElasticResult(file, ensemble, drive, found)
