"""The published master equation solved by a third party, py-pde.

Contacts that have not broken since the fresh start stay together at x = X and carry the
weight E_PT(X); all others have a density q(x; X) with dq/dX = -dq/dx - P_T q (Q5a,
temper4) and enter at x = 0 at the rate Gamma at which contacts break (Q5aG, R = delta).
Rates and E_PT are the closed forms nt03 and nt08-nt11 (k = omega = x_* = 1, n = 1,
soft).
"""

import math

import numpy as np
import pde
from scipy.special import erf

TOP = 5.0  # a fraction E_PT(5) < 4e-10 of the contacts gets farther
V, END, POINTS = 0.1, 12.0, 25
C_0 = 4 / (3 * math.sqrt(math.pi))


class Paper(pde.PDEBase):
    """q(x; X), with X in the place of time."""

    def __init__(self, b, grid):
        super().__init__()
        self.b = b
        self.breaking = pde.ScalarField(grid, self.P_T(grid.axes_coords[0]))

    def P_T(self, u):
        h = (1 + (1 + self.b) * u**2) / (1 + self.b) ** 2 * np.exp(-(u**2))  # nt08
        return 2 * u**3 / (1 + u**2) + h / V  # nt03, temper4

    def E_PT(self, u):
        S_0 = (1 + self.b / 3) / (C_0 * V * (1 + self.b) ** 2)  # nt10
        S_1 = C_0 / 2 * (1 + self.b) / (1 + self.b / 3)  # nt11
        return (
            (1 + u**2)
            * np.exp(-(u**2))
            * np.exp(-S_0 * (erf(u) - S_1 * u * np.exp(-(u**2))))
        )

    def evolution_rate(self, state, t=0):
        lost = self.breaking * state
        gamma = self.P_T(t) * self.E_PT(t) + lost.integral
        slope = state.gradient(
            {"x-": {"value": gamma}, "x+": {"curvature": 0}}, backend="scipy"
        )[0]
        return -slope - lost


def friction(b, cells):
    """F(X) at the points, on a grid of `cells`; Runge-Kutta steps of half a cell, so
    that one grid refines both."""
    grid = pde.CartesianGrid([[0, TOP]], cells)
    equation, storage = Paper(b, grid), pde.MemoryStorage()
    equation.solve(
        pde.ScalarField(grid, 0.0),
        t_range=END,
        dt=0.5 * TOP / cells,
        solver="runge-kutta",
        backend="numpy",
        tracker=[storage.tracker(END / (POINTS - 1))],
    )
    X, q = np.array(storage.times), np.array(storage.data)
    return X, X * equation.E_PT(X) + q @ grid.axes_coords[0] * TOP / cells
