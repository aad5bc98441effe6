"""What `eqsim fluctuations` computes: the autocovariance of the stationary force, exact
and of simulated contacts."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from eqsim.engine.contacts import contacts
from eqsim.engine.scatter import births
from eqsim.engine.trajectory import predicted_lives, trajectory
from eqsim.errors import InputError, require_number
from eqsim.estimate import Estimate, known, z_score
from eqsim.io import storage
from eqsim.io.runfile import RunFile
from eqsim.master.steady import Reference, reference
from eqsim.master.transient import Fluctuations, fluctuations
from eqsim.model.drive import Drive
from eqsim.model.ensemble import Ensemble
from eqsim.model.reduced import drag_of
from eqsim.numerics.tables import Array

Progress = Callable[[int, float], None]
_CYCLES = 5.0  # mean cycles of pinned and detached to which lags extend by default
_TOGETHER = 20  # contacts of a simulated ensemble: the fewer, the more ensembles there are of the same lives
_MOST_ENSEMBLES, _FEWEST = 20_000, 100
# an ensemble that makes more of the scatter has siblings that were not seen
_DOMINANT = 0.1
_UNMET = 4.0  # contacts expected, below which a sample may have met none


@dataclass(frozen=True)
class Sample:
    """The autocovariance of many small ensembles, N times that of F/(N k), at the lags
    of the exact one, arrays (points,) (length^2); `reliable` is False where few of the
    ensembles make its scatter."""

    covariance: Array
    stderr: Array
    reliable: bool
    contacts: int
    ensembles: int
    lives: int


@dataclass(frozen=True)
class FluctuationsResult:
    """A run file whose fluctuations were computed; `sample` is None if nothing was
    simulated, and `reason` why."""

    file: RunFile
    ensemble: Ensemble
    exact: Fluctuations
    sample: Sample | None
    reason: str
    asked: dict[str, float]
    names: ClassVar[tuple[str, ...]] = (
        "fluctuations.parquet",
        "summary.json",
        "fluctuations.png",
    )

    @property
    def z(self) -> list[float | None]:
        """Difference of the simulated covariance from the exact one in standard errors,
        at each lag; None if there is no sample."""
        sample, exact = self.sample, self.exact
        if sample is None:
            return [None] * exact.lag.size
        estimates = zip(sample.covariance.tolist(), sample.stderr.tolist(), strict=True)
        found = (
            Estimate(value, stderr, sample.ensembles) for value, stderr in estimates
        )
        return [
            z_score(*parts)
            for parts in zip(
                found, exact.covariance.tolist(), exact.error.tolist(), strict=True
            )
        ]

    @property
    def correlation_length(self) -> float:
        """int of the covariance over the lags, over the variance (length)."""
        return float(
            np.trapezoid(self.exact.covariance, self.exact.lag)
            / self.exact.covariance[0]
        )

    def columns(self) -> dict[str, Array]:
        """The table: `lag`, `covariance`, `error`, and if contacts were simulated
        `simulated`, `simulated_stderr`."""
        found = self.exact.columns()
        if self.sample:
            found |= {
                "simulated": self.sample.covariance,
                "simulated_stderr": self.sample.stderr,
            }
        return found

    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        exact, sample = self.exact, self.sample
        variance = float(exact.covariance[0])
        return {
            "title": self.file.title,
            "variance": {"value": variance, "error": float(exact.error[0])},
            "force_std": math.sqrt(max(variance, 0.0) / self.ensemble.count),
            "correlation_length": self.correlation_length,
            **self.columns(),
            "z": self.z,
            "reliable": None if sample is None else sample.reliable,
            "ensembles": 0 if sample is None else sample.ensembles,
            "contacts": 0 if sample is None else sample.contacts,
            "lives": 0 if sample is None else sample.lives,
            "seed": self.file.output.seed,
            "versions": storage.versions(),
        }

    def files(self, title: str = "") -> dict[str, bytes]:
        """The files of a results folder by name; `title` of the picture, unless the run
        file has one."""
        from eqsim.io.plots import caption, fluctuations_figure
        from eqsim.io.style import saved

        said = caption(self.file, Estimate(None, None, 0), title)
        settings = {"run": self.file.settings, **self.asked}
        origin = storage.provenance(
            "fluctuations",
            settings,
            self.file.text,
            self.file.output.seed,
            self.file.folder,
        )
        contents = (
            storage.parquet(self.columns(), origin),
            storage.to_json(self.summary()).encode(),
            saved(fluctuations_figure(self.exact, self.sample, said)),
        )
        return dict(zip(self.names, contents, strict=True))


def run_fluctuations(
    file: RunFile,
    *,
    lag: float | None = None,
    points: int = 101,
    lives: float = 1e6,
    threads: int = 1,
) -> FluctuationsResult:
    """The stationary fluctuations of a run file's force, exact and of simulated
    contacts.

    Parameters
    ----------
    file : RunFile
    lag : float, optional
        Greatest lag (length); by default five mean cycles of pinned and detached.
    points : int
        Lags, from 0 on.
    lives : float
        About how many lives of contacts are simulated; 0: none.
    threads : int
        Speed only.

    Returns
    -------
    FluctuationsResult

    Raises
    ------
    InputError
        Without a constant velocity, for contacts that there is no such theory of, and
        for values out of range.
    """
    ensemble, drive = file.ensemble, file.constant_drive
    require_number("--lives", lives, least=0.0, most=1e10)
    if lag is None:
        lag = default_lag(ensemble, drive)
    require_number("--lag", lag, above=0.0)
    exact = fluctuations(ensemble, replace(drive, distance=lag), points)
    sample, reason = None, "" if lives else "none asked for"
    if lives:
        try:
            sample = sampled(
                ensemble,
                replace(drive, distance=lag),
                points,
                lives,
                file.output.seed,
                threads,
            )
        except InputError as error:
            reason = str(error)
    asked = {"lag": lag, "points": points, "lives": lives}
    return FluctuationsResult(file, ensemble, exact, sample, reason, asked)


def default_lag(ensemble: Ensemble, drive: Drive) -> float:
    """Five mean cycles of pinned and detached (length)."""
    means = reference(ensemble, drive)
    return _CYCLES * known(means.travel) / known(means.pinned)


def sampled(
    ensemble: Ensemble, drive: Drive, points: int, lives: float, seed: int, threads: int
) -> Sample:
    """The autocovariance at `points` lags up to the drive's distance, from products
    about the exact mean, of forces of independent stationary ensembles over twice that
    distance.

    Raises InputError where an ensemble cannot be simulated so.
    """
    exact = reference(ensemble, drive, variance=True)
    level = known(exact.friction)
    small = replace(ensemble, count=_TOGETHER)
    long = replace(drive, distance=2.0 * drive.over(ensemble), start="stationary")
    each = predicted_lives(small, long)
    ensembles = int(
        min(max(lives / each, _FEWEST), _MOST_ENSEMBLES, 1e7 // (2 * points))
    )
    run = trajectory(
        small,
        long,
        points=2 * points - 1,
        seed=seed,
        replicas=ensembles,
        threads=threads,
    )
    assert run.force_replicas is not None
    off = run.force_replicas - level
    products = np.array(
        [
            np.mean(off[:, :points] * off[:, j : j + points], axis=1)
            for j in range(points)
        ]
    )  # (points, ensembles)
    found = _TOGETHER * products
    about = (products[0] - products[0].mean()) ** 2
    stderr = found.std(axis=1, ddof=1) / math.sqrt(ensembles)
    unmet = _unmet(ensemble, drive.velocity, exact, _TOGETHER * ensembles, run.lives)
    return Sample(
        covariance=found.mean(axis=1),
        stderr=np.hypot(stderr, unmet),
        reliable=bool(
            about.max() < _DOMINANT * about.sum()
            and unmet < _DOMINANT * known(exact.force_variance)
        ),
        contacts=_TOGETHER,
        ensembles=ensembles,
        lives=run.lives,
    )


def _unmet(
    ensemble: Ensemble, velocity: float, exact: Reference, initial: int, lives: int
) -> float:
    """The part of the mean square force (length^2) that a sample cannot know of: that
    of contacts so strong that few are expected among `initial` contacts of the
    stationary state and the `lives` that begin later."""
    if ensemble.fluctuates:
        return 0.0  # thresholds of gamma laws, whose lives take paths
    c = contacts(
        ensemble,
        velocity,
        known(exact.break_stretch) if ensemble.self_consistent else None,
    )
    born, unit = births(c), ensemble.thresholds.scale
    square = (
        born.stiffness**2
        * born.travel
        * (born.birth**2 + born.travel * (born.birth + born.travel / 3.0))
    )
    cycle = known(exact.travel) / unit / known(exact.pinned)
    expected = born.share * (initial * born.travel / cycle + lives)
    order = np.argsort(-square)
    met = np.cumsum(expected[order]) >= _UNMET
    drag = drag_of(ensemble, velocity)
    second = (known(exact.force_variance) + known(exact.friction) ** 2) / unit**2
    pinned = second - drag**2 * (1.0 - known(exact.pinned))
    return (
        max(pinned - float(np.sum((born.share * square)[order][met])) / cycle, 0.0)
        * unit**2
    )
