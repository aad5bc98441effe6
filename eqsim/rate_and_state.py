"""Rate-and-state friction, a law of two variables beside that of contacts (Dieterich,
1979; Ruina, 1983):

    mu = mu_0 + a ln(V/V_0) + b ln(V_0 theta/D_c),

    aging law:  theta' = 1 - V theta/D_c,
    slip law:   theta' = -(V theta/D_c) ln(V theta/D_c),

behind a machine of stiffness k, mu' = k (V_load - V) - eta V', with a damping eta (the
radiation of waves; 0 by default). It is solved in ln(V/V_0) and ln(V_0 theta/D_c), in
which theta and V cannot become negative, however fast the slider slips.
"""

import math
import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import ODEintWarning, odeint

from eqsim.errors import (
    NOT_NEGATIVE,
    POSITIVE,
    InputError,
    require_choice,
    require_number,
)
from eqsim.model.drive import Programme
from eqsim.numerics.tables import Array

StateLaw = Literal["slip", "aging"]
# Error of LSODA in a step, of the logarithms and relative; that of friction is below
# 1e-10 of a and b in tests.
_TOLERANCE = 1e-10
# LSODA's steps between two times at most.
_MOST_STEPS = 1_000_000
# What `odeint` says of a solution that is complete.
_SOLVED = "Integration successful."
# ln(V/V_0) from which on V no longer counts: it would overflow.
_FASTEST = 300.0
# Relative rounding of the end of a record.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class RateAndState:
    """Rate-and-state friction and the machine that pulls.

    Raises InputError for a value out of range.

    Parameters
    ----------
    a, b : float
        Direct and evolution effect (unit of friction), a > 0, b >= 0.
    D_c : float
        Critical slip (length), > 0.
    stiffness : float
        k of the machine (unit of friction per length), > 0.
    law : str
        "slip" (Ruina) or "aging" (Dieterich).
    mu_0 : float
        Steady friction at V_0, the first velocity of the programme.
    damping : float
        eta (unit of friction per velocity), >= 0.

    Examples
    --------
    >>> law = RateAndState(a=0.01, b=0.015, D_c=10.0, stiffness=0.01, mu_0=0.6)
    >>> print(f"{law.critical_stiffness:.4f}")
    0.0005
    """

    a: float
    b: float
    D_c: float
    stiffness: float
    law: StateLaw = "slip"
    mu_0: float = 0.0
    damping: float = 0.0

    def __post_init__(self) -> None:
        for name in ("a", "D_c", "stiffness"):
            require_number(name, getattr(self, name), **POSITIVE)
        for name in ("b", "damping"):
            require_number(name, getattr(self, name), **NOT_NEGATIVE)
        require_number("mu_0", self.mu_0)
        require_choice("law", self.law, ("slip", "aging"))

    @property
    def critical_stiffness(self) -> float:
        """(b - a)/D_c, below which steady sliding is unstable without damping (Ruina,
        1983); negative if it never is. With damping the border depends on the velocity:
        (b - a - damping V)/D_c (derived)."""
        return (self.b - self.a) / self.D_c

    def friction(self, programme: Programme, times: ArrayLike) -> Array:
        """Friction while the load point follows a programme, from steady sliding at its
        `velocity` or that of its first segment on.

        Parameters
        ----------
        programme : Programme
            Velocities of the load point; a stage of its own does not count.
        times : array_like
            When (time), ascending.

        Returns
        -------
        ndarray
            What the machine measures, of the shape of `times`.

        Raises
        ------
        InputError
            If the programme begins without a velocity, goes back, is under a force or
            a normal load that changes, or has a motor or blocks, `times` are not within
            it, or too far apart for the stick-slip between them, or the slider slips
            without end.

        Examples
        --------
        >>> from eqsim import Programme, Segment
        >>> step = Programme([Segment(1.0, time=10.0), Segment(10.0, time=20.0)])
        >>> law = RateAndState(a=0.01, b=0.015, D_c=10.0, stiffness=0.01, mu_0=0.6)
        >>> print(law.friction(step, [5.0, 10.5, 30.0]).round(4))
        [0.6    0.6165 0.5885]
        """
        t = np.asarray(times, float)
        require_programme(programme, t)
        first = programme.velocity or programme.segments[0].velocity
        ends = programme.corners[0][1:]
        upto = np.searchsorted(t, ends, "right")
        upto[-1] = t.size
        state, courses, begin, done = np.zeros(2), [np.empty((0, 2))], 0.0, 0
        for segment, end, last in zip(programme.segments, ends, upto, strict=True):
            if done == t.size:
                break
            there = np.clip(t[done:last] - begin, 0.0, segment.duration)
            stop = segment.duration if last < t.size else there[-1]
            grid = np.concatenate(([0.0], there, [stop]))
            course = self._course(state, grid, first, segment.velocity)
            courses.append(course[1:-1])
            state, begin, done = course[-1], end, last
        log_v, log_theta = np.concatenate(courses).T
        drag = self.damping * first * np.expm1(log_v)
        return self.mu_0 + self.a * log_v + self.b * log_theta + drag

    def _course(self, state: Array, t: Array, first: float, load: float) -> Array:
        """ln(V/V_0) and ln(V_0 theta/D_c), shape (times, 2), from a `state` of these on,
        while the load point moves at a velocity `load`; V_0 is `first`. Raises
        InputError once V is beyond all bounds, or for too many steps."""
        a, b, k, drag = self.a, self.b, self.stiffness * first, self.damping * first
        rate, pull, aging = first / self.D_c, load / first, self.law == "aging"
        fastest = 0.0

        def slopes(state: Array, _: float) -> tuple[float, float]:
            nonlocal fastest
            log_v, log_theta = state.tolist()
            fastest = max(fastest, log_v)
            if not log_v < _FASTEST:
                return math.nan, math.nan
            v = math.exp(log_v)
            change = math.exp(-log_theta) - v if aging else -v * (log_v + log_theta)
            growth = rate * change
            return (k * (pull - v) - b * growth) / (a + drag * v), growth

        given = {"rtol": _TOLERANCE, "atol": _TOLERANCE, "mxstep": _MOST_STEPS}
        with warnings.catch_warnings():  # of too many steps
            warnings.simplefilter("ignore", ODEintWarning)
            course, how = odeint(slopes, state, t, full_output=True, **given)
        if how["message"] == _SOLVED and np.isfinite(course).all():
            return course
        if fastest < _FASTEST:
            said = f"stick-slip takes more than {_MOST_STEPS} steps between two of them"
            raise InputError(f"times: {said}; give more of them")
        said = "the slider slips without end; damping would end it"
        raise InputError(f"stiffness = {self.stiffness:g}: {said}")


