"""Records: force against time under a programme, with errors that are correlated from
point to point.

What is measured is scale F(t) + offset + drift (t - <t>), F the mean field along the
programme (`master.slider` with a stage, `master.programme` without). The stage's
stiffness is that of the run file, kappa_s = K/(N k), or K is given in the unit of the
measured force over length, so that kappa_s = K/scale.

Errors of neighbours, dt apart, are taken to have the correlation exp(-dt/tau) of a
Markov process, of which the residuals of a first fit tell tau; residuals are then made
independent (whitened).
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize

from eqsim.errors import InputError
from eqsim.fitting.data import Row, Table
from eqsim.fitting.estimate import Minimum, minimise
from eqsim.fitting.model import Problem
from eqsim.fitting.section import Fit, Parameter
from eqsim.io.csv import number, read
from eqsim.io.runfile import RunFile, at
from eqsim.master.programme import means_of
from eqsim.master.slider import Steps, TooManySteps, force_of, steps_of
from eqsim.model.drive import Grid, Programme
from eqsim.model.ensemble import Ensemble
from eqsim.numerics.tables import Array

# of derivatives: where solves choose their steps, and where these are given; how often
# they are chosen anew, as long as chi-square falls by more than a share
_ROUGH, _SMOOTH, _CHOSEN, _FALLEN = 2e-2, 1e-3, 6, 1e-3
_COARSE = 0.7  # of `force_of`, for a search
# of a solve in a search: steady sliding takes some hundred, a slip a thousand
_MOST_STEPS = 4000
_LEAST = 0.02  # correlation of neighbours below which they are independent


def read_record(path: Path, fit: Fit) -> Table:
    """The points of a record, a CSV file with columns of time and force, and of
    standard errors. Errors of the file and of fit.noise add in quadrature. Raises
    InputError with the column or line that cannot be used."""
    record = fit.record
    assert record is not None
    sheet = read(path, f"fit.record.file = {path}")
    for field in ("time", "force", "stderr"):
        name = getattr(record, field)
        if name is not None and name not in sheet.columns:
            raise InputError(
                f'fit.record.{field} = "{name}": no such column; there are {", ".join(sheet.columns)}'
            )
        if name is not None:
            sheet.index(name)  # of a name that is there twice
    t, force, sigma = [], [], []
    for line, cells in sheet.rows():
        if not any(cells):  # a spreadsheet's last lines
            continue
        given = dict(zip(sheet.columns, cells, strict=True))
        where = f"fit.record.file, line {line}: "
        t.append(number(given[record.time], where + record.time))
        force.append(number(given[record.force], where + record.force))
        error = (
            number(given[record.stderr], where + record.stderr)
            if record.stderr is not None
            else 0.0
        )
        if error < 0:
            raise InputError(f"{where}{record.stderr} = {error:g}: must be >= 0")
        sigma.append(
            math.hypot(error, fit.noise.absolute, fit.noise.relative * force[-1])
        )
        if not sigma[-1] > 0:
            raise InputError(
                f"{where}{record.force} has no error; give stderr > 0, or noise in [fit]"
            )
        if len(t) > 1 and not t[-1] > t[-2]:
            raise InputError(
                f"{where}{record.time} = {t[-1]:g}: must be later than the {t[-2]:g} before it"
            )
    if not t or t[0] < 0:
        raise InputError(
            f"fit.record.file = {path}: "
            + ("is empty" if not t else "begins before time 0")
        )
    n, one = len(t), [Row((), 1.0, "")]
    values = np.array(force), np.array(sigma)
    return Table(
        one,
        np.zeros(n, int),
        ["friction"] * n,
        *values,
        [],
        np.ones(1),
        sheet.sha256,
        np.array(t),
    )


@dataclass(frozen=True)
class RecordForward:
    """The mean field along a programme at the instants of a record, at unit scale.

    With a stage it is solved with coarse steps: what these miss, relative to the force,
    hardly depends on the parameters, and is the `correction` that was found at some of
    them, with the `error` that is left. A solve that chooses its own steps is a rough
    function of parameters; with `steps` chosen at some of them it is smooth around.
    """

    file: RunFile
    time: Array
    machine_stiffness: float | None
    fixed_scale: float
    correction: Array | None = None
    error: Array | None = None
    steps: Steps | None = None

    @property
    def scaled(self) -> bool:
        """Whether predictions depend on the scale of force."""
        return self.machine_stiffness is not None

    def predict(self, changes: dict[str, float]) -> tuple[Array, Array]:
        """See `Forward`."""
        ensemble, programme, grid, index = self._drive(changes)
        if programme.stage is None:
            means = means_of(ensemble, programme, grid)
            return means.force[index], means.force_error[index]
        force = force_of(ensemble, programme, grid, _COARSE, _MOST_STEPS, self.steps)[
            index
        ]
        zero = np.zeros(force.size)
        correction, error = (
            zero if part is None else part for part in (self.correction, self.error)
        )
        return force * (1.0 + correction), np.abs(force) * error

    def corrected(self, changes: dict[str, float]) -> "RecordForward":
        """With the correction at these parameters: finer steps, extrapolated as of
        second order; a third of what the last refinement changes is left as the error,
        more than was seen."""
        ensemble, programme, grid, index = self._drive(changes)
        if programme.stage is None:
            return self
        used = force_of(ensemble, programme, grid, _COARSE, _MOST_STEPS, self.steps)[
            index
        ]
        coarse, fine = (
            force_of(ensemble, programme, grid, size)[index] for size in (2, 4)
        )
        correction = (4.0 * fine - coarse) / 3.0 / used - 1.0
        return replace(
            self, correction=correction, error=np.abs(fine / coarse - 1.0) / 3.0
        )

    def settled(self, changes: dict[str, float]) -> "RecordForward":
        """With the steps that a solve at these parameters chooses, and no correction."""
        ensemble, programme, grid, _ = self._drive(changes)
        if programme.stage is None:
            return self
        steps = steps_of(ensemble, programme, grid, _COARSE, _MOST_STEPS)
        return replace(self, correction=None, error=None, steps=steps)

    def _drive(
        self, changes: dict[str, float]
    ) -> tuple[Ensemble, Programme, Grid, Array]:
        """Contacts, drive, the grid of instants, and which of these are the record's.
        Raises InputError."""
        file = at(
            self.file,
            {
                key: value
                for key, value in changes.items()
                if not key.startswith("fit.")
            },
        )
        ensemble, programme = file.ensemble, file.drive
        if not isinstance(programme, Programme):
            raise InputError("drive.programme: is required with fit.record")
        if self.machine_stiffness is not None:
            if programme.stage is None:
                raise InputError(
                    "drive.stage: is required with fit.record.machine_stiffness"
                )
            stiffness = self.machine_stiffness / changes.get(
                "fit.scale", self.fixed_scale
            )
            programme = replace(
                programme, stage=replace(programme.stage, stiffness=stiffness)
            )
        ends = np.cumsum([segment.duration for segment in programme.segments])
        if self.time[-1] > ends[-1] * (1.0 + 1e-9):
            raise InputError(
                f"fit.record: ends at {self.time[-1]:g}, after the programme, which takes {ends[-1]:g}"
            )
        t = np.unique(np.concatenate(([0.0], np.minimum(self.time, ends[-1]), ends)))
        segment = np.minimum(np.searchsorted(ends, t * (1.0 - 1e-12)), ends.size - 1)
        ways = [math.copysign(part.path, part.velocity) for part in programme.segments]
        X = np.interp(t, np.append(0.0, ends), np.append(0.0, np.cumsum(ways)))
        return (
            ensemble,
            programme,
            Grid(t, X, segment),
            np.searchsorted(t, np.minimum(self.time, ends[-1])),
        )


def record_problem(
    file: RunFile,
    fit: Fit,
    table: Table,
    free: list[Parameter],
    scales: tuple[list[Parameter], float],
) -> Problem:
    """The fit of a record, with independent errors."""
    assert table.time is not None
    assert fit.record is not None
    if fit.record.machine_stiffness is not None and any(
        one.key == "drive.stage.stiffness" for one in free
    ):
        raise InputError(
            "fit.free.drive.stage.stiffness: not allowed with fit.record.machine_stiffness"
        )
    forward = RecordForward(file, table.time, fit.record.machine_stiffness, scales[1])
    ones = np.ones(table.time.size)
    known = {"fit.offset": ones, "fit.drift": table.time - table.time.mean()}
    nuisance = {one.key: known[one.key] for one in free if one.key in known}
    ordered = (
        [one for one in free if one.key not in known]
        + scales[0]
        + [one for one in free if one.key in known]
    )
    return Problem(
        forward, ordered, table.value - _fixed(fit, nuisance, known), table.sigma, np.zeros(ones.size, int), scales[1],
        np.zeros(ones.size, bool), None if scales[0] else float(file["contacts.count"]),
        file["contacts.stiffness"], nuisance, fit.loss, step=_ROUGH,
    )  # fmt: skip


def _fixed(fit: Fit, free: dict[str, Array], known: dict[str, Array]) -> Array:
    """Offset and drift that are not free, which are taken off what was measured."""
    values = {"fit.offset": fit.offset, "fit.drift": fit.drift}
    return np.asarray(
        sum(values[key] * base for key, base in known.items() if key not in free)
    )


class Correlation(NamedTuple):
    """Correlation time of residuals, and of how many independent points they are worth."""

    time: float
    effective: float


def settled(problem: Problem, u: Array) -> Problem:
    """The problem with the steps that a solve at parameters `u` chooses. Raises
    InputError where there is none."""
    assert isinstance(problem.forward, RecordForward)
    return replace(
        problem,
        forward=problem.forward.settled(problem.changes(u)),
        step=_SMOOTH,
        central=True,
    )


def search(problem: Problem, u: Array) -> Minimum:
    """Least squares from `u`, again and again with the steps that are chosen where they
    ended."""
    found: list[Minimum] = []
    while len(found) < _CHOSEN and (
        len(found) < 2 or found[-1].chi2 < (1.0 - _FALLEN) * found[-2].chi2
    ):
        try:
            found.append(minimise(settled(problem, u), u))
        except TooManySteps:
            found.append(minimise(problem, u))
        u = found[-1].u
    best = min(found, key=lambda one: one.chi2)
    return best._replace(solves=sum(one.solves for one in found))


def correlated(problem: Problem, u: Array, t: Array) -> tuple[Problem, Correlation]:
    """The problem with steps and correction at parameters `u`, and the errors'
    correlation that the residuals there have, by maximum likelihood of a Markov process
    of free variance."""
    problem = settled(problem, u)
    assert isinstance(problem.forward, RecordForward)
    problem = replace(problem, forward=problem.forward.corrected(problem.changes(u)))
    _, predicted, _ = problem.solved(u)
    r, gap = (problem.value - predicted) / problem.sigma, np.diff(t)

    def deviance(log_tau: float) -> float:
        rho = np.exp(-gap * math.exp(-log_tau))
        w = replace(problem, correlation=rho).white(r)
        return float(r.size * math.log(w @ w) + np.sum(np.log1p(-(rho**2))))

    found = optimize.minimize_scalar(
        deviance,
        bounds=(math.log(0.1 * gap.min()), math.log(0.3 * (t[-1] - t[0]))),
        method="bounded",
    )
    tau = math.exp(found.x)
    rho = np.exp(-gap / tau)
    if np.median(rho) < _LEAST:
        return replace(problem, correlation=None), Correlation(0.0, float(t.size))
    effective = 1.0 + float(np.sum((1.0 - rho) / (1.0 + rho)))
    return replace(problem, correlation=rho), Correlation(tau, effective)
