"""Results of `eqsim run`: a simulated run file beside exact and steady values."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from eqsim.engine.breaks import Breaks, breaks, check_breaks
from eqsim.engine.readings import Forces, shown_by
from eqsim.engine.records import (
    ProgrammeTrajectory,
    SegmentRecord,
    SliderTrajectory,
    Trajectory,
    observed,
)
from eqsim.engine.steady import Steady, steady
from eqsim.engine.trajectory import check_run, trajectory
from eqsim.errors import InputError, require_threads
from eqsim.estimate import Estimate, known
from eqsim.io.runfile import RunFile, opened
from eqsim.io.states import States, kept
from eqsim.io.units import Row
from eqsim.lazy import lazily
from eqsim.master.avalanche_sizes import load_of, size_law
from eqsim.master.bursts import bursts
from eqsim.master.lifetimes import lifetime
from eqsim.master.peak import Peak, first_peak
from eqsim.master.programme import Transient
from eqsim.master.steady import reference
from eqsim.model.drive import Drive, Programme
from eqsim.model.healing import Healing, healing_law
from eqsim.numerics.tables import Array
from eqsim.sweeps.rows import failures_of
from eqsim.sweeps.workers import Workers
from eqsim.workflows.averages import unit_column
from eqsim.workflows.elastic import ElasticResult, run_elastic
from eqsim.workflows.peak import static_peak
from eqsim.workflows.report import (
    How,
    Progress,
    SimulatedFile,
    Solved,
    difference_of,
    if_any,
)

with lazily():
    from eqsim.plots import runs


_MOST_LINES = 40  # segments or slips that a table shows
_LARGEST_SIZE = 1000  # size of avalanches up to which their law is drawn
_MOST_NAMED = 8  # slips that a note names
_FEW = 1000  # contacts under a force or a motor, to which a mean field says little
_CUT = "the record {} during {}: drop, time and distance (>) are lower bounds"


@dataclass(frozen=True, repr=False)
class RunResult(SimulatedFile):
    """Simulation of a run file at constant velocity.

    Attributes
    ----------
    file : RunFile
        The run file; its ensemble and drive are attributes of the result, too.
    steady : Steady
        Steady averages of the ensemble, simulated separately.
    trajectory : Trajectory
        Mean force and pinned fraction over displacement.
    breaks : Breaks or None
        Every break of a contact, if `output.breaks` asks for them.
    who : str
        "threads" or "workers", which shared the work.
    """

    file: RunFile
    steady: Steady
    trajectory: Trajectory
    breaks: Breaks | None = None
    who: str = "threads"
    compares: bool = True

    @cached_property
    def peak(self) -> Peak | None:
        """The static peak; None for a stationary start."""
        return static_peak(self.ensemble, self.drive, self.trajectory)

    @cached_property
    def exact_peak(self) -> Peak | None:
        """The static peak of the exact mean, if there is one."""
        if self.peak is None or not self.compares:
            return None
        return if_any(lambda: first_peak(self.ensemble, self.drive.velocity)).solution

    @property
    def _ends(self) -> bool:
        """True if contacts never form again, so that nothing is steady."""
        kinds = self.ensemble.kinds
        return all(kind.contacts.delay.time == math.inf for kind in kinds)

    def _peaks(self) -> dict[str, Any]:
        """The static peak and the exact one for JSON; empty for a stationary start."""
        peak, exact, known = self.peak, self.exact_peak, None
        if peak is None:
            return {}
        if exact is not None:
            level = reference(self.ensemble, self.drive).friction
            known = {name: estimate.value for name, estimate in exact._asdict().items()}
            known["ratio"] = _peak_ratio(exact.force, level).value
        ratio = _peak_ratio(peak.force, self.steady.friction)
        estimates = {**peak._asdict(), "ratio": ratio}
        shown = {name: estimate.as_dict() for name, estimate in estimates.items()}
        return {"peak": {**shown, "exact": known}}

    def summary(self) -> dict[str, Any]:
        run, divergence = self.trajectory, self.ensemble.divergence
        averages, level = run.averages.averages(), self.steady.averages()
        return {
            "title": self.file.title,
            **{name: estimate.as_dict() for name, estimate in averages.items()},
            **self._peaks(),
            **({"divergence": divergence} if divergence else {}),
            "force_reliable": run.force_reliable,
            "steady": {name: estimate.as_dict() for name, estimate in level.items()},
            **self.file.physical(run.averages.friction, self.steady.friction.value),
            **self.made(),
        }

    def tables(self) -> dict[str, Any]:
        """The trajectory, and series and breaks if they are asked for."""
        listed = {"breaks": self.breaks.columns()} if self.breaks is not None else {}
        return super().tables() | listed

    def figures(self, title: str) -> dict[str, Any]:
        """The force against displacement beside the exact mean and the steady value."""
        caption = self.caption(title, self.steady.friction.value)
        draw, exact = runs.trajectory_figure, self.exact.solution
        return {"force": draw(self.trajectory, self.steady, exact, caption)}

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Averages, if any is steady, and the peak beside their expected values."""
        averages = self.trajectory.averages
        rows = self.file.rows(averages)
        yield "", "this run", "expected", *unit_column(rows), "z"
        for name, row in () if self._ends else rows:
            found, level = getattr(averages, name), getattr(self.steady, name)
            yield _beside_expected(row, found, level)
        if self.peak is None:
            return
        quantity, length = self.file.preferred(self.peak.force), rows[0][1].unit
        unit = (quantity.unit,) if quantity else length
        forces = Row(f"peak_{quantity.short if quantity else 'force'}", unit, quantity)
        for name, row in (("force", forces), ("X", Row("peak_X", length))):
            exact = getattr(self.exact_peak, name, None)
            yield _beside_expected(row, getattr(self.peak, name), exact)

    def notes(self) -> Iterator[str]:
        averages = self.trajectory.averages.averages().values()
        if self.ensemble.divergence:
            yield self.ensemble.divergence
        if self._ends:
            yield "contacts never form again: no steady averages; peak: the first maximum of the force"
        elif not all(one.reliable or one.diverges for one in averages):
            yield "unreliable: the steady state was not reached before the second half, or too few contacts broke in it"
        if self.peak and not self._ends:
            yield "averages: over the second half of the run; peak: the first maximum of the force after the start"
        yield from _doubt(self.trajectory)
        yield from self.speed()


