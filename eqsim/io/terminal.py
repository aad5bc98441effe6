"""Output on a terminal: results of commands, numbers, progress."""

import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
from rich.table import Table
from rich.text import Text

from eqsim.lazy import lazily
from eqsim.numerics.kernel_folder import compiling_since

with lazily():
    from eqsim.io import storage

LONG_ATTEMPT = 20.0  # seconds from which on the time left is announced
_COMPILING = 1.0  # seconds after which the bar says that kernels are compiled
_FILE_WIDTH = 100  # width of a table that goes to a file
_WIDEST = 10_000  # beyond the width of any table
_LEFT_COLUMNS = ("", "group", "meaning", "unit")  # words, which begin at the left


@dataclass(frozen=True)
class Report:
    """The result of a command: `data` for machines; for people a table, unless it has
    no columns, and lines below. Cells are texts, or estimates with their errors."""

    data: Any
    title: str = ""
    columns: Sequence[str] = ()
    rows: Iterable[Sequence[Any]] = ()
    notes: Iterable[str] = ()

    def show(self, json: bool = False, quiet: bool = False) -> None:
        """Print the result as JSON, as table and lines, or not at all."""
        if json:
            print(storage.to_json(self.data))
        elif not quiet:
            if self.columns:
                self._table()
            for line in self.notes:
                print(line)

    def _table(self) -> None:
        """Print the table; no word and no number is cut, and it may be too wide."""
        console, rows = Console(), [tuple(map(str, row)) for row in self.rows]
        if not console.is_terminal and "COLUMNS" not in os.environ:
            console.width = _FILE_WIDTH
        table = Table()
        for name, *cells in zip(self.columns, *rows, strict=True):
            words = " ".join([name, *cells]).split()
            table.add_column(
                Text(name),
                justify="left" if name in _LEFT_COLUMNS else "right",
                min_width=max(map(len, words), default=0),
                no_wrap=not any(" " in text for text in (name, *cells)),
            )
        for row in rows:
            table.add_row(*map(Text, row))
        wide = console.options.update(max_width=_WIDEST)
        least = Measurement.get(console, wide, table).minimum
        console.width = max(console.width, least)  # rich would leave columns empty
        console.print(Text(self.title, style="bold"), table, crop=False)


def relative_error(estimate: Any) -> str:
    """Standard error over value, as text."""
    if estimate.diverges:
        return "none"
    if not estimate.stderr or not estimate.value:
        return "exact"
    return f"{abs(estimate.stderr / estimate.value):.1e}"


def score(z: float | None) -> str:
    """A difference in standard errors as text; None if there is no error."""
    return "exact" if z is None else f"{z:+.2f}"


def some(count: int, parts: int) -> list[int]:
    """Indices of `parts` + 1 rows of a long table, from the first to the last."""
    return sorted({round((count - 1) * part / parts) for part in range(parts + 1)})


def count(number: float) -> str:
    """A count to three digits, with k, M, G or T."""
    number = float(f"{number:.3g}")  # 999 999 is 1 M
    for size, letter in ((1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= size:
            return f"{number / size:.3g} {letter}"
    return f"{number:.3g}"


def lives(number: int, seconds: float, of: str = "") -> str:
    """Text of how many lives were simulated, and how fast."""
    speed = count(number / max(seconds, 1e-9))
    return f"{count(number)} lives{of} in {seconds:.2f} s ({speed}/s)"


def duration(seconds: float) -> str:
    """Seconds in a unit fit for them, to two digits or more."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    if seconds < 0.9995:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.0f} s" if seconds >= 9.95 else f"{seconds:.1f} s"


def announcing(
    progress: Callable[[int, int], None], note: Callable[[str], None]
) -> Callable[[int, int], None]:
    """`progress(done, total)` of lives drawn in attempts, each of which begins with
    done = 0, and a note how long an attempt of over 20 s takes at the speed of the last
    one."""
    begin, speed, largest = 0.0, 0.0, 0

    def announced(done: int, total: int) -> None:
        nonlocal begin, speed, largest
        now = time.perf_counter()
        if done == 0:
            begin = now
            if speed and total > max(largest, LONG_ATTEMPT * speed):
                largest = total
                needed, pace = duration(total / speed), f"{count(speed)}/s"
                note(f"about {needed} to go: {count(total)} lives at {pace}")
        elif now > begin:
            speed = done / (now - begin)
        progress(done, total)

    return announced


class _Doing(TextColumn):
    """Column that names the work, or says that kernels are compiled."""

    def render(self, task: Any) -> Any:
        begin = compiling_since()
        if begin is None or time.monotonic() - begin <= _COMPILING:
            return super().render(task)
        return Text("compiling kernels, once for these laws")


class _Pace(ProgressColumn):
    """Column of units per second and the time left, or if these are not known, as while
    kernels are compiled, of the time so far."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self.unit = unit

    def render(self, task: Any) -> Any:
        left = task.time_remaining
        if not left or compiling_since() is not None:
            return Text(f"{duration(task.elapsed or 0.0)} so far")
        return Text(f"{count(task.speed)} {self.unit}/s, {duration(left)} to go")


class _Shown:
    """`progress(done, total)` of a bar, beside which `say` shows a text."""

    def __init__(self, bar: Progress, title: str, unit: str) -> None:
        self.bar, self.title, self.unit, self.said = bar, title, unit, ""
        self.task = bar.add_task(title, total=None)

    def say(self, text: str) -> None:
        self.said = f", {text}"

    def __call__(self, done: int, total: float) -> None:
        if done == 0:  # an attempt begins
            self.bar.reset(self.task)
        text = self.title + self.said
        if self.unit != "lives":
            text = f"{self.title} {done}/{total:.0f}"
        self.bar.update(self.task, completed=done, total=total, description=text)


@contextmanager
def bar(
    title: str, silent: bool, unit: str = ""
) -> Iterator[Callable[[int, float], None]]:
    """A progress bar on the terminal's standard error, for `progress(done, total)`; it
    tells when kernels are compiled for longer than a moment."""
    console = Console(stderr=True)
    if silent or not console.is_terminal:
        yield lambda *_: None
        return
    columns = _Doing("{task.description}"), BarColumn(), _Pace(unit)
    how: dict[str, Any] = {"transient": True, "speed_estimate_period": 3600.0}
    shown = Progress(*columns, console=console, **how)
    with shown:
        yield _Shown(shown, title, unit)
