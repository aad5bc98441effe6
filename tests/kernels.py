"""Routines that only kernels call, as functions that tests can call: compiled, as in a kernel."""

import numba


def compiled(routine):
    return numba.njit(lambda *arguments: routine(*arguments), error_model="numpy")
