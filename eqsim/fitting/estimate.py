"""Least squares from many starts, and its covariance, eigenvectors and eigenvalues."""

import math
import pickle
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass, replace
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
# Singular value, relative to the largest, of a direction along which nothing changes, and
# the least squared component of a parameter in a direction that moves it.
_NULL = 1e-12
_MOVED = 1e-12
# Digits of powers in the name of a direction: the first number of them with which the
# standard deviation grows by less than this factor; and the part of a unit vector that
# is rounding.
_DIGITS = (2, 3, 4, 5, 6)
_ROUNDED_SD = 1.1
_ROUNDING = 1e-14
# Fall of chi-square that Gauss-Newton steps of `refine` still take, the share of it that
# a step has to bring, and the most solves before a search with a trust region.
_REFINED_GAIN = 5e-3
_LEAST_GAIN = 0.2
# Least damping: a step beyond a factor 20 in a parameter costs as much as a rise of 1.
_DAMPING = 0.1
_MOST_REFINED = 80

# `map`, or that of threads.
Each = Callable[..., Iterable[Any]]


class Minimum(NamedTuple):
    """End of a minimisation: parameters, chi-square (priors included), whether it
    converged, and the number of solves."""

    u: Array
    chi2: float
    converged: bool
    solves: int


class _Search:
    """Residuals as a function of the parameters that are searched: all but the linear
    ones, which need no start, and that of index `held`; `x` holds their variables in
    natural units."""

    def __init__(self, problem: Problem, u: Array, held: int, each: Each = map) -> None:
        self.problem, self.u, self.held, self.each = problem, u, held, each
        self.index = searched(problem, held)
        self.unit = problem.unit_of_variables[self.index]
        self.low, self.high, self.start = (
            ends[self.index] / self.unit for ends in (problem.low, problem.high, u)
        )
        # all parameters and residuals; SciPy asks for some points twice
        self.known: dict[bytes, tuple[Array, Array]] = {}

    def full(self, x: Array) -> Array:
        """All parameters, the linear ones where the search began."""
        full = self.u.copy()
        full[self.index] = x * self.unit
        return np.clip(full, self.problem.low, self.problem.high)

    def solved(self, x: Array) -> tuple[Array, Array]:
        """All parameters, the linear ones at their best, and residuals."""
        if x.tobytes() not in self.known:
            full = self.full(x)
            self.known[x.tobytes()] = self.problem.deviations(full, self.held)
        return self.known[x.tobytes()]

    def residuals(self, x: Array) -> Array:
        return self.solved(x)[1]

    def jacobian(self, x: Array) -> Array:
        """Derivatives of residuals by finite differences."""
        step = self.problem.steps(self.full(x))[self.index] / self.unit
        each_alone = np.eye(x.size, dtype=bool)
        signed = np.where(x + step <= self.high, step, -step)
        ahead, behind = x + signed, x
        if self.problem.central:
            behind = np.clip(x - signed, self.low, self.high)
        ends = [np.where(each_alone, end, x) for end in (ahead, behind)]
        r = np.array(list(self.each(self.residuals, np.concatenate(ends))))
        change = r[: x.size] - r[x.size :]
        return np.asarray((change / (ahead - behind)[:, None]).T)

    def minimum(self, x: Array, converged: bool) -> Minimum:
        """The end of a search at `x`."""
        full, r = self.solved(x)
        chi2 = float(r @ r)
        good = converged and chi2 <= 0.9 * REFUSED**2
        return Minimum(full, chi2, good, len(self.known))


def searched(problem: Problem, held: int = -1) -> Array:
    """Indices of the parameters that a search changes."""
    kept = np.arange(len(problem.parameters)) != held
    return np.flatnonzero(~problem.linear & kept)


def minimise(problem: Problem, u: Array, held: int = -1, each: Each = map) -> Minimum:
    """Least squares from `u`, with the parameter of index `held` fixed; linear ones need
    no start. `each` maps a function over the points of a derivative."""
    search = _Search(problem, u, held, each)
    x, low, high = search.start, search.low, search.high
    if not x.size:
        return search.minimum(x, True)
    inset = 1e-9 * (high - low)
    least = optimize.least_squares(
        search.residuals,
        np.clip(x, low + inset, high - inset),
        search.jacobian,
        (low, high),
        **dict.fromkeys(("ftol", "xtol", "gtol"), problem.tolerance),
        max_nfev=200,
    )
    return search.minimum(least.x, least.status > 0)


