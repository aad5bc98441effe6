"""Laws of thresholds by name: NumPy against SciPy and mpmath, draws, engine against
reference, run files, fits."""

import dataclasses
import functools
import math

import mpmath
import numpy as np
import pytest
import scipy.stats
from kernels import compiled

from eqsim import (
    Aging,
    Delay,
    Drive,
    Ensemble,
    Exponential,
    Gamma,
    InputError,
    Lognormal,
    Normal,
    Pareto,
    Programme,
    Segment,
    Thermal,
    Uniform,
    Weibull,
    fit,
    reference,
    steady,
    trajectory,
    transient,
    z_score,
)
from eqsim.io.parameters import parameters
from eqsim.io.runfile import check, load
from eqsim.laws import threshold
from eqsim.laws.named import NAMED, THRESHOLDS, threshold_parameters
from eqsim.laws.threshold import for_kernels
from eqsim.model.groups import groups
from eqsim.numerics import streams
from eqsim.numerics.streams import TRAJECTORY, key

uniforms, threshold_draw = (
    compiled(streams.uniforms),
    compiled(threshold.threshold_draw),
)
EPS = np.finfo(float).eps

# the usual, and the ends of the ranges
LAWS = [
    *(Lognormal(0.5, 2.5), Lognormal(1e-3, 2.5), Lognormal(2.0, 2.5)),
    *(Weibull(1.5, 2.5), Weibull(0.5, 2.5), Weibull(1000.0, 2.5)),
    *(Exponential(2.5), Uniform(1.0, 2.5), Uniform(0.0, 2.5), Uniform(2.4975, 2.5)),
    *(Normal(0.75, 2.5), Normal(0.0025, 2.5), Normal(2.5, 2.5), Normal(25.0, 2.5)),
    *(Pareto(5.0, 2.5), Pareto(3.05, 2.5), Pareto(1000.0, 2.5)),
]
USUAL = [
    Lognormal(0.5, 2.0),
    Weibull(1.5, 3.0),
    Exponential(0.5),
    Normal(0.6, 2.0),
    Uniform(0.5, 2.0),
    Pareto(5.0, 0.5),
]


@functools.cache
def kernel_uniforms():
    return np.array([uniforms(key(12, TRAJECTORY), i, 0, 0)[0] for i in range(50_000)])


def of_scipy(law):
    x_star = getattr(law, "x_star", None)
    return {
        "lognormal": lambda: scipy.stats.lognorm(law.sigma, scale=x_star),
        "weibull": lambda: scipy.stats.weibull_min(law.shape, scale=x_star),
        "exponential": lambda: scipy.stats.expon(scale=x_star),
        "normal": lambda: scipy.stats.truncnorm(
            -x_star / law.std, np.inf, loc=x_star, scale=law.std
        ),
        "uniform": lambda: scipy.stats.uniform(law.low, law.high - law.low),
        "pareto": lambda: scipy.stats.pareto(law.exponent, scale=x_star),
    }[law.name]()


def test_every_law_is_tested():
    assert {type(law) for law in LAWS} == {type(law) for law in USUAL} == set(NAMED)


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_against_scipy(law):
    """Density, distribution and survival, down to 1e-250. The logarithm of a narrow law
    is as large as its argument is far from the middle: its rounding is multiplied by
    1/width^2 (1e3 here, as x are multiples of 1/50)."""
    frozen, x = of_scipy(law), np.linspace(0.02, 12.0, 600)
    for side in ("pdf", "cdf", "sf"):
        with np.errstate(all="ignore"):
            exact = np.nan_to_num(getattr(frozen, side)(x))
        shown = exact > 1e-250
        np.testing.assert_allclose(
            getattr(law, side)(x)[shown], exact[shown], rtol=5e-12 / min(law.rms, 1.0)
        )
        assert np.all(getattr(law, side)(x)[~shown] < 1e-249)
    assert law.mean == pytest.approx(frozen.mean(), rel=1e-12, abs=0)
    assert law.rms == pytest.approx(math.sqrt(frozen.moment(2)), rel=1e-12, abs=0)
    assert law.support == frozen.support()
    assert np.all(law.pdf(np.array([-1.0])) == 0.0)
    assert (float(law.sf(0.0)), float(law.cdf(0.0)), float(law.sf(-1.0))) == (
        1.0,
        0.0,
        1.0,
    )


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_quantile_inverts_the_survival(law):
    """From e = 2^-54 to 500, up to the rounding of xi (d ln J_c = -xi P_c/J_c d ln xi)
    and of e."""
    e = np.geomspace(2.0**-54, 500.0, 600)
    xi = law.inverse_survival(e)
    assert np.all(np.diff(xi) >= 0)
    told = law.sf(xi) > 1e3 * EPS * xi * law.pdf(xi)  # not where a law ends
    e, xi = e[told], xi[told]
    assert e[-1] > (20.0 if law.support[1] < np.inf else 499.0)
    small = e < 0.7
    found = np.append(-np.log1p(-law.cdf(xi[small])), -np.log(law.sf(xi[~small])))
    assert np.all(np.abs(found - e) < 40 * EPS * (e + xi * law.pdf(xi) / law.sf(xi)))


