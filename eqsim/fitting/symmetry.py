"""Symmetries, which steady data can never tell: changes of free keys that leave every
prediction as it is, known by name (derived).

A symmetry scales keys by powers of a factor. Those of all steady friction are two:
lengths x_*, at the same velocity and kT, so that times are ~ x_*, k ~ 1/x_*^2, and N ~
x_*; and energies k, kT and eta, with N ~ 1/k. The powers of a key follow from its
dimension. What is measured besides friction (a length, the variance of the force, which
reads N) has a power, too, and a symmetry must leave it. A symmetry is there if a
combination of these scalings moves free keys only; a key that is 0 stays 0.
"""

import math
from collections.abc import Iterator

import numpy as np
from scipy import linalg

from eqsim import catalogue
from eqsim.fitting.section import Parameter
from eqsim.io.parameters import parameters
from eqsim.io.runfile import RunFile
from eqsim.laws.aging import RULES
from eqsim.laws.barrier import BARRIERS

# Powers of the factor by which the two symmetries, of lengths and of energies, scale
# what is no key of a run file: N k ("fit.scale") and what is measured.
MEASURED_POWERS = {
    "fit.scale": (-1, 0),
    "break_stretch": (1, 0),
    "peak_X": (1, 0),
    "record": (1, 0),
    "force_std": (1, -1),
}
# b below which it has no effect on annealed contacts.
_HOT = 0.3
# b above which only omega/b has an effect on them.
_COLD = 1e3
# Keys that scale a law of thresholds; the others change its shape.
_SIZES = ("thresholds.x_star", "thresholds.high")
# Keys of the drag of a detached contact.
_DRAGS = ("viscosity.eta", "viscosity.force")
# Observables that begin with contacts all pinned, or change in time.
_FROM_FRESH = {"record", "peak_ratio", "peak_X"}
# Observables for which the limits of b are not taken to hold.
_UNSEEN = {"force_std", "peak_ratio", "peak_X"}


