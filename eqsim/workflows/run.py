"""Everything that `eqsim run` computes: a run, and what it is compared with."""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from eqsim.engine.breaks import Breaks, breaks, check_breaks
from eqsim.engine.records import (
    ProgrammeTrajectory,
    SegmentRecord,
    SliderTrajectory,
    Trajectory,
    shown_by,
)
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import check_run, trajectory
from eqsim.errors import InputError
from eqsim.estimate import Estimate
from eqsim.io import storage
from eqsim.io.runfile import RunFile, opened
from eqsim.master.peak import Peak, first_peak
from eqsim.master.steady import reference
from eqsim.master.transient import Transient, transient
from eqsim.model.drive import Drive, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.results import OfTrajectory
from eqsim.sweeps.workers import Workers
from eqsim.workflows.elastic import ElasticResult, run_elastic
from eqsim.workflows.peak import static_peak

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, float], None]
Result = TypeVar("Result")


@dataclass(frozen=True, repr=False)
class RunResult(OfTrajectory):
    """A run file that was simulated.

    Attributes
    ----------
    file : RunFile
    ensemble : Ensemble
    drive : Drive
    steady : Steady
        Steady averages of the ensemble.
    trajectory : Trajectory
        What was found.
    breaks : Breaks or None
        If `output.breaks` asks for them.
    """

    file: RunFile
    ensemble: Ensemble
    drive: Drive
    steady: Steady
    trajectory: Trajectory
    breaks: Breaks | None = None

    @cached_property
    def exact(self) -> tuple[Transient | None, str]:
        """The exact mean, or None and why there is none."""
        return if_any(
            lambda: transient(self.ensemble, self.drive, self.file.output.points)
        )

    @cached_property
    def peak(self) -> Peak | None:
        """The static peak; None of a stationary start."""
        return static_peak(self.ensemble, self.drive, self.trajectory)

    @cached_property
    def exact_peak(self) -> Peak | None:
        """The static peak of the exact mean, if there is one."""
        if self.peak is None:
            return None
        return if_any(lambda: first_peak(self.ensemble, self.drive.velocity))[0]

    def _peaks(self) -> dict[str, Any]:
        """For JSON."""
        seen, exact = self.peak, self.exact_peak
        if seen is None:
            return {}
        level, known = self.steady.friction, None
        if exact is not None:
            known = {name: getattr(exact, name).value for name in Peak._fields}
            known["ratio"] = _over(
                exact.force, reference(self.ensemble, self.drive).friction
            ).value
        found = {**seen._asdict(), "ratio": _over(seen.force, level)}
        return {
            "peak": {
                **{name: one.as_dict() for name, one in found.items()},
                "exact": known,
            }
        }

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        found = self.trajectory
        return {
            "title": self.file.title,
            **{
                name: estimate.as_dict()
                for name, estimate in found.averages.averages().items()
            },
            **self._peaks(),
            **(
                {"divergence": self.ensemble.divergence}
                if self.ensemble.divergence
                else {}
            ),
            "force_reliable": found.force_reliable,
            "steady": {
                name: estimate.as_dict()
                for name, estimate in self.steady.averages().items()
            },
            **self.file.physical(found.averages.friction, self.steady.friction.value),
            **_how(found),
        }

    def files(
        self, title: str = "", formats: Sequence[str] = ("png",)
    ) -> dict[str, bytes]:
        """The files of a results folder by name; `title` of the picture, unless the run
        file has one."""
        found = _files(self, formats, self.picture(title))
        if self.breaks is not None:
            found["breaks.parquet"] = storage.parquet(
                self.breaks.columns(), _origin(self)
            )
        return found

    def picture(self, title: str = "") -> "Figure":
        """The force against displacement beside the exact mean and the steady value."""
        from eqsim.io.plots import caption, trajectory_figure

        said = caption(self.file, self.steady.friction, title)
        return trajectory_figure(self.trajectory, self.steady, self.exact[0], said)


