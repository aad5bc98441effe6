"""Ctrl-C while kernels run, from Python and at the command line: the work, which would
take 20 s to hours, ends within `waiting.ALLOWED`, and so do its threads."""

import math
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError

import numpy as np
import pytest
from waiting import ALLOWED, has_worked, once

from eqsim import Delay, Ensemble, Programme, Segment, Stage, Thermal
from eqsim.engine import avalanches
from eqsim.engine.contacts import contacts
from eqsim.engine.lanes import LANES, follow, idle_lanes
from eqsim.engine.randomise import PlainSums
from eqsim.engine.slider import Slider
from eqsim.master import slider
from eqsim.master.cohorts import march
from eqsim.master.programme import course_of, numerics_of
from eqsim.numerics.streams import STEADY, key
from eqsim.numerics.threads import NEVER, ThreadPool, current_stop, interruptibly

SET = np.ones(1, np.int64)

# ---- threads ----


def until_told(begun, ended):
    """Work that looks at the flag, as kernels do."""
    begun.set()
    while not current_stop()[0]:
        time.sleep(0.001)
    ended.set()


def broken_off(work):
    """Interrupt the thread that waits for some work of another one as soon as that has
    begun."""
    begun = threading.Event()
    with ThreadPool(1) as pool:
        futures = work(pool, begun)
        begun.wait()
        raise KeyboardInterrupt(futures)


def test_an_interrupt_stops_threads_and_cancels_what_has_not_begun():
    ended = threading.Event()
    with pytest.raises(KeyboardInterrupt) as stopped:
        broken_off(
            lambda pool, begun: (
                pool.submit(until_told, begun, ended),
                pool.submit(len, "never begun"),
            )
        )
    assert ended.wait(ALLOWED)
    first, second = stopped.value.args[0]
    assert second.cancelled()
    with pytest.raises(CancelledError):
        first.result(ALLOWED)


def test_pools_of_threads_are_stopped_with_them():
    ended = threading.Event()
    with pytest.raises(KeyboardInterrupt):
        broken_off(
            lambda pool, begun: pool.submit(interruptibly, until_told, begun, ended)
        )
    assert ended.wait(ALLOWED)
    assert current_stop() is NEVER
    assert not NEVER[0]


def test_an_error_in_a_nested_pool_stops_nobody_else():
    def fails():
        with pytest.raises(ZeroDivisionError):
            interruptibly(divmod, 1, 0)
        return int(current_stop()[0])

    with ThreadPool(1) as pool:
        assert pool.submit(fails).result() == 0


def test_a_thread_that_does_not_look_is_abandoned():
    """As one that compiles."""
    done, release = threading.Event(), threading.Event()

    def compiles(begun):
        begun.set()
        release.wait(3 * ALLOWED)
        done.set()

    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        broken_off(lambda pool, begun: pool.submit(compiles, begun))
    assert time.monotonic() - begin < ALLOWED
    assert not done.is_set()
    release.set()
    assert done.wait(ALLOWED)


def test_results_keep_their_order_and_errors_their_type():
    with ThreadPool(3) as pool:
        assert list(pool.map(lambda x: x * x, range(100))) == [
            x * x for x in range(100)
        ]
        with pytest.raises(ZeroDivisionError):
            pool.submit(divmod, 1, 0).result()
    assert interruptibly(max, 1, 2) == 2


# ---- kernels ----

WARM = Ensemble(
    count=1000, thermal=Thermal(0.05), delay=Delay(1.0), stiffness_law="uniform"
)
PULLED = Programme([Segment(0.1, time=4.0)], stage=Stage(0.1, damping=0.1, preload=7.5))


def test_kernels_end_when_they_are_told():
    """Before their first step, where what they fill is still 0."""
    s, course = course_of(WARM, PULLED)
    numerics = numerics_of(s, course, math.inf)
    t = np.linspace(0.0, 1.0, 50)
    path = numerics.path(t, course.at(t), 1.0)
    assert march(numerics.contacts(1.0), path).force[-1] > 0.0
    assert not np.array(march(numerics.contacts(1.0), path._replace(stop=SET)))[
        :, 1:
    ].any()
    c = contacts(Ensemble(), 0.1)
    for stop, travels in ((NEVER, True), (SET, False)):
        sums = PlainSums.empty(0, 0, 2, stop)
        follow(c, sums, 0, LANES, *idle_lanes(c, key(1, STEADY)))
        assert np.any(sums[4:9]) == np.any(sums.travel) == travels


@pytest.mark.parametrize(("stop", "breaks"), [(NEVER, True), (SET, False)])
def test_avalanches_end_when_they_are_told(stop, breaks):
    ensemble = Ensemble(count=100, stiffness_law="uniform")
    with Slider(
        ensemble, Programme([Segment(0.1, time=50.0)], stage=Stage(0.1)), 1, 0, 1
    ) as pulled:
        state = np.zeros(1, avalanches.STATE)
        state["stiffness"] = 1.0
        contacts = pulled.groups[0]
        queue = avalanches.queue_of(*contacts[:4])
        way, events = avalanches.Way(0.1, 40.0, stop), np.empty(1, avalanches.EVENT)
        avalanches.load(queue, state, way, events)
    assert (state["breaks"][0] > 0) == breaks


