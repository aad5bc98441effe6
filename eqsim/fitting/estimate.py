"""Least squares from many starts, and its covariance, eigenvectors and eigenvalues."""

import math
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
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

# Ratio of eigenvalues of J'J below which a direction is not determined.
DEGENERATE = 1e-7
# Minima whose chi-square differs by less are taken for the same one.
SAME_MINIMUM = 0.1
# Relative changes of chi-square, parameters and gradient at which a search ends.
_SEARCH_TOLERANCE = 1e-8


class Minimum(NamedTuple):
    """End of a minimisation: parameters, chi-square (priors included), whether it
    converged, and the number of solves."""

    u: Array
    chi2: float
    converged: bool
    solves: int


def minimise(problem: Problem, u: Array, held: int = -1) -> Minimum:
    """Least squares from `u`, with the parameter of index `held` fixed; linear ones need
    no start."""
    searched = np.flatnonzero(~problem.linear & (np.arange(u.size) != held))
    low, high = problem.low[searched], problem.high[searched]
    known: dict[bytes, Array] = {}  # SciPy asks for some points twice

    def residuals(x: Array) -> Array:
        if x.tobytes() not in known:
            full = u.copy()
            full[searched] = x
            known[x.tobytes()] = problem.residuals(full, held)
        return known[x.tobytes()]

    def jacobian(x: Array) -> Array:
        columns = []
        for i, value in enumerate(x):
            step = problem.step if value + problem.step <= high[i] else -problem.step
            moved, other = x.copy(), x.copy()
            moved[i] += step
            if problem.central:
                other[i] = min(max(value - step, low[i]), high[i])
            change = residuals(moved) - residuals(other)
            columns.append(change / (moved[i] - other[i]))
        return np.array(columns).T

    if not searched.size:
        r = residuals(u[searched])
        return Minimum(problem.solved(u, held).u, float(r @ r), True, 1)
    inset = 1e-9 * (high - low)
    least = optimize.least_squares(
        residuals,
        np.clip(u[searched], low + inset, high - inset),
        jacobian,
        (low, high),
        **dict.fromkeys(("ftol", "xtol", "gtol"), _SEARCH_TOLERANCE),
        max_nfev=200,
    )
    full = u.copy()
    full[searched] = least.x
    chi2 = 2.0 * float(least.cost)
    refused = chi2 > 0.9 * REFUSED**2
    if not refused:
        full = problem.solved(full, held).u
    return Minimum(full, chi2, least.status > 0 and not refused, len(known))


def starts(problem: Problem, count: int, seed: int) -> list[Array]:
    """Points to start from: the run file's values, and a Latin hypercube between the
    bounds."""
    rng = np.random.default_rng(seed)
    sampler = qmc.LatinHypercube(len(problem.parameters), rng=rng)
    width = problem.high - problem.low
    return [problem.start, *(problem.low + width * sampler.random(count - 1))]


def check_starts(problem: Problem, every: list[Array]) -> None:
    """Raise InputError if the reference refuses one of these starts, naming the key and
    the bound at fault."""
    for u in every:
        error = _refusal(problem, u)
        if error is None:
            continue
        for i, one in enumerate(problem.parameters):
            nearer = np.where(np.arange(u.size) == i, problem.start, u)
            moved = not one.linear and nearer[i] != u[i]
            if moved and _refusal(problem, nearer) is None:
                upper = u[i] > problem.start[i]
                side, bound = ("upper", one.high) if upper else ("lower", one.low)
                raise InputError(
                    f"fit.free.{one.key}: the reference refuses a start at "
                    f"{one.value(u[i]):.4g}; its {side} bound {one.value(bound):g} "
                    f"must be nearer ({error})"
                )
        raise InputError(f"fit.free: the reference refuses the start ({error})")


def _refusal(problem: Problem, u: Array) -> InputError | None:
    """The error of the reference if it has no predictions."""
    try:
        problem.given(u)
    except TooManySteps:  # slips too often here, but a search may leave
        return None
    except InputError as error:
        return error
    return None