@dataclass(frozen=True, repr=False)
class ProgrammeResult(OfTrajectory):
    """A run file with a programme that was simulated."""

    file: RunFile
    ensemble: Ensemble
    drive: Programme
    trajectory: ProgrammeTrajectory

    @cached_property
    def exact(self) -> tuple[Transient | None, str]:
        """The exact mean, or None and why there is none."""
        return if_any(
            lambda: transient(self.ensemble, self.drive, self.file.output.points)
        )

    @cached_property
    def exact_segments(self) -> tuple[SegmentRecord, ...]:
        """What the exact mean shows of each segment; empty if there is none."""
        exact = self.exact[0]
        if exact is None:
            return ()
        grid = self.drive.grid(self.file.output.points)
        # behind a spring the grid knows where the stage is, and the solution where the
        # slider is
        return shown_by(
            self.drive,
            grid._replace(X=exact.X),
            exact.force,
            exact.force_error,
            X_stderr=exact.X_error,
        )

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        found, exact = self.trajectory, self.exact_segments
        segments = [asdict(segment) for segment in found.segments]
        for segment, known in zip(segments, exact, strict=False):
            segment["exact"] = {
                "end": known.end.value,
                "peak": known.peak.value,
                "at": known.at.value,
            }
        return {
            "title": self.file.title,
            "segments": segments,
            **self._physical(),
            "force_reliable": found.force_reliable,
            **_how(found),
        }

    def _physical(self) -> dict[str, Any]:
        """Of each quantity of the interface, what a force F/(N k) is multiplied by, and
        its unit."""
        known = self.file.quantities
        return (
            {
                "physical": {
                    one.name: {"factor": one.factor, "unit": one.unit} for one in known
                }
            }
            if known
            else {}
        )

    def files(
        self, title: str = "", formats: Sequence[str] = ("png",)
    ) -> dict[str, bytes]:
        """The files of a results folder by name; `title` of the picture, unless the run
        file has one."""
        return _files(self, formats, self.picture(title))

    def picture(self, title: str = "") -> "Figure":
        """The force along the programme."""
        from eqsim.io.plots import caption, programme_figure

        largest = Estimate(float(np.abs(self.trajectory.force).max()), None, 0)
        return programme_figure(
            self.trajectory,
            self.exact[0],
            caption(self.file, largest, title),
        )


@dataclass(frozen=True, repr=False)
class SliderResult(ProgrammeResult):
    """A run file with a stage that was simulated."""

    trajectory: SliderTrajectory

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        found = self.trajectory
        slips = {"slips": [asdict(slip) for slip in found.slips]}
        return (
            super().summary()
            | {"period": found.period.as_dict(), "drop": found.drop.as_dict()}
            | slips
        )

    def picture(self, title: str = "") -> "Figure":
        """Forces and displacements of slider and stage."""
        from eqsim.io.plots import caption, slider_figure

        largest = Estimate(float(np.abs(self.trajectory.spring).max()), None, 0)
        return slider_figure(
            self.trajectory,
            self.exact[0],
            caption(self.file, largest, title),
        )

    def files(
        self, title: str = "", formats: Sequence[str] = ("png",)
    ) -> dict[str, bytes]:
        """The files of a results folder by name; `title` of the picture, unless the run
        file has one."""
        found = super().files(title, formats)
        if self.trajectory.avalanches is not None:
            found["avalanches.parquet"] = storage.parquet(
                self.trajectory.avalanches, _origin(self)
            )
        return found


def _over(peak: Estimate, level: Estimate) -> Estimate:
    """A static peak over the steady friction."""
    if not peak.value or not level.value:
        return Estimate(None, None, peak.n, reliable=False)
    relative = math.hypot(
        (peak.stderr or 0.0) / peak.value, (level.stderr or 0.0) / level.value
    )
    value = peak.value / level.value
    return Estimate(value, abs(value) * relative, peak.n, None, peak.reliable)


