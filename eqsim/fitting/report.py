"""Files of a fit: fit.json, tables, pictures, and the run file of the best fit; and the
lines that are printed about it."""

import json
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eqsim.fitting import pictures
from eqsim.fitting.data import MeasuredAt
from eqsim.fitting.estimate import DEGENERATE, different
from eqsim.fitting.fit import REJECTED, FitResult, Goodness, Prepared
from eqsim.fitting.model import velocity_of
from eqsim.fitting.posterior import Posterior
from eqsim.fitting.profiles import UNSURE, WIDE
from eqsim.io import storage
from eqsim.io.content import copied
from eqsim.io.runfile import at
from eqsim.plots.style import saved

DATA_COLUMNS = ("", "points", "from", "to")
KEY_COLUMNS = ("key", "estimate", "68 %", "95 %", "status")
_PICTURES = {
    "fit.png": pictures.fit_figure,
    "profiles.png": pictures.profiles_figure,
    "identifiability.png": pictures.identifiability_figure,
}
# Files that come after the estimates.
_LATER = ("profiles.parquet", *_PICTURES, "posterior.parquet", "posterior.png")


def summary(result: FitResult, sampled: Posterior | None = None) -> dict[str, Any]:
    """The content of fit.json."""
    values = result.problem.values
    parameters = {}
    for interval in result.intervals:
        known = interval._asdict()
        ends = {f"interval_{name}": x for name, x in known.pop("intervals").items()}
        parameters[known.pop("key")] = {**known, **ends}
    starts, minima = (
        [{**minimum._asdict(), "values": values(minimum.u)} for minimum in several]
        for several in (result.minima, different(result.minima))
    )
    content = {
        "title": result.file.title,
        "parameters": parameters,
        **result.goodness._asdict(),
        "chi2_as_given": result.chi2_as_given,
        "rejected": result.rejected,
        "converged": result.converged,
        "loss": result.fit.loss,
        "measurements": result.table.value.size,
        "read": result.table.said,
        "covariance": {"keys": result.problem.keys, "matrix": result.covariance},
        "starts": [_pick(x, "chi2", "converged", "solves", "values") for x in starts],
        "minima": [_pick(x, "chi2", "values") for x in minima],
        "eigenvalues": [
            {
                "value": rung.eigenvalue,
                "direction": rung.name,
                **_pick(rung._asdict(), "sd_of_name", "ratio", "sd", "components"),
            }
            for rung in result.ladder
        ],
        "derived": result.derived,
        "correlation": result.correlation and result.correlation._asdict(),
        "noise_floor": result.floor,
        "warnings": result.warnings,
        "seed": result.seed,
        "data_sha256": result.table.sha256,
        "versions": storage.versions(),
    }
    return content if sampled is None else {**content, "posterior": sampled.summary()}


def _pick(given: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: given[name] for name in names}


def fitted(result: FitResult) -> dict[str, Any]:
    """Columns of fitted.parquet, one measurement a row: its conditions, its value, and
    that of the fit."""
    table, problem = result.table, result.problem
    known = [dict(one.changes) for one in table.conditions]
    columns: dict[str, Any] = {
        name: np.array([changes.get(name, math.nan) for changes in known])
        for name in table.names
    }
    if result.fit.temperature is not None:
        columns["temperature"] = np.array([one.kelvin for one in table.conditions])
    if table.time is not None:
        columns["time"] = table.time
    sets = [one.set for one in table.conditions]
    if len({*sets}) > 1:
        columns["set"] = sets
    best = problem.solved(result.best.u)
    r = (problem.value - best.predicted) / table.sigma
    return {
        **columns,
        "observable": list(table.observable),
        "measured": table.value,
        "sigma": table.sigma,
        "fitted": best.predicted + result.fixed,
        "solver_error": best.error,
        "residual": r,
        "whitened": problem.white(r),
    }