@dataclass(frozen=True)
class Tasks:
    """Independent tasks, computed by an executor, or one after the other by this
    process. A `folder` keeps their results, by name and number, so that a computation
    that was stopped can go on."""

    executor: Executor | None = None
    folder: Path | None = None

    def results(
        self,
        name: str,
        function: Callable[..., Any],
        tasks: Sequence[tuple[Any, ...]],
        done: Callable[[], None] = lambda: None,
    ) -> list[Any]:
        """Results in the order of the tasks; those that are kept are not computed again.
        Raises InputError if one cannot be kept."""
        files = [f"{name}-{index}.pickle" for index in range(len(tasks))]
        found, missing = dict[str, Any](), dict[str, tuple[Any, ...]]()
        for file, task in zip(files, tasks, strict=True):
            if self.folder is not None and (self.folder / file).is_file():
                found[file] = pickle.loads((self.folder / file).read_bytes())
                done()
            else:
                missing[file] = task
        for file, result in self._computed(function, missing):
            found[file] = result
            if self.folder is not None:
                publish(self.folder, {file: pickle.dumps(result)})
            done()
        return [found[file] for file in files]

    def _computed(
        self, function: Callable[..., Any], tasks: dict[str, tuple[Any, ...]]
    ) -> Iterator[tuple[str, Any]]:
        """Results by name, as they are finished."""
        if self.executor is None:
            yield from ((name, function(*task)) for name, task in tasks.items())
            return
        submit = self.executor.submit
        futures = {submit(function, *task): name for name, task in tasks.items()}
        for future in as_completed(futures):
            yield futures[future], future.result()


def different(minima: Sequence[Minimum]) -> list[Minimum]:
    """Distinct minima that converged, the best first."""
    distinct: list[Minimum] = []
    for one in sorted((m for m in minima if m.converged), key=lambda m: m.chi2):
        if not any(abs(one.chi2 - other.chi2) < SAME_MINIMUM for other in distinct):
            distinct.append(one)
    return distinct


class Direction(NamedTuple):
    """An eigenvector of J'J: eigenvalue, its ratio to the largest, standard deviation
    of the parameters along it, components by key, and a name."""

    eigenvalue: float
    ratio: float
    sd: float
    components: dict[str, float]
    name: str


def ladder(keys: list[str], jacobian: Array) -> list[Direction]:
    """Eigenvectors of J'J in the space of parameters' variables, best determined first."""
    missing = max(len(keys) - len(jacobian), 0)  # fewer measurements than parameters
    padded = np.vstack((jacobian, np.zeros((missing, len(keys)))))
    _, singular, rows = np.linalg.svd(padded, full_matrices=False)
    directions = []
    for value, row in zip((singular**2).tolist(), rows, strict=True):
        row = row * np.sign(row[np.argmax(np.abs(row))])
        components = dict(zip(keys, row.tolist(), strict=True))
        ratio, sd = 0.0, math.inf
        if value > 0:
            ratio, sd = float(value / singular[0] ** 2), 1.0 / math.sqrt(value)
        directions.append(Direction(value, ratio, sd, components, _product(components)))
    return directions


def _product(components: dict[str, float]) -> str:
    """Name of a direction: a product of powers of its keys, the largest component
    first."""
    order = sorted(components.items(), key=lambda item: -abs(item[1]))
    powers = {key: part / order[0][1] for key, part in order}
    return " * ".join(
        key if power == 1.0 else f"{key}^{power:+.2g}"
        for key, power in powers.items()
        if abs(power) > 0.1
    )


def covariance(jacobian: Array) -> Array:
    """Inverse of J'J; infinite variances where it is singular."""
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return np.full((jacobian.shape[1],) * 2, np.inf)
    return inverse if np.all(np.diag(inverse) >= 0) else np.full_like(inverse, np.inf)
