"""What a fit leaves behind: fit.json, tables, pictures, and the run file of the best
fit."""

import json
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eqsim.fitting.estimate import DEGENERATE, different
from eqsim.fitting.fit import REJECTED, FitResult, Goodness, derived
from eqsim.fitting.posterior import Posterior
from eqsim.fitting.profiles import WIDE
from eqsim.io import storage
from eqsim.io.runfile import at, copied

_DRAWN = ("posterior.parquet", "posterior.png")
COLUMNS = ("key", "estimate", "68 %", "95 %", "status")


def summary(result: FitResult, sampled: Posterior | None = None) -> dict[str, Any]:
    """The content of fit.json."""
    keys = [one.key for one in result.problem.parameters]
    return {
        "title": result.file.title,
        "parameters": {
            one.key: {
                "estimate": one.estimate,
                "transform": one.transform,
                "sd": one.sd,
                "interval_68": list(one.intervals["68"]),
                "interval_95": list(one.intervals["95"]),
                "status": one.status,
            }
            for one in result.intervals
        },
        **result.goodness._asdict(),
        "rejected": result.rejected,
        "converged": result.converged,
        "loss": result.fit.loss,
        "measurements": result.table.value.size,
        "covariance": {"keys": keys, "matrix": result.covariance},
        "starts": [
            {"chi2": one.chi2, "converged": one.converged, "solves": one.solves, "values": _values(result, one.u)}
            for one in result.minima
        ],
        "minima": [{"chi2": one.chi2, "values": _values(result, one.u)} for one in different(list(result.minima))],
        "eigenvalues": [
            {"value": rung.eigenvalue, "ratio": rung.ratio, "sd": rung.sd, "direction": rung.name,
             "components": rung.components}
            for rung in result.ladder
        ],
        "derived": derived(result),
        "correlation": None if result.correlation is None else result.correlation._asdict(),
        "noise_floor": result.floor,
        **({} if sampled is None else {"posterior": _posterior(sampled)}),
        "warnings": list(result.warnings),
        "seed": result.seed,
        "data_sha256": result.table.sha256,
        "versions": storage.versions(),
    }  # fmt: skip


def _posterior(sampled: Posterior) -> dict[str, Any]:
    intervals = sampled.intervals
    return {
        "parameters": {
            key: {
                "median": one["median"],
                "interval_68": one["68"],
                "interval_95": one["95"],
            }
            for key, one in intervals.items()
        },
        "walkers": sampled.walkers,
        "steps": sampled.steps,
        "autocorrelation": sampled.autocorrelation,
        "effective_draws": sampled.effective,
        "acceptance": sampled.acceptance,
        "converged": sampled.converged,
    }


def _values(result: FitResult, u: Any) -> dict[str, float]:
    return {
        one.key: float(one.value(x))
        for one, x in zip(result.problem.parameters, u, strict=True)
    }


def fitted(result: FitResult) -> dict[str, Any]:
    """Columns of fitted.parquet, one measurement a row: where it was made, what was
    found, and the fit."""
    table, problem = result.table, result.problem
    rows = [table.rows[row] for row in table.row]
    columns: dict[str, Any] = {
        name: np.array([dict(row.changes).get(name, math.nan) for row in rows])
        for name in table.names
    }
    if result.fit.temperature is not None:
        columns["temperature"] = table.temperatures[table.row]
    if table.time is not None:
        columns["time"] = table.time
    if len(table.sets) > 1:
        columns["set"] = [row.set for row in rows]
    _, predicted, error = problem.solved(result.best.u)
    r = (problem.value - predicted) / table.sigma
    return {
        **columns, "observable": list(table.observable), "measured": problem.value, "sigma": table.sigma,
        "fitted": predicted, "solver_error": error, "residual": r, "whitened": problem.white(r),
    }  # fmt: skip


