"""Routines that only kernels call, as functions that tests can call: compiled, as in a kernel."""

import functools

import numba


@functools.cache
def compiled(routine):
    def call(*arguments):
        return routine(*arguments)

    call.__name__ = routine.__name__  # pytest names cases after it
    return numba.njit(call, error_model="numpy")
