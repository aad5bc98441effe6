"""A table can be made again from what it carries, and a table that was tampered with is
found out."""

import json
import os
import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from cases import chosen
from command_line import call

from eqsim.errors import InputError
from eqsim.workflows.replay import compare, replay
from eqsim.workflows.sweep import sweep

RUN = """
disorder = "annealed"
[contacts]
count = 300
[thresholds]
law = "gamma"
[aging]
rule = "flow"
rate = inf
x_star_final = 2.0
[thermal]
kT = 0.1
[delay]
time = 0.5
[drive]
velocity = 0.1
distance = 5.0
[output]
points = 21
replicas = 2
[sweep]
"drive.velocity" = [0.1, 1.0]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a run file's folder")
    (folder / "a.toml").write_text(RUN)
    pd.DataFrame({"threshold": [0.5, 1.0, 1.5]}).to_csv(folder / "x.csv", index=False)
    (folder / "b.toml").write_text(
        '[thresholds]\nlaw = "table"\nfile = "x.csv"\n[drive]\nvelocity = 1.0\ndistance = 3\n'
    )
    calls = {
        "run": (
            "run",
            folder / "a.toml",
            "--out",
            folder / "run",
            "--seed",
            7,
            "--set",
            "delay.law=exponential",
        ),
        "table": (
            "run",
            folder / "b.toml",
            "--out",
            folder / "table",
            "--set",
            "contacts.count=50",
        ),
        "sweep": (
            "sweep",
            folder / "a.toml",
            "--out",
            folder / "sweep",
            "--workers",
            1,
        ),
    }
    for command in calls.values():
        done = call(*command)
        assert done.exit_code == 0, done.output
    return {
        "run": folder / "run" / "trajectory.parquet",
        "table": folder / "table" / "trajectory.parquet",
        "sweep": folder / "sweep" / "sweep.parquet",
    }


@chosen(  # a sweep is replayed by default as one of an older version
    ("kind", "threads"), [("run", 2), ("sweep", 1), ("table", 2)], [("run", 2)]
)
def test_same_bits(made, kind, threads):
    done = call("replay", made[kind], "--threads", threads, "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 0, done.output
    assert found["same"]
    assert found["differences"] == {}
    assert found["rows"] == {"run": 21, "table": 2001, "sweep": 2}[kind]


def test_a_run_file_from_a_pipe(made, tmp_path):
    """It can be read once; the table carries it as it was."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for out in ([], ["--out", tmp_path / "o"]):
        writer = threading.Thread(target=pipe.write_text, args=(RUN,))
        writer.start()
        done = call("run", pipe, *out)
        writer.join()
        assert done.exit_code == (0 if out else 2), done.output
    path = tmp_path / "o" / "trajectory.parquet"
    assert json.loads(pq.read_schema(path).metadata[b"eqsim"])["run_file"] == RUN
    assert call("replay", path).exit_code == 0


def test_what_was_changed_is_found(made, tmp_path):
    table = pq.read_table(made["run"])
    force = table["force"].to_numpy().copy()
    force[3] = np.nextafter(force[3], 1.0)
    at = table.schema.get_field_index("force")
    changed = table.set_column(at, "force", pa.array(force)).replace_schema_metadata(
        table.schema.metadata
    )
    pq.write_table(changed, tmp_path / "changed.parquet")
    done = call("replay", tmp_path / "changed.parquet")
    assert done.exit_code == 1
    assert "force differs in 1 of 21 rows, by up to" in " ".join(done.stdout.split())


@pytest.mark.verification
def test_a_sweep_of_an_older_version(made, tmp_path, monkeypatch):
    """Seeds are made from identities, and these from the version of results; a replay
    takes those of then."""
    monkeypatch.setattr("eqsim.sweeps.plan.RESULTS_VERSION", 1000)
    done = call("replay", made["sweep"], "--json")
    assert json.loads(done.stdout)["differences"] == {}, done.output
    table = pq.read_table(made["sweep"])
    for ids in (["x"], ["x", "y"]):  # as nobody has written them
        changed = table.slice(0, len(ids)).set_column(0, "id", pa.array(ids))
        pq.write_table(
            changed.replace_schema_metadata(table.schema.metadata),
            tmp_path / "changed.parquet",
        )
        done = call("replay", tmp_path / "changed.parquet")
        assert done.exit_code == 2
        assert (
            "holds 1 of the 2 points of a sweep that was not finished" in done.stderr
        ) == (len(ids) == 1)
        assert ("its provenance is damaged (ValueError" in done.stderr) == (
            len(ids) == 2
        )


MEASURED = """
units = { length = "um", time = "s", force = "mN" }
interface = { area = 1.0, normal_load = 100.0 }
"""
STAGE = "time = 20.0\nstage = { stiffness = 0.1 }\n"