def profiles(result: FitResult) -> dict[str, Any]:
    """Columns of profiles.parquet: the key that is held, chi-square over its least
    value, and all values there."""
    parameters = result.problem.parameters
    held: list[str] = []
    rises, points = [], []
    for one in parameters:
        for side in result.profiles[one.key]:
            held += [one.key] * side.rise.size
            rises.append(side.rise)
            points.append(side.points)
    every = np.concatenate(points)
    values = {
        one.key: np.asarray(one.value(every[:, i])) for i, one in enumerate(parameters)
    }
    return {"key": held, "rise": np.concatenate(rises), **values}


def write(result: FitResult, out: Path, title: str = "") -> list[str]:
    """Write a results folder; the names of its files. Draws from the posterior of
    another fit are removed."""
    from eqsim.fitting import pictures
    from eqsim.io.style import saved

    file, title = result.file, result.file.title or title
    origin = storage.provenance(
        "fit", file.settings, file.text, result.seed, file.folder
    )
    files = {
        "fit.json": storage.to_json(summary(result)).encode(),
        "fitted.parquet": storage.parquet(fitted(result), origin),
        "profiles.parquet": storage.parquet(profiles(result), origin),
        "run.toml": run_toml(result, out).encode(),
        "fit.png": saved(pictures.fit_figure(result, title)),
        "profiles.png": saved(pictures.profiles_figure(result, title)),
        "identifiability.png": saved(pictures.identifiability_figure(result, title)),
    }
    storage.publish(out, files)
    for name in _DRAWN:
        (out / name).unlink(missing_ok=True)
    return list(files)


def write_posterior(
    result: FitResult, sampled: Posterior, out: Path, title: str = ""
) -> list[str]:
    """Add draws from the posterior to a results folder; the names of the new files."""
    from eqsim.fitting import pictures
    from eqsim.io.style import saved

    origin = storage.provenance(
        "fit", result.file.settings, result.file.text, result.seed, result.folder
    )
    picture = pictures.posterior_figure(sampled, result.file.title or title)
    content = dict(
        zip(
            _DRAWN,
            (storage.parquet(sampled.columns, origin), saved(picture)),
            strict=True,
        )
    )
    storage.publish(
        out, {**content, "fit.json": storage.to_json(summary(result, sampled)).encode()}
    )
    return list(content)


def run_toml(result: FitResult, out: Path) -> str:
    """The run file of the best fit, at the middle velocity of the data unless the run
    file has one."""
    values = result.values
    changes = {
        key: value for key, value in values.items() if not key.startswith("fit.")
    }
    file = at(result.file, changes)
    if (
        file["drive.velocity"] is None
        and file["drive.programme"] is None
        and file["drive.file"] is None
    ):
        given = [
            dict(result.table.rows[row].changes).get("drive.velocity")
            for row in result.table.row
        ]
        known = [v for v in given if v is not None]
        if known:
            file = at(
                file,
                {"drive.velocity": float(f"{math.exp(np.mean(np.log(known))):.6g}")},
            )
    data = copied(file.given)
    for section in ("thresholds", "drive"):
        name = data.get(section, {}).get("file")
        if name is not None:
            data[section]["file"] = os.path.relpath(
                (result.folder / name).absolute(), out.absolute()
            )
    lines = [
        f"# best fit of {len(result.table.value)} measurements; data SHA-256 {result.table.sha256}"
    ]
    lines += [
        f"# {key} = {value!r}"
        for key, value in values.items()
        if key.startswith("fit.")
    ]
    return "\n".join([*lines, *to_toml(data)]) + "\n"


def to_toml(data: dict[str, Any]) -> Iterator[str]:
    """Lines of a run file with this content: values, then sections."""
    for key, value in data.items():
        if not isinstance(value, dict):
            yield f"{key} = {_text(value)}"
    for key, value in data.items():
        if isinstance(value, dict) and value:
            yield f"\n[{key}]"
            yield from (
                f"{_name(name)} = {_text(part)}" for name, part in value.items()
            )


