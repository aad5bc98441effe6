"""One ensemble split over threads, processes and machines: the same bits."""

import math
import multiprocessing
import os
import pickle
import signal
import sys
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor

import distributed
import numpy as np
import pytest
from typer.testing import CliRunner

from eqsim import (
    Aging,
    Delay,
    Drive,
    Ensemble,
    Programme,
    Segment,
    Thermal,
    trajectory,
)
from eqsim.cli.app import app
from eqsim.engine.blocks import Totals

ARRAYS = (
    "X",
    "t",
    "force",
    "force_stderr",
    "pinned",
    "pinned_stderr",
    "force_replica_std",
)
THERMAL = Ensemble(
    thermal=Thermal(0.1), count=3000, delay=Delay(1.0, "exponential"), eta=1.0
)
LANGEVIN = Ensemble(thermal=Thermal(0.1), aging=Aging("langevin", 0.1, 2.0), count=600)
CASES = [
    (ensemble, start, replicas)
    for ensemble in (THERMAL, LANGEVIN)
    for start in ("fresh", "stationary")
    for replicas in (1, 7)
]


def bits(ensemble, start, replicas, **how):
    run = trajectory(
        ensemble, Drive(0.1, 4.0, start), points=101, seed=9, replicas=replicas, **how
    )
    arrays = (getattr(run, name) for name in ARRAYS)
    return [a is not None and a.tobytes() for a in arrays], run.averages, run.lives


@pytest.fixture(scope="module")
def expected():
    return [bits(*case) for case in CASES]


@pytest.fixture(scope="module")
def processes():
    with ProcessPoolExecutor(
        2, mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        yield pool


def test_same_bits_on_threads(expected):
    assert [bits(*case, threads=2) for case in CASES] == expected


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_same_bits_on_processes(expected, processes, workers):
    """Two processes; the size that is given says how many shares are made."""
    assert [bits(*case, threads=(processes, workers)) for case in CASES] == expected


def compiled_signatures():
    """How often this process has compiled or loaded the kernels."""
    from eqsim.engine.lanes import follow
    from eqsim.engine.segments import follow_alone

    return len(follow.signatures) + len(follow_alone.signatures)


@pytest.mark.long
def test_same_bits_on_dask(expected, command):
    cluster = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        worker_dashboard_address=None,
    )
    with cluster, distributed.Client(cluster) as client:
        workers = (client.get_executor(), 2)
        assert [bits(*case, threads=workers) for case in CASES] == expected
        # arrays come as the kernels know them: they are compiled once for each law and
        # each start
        assert set(client.run(compiled_signatures).values()) == {4}
        here, there = (
            command("--threads", "1"),
            command("--dask", cluster.scheduler_address),
        )
    assert there[0].exit_code == 0, there[0].output
    assert "2 workers" in there[0].output
    assert here[1] == there[1]


@pytest.mark.long
def test_a_lost_worker_of_a_cluster_changes_no_bit():
    """Others repeat its share."""
    ensemble, drive, killed = (
        Ensemble(thermal=Thermal(0.1), count=3_000_000),
        Drive(0.1, 4.0),
        [],
    )
    cluster = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        worker_dashboard_address=None,
    )
    with cluster, distributed.Client(cluster) as client:

        def kill(lives):
            if lives and not killed:
                killed.append((lives, min(client.run(os.getpid).values())))
                os.kill(killed[0][1], signal.SIGKILL)

        workers = (client.get_executor(), 2)
        there = trajectory(
            ensemble, drive, points=101, seed=9, threads=workers, progress=kill
        )
    here = trajectory(ensemble, drive, points=101, seed=9)
    assert killed[0][0] < here.lives
    assert there.force.tobytes() == here.force.tobytes()
    assert there.lives == here.lives


@pytest.fixture
def command(tmp_path):
    """`eqsim run` of a small ensemble with more arguments: its result, and the bytes of
    the table if there is one."""
    path = tmp_path / "small.toml"
    path.write_text(
        "[contacts]\ncount = 3000\n[drive]\nvelocity = 0.1\ndistance = 4.0\n[output]\npoints = 51\n"
    )

    def call(*args):
        out = tmp_path / "out" / "-".join(str(len(arg)) for arg in args)
        result = CliRunner().invoke(
            app, ["run", str(path), "--out", str(out), *map(str, args)]
        )
        table = out / "trajectory.parquet"
        return result, table.read_bytes() if table.exists() else None

    return call


@pytest.mark.long
def test_command_on_processes(command):
    here, there = command("--threads", "1"), command("--workers", "2")
    assert here[0].exit_code == there[0].exit_code == 0
    assert "2 workers" in there[0].output
    assert here[1] == there[1]