@pytest.mark.parametrize(
    ("given", "more", "column"),
    [(MEASURED, "", "friction_coefficient"), ("", STAGE, "slips")],
    ids=["interface", "stage"],
)
def test_a_sweep_is_repeated_with_all_columns(given, more, column, tmp_path):
    """Those of units and an interface, and those of a slider that is pulled."""
    drive = f"{given}[contacts]\ncount = 20\n[drive]\nvelocity = 0.1\n{more}"
    (tmp_path / "a.toml").write_text(f'{drive}[sweep]\n"drive.velocity" = [0.1]\n')
    sweep(tmp_path / "a.toml", out=tmp_path / "o", progress=False)
    assert column in pq.read_schema(tmp_path / "o" / "sweep.parquet").names
    assert replay(tmp_path / "o" / "sweep.parquet").differences == {}


def test_one_worker_is_this_process(made, monkeypatch):
    """A script without `if __name__ == "__main__":` cannot start another one. A point
    that fails only when it is repeated is no difference of results."""
    monkeypatch.setattr("eqsim.sweeps.workers.Processes", None)
    assert replay(made["sweep"]).same

    def fails(*_, **__):
        raise InputError("no memory")

    monkeypatch.setattr("eqsim.sweeps.rows.steady", fails)
    with pytest.raises(InputError, match="point 1 fails when it is repeated: no mem"):
        replay(made["sweep"])


def test_modes_of_a_chain(tmp_path):
    runs = Path(__file__).parents[2] / "runs"
    done = call("stability", runs / "fronts.toml", "--out", tmp_path / "modes")
    assert done.exit_code == 0, done.output
    assert replay(tmp_path / "modes" / "modes.parquet").same


def test_compare():
    left = pd.DataFrame({"a": [1.0, np.nan], "b": ["x", "y"], "seconds": [1.0, 2.0]})
    assert compare(left, left.assign(seconds=0.0)) == {}
    assert compare(left, left.assign(a=[1.5, np.nan])) == {"a": (1, 0.5)}
    assert compare(left, left.assign(a=[1.0, 2.0], b=["x", "z"])) == {
        "a": (1, None),
        "b": (1, None),
    }
    assert compare(left.assign(a=[True, False]), left.assign(a=[True, True])) == {
        "a": (1, None)
    }
    for longer, shorter in (
        (left, left.iloc[:1]),
        (pd.concat([left, left.iloc[:1]]), left),
    ):
        rows = {"a": (len(longer), None), "b": (len(longer), None)}
        assert compare(longer, shorter) == compare(shorter, longer) == rows
    assert (
        set(compare(left, left.drop(columns="b")))
        == set(compare(left.drop(columns="b"), left))
        == {"b"}
    )


def test_what_cannot_be_replayed_says_so(tmp_path):
    """A table of a fit carries its provenance, but a fit is not repeated."""
    origin = {"command": "fit", "settings": {}, "versions": {}}
    table = pa.table({"a": [1]}).replace_schema_metadata({"eqsim": json.dumps(origin)})
    pq.write_table(table, tmp_path / "fitted.parquet")
    done = call("replay", tmp_path / "fitted.parquet")
    assert done.exit_code == 2
    assert (
        "was written by `eqsim fit`; only tables of `eqsim run`, `eqsim fluctuations`"
        in done.stderr
    )
    assert done.stderr.count("\n") == 1


def test_bad_input_is_one_line(tmp_path):
    pd.DataFrame({"a": [1]}).to_parquet(tmp_path / "other.parquet")
    (tmp_path / "text.parquet").write_text("no table")
    os.mkfifo(tmp_path / "pipe.parquet")
    good = {"command": "run", "settings": {}, "versions": {}}
    for number, origin in enumerate(
        (
            {**good, "settings": None},
            {**good, "versions": []},
            {"command": "run"},
            [],
            "[" * 5000,
            good,
        )
    ):
        text = origin if isinstance(origin, str) else json.dumps(origin)
        table = pa.table({"a": [1]}).replace_schema_metadata({"eqsim": text})
        pq.write_table(table, tmp_path / f"{number}.parquet")
    for name, message in (
        *(
            (f"{number}.parquet", "that eqsim has written, or is damaged")
            for number in range(5)
        ),
        ("5.parquet", "its provenance is damaged (KeyError: 'folder')"),
        ("pipe.parquet", "is not a file"),
        ("absent.parquet", "cannot be read (No such file"),
        ("other.parquet", "is not a Parquet file that eqsim has written"),
        ("text.parquet", "is not a Parquet file that eqsim has written"),
    ):
        done = call("replay", tmp_path / name)
        assert done.exit_code == 2
        assert message in done.stderr
        assert done.stderr.count("\n") == 1
