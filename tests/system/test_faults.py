"""Whatever ends a command or stands in its way: nothing half-written, nobody left
behind, one clear line.

The kills at random moments, and what needs minutes, are in `pytest -m long`.
"""

import contextlib
import ctypes
import itertools
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner
from waiting import ALLOWED, once

import eqsim
from eqsim.cli.app import app
from eqsim.io import storage
from eqsim.sweeps.workers import Processes

EQSIM = "from eqsim.__main__ import main; main()"
# from the folder of the repository, where `analysis` is found
FIGURES = (
    f"import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r}); "
    "sys.argv.remove('figures'); from analysis.figures.__main__ import main; main()"
)
EAGER = (  # rows reach the disk at once
    "import eqsim.sweeps.scheduler as s, eqsim.sweeps.store as t; t._FLUSH_ROWS = 3; s._BATCH_SECONDS = 0.1; "
    + EQSIM
)
RUN = (
    '[contacts]\ncount = 500\nstiffness_law = "uniform"\n'
    "[drive]\nvelocity = 0.1\ndistance = 5\n[output]\npoints = 51\n"
)
SWEEP = (
    RUN
    + '[sweep]\n"thermal.kT" = { log = [0.03, 1.0, 20] }\n"delay.time" = { linear = [0.0, 1.0, 50] }\n'
)
WARM = "[thermal]\nkT = 0.05\n[delay]\ntime = 1.0\n[drive]\n"
TURNS = "{ velocity = 0.1, distance = 500.0 }, { velocity = -0.1, distance = 500.0 }"
LONGER = {  # run files of work that takes minutes, in mean field or for other contacts
    "warm": WARM
    + "velocity = 0.1\ndistance = 400.0\n[drive.stage]\nstiffness = 0.1\ndamping = 0.1\npreload = 7.5\n",
    "programme": WARM + f"programme = [{TURNS}]\n",
    "langevin": '[aging]\nrule = "langevin"\nrate = 0.3\nx_star_final = 2.0\n[drive]\nvelocity = 0.1\n',
    "elastic": "[drive]\nvelocity = 1.0\ndistance = 1000.0\n[elastic]\nblocks = 50\ncoupling = 20.0\n"
    "drive_stiffness = 0.25\n[output]\npoints = 11\nreplicas = 190\n",
}
RUNS = Path(__file__).parents[2] / "runs"
LONG = ("--set", "contacts.count=300000000", "--threads", "1")  # minutes
FILES = ["force.png", "summary.json", "trajectory.parquet"]
OVER = "eqsim: interrupted; nothing is half-written\n"
WORKERS = ("--workers", "2")
SLOWLY = ("--set", "drive.velocity=1e-4")


@pytest.fixture
def run_file(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(RUN)
    (tmp_path / "grid.toml").write_text(SWEEP)
    for name, text in LONGER.items():
        (tmp_path / f"{name}.toml").write_text(
            '[contacts]\ncount = 1000\nstiffness_law = "uniform"\n' + text
        )
    return path


def start(*args, code=None, limit=None, **options):
    """A command in a process group of its own, as a terminal or a batch system starts
    it."""
    code = code or (FIGURES if args[:1] == ("figures",) else EQSIM)
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True, preexec_fn=limit, **options,
    )  # fmt: skip


def ended(process, timeout=60):
    """Exit code, output and errors; nobody of its process group outlives it by more
    than 10 seconds."""
    output, errors = process.communicate(timeout=timeout)
    deadline = time.monotonic() + 10
    while group(process.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not group(process.pid)
    return process.returncode, output, errors


def group(leader):
    """The living processes of a group."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if (
                os.getpgid(process.pid) == leader
                and process.status() != psutil.STATUS_ZOMBIE
            ):
                found.append(process)
    return found


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


# ---- signals ----

SWALLOWED = """
import os, signal, sys, time
from eqsim.__main__ import main
from eqsim.cli.options import Changes

class Finaliser:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)