def test_command_refuses_in_one_line(command, monkeypatch, tmp_path):
    def silent(*_, **__):
        raise TimeoutError("timed out")

    def refused(message, *args):
        result, table = command(*args)
        assert result.exit_code == 2
        assert message in result.stderr
        assert result.stderr.count("\n") == 1
        assert table is None

    refused("--workers = 0: must be an integer from 1", "--workers", "0")
    refused(
        "--workers, --dask: only one of them",
        "--workers",
        "1",
        "--dask",
        "localhost:8786",
    )
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "distributed", None)
        refused('--dask: needs the package "distributed"', "--dask", "localhost:8786")
    refused("--dask nowhere: must be HOST:PORT", "--dask", "nowhere")
    for text in ("{}", "[[", '{"address": 5}', "[contacts]"):
        (tmp_path / "scheduler").write_text(text)
        refused(
            "scheduler: must be HOST:PORT of a scheduler or a file",
            "--dask",
            str(tmp_path / "scheduler"),
        )
    monkeypatch.setattr(distributed, "Client", silent)
    refused(
        "--dask localhost:9: no scheduler answers (timed out)", "--dask", "localhost:9"
    )


class Watched(Executor):
    """Runs what it is sent at once, through pickles as a process would; may forget a
    share, or fail at one."""

    def __init__(self, forget=None, fail=None):
        self.sent, self.returned, self.forget, self.fail = [], [], forget, fail
        self.futures = []

    def submit(self, function, /, *args, **kwargs):
        future = Future()
        self.futures.append(future)
        sent = pickle.dumps((function, args, kwargs))
        self.sent.append(len(sent))
        index = len(self.sent) - 1
        if self.fail is not None and index >= self.fail:
            if index == self.fail:
                future.set_exception(ChildProcessError("a worker died"))
            return future  # those behind a dead worker never run
        function, args, kwargs = pickle.loads(sent)
        result = function(*args, **kwargs)
        self.returned.append(len(pickle.dumps(result)))
        future.set_result(Totals(102, 101, 1) if index == self.forget else result)
        return future


@pytest.mark.parametrize("replicas", [1, 40])
def test_few_shares_small_messages_and_progress(replicas):
    """Four shares a worker; each is sent the tables once and returns sums over points,
    whatever the contacts."""
    executor, told = Watched(), []
    found = bits(
        THERMAL, "stationary", replicas, threads=(executor, 3), progress=told.append
    )
    assert found == bits(THERMAL, "stationary", replicas)
    assert len(executor.sent) == 12
    assert max(executor.sent) < 2**20
    # deposits, windows, counts
    sums = 102 * 6 + 64 * 2 * 6 + 2
    if replicas > 1:  # sums over replicas, and forces of those that a share touches
        sums += 2 * 101 + (math.ceil(replicas / 12) + 1) * 101
    assert max(executor.returned) < 8 * sums + 1000
    assert told[-1] == found[-1]


def test_forces_of_many_replicas_from_workers():
    """The scatter of all replicas tells errors of segments, on workers, too."""
    ensemble = Ensemble(count=10, stiffness_law="uniform")
    slide = Programme([Segment(1.0, distance=2.0), Segment(0.5, distance=2.0)])
    here, there = (
        trajectory(ensemble, slide, points=11, replicas=65, threads=threads)
        for threads in (1, (Watched(), 3))
    )
    assert here.segments == there.segments
    assert here.force_replicas.tobytes() == there.force_replicas.tobytes()


def test_no_block_below_the_lanes():
    """300 contacts are three blocks, however many workers there are."""
    executor = Watched()
    trajectory(Ensemble(count=300), Drive(0.1, 1.0), points=101, threads=(executor, 50))
    assert len(executor.sent) == 3


def test_a_lost_share_shows():
    """Negative control: without one of the shares the bits differ."""
    whole = trajectory(THERMAL, Drive(0.1, 4.0), points=101)
    less = trajectory(
        THERMAL, Drive(0.1, 4.0), points=101, threads=(Watched(forget=3), 2)
    )
    assert not np.array_equal(whole.force, less.force)
    assert less.lives < whole.lives


def test_a_dead_worker_is_an_error_and_the_rest_is_cancelled():
    executor = Watched(fail=2)
    with pytest.raises(ChildProcessError, match="a worker died"):
        trajectory(THERMAL, Drive(0.1, 4.0), points=101, threads=(executor, 2))
    assert len(executor.futures) == 8
    for future in executor.futures[3:]:
        with pytest.raises(CancelledError):
            future.result(timeout=0)
