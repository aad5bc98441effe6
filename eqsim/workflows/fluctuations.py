"""Results of `eqsim fluctuations`: the autocovariance of the stationary force, exact
and of simulated contacts."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from eqsim.engine.contacts import contacts
from eqsim.engine.scatter import births
from eqsim.engine.trajectory import predicted_lives, trajectory
from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate, known, z_score
from eqsim.io import storage, terminal
from eqsim.io.runfile import RunFile
from eqsim.lazy import lazily
from eqsim.master.steady import Reference, reference
from eqsim.master.transient import Fluctuations, fluctuations
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.tables import Array
from eqsim.workflows.report import FileResult, Solved, if_any

with lazily():
    from eqsim.plots import checks, panels


_LAG_ROWS = 8  # lags that a table shows
# Spacings of lags between which the correlation length is integrated: a cycle has 320.
_CORRELATION_CELLS = 1600
_LAG_CYCLES = 5.0  # mean cycles of pinned and detached to which lags extend by default
# Contacts of a simulated ensemble: fewer leave more ensembles for as many lives.
_TOGETHER = 20
_MOST_ENSEMBLES = 20_000
_FEWEST_ENSEMBLES = 100
# share of the scatter above which one ensemble, or contacts that were not met, decide
_DOMINANT_SHARE = 0.1
_UNMET = 4.0  # expected number of contacts below which a sample may hold none


@dataclass(frozen=True)
class SampledCovariance:
    """Autocovariance of many small ensembles, N times that of F/(N k), at the lags of
    the exact one, arrays (points,) (length^2); `reliable` is False if a few ensembles
    dominate its scatter."""

    covariance: Array
    stderr: Array
    reliable: bool
    contacts: int
    ensembles: int
    lives: int


@dataclass(frozen=True)
class FluctuationsResult(FileResult):
    """Fluctuations of a run file, exact and simulated; if nothing was simulated,
    `sample` is None for the `reason` given. `asked` holds lag, points and lives."""

    file: RunFile
    exact: Fluctuations
    sample: SampledCovariance | None
    reason: str
    asked: dict[str, float]
    command = "fluctuations"

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the call, with which `eqsim replay` repeats it."""
        return {"run": self.file.settings, **self.asked}

    def estimates(self) -> list[Estimate]:
        """The simulated covariance at each lag; none if there is no sample."""
        sample = self.sample
        if sample is None:
            return []
        pairs = zip(sample.covariance.tolist(), sample.stderr.tolist(), strict=True)
        n, reliable = sample.ensembles, sample.reliable
        return [Estimate(*pair, n, reliable=reliable) for pair in pairs]

    @property
    def z(self) -> list[float | None]:
        """Difference of the simulated covariance from the exact one in standard errors,
        at each lag; None if there is no sample."""
        if self.sample is None:
            return [None] * self.exact.lag.size
        exact = self.exact.covariance.tolist(), self.exact.error.tolist()
        return list(map(z_score, self.estimates(), *exact))

    @cached_property
    def correlation(self) -> Estimate:
        """Integral of the covariance up to the largest lag, over the variance (length),
        by trapezia between lags of its own, however few are shown. It is extrapolated
        as of second order; its error is the change for twice the spacing, and what the
        errors of the covariance make."""
        far = replace(self.file.constant_drive, distance=self.asked["lag"])
        exact = fluctuations(self.ensemble, far, _CORRELATION_CELLS + 1)
        lag, covariance, error = exact.lag, exact.covariance, exact.error
        fine = float(np.trapezoid(covariance, lag))
        change = fine - float(np.trapezoid(covariance[::2], lag[::2]))
        variance = float(covariance[0])
        length = (fine + change / 3.0) / variance
        missed = float(np.trapezoid(error, lag)) + abs(length) * float(error[0])
        return Estimate(length, (abs(change) + missed) / variance, lag.size)

    def columns(self) -> dict[str, Array]:
        """The table: `lag`, `covariance`, `error`, and if contacts were simulated
        `simulated`, `simulated_stderr`."""
        columns, sample = self.exact.columns(), self.sample
        if sample:
            columns["simulated"] = sample.covariance
            columns["simulated_stderr"] = sample.stderr
        return columns

    @property
    def force_std(self) -> float:
        """Standard deviation of F/(N k) (length)."""
        variance = float(self.exact.covariance[0])
        return math.sqrt(max(variance, 0.0) / self.ensemble.count)

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        exact, sample = self.exact, self.sample
        variance, error = float(exact.covariance[0]), float(exact.error[0])
        counts = ("ensembles", "contacts", "lives")
        length = self.correlation
        return {
            **{
                "title": self.file.title,
                "variance": {"value": variance, "error": error},
            },
            "force_std": self.force_std,
            "correlation_length": length.value,
            "correlation_length_error": length.stderr,
            **self.columns(),
            **{"z": self.z, "reliable": sample and sample.reliable},
            **{name: getattr(sample, name, 0) for name in counts},
            **{"seed": self.file.output.seed, "versions": storage.versions()},
        }

    def tables(self) -> dict[str, Any]:
        return {"fluctuations": self.columns()}

    def figures(self, title: str) -> dict[str, Any]:
        caption = panels.Caption.of(self.file, title)
        draw = checks.fluctuations_figure
        return {"fluctuations": draw(self.exact, self.sample, caption)}

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Some lags, from 0 on, where the covariance is the variance."""
        exact, estimates, z = self.exact, self.estimates(), self.z
        yield "lag", "exact", "simulated", "z"
        for i in terminal.some(exact.lag.size, _LAG_ROWS - 1):
            both = (estimates[i], terminal.score(z[i])) if estimates else ("none",) * 2
            yield f"{exact.lag[i]:.6g}", f"{exact.covariance[i]:.6g}", *both

    def notes(self) -> Iterator[str]:
        contacts = f"{terminal.count(self.ensemble.count)} contacts"
        sample = self.sample
        yield "N times the autocovariance of F/(N k) over a lag in displacement; at lag 0 the variance"
        yield f"standard deviation of F/(N k) with {contacts}: {self.force_std:.6g}"
        yield f"correlation length, the integral over these lags over the variance: {self.correlation}"
        if sample is None:
            yield f"nothing simulated: {self.reason}"
            return
        ensembles = f"{sample.ensembles} ensembles of {sample.contacts} contacts"
        lives = terminal.count(sample.lives)
        yield f"{ensembles}, {lives} lives, seed {self.file.output.seed}"
        if not sample.reliable:
            yield "unreliable: a few ensembles make the scatter; forces this heavy-tailed need more --lives"


def run_fluctuations(
    file: RunFile,
    *,
    lag: float | None = None,
    points: int = 101,
    lives: float = 1e6,
    threads: int = 1,
) -> FluctuationsResult:
    """The stationary fluctuations of a run file's force, exact and of simulated
    contacts, of which about `lives` lives are drawn, at `points` lags from 0 to `lag`
    (length), by default `default_lag`. Raises InputError without a constant velocity,
    for contacts without such a theory, and for values out of range."""
    ensemble, drive = file.ensemble, file.constant_drive
    require_number("--lives", lives, least=0.0, most=1e10)
    if lag is None:
        lag = default_lag(ensemble, drive)
    require_number("--lag", lag, above=0.0)
    far, seed = replace(drive, distance=lag), file.output.seed
    exact = fluctuations(ensemble, far, points)
    found: Solved[SampledCovariance] = Solved(None, "--lives = 0")
    if lives:
        found = if_any(lambda: sampled(ensemble, far, points, lives, seed, threads))
    asked = {"lag": lag, "points": points, "lives": lives}
    return FluctuationsResult(file, exact, *found, asked)


def default_lag(ensemble: Ensemble, drive: Drive) -> float:
    """Five mean cycles of pinned and detached (length)."""
    ensemble.require_steady_state(drive.velocity)
    means = reference(ensemble, drive)
    return _LAG_CYCLES * known(means.travel) / known(means.pinned)


def sampled(
    ensemble: Ensemble, drive: Drive, points: int, lives: float, seed: int, threads: int
) -> SampledCovariance:
    """Estimate the autocovariance at `points` lags up to the drive's distance, from
    independent stationary ensembles over twice that distance. Products are of forces
    less their exact mean: that of the sample would bias them. Raises InputError."""
    if ensemble.populations:
        raise InputError("population: this is simulated for contacts of one kind")
    exact = reference(ensemble, drive, variance=True)
    level = known(exact.friction)
    small = replace(ensemble, count=_TOGETHER)
    long = replace(drive, distance=2.0 * drive.over(ensemble), start="stationary")
    wanted = max(lives / predicted_lives(small, long), _FEWEST_ENSEMBLES)
    affordable = 1e7 // (2 * points)
    ensembles = int(min(wanted, _MOST_ENSEMBLES, affordable))
    how: dict[str, Any] = {"seed": seed, "replicas": ensembles, "threads": threads}
    run = trajectory(small, long, points=2 * points - 1, **how)
    assert run.force_replicas is not None
    dF = run.force_replicas - level
    products = np.array(  # (points, ensembles)
        [(dF[:, :points] * dF[:, j : j + points]).mean(1) for j in range(points)]
    )
    covariances = _TOGETHER * products
    scatter = (products[0] - products[0].mean()) ** 2
    stderr = covariances.std(axis=1, ddof=1) / math.sqrt(ensembles)
    unmet = _unmet(ensemble, drive.velocity, exact, _TOGETHER * ensembles, run.lives)
    even = scatter.max() < _DOMINANT_SHARE * scatter.sum()
    reliable = bool(even and unmet < _DOMINANT_SHARE * known(exact.force_variance))
    mean, error = covariances.mean(axis=1), np.hypot(stderr, unmet)
    return SampledCovariance(mean, error, reliable, _TOGETHER, ensembles, run.lives)


def _unmet(
    ensemble: Ensemble, velocity: float, exact: Reference, initial: int, lives: int
) -> float:
    """Part of the mean square force (length^2) that a sample may miss: that of contacts
    so strong that few are expected among `initial` contacts of the stationary state and
    the `lives` that begin later."""
    if ensemble.fluctuates:
        return 0.0  # thresholds of gamma laws, whose lives take paths
    stretch = known(exact.break_stretch) if ensemble.self_consistent else None
    born = births(contacts(ensemble, velocity, stretch))
    unit = ensemble.thresholds.scale
    travel = born.travel
    mean_square = born.birth**2 + travel * (born.birth + travel / 3.0)
    square = born.stiffness**2 * travel * mean_square
    cycle = known(exact.travel) / unit / known(exact.pinned)
    expected = born.share * (initial * travel / cycle + lives)
    order = np.argsort(-square)
    met = np.cumsum(expected[order]) >= _UNMET
    drag = drag_of(ensemble, velocity)
    second = (known(exact.force_variance) + known(exact.friction) ** 2) / unit**2
    pinned = second - drag**2 * (1.0 - known(exact.pinned))
    seen = float(np.sum((born.share * square)[order][met])) / cycle
    return max(pinned - seen, 0.0) * unit**2
