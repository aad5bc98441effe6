"""What steady data can never tell: changes of free keys that leave every prediction as
it is, known by name (derived).

A symmetry scales keys by powers of a factor. Those of all steady friction are two:
lengths x_*, with k ~ 1/x_*^2, N ~ x_* and rates of displacement ~ 1/x_*; and energies
k, kT and eta, with N ~ 1/k. What is measured besides friction (a length, the variance
of the force, which reads N) has a power, too, and a symmetry must leave it. A symmetry
is there if a combination of these scalings moves free keys only; a key that is 0 stays
0.
"""

import math
from collections.abc import Iterator

import numpy as np

from eqsim.errors import InputError
from eqsim.fitting.section import Parameter
from eqsim.io.runfile import RunFile, parameters
from eqsim.numerics.tables import Array

# powers of the factor by which each symmetry scales keys ("fit.scale" is N k), and of
# what is measured
_LENGTH = {
    "thresholds.x_star": 1, "contacts.stiffness": -2, "fit.scale": -1, "thermal.attempt_frequency": -1,
    "delay.time": 1, "aging.rate": 1, "aging.x_star_final": 1, "aging.cutoff_time": 1, "viscosity.eta": -1,
    "drive.velocity": 0, "break_stretch": 1, "peak_X": 1, "force_std": 1,
    "record": 1, **dict.fromkeys(("thresholds.std", "thresholds.low", "thresholds.high"), 1),
}  # fmt: skip
_ENERGY = {
    "contacts.stiffness": 1,
    "thermal.kT": 1,
    "viscosity.eta": 1,
    "force_std": -1,
}
_HOT, _COLD = (
    0.3,
    1e3,
)  # b below which it does not matter to annealed contacts, and above which only omega/b does
_SIZES = (
    "thresholds.x_star",
    "thresholds.high",
)  # of a law; its other parameters change the shape
_UNSEEN = {"force_std", "peak_ratio", "peak_X"}


