"""Kernels: which machine code a call takes, and what processes that start at once,
kills, damaged files and full disks do to the files in which it is kept.

Each test but those of `_kind` runs processes that compile a function of one line.
"""

import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from typing import NamedTuple

import numba
import numpy as np
import pytest
from filelock import FileLock

from eqsim.numerics.compiled import _kind

TINY = """
from eqsim.numerics.compiled import kernel

@kernel
def double(x):
    return 2.0 * x

@kernel
def size(x):
    return x.size
"""
CALL = """
from numba.core import event
from tiny import double
with event.install_recorder("numba:compile") as compiled:
    found = double(1.5)
print(found, len(compiled.buffer) // 2)
"""  # an event begins and ends
STEADY = """
from numba.core import event
from eqsim import Drive, Ensemble, steady
count = []
class Listener(event.Listener):
    def on_start(self, happened):
        name = getattr(getattr(happened.data.get("dispatcher"), "py_func", None), "__name__", "")
        count.extend([name] * (name in ("fill_lives", "invert")))
    def on_end(self, happened):
        pass
event.register("numba:compile", Listener())
print(repr(steady(Ensemble(), Drive(velocity=0.1), rel_error=1e-2).friction.value), *count)
"""
COMPILED, LOADED = "3.0 1", "3.0 0"


class Tiny:
    """Processes that have the module `tiny` and an empty folder for its kernels."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "tiny.py").write_text(TINY)
        path = os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", "")))
        self.environment = os.environ | {
            "PYTHONPATH": path,
            "NUMBA_CACHE_DIR": str(folder / "kernels"),
        }

    def start(self, code=CALL, **options):
        return subprocess.Popen(
            [sys.executable, "-c", code],
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            **options,
        )

    def run(self, code=CALL, **options):
        process = self.start(code, **options)
        output, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
        assert errors == ""
        return output.strip()

    def files(self, pattern):
        return list((self.folder / "kernels").rglob(pattern))


@pytest.fixture
def tiny(tmp_path):
    return Tiny(tmp_path)


def test_what_was_compiled_is_loaded(tiny):
    assert tiny.run() == COMPILED
    assert tiny.run() == LOADED


def test_damaged_files_are_compiled_again(tiny):
    """Files of which a disk has kept nothing, a part, or a part and zeros, or which it
    has lost. A new kernel of the same function is one of a new process."""
    code = """
from pathlib import Path
from numba.core import event
from eqsim.numerics.compiled import kernel
from eqsim.numerics.kernel_folder import kernel_folder
from tiny import double

def compilations():
    with event.install_recorder("numba:compile") as compiled:
        assert kernel(double.__wrapped__)(1.5) == 3.0
    return len(compiled.buffer) // 2

assert (compilations(), compilations()) == (1, 0)
for pattern in ("*.nbi", "*.nbc", "*.sha256"):
    (path,) = Path(kernel_folder()).rglob(pattern)
    for kept, zeros in ((0, 0), (0.5, 0), (0.5, 0.5), (0.9, 0.1)):
        content = path.read_bytes()
        size = len(content)
        path.write_bytes(content[: int(kept * size)] + bytes(int(zeros * size)))
        assert (compilations(), compilations()) == (1, 0), (pattern, kept, zeros)
    path.unlink()
    assert (compilations(), compilations()) == (1, 0), pattern
"""
    tiny.run(code)


@pytest.mark.long
def test_processes_that_start_at_once(tiny):
    """One of them compiles, and the others load."""
    every = [tiny.start() for _ in range(4)]
    said = sorted(process.communicate(timeout=120)[0].strip() for process in every)
    assert said == [LOADED, LOADED, LOADED, COMPILED]


@pytest.mark.long
def test_processes_that_start_at_once_compile_each_kernel_once(tiny):
    every = [tiny.start(STEADY) for _ in range(4)]
    said = [process.communicate(timeout=300)[0].split() for process in every]
    assert len({numbers[0] for numbers in said}) == 1
    assert sorted(name for words in said for name in words[1:]) == [
        "fill_lives",
        "invert",
    ]


def test_threads_that_start_at_once(tiny):
    code = """
from concurrent.futures import ThreadPoolExecutor
from numba.core import event
from tiny import double
with event.install_recorder("numba:compile") as compiled, ThreadPoolExecutor(4) as pool:
    found = set(pool.map(double, [1.5] * 4))
print(*found, len(compiled.buffer) // 2)
"""
    assert tiny.run(code) == COMPILED


@pytest.mark.verification
def test_killed_at_every_step_of_compiling(tiny):
    """A process that is killed as it makes, writes, renames or removes a file of the
    cache leaves nothing that another takes: of the next two, both find the value, and
    the second one loads. The parent has imported all; each child finds what was saved,
    and no checksum."""
    code = """
import os, signal, sys
from numba.core import event
from pathlib import Path
import numpy as np
from eqsim.numerics.kernel_folder import kernel_folder
from tiny import double, size

def call():
    with event.install_recorder("numba:compile") as compiled:
        found = double(1.5)
    assert found == 3.0
    return len(compiled.buffer) // 2

def killed_at(step):
    left = [step]
    def look(name, arguments):
        changes = name in ("os.mkdir", "os.rename", "os.remove", "os.rmdir")
        changes |= name == "open" and bool(arguments[2] & (os.O_WRONLY | os.O_RDWR))
        if changes and "double" in str(arguments[0]):
            left[0] -= 1
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(look)
    return call()

def child(function, *arguments):
    process = os.fork()
    if not process:
        status = 100
        try:
            status = function(*arguments)
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])

