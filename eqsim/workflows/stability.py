"""Results of `eqsim stability`: whether sliding through a spring is stable, and the
borders over velocity."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from eqsim.estimate import Estimate, known
from eqsim.io import storage
from eqsim.io.runfile import RunFile
from eqsim.io.surface import machine_stiffness
from eqsim.lazy import lazily
from eqsim.master import stability as solver
from eqsim.master.chain_modes import Modes, chain_modes
from eqsim.master.stability import Stability
from eqsim.model.chain import Chain
from eqsim.model.drive import Programme
from eqsim.workflows.report import FileResult

with lazily():
    from eqsim.plots import checks, panels


_BORDER_DECADES = 1.5  # decades of velocity to either side of the run's
_BORDER_POINTS = 25  # velocities of the borders
_ROUNDING = 1e-7  # relative error below which a value is shown without its error
_FRESH = {
    "slips": "slips",
    "jumps": "jumps, by less than a slip",
    "slides": "does not slip",
    "undecided": "may slip or not, undecided",
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
        more = {name: getattr(found, name) for name in names}
        more |= {"sentence": self.sentence, "versions": storage.versions()}
        return asdict(found) | more

    def tables(self) -> dict[str, Any]:
        return {"border": self.borders}

    def figures(self, title: str) -> dict[str, Any]:
        names = "critical_stiffness", "fresh_critical_stiffness"
        found = np.array([self.borders[name] for name in names])
        if not np.any(np.isfinite(found) & (found > 0.0)):
            return {}  # no border at any velocity
        caption = panels.Caption.of(self.file, title)
        draw = checks.stability_figure
        return {"stability": draw(self.stability, self.borders, caption)}

    def rows(self) -> Iterator[tuple[str, ...]]:
        """The run's stiffness, its first slip, and steady sliding."""
        found, fresh = self.stability, self.stability.fresh
        unit = bool(machine_stiffness(self.file, 1))
        yield "", "value", *("K",) * unit, "meaning"

        def of(kappa: float | None) -> tuple[str, ...]:
            return (machine_stiffness(self.file, kappa) if kappa else "",) * unit

        said = "kappa_s = K/(N k) of this run"
        yield "stiffness", f"{found.stiffness:.6g}", *of(found.stiffness), said
        run = "this run" if self.drive.start == "fresh" else "a fresh start"
        verdict = f"{run} {_FRESH[found.fresh_verdict]}"
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

    @property
    def sentence(self) -> str:
        """Above which stiffness of the spring this run is smooth, and its own."""
        found, fresh = self.stability, self.drive.start == "fresh"
        steady = known(found.critical_stiffness)
        border = max(steady, known(found.fresh.slip_stiffness) if fresh else 0.0)
        yours = f"yours is {self._machine(found.stiffness)}"
        if "undecided" in (found.verdict, found.fresh_verdict if fresh else ""):
            return f"at the border between smooth and not, {yours}"
        if found.stiffness < steady:
            does = "it sticks and slips"
        elif found.stiffness < border:
            does = "it slips at its start, and slides steadily then"
        else:
            does = "it is smooth"
        if border == 0.0:
            return f"smooth behind any spring; {yours}"
        if border == math.inf:
            return f"smooth behind no spring; {yours}: {does}"
        return f"smooth above {self._machine(border)}; {yours}: {does}"

    def _machine(self, stiffness: float) -> str:
        """A stiffness in the unit of the machine, else as kappa_s."""
        return machine_stiffness(self.file, stiffness) or f"kappa_s = {stiffness:.4g}"

    def notes(self) -> Iterator[str]:
        found = self.stability
        yield self.sentence
        if found.verdict == "neutral":
            yield f"neutral: {found.method}"
        elif found.growth.value is None and found.verdict == "stable":
            yield (
                "no rate found: perturbations decay within a fraction of a cycle, not "
                "exponentially, or faster than can be told next to a resonance"
            )
        if found.verdict == "undecided":
            yield "undecided: the rate is not known well enough to tell its sign"