def search(problem: Problem, u: Array, each: Each = map) -> Minimum:
    """Least squares from a start, as `minimise`; with a robust loss, which hardly falls
    towards data that are many standard errors away, also from the end without it."""
    best = minimise(problem, u, each=each)
    if problem.loss == "gaussian":
        return best
    near = minimise(replace(problem, loss="gaussian"), u, each=each)
    again = minimise(problem, near.u, each=each)
    solves = best.solves + near.solves + again.solves
    return min(best, again, key=lambda end: end.chi2)._replace(solves=solves)


def refine(
    problem: Problem, u: Array, held: int, slopes: Array
) -> tuple[Minimum, Array]:
    """Least squares from a guess near the minimum, by steps of Levenberg and Marquardt
    with derivatives `slopes` of residuals from nearby, with respect to variables in
    natural units, shape (measurements + priors, searched), which each step improves
    (Broyden, 1965). Where they lead astray steps become shorter, and
    they are found anew. Returns the minimum, and derivatives for the next guess."""
    search, fresh, damping, failed = _Search(problem, u, held), False, _DAMPING, 0
    x, unit = search.start, np.minimum(search.high - search.low, 1.0)
    converged = not x.size
    while len(search.known) < _MOST_REFINED and not converged:
        r = search.residuals(x)
        damped = np.vstack((slopes, np.diag(math.sqrt(damping) / unit)))
        target = np.append(-r, np.zeros(x.size))
        bounds = search.low - x, search.high - x
        step = optimize.lsq_linear(damped, target, bounds, method="bvls").x
        change = slopes @ step
        gain = float(r @ r - (r + change) @ (r + change))
        if gain < _REFINED_GAIN:
            # those of a robust loss fade as residuals grow: old ones hide a gain
            converged = fresh or problem.loss == "gaussian"
            if not converged:
                slopes, fresh = search.jacobian(x), True
            continue
        moved = np.clip(x + step, search.low, search.high)
        new = search.residuals(moved)
        if r @ r - new @ new > _LEAST_GAIN * gain:
            slopes = slopes + np.outer(new - r - change, step) / (step @ step)
            x, fresh, failed = moved, False, 0
            damping = max(0.2 * damping, _DAMPING)
        elif failed and not fresh:
            slopes, fresh = search.jacobian(x), True
        else:
            damping, failed = 10.0 * damping, failed + 1
    return search.minimum(x, converged), slopes


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
    that was stopped can go on. `threads`: of a search that is alone."""

    executor: Executor | None = None
    folder: Path | None = None
    threads: int = 1

    def results(
        self,
        name: str,
        function: Callable[..., Any],
        tasks: Sequence[tuple[Any, ...]],
        done: Callable[[int, Any], None] = lambda index, result: None,
    ) -> list[Any]:
        """Results in the order of the tasks; those that are kept are not computed again.
        `done(index, result)` is called for each when it is there. Raises InputError if
        one cannot be kept."""
        found, missing = dict[int, Any](), dict[int, tuple[Any, ...]]()
        for index, task in enumerate(tasks):
            kept = self.folder and self.folder / f"{name}-{index}.pickle"
            if kept and kept.is_file():
                found[index] = pickle.loads(kept.read_bytes())
                done(index, found[index])
            else:
                missing[index] = task
        computed: Iterable[tuple[int, Any]]
        if self.executor is None:
            computed = ((index, function(*task)) for index, task in missing.items())
        else:
            submit = self.executor.submit
            futures = {submit(function, *task): i for i, task in missing.items()}
            computed = ((futures[one], one.result()) for one in as_completed(futures))
        for index, result in computed:
            found[index] = result
            if self.folder:
                content = pickle.dumps(result)
                publish(self.folder, {f"{name}-{index}.pickle": content})
            done(index, result)
        return [found[index] for index in range(len(tasks))]


def different(minima: Sequence[Minimum]) -> list[Minimum]:
    """Distinct minima that converged, the best first."""
    distinct: list[Minimum] = []
    for one in sorted((m for m in minima if m.converged), key=lambda m: m.chi2):
        if not any(abs(one.chi2 - other.chi2) < SAME_MINIMUM for other in distinct):
            distinct.append(one)
    return distinct


class Direction(NamedTuple):
    """An eigenvector of J'J: eigenvalue, its ratio to the largest, standard deviation
    of the parameters along it, components by key, a product of powers that goes along
    it, its name, and the standard deviation of the product's logarithm."""

    eigenvalue: float
    ratio: float
    sd: float
    components: dict[str, float]
    name: str
    sd_of_name: float


