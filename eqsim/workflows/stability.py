"""Results of `eqsim stability`: whether sliding through a spring is stable, and the
borders over velocity."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from eqsim.estimate import Estimate
from eqsim.io import storage
from eqsim.io.runfile import RunFile
from eqsim.lazy import lazily
from eqsim.master import stability as solver
from eqsim.master.stability import Stability
from eqsim.workflows.report import FileResult

with lazily():
    from eqsim.plots import checks, panels


_BORDER_DECADES = 1.5  # decades of velocity to either side of the run's
_BORDER_POINTS = 25  # velocities of the borders
_SLOW_POINTS = 7  # velocities of borders that take minutes each
_ROUNDING = 1e-7  # relative error below which a value is shown without its error
_FRESH = {
    "slips": "this run slips",
    "jumps": "this run jumps, by less than a slip",
    "slides": "this run does not slip",
    "undecided": "this run: undecided",
}


@dataclass(frozen=True)
class StabilityResult(FileResult):
    """Stability of the slider of a run file, and the borders over velocity, columns of
    a table, if they were asked for."""

    file: RunFile
    stability: Stability
    borders: dict[str, Any]
    command = "stability"

    def title(self, name: str) -> str:
        return self.file.title or name

    def summary(self) -> dict[str, Any]:
        found = self.stability
        names = ("fresh_slips", "fresh_verdict", "verdict")
        return {
            **asdict(found),
            **{name: getattr(found, name) for name in names},
            "versions": storage.versions(),
        }

    def tables(self) -> dict[str, Any]:
        return {"border": self.borders}

    def figures(self, title: str) -> dict[str, Any]:
        caption = panels.Caption.of(self.file, title)
        draw = checks.stability_figure
        return {"stability": draw(self.stability, self.borders, caption)}

    def rows(self) -> Iterator[tuple[str, ...]]:
        """The run's stiffness, its first slip, and steady sliding."""
        found, fresh, known = self.stability, self.stability.fresh, self.file.machine(1)
        machine = ("K",) * bool(known)
        yield "", "value", *machine, "meaning"

        def of(kappa: float | None) -> tuple[str, ...]:
            return (self.file.machine(kappa) if kappa else "",) * bool(known)

        said = "kappa_s = K/(N k) of this run"
        yield "stiffness", f"{found.stiffness:.6g}", *of(found.stiffness), said
        verdict = _FRESH[found.fresh_verdict]
        every: list[tuple[str, Any, str]] = [
            ("fresh start, critical", fresh.critical_stiffness, "kappa_s below which the slider jumps"),
            ("first slip", fresh.slip_stiffness, f"kappa_s below which the jump is a slip; {verdict}"),
            ("after X", fresh.X, "where friction falls most steeply"),
            ("peak / steady", fresh.peak_ratio, "largest friction over steady friction"),
            ("steady sliding", found.verdict, f"by {found.method}"),
            ("critical", found.critical_stiffness, "kappa_s below which it is unstable"),
            ("growth rate", found.growth, "of perturbations, 1/time"),
            ("period", found.period, "of perturbations, time"),
        ]  # fmt: skip
        if found.verdict == "neutral":
            every[4:] = [("steady sliding", found.verdict, "of this run")]
        optional = ("after X", "critical", "growth rate", "period")
        for name, value, meaning in every:
            if name not in optional or value.value is not None:
                stiffness = value.value if "kappa_s" in meaning else None
                yield name, _with_error(value), *of(stiffness), meaning

    def notes(self) -> Iterator[str]:
        found = self.stability
        if found.verdict == "neutral":
            yield f"neutral: {found.method}"
        elif found.growth.value is None and found.verdict == "stable":
            yield "no rate: perturbations decay within a fraction of a cycle, or not exponentially"
        if found.critical_stiffness.value is None:
            yield "no critical stiffness of steady sliding: not asked for (--critical, minutes), or not found"
        if found.verdict == "undecided":
            yield "undecided: the rate is not known well enough to tell its sign"


def _with_error(known: Estimate | str) -> str:
    """A value with its error, unless that is rounding."""
    if isinstance(known, str) or known.value is None or known.stderr is None:
        return str(known)
    precise = known.stderr < _ROUNDING * abs(known.value) < float("inf")
    return f"{known.value:.8g}" if precise else str(known)


def stability(
    file: RunFile,
    *,
    critical: bool,
    borders: bool,
    bar: Callable[[str, str], Any],
) -> StabilityResult:
    """Find whether the slider of a run file slides steadily, and if asked for, the
    `borders` over velocity; `critical`: look for the critical stiffness also where that
    takes minutes. `bar(title, unit)` is a context with a progress bar. Raises
    InputError."""
    pulled = solver.pulled_by(file.ensemble, file.drive)
    with bar("kicks and stiffnesses", "runs") as progress:
        found = solver.stability(
            pulled.ensemble,
            pulled.programme(),
            critical=True if critical else None,
            progress=progress,
        )
    if not borders:
        return StabilityResult(file, found, {})
    points = _SLOW_POINTS if critical and not pulled.quick else _BORDER_POINTS
    steps = (_BORDER_DECADES * (2.0 * i / (points - 1) - 1.0) for i in range(points))
    velocities = [found.velocity * 10.0**step for step in steps]
    with bar("borders", "velocities") as progress:
        known = solver.border(
            pulled, velocities, critical=pulled.quick or critical, progress=progress
        )
    return StabilityResult(file, found, known)