def refused(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> list[str]:
    """Reasons why the data cannot determine free keys, a line for each exact symmetry
    between them; empty if none is known.

    Parameters
    ----------
    file : RunFile
    free : list of Parameter
    scaled : bool
        True if the scale of force is free.
    measured : set of str
        Observables, or "record".
    """
    asked = file, free, scaled, measured
    return [*_scalings(*asked), *_limits(*asked)]


def _scalings(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> Iterator[str]:
    values = {k: v for k, v in parameters(file).items() if isinstance(v, float)}
    if file["thresholds.law"] == "table":
        values["thresholds.x_star"] = 1.0  # its length is known
    rule = file["aging.rule"]
    taken = RULES[rule].keys if rule != "none" else ()
    unused = (key for key in values if key.startswith("aging."))
    values |= {key: 0.0 for key in unused if key.partition(".")[2] not in taken}
    moving = {one.key for one in free} | ({"fit.scale"} if scaled else set())
    if file["thresholds.law"] == "none":
        values.pop("thresholds.x_star", None)  # nothing depends on it
    if not file["thermal.kT"] and not any(k.endswith("thermal.kT") for k in moving):
        values["thermal.attempt_frequency"] = 0.0
    effective = (key for key, value in values.items() if value and math.isfinite(value))
    held = [key for key in ("fit.scale", *effective) if key not in moving]
    seen = sorted(measured & MEASURED_POWERS.keys())
    if "force_std" in seen and not scaled:  # N is `contacts.count`, known
        held.append("fit.scale")
        seen.remove("force_std")
    rows = np.array([powers_of(file, name) for name in (*held, *seen)], float)
    for combination in linalg.null_space(rows.reshape(-1, 2), rcond=1e-9).T:
        powers = {key: combination @ powers_of(file, key) for key in sorted(moving)}
        powers = {key: power for key, power in powers.items() if abs(power) > 1e-9}
        if not powers:
            continue
        least = math.copysign(
            min(map(abs, powers.values())), next(iter(powers.values()))
        )
        said = ", ".join(f"{key} ~ l^{p / least:+.3g}" for key, p in powers.items())
        cure = "kT known"
        if abs(combination[0]) > 1e-9:
            cure = "a length (peak_X, break_stretch)"
            cure += " or the variance of the force (force_std)"
        cure = f"fix one of these keys, or measure {cure}"
        yield f"{said} leaves every prediction as it is; {cure}"


def powers_of(file: RunFile, name: str) -> tuple[int, int]:
    """Powers of the factor by which the symmetries of lengths and of energies scale a
    key, or what is measured. The drive stays as it is."""
    if name.startswith("population."):
        name = name.split(".", 2)[2]
        name = "contacts.stiffness" if name == "stiffness" else name
    entry = catalogue.KEYS.get(name)
    if entry is None:
        return MEASURED_POWERS.get(name, (0, 0))
    fraction = name.startswith("newborn.") and file["newborn.of"] == "threshold"
    if fraction or name.startswith("drive."):
        return 0, 0
    length, time, force = entry.dimension
    return length + time - force, force


def _limits(
    file: RunFile, free: list[Parameter], scaled: bool, measured: set[str]
) -> Iterator[str]:
    by_key, law = {one.key: one for one in free}, file["thresholds.law"]
    bond = BARRIERS[file["thermal.barrier"]].by_force
    heats = [k for k in (*parameters(file), *by_key) if k.endswith("thermal.kT")]
    cold = not (bond or any(file[key] or key in by_key for key in heats))
    rule, annealed = file["aging.rule"], file["disorder"] == "annealed"
    if cold and "thermal.attempt_frequency" in by_key:
        yield "thermal.attempt_frequency: has no effect at thermal.kT = 0"
    idle = {"drive.distance", "drive.stage.tolerance"}
    if measured.isdisjoint(_FROM_FRESH):
        idle |= {"delay.shape", "delay.sigma"}
    for key in by_key:
        if key in idle:
            yield f"{key}: has no effect on a steady observable"
    shapes = (key for key in by_key if key.startswith("thresholds."))
    widths = [key for key in shapes if key not in _SIZES]
    if cold and widths and measured <= {"friction", "pinned"}:
        drags = [k for k in _DRAGS if file[k] and k not in by_key]
        delayed = file["delay.time"] != 0 or "delay.time" in by_key
        level = [key for key in _SIZES if key in by_key]
        # the drag of detached contacts, if it is known, tells how many there are
        if scaled and not (drags and delayed):
            level.append("fit.scale")
        absorbs = bool(level)
        if rule == "none":
            timed = file["delay.time"] == 0 or "delay.time" in by_key
            absorbs &= timed or len(level) == 2
        else:
            absorbs &= annealed and "aging.rate" in by_key
        if absorbs:
            level += [key for key in ("delay.time", "aging.rate") if key in by_key]
            cure = (
                f"absorbed in {', '.join(level)}; measure a temperature or peak_ratio"
            )
            yield f"{widths[0]}: at thermal.kT = 0 it is {cure}"
    known = law in ("gamma", "delta") and file["thermal.barrier"] == "soft"
    known &= not file["population"]
    if annealed and known and not measured & _UNSEEN:
        yield from _regimes(file, by_key)


def _regimes(file: RunFile, by_key: dict[str, Parameter]) -> Iterator[str]:
    """Reasons of annealed contacts whose b, anywhere within the bounds, is so small that
    it has no effect, or so large that only omega/b has one."""
    values = parameters(file)

    def range_of(key: str) -> tuple[float, float]:
        if key in by_key:
            one = by_key[key]
            return float(one.value(one.low)), float(one.value(one.high))
        given = 1.0 if values[key] is None else values[key]
        return given, given

    k = range_of("contacts.stiffness")
    x, kT = range_of("thresholds.x_star"), range_of("thermal.kT")
    moves = [key for key in ("thermal.kT", "contacts.stiffness") if key in by_key]
    if not moves or kT[0] <= 0:
        return
    least, greatest = k[0] * x[0] ** 2 / (2.0 * kT[1]), k[1] * x[1] ** 2 / (2.0 * kT[0])
    if greatest < _HOT:
        said = f"is below {_HOT} within the bounds, where it has no effect; lower kT"
        yield f"{moves[0]}: b = k x_*^2/(2 kT) {said}"
    if least > _COLD and "thermal.attempt_frequency" in by_key:
        said = f"is above {_COLD:g} within the bounds, where only v_* ~ omega x_*/b"
        keys = f"{moves[0]} and thermal.attempt_frequency"
        yield f"{keys}: b = k x_*^2/(2 kT) {said} has an effect; fix one of them"
