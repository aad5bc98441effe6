"""Kernels are compiled before workers start on all tests, in processes side by side, and not by every worker anew."""

import subprocess
import sys
from pathlib import Path

import pytest
from kernels import LAWS

from eqsim.numerics.kernel_folder import kernel_folder


def pytest_sessionstart(session):
    workers = getattr(session.config.option, "numprocesses", None)
    folder = kernel_folder()
    if not workers or folder is None or not all(Path(arg).is_dir() for arg in session.config.args):
        return
    done = Path(folder, "for-tests")
    if not done.exists():
        count = min(workers, 4)  # of processes, each of which takes some seconds more
        command, root = [sys.executable, "-m", "tests.kernels"], Path(__file__).parent.parent
        running = [subprocess.Popen([*command, *LAWS[i::count]], cwd=root) for i in range(count)]
        if not any([process.wait() for process in running]):
            done.touch()


# of these, a part of the cases of tests with many, so that the suite ends in time even on a machine half as fast as
# usual; the others run with -m verification
THINNED = {
    *("test_aging", "test_aging_engine", "test_closure", "test_flow", "test_fokker_planck", "test_langevin_programme"),
    *("test_logarithmic", "test_oracle", "test_programme", "test_programme_reference", "test_reference", "test_steady"),
    *("test_thermal", "test_stability", "test_master_edges", "test_asymptotics", "test_densities", "test_lives"),
    *("test_threshold", "test_trajectory", "test_elastic", "test_newborn", "test_newborn_reference", "test_slider"),
    *("test_velocities", "test_scatter", "test_portable", "test_properties", "test_figures"),
    *("test_convolution", "test_kinks", "test_lattice", "test_standstill", "test_variance"),
}


@pytest.hookimpl(tryfirst=True)  # before cases are chosen by their marks
def pytest_collection_modifyitems(config, items):
    """By default one in five cases of a test that has three or more, in `THINNED` modules, one in eight of six or more
    and one in twelve of twelve or more, unless asked for by name."""
    cases = {}
    if any("::" in arg for arg in config.args):
        return
    for item in items:
        if item.module.__name__ in THINNED and not any(map(item.get_closest_marker, ("long", "verification"))):
            cases.setdefault((item.module.__name__, item.originalname), []).append(item)
    for found in cases.values():
        every = next((every for every, least in ((12, 12), (8, 6), (5, 3)) if len(found) >= least), 1)
        for index, item in enumerate(found):
            if index % every:
                item.add_marker(pytest.mark.verification)