def profiles(result: FitResult) -> dict[str, Any]:
    """Columns of profiles.parquet: the key that is held, the rise of chi-square above its
    least value, and the values of all keys there."""
    sides = [(key, side) for key, pair in result.profiles.items() for side in pair]
    points = np.concatenate([side.points for _, side in sides])
    parameters = zip(result.problem.parameters, points.T, strict=True)
    return {
        "key": [key for key, side in sides for _ in side.rise],
        "rise": np.concatenate([side.rise for _, side in sides]),
        **{one.key: np.asarray(one.value(column)) for one, column in parameters},
    }


def _fit_origin(result: FitResult) -> dict[str, Any]:
    file = result.file
    return storage.provenance("fit", file.settings, file.text, result.seed, file.folder)


def write(
    result: FitResult, out: Path, title: str = "", *, final: bool = True
) -> list[str]:
    """Write a results folder, and return the names of its files: of a fit that is not
    `final`, as profiles are to come, the estimates alone. Later files are those of
    another fit, and removed."""
    origin, title = _fit_origin(result), result.file.title or title
    files = {
        "fit.json": storage.to_json(summary(result)).encode(),
        "fitted.parquet": storage.parquet(fitted(result), origin),
    }
    if final:
        files["profiles.parquet"] = storage.parquet(profiles(result), origin)
    files["run.toml"] = run_toml(result, out).encode()
    for name, draw in _PICTURES.items() if final else ():
        files[name] = saved(draw(result, title))
    storage.publish(out, files)
    for name in _LATER:
        if name not in files:
            (out / name).unlink(missing_ok=True)
    return list(files)


def write_posterior(
    result: FitResult, sampled: Posterior, out: Path, title: str = ""
) -> list[str]:
    """Add draws from the posterior to a results folder, and return the names of the new
    files."""
    figure = pictures.posterior_figure(sampled, result.file.title or title)
    files = {
        "posterior.parquet": storage.parquet(sampled.columns, _fit_origin(result)),
        "posterior.png": saved(figure),
    }
    content = storage.to_json(summary(result, sampled)).encode()
    storage.publish(out, {**files, "fit.json": content})
    return list(files)


def run_toml(result: FitResult, out: Path) -> str:
    """The run file of the best fit, at the middle velocity of the data unless the run
    file has one."""
    table, file = result.table, at(result.file, result.changes)
    names = ("velocity", "programme", "file")
    if all(file[f"drive.{name}"] is None for name in names):
        given = map(velocity_of, table.conditions)
        known = [v for v in given if v is not None]
        if known:
            middle = float(f"{math.exp(np.mean(np.log(known))):.6g}")
            file = at(file, {"drive.velocity": middle})
    data = copied(file.given)
    sections = [data.get("drive", {}), data.get("thresholds", {})]
    sections += [kind.get("thresholds", {}) for kind in data.get("population", [])]
    for section in sections:
        if "file" in section:
            path = (file.folder / section["file"]).absolute()
            section["file"] = os.path.relpath(path, out.absolute())
    count, digest = len(table.value), table.sha256
    lines = [f"# best fit of {count} measurements; data SHA-256 {digest}"]
    others = {key: x for key, x in result.values.items() if key not in result.changes}
    lines += [f"# {key} = {value!r}" for key, value in others.items()]
    return "\n".join([*lines, *to_toml(data)]) + "\n"


def to_toml(data: dict[str, Any]) -> Iterator[str]:
    """Lines of a run file with this content: values, then sections."""
    sections = {key: value for key, value in data.items() if isinstance(value, dict)}
    for key, value in data.items():
        if key not in sections:
            yield f"{key} = {_toml(value)}"
    for key, section in sections.items():
        if section:
            yield f"\n[{key}]"
            yield from _pairs(section)


def _pairs(section: dict[str, Any]) -> Iterator[str]:
    for key, value in section.items():
        name = key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)
        yield f"{name} = {_toml(value)}"


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(_pairs(value)) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)  # also inf, which JSON lacks
    return json.dumps(value, ensure_ascii=False)