@pytest.mark.parametrize(
    ("law", "survival"),
    [
        (
            Lognormal(0.5, 0.7),
            lambda x: (
                mpmath.erfc(mpmath.log(x / mpmath.mpf(0.7)) / mpmath.sqrt(2) / 0.5) / 2
            ),
        ),
        (Weibull(1.5, 0.7), lambda x: mpmath.exp(-((x / mpmath.mpf(0.7)) ** 1.5))),
        (
            Normal(0.35, 0.7),
            lambda x: (
                mpmath.ncdf((0.7 - mpmath.mpf(x)) / mpmath.mpf(0.35))
                / mpmath.ncdf(0.7 / mpmath.mpf(0.35))
            ),
        ),
    ],
    ids=["lognormal", "weibull", "normal"],
)
def test_against_forty_digits(law, survival):
    """Survival, density, moments and the far ends: thresholds that 1e-17 and all but
    1e-17 of the contacts exceed."""
    with mpmath.workdps(40):
        pieces = [0, 0.3, 0.7, 1.5, 4, 20, 400]
        mean, square = (
            mpmath.quad(lambda x, p=p: p * x ** (p - 1) * survival(x), pieces)
            for p in (1, 2)
        )
        assert law.mean == pytest.approx(float(mean), rel=1e-13, abs=0)
        assert law.rms == pytest.approx(float(mpmath.sqrt(square)), rel=1e-13, abs=0)
        for x in (0.05, 0.4, 1.3, 3.0):
            at = mpmath.mpf(x)
            assert float(law.sf(x)) == pytest.approx(
                float(survival(at)), rel=1e-13, abs=0
            )
            assert float(law.cdf(x)) == pytest.approx(
                float(1 - survival(at)), rel=1e-13, abs=0
            )
            assert float(law.pdf(x)) == pytest.approx(
                float(-mpmath.diff(survival, at)), rel=1e-12, abs=0
            )
        for e in (1e-17, 1e-6, 39.0, 400.0):
            xi = mpmath.mpf(float(law.inverse_survival(e)))
            log_slope = xi * float(law.pdf(float(xi))) / float(survival(xi))
            found = -mpmath.log(survival(xi))
            assert abs(float(found - e)) < 40 * EPS * (e + log_slope)


def test_weibull_of_shape_2_is_a_gamma_law():
    weibull, gamma, x = Weibull(2.0, 1.5), Gamma(0.0, 1.5), np.linspace(0.1, 5.0, 50)
    for side in ("pdf", "cdf", "sf"):
        np.testing.assert_allclose(
            getattr(weibull, side)(x), getattr(gamma, side)(x), rtol=1e-12
        )
    assert weibull.rms == pytest.approx(gamma.rms, rel=1e-14, abs=0)


def drawn(law, u):
    lowered = for_kernels(law)
    return law.scale * np.array([threshold_draw(lowered, value) for value in u])