def _beside_expected(
    row: Row, found: Estimate, exact: Estimate | None, scored: bool = True
) -> tuple[Any, ...]:
    """A row of an estimate, its expected value, and if `scored` z, their difference."""
    z = difference_of(found, exact) if scored else "none"
    known = "none" if exact is None else row.of(exact)
    return row.label, row.of(found), known, *row.unit, z


def _doubt(run: Any) -> Iterator[str]:
    """Note that standard errors of the force cannot be trusted, if so."""
    if not run.force_reliable:
        yield "force_stderr: not to be trusted, forces this heavy-tailed need more contacts"


def _peak_ratio(peak: Estimate, level: Estimate) -> Estimate:
    """Ratio of a static peak to the steady friction."""
    if not peak.value or not level.value:
        return Estimate(None, None, peak.n, reliable=False)
    errors = (peak.stderr or 0.0) / peak.value, (level.stderr or 0.0) / level.value
    value = peak.value / level.value
    stderr = abs(value) * math.hypot(*errors)
    return Estimate(value, stderr, peak.n, None, peak.reliable)


@dataclass(frozen=True, repr=False)
class ProgrammeResult(SimulatedFile):
    """Simulation of a run file with a programme."""

    file: RunFile
    trajectory: ProgrammeTrajectory
    who: str = "threads"
    compares: bool = True

    @cached_property
    def exact_segments(self) -> tuple[SegmentRecord, ...]:
        """Segments of the exact mean, as those of the run; empty if there is none."""
        exact = self.exact.solution
        if exact is None:
            return ()
        # behind a spring the X of the grid is the stage's, that of the solution the
        # slider's
        grid = self.drive.grid(self.file.output.points)._replace(X=exact.X)
        forces = Forces(exact.force, exact.force_error)
        return shown_by(self.drive, grid, forces, X_stderr=exact.X_error)

    def summary(self) -> dict[str, Any]:
        run = self.trajectory
        segments = [asdict(segment) for segment in run.segments]
        for segment, exact in zip(segments, self.exact_segments, strict=False):
            found = observed(exact).items()
            segment["exact"] = {name: estimate.value for name, estimate in found}
        healing = {"healing": self.healing.as_dict()} if self.healing else {}
        physical = {  # factors of F/(N k), and the units of the products
            quantity.name: {"factor": quantity.factor, "unit": quantity.unit}
            for quantity in self.file.quantities
        }
        known: dict[str, Any] = healing | ({"physical": physical} if physical else {})
        known["force_reliable"] = run.force_reliable
        return {"title": self.file.title, "segments": segments, **known, **self.made()}

    @property
    def _holds(self) -> tuple[Array, Array, Array]:
        """Times of holds, and healing after them with its errors."""
        segments, held = self.trajectory.segments, 0.0
        rows = []
        for segment, given in zip(segments, self.drive.segments, strict=True):
            if segment.healing and segment.healing.reliable:
                rows.append((held, segment.healing.value, segment.healing.stderr))
            held = 0.0 if segment.velocity else held + given.duration
        hold, healing, stderr = np.array(rows, float).reshape(-1, 3).T
        return hold, healing, stderr

    @cached_property
    def healing(self) -> Healing | None:
        """The logarithm through the healing after holds, if there are several."""
        return healing_law(*self._holds)

    def figures(self, title: str) -> dict[str, Any]:
        """The force along the programme, and the healing after several holds."""
        level = float(np.abs(self.trajectory.force).max())
        caption = self.caption(title, level)
        figures = {"force": self._force_figure(caption)}
        if self.healing:
            pairs = zip(self.trajectory.segments, self.exact_segments, strict=False)
            healed = [b for a, b in pairs if a.healing and a.healing.reliable]
            exact = np.array([known(one.healing) for one in healed if one.healing])
            drawn = self._holds, exact, self.healing, caption
            figures["healing"] = runs.healing_figure(*drawn)
        return figures

    def _force_figure(self, caption: Any) -> Any:
        """The picture of the force along the programme."""
        return runs.programme_figure(self.trajectory, self.exact.solution, caption)

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Force at the end and at the peak of each segment, as a quantity of the
        interface if there is one; z compares the force at the end with the exact
        mean."""
        exact, segments = self.exact_segments, self.trajectory.segments
        shown = self.file.preferred(segments[0].peak)
        forces, row = ("force then", "z", "peak"), Row("", (), shown)
        if shown:
            unit = f" [{shown.unit}]" * bool(shown.unit)
            forces = f"{shown.symbol} then{unit}", "z", f"{shown.symbol} at its peak"
        yield "", "velocity", "until t", *forces, "after X or t"
        for index, segment in enumerate(segments[:_MOST_LINES]):
            level = exact[index].end if exact else None
            z = difference_of(segment.end, level)
            velocity = "hold" if segment.velocity == 0 else f"{segment.velocity:.6g}"
            end, peak = row.of(segment.end), row.of(segment.peak)
            yield str(index), velocity, f"{segment.t:.6g}", end, z, peak, segment.at
        if len(segments) > _MOST_LINES:
            yield "...", *[""] * 6

    def notes(self) -> Iterator[str]:
        segments = self.trajectory.segments
        shown = self.file.preferred(segments[0].peak)
        row = Row("", (), shown)
        of = f" of {shown.symbol}" if shown else ""

        def told(found: dict[str, Any]) -> str:
            return ", ".join(f"{name} {row.of(x)}" for name, x in found.items() if x)

        noisy = self.file["drive.file"] is not None and len(segments) > _MOST_LINES
        if noisy:
            yield "steps and holds of a long record: drive.record.smooth = true tells them from noise"
        for index, segment in enumerate(() if noisy else segments[:_MOST_LINES]):
            names = "relaxation", "healing", "drop"
            if said := told({name: getattr(segment, name) for name in names}):
                where = "reload" if segment.velocity else "hold"
                yield f"{where} of segment {index}: {said}{of}"
            if step := segment.step:
                effects = {"direct": step.direct, "evolution": step.evolution}
                said = told(effects | {"a - b": step.a_minus_b})
                memory = f"memory length {step.memory}"
                yield f"velocity step of segment {index}: {said}{of} per ln v; {memory}"
        if self.healing:
            time = self.file.units.time
            yield f"healing{of}: {self.healing.told(row.of(self.healing.rate), time)}"
        if self.drive.loaded and shown and shown.symbol == "mu":
            yield "mu: friction over the normal load at the start"
        yield from self.doubts()
        yield from self.speed()

    def doubts(self) -> Iterator[str]:
        """Notes on errors that cannot be trusted."""
        yield from _doubt(self.trajectory)


@dataclass(frozen=True, repr=False)
class SliderResult(ProgrammeResult):
    """Simulation of a run file whose slider a stage, a force or a motor pulls."""

    trajectory: SliderTrajectory
    exact_name = "mean field"

    @cached_property
    def exact(self) -> Solved[Transient]:
        """The mean field."""
        count, spring = self.ensemble.count, self.drive.stage and not self.drive.motor
        if self.compares and count < _FEW and not spring:
            said = f"a mean field is of many contacts, at least {_FEW}"
            return Solved(None, f"{said}; these are {count}")
        return super().exact

    @property
    def failures(self) -> dict[str, Estimate]:
        """Mean lifetime of bundles that all let go under a force, and the mean force at
        that time if it changes; else empty."""
        return failures_of(self.trajectory, self.drive)

    def summary(self) -> dict[str, Any]:
        run = self.trajectory
        means = {name: getattr(run, name).as_dict() for name in ("period", "drop")}
        means |= {name: found.as_dict() for name, found in self.failures.items()}
        slips = [asdict(slip) for slip in run.slips]
        return super().summary() | means | {"slips": slips}

    def tables(self) -> dict[str, Any]:
        """The trajectory, and avalanches of a slider without mass and damping."""
        avalanches = self.trajectory.avalanches
        listed = {} if avalanches is None else {"avalanches": avalanches}
        return super().tables() | listed

    def figures(self, title: str) -> dict[str, Any]:
        """Forces and displacements of slider and stage, and sizes of avalanches."""
        figures, avalanches = super().figures(title), self.trajectory.avalanches
        if avalanches is None or self._pulled_by == "motor":
            return figures
        if avalanches["breaks"].size:
            sizes = self._sizes(avalanches["breaks"], avalanches["t"])
            caption = self.caption(title, None)
            drawn = *sizes, caption, self.drive.forced
            figures["avalanches"] = runs.sizes_figure(*drawn)
        return figures

    @property
    def _pulled_by(self) -> str:
        """Name what pulls the slider: "force", "stage" or, without one, "motor"."""
        alone = "force" if self.drive.forced else "motor"
        return "stage" if self.drive.stage else alone

    def _force_figure(self, caption: Any) -> Any:
        exact, pulled_by = self.exact.solution, self._pulled_by
        return runs.slider_figure(self.trajectory, exact, caption, pulled_by)

    def _sizes(self, breaks: Array, t: Array) -> tuple[Array, int, Array]:
        """Sizes of bursts under a force, or of avalanches in the second half of a run
        behind a stage; what numbers are divided by, and the exact law, if there is
        one."""
        per = self.ensemble.count * self.file.output.replicas
        if not self.drive.forced:
            breaks = breaks[t > 0.5 * self.trajectory.t[-1]]
            per = breaks.size
        return breaks, per, self._law_of_sizes()

    def _law_of_sizes(self) -> Array:
        """P(1), P(2), ... of avalanches, or numbers of bursts, of infinitely many
        contacts; empty where they are not alike, have equal thresholds, are born
        stretched, age or are broken by heat, behind a stage with a delay, and under a
        force that is not raised from 0 until all contacts are broken for ever."""
        contacts, drive, run = self.ensemble, self.drive, self.trajectory
        law, springs = contacts.thresholds, contacts.stiffness_law
        changing = (contacts.thermal, contacts.aging, contacts.newborn)
        if contacts.populations or law.steps.size or any(x.active for x in changing):
            return np.empty(0)
        if drive.stage:
            if contacts.delay.time:
                return np.empty(0)
            load = load_of(law, drive.stage.stiffness, springs)
            return size_law(law, load, _LARGEST_SIZE, springs)
        jumps = len(drive.segments) > 1 or drive.segments[0].force
        broken = np.all(np.isfinite(run.lifetimes))
        if jumps or not broken or contacts.delay.time < math.inf:
            return np.empty(0)
        found = if_any(lambda: bursts(contacts, range(1, _LARGEST_SIZE + 1)))
        return found.solution.number if found.solution else np.empty(0)

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Each slip, and the mean period and drop, which leave out the first; under a
        force the lifetime and strength, and the exact lifetime of identical
        contacts."""
        run, drive = self.trajectory, self.drive
        if drive.forced:
            known = if_any(lambda: lifetime(self.ensemble, drive, points=2)).solution
            yield "", "this run", "expected", "z"
            for name, found in self.failures.items():
                exact, z = "", ""
                if known and name == "lifetime":
                    exact = f"{known.mean.value:.10g}"
                    z = difference_of(found, known.mean)
                yield name, found, exact, z
            yield from self._standing()
            return
        if len(drive.segments) > 1 or not run.slips:
            yield from super().rows()
            return
        largest = max(slip.drop for slip in run.slips)
        shown = self.file.preferred(Estimate(largest, None, 0))
        factor, of = 1.0, "drop of the force"
        if shown:
            unit = f" [{shown.unit}]" * bool(shown.unit)
            factor, of = shown.factor, f"drop of {shown.symbol}{unit}"
        yield "slip", "at t", "at X", of, "takes", "over"
        for index, slip in enumerate(run.slips[:_MOST_LINES]):
            bound = "" if slip.begun and slip.ended else "> "
            distance = abs(slip.distance) if bound else slip.distance
            sizes = (factor * slip.drop, slip.duration, distance)
            places = (f"{number:.6g}" for number in (slip.t, slip.X))
            yield str(index), *places, *(f"{bound}{number:.6g}" for number in sizes)
        if len(run.slips) > _MOST_LINES:
            yield "...", *[""] * 5
        if run.period.value is not None:
            drop = Row("", (), shown).of(run.drop)
            yield "mean", f"every {run.period}", "", drop, "", ""

    def _standing(self) -> Iterator[tuple[Any, ...]]:
        """Displacement and pinned share at the end of a slider that a force has not
        torn off, scored where their scatter is known."""
        run, mean = self.trajectory, self.exact.solution
        for name in ("X", "pinned"):
            value, error = getattr(run, name)[-1], getattr(run, f"{name}_stderr")[-1]
            found = Estimate(float(value), float(error), run.t.size)
            if not math.isfinite(value):  # it has let go
                continue
            exact = None
            if mean is not None:
                level = getattr(mean, name)[-1], getattr(mean, f"{name}_error")[-1]
                exact = Estimate(float(level[0]), float(level[1]), run.t.size)
            scored = error > 0.0 and run.force_reliable
            yield _beside_expected(Row(f"{name} at the end"), found, exact, scored)

    def doubts(self) -> Iterator[str]:
        """Notes on slips, those that the record cuts, and errors of the force."""
        slips, lives = self.trajectory.slips, self.trajectory.lifetimes
        counted = f"{len(slips)} slip" + "s" * (len(slips) != 1)
        if self.drive.forced:
            gone = np.sum(np.isfinite(lives))
            yield f"{gone} of {lives.size} replicas let go before the end"
        elif slips and len(self.drive.segments) > 1:
            run = self.trajectory
            mean = f"one every {run.period}, drop {run.drop}"
            yield counted + f": {mean}" * (run.period.value is not None)
        else:
            yield counted if slips else "no slip in this run"
        for verb, whole in (("begins", "begun"), ("ends", "ended")):
            cut = [str(i) for i, slip in enumerate(slips) if not getattr(slip, whole)]
            if cut:
                more = ["..."] * (len(cut) > _MOST_NAMED)
                named = ", ".join(cut[:_MOST_NAMED] + more)
                yield _CUT.format(verb, f"slip{'s' * (len(cut) > 1)} {named}")
        if not self.trajectory.force_reliable:
            yield "force_stderr: scatter of contacts at the same X; the scatter of X is known from 8 replicas on"


