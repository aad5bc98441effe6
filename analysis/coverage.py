"""Expected errors of fits to steady friction, and the coverage of their intervals.

    python -m analysis.coverage [--sets 40] [--seed 1] [--only NAME] [--posterior]

The first table has standard deviations of the logarithms of F0 = N k x_*, v0 = omega
x_*, b and n + 1, expected by the Fisher information from 12 velocities per temperature
with 5 % noise. The second has, for some models, the share of fits to synthetic data
whose profile intervals contain the truth, with the range expected of a binomial number.
With --posterior, instead: truths are drawn from the prior, data for them, and the share
of the posterior below the truth, which must be uniform (simulation-based calibration;
Talts et al., arXiv:1804.06788).
"""

import argparse
import math
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from eqsim import Ensemble, Gamma, Thermal
from eqsim.fitting import posterior
from eqsim.fitting import rate_and_state as rates
from eqsim.fitting.data import MeasuredAt, Measurements
from eqsim.fitting.estimate import covariance, minimise
from eqsim.fitting.fit import problem_of
from eqsim.fitting.model import Problem
from eqsim.fitting.profiles import LEVELS
from eqsim.fitting.record import settle_steps
from eqsim.fitting.section import section_of
from eqsim.io.runfile import check

NOISE, VELOCITIES, N = 0.05, 12, 1.0


class Case(NamedTuple):
    """Contacts with b = k x_*^2/(2 kT), n = 1 and k = omega = x_* = 1, measured over
    some decades of velocity (around v_* if annealed, else around omega x_*/100), with
    the temperature multiplied by each of `heats`."""

    disorder: str
    b: float
    law: str
    decades: float
    heats: tuple[float, ...]

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of the measurements at each temperature."""
        center = 1e-2
        if self.disorder == "annealed":
            contacts = Ensemble(
                Gamma(N),
                Thermal(0.5 / self.b),
                disorder="annealed",
                stiffness_law=self.law,
            )
            center = contacts.crossover_velocity
        return center * np.logspace(-0.5 * self.decades, 0.5 * self.decades, VELOCITIES)


FREE = ("thermal.kT", "thermal.attempt_frequency", "thresholds.n")


def problem(case: Case, free: tuple[str, ...] = FREE, **changes: dict) -> Problem:
    """A fit of exact data: F0, v0, b and n + 1 are fit.scale, attempt_frequency, 1/kT
    and n + 1, as x_* = k = 1."""
    bounds = {
        "thermal.kT": {"bounds": [1e-3, 20.0]},
        "thermal.attempt_frequency": {"bounds": [1e-4, 1e4]},
        "thresholds.n": {"bounds": [0.0, 15.0], "transform": "log1p"},
    }
    content = {
        "disorder": case.disorder,
        "contacts": {"stiffness_law": case.law},
        "thermal": {"kT": 0.5 / case.b, "attempt_frequency": 1.0},
        "thresholds": {"n": N, "x_star": 1.0},
        **changes,
        "fit": {
            "scale": {"start": 1.0, "bounds": [1e-3, 1e3]},
            "noise": {"relative": NOISE},
            "free": {key: bounds.get(key, {"bounds": [1e-4, 1e4]}) for key in free},
        },
    }
    file = check(content)
    rows = [
        MeasuredAt((("drive.velocity", float(v)),), heat, "")
        for heat in case.heats
        for v in case.velocities
    ]
    n, ones, names = len(rows), np.ones(len(rows)), ["drive.velocity"]
    table = Measurements(rows, ["friction"] * n, ones, ones, names, "")
    fit = problem_of(file, section_of(file), table)
    exact = fit.given(fit.start)
    return replace(fit, value=exact, sigma=NOISE * exact)


def expected(fit: Problem) -> dict[str, float]:
    """Standard deviation of each parameter's logarithm, by key."""
    sd = np.sqrt(np.diag(covariance(fit.jacobian(fit.start))))
    return {
        parameter.key: float(x) for parameter, x in zip(fit.parameters, sd, strict=True)
    }


