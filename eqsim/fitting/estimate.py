"""Least squares from many starts, and what it says about parameters: covariance and the
ladder of directions."""

import math
import pickle
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from eqsim.errors import InputError
from eqsim.fitting.model import REFUSED, Problem
from eqsim.io.storage import publish
from eqsim.master.slider import TooManySteps
from eqsim.numerics.tables import Array

# ratio of eigenvalues of J'J below which a direction is not determined
DEGENERATE = 1e-7
_SAME = 0.1  # of chi-square: minima that differ by less are one


class Minimum(NamedTuple):
    """Where a minimisation ended: parameters, chi-square (priors included), whether it
    converged, and solves."""

    u: Array
    chi2: float
    converged: bool
    solves: int


def minimise(problem: Problem, u: Array, held: int = -1) -> Minimum:
    """Least squares from `u`, the parameter of index `held` as it is there; the linear
    ones need no start."""
    active = np.array(
        [i for i in range(u.size) if i != held and not problem.linear[i]], int
    )
    known: dict[bytes, Array] = {}  # least squares ask twice

    def residuals(x: Array) -> Array:
        if x.tobytes() not in known:
            full = u.copy()
            full[active] = x
            known[x.tobytes()] = problem.residuals(full, held)
        return known[x.tobytes()]

    def jacobian(x: Array) -> Array:
        columns = []
        for i, j in enumerate(active):
            step = (
                problem.step
                if x[i] + problem.step <= problem.high[j]
                else -problem.step
            )
            moved, other = x.copy(), x.copy()
            moved[i] += step
            if problem.central:
                other[i] = min(max(x[i] - step, problem.low[j]), problem.high[j])
            columns.append(
                (residuals(moved) - residuals(other)) / (moved[i] - other[i])
            )
        return np.array(columns).T

    if not active.size:
        r = residuals(u[active])
        return Minimum(problem.solved(u, held)[0], float(r @ r), True, 1)
    low, high = problem.low[active], problem.high[active]
    inside = np.clip(u[active], low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    found = optimize.least_squares(
        residuals,
        inside,
        jacobian,
        (low, high),
        ftol=1e-8,
        xtol=1e-8,
        gtol=1e-8,
        max_nfev=200,
    )
    full = u.copy()
    full[active] = found.x
    chi2 = 2.0 * float(found.cost)
    refused = chi2 > 0.9 * REFUSED**2
    if not refused:
        full = problem.solved(full, held)[0]
    return Minimum(full, chi2, found.status > 0 and not refused, len(known))


def starts(problem: Problem, count: int, seed: int) -> list[Array]:
    """The run file's values, and others spread evenly between the bounds."""
    if count == 1:
        return [problem.start]
    sampler = qmc.LatinHypercube(
        len(problem.parameters), rng=np.random.default_rng(seed)
    )
    spread = problem.low + (problem.high - problem.low) * sampler.random(count - 1)
    return [problem.start, *spread]


def check_starts(problem: Problem, every: list[Array]) -> None:
    """Raise InputError where the reference refuses, and say which key and bound it
    takes."""
    for u in every:
        try:
            problem.parts(u)
        except TooManySteps:  # as far from the data as may be, but no mistake
            continue
        except InputError as error:
            for i, one in enumerate(problem.parameters):
                other = u.copy()
                other[i] = problem.start[i]
                if u is every[0] or one.linear or other[i] == u[i]:
                    continue
                try:
                    problem.parts(other)
                except InputError:
                    continue
                side = "upper" if u[i] > problem.start[i] else "lower"
                bound = float(one.value(one.high if side == "upper" else one.low))
                raise InputError(
                    f"fit.free.{one.key}: the reference refuses a start at {float(one.value(u[i])):.4g}; its {side} "
                    f"bound {bound:g} must be nearer ({error})"
                ) from None
            raise InputError(
                f"fit.free: the reference refuses the start ({error})"
            ) from None


class Kept(NamedTuple):
    """Results of finished tasks in a folder, for a computation that is stopped and
    begun again; in none, they are not kept. Tasks are known by a name and their number,
    so the folder must belong to one computation."""

    folder: Path | None

    def get(self, name: str, index: int) -> Any:
        """The result, None where there is none."""
        file = (
            self.folder / f"{name}-{index}.pickle" if self.folder is not None else None
        )
        return (
            pickle.loads(file.read_bytes())
            if file is not None and file.is_file()
            else None
        )

    def put(self, name: str, index: int, result: Any) -> None:
        """Keep a result. Raises InputError if it cannot be written."""
        if self.folder is not None:
            publish(self.folder, {f"{name}-{index}.pickle": pickle.dumps(result)})

    def clear(self) -> None:
        """Remove all."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


_NOT_KEPT = Kept(None)


def together(
    function: Callable[..., Any],
    tasks: Iterable[tuple[Any, ...]],
    executor: Executor | None,
    done: Callable[[], None] = lambda: None,
    kept: tuple[Kept, str] = (_NOT_KEPT, ""),
) -> list[Any]:
    """Results of independent tasks, in order, whoever computes them; those that are
    `kept` are not computed again."""
    every, (store, name) = list(tasks), kept
    found = [store.get(name, index) for index in range(len(every))]

    def keep(index: int, result: Any) -> None:
        found[index] = result
        store.put(name, index, result)
        done()

    missing = [index for index, result in enumerate(found) if result is None]
    for _ in range(len(every) - len(missing)):
        done()
    if executor is None:
        for index in missing:
            keep(index, function(*every[index]))
    else:
        futures = {executor.submit(function, *every[index]): index for index in missing}
        for future in as_completed(futures):
            keep(futures[future], future.result())
    return found


def different(minima: list[Minimum]) -> list[Minimum]:
    """Those that converged, the best first, of equal ones only one."""
    found: list[Minimum] = []
    for one in sorted((m for m in minima if m.converged), key=lambda m: m.chi2):
        if not any(abs(one.chi2 - other.chi2) < _SAME for other in found):
            found.append(one)
    return found


class Direction(NamedTuple):
    """An eigenvector of J'J: its eigenvalue, over the largest, how far all may move
    along it (standard deviation), and components by key, and its name."""

    eigenvalue: float
    ratio: float
    sd: float
    components: dict[str, float]
    name: str


def ladder(keys: list[str], jacobian: Array) -> list[Direction]:
    """Directions in the space of the parameters' variables, the best determined first."""
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    if rows.shape[0] < len(keys):  # fewer measurements than parameters
        rows = np.linalg.svd(jacobian)[2]
        singular = np.append(singular, np.zeros(len(keys) - singular.size))
    values = singular**2
    found = []
    for value, row in zip(values, rows, strict=True):
        row = row * np.sign(row[np.argmax(np.abs(row))])
        sd = 1.0 / math.sqrt(value) if value > 0 else math.inf
        components = dict(zip(keys, row.tolist(), strict=True))
        ratio = float(value / values[0]) if values[0] > 0 else 0.0
        found.append(Direction(float(value), ratio, sd, components, _name(components)))
    return found


def _name(components: dict[str, float]) -> str:
    """Which keys a direction moves, as powers of the one that moves most: "thermal.kT
    up, fit.scale down as its 0.9th power" in short."""
    order = sorted(components.items(), key=lambda item: -abs(item[1]))
    lead = order[0][1]
    shown = [(key, part / lead) for key, part in order if abs(part / lead) > 0.1]
    return " * ".join(
        f"{key}^{power:+.2g}" if power != 1.0 else key for key, power in shown
    )


def covariance(jacobian: Array) -> Array:
    """Inverse of J'J; infinite variances where it is singular."""
    try:
        found = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full((jacobian.shape[1],) * 2, np.inf)
    return found if np.all(np.diag(found) >= 0) else np.full_like(found, np.inf)