def principal_axes(jacobian: Array) -> tuple[Array, Array]:
    """Singular values of J, the largest first, one for each parameter, and the
    directions that belong to them, shape (parameters, parameters)."""
    missing = max(jacobian.shape[1] - len(jacobian), 0)  # fewer measurements
    padded = np.vstack((jacobian, np.zeros((missing, jacobian.shape[1]))))
    _, singular, rows = np.linalg.svd(padded, full_matrices=False)
    return singular, rows


def ladder(factors: dict[str, str], jacobian: Array) -> list[Direction]:
    """Eigenvectors of J'J in the space of parameters' variables, best determined first.
    `factors` names, by key, what each variable is the logarithm of."""
    singular, rows = principal_axes(jacobian)
    directions = []
    for value, row in zip((singular**2).tolist(), rows, strict=True):
        row = row * np.sign(row[np.argmax(np.abs(row))])
        components = dict(zip(factors, row.tolist(), strict=True))
        ratio, sd = 0.0, math.inf
        if value > 0:
            ratio, sd = float(value / singular[0] ** 2), 1.0 / math.sqrt(value)
        sd_of_name = sd / float(row.max())
        for digits in _DIGITS:
            powers = _rounded(row / row.max(), digits)
            there = _sd_along(powers, singular, rows)
            if there <= _ROUNDED_SD * sd_of_name:
                sd_of_name = there
                break
        name = _product(dict(zip(factors.values(), powers.tolist(), strict=True)))
        known = Direction(value, ratio, sd, components, name, sd_of_name)
        directions.append(known)
    return directions


def _rounded(powers: Array, digits: int) -> Array:
    """Powers, of which the largest is 1, with so many digits, without small ones."""
    rounded = [float(f"{power:.{digits}g}") for power in powers]
    return np.where(np.abs(powers) > 10.0 ** (1 - digits), rounded, 0.0)


def _sd_along(powers: Array, singular: Array, rows: Array) -> float:
    """The standard deviation of the logarithm of a product of powers, which goes along
    several directions; infinite if one of these has no bound."""
    along = rows @ powers
    moved = np.abs(along) > _ROUNDING
    if np.any(singular[moved] == 0):
        return math.inf
    return float(np.linalg.norm(along[moved] / singular[moved]))


def _product(powers: dict[str, float]) -> str:
    """A product of powers, the largest first."""
    order = sorted(powers.items(), key=lambda item: -abs(item[1]))
    return " * ".join(
        name if power == 1.0 else f"{name}^{power:+g}" for name, power in order if power
    )


def inverse_root(jacobian: Array, least: float) -> tuple[Array, Array]:
    """A root R of the inverse of J'J, which is R R', shape (parameters, directions),
    without directions whose singular values are less than `least` times the largest,
    each column of J in its own unit; and, for each parameter, whether these directions
    move it."""
    norm = np.linalg.norm(jacobian, axis=0)
    norm[norm == 0.0] = 1.0
    singular, rows = principal_axes(jacobian / norm)
    known = singular > least * singular[0]
    lost = np.any(rows[~known] ** 2 > _MOVED, axis=0)
    return (rows[known] / singular[known, None] / norm).T, lost


def covariance(jacobian: Array) -> Array:
    """Inverse of J'J; infinite for parameters that move along a null direction."""
    root, lost = inverse_root(jacobian, _NULL)
    return np.where(lost | lost[:, None], np.inf, root @ root.T)
