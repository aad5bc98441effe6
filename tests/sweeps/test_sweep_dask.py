"""Sweeps on a real dask.distributed cluster, one of whose workers is killed."""

import os
import signal

import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster

from eqsim.errors import InputError
from eqsim.io.runfile import check
from eqsim.sweeps.plan import Plan
from eqsim.sweeps.scheduler import sweep
from eqsim.sweeps.workers import Workers

RUN = {
    "contacts": {"stiffness_law": "uniform"},
    "sweep": {
        "drive.velocity": {"log": [0.01, 10.0, 8]},
        "thermal.kT": [0.03, 0.1, 1.0],
        "delay.time": [0.0, 1.0],
    },
}


def table_of(folder):
    return pq.read_table(folder / "sweep.parquet").drop_columns("seconds")


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    folder = tmp_path_factory.mktemp("exact")
    sweep(Plan(check(RUN)), folder, workers=Workers(2))
    return table_of(folder)


@pytest.mark.long
def test_a_cluster_gives_the_same_table_though_a_worker_is_killed(exact, tmp_path):
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        host="127.0.0.1",
    ) as cluster:
        address = cluster.scheduler_address
        found = sweep(
            Plan(check(RUN)), tmp_path / "calm", workers=Workers(dask=address)
        )
        assert found.ok == 48
        assert table_of(tmp_path / "calm").equals(exact)

        killed = []

        def progress(done, total):
            if done > total // 4 and not killed:
                from distributed import Client

                with Client(address, set_as_default=False) as client:
                    killed.append(min(client.run(os.getpid).values()))
                os.kill(killed[0], signal.SIGKILL)
                assert done < total

        found = sweep(
            Plan(check(RUN)),
            tmp_path / "killed",
            workers=Workers(dask=address),
            progress=progress,
        )
        assert killed
        assert found.ok == 48
        assert table_of(tmp_path / "killed").equals(exact)


def test_no_scheduler_is_one_line(tmp_path, monkeypatch):
    from distributed import Client

    def refuse(*_, **__):
        raise OSError("Timed out trying to connect")

    monkeypatch.setattr(Client, "__init__", refuse)
    with pytest.raises(
        InputError, match=r"--dask tcp://nowhere:1: no scheduler answers"
    ):
        sweep(
            Plan(check(RUN)),
            tmp_path / "o",
            workers=Workers(dask="tcp://nowhere:1"),
        )


def test_without_the_package_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install \"eqsim\[dask\]\""):
        sweep(
            Plan(check(RUN)),
            tmp_path / "o",
            workers=Workers(dask="tcp://nowhere:1"),
        )