size(np.ones(3))
folder = Path(kernel_folder())
for step in range(1, 100):
    status = child(killed_at, step)
    if status != -signal.SIGKILL:
        break
    assert child(call) in (0, 1), step
    assert child(call) == 0, step
    (note,) = folder.glob("*double*.sha256")
    note.unlink()
assert (step > 10, status) == (True, 1), (step, status)
"""
    tiny.run(code)


@pytest.mark.parametrize(
    "most", [0, pytest.param(4096, marks=pytest.mark.verification)]
)
def test_a_full_disk(tiny, most):
    """It takes nothing at all, or the probe of the folder and not the machine code."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    code = CALL.replace("len(compiled.buffer) // 2", "bool(compiled.buffer)")
    code = f"import sys; sys.dont_write_bytecode = True\n{code}"
    assert tiny.run(code, preexec_fn=limit) == "3.0 True"
    assert not tiny.files("*.nbc")
    assert tiny.run() == COMPILED
    assert tiny.run() == LOADED


@contextmanager
def another_process_compiles(tiny):
    """A lock on the folder of `double`, which was not saved whole."""
    tiny.run()
    (note,) = tiny.files("*.sha256")
    note.unlink()
    with FileLock(note.with_suffix(".lock")):
        yield


def one_that_waits(tiny, patience):
    """A process that calls `double`, once it waits for the lock."""
    code = f"""
import threading, time
from eqsim.numerics import kernel_folder
kernel_folder._PATIENCE = {patience}
def tell():
    while kernel_folder.compiling_since() is None:
        time.sleep(0.01)
    print("waits", flush=True)
threading.Thread(target=tell, daemon=True).start()
{CALL}
print(kernel_folder.compiling_since())
"""
    process = tiny.start(code)
    assert process.stdout.readline() == "waits\n"
    return process


@pytest.mark.long
def test_a_process_waits_for_the_one_that_compiles(tiny):
    with another_process_compiles(tiny):
        process = one_that_waits(tiny, patience=100.0)
        time.sleep(1.0)
        assert process.poll() is None
    assert process.communicate(timeout=60)[0].splitlines() == [COMPILED, "None"]
    assert tiny.run() == LOADED


@pytest.mark.long
def test_a_process_whose_patience_ends_compiles_for_itself(tiny):
    with another_process_compiles(tiny):
        process = one_that_waits(tiny, patience=0.2)
        said = process.communicate(timeout=60)[0]
    assert said.splitlines() == [COMPILED, "None"]
    assert not tiny.files("*.sha256")


def test_an_interrupt_ends_a_process_that_waits(tiny):
    with another_process_compiles(tiny):
        process = one_that_waits(tiny, patience=100.0)
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        assert "KeyboardInterrupt" in process.communicate(timeout=10)[1]


class Pair(NamedTuple):
    a: object
    b: object


class Other(NamedTuple):
    a: object
    b: object


def values():
    """Arguments of all kinds, some of which have the same type for numba."""
    whole, column = np.zeros((3, 4)), np.zeros((3, 1))
    sealed, fields = np.zeros(3), np.zeros(3, [("x", float), ("y", np.int64)])
    sealed.flags.writeable = False
    bytewise = np.zeros(25, np.uint8)[1:].view(float)
    arrays = whole, whole.T, whole[:, ::2], column, column.T, whole[0], whole[:, 0]
    arrays += sealed, bytewise, fields, fields["x"], whole.astype(np.float32)
    numbers = (
        1,
        2,
        1.0,
        True,
        np.float64(1.0),
        np.float32(1.0),
        np.int64(1),
        np.bool_(True),
    )
    plain = *arrays, *numbers, None, ()
    nested = [kind(a, 1.0) for a in plain for kind in (Pair, Other)]
    nested += [(a, 1.0) for a in plain]
    return [*plain, *nested, Pair(Pair(1, ()), sealed), Pair(Pair(1, ()), whole[0])]


def test_values_of_one_kind_have_one_type():
    """Else a call would take machine code for other arguments."""
    types = {}
    for value in values():
        found = numba.typeof(value)
        assert types.setdefault(_kind(value), found) == found
    assert len(types) > 60


def test_each_type_has_machine_code(tiny):
    """numba would convert an integer for machine code that takes a double."""
    code = """
import numpy as np
from tiny import double, size
assert [type(double(x)) for x in (1, 1.5, np.float32(1.0))] == [float] * 3
assert [str(x) for (x,) in double.signatures] == ["int64", "float64", "float32"]
x = np.arange(6.0).reshape(2, 3)
sealed = x.copy()
sealed.flags.writeable = False
assert {size(a) for a in (x, x.T, x.copy(), x[:, :], sealed)} == {6}
assert len(size.signatures) == 3
"""
    tiny.run(code)