def require_programme(programme: Programme, times: Array) -> None:
    """Raise InputError for a programme along which there is no rate-and-state friction,
    or times that do not ascend within it."""
    if not (programme.velocity or programme.segments[0].velocity) > 0:
        said = "begins at rest; rate-and-state friction begins in steady sliding"
        raise InputError(f"programme: {said}, so give a velocity")
    said = "rate-and-state friction is pulled forward, or held, under a constant load"
    blocks = programme.chain is not None or programme.elastic is not None
    for given, there in (("a motor", programme.motor), ("blocks", blocks)):
        if there:
            raise InputError(f"programme: has {given}; {said}")
    for index, segment in enumerate(programme.segments):
        given = ""
        if segment.forced:
            given = "a force"
        elif segment.velocity < 0:
            given = f"velocity {segment.velocity:g}"
        elif segment.load not in (None, 1.0) or segment.load_rate:
            given = "a load that changes"
        if given:
            raise InputError(f"programme.{index}: has {given}; {said}")
    end = programme.corners[0][-1]
    # NaN is not later than any time
    if times.ndim != 1 or not np.all(np.diff(times, prepend=0.0) >= 0):
        raise InputError("times: must be a list that ascends from 0 or later")
    if times.size and times[-1] > end * (1.0 + _ROUNDING):
        said = f"end at {times[-1]:g}, after the programme, which takes {end:g}"
        raise InputError(f"times: {said}")
