"""Results of `eqsim run` for a chain of blocks that moves in time."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eqsim.engine.chain import chain_trajectory
from eqsim.engine.chain_records import ChainTrajectory
from eqsim.engine.trajectory import check_run, guarded
from eqsim.errors import InputError, shown
from eqsim.io.runfile import RunFile
from eqsim.lazy import lazily
from eqsim.model.drive import Programme
from eqsim.workflows.report import How, Solved
from eqsim.workflows.run import ProgrammeResult

with lazily():
    from eqsim.plots import chains as draw

_MOST_EVENTS = 20  # events that a table shows
_MEANS = ("static_friction", "recurrence", "precursors", "front_speed")


@dataclass(frozen=True, repr=False)
class ChainResult(ProgrammeResult):
    """Simulation of a run file with a chain of blocks in time."""

    trajectory: ChainTrajectory
    exact = Solved(None)

    def summary(self) -> dict[str, Any]:
        """Forces of segments, means over events and fronts, and how slip is spread."""
        run = self.trajectory
        means = {name: getattr(run, name).as_dict() for name in _MEANS}
        whole = run.events["blocks"] == run.chain.count
        found = {"events": whole.size, "full_events": int(whole.sum())}
        found["fronts"] = run.fronts["t"].size
        speed = {"wave_speed": run.chain.wave_speed if run.chain.mass else None}
        slip = {"gini": run.gini, "correlation_length": run.correlation_length}
        steps = {"steps": sum(run.steps)}
        return super().summary() | means | found | speed | slip | steps

    def tables(self) -> dict[str, Any]:
        """The trajectory, every block at every record, blocks that broke, events and
        fronts."""
        run = self.trajectory
        lists = {"blocks": run.blocks, "broke": run.broke}
        return super().tables() | lists | {"events": run.events, "fronts": run.fronts}

    def figures(self, title: str) -> dict[str, Any]:
        """The force of the drive, and events and fronts in space and time."""
        run, level = self.trajectory, float(np.abs(self.trajectory.spring).max())
        caption = self.caption(title, level)
        figures = {"force": draw.chain_figure(run, caption)}
        if run.events["t"].size:
            figures["fronts"] = draw.fronts_figure(run, caption)
        return figures

    def animate(self, path: Path | str) -> None:
        """Write a film of the blocks, of at most 200 pictures, as GIF or, where ffmpeg
        is installed, MP4: `eqsim.run("fronts.toml").animate("fronts.gif")`. Raises
        InputError for another ending."""
        writers = {".gif": "pillow", ".mp4": "ffmpeg"}
        writer = writers.get(Path(path).suffix)
        if writer is None:
            raise InputError(f"path = {shown(str(path))}: must end with .gif or .mp4")
        film: Any = draw.animation_of(self.trajectory, self.caption("", None))
        film.save(path, writer=writer)

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Each event with its fastest front; segments if there is no event."""
        run = self.trajectory
        events, fronts = run.events, run.fronts
        if not events["t"].size:
            yield from super().rows()
            return
        yield "event", "at t", "takes", "blocks", "peak", "drop", "fastest front", ""
        for i in range(min(_MOST_EVENTS, events["t"].size)):
            here = fronts["event"] == events["event"][i]
            here &= fronts["replica"] == events["replica"][i]
            front = ("none", "")
            if here.any():
                fastest = np.flatnonzero(here)[np.argmax(fronts["speed"][here])]
                speed = float(fronts["speed"][fastest])
                error = float(fronts["speed_stderr"][fastest])
                front = f"{speed:.3g} +- {error:.1g}", run.kind_of(speed)
            blocks = events["blocks"][i]
            kind = f"{blocks} (all)" if blocks == run.chain.count else f"{blocks}"
            bound = "" if events["ended"][i] else "> "
            times = f"{events['t'][i]:.5g}", f"{bound}{events['duration'][i]:.5g}"
            forces = (f"{events[name][i]:.4g}" for name in ("peak", "drop"))
            yield str(i), *times, kind, *forces, *front
        if events["t"].size > _MOST_EVENTS:
            yield "...", *[""] * 7

    def doubts(self) -> Iterator[str]:
        """Notes on events, means over them, and on the start and errors."""
        run = self.trajectory
        events = run.events["blocks"]
        whole = int(np.sum(events == run.chain.count))
        none = "no event: no block broke while one moved twice as fast as the drive"
        yield f"{events.size} events, {whole} of all blocks" if events.size else none
        if going := int(np.sum(~run.events["ended"])):
            yield f"{going} under way at the end, not in means over events"
        said = {
            "static friction before events of all blocks": run.static_friction,
            "their recurrence": run.recurrence,
            "precursors break": run.precursors,
            "speed of fronts": run.front_speed,
        }
        known = [f"{k} {v}" for k, v in said.items() if v.value is not None]
        if known:
            more = f", c = {run.chain.wave_speed:.4g}" if run.chain.mass else ""
            yield "; ".join(known) + more * (run.front_speed.value is not None)
        yield f"slip: Gini coefficient {run.gini:.3g}, correlation length {run.correlation_length:.3g} blocks"
        if self.drive.start == "stationary":
            yield "the stationary start is that of independent blocks"
        if not run.force_reliable:
            yield "force_stderr: scatter of contacts at the same X; the scatter of X is known from 8 replicas on"


def run_chain(file: RunFile, how: How) -> ChainResult:
    """Simulate a run file whose `drive` has a chain. Raises InputError."""
    ensemble, drive, output = file.ensemble, file.drive, file.output
    assert isinstance(drive, Programme)
    expected = check_run(ensemble, drive, output, how.max_lives)
    how.progress(0, expected)

    def told(lives: int) -> None:
        how.progress(lives, max(lives, expected))

    def front(block: int) -> None:
        assert drive.chain
        say(f"front at block {block + 1} of {drive.chain.count}")

    say = getattr(how.progress, "say", lambda _: None)  # a bar shows it
    guard = guarded(told, expected, how.max_lives)
    given = how.threads, guard, how.keep, front
    found = chain_trajectory(ensemble, drive, output, *given)
    return ChainResult(file, found)