@pytest.mark.parametrize("law", LAWS, ids=repr)
def test_draws_are_the_quantile(law):
    """Where all but 1e-12 of the draws are, within the error of a cubic in a cell of
    1/4 for exponentials of e, of 2e-7 for a lognormal law over six decades, else of
    1e-9; and what tables cost averages, which `steady` quotes."""
    rng = np.random.default_rng(4)
    u = np.concatenate(
        (2.0 ** rng.uniform(-40, 0, 500), 1.0 - 2.0 ** rng.uniform(-40, -1, 500))
    )
    wide = law == Lognormal(2.0, 2.5)
    cubic = (0.25 / law.exponent) ** 4 / 384 if isinstance(law, Pareto) else 0.0
    np.testing.assert_allclose(
        drawn(law, u),
        law.inverse_survival(-np.log(u)),
        rtol=1.1 * cubic + (2e-7 if wide else 1e-9),
    )
    assert law.drawn_to < (1e-6 if wide or law == Pareto(3.05, 2.5) else 1e-9)


@pytest.mark.parametrize("law", USUAL, ids=repr)
def test_draws(law):
    """Kolmogorov and Smirnov over 5e4 draws, p > 1e-5 (false alarm of the test 6e-5);
    thresholds 3 % larger fail."""
    sample, cdf = drawn(law, kernel_uniforms()), of_scipy(law).cdf
    assert scipy.stats.kstest(sample, cdf).pvalue > 1e-5
    assert scipy.stats.kstest(1.03 * sample, cdf).pvalue < 1e-5


# -----------------------------------------------------------------------------------------
# engine against reference

CASES = [
    ("quenched", "sqrt", 0.1, Delay(1.0), 0.1),
    ("annealed", "sqrt", 0.1, Delay(0.5, "exponential"), 0.01),
    ("quenched", "uniform", 0.0, Delay(), 1.0),
    ("annealed", "uniform", 0.03, Delay(), 1e-3),
    ("quenched", "uniform", 0.3, Delay(), 1e-3),
]


def interface(law, disorder, stiffness_law, kT, delay, velocity):
    u = law.scale
    thermal = Thermal(kT * u * u, 1.0)
    return Ensemble(
        law, thermal, delay, stiffness_law=stiffness_law, disorder=disorder
    ), Drive(velocity * u)


def scores(law, case, other=None):
    """z of friction and stretch at breaking, of independent clocks."""
    ensemble, drive = interface(law, *case)
    found, exact = (
        steady(ensemble, drive, rel_error=1e-3, seed=3),
        reference(interface(other or law, *case)[0], drive),
    )
    return [
        z_score(
            getattr(found, name),
            getattr(exact, name).value,
            getattr(exact, name).stderr,
        )
        for name in ("friction", "break_stretch")
    ]


def judged(z):
    """p of chi-square, on both sides."""
    p = scipy.stats.chi2.cdf(np.sum(np.square(z)), len(z))
    return 2 * min(p, 1 - p)


def test_engine_against_reference():
    """Each law at one point of `CASES`, both ensembles: all |z| < 4.5 and the
    frictions' chi-square p > 1e-4 (false alarm 3e-4). Negative control: a reference
    with a shape 1 % off."""
    z = np.array([scores(law, CASES[i % 3]) for i, law in enumerate(USUAL)])
    assert np.abs(z).max() < 4.5
    assert judged(z[:, 0]) > 1e-4
    wrong = [
        scores(law, CASES[0], off)[0]
        for law, off in (
            (USUAL[0], Lognormal(0.505, 2.0)),
            (USUAL[1], Weibull(1.515, 3.0)),
        )
    ]
    assert np.abs(wrong).min() > 4.5


@pytest.mark.verification
@pytest.mark.parametrize("case", CASES, ids=str)
def test_engine_against_reference_everywhere(case):
    """All laws, ends of ranges included: all |z| < 4.5 and chi-square p > 1e-4 (false
    alarm 4e-4 a case)."""
    z = np.array([scores(law, case) for law in (*USUAL, *LAWS)])
    assert np.abs(z).max() < 4.5
    assert judged(z[:, 0]) > 1e-4


@pytest.mark.parametrize("law", [USUAL[0], USUAL[3]], ids=repr)
def test_transients(law):
    """Force from a fresh start at 20 instants that are some lives apart: |z| < 4.5
    (false alarm 2e-4 for both laws)."""
    ensemble, _ = interface(law, "quenched", "sqrt", 0.1, Delay(0.3), 0.1)
    ensemble, drive = (
        dataclasses.replace(ensemble, count=20_000),
        Drive(0.1 * law.scale, 20.0 * law.scale),
    )
    found, exact = (
        trajectory(ensemble, drive, points=21),
        transient(ensemble, drive, 21),
    )
    z = (found.force - exact.force)[1:] / np.hypot(
        found.force_stderr, exact.force_error
    )[1:]
    assert np.abs(z).max() < 4.5
    other = transient(
        dataclasses.replace(
            ensemble, thresholds=dataclasses.replace(law, x_star=1.05 * law.x_star)
        ),
        drive,
        21,
    )
    assert np.abs((found.force - other.force)[1:] / found.force_stderr[1:]).max() > 4.5


