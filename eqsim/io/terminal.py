"""What a terminal shows: results of commands, values with their errors, progress."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eqsim.io.storage import to_json

if TYPE_CHECKING:
    from eqsim.estimate import Estimate

_LONG = 20.0  # seconds from which on the time left is announced


@dataclass(frozen=True)
class Report:
    """The result of a command: `data` for machines; for people a table, unless it has no columns, and lines below."""

    data: Any
    title: str = ""
    columns: Sequence[str] = ()
    rows: Iterable[Sequence[str]] = ()
    notes: Iterable[str] = ()

    def show(self, json: bool = False, quiet: bool = False) -> None:
        """Print it: as JSON, as table and lines, or not at all."""
        if json:
            print(to_json(self.data))
        elif not quiet:
            if self.columns:
                self._table()
            for line in self.notes:
                print(line)

    def _table(self) -> None:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table()
        for place, column in enumerate(self.columns):
            justify: Any = "left" if column in ("", "group", "meaning", "unit") else "right"
            table.add_column(column, justify=justify, overflow="fold", no_wrap=place == 0)  # names stay whole
        for row in self.rows:
            table.add_row(*row)
        Console().print(Text(self.title, style="bold"), table)


def value_and_error(estimate: "Estimate") -> str:
    """Value(error in the last two digits), as physicists write it."""
    return str(estimate)


def relative_error(estimate: "Estimate") -> str:
    """Standard error over value."""
    return "exact" if not estimate.stderr or not estimate.value else f"{abs(estimate.stderr / estimate.value):.1e}"


def score(z: float | None) -> str:
    """A difference in standard errors; None if there is neither."""
    return "exact" if z is None else f"{z:+.2f}"


def count(number: float) -> str:
    """A count to three digits, with k, M, G or T."""
    for size, letter in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= size:
            return f"{number / size:.3g} {letter}"
    return f"{number:.3g}"


def lives(number: int, seconds: float, of: str = "") -> str:
    """How many were simulated, and how fast."""
    return f"{count(number)} lives{of} in {seconds:.2f} s ({count(number / max(seconds, 1e-9))}/s)"


def duration(seconds: float) -> str:
    """Seconds in the largest unit of which there are two, to two digits or one decimal."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.2g} s"


def announcing(progress: Callable[[int, int], None], note: Callable[[str], None]) -> Callable[[int, int], None]:
    """`progress(done, total)` of lives that are drawn in attempts, each of which begins with done = 0; it also notes
    how long an attempt of more than 20 s will take, by the speed of the one before."""
    begin, speed, largest = 0.0, 0.0, 0

    def announced(done: int, total: int) -> None:
        nonlocal begin, speed, largest
        now = time.perf_counter()
        if done == 0:
            begin = now
            if speed and total > max(largest, _LONG * speed):
                largest = total
                note(f"about {duration(total / speed)} to go: {count(total)} lives at {count(speed)}/s")
        elif now > begin:
            speed = done / (now - begin)
        progress(done, total)

    return announced


@contextmanager
def bar(title: str, silent: bool, unit: str) -> Iterator[Callable[[int, float], None]]:
    """A progress bar on the terminal's standard error, for `progress(done, total)`; it tells when kernels are
    compiled."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if silent or not console.is_terminal:
        yield lambda *_: None
        return
    from numba.core import event

    shown = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[rate]} " + unit + "/s"),
        TimeRemainingColumn(), console=console, transient=True, speed_estimate_period=3600.0,
    )  # fmt: skip
    task = shown.add_task(title, total=None, rate="0")
    begin: list[float] = []

    class Compiling(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            shown.update(task, description="compiling kernels, first run only")

        def on_end(self, _: Any) -> None:
            shown.update(task, description=title)

    def progress(done: int, total: float) -> None:
        now = time.perf_counter()
        if done == 0:
            begin.clear()
        elif not begin:
            begin.append(now)
        speed = done / (now - begin[0]) if begin and now > begin[0] else 0.0
        description = title if unit == "lives" else f"{title} {done}/{total:.0f}"
        shown.update(task, completed=done, total=total, description=description, rate=count(speed))

    with shown, event.install_listener("numba:compile", Compiling()):
        yield progress