def run(
    file: RunFile | Path | str,
    folder: Path | None = None,
    *,
    threads: int = 1,
    workers: Workers | None = None,
    max_lives: float = 1e10,
    exact: bool = True,
    progress: Progress = lambda *_: None,
    keep: Path | States | None = None,
) -> RunResult | ProgrammeResult | ElasticResult:
    """Simulate a run file, and at constant velocity estimate the steady averages that
    belong to it.

    Parameters
    ----------
    file : RunFile, Path or str
        A run file or the path of one.
    folder : Path, optional
        Folder of relative paths in the run file; by default its own.
    threads : int
        Threads of this process; results do not depend on their number.
    workers : Workers, optional
        Processes instead of threads; results are the same to the last bit.
    max_lives : float
        Largest number of lives that a run may need.
    exact : bool
        False for particles only, without exact curve and peak beside them; blocks have
        none.
    progress : callable, optional
        Called as `progress(done, expected)`, numbers of lives.
    keep : Path or States, optional
        Folder where a run of coupled blocks that is stopped leaves its states, every
        half a minute; the next run of the same file goes on from these within 30 days,
        with the same bits, and removes them when it is finished. States that are given
        (`eqsim.io.states.kept`) stay.

    Returns
    -------
    RunResult, ProgrammeResult or ElasticResult

    Raises
    ------
    InputError
        If the run file cannot be simulated, if more than `max_lives` lives are
        predicted, or if a worker is lost.

    Examples
    --------
    >>> from eqsim import run
    >>> text = "[contacts]\\ncount = 500\\n[drive]\\nvelocity = 0.1\\ndistance = 5.0\\n"
    >>> _ = Path("x.toml").write_text(text)
    >>> result = run("x.toml", changes={"output.points": 6})
    >>> result.trajectory.X.tolist(), result.steady.reached
    ([0.0, 1.0, 2.0, 3.0, 4.0, 5.0], True)
    """
    require_threads(threads)
    file = opened(file, folder)
    ensemble, drive, output = file.ensemble, file.drive, file.output
    chain = isinstance(drive, Programme) and drive.chain
    if drive.elastic or chain:
        if workers:
            said = "coupled blocks are simulated in one process; threads share replicas"
            raise InputError(f"--workers, --dask: {said}")
        with kept(file, keep) as states:
            how = How(threads, max_lives, progress, states)
            if chain:
                from eqsim.workflows.chain import run_chain

                return run_chain(file, how)
            return run_elastic(file, how)
    draws: dict[str, Any] = {"seed": output.seed, "replicas": output.replicas}
    rough = 5e-3 if ensemble.fluctuates else 1e-3  # lives with paths cost more
    with ExitStack() as stack:
        expected = check_run(ensemble, drive, output, max_lives)
        if output.series and workers:
            said = "is kept by threads only, not with --workers or --dask"
            raise InputError(f"output.series: {said}")
        if output.breaks and isinstance(drive, Drive):
            check_breaks(ensemble, drive, output)
        pool = stack.enter_context(workers.fixed_pool()) if workers else None
        progress(0, expected)
        level = None
        if isinstance(drive, Drive):
            level = steady(
                ensemble, drive, rel_error=rough, seed=output.seed, threads=threads, max_lives=max_lives
            )  # fmt: skip
        simulated: Any = trajectory(
            ensemble, drive, points=output.points, **draws, max_lives=max_lives,
            threads=(pool.executor, pool.slots()) if pool else threads,
            progress=lambda lives: progress(lives, expected),
        )  # fmt: skip
    who = "workers" if workers else "threads"
    if isinstance(drive, Drive):
        assert level
        listed = None
        if output.breaks:
            listed = breaks(ensemble, drive, **draws, threads=threads)
        return RunResult(file, level, simulated, listed, who, exact)
    kind = SliderResult if drive.pulled else ProgrammeResult
    return kind(file, simulated, who, exact)