def refused(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> list[str]:
    """Why the data cannot decide, one line for each exact symmetry between free keys;
    empty if there is none known.

    Parameters
    ----------
    file : RunFile
    free : list of Parameter
    scaled : bool
        Whether the scale of force is free.
    measured : set of str
        Observables, or "record".
    """
    return [
        *_scalings(file, free, scaled, measured),
        *_limits(file, free, scaled, measured),
    ]


def _scalings(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> Iterator[str]:
    values = {
        key: value
        for key, value in parameters(file).items()
        if isinstance(value, float)
    }
    if file["thresholds.law"] == "table":
        values["thresholds.x_star"] = 1.0  # its length is known
    aging = file["aging.rule"]
    if aging == "none":
        values |= {
            "aging.rate": 0.0,
            "aging.x_star_final": 0.0,
            "aging.cutoff_time": 0.0,
        }
    elif aging == "logarithmic":
        values |= {"aging.rate": 0.0, "aging.x_star_final": 0.0}
    moving = {one.key for one in free} | ({"fit.scale"} if scaled else set())
    fixed_kT = not file["thermal.kT"] and "thermal.kT" not in moving
    if fixed_kT:
        values["thermal.attempt_frequency"] = 0.0
    held = [
        "fit.scale",
        *(key for key, value in values.items() if value and math.isfinite(value)),
    ]
    held = [key for key in held if key not in moving]
    seen = sorted(measured & {"break_stretch", "peak_X", "force_std", "record"})
    if "force_std" in seen and not scaled:  # N is `contacts.count`, known
        held, seen = (
            [*held, "fit.scale"],
            [name for name in seen if name != "force_std"],
        )
    rows = [
        [part.get(name, 0) for name in (*dict.fromkeys(held), *seen)]
        for part in (_LENGTH, _ENERGY)
    ]
    for combination in _null(np.array(rows, float).reshape(2, -1)):
        powers = {
            key: combination[0] * _LENGTH.get(key, 0)
            + combination[1] * _ENERGY.get(key, 0)
            for key in sorted(moving)
        }
        powers = {key: power for key, power in powers.items() if abs(power) > 1e-9}
        if powers:
            least = min(map(abs, powers.values()))
            said = ", ".join(
                f"{key} ~ l^{power / least:+.3g}" for key, power in powers.items()
            )
            length = abs(combination[0]) > 1e-9
            cure = (
                "a length (peak_X, break_stretch) or the variance of the force (force_std)"
                if length
                else "kT known"
            )
            yield f"{said} leaves every prediction as it is; fix one of these keys, or measure {cure}"


def _null(rows: Array) -> list[Array]:
    """Combinations of the two scalings that leave every column, shape (2, columns), as
    it is."""
    if not rows.shape[1] or not rows.any():
        return [np.array([1.0, 0.0]), np.array([0.0, 1.0])]
    u, singular, _ = np.linalg.svd(rows)
    rank = int((singular > 1e-9 * singular[0]).sum())
    return [u[:, i] for i in range(rank, 2)]


def _limits(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> Iterator[str]:
    by_key, law = {one.key: one for one in free}, file["thresholds.law"]
    cold = not file["thermal.kT"] and "thermal.kT" not in by_key
    for key in ("thermal.attempt_frequency",) if cold else ():
        if key in by_key:
            yield f"{key}: has no effect at thermal.kT = 0"
    rule, annealed = file["aging.rule"], file["disorder"] == "annealed"
    for key in by_key:
        if key in ("drive.distance", "drive.stage.tolerance"):
            yield f"{key}: has no effect on a steady observable"
    transient = measured & {"peak_ratio", "peak_X"}
    widths = [
        key for key in by_key if key.startswith("thresholds.") and key not in _SIZES
    ]
    if cold and widths and not transient and measured <= {"friction", "pinned"}:
        others = [
            key
            for key in (*_SIZES, "fit.scale")
            if key in by_key or (key == "fit.scale" and scaled)
        ]
        level = bool(others)
        if rule == "none":
            level &= (
                file["delay.time"] == 0 or len(others) == 2 or "delay.time" in by_key
            )
        elif annealed:
            level &= "aging.rate" in by_key
        else:
            level = False
        if level:
            absorbed = ", ".join(
                [
                    *others,
                    *(key for key in ("delay.time", "aging.rate") if key in by_key),
                ]
            )
            yield f"{widths[0]}: at thermal.kT = 0 it is absorbed in {absorbed}; measure a temperature or peak_ratio"
    if (
        annealed
        and law in ("gamma", "delta")
        and file["thermal.barrier"] == "soft"
        and not measured & _UNSEEN
    ):
        yield from _regimes(file, by_key)


def _regimes(file: RunFile, by_key: dict[str, Parameter]) -> Iterator[str]:
    """Annealed contacts whose b is nowhere between the bounds one that matters."""
    values = parameters(file)

    def range_of(key: str) -> tuple[float, float]:
        one = by_key.get(key)
        given = values[key] if values[key] is not None else 1.0
        return (
            (float(one.value(one.low)), float(one.value(one.high)))
            if one
            else (given, given)
        )

    k, x, kT = (
        range_of(key)
        for key in ("contacts.stiffness", "thresholds.x_star", "thermal.kT")
    )
    moves = [key for key in ("thermal.kT", "contacts.stiffness") if key in by_key]
    if not moves or kT[0] <= 0:
        return
    least, greatest = k[0] * x[0] ** 2 / (2.0 * kT[1]), k[1] * x[1] ** 2 / (2.0 * kT[0])
    if greatest < _HOT:
        yield f"{moves[0]}: b = k x_*^2/(2 kT) is below {_HOT} within the bounds, where it has no effect; lower kT"
    if least > _COLD and "thermal.attempt_frequency" in by_key:
        yield (
            f"{moves[0]} and thermal.attempt_frequency: b = k x_*^2/(2 kT) is above {_COLD:g} within the bounds, where "
            "only v_* ~ omega x_*/b has an effect; fix one of them"
        )


def check(reasons: list[str], allowed: bool) -> list[str]:
    """The reasons as warnings if that is `allowed`. Raises InputError otherwise."""
    if reasons and not allowed:
        raise InputError(
            f"fit.free: {reasons[0]} (--allow-degenerate fits all the same)"
        )
    return reasons