# expected standard deviations of F0, v0, b and n + 1
TABLE = {
    Case("annealed", 5.0, "uniform", 2.0, (1.0,)): (1.1, 9.6, 12.0, 2.6),
    Case("annealed", 5.0, "uniform", 4.0, (1.0,)): (0.14, 0.78, 1.12, 0.34),
    Case("annealed", 5.0, "uniform", 4.0, (1.0, 1.3)): (0.072, 0.41, 0.54, 0.16),
    Case("annealed", 5.0, "uniform", 4.0, (1.0, 3.0)): (0.061, 0.41, 0.49, 0.13),
    Case("annealed", 50.0, "uniform", 4.0, (1.0,)): (0.061, 1.2, 1.4, 0.14),
    Case("annealed", 50.0, "uniform", 4.0, (1.0, 3.0)): (0.022, 0.17, 0.17, 0.035),
    Case("quenched", 5.0, "uniform", 4.0, (1.0,)): (1.1, 6.2, 3.1, 2.6),
    Case("quenched", 5.0, "uniform", 4.0, (1.0, 3.0)): (0.12, 0.80, 0.054, 0.32),
    Case("quenched", 5.0, "sqrt", 4.0, (1.0,)): (0.75, 4.6, 7.5, 2.5),
    Case("quenched", 5.0, "sqrt", 4.0, (1.0, 3.0)): (0.084, 1.9, 0.60, 0.16),
}
COLUMNS = ("fit.scale", "thermal.attempt_frequency", "thermal.kT", "thresholds.n")

RECORD = """
[contacts]
stiffness_law = "uniform"
[thresholds]
n = 1.0
x_star = 1.0
[aging]
rule = "logarithmic"
beta = 0.05
cutoff_time = 0.1
[drive]
start = "stationary"
velocity = 0.1
programme = [{ velocity = 0.1, time = 3.0 }, { velocity = 1.0, time = 2.0 }]
[drive.stage]
stiffness = 0.5
[fit]
record = { file = "" }
noise = { absolute = 0.003 }
scale = { start = 1.0, bounds = [0.1, 10.0] }
[fit.free]
"aging.beta" = { bounds = [1e-3, 0.5] }
"drive.stage.stiffness" = { bounds = [0.05, 5.0] }
"fit.drift" = { bounds = [-0.1, 0.1] }
"""
RHO = 0.7  # correlation of neighbours in a record


def record() -> Problem:
    """A velocity step of contacts at T = 0 that strengthen as ln t, through a spring:
    81 points, exact."""
    file = check(tomllib.loads(RECORD))
    time = np.linspace(0.0, 5.0, 81)
    ones, rows, names = np.ones(81), [MeasuredAt()] * 81, ["friction"] * 81
    table = Measurements(rows, names, ones, 0.003 * ones, [], "", time)
    fit = problem_of(file, section_of(file), table)
    fit = settle_steps(fit, fit.start)
    return replace(fit, value=fit.given(fit.start), correlation=np.full(80, RHO))


# Rate-and-state friction along the same programme.
RATE_AND_STATE = {"a": 0.01, "b": 0.014, "D_c": 0.08, "k": 0.3, "mu_0": 0.6}


def rate_and_state(law: str) -> Problem:
    """A velocity step of rate-and-state friction, with a trend per displacement: 121
    points, exact."""
    time = np.linspace(0.0, 5.0, 121)
    ones, rows, names = np.ones(121), [MeasuredAt()] * 121, ["friction"] * 121
    table = Measurements(rows, names, ones, 3e-4 * ones, [], "", time)
    fit = rates.problem_of(
        check(tomllib.loads(RECORD)), table, law, {"trend": "displacement"}
    )
    truth = RATE_AND_STATE | {"trend": 1e-3}
    starts = [p._replace(start=p.variable(truth[p.key])) for p in fit.parameters]
    fit = replace(fit, parameters=starts, correlation=np.full(120, RHO))
    return replace(fit, value=fit.given(fit.start))


COVERED = {
    "annealed": lambda: problem(Case("annealed", 5.0, "uniform", 4.0, (1.0, 1.3))),
    "quenched sqrt": lambda: problem(Case("quenched", 5.0, "sqrt", 4.0, (1.0, 3.0))),
    "record": record,
    "slip law": lambda: rate_and_state("slip"),
    "aging law": lambda: rate_and_state("aging"),
}


def markov(rng: np.random.Generator, size: int, rho: float = RHO) -> np.ndarray:
    """Errors of variance 1 with the correlation rho between neighbours."""
    noise = rng.standard_normal(size)
    for i in range(1, size):
        noise[i] = rho * noise[i - 1] + math.sqrt(1.0 - rho**2) * noise[i]
    return noise


def sample(exact: Problem, rng: np.random.Generator) -> Problem:
    """Problem with random errors of the data: relative ones in a table, correlated ones
    in a record."""
    if exact.correlation is not None:
        return replace(
            exact, value=exact.value + exact.sigma * markov(rng, exact.value.size)
        )
    value = exact.value * (1.0 + NOISE * rng.standard_normal(exact.value.size))
    return replace(exact, value=value, sigma=NOISE * value)


