"""What is compiled, and machine code on disk: what processes that start at once and damaged files do to it."""

import fcntl
import os
import pickle
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest
from numba.core import event

from eqsim import Aging, Drive, Ensemble, trajectory
from eqsim.numerics import compiled
from eqsim.workflows import ahead, second

ONE = """
from eqsim import Drive, Ensemble, Thermal, steady
from numba.core import event
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


def files(folder, stamp=1):
    return compiled.Files(SimpleNamespace(_cache_path=str(folder), _index_name="kernel.nbi", _source_stamp=stamp))


def saved(folder, key="a", data="code"):
    store = files(folder)
    assert store.load(key) is None
    store.save(key, data)
    return store


def test_what_was_saved_is_loaded(tmp_path):
    saved(tmp_path, "a", "of a")
    saved(tmp_path, "b", "of b")
    assert (files(tmp_path).load("a"), files(tmp_path).load("b")) == ("of a", "of b")
    assert files(tmp_path, stamp=2).load("a") is None  # another source
    assert not list(tmp_path.glob("*.tmp"))


def test_damaged_files_are_compiled_again(tmp_path):
    path = saved(tmp_path).path("a")
    whole = path.read_bytes()
    for content in (b"", whole[:40], whole.replace(b"code", b"cede")):
        path.write_bytes(content)
        store = files(tmp_path)
        assert store.load("a") is None
        store.save("a", "anew")
        assert files(tmp_path).load("a") == "anew"


def test_a_file_of_another_signature_is_not_taken(tmp_path):
    store = saved(tmp_path, "a")
    store.path("b").write_bytes(store.path("a").read_bytes())
    assert files(tmp_path).load("b") is None


@pytest.mark.skipif(sys.platform == "win32", reason="no locks")
def test_others_wait_for_the_one_that_compiles(tmp_path):
    first, found = files(tmp_path), []
    assert first.load("a") is None  # compiles from here on
    other = threading.Thread(target=lambda: found.append(files(tmp_path).load("a")))
    other.start()
    time.sleep(0.3)
    assert not found
    first.save("a", "code")
    other.join(10.0)
    assert found == ["code"]


def test_a_kernel_that_failed_to_compile_keeps_nobody_of_its_own_process_waiting(tmp_path):
    store = files(tmp_path)
    begin = time.monotonic()
    assert store.load("a") is None
    assert store.load("a") is None
    assert time.monotonic() - begin < 5.0


def test_a_folder_that_cannot_be_written_stops_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    store = files(tmp_path / "file")
    assert store.load("a") is None
    store.save("a", "code")
    assert store.load("a") is None


@pytest.mark.long
def test_processes_that_start_at_once_compile_each_kernel_once(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", ONE]
    every = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    said = [process.communicate(timeout=300)[0].split() for process in every]
    assert len({numbers[0] for numbers in said}) == 1
    assert sorted(name for words in said for name in words[1:]) == ["fill_lives", "invert"]


def test_a_routine_of_a_kernel_elsewhere():
    """A kernel's own copy of a routine takes fewer arguments than that of another module, which is compiled later. In a
    process of its own: the wrong one reads and writes anywhere."""
    code = """
import numpy as np
from eqsim import Aging, Ensemble, Thermal
from eqsim.engine import langevin, lanes
from eqsim.engine.contacts import contacts
from tests.kernels import compiled
c = contacts(Ensemble(thermal=Thermal(0.1), aging=Aging("langevin", 0.1, 2.0)), 1.0)
name, n = lanes.key_of(1, 2), 300
found = lanes.lives(c, name, 0, np.full(n, 0.3), np.full(n, 0.6))
stretch, clock = np.full(n, compiled(lanes.threshold_draw)(c.thresholds, 0.3)), np.full(n, -np.log(0.6))
arguments = langevin.pinned(c), name, langevin.STEP, np.arange(n), np.zeros(n, np.int64), stretch, clock
compiled(langevin.lives)(*arguments)
assert np.allclose(stretch, found.travel, rtol=1e-9, atol=0)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


@compiled.routine
def inner(x):
    return 2.0 * x


@compiled.inlined
def by_inlined(x):
    return inner(x) + 1.0


@compiled.routine
def by_routine(x):
    return inner(x) + 10.0


@compiled.shared
def by_shared(x):
    return inner(x) + 100.0


@compiled.kernel
def outer(x):
    return by_inlined(x) + by_routine(x) + by_shared(x)


def test_a_routine_is_compiled_once_for_all_that_call_it(tmp_path, monkeypatch):
    class Compiled(event.Listener):
        def on_start(self, happened):
            if "dispatcher" in happened.data:
                done[happened.data["dispatcher"].py_func.__name__] += 1

        def on_end(self, happened):
            pass

    done = Counter()
    for one in (outer, by_shared.dispatcher):
        monkeypatch.setattr(one._cache._cache_file, "_folder", tmp_path)
    with event.install_listener("numba:compile", Compiled()):
        assert outer(1.0) == 117.0
        assert by_shared(2.0) == 104.0  # interpreted
    assert done == dict.fromkeys(("inner", "by_inlined", "by_routine", "by_shared", "outer"), 1)
    assert len(list(tmp_path.glob("*.nbc"))) == 2  # what another kernel finds there