@dataclass(frozen=True)
class ModesResult(FileResult):
    """Growth of perturbations of the steady sliding of a chain of a run file."""

    file: RunFile
    modes: Modes
    command = "stability"

    def title(self, name: str) -> str:
        return self.file.title or name

    @property
    def sentence(self) -> str:
        """Which wavelengths grow, and whether this chain has them."""
        chain, q = self.drive.chain, self.modes.critical_wave_number.value
        mine = f"this chain of {chain.count} blocks is {self.modes.verdict}"
        if q is None:
            return f"perturbations of any wavelength grow; {mine}"
        if q == 0.0:
            return f"no perturbation grows; {mine}"
        return f"perturbations longer than {2.0 * math.pi / q:.4g} blocks grow; {mine}"

    def summary(self) -> dict[str, Any]:
        modes, names = self.modes, ("critical_wave_number", "softest")
        found = {name: getattr(modes, name).as_dict() for name in names}
        found |= {"lowest_wave_number": modes.lowest, "verdict": modes.verdict}
        found["modes"] = {name: x.tolist() for name, x in modes.columns().items()}
        made = {"sentence": self.sentence, "versions": storage.versions()}
        return {"title": self.file.title, **found, **made}

    def tables(self) -> dict[str, Any]:
        return {"modes": self.modes.columns()}

    def figures(self, title: str) -> dict[str, Any]:
        caption = panels.Caption.of(self.file, title)
        return {"modes": checks.modes_figure(self.modes, caption)}

    def rows(self) -> Iterator[tuple[str, ...]]:
        chain, modes = self.drive.chain, self.modes
        yield "", "value", "meaning"
        yield "coupling", f"{chain.coupling:.6g}", "K/(n k)"
        spring = f"spring of the {chain.drive} over n k"
        yield "drive", f"{chain.drive_stiffness:.6g}", spring
        critical, growth = map(_with_error, (modes.critical_wave_number, modes.softest))
        if modes.critical_wave_number.value:
            below = "wave number below which perturbations grow, per block"
            yield "critical q_c", critical, below
        yield "softest q", f"{modes.lowest:.6g}", "longest wave of this chain"
        yield "steady sliding", modes.verdict, "of this chain"
        if modes.softest.value is not None:
            yield "growth rate", growth, "of its softest mode, 1/time"

    def notes(self) -> Iterator[str]:
        yield self.sentence


def _with_error(value: Estimate | str) -> str:
    """A value with its error, unless that is rounding."""
    if isinstance(value, str) or value.value is None or value.stderr is None:
        return str(value)
    precise = value.stderr < _ROUNDING * abs(value.value) < float("inf")
    return f"{value.value:.8g}" if precise else str(value)


def stability(
    file: RunFile, *, borders: bool, bar: Callable[[str, str], Any]
) -> StabilityResult | ModesResult:
    """Find whether the slider or the chain of a run file slides steadily, and the
    `borders` over velocity; `bar(title, unit)` shows progress. Raises InputError."""
    if isinstance(file.drive, Programme) and isinstance(file.blocks, Chain):
        with bar("modes of the chain", ""):
            return ModesResult(file, chain_modes(file.ensemble, file.drive))
    pulled = solver.pulled_by(file.ensemble, file.drive)
    with bar("critical stiffness", ""):
        found = solver.stability(pulled.ensemble, pulled.programme())
    if not borders:
        return StabilityResult(file, found, {})
    spread = _BORDER_DECADES * np.linspace(-1.0, 1.0, _BORDER_POINTS)
    velocities = (found.velocity * 10.0**spread).tolist()
    with bar("borders", "velocities") as progress:
        borders_at = solver.critical_stiffnesses(pulled, velocities, progress=progress)
    return StabilityResult(file, found, borders_at)