def work(*_):
    try:
        found = Finaliser()
        if sys.argv[1] == "info":
            del found  # Python reports and drops what is raised in __del__, as in callbacks of a compiler
        else:
            found.__del__()
    except BaseException:
        if sys.argv[1] == "reference":
            raise ImportError("initialization failed") from None
        print("swallowed", flush=True)
    time.sleep(60)

Changes.load = work
main()
"""


@pytest.mark.parametrize(
    ("command", "output"), [("info", ""), ("steady", "swallowed\n"), ("reference", "")]
)
def test_an_interrupt_that_is_lost_ends_the_process_all_the_same(command, output):
    """Lost in a finaliser, lost in a library that catches everything, or turned into
    another error by one."""
    assert ended(start(command, "a.toml", code=SWALLOWED), timeout=30) == (
        130,
        output,
        OVER,
    )


def test_ctrl_c_does_not_reach_a_worker_that_starts():
    """A terminal sends it to all; a worker is deaf from its first moment on, and its
    parent decides."""
    pool = Processes(1)
    try:
        future = pool.executor.submit(os.getpid)

        def done():
            for child in psutil.Process().children():
                if "spawn_main" in " ".join(child.cmdline()):
                    child.send_signal(signal.SIGINT)
            return future.done()

        once(done)
        assert future.result() != os.getpid()
    finally:
        pool.close(hurry=True)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.parametrize("hurry", [False, True])
def test_one_thread_is_asked_of_workers_alone(monkeypatch, hurry):
    """Libraries read these when they are loaded: what belongs to workers must not
    outlive them."""
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    before = dict(os.environ)
    pool = Processes(1)
    assert {
        os.environ[f"{name}_NUM_THREADS"] for name in ("OMP", "OPENBLAS", "MKL")
    } == {"1"}
    assert pool.executor.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
    pool.close(hurry)
    assert dict(os.environ) == before


def test_killed_workers_leave_no_thread_behind(monkeypatch):
    """Not even if there is more to send than a pipe holds and somebody tries to cancel
    it."""
    complaints, before = [], set(threading.enumerate())
    monkeypatch.setattr(threading, "excepthook", complaints.append)
    pool = Processes(1)
    futures = [pool.executor.submit(time.sleep, 60)] + [
        pool.executor.submit(len, bytes(10**6)) for _ in range(4)
    ]
    once(futures[1].running)  # and waits in the pipe
    for future in futures:
        future.cancel()
    for child in multiprocessing.active_children():
        child.kill()
        child.join()
    deadline = time.monotonic() + 10
    while set(threading.enumerate()) - before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert (complaints, set(threading.enumerate()) - before) == ([], set())
    pool.close(hurry=True)


@pytest.mark.long
def test_sigterm_ends_a_sweep_and_its_workers_and_a_second_sweep_is_refused(
    run_file, tmp_path
):
    grid, out = tmp_path / "grid.toml", tmp_path / "o"
    process = start("sweep", grid, "--out", out, *WORKERS, code=EAGER)
    once(lambda: [*(out / "parts").glob("part-*")], process)
    second = CliRunner().invoke(app, ["sweep", str(grid), "--out", str(out)])
    assert (second.exit_code, second.stderr) == (
        2,
        f"eqsim: --out {out}: another sweep is at work in this folder\n",
    )
    os.killpg(process.pid, signal.SIGTERM)
    code, _, errors = ended(process)
    assert code == 143
    said = re.fullmatch(
        r"eqsim: interrupted; (\d+) of 1000 points are on disk; the same command continues\n",
        errors,
    )
    assert said, errors
    assert sum(
        pq.read_metadata(part).num_rows for part in (out / "parts").iterdir()
    ) == int(said[1])


SLOW = (
    "import time; import eqsim.io.storage as t; w = t.as_parquet; t.as_parquet = lambda x: (time.sleep(0.2), w(x))[1]; "
    + EAGER
)


@pytest.mark.long
def test_a_sweep_interrupted_again_and_again_counts_what_is_on_disk(run_file, tmp_path):
    """Impatience, or `timeout`, which sends its signal to the leader and to the group;
    writing takes its time."""
    out = tmp_path / "o"
    process = start("sweep", tmp_path / "grid.toml", "--out", out, *WORKERS, code=SLOW)
    once(lambda: [*(out / "parts").glob("part-*")], process)
    os.killpg(process.pid, signal.SIGINT)
    for gap in (0.0, 0.1, 0.1, 0.1):
        time.sleep(gap)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
    code, _, errors = ended(process)
    said = re.fullmatch(
        r"eqsim: interrupted; (\d+) of 1000 points are on disk; the same command continues\n",
        errors,
    )
    assert said, errors
    assert code == 130
    assert sum(
        pq.read_metadata(part).num_rows for part in (out / "parts").iterdir()
    ) == int(said[1])


def test_a_signal_while_modules_are_imported(tmp_path):
    (tmp_path / "typer.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"
    )
    code = "import runpy; runpy.run_module('eqsim', run_name='__main__')"
    process = start("--help", code=code, env=os.environ | {"PYTHONPATH": str(tmp_path)})
    assert ended(process, timeout=30) == (130, "", OVER)


COMMANDS = {
    "run": ("run", "a.toml", "--out", "o", *LONG),
    "run --workers": ("run", "a.toml", "--out", "o", *LONG, *WORKERS),
    "steady": ("steady", "a.toml", "--rel-error", "1e-9", "--max-lives", "1e15"),
    "validate": ("validate", "full", "--out", "o"),
    "sweep": ("sweep", "grid.toml", "--out", "o", *WORKERS),
    "figures": ("figures", "--out", "o", *WORKERS),
    "replay": ("replay", "made/trajectory.parquet"),
    "steady, fluctuating": (
        "steady",
        "langevin.toml",
        "--rel-error",
        "1e-7",
        "--max-lives",
        "1e15",
    ),
    "run with a stage": ("run", "warm.toml", "--out", "o"),
    "reference with a stage": ("reference", "warm.toml", "--transient"),
    "reference of a programme": ("reference", "programme.toml", "--transient"),
    "stability": ("stability", "warm.toml", "--critical", *SLOWLY),
    "borders": ("stability", "warm.toml", "--critical", "--out", "o", *SLOWLY),
    "elastic": ("run", "elastic.toml", "--out", "o"),
    "fit": (
        "fit",
        str(RUNS / "fit-synthetic.toml"),
        "--out",
        "o",
        "--starts",
        "500",
        *WORKERS,
    ),
    "fit of a record": (
        "fit",
        str(RUNS / "fit-basalt-step.toml"),
        "--out",
        "o",
        "--workers",
        "1",
    ),
    "fit, posterior": (
        "fit",
        str(RUNS / "fit-synthetic.toml"),
        "--out",
        "o",
        "--starts",
        "1",
        "--posterior",
        *WORKERS,
    ),
}


# Commands that read what there is, or solve a few equations: not interrupted here.
SHORT = {
    *("design", "export", "fluctuations", "info", "keys", "material", "new", "plot"),
    "rsf",
}


def test_no_command_is_forgotten():
    long = {words[0] for words in COMMANDS.values()}
    assert sorted([*long, *SHORT]) == sorted(
        info.callback.__name__ for info in app.registered_commands
    )


@pytest.mark.long
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_one_signal_at_any_moment_ends_any_command(run_file, tmp_path, command, number):
    """Twelve moments of the first six seconds, to the whole process group or to its
    leader."""
    if command == "replay":
        long_table(tmp_path / "made")
    moments = [0.3 * 1.3**turn for turn in range(12)]
    for turn, moment in enumerate(moments):
        process = start(*COMMANDS[command], cwd=tmp_path)
        time.sleep(moment)
        assert process.poll() is None, process.communicate()
        (os.kill if turn % 2 else os.killpg)(process.pid, number)
        code, output, errors = ended(process, ALLOWED)
        assert code == 128 + number
        assert re.fullmatch(r"eqsim: interrupted; .*\n", errors), errors
        # to go
        assert (
            command == "sweep"
            or output == ""
            or (command == "steady" and output.startswith("about "))
            or command.startswith("fit")  # estimates
        )
        if command == "sweep":
            assert {name.split("/")[0] for name in names(tmp_path / "o")} <= {
                "_lock",
                "_sweep.json",
                "parts",
            }
        elif command.startswith("fit"):  # goes on with finished fits
            kept = {name.partition("/")[0] for name in names(tmp_path / "o")}
            kept -= {"fit.json", "fitted.parquet", "run.toml"}
            if command == "fit, posterior":  # all but the posterior may be there
                kept -= {"fit.png", "identifiability.png"}
                kept -= {"profiles.parquet", "profiles.png"}
            assert all(name.startswith(".unfinished-") for name in kept)
            assert not any(".eqsim-" in name for name in names(tmp_path / "o"))
        elif command == "figures":  # each is whole as soon as its points are there
            assert {name.partition(".")[2] for name in names(tmp_path / "o")} <= {
                "pdf",
                "png",
                "parquet",
            }
        else:
            assert not (tmp_path / "o").exists()


def long_table(folder):
    """A table that says it was made by a run of minutes."""
    file = eqsim.load(folder.parent / "a.toml", {"contacts.count": 300_000_000})
    folder.mkdir()
    content = storage.parquet(
        {"X": [0.0]}, storage.provenance("run", file.settings, RUN, 1, folder)
    )
    (folder / "trajectory.parquet").write_bytes(content)


# ---- SIGKILL ----

DIES = """
import os, signal, sys
from pathlib import Path
from eqsim.io import storage