def _how(found: Trajectory | ProgrammeTrajectory) -> dict[str, Any]:
    """How it was computed."""
    names = ("lives", "engine_seconds", "threads", "seed")
    return {
        **{name: getattr(found, name) for name in names},
        "versions": storage.versions(),
    }


def _origin(result: RunResult | ProgrammeResult) -> dict[str, Any]:
    file = result.file
    return storage.provenance(
        "run", file.settings, file.text, file.output.seed, file.folder
    )


def _files(
    result: RunResult | ProgrammeResult, formats: Sequence[str], picture: "Figure"
) -> dict[str, bytes]:
    from eqsim.io.style import pictures

    found = {
        "trajectory.parquet": storage.parquet(
            result.trajectory.columns(), _origin(result)
        ),
        "summary.json": storage.to_json(result.summary()).encode(),
        **pictures("force", picture, formats),
    }
    if result.file.output.series:
        found["replicas.parquet"] = storage.parquet(
            result.trajectory.replicas(), _origin(result)
        )
    return found


def run(
    file: RunFile | Path | str,
    folder: Path | None = None,
    *,
    threads: int = 1,
    workers: Workers | None = None,
    max_lives: float = 1e10,
    progress: Progress = lambda *_: None,
) -> RunResult | ProgrammeResult | ElasticResult:
    """Simulate a run file, and at constant velocity estimate the steady averages that
    belong to it.

    Parameters
    ----------
    file : RunFile, Path or str
        A run file or the path of one.
    folder : Path, optional
        Where the paths in the run file start; by default its own folder.
    threads : int
        Of this process; they change no number.
    workers : Workers, optional
        Instead of threads; the same bits.
    max_lives : float
        Most lives.
    progress : callable, optional
        `progress(done, expected)`, lives.

    Returns
    -------
    RunResult, ProgrammeResult or ElasticResult

    Raises
    ------
    InputError
        If the run file cannot be simulated, if more than `max_lives` lives are
        predicted, or if a worker is lost.
    """
    file = opened(file, folder)
    ensemble, drive, output = file.ensemble, file.drive, file.output
    if isinstance(drive, Drive) and drive.elastic:
        if workers:
            raise InputError(
                "--workers, --dask: coupled blocks are simulated in one process; threads share replicas"
            )
        return run_elastic(
            file, drive, threads=threads, max_lives=max_lives, progress=progress
        )
    rough = 5e-3 if ensemble.fluctuates else 1e-3
    with ExitStack() as stack:
        expected = check_run(ensemble, drive, output, max_lives)
        if output.series and workers:
            raise InputError(
                "output.series: every series is kept by threads; not with --workers or --dask"
            )
        if output.breaks and isinstance(drive, Drive):
            check_breaks(ensemble, drive, output)
        pool = stack.enter_context(workers.fixed_pool()) if workers else None
        progress(0, expected)
        level = None
        if isinstance(drive, Drive):
            level = steady(
                ensemble,
                drive,
                rel_error=rough,
                seed=output.seed,
                threads=threads,
                max_lives=max_lives,
            )
        found: Any = trajectory(
            ensemble, drive, points=output.points, seed=output.seed, replicas=output.replicas, max_lives=max_lives,
            threads=(pool.executor, pool.slots()) if pool else threads,
            progress=lambda lives: progress(lives, expected),
        )  # fmt: skip
        if isinstance(drive, Programme):
            kind = SliderResult if drive.stage else ProgrammeResult
            return kind(file, ensemble, drive, found)
    assert level is not None
    listed = None
    if output.breaks:
        listed = breaks(
            ensemble, drive, seed=output.seed, replicas=output.replicas, threads=threads
        )
    return RunResult(file, ensemble, drive, level, found, listed)


def if_any(solve: Callable[[], Result]) -> tuple[Result | None, str]:
    """An exact result, or None and why there is none."""
    try:
        return solve(), ""
    except InputError as error:
        return None, str(error)