def understood(prepared: Prepared) -> Iterator[tuple[str, ...]]:
    """Cells of `DATA_COLUMNS`: what was read of a file of measurements."""
    table, lines = prepared.table, dict.fromkeys(prepared.table.conditions)
    known = [dict(one.changes) for one in lines]
    columns = {name: [x[name] for x in known if name in x] for name in table.names}
    if table.time is not None:
        columns["time"] = list(table.time)
    elif prepared.fit.temperature is not None:
        columns[prepared.fit.temperature] = [one.kelvin for one in lines]
    for name in dict.fromkeys(table.observable):
        here = np.array(table.observable) == name
        shown = "force" if table.time is not None else name
        columns |= {shown: table.value[here], f"{shown}, error": table.sigma[here]}
    for name, values in columns.items():
        if len(values):
            yield name, str(len(values)), f"{min(values):.6g}", f"{max(values):.6g}"


def write_check(prepared: Prepared, out: Path, title: str) -> str:
    """Draw what was read into a folder, and return the name of the picture."""
    figure = pictures.data_figure(prepared, title)
    storage.publish(out, {"data.png": saved(figure)})
    return "data.png"


def rows(result: FitResult) -> Iterator[tuple[str, ...]]:
    """Cells of `KEY_COLUMNS` for each key."""
    for one in result.intervals:
        known = one.intervals
        ends = [_range(*known[x]) if x in known else "" for x in ("68", "95")]
        yield one.key, f"{one.estimate:.4g}", *ends, one.status


def _range(low: float | None, high: float | None) -> str:
    """An interval as text, with so many digits that its width shows; an end that is None
    is open."""
    digits = 3
    if low is not None and high is not None and high > low:
        narrow = math.log10((high - low) / max(abs(low), abs(high)))
        digits = min(max(digits, 2 - math.floor(narrow)), 12)
    left, right = ("open" if x is None else f"{x:.{digits}g}" for x in (low, high))
    return f"{left} to {right}"


def remarks(result: FitResult) -> Iterator[str]:
    """Lines on the quality of the fit, on what else it determines, and what not."""
    yield quality("this model", result.goodness)
    if not result.converged:
        yield "NO START CONVERGED: these are no estimates"
    elif result.rejected:
        yield (
            f"REJECTED: p < {REJECTED:g}; values and intervals are those of a model "
            "that does not describe the data"
        )
    if result.table.time is not None:
        yield f"data: {'; '.join(result.table.said)}"
    yield from _correlated(result)
    minima, count = different(result.minima), len(result.minima)
    if len(minima) > 1:
        values = ", ".join(f"{minimum.chi2:.4g}" for minimum in minima[:5])
        yield f"{len(minima)} minima among {count} starts, chi-square {values}"
    best = result.ladder[0]
    yield f"best determined: {best.name}, to {100.0 * best.sd_of_name:.2g} %"
    for rung in result.ladder:
        if rung.ratio < DEGENERATE:
            yield f"not separated (eigenvalue ratio {rung.ratio:.1e}): {rung.name}"
        elif rung.sd > WIDE:
            factor = math.exp(min(rung.sd_of_name, 50.0))
            yield f"known to no better than a factor {factor:.3g}: {rung.name}"
    unsure = [one.key for one in result.intervals if one.status in UNSURE]
    heat = ("thermal.kT", "thermal.attempt_frequency")
    thermal = result.table.time is None and any(key.endswith(heat) for key in unsure)
    if thermal and len({_temperature(one) for one in result.table.conditions}) == 1:
        yield (
            "these are data of one temperature: a second one tells most about heat and "
            "thresholds (eqsim design)"
        )
    if not result.rejected and unsure:
        yield (
            "predictions within the range of the data are good all the same; beyond it "
            "they are not"
        )
    for name, value in result.derived.items():
        yield f"{name} = {value:.4g}"
    yield from result.warnings