@pytest.mark.parametrize("moment", ["solver", "compiler"])
def test_a_solver_of_the_mean_field_is_told(monkeypatch, moment):
    """An interrupt of the thread that waits for it, as a signal raises one."""
    told = []

    def pull(c, path, *_):
        begun.set()
        end = time.monotonic() + ALLOWED
        while moment == "solver" and not path.stop[0] and time.monotonic() < end:
            time.sleep(0.001)
        told.append(int(path.stop[0]))
        return np.zeros((6, path.t.size)), 1

    def result(future):
        begun.wait()
        raise KeyboardInterrupt

    begun = threading.Event()
    monkeypatch.setattr(slider, "pull", pull)
    monkeypatch.setattr("concurrent.futures.Future.result", result)
    with pytest.raises(KeyboardInterrupt):
        slider.pulled_of(WARM, PULLED, PULLED.grid(3))
    once(lambda: told, seconds=ALLOWED)
    assert moment == "compiler" or told == [1]


# ---- from Python and at the command line ----

LONG = """
import eqsim
if __name__ == "__main__":
    warm = eqsim.Ensemble(
        count=1000, thermal=eqsim.Thermal(0.05), delay=eqsim.Delay(1.0), stiffness_law="uniform"
    )
    stage = eqsim.Stage(0.1, damping=0.1, preload=7.5)
    drive = eqsim.Programme([eqsim.Segment(0.1, distance=400.0)], stage=stage)
    slow = eqsim.Programme([eqsim.Segment(1e-4, distance=400.0)], stage=stage)
    try:
        {work}
    except KeyboardInterrupt:
        print("KeyboardInterrupt")
"""
RUN = """
[contacts]
count = 1000
stiffness_law = "uniform"
[thermal]
kT = 0.05
[delay]
time = 1.0
[drive]
velocity = 0.1
distance = 400.0
[drive.stage]
stiffness = 0.1
damping = 0.1
preload = 7.5
"""


def start(*command, **options):
    return subprocess.Popen(
        [sys.executable, *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        **options,
    )  # fmt: skip


def answer(process, number, in_kernel=True):
    """Exit code, output and errors of a process that gets a signal."""
    # without a kernel, for longer than it takes to import eqsim
    seconds = 0.2 if in_kernel else 3.0
    once(lambda: has_worked(process, seconds, in_kernel), process)
    process.send_signal(number)
    try:
        output, errors = process.communicate(timeout=ALLOWED)
    finally:
        process.kill()
    return process.returncode, output, errors


WORK = {
    "transient": "eqsim.transient(warm, drive)",
    "curve": "eqsim.transient(warm, eqsim.Programme([eqsim.Segment(0.1 + i % 2, time=1.0) for i in range(4000)]))",
    "stability": "eqsim.stability(warm, slow, critical=True)",  # without a kernel
    "trajectory": "eqsim.trajectory(eqsim.Ensemble(count=300_000_000), eqsim.Drive(0.1, 5.0))",
    "steady": "eqsim.steady(eqsim.Ensemble(), eqsim.Drive(0.1), rel_error=1e-9, max_lives=1e15, threads=2)",
}


@pytest.mark.parametrize(
    "work",
    [
        pytest.param(name, marks=[pytest.mark.long] if name != "transient" else [])
        for name in WORK
    ],
)
def test_ctrl_c_from_python(tmp_path, work):
    (tmp_path / "a.py").write_text(LONG.format(work=WORK[work]))
    assert answer(start(tmp_path / "a.py"), signal.SIGINT, work != "stability") == (
        0,
        "KeyboardInterrupt\n",
        "",
    )


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.long), signal.SIGTERM]
)
def test_a_signal_while_the_mean_field_is_solved(tmp_path, number):
    (tmp_path / "a.toml").write_text(RUN)
    process = start("-m", "eqsim", "reference", "a.toml", "--transient", cwd=tmp_path)
    assert answer(process, number) == (
        128 + number,
        "",
        "eqsim: interrupted; nothing is half-written\n",
    )


DEAF = """
import os, signal, time
from eqsim.__main__ import main

def stuck(_):
    while True:  # as in a call to the system that does not return
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(60)
        except KeyboardInterrupt:
            pass

os.fsync = stuck
main()
"""


def test_a_process_that_cannot_answer_leaves_no_temporary_file(tmp_path):
    from eqsim.io import storage

    (tmp_path / "x").mkdir()
    storage.publish(tmp_path / "x", {"a.parquet": storage.parquet({"X": [0.0]}, {})})
    process = start(
        "-c",
        DEAF,
        "export",
        tmp_path / "x" / "a.parquet",
        "--out",
        tmp_path / "y" / "b.csv",
    )
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (
        143,
        "eqsim: interrupted; nothing is half-written\n",
    )
    assert [path.name for path in tmp_path.rglob("*")] == ["x", "a.parquet"]
