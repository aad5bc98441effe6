"""The posterior of a fit, drawn by the ensemble sampler of emcee, in addition to profile
intervals.

The prior is that of the run file, and else flat between the bounds in the variable of
each parameter: where data determine little, the posterior depends on the bounds.
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

# Shares of the posterior below the ends of an interval.
SHARES = {"68": (0.16, 0.84), "95": (0.025, 0.975)}
# Autocorrelation times of a chain from which emcee's estimate of them can be trusted.
_ENOUGH_TIMES = 50.0
# Walkers of each parameter, and at least.
_WALKERS = 4
_LEAST_WALKERS = 16
# Steps at most, and between estimates of the autocorrelation time.
_STEPS_AT_MOST = 10_000
_CHECKED = 100
# The first 1/4 of the steps is left out.
_SETTLING = 4


@dataclass(frozen=True, repr=False)
class Posterior:
    """Draws from the posterior of a fit.

    Attributes
    ----------
    problem : Problem
        The fit.
    points : ndarray, shape (draws, parameters)
        Draws of the variables of parameters.
    density : ndarray, shape (draws,)
        Logarithm of the posterior density of these variables, up to a constant.
    walkers, steps : int
        Walkers of the sampler, and its steps without the first ones, left out.
    autocorrelation : float
        Integrated autocorrelation time of the slowest parameter, in steps.
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
        """Number of independent draws that these are worth."""
        return self.walkers * self.steps / self.autocorrelation

    @property
    def converged(self) -> bool:
        """True if the chain is so long that its autocorrelation time, and so its
        quantiles, can be trusted."""
        return self.steps >= _ENOUGH_TIMES * self.autocorrelation

    @property
    def doubt(self) -> float:
        """Standard error of the posterior's share below an end of a 95 % interval."""
        share = SHARES["95"][0]
        return math.sqrt(share * (1.0 - share) / self.effective)

    @property
    def intervals(self) -> dict[str, dict[str, Any]]:
        """Median and ends of the central 68 and 95 % by key; None if the chain is too
        short for them."""
        if not self.converged:
            none = dict.fromkeys(("median", *SHARES))
            return {key: dict(none) for key in self.problem.keys}
        found: dict[str, dict[str, Any]] = {}
        for one, points in zip(self.problem.parameters, self.points.T, strict=True):
            shares = {"median": 0.5, **SHARES}
            found[one.key] = {
                name: one.value(np.quantile(points, np.array(share))).tolist()
                for name, share in shares.items()
            }
        return found

    def summary(self) -> dict[str, Any]:
        """The content of fit.json about the posterior."""
        return {
            "parameters": {
                key: {"median": one["median"]}
                | {f"interval_{level}": one[level] for level in SHARES}
                for key, one in self.intervals.items()
            },
            "walkers": self.walkers,
            "steps": self.steps,
            "autocorrelation": self.autocorrelation,
            "effective_draws": self.effective,
            "acceptance": self.acceptance,
            "converged": self.converged,
        }

    @property
    def columns(self) -> dict[str, Array]:
        """Values by key, and the logarithm of the density of their variables."""
        pairs = zip(self.problem.parameters, self.points.T, strict=True)
        values = {one.key: np.asarray(one.value(u)) for one, u in pairs}
        return {**values, "log_density": self.density}

    def to_pandas(self) -> Any:
        """A DataFrame of the draws, a column for each key and one of the density."""
        import pandas as pd

        return pd.DataFrame(self.columns)

    def plot(self, title: str = "") -> Any:
        """A matplotlib Figure of the draws, each pair of keys in a panel. Raises
        InputError without corner."""
        from eqsim.fitting.pictures import posterior_figure

        return posterior_figure(self, title)

    def __repr__(self) -> str:
        count, short = self.points.shape[0], "" if self.converged else ", TOO SHORT"
        worth = f"worth {self.effective:.0f} independent ones"
        return f"Posterior({count} draws, {worth}{short})"

    def _repr_html_(self) -> str:
        return str(self.to_pandas().describe().to_html())


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
        Its data, model, bounds, priors and seed are used; walkers start around its best
        fit.
    workers : int
        Processes; they change speed, never a number.
    progress : callable, optional
        `progress(done, total)` counts steps; the total is estimated anew on the way.

    Returns
    -------
    Posterior
        Draws over 50 autocorrelation times, or 10 000 steps, whichever is less.

    Raises
    ------
    InputError
        If emcee is not installed.

    Examples
    --------
    >>> from eqsim import fit, posterior
    >>> result = fit("runs/fit-synthetic.toml")  # doctest: +SKIP
    >>> posterior(result).intervals["thermal.kT"]["median"]  # doctest: +SKIP
    0.102
    """
    require_integer("workers", workers, 1, 1024)
    rng, best = np.random.default_rng(result.seed), result.best.u
    about = result.problem, best, result.covariance, rng
    with Workers(workers).executor() as executor:
        return draw_posterior(*about, executor, progress)


def draw_posterior(
    problem: Problem,
    best: Array,
    covariance: Array,
    rng: np.random.Generator,
    executor: Executor | None = None,
    progress: Progress = lambda done, total: None,
) -> Posterior:
    """Draw as `posterior` does, from walkers about the `best` fit, (parameters,), spread
    by its `covariance`, (parameters, parameters)."""
    emcee = require_package("posterior", "emcee")

    def densities(points: Array) -> Array:
        if executor is None:
            return np.array([problem.density(u) for u in points])
        return np.array(list(executor.map(problem.density, points, chunksize=8)))

    walkers = max(_WALKERS * best.size, _LEAST_WALKERS)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(
        walkers, best.size, densities, moves=moves, vectorize=True
    )
    # emcee's wrapper of a function prints a traceback also for Ctrl-C
    sampler.log_prob_fn = densities
    state = np.random.RandomState(rng.integers(2**32)).get_state()
    begin = _around(problem, best, covariance, rng, walkers)
    progress(0, _STEPS_AT_MOST)
    tau = math.inf
    for _ in sampler.sample(
        emcee.State(begin, random_state=state), iterations=_STEPS_AT_MOST
    ):
        done = sampler.iteration
        if done % _CHECKED:
            continue
        chain = sampler.get_chain(discard=done // _SETTLING)
        tau = float(np.max(emcee.autocorr.integrated_time(chain, tol=0)))
        if not math.isfinite(tau):  # no walker has moved
            tau = math.inf
        if len(chain) >= _ENOUGH_TIMES * tau:
            break
        needed = _ENOUGH_TIMES * tau * _SETTLING / (_SETTLING - 1)
        progress(done, min(_STEPS_AT_MOST, max(done + _CHECKED, needed)))
    progress(done, done)
    thin = max(int(min(0.5 * tau, done / 10)), 1)
    kept = {"discard": done // _SETTLING, "thin": thin, "flat": True}
    points, density = sampler.get_chain(**kept), sampler.get_log_prob(**kept)
    acceptance = float(np.mean(sampler.acceptance_fraction))
    return Posterior(problem, points, density, walkers, len(chain), tau, acceptance)


def _around(
    problem: Problem, best: Array, covariance: Array, rng: np.random.Generator, n: int
) -> Array:
    """Points about a best fit, spread as its covariance says, inside the bounds."""
    low, high, zero = problem.low, problem.high, np.zeros(best.size)
    finite, width = np.where(np.isfinite(covariance), covariance, 0.0), high - low
    options: Any = {"method": "eigh", "check_valid": "ignore"}
    steps = rng.multivariate_normal(zero, finite, n, **options)
    longest = np.maximum(np.max(np.abs(steps) / width, axis=1), 1e-300)
    steps *= np.minimum(1.0, 0.4 / longest)[:, None]
    # directions of no known width
    steps += 1e-4 * width * rng.standard_normal(steps.shape)
    moved = low + np.abs(best + steps - low)
    return np.asarray(high - np.abs(high - moved))