@compiled.shared_inlined
def by_shared_inlined(x):
    return by_shared(x) * 2.0


@compiled.shared_maker
def by_shared_maker(x):
    return np.full(2, by_shared_inlined(x))


@compiled.kernel
def first_caller(x):
    return by_shared_maker(x)[1] + by_shared(x)


@compiled.kernel
def later_caller(x):
    return by_shared_maker(x)[1] - by_shared(x)


@numba.njit
def compiled_by_numba(x):
    return by_routine(x) + by_shared_maker(x)[0]


def test_shared_routines_are_taken_from_disk(tmp_path, monkeypatch):
    def as_in_a_new_process():
        every = (
            compiled.shared(by_shared),
            compiled.shared_inlined(by_shared_inlined),
            compiled.shared_maker(by_shared_maker),
        )
        for one in (*(routine.dispatcher for routine in every), first_caller, later_caller):
            monkeypatch.setattr(one._cache._cache_file, "_folder", tmp_path)
        return [routine.dispatcher.stats.cache_hits for routine in every]

    hits = as_in_a_new_process()
    assert first_caller(1.0) == 306.0
    assert [sum(each.values()) for each in hits] == [0, 0, 0]
    hits = as_in_a_new_process()
    assert later_caller(3.0) == 106.0
    assert compiled_by_numba(3.0) == 228.0
    assert [sum(each.values()) for each in hits] == [1, 0, 1]  # what is on disk has in it what it calls


def test_a_routine_that_another_process_compiles_is_left_to_it(tmp_path, monkeypatch):
    made = by_shared.dispatcher
    monkeypatch.setattr(made._cache._cache_file, "_folder", tmp_path)
    arguments = (np.float32(1.0),)
    path = made._cache._cache_file.path(made._cache._index_key((numba.float32,), made.targetctx.codegen()))
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        compiled.compile_unless_taken(by_shared, arguments)
        assert not path.exists()
    compiled.compile_unless_taken(by_shared, arguments)
    assert path.exists()


@pytest.mark.skipif(compiled._CACHE is None, reason="it looks for files, and no folder for them can be written")
@pytest.mark.parametrize("start", ["fresh", "stationary"])
@pytest.mark.parametrize("aging", [Aging(), Aging("langevin", 0.1, 2.0)])
def test_processes_compile_what_kernels_ask_for(start, aging):
    """There would be two files of a routine if the types of its arguments differed."""
    ensemble, drive = Ensemble(count=1, aging=aging), Drive(1.0, 1.0, start)
    trajectory(ensemble, drive, points=2)
    for routine, arguments in ahead._routines(ensemble, drive):
        files, key = routine.dispatcher._cache._cache_file, tuple(map(numba.typeof, arguments))
        assert files.path(routine.dispatcher._cache._index_key(key, routine.dispatcher.targetctx.codegen())).exists()
    names = ("join_uniform_ramps", "leave_uniform_ramps", "leave_ramps", "empty_columns")
    of_all_laws = [f"recorder.{name}" for name in names]
    of_all_laws += [f"lanes.{name}" for name in ("empty_lanes", "draw_unstressed", "draw_thresholds")]
    for name in of_all_laws:
        keys = [pickle.loads(path.read_bytes()[32:])[0] for path in Path(compiled._CACHE).rglob(f"{name}-*.nbc")]
        processors = [processor for _, processor, _ in keys]  # other tests compile for older ones
        assert len(keys) == len(set(processors)) >= 1, name


@pytest.mark.parametrize(
    ("program", "found"),
    [
        ("import pickle, sys; pickle.dump(len(pickle.load(sys.stdin.buffer)), sys.stdout.buffer)", 3),
        ("import pickle, sys; pickle.load(sys.stdin.buffer); sys.stdout.write('rubbish')", None),
        ("raise SystemExit(1)", None),
    ],
)
def test_what_the_second_process_sends(monkeypatch, program, found):
    monkeypatch.setattr(second, "_COMMAND", program)
    process = second.Second()
    assert process.found() is None  # nothing was compiled
    process.send(pickle.dumps((1, 2, 3)))
    assert process.found() == found
    process.send(b"more")  # is not taken
    process.end()
    assert process.process.returncode is not None


def test_a_process_that_is_started_early(monkeypatch):
    monkeypatch.setattr(second, "_COMMAND", "import sys; sys.stdin.buffer.read()")
    monkeypatch.setattr(second, "several_processors", lambda: True)
    for empty in (False, True):
        monkeypatch.setattr(second.kernel_folder, "is_empty", lambda empty=empty: empty)
        second.start_early()
        assert (second._started != []) == empty
    process = second.take()
    assert process.process.poll() is None
    assert process.found() is None  # nor does anybody wait for one that has nothing to do
    process.end()
    assert second.take().process is None