@pytest.mark.verification
@pytest.mark.parametrize("law", USUAL[:1], ids=repr)
def test_logarithmic_aging_and_programmes(law):
    """Thresholds of any law may grow: z of the steady friction, and of the force after
    a hold (false alarm 3e-5)."""
    u = law.scale
    aging = Aging("logarithmic", beta=0.1, cutoff_time=1.0)
    ensemble = Ensemble(
        law, Thermal(0.05 * u * u), aging=aging, count=20_000, stiffness_law="uniform"
    )
    found, exact = steady(ensemble, Drive(0.1 * u)), reference(ensemble, Drive(0.1 * u))
    assert (
        abs(z_score(found.friction, exact.friction.value, exact.friction.stderr)) < 4.5
    )
    young = reference(dataclasses.replace(ensemble, aging=Aging()), Drive(0.1 * u))
    assert (
        abs(z_score(found.friction, young.friction.value, young.friction.stderr)) > 4.5
    )
    programme = Programme([Segment(0.1 * u, distance=3 * u), Segment(0.0, time=30.0)])
    run, mean = (
        trajectory(ensemble, programme, points=21),
        transient(ensemble, programme, 21),
    )
    assert abs(run.force[-1] - mean.force[-1]) < 4.5 * math.hypot(
        run.force_stderr[-1], mean.force_error[-1]
    )


def test_other_aging_is_of_the_gamma_law():
    for rule in ("langevin", "flow"):
        with pytest.raises(
            InputError, match=f'^rule = "{rule}": needs thresholds of law "gamma"$'
        ):
            Ensemble(Lognormal(0.5), aging=Aging(rule, 0.1, 2.0))


# ---------------------------------------------------------------------------------------------------
# run files, fits


def test_run_files_know_every_law(tmp_path):
    """By name, with the parameters of its dataclass, each of which is a key of the
    section."""
    for law in USUAL:
        given = {
            field.name: getattr(law, field.name) for field in dataclasses.fields(law)
        }
        file = check(
            {"thresholds": {"law": law.name, **given}, "drive": {"velocity": 0.1}}
        )
        assert file.ensemble.thresholds == law
        known = parameters(file)
        assert {
            key.removeprefix("thresholds."): value
            for key, value in known.items()
            if value is not None
        }.items() >= given.items()
    short = check({"thresholds": {"law": "weibull", "shape": 2.0}})
    assert short.ensemble.thresholds == Weibull(2.0, 1.0)
    assert parameters(short)["thresholds.x_star"] == 1.0
    assert threshold_parameters("table") == {}
    assert list(THRESHOLDS) == [
        "gamma",
        "delta",
        "none",
        "lognormal",
        "weibull",
        "exponential",
        "normal",
        "uniform",
        "pareto",
    ]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"law": "lognormal"}, 'thresholds.sigma: is required with law = "lognormal"'),
        (
            {"law": "lognormal", "sigma": 0.5, "n": 1.0},
            'thresholds.n = 1.0: not allowed with law = "lognormal"',
        ),
        (
            {"law": "gamma", "sigma": 0.5},
            'thresholds.sigma = 0.5: not allowed with law = "gamma"',
        ),
        (
            {"law": "lognormal", "sigma": 3.0},
            "thresholds.sigma = 3.0: must be a finite number >= 0.001 and <= 2",
        ),
        (
            {"law": "weibull", "shape": 0.1},
            "thresholds.shape = 0.1: must be a finite number >= 0.5 and <= 1000",
        ),
        (
            {"law": "weibull", "shape": 1.0, "x_star": -1.0},
            "thresholds.x_star = -1.0: must be a finite number > 0",
        ),
        (
            {"law": "pareto", "exponent": 3.0},
            "thresholds.exponent = 3.0: must be a finite number >= 3.05",
        ),
        (
            {"law": "uniform", "low": 0.1},
            'thresholds.high: is required with law = "uniform"',
        ),
        (
            {"law": "uniform", "low": 2.0, "high": 1.0},
            "thresholds.low = 2.0: must be a finite number >= 0 and <= 0.999",
        ),
        (
            {"law": "normal", "std": 20.0},
            "thresholds.std = 20.0: must be a finite number >= 0.001 and <= 10",
        ),
        (
            {"law": "exponential", "file": "x.csv"},
            "thresholds.file = 'x.csv': not allowed with law = \"exponential\"",
        ),
        (
            {"law": "log-normal"},
            'thresholds.law = \'log-normal\': must be "gamma", "delta", "none", "lognormal"',
        ),
        (
            {"law": "lognormal", "sgima": 0.5},
            'thresholds.sgima: unknown key; did you mean "sigma"?',
        ),
    ],
    ids=str,
)
def test_bad_run_files(tmp_path, given, message):
    with pytest.raises(InputError) as caught:
        _ = check({"thresholds": given}).ensemble
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def heavy_tails(law):
    """Answer to whether a law has heavy tails, None without one."""
    found = groups(Ensemble(law, Thermal(0.1)), Drive(0.1))
    return {group.name: group.value for group in found}.get("heavy tails")