def _name(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return (
            "{ "
            + ", ".join(f"{_name(key)} = {_text(part)}" for key, part in value.items())
            + " }"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_text, value)) + "]"
    return repr(value)  # also inf


def rows(result: FitResult) -> Iterator[tuple[str, ...]]:
    """What is printed of each key."""
    for one in result.intervals:
        yield (
            one.key,
            f"{one.estimate:.4g}",
            _range(*one.intervals["68"]),
            _range(*one.intervals["95"]),
            one.status,
        )


def _range(low: float | None, high: float | None) -> str:
    """An interval as text; None where it is open."""
    digits = 3
    if (
        low is not None and high is not None and high > low
    ):  # so many that the width shows
        digits = min(
            max(
                digits,
                2 - math.floor(math.log10((high - low) / max(abs(low), abs(high)))),
            ),
            12,
        )
    left = "open" if low is None else f"{low:.{digits}g}"
    right = "open" if high is None else f"{high:.{digits}g}"
    return f"{left} to {right}"


def remarks(result: FitResult) -> Iterator[str]:
    """What needs to be said besides: how good the fit is, what else is determined, and
    what is not."""
    yield quality("this model", result.goodness)
    if not result.converged:
        yield "NO START CONVERGED: these are no estimates"
    elif result.rejected:
        yield f"REJECTED: p < {REJECTED:g}; values and intervals are those of a model that does not describe the data"
    if result.correlation is not None:
        tau, effective = result.correlation
        said = f"correlation time {tau:.3g} (whitened)" if tau else "not correlated"
        yield f"errors of {result.table.value.size} points: {said}, worth {effective:.0f} independent ones"
    minima = different(list(result.minima))
    if len(minima) > 1:
        found = ", ".join(f"{one.chi2:.4g}" for one in minima[:5])
        yield f"{len(minima)} minima among {len(result.minima)} starts, chi-square {found}"
    best = result.ladder[0]
    yield f"best determined: {best.name}, to {best.sd:.2g}"
    for rung in result.ladder:
        if rung.ratio < DEGENERATE:
            yield f"not separated (eigenvalue ratio {rung.ratio:.1e}): {rung.name}"
        elif rung.sd > WIDE:
            yield f"known to no better than a factor {math.exp(min(rung.sd, 50.0)):.3g}: {rung.name}"
    unsure = [one.key for one in result.intervals if one.status != "determined"]
    if (
        any(key.startswith("thermal.") for key in unsure)
        and len({row.heat for row in result.table.rows}) == 1
    ):
        yield "these are data of one temperature: a second one tells most about heat and thresholds (eqsim design)"
    if not result.rejected and unsure:
        yield "predictions within the range of the data are good all the same; beyond it they are not"
    for name, value in derived(result).items():
        yield f"{name} = {value:.4g}"
    yield from result.warnings


def drawn(sampled: Posterior) -> Iterator[str]:
    """What draws from the posterior say."""
    long = f"{sampled.steps} steps, {sampled.steps / sampled.autocorrelation:.0f} autocorrelation times"
    if not sampled.converged:
        yield f"posterior: NOT CONVERGED, {long}: no intervals are quoted"
        return
    yield f"posterior, flat in each key's variable between its bounds where it has no prior ({long}, worth"
    yield f"{sampled.effective:.0f} independent draws: the 2.5 % beyond an end are known to {100 * sampled.doubt:.1f}):"
    for key, one in sampled.intervals.items():
        yield f"  {key}: median {one['median']:.4g}, 68 % {_range(*one['68'])}, 95 % {_range(*one['95'])}"


def quality(name: str, good: Goodness) -> str:
    """A line about how well a model describes the data."""
    p = "no p without degrees of freedom" if good.p is None else f"p = {good.p:.2g}"
    aicc = "" if good.aicc is None else f", AICc {good.aicc:.2f}"
    return f"{name}: chi-square {good.chi2:.2f} of {good.dof} degrees of freedom, {p}{aicc}, BIC {good.bic:.2f}"