def deadly(call):
    def dies(*args, **kwargs):
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return call(*args, **kwargs)
    return dies

def write(out):
    for name in ("fsync", "replace", "mkdir", "rmdir", "unlink", "open", "close"):
        setattr(os, name, deadly(getattr(os, name)))
    storage.publish(out, {"a": b"new a", "b": b"new b"})
    storage.save(out / "c", b"new c")
    os._exit(0)

for line in sys.stdin:
    left, out = [int(line)], sys.stdin.readline().strip()
    process = os.fork() or write(Path(out))
    print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
"""


def test_killed_at_every_step_of_writing(tmp_path):
    """A file has its old content or its new one, whichever call to the system was the
    last, and a repeat works."""
    writer = subprocess.Popen(
        [sys.executable, "-c", DIES],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    kills = 0
    for turn, known in itertools.product(range(200), (False, True)):
        out = tmp_path / f"{turn} {known}"
        out.mkdir()
        if known:
            for name in "abc":
                (out / name).write_text(f"old {name}")
        print(f"{turn}\n{out}", file=writer.stdin, flush=True)
        code = int(writer.stdout.readline())
        found = {
            path.name: path.read_text()
            for path in out.iterdir()
            if not path.name.startswith(".eqsim-")
        }
        assert all(
            text in (f"new {name}", f"old {name}") for name, text in found.items()
        )
        if code == 0:
            assert found == {name: f"new {name}" for name in "abc"}
            break
        assert code == -signal.SIGKILL
        kills += 1
        storage.publish(out, {"a": b"again", "b": b"again"})
        assert {(out / name).read_text() for name in "ab"} == {"again"}
    writer.communicate()
    assert kills > 16


def test_anyone_can_read_what_is_written(tmp_path):
    """Temporary files are private until they have their names; others use the results."""
    before = os.umask(0o022)
    try:
        storage.save(tmp_path / "one", b"1")
        storage.publish(tmp_path / "new" / "folder", {"two": b"2", "three": b"3"})
    finally:
        os.umask(before)
    for name in ("one", "new/folder/two", "new/folder/three"):
        assert (tmp_path / name).stat().st_mode & 0o777 == 0o644
    assert (tmp_path / "new" / "folder").stat().st_mode & 0o777 == 0o755


@pytest.mark.long
def test_a_sweep_clears_what_a_killed_command_has_left(run_file, tmp_path):
    out = tmp_path / "o"
    (out / ".eqsim-folder").mkdir(parents=True)
    (out / ".eqsim-folder" / "force.png").write_bytes(b"half")
    (out / ".eqsim-file").write_bytes(b"half")
    run_file.write_text(RUN + '[sweep]\n"thermal.kT" = [0.1]\n')
    done = CliRunner().invoke(
        app, ["sweep", str(run_file), "--out", str(out), "--workers", "1"]
    )
    assert done.exit_code == 0, done.output
    assert names(out) == ["_lock", "_sweep.json", "sweep.parquet"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "files", "kills", "longest"),
    [
        (("run", "a.toml", "--out", "o"), FILES, 25, 4.0),
        (("run", "a.toml", "--out", "o", *WORKERS), FILES, 10, 7.0),
        (("figures", "A05", "--quick", "--out", "o", *WORKERS), ["A05.parquet", "A05.pdf", "A05.png"], 10, 12.0),
    ],
)  # fmt: skip
def test_killed_at_any_moment(run_file, tmp_path, command, files, kills, longest):
    """Whatever is there is whole, workers go too, and the next one is not disturbed."""
    whole = {}
    assert ended(start(*command, cwd=tmp_path), timeout=300)[0] == 0
    for name in files:
        whole[name] = (tmp_path / "o" / name).read_bytes()
    rng = random.Random(1)
    for _ in range(kills):
        shutil.rmtree(tmp_path / "o", ignore_errors=True)
        process = start(*command, cwd=tmp_path)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(rng.uniform(0, longest))
        process.kill()
        ended(process)
        for name in names(tmp_path / "o"):
            if not name.startswith(".eqsim-"):
                assert (
                    name == "summary.json"
                    or (tmp_path / "o" / name).read_bytes() == whole[name]
                )
    code, _, errors = ended(start(*command, cwd=tmp_path), timeout=300)
    assert (code, errors) == (0, "")
    assert set(files) <= set(names(tmp_path / "o"))


@pytest.mark.long
@pytest.mark.parametrize("command", ["run --workers", "figures"])
def test_a_killed_worker_ends_what_cannot_go_on_without_it(run_file, tmp_path, command):
    process = start(*COMMANDS[command], cwd=tmp_path)
    workers = once(
        lambda: [
            c for c in group(process.pid) if "spawn_main" in " ".join(c.cmdline())
        ],
        process,
    )
    workers[0].kill()
    code, output, errors = ended(process)
    assert (code, output) == (2, "")
    assert re.fullmatch(
        r"eqsim: --workers: a worker was lost, perhaps for want of memory .*\n", errors
    )
    assert not (tmp_path / "o").exists()


# ---- places that cannot be used ----


def powerless():
    """Drop what lets the superuser write anywhere (CAP_DAC_OVERRIDE,
    CAP_DAC_READ_SEARCH); others have not got it."""
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


def small_files():
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.long
def test_no_home_and_no_temporary_folder(run_file, tmp_path):
    home = {
        "HOME": "/dev/null",
        "XDG_CACHE_HOME": "/dev/null",
        "TMPDIR": "/nowhere",
        "MPLCONFIGDIR": str(tmp_path),
    }
    process = start(
        "run", run_file, "--out", tmp_path / "o", "--quiet", env=os.environ | home
    )
    assert ended(process) == (0, "", "")
    assert names(tmp_path / "o") == FILES


@pytest.mark.long
def test_a_sweep_on_a_full_disk_names_the_file(run_file, tmp_path):
    """Rows that were written before remain; the rest is one line."""
    out = tmp_path / "o"
    process = start(
        "sweep",
        tmp_path / "grid.toml",
        "--out",
        out,
        "--workers",
        "1",
        "--quiet",
        code=EAGER,
        limit=small_files,
    )
    code, output, errors = ended(process)
    assert (code, output) == (2, "")
    assert re.fullmatch(
        rf"eqsim: {re.escape(str(out))}/.*: cannot be written \(File too large\)\n",
        errors,
    )
    assert not [name for name in names(out) if ".eqsim-" in name]


# Whether output is written when it is printed or at the end: what a shell starts does
# the latter, unless it is told not to.
AT_ONCE = pytest.mark.parametrize(
    "at_once", [False, True], ids=["at the end", "at once"]
)


def run_with(output, command, at_once, folder):
    """Exit code and messages of a command whose output goes to `output`."""
    done = subprocess.run(
        [sys.executable, *["-u"] * at_once, "-c", EQSIM, *command],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": ""},
        stdout=output,
        stderr=subprocess.PIPE,
        text=True,
    )
    return done.returncode, done.stderr


@AT_ONCE
@pytest.mark.parametrize(
    "command",
    [
        ("info", "a.toml", "--json"),
        pytest.param(("info", "a.toml"), marks=pytest.mark.long),
        pytest.param(("--help",), marks=pytest.mark.long),
    ],
)
def test_output_that_cannot_be_written(run_file, tmp_path, command, at_once):
    with open("/dev/full", "w") as full:
        assert run_with(full, command, at_once, tmp_path) == (
            2,
            "eqsim: file system: No space left on device\n",
        )


@AT_ONCE
@pytest.mark.parametrize(
    "command",
    [
        ("info", "a.toml", "--json"),
        pytest.param(("steady", "a.toml"), marks=pytest.mark.long),
        pytest.param(("--help",), marks=pytest.mark.long),
    ],
)
def test_reader_that_has_left(run_file, tmp_path, command, at_once):
    """As with `eqsim ... | head`: nothing is wrong, and nobody listens."""
    unread, output = os.pipe()
    os.close(unread)
    try:
        assert run_with(output, command, at_once, tmp_path) == (0, "")
    finally:
        os.close(output)


def test_output_that_is_closed(run_file, tmp_path):
    done = subprocess.run(
        [
            "sh",
            "-c",
            'exec "$@" >&-',
            "sh",
            sys.executable,
            "-c",
            EQSIM,
            "info",
            run_file,
        ],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("command", ["info", "run"])
def test_a_run_file_without_an_end(tmp_path, command):
    done = CliRunner().invoke(app, [command, "/dev/zero"])
    assert (done.exit_code, done.stderr) == (
        2,
        "eqsim: /dev/zero: is longer than 1e+07 characters; a run file is not\n",
    )


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_a_device_is_no_folder(tmp_path, run_file, command):
    done = CliRunner().invoke(
        app, [command, str(tmp_path / "grid.toml"), "--out", "/dev/full"]
    )
    assert (done.exit_code, done.stderr) == (
        2,
        "eqsim: --out /dev/full: /dev/full is not a folder\n",
    )


@pytest.mark.long
def test_nothing_can_be_written_but_the_results(run_file, tmp_path):
    """A package, a home and a cache that are read-only: kernels are compiled for this
    one run."""
    package = tmp_path / "package"
    shutil.copytree(
        Path(eqsim.__file__).parent,
        package / "eqsim",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    sealed = [package, *(path for path in package.rglob("*") if path.is_dir())]
    for folder in sealed:
        folder.chmod(0o500)
    home = {
        "HOME": str(package),
        "XDG_CACHE_HOME": str(package),
        "PYTHONPATH": str(package),
        "NUMBA_CACHE_DIR": str(package),
    }
    home |= {"MPLCONFIGDIR": str(tmp_path)}
    code = (
        "from eqsim.numerics.kernel_folder import kernel_folder as f; assert f() is None, f(); "
        + EQSIM
    )
    process = start(
        "steady",
        run_file,
        code=code,
        limit=powerless,
        env=os.environ | home,
        cwd=tmp_path,
    )
    try:
        code, output, errors = ended(process, timeout=300)
        assert (code, errors) == (0, "")
        assert "friction" in output
        process = start(
            "run",
            run_file,
            "--out",
            package / "o",
            limit=powerless,
            env=os.environ | home,
            cwd=tmp_path,
        )
        said = f"eqsim: --out {package / 'o'}: cannot be written (Permission denied)\n"
        assert ended(process, timeout=300) == (2, "", said)
    finally:
        for folder in sealed:
            folder.chmod(0o700)
