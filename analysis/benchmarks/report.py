"""The figures as a table and as a picture."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import pandas as pd
from rich.table import Table

from analysis.benchmarks.cases import Sizes
from analysis.benchmarks.stepped import STEP

COLUMNS = {  # heading: column and format
    "eqsim, s": ("seconds", "{:.3g}"),
    "10⁶ lives/s": ("lives_per_second", "{:.3g}"),
    "rel. error": ("rel_error", "{:.1e}"),
    "A": ("A", "{:.3g}"),
    "B": ("B", "{:.3g}"),
    "B per life": ("B_per_life", "{:.3g}"),
    "{threads} threads": ("threads", "{:.2f}"),
    "bias of A": ("A_bias", "{:+.2%}"),
    "± ": ("A_bias_stderr", "{:.2%}"),
    "z of B": ("B_z", "{:+.1f}"),
}


def notes(sizes: Sizes) -> str:
    """How to read the figures."""
    return (
        "A and B: seconds of the rival per second of eqsim, both on one thread; medians over "
        f"{sizes.repeats} interleaved turns.\n"
        f"A: NumPy script, steps of {STEP} x_*; measured on {sizes.stepped_contacts} contacts over "
        f"{sizes.stepped_distance:g} x_*, scaled by contact-steps\n   (x{sizes.contact_steps:g}). Its bias is that of "
        "its friction against eqsim's.\n"
        "B: plain scalar numba kernel of the same algorithm, mean force only. Steady: plain Monte Carlo, measured on "
        f"{sizes.lives:.1e} lives,\n   scaled by error^-2 to the asked error. z: its friction against eqsim's, in "
        "standard errors."
    )