def _temperature(row: MeasuredAt) -> tuple[Any, ...]:
    """Temperature and keys of heat that a row of a table gives, to tell rows apart."""
    return (row.heat, *(pair for pair in row.changes if "thermal." in pair[0]))


def _correlated(result: FitResult) -> Iterator[str]:
    """A line on the correlation of a record's errors."""
    if result.correlation is not None:
        tau, effective = result.correlation
        said = f"correlation time {tau:.3g} (whitened)" if tau else "not correlated"
        size = result.table.value.size
        yield f"errors of {size} points: {said}, worth {effective:.0f} independent ones"


def drawn(sampled: Posterior) -> Iterator[str]:
    """Lines on draws from the posterior."""
    times = sampled.steps / sampled.autocorrelation
    long = f"{sampled.steps} steps, {times:.0f} autocorrelation times"
    if not sampled.converged:
        yield f"posterior: NOT CONVERGED, {long}: no intervals are quoted"
        return
    yield (
        "posterior, flat in each key's variable between its bounds where it has no "
        f"prior ({long}, worth"
    )
    yield (
        f"{sampled.effective:.0f} independent draws; of the 2.5 % beyond an end the "
        f"error is {100 * sampled.doubt:.1f} %):"
    )
    for key, known in sampled.intervals.items():
        inner, outer = _range(*known["68"]), _range(*known["95"])
        yield f"  {key}: median {known['median']:.4g}, 68 % {inner}, 95 % {outer}"


def quality(name: str, good: Goodness) -> str:
    """A line about how well a model describes the data."""
    p = "no p without degrees of freedom" if good.p is None else f"p = {good.p:.2g}"
    aicc = "" if good.aicc is None else f", AICc {good.aicc:.2f}"
    fit = f"chi-square {good.chi2:.2f} of {good.dof} degrees of freedom"
    return f"{name}: {fit}, {p}{aicc}, BIC {good.bic:.2f}"


def summaries(models: Mapping[str, FitResult]) -> dict[str, Any]:
    """The content of rate-and-state.json: several models of one record, by name."""
    return {name: summary(one) for name, one in models.items()}


def model_rows(models: Mapping[str, FitResult]) -> Iterator[tuple[str, ...]]:
    """Cells of a model's name and `KEY_COLUMNS`, for each key of several models."""
    for name, one in models.items():
        yield from ((name, *cells) for cells in rows(one))


def model_remarks(models: Mapping[str, FitResult]) -> Iterator[str]:
    """Lines on the quality of several models of one record: with its errors as given,
    which compare, and each with the correlation of its own residuals."""
    for name, one in models.items():
        good = one.goodness
        given = f"chi-square {one.chi2_as_given:.1f} of {good.dof} with errors as given"
        whitened = (
            "" if one.problem.correlation is None else f", {good.chi2:.1f} whitened"
        )
        p = "" if good.p is None else f", p = {good.p:.2g}"
        said = "NO START CONVERGED" if not one.converged else "REJECTED"
        verdict = f": {said}" if one.rejected or not one.converged else ""
        yield f"{name}: {given}{whitened}{p}{verdict}"
        yield from (f"{name}: {line}" for line in (*_correlated(one), *one.warnings))


def write_compared(models: Mapping[str, FitResult], out: Path, title: str) -> list[str]:
    """Write JSON, predictions and a picture of several models of one record to a folder,
    and return the names of the files."""
    first = next(iter(models.values()))
    columns = {name: fitted(first)[name] for name in ("time", "measured", "sigma")}
    for name, one in models.items():
        both = fitted(one)
        columns |= {f"{name}: {x}": both[x] for x in ("fitted", "residual")}
    figure = pictures.compared_figure(models, title)
    files = {
        "rate-and-state.json": storage.to_json(summaries(models)).encode(),
        "rate-and-state.parquet": storage.parquet(columns, _fit_origin(first)),
        "rate-and-state.png": saved(figure),
    }
    storage.publish(out, files)
    return list(files)
