"""Interface of the results of commands on a run file: every kind of result defines its
table, JSON, files and pictures."""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast

from eqsim.errors import InputError
from eqsim.estimate import Estimate, score
from eqsim.io import labels, storage, terminal
from eqsim.io.runfile import RunFile
from eqsim.io.states import States
from eqsim.lazy import lazily
from eqsim.master.programme import Transient, heat_is_idle
from eqsim.master.transient import transient
from eqsim.model.ensemble import Ensemble
from eqsim.results import Listed, Physical, tell_quantities

with lazily():
    from eqsim.plots import panels, style


Progress = Callable[[int, float], None]
Exact = TypeVar("Exact")


class How(NamedTuple):
    """How blocks are simulated; `keep`: states of a stopped run."""

    threads: int
    max_lives: float
    progress: Progress
    keep: States | None


class Solved(NamedTuple, Generic[Exact]):
    """An exact `solution`, or None and the `reason` why there is none."""

    solution: Exact | None
    reason: str = ""


class FileResult:
    """The result of a command on a run file `file`."""

    command: ClassVar[str]  # name of the command that made it
    summarised: ClassVar[bool] = True  # whether its folder has a summary.json
    file: RunFile

    @property
    def ensemble(self) -> Ensemble:
        """The contacts of the run file."""
        return self.file.ensemble

    @property
    def drive(self) -> Any:
        """The drive of the run file."""
        return self.file.drive

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the call, with which `eqsim replay` repeats it."""
        return self.file.settings

    @property
    def phase(self) -> str:
        """Name of the work that its files wait for, as a progress bar shows it."""
        return "writing"

    def summary(self) -> dict[str, Any]:
        """The content of summary.json, and what --json prints."""
        raise NotImplementedError

    def tables(self) -> dict[str, Any]:
        """Columns of each table by its name."""
        return {}

    def figures(self, title: str) -> dict[str, Any]:
        """Pictures by name, with `title` unless the run file has one."""
        return {}

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """The table that a terminal shows: names of columns, and rows."""
        raise NotImplementedError

    def notes(self) -> Iterator[str]:
        """Lines below the table."""
        yield from ()

    def report(self, name: str, *more: str) -> terminal.Report:
        """Table and notes, also `more`, titled `name` unless the run file has a title."""
        head, *rows = self.rows()
        notes = [*self.notes(), *more]
        return terminal.Report(self.summary(), self.title(name), head, rows, notes)

    def title(self, name: str) -> str:
        """Title of the table."""
        return self.file.headline(name)

    def written(self, files: Sequence[str]) -> str:
        """List of the `files` in its folder, as a note."""
        return ", ".join(files)

    def origin(self) -> dict[str, Any]:
        """Provenance of tables."""
        made = self.file.text, self.file.output.seed, self.file.folder
        return storage.provenance(self.command, self.settings, *made)

    def files(
        self, title: str = "", formats: Sequence[str] = ("png",)
    ) -> dict[str, bytes]:
        """The files of a results folder by name; `title` as in `figures`."""
        origin, tables = self.origin(), self.tables().items()
        files = {f"{name}.parquet": storage.parquet(x, origin) for name, x in tables}
        if self.summarised:
            files["summary.json"] = storage.to_json(self.summary()).encode()
        for name, figure in self.figures(title).items():
            files |= style.pictures(name, figure, formats)
        return files


class SimulatedFile(FileResult, Listed):
    """Simulation of a run file: a `trajectory`, drawn with the exact mean if there is
    one, and it `compares`; `who`, "threads" or "workers", shared the work."""

    command = "run"
    trajectory: Any
    who: str = "threads"
    compares: bool = True
    exact_name = "exact curve"

    def __post_init__(self) -> None:
        tell_quantities(self, self.file.quantities_in)

    def in_units(self, units: Any = None, interface: Any = None) -> dict[str, Physical]:
        """The force of the trajectory as `Result.in_units` gives it."""
        return cast(dict[str, Physical], self.trajectory.in_units(units, interface))

    @property
    def phase(self) -> str:
        return self.exact_name if self.compares else super().phase

    @cached_property
    def exact(self) -> Solved[Transient]:
        """The exact mean, or the reason why there is none."""
        if not self.compares:
            return Solved(None, "not asked for")
        points = self.file.output.points
        return if_any(lambda: transient(self.ensemble, self.drive, points))

    @property
    def folder(self) -> Any:
        """The folder in which paths in the run file start."""
        return self.file.folder

    def to_pandas(self) -> Any:
        """A DataFrame of the trajectory."""
        return self.trajectory.to_pandas()

    def plot(self, axes: Any = None, **style: Any) -> Any:
        """Draw the trajectory and the exact mean; arguments as of `Result.plot`."""
        x, given, exact = self.trajectory.drawn.x, axes, self.exact.solution
        axes = self.trajectory.plot(axes, **{"label": "simulated contacts", **style})
        if given is None:
            axes.set(**labels.of_trajectory(x, self.file.units))
        if exact is not None:
            line = {"linewidth": 1, "label": "exact mean"}
            axes.plot(getattr(exact, x), exact.force, "k:", **line)
            axes.legend()
        return axes

    def picture(self, title: str = "") -> Any:
        """The picture of the force, with `title` unless the run file has one."""
        return self.figures(title)["force"]

    def tables(self) -> dict[str, Any]:
        """The trajectory, and that of every replica if `output.series` asks for it."""
        tables = {"trajectory": self.trajectory.columns()}
        if self.file.output.series:
            tables["replicas"] = self.trajectory.replicas()
        return tables

    def made(self) -> dict[str, Any]:
        """Lives, time, threads, seed and versions, for JSON."""
        names = ("lives", "engine_seconds", "threads", "seed")
        how = {name: getattr(self.trajectory, name) for name in names}
        left_out = {} if self.compares else {"exact_curve": self.exact.reason}
        return {**how, **left_out, "versions": storage.versions()}

    def caption(self, title: str, level: float | None) -> Any:
        """The caption of a picture of forces of about a `level`."""
        caption = panels.Caption.of(self.file, title, level)
        without = "" if self.compares else "; no exact curve"
        return caption._replace(detail=caption.detail + without)

    def speed(self) -> Iterator[str]:
        """Notes on lives, speed, who simulated, and why there is no exact mean."""
        run, count = self.trajectory, self.ensemble.count * self.file.output.replicas
        contacts = f" of {terminal.count(count)} contacts"
        speed = terminal.lives(run.lives, run.engine_seconds, contacts)
        who = self.who if run.threads > 1 else self.who.removesuffix("s")
        yield f"{speed}, {run.threads} {who}, seed {run.seed}"
        if self.exact.reason:
            yield f"no exact curve: {self.exact.reason}"
        elif heat_is_idle(self.ensemble, self.drive):
            b = max(kind.contacts.b for kind in self.ensemble.kinds)
            yield f"heat is idle, b = {b:.3g}: exact curve at T = 0; its error covers the difference"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.trajectory!r})"

    def _repr_html_(self) -> str:
        return str(self.trajectory._repr_html_())


def if_any(solve: Callable[[], Exact]) -> Solved[Exact]:
    """Solve, unless the solver refuses by InputError."""
    try:
        return Solved(solve())
    except InputError as error:
        return Solved(None, str(error))


def difference_of(found: Estimate, expected: Estimate | None) -> str:
    """The `score` of an estimate beside its expected value as text; "none" if a value
    or an error of these is not known."""
    if expected is None:
        return "none"
    numbers = found.value, found.stderr, expected.value, expected.stderr
    return "none" if None in numbers else terminal.score(score(found, expected))
