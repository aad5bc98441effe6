"""Rival C: the same work in C by hand (`tuned.c`), compiled when it is needed, as a
measure of what this machine can do.

Every contact draws from the generator that eqsim uses, lives are exact, and the results
are those that eqsim records: mean force, pinned fraction and variance over contacts at
every grid point, and sums of batches over the second half.
"""

import ctypes
import functools
import math
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy import special

from analysis.benchmarks.cases import VELOCITY, Case

BATCHES = 64
DEGREE = 9
FLAGS = (
    "-O3",
    "-march=native",
    "-fopenmp",
    "-fno-math-errno",
    "-Wno-psabi",
    "-shared",
    "-fPIC",
)
COMPILER = shutil.which("gcc")

_AREA, _PINNED, _BREAKS, _STRETCH = range(4)
Array = NDArray[np.float64]


class _Law(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("breaking", "general")),
        *((name, ctypes.c_double) for name in ("b", "w", "delay")),
        ("key", ctypes.c_uint32 * 2),
    )


class _Job(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("contacts", "points", "batches")),
        ("distance", ctypes.c_double),
    )


class Run(NamedTuple):
    """<F>/(N k) with its standard error, and <N_c>/N, on the grid; friction over the
    second half with its error."""

    force: Array
    force_stderr: Array
    pinned: Array
    friction: float
    stderr: float
    lives: int


def compiler_version() -> str:
    """The compiler's first line about itself; empty where there is none."""
    if not COMPILER:
        return ""
    return subprocess.run(
        [COMPILER, "--version"], check=True, capture_output=True, text=True
    ).stdout.splitlines()[0]


@functools.cache
def library(*flags: str) -> ctypes.CDLL:
    """The compiled C. Raises CalledProcessError, with what the compiler said, if it
    cannot be compiled."""
    folder = Path(__file__).parent
    with tempfile.TemporaryDirectory() as out:
        target = Path(out) / "tuned.so"
        command = [
            str(COMPILER),
            *FLAGS,
            *flags,
            str(folder / "tuned.c"),
            "-o",
            str(target),
            "-lm",
        ]
        subprocess.run(command, check=True, capture_output=True, text=True)
        compiled = ctypes.CDLL(str(target))
    compiled.trajectory.restype = ctypes.c_int64
    compiled.prepare(_pointer(_erfi_inverse()))
    return compiled


@functools.cache
def available() -> bool:
    """True if there is a gcc that compiles the C."""
    try:
        return COMPILER is not None and library() is not None
    except subprocess.CalledProcessError:
        return False


def _pointer(values: Array) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)


def _erfi_inverse() -> Array:
    """z/s, s = ln(1 + erfi(z)), as polynomials in half octaves of s + 1/2 from 1/2 to
    128, shape (DEGREE + 2, 16): the middles of the cells and the coefficients from the
    highest; columns by the last four bits of the cell's number."""
    table = np.empty((DEGREE + 2, 16))
    for cell in range(16):
        low = 2.0 ** (cell // 2 - 1) * (1.0 + 0.5 * (cell % 2))
        high = 2.0 ** (cell // 2 - 1) * (1.5 + 0.5 * (cell % 2))
        middle, half = (low + high) / 2, (high - low) / 2
        series = chebyshev.chebinterpolate(  # type: ignore[type-var]
            lambda t, middle=middle, half=half: _ratio(middle + half * t - 0.5),  # type: ignore[misc]
            DEGREE,
        )
        powers = chebyshev.cheb2poly(series) / half ** np.arange(DEGREE + 1)
        table[:, (2 * 1022 + cell) % 16] = [middle, *powers[::-1]]
    return table


def _ratio(s: Array) -> Array:
    s = np.maximum(s, 1e-6)
    target = np.where(s > 40, s, np.log(np.expm1(np.minimum(s, 40))))
    z = np.where(s < 1, s * math.sqrt(math.pi) / 2, np.sqrt(s + 1))
    # Newton for ln erfi(z) = z^2 + ln(2/sqrt(pi) D(z)), whose derivative is 1/D
    for _ in range(60):
        d = special.dawsn(z)
        z = np.maximum(
            z - (z**2 + np.log(2 / math.sqrt(math.pi) * d) - target) * d, z / 4
        )
    return z / s


def _law(case: Case, seed: int) -> _Law:
    breaking = ("soft", "stiff").index(case.barrier) + 1 if case.kT else 0
    key = np.random.SeedSequence((seed, 3)).generate_state(2, np.uint32)
    words = (ctypes.c_uint32 * 2)(*key.tolist())
    return _Law(
        breaking,
        case.general,
        0.5 / case.kT if case.kT else 0.0,
        1.0 / VELOCITY,
        case.delay,
        words,
    )


def run(
    case: Case, contacts: int, distance: float, points: int, seed: int, threads: int = 1
) -> Run:
    """Force of the ensemble from a fresh start. Raises MemoryError."""
    deposits, sums = (
        np.zeros((points, 8 if case.general else 2)),
        np.zeros((BATCHES, 2, 4)),
    )
    law, job = _law(case, seed), _Job(contacts, points, BATCHES, distance)
    lives = library().trajectory(
        ctypes.byref(law),
        ctypes.byref(job),
        ctypes.c_int(threads),
        _pointer(deposits),
        _pointer(sums),
    )
    if lives < 0:
        raise MemoryError
    X, total = (
        np.linspace(0.0, distance, points),
        np.cumsum(deposits, axis=0) / contacts,
    )
    if case.general:
        count, k, k_born, k2, k2_born, k_born_2 = total[:, :6].T
    else:
        (k_born, k_born_2), count, k, k2 = total.T, np.ones(points), 1.0, 1.0
        k2_born = k_born
    force = k * X - k_born
    variance = np.maximum(k2 * X**2 - 2.0 * X * k2_born + k_born_2 - force**2, 0.0)
    area = sums[:, :, _AREA].sum(axis=1)
    elapsed = 0.5 * distance * np.diff(contacts * np.arange(BATCHES + 1) // BATCHES)
    friction = float(area.sum() / elapsed.sum())
    error = (
        float((area - friction * elapsed).std(ddof=1))
        * math.sqrt(BATCHES)
        / float(elapsed.sum())
    )
    return Run(force, np.sqrt(variance / (contacts - 1)), count, friction, error, lives)


def steady(case: Case, lives: int, seed: int, threads: int = 1) -> tuple[float, float]:
    """Steady friction by renewal-reward over plainly drawn lives, and its standard
    error."""
    sums, size = np.zeros((BATCHES, 4)), -(-lives // (128 * BATCHES)) * 128
    library().steady(
        ctypes.byref(_law(case, seed)),
        ctypes.c_int64(BATCHES),
        ctypes.c_int64(size),
        ctypes.c_int(threads),
        _pointer(sums),
    )
    work, cycle = sums[:, 0], sums[:, 1] + size * case.delay
    value = float(work.sum() / cycle.sum())
    return value, float((work - value * cycle).std(ddof=1)) * math.sqrt(
        BATCHES
    ) / float(cycle.sum())


def stripped(case: Case, upto: int, lives: int) -> int:
    """Draw the random words of lives (`upto` = 0), with thresholds and clocks (1), or
    until they break (2), and keep nothing; returns the number of lives."""
    size = -(-lives // 128) * 128
    library().stripped(
        ctypes.byref(_law(case, 1)), ctypes.c_int(upto), ctypes.c_int64(size)
    )
    return size
