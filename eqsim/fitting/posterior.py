"""The posterior of a fit, drawn by the ensemble sampler of emcee, beside profile
intervals, never instead of them.

The prior is that of the run file, and else flat between the bounds in the variable of
each parameter: where data decide little, the posterior says what the bounds are.
"""

import math
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from eqsim.errors import require_integer, require_package
from eqsim.fitting.fit import FitResult, Progress
from eqsim.fitting.model import Problem
from eqsim.numerics.tables import Array
from eqsim.sweeps.workers import Workers

SHARES = {
    "68": (0.16, 0.84),
    "95": (0.025, 0.975),
}  # of the posterior below the ends of an interval
_ENOUGH = 50.0  # autocorrelation times, from which on emcee's estimate of that time can be trusted
_WALKERS, _LEAST = 4, 16  # of each parameter, and at least
_MOST, _CHECKED = 10_000, 100  # steps, and after how many the chain is looked at
_SETTLING = 4  # 1/4 of the steps is left out


@dataclass(frozen=True, repr=False)
class Posterior:
    """Draws from the posterior of a fit.

    Attributes
    ----------
    problem : Problem
        The fit.
    points : ndarray, shape (draws, parameters)
        In the variables of parameters.
    density : ndarray, shape (draws,)
        Logarithm of the posterior density of these variables, but for a constant.
    walkers, steps : int
        Of the sampler, the steps that count.
    autocorrelation : float
        Steps after which a walker has forgotten where it was, of the slowest parameter.
    acceptance : float
        Share of moves that were accepted.
    """

    problem: Problem
    points: Array
    density: Array
    walkers: int
    steps: int
    autocorrelation: float
    acceptance: float

    @property
    def effective(self) -> float:
        """How many independent draws these are worth."""
        return self.walkers * self.steps / self.autocorrelation

    @property
    def converged(self) -> bool:
        """Whether the chain is so long that its autocorrelation time, and so its
        quantiles, can be trusted."""
        return self.steps >= _ENOUGH * self.autocorrelation

    @property
    def doubt(self) -> float:
        """Standard error of the share of the posterior below an end of a 95 % interval."""
        share = SHARES["95"][0]
        return math.sqrt(share * (1.0 - share) / self.effective)

    @property
    def intervals(self) -> dict[str, dict[str, Any]]:
        """By key: median, and the ends of the central 68 and 95 %; None if the chain is
        too short for them."""
        found: dict[str, dict[str, Any]] = {}
        for one, values in zip(self.problem.parameters, self.points.T, strict=True):
            shares = {"median": (0.5,), **SHARES}
            ends = {
                name: one.value(np.quantile(values, np.array(part))).tolist()
                for name, part in shares.items()
            }
            found[one.key] = (
                {**ends, "median": ends["median"][0]}
                if self.converged
                else dict.fromkeys(shares)
            )
        return found

    def to_pandas(self) -> Any:
        """A DataFrame of the draws, a column for each key and one of the density."""
        import pandas as pd

        return pd.DataFrame(self.columns)

    @property
    def columns(self) -> dict[str, Array]:
        """Values by key, and the logarithm of the density of their variables."""
        parameters = self.problem.parameters
        values = {
            one.key: np.asarray(one.value(u))
            for one, u in zip(parameters, self.points.T, strict=True)
        }
        return {**values, "log_density": self.density}

    def plot(self, title: str = "") -> Any:
        """A matplotlib Figure of the draws, each pair of keys in a panel. Raises
        InputError without corner."""
        from eqsim.fitting.pictures import posterior_figure

        return posterior_figure(self, title)

    def __repr__(self) -> str:
        short = "" if self.converged else ", TOO SHORT"
        return f"Posterior({self.points.shape[0]} draws, worth {self.effective:.0f} independent ones{short})"

    def _repr_html_(self) -> str:
        shown: str = self.to_pandas().describe().to_html()
        return shown


def posterior(
    result: FitResult,
    *,
    workers: int = 1,
    progress: Progress = lambda done, total: None,
) -> Posterior:
    """Draw from the posterior of the parameters of a fit.

    Parameters
    ----------
    result : FitResult
        Whose data, model, bounds, priors and seed are used; walkers start around its
        best fit.
    workers : int
        Processes; they change speed, never a number.
    progress : callable, optional
        `progress(done, total)` counts steps; the total is what is needed by all that is
        known so far.

    Returns
    -------
    Posterior
        Of 50 autocorrelation times, or of 10 000 steps, whichever is less.

    Raises
    ------
    InputError
        If emcee is not installed.
    """
    require_integer("workers", workers, 1, 1024)
    with Workers(workers).executor() as executor:
        rng = np.random.default_rng(result.seed)
        return sample(
            result.problem, result.best.u, result.covariance, rng, executor, progress
        )


def sample(
    problem: Problem, best: Array, covariance: Array, rng: np.random.Generator,
    executor: Executor | None = None, progress: Progress = lambda done, total: None,
) -> Posterior:  # fmt: skip
    """As `posterior`, by the `covariance` about the `best` fit, shapes (parameters,
    parameters) and (parameters,)."""
    emcee = require_package("posterior", "emcee")

    def densities(points: Array) -> Array:
        known = (
            map(problem.density, points)
            if executor is None
            else executor.map(problem.density, points, chunksize=8)
        )
        return np.fromiter(known, float, len(points))

    walkers = max(_WALKERS * best.size, _LEAST)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(
        walkers, best.size, densities, moves=moves, vectorize=True
    )
    state = np.random.RandomState(rng.integers(2**32)).get_state()
    first = emcee.State(
        _around(problem, best, covariance, walkers, rng), random_state=state
    )
    progress(0, _MOST)
    tau = math.inf
    for _ in sampler.sample(first, iterations=_MOST):
        done = sampler.iteration
        if done % _CHECKED:
            continue
        chain = sampler.get_chain(discard=done // _SETTLING)
        tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0)))
        tau = (
            tau if math.isfinite(tau) else math.inf
        )  # of walkers that have not moved it is not known
        if len(chain) >= _ENOUGH * tau:
            break
        progress(
            done,
            min(
                _MOST, max(done + _CHECKED, _ENOUGH * tau * _SETTLING / (_SETTLING - 1))
            ),
        )
    progress(done, done)
    part = {
        "discard": done // _SETTLING,
        "thin": max(int(min(0.5 * tau, done / 10)), 1),
        "flat": True,
    }
    return Posterior(
        problem, sampler.get_chain(**part), sampler.get_log_prob(**part), walkers, len(chain), tau,
        float(np.mean(sampler.acceptance_fraction)),
    )  # fmt: skip


def _around(
    problem: Problem,
    best: Array,
    covariance: Array,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """Points about a best fit, spread as its covariance says, inside the bounds."""
    low, high = problem.low, problem.high
    width = high - low
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    steps = rng.multivariate_normal(
        np.zeros(best.size), known, count, method="eigh", check_valid="ignore"
    )
    steps *= np.minimum(
        1.0, 0.4 / np.maximum(np.max(np.abs(steps) / width, axis=1), 1e-300)
    )[:, None]
    steps += (
        1e-4 * width * rng.standard_normal(steps.shape)
    )  # directions of no known width
    moved = low + np.abs(best + steps - low)
    return np.asarray(high - np.abs(high - moved))