def test_which_laws_have_heavy_tails():
    """Gamma laws have, at any temperature if k_i grows with the threshold, and bounded
    ones have not; nothing is said of others, where b does not decide."""
    assert heavy_tails(Gamma()) == "yes"
    said = {law.name: heavy_tails(law) for law in USUAL}
    assert {name: x for name, x in said.items() if x} == {"uniform": "no"}


RUN = """
disorder = "annealed"
[contacts]
stiffness_law = "uniform"
[thresholds]
law = "lognormal"
sigma = 0.4
[thermal]
kT = 0.1
[fit]
data = "data.csv"
scale = {{ start = 1.0, bounds = [0.01, 100.0] }}
noise = {{ relative = 0.01 }}
[fit.free]
{free}
"""


def test_fits(tmp_path):
    """Sigma from friction with errors of 1 %: within 5 of its own standard errors
    (false alarm 6e-7 if these are right), and within 10 %."""
    truth = Ensemble(
        Lognormal(0.5), Thermal(0.1), disorder="annealed", stiffness_law="uniform"
    )
    rng, rows = np.random.default_rng(5), ["drive.velocity,friction"]
    for v in np.geomspace(1e-3, 10.0, 12):
        friction = reference(truth, Drive(v)).friction.value
        rows.append(f"{v},{3.0 * friction * (1 + 0.01 * rng.standard_normal())}")
    (tmp_path / "data.csv").write_text("\n".join(rows))
    (tmp_path / "run.toml").write_text(
        RUN.format(free='"thresholds.sigma" = { bounds = [0.1, 1.5] }')
    )
    found = fit(load(tmp_path / "run.toml"), tmp_path, starts=1)
    (sigma,) = (one for one in found.intervals if one.key == "thresholds.sigma")
    low, high = sigma.intervals["68"]
    assert abs(math.log(sigma.estimate / 0.5)) < min(
        0.1, 5 * 0.5 * math.log(high / low)
    )


def test_fits_refuse_what_cannot_be_known(tmp_path):
    (tmp_path / "data.csv").write_text(
        "drive.velocity,friction\n0.1,1.0\n0.2,1.1\n0.3,1.2\n"
    )
    (tmp_path / "run.toml").write_text(
        RUN.format(free='"thresholds.n" = { bounds = [0.1, 1.5] }')
    )
    with pytest.raises(
        InputError,
        match=r'^fit\.free\.thresholds\.n: has no effect with thresholds\.law = "lognormal"',
    ):
        fit(load(tmp_path / "run.toml"), tmp_path)
    (tmp_path / "run.toml").write_text(
        RUN.format(free='"thresholds.sigma" = { bounds = [0.1, 1.5] }').replace(
            "kT = 0.1", "kT = 0.0"
        )
    )
    with pytest.raises(
        InputError,
        match=r"^fit\.free: thresholds\.sigma: at thermal\.kT = 0 it is absorbed in fit\.scale",
    ):
        fit(load(tmp_path / "run.toml"), tmp_path)