def rises(exact: Problem, sets: int, seed: int) -> Iterator[dict[str, float]]:
    """Rise of chi-square in each synthetic data set, by key: by how much its minimum
    with the parameter at its true value exceeds that with all free. An interval
    contains the truth if the rise is below its level."""
    rng = np.random.default_rng(seed)
    for _ in range(sets):
        data = sample(exact, rng)
        fits = [
            minimise(data, exact.start),
            *(minimise(data, u) for u in _starts(exact, rng)),
        ]
        held = [minimise(data, exact.start, i) for i in range(len(exact.parameters))]
        least = min([*fits, *held], key=lambda fit: fit.chi2)
        yield {
            parameter.key: minimum.chi2 - least.chi2
            for parameter, minimum in zip(exact.parameters, held, strict=True)
        }


def _starts(exact: Problem, rng: np.random.Generator) -> list[np.ndarray]:
    """Two more starts between the bounds."""
    return list(exact.low + (exact.high - exact.low) * rng.random((2, exact.low.size)))


def prior_problem() -> Problem:
    """Annealed contacts, b = 5 in the middle of the prior, which is flat within .6 in
    each variable."""
    fit = problem(Case("annealed", 5.0, "uniform", 4.0, (1.0,)))
    near = [p._replace(low=p.start - 0.6, high=p.start + 0.6) for p in fit.parameters]
    return replace(fit, parameters=near)


def below(exact: Problem, sets: int, seed: int) -> Iterator[dict[str, float]]:
    """Share of the posterior below the truth in each data set, by key; the truth comes
    from the prior."""
    rng = np.random.default_rng(seed)
    for _ in range(sets):
        truth = exact.low + (exact.high - exact.low) * rng.random(exact.low.size)
        data = replace(
            exact,
            value=exact.given(truth)
            + exact.sigma * rng.standard_normal(exact.value.size),
        )
        best = minimise(data, exact.start).u
        spread = covariance(data.jacobian(best))
        drawn = posterior.draw_posterior(data, best, spread, rng)
        shares = np.mean(drawn.points < truth, axis=0)
        yield {
            parameter.key: float(share)
            for parameter, share in zip(exact.parameters, shares, strict=True)
        }


def binomial(sets: int, share: float) -> tuple[float, float]:
    """Range of the observed share of `sets` in 999 of 1000 cases, if the true one is
    `share`."""
    low, high = stats.binom.ppf([0.5e-3, 1.0 - 0.5e-3], sets, share)
    return low / sets, high / sets


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        prog="python -m analysis.coverage", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--sets", type=int, default=40, help="data sets of each model")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=sorted(COVERED), help="a single model")
    parser.add_argument(
        "--posterior", action="store_true", help="calibration of posteriors instead"
    )
    asked = parser.parse_args()
    if asked.posterior:
        _calibration(asked.sets, asked.seed)
        return
    print("expected standard deviations of ln F0, ln v0, ln b, ln(n + 1)")
    for case in TABLE:
        deviations = expected(problem(case))
        temperatures = " and ".join(
            "T" if heat == 1.0 else f"{heat:g} T" for heat in case.heats
        )
        where = f"{case.disorder} b={case.b:g} {case.law}, {temperatures}"
        where += f", {case.decades:g} decades"
        print(f"  {where:50s}", *(f"{deviations[key]:8.3g}" for key in COLUMNS))
    for name, made in COVERED.items():
        if asked.only not in (None, name):
            continue
        every = list(rises(made(), asked.sets, asked.seed))
        print(
            f"{name}: share of {asked.sets} data sets whose interval contains the truth"
        )
        for key in every[0]:
            covered = {
                level: np.mean([rises_of[key] < rise for rises_of in every])
                for level, rise in LEVELS.items()
            }
            print(f"  {key:28s} {_said(covered, asked.sets)}")


def _said(covered: dict[str, float], sets: int) -> str:
    return ", ".join(
        "{} %: {:.1f} ({:.1f} to {:.1f} expected)".format(
            level, 100 * share, *(100 * x for x in binomial(sets, int(level) / 100))
        )
        for level, share in covered.items()
    )


def _calibration(sets: int, seed: int) -> None:
    every = []
    for shares in below(prior_problem(), sets, seed):
        every.append(shares)
        print(f"{len(every)} of {sets} data sets", file=sys.stderr)
    print(
        f"share of {sets} truths of the prior that intervals of the posterior contain, "
        f"and a test that ranks are uniform"
    )
    for key in every[0]:
        ranks = np.array([shares[key] for shares in every])
        covered = {
            level: np.mean((ranks > low) & (ranks < high))
            for level, (low, high) in posterior.SHARES.items()
        }
        print(
            f"  {key:28s} {_said(covered, sets)}; Kolmogorov-Smirnov p = "
            f"{stats.kstest(ranks, 'uniform').pvalue:.2f}"
        )


if __name__ == "__main__":
    main()
