"""Bad input in bulk: whatever a user gives is used, or refused in one clear line that
names the field. Never a traceback, a hang, a file half-written, or a number that is
none."""

import contextlib
import datetime
import errno
import io
import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import call
from rows import BASIC

from eqsim import InputError, load, reference, steady
from eqsim.engine.trajectory import check_run
from eqsim.io.parameters import keys
from eqsim.io.tables import read_thresholds
from eqsim.model.groups import groups
from eqsim.sweeps.plan import Plan

SECONDS = 60  # for one case; the slowest takes a few on a loaded machine
LONGEST = 600  # characters of a message beyond those of the path
WORDS = {word for key in keys() for word in key.split(".")} | {
    "sweep",
    "max_lives",
    "--max-lives",
    "title",
}
EQSIM = [sys.executable, "-c", "from eqsim.__main__ import main; main()"]
FASTEST = 100.0  # alpha of `langevin` aging: a life takes as many steps, and a kernel cannot be interrupted
CHEAP = 65_536  # lives of the first attempt of `steady`


@contextlib.contextmanager
def limited(seconds=SECONDS):
    """A hang fails the test."""

    def stop(*_):
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def judge(message, path):
    """One printable line that names the file or the field."""
    assert message, "an empty message"
    assert message.isprintable(), message
    assert len(message) < LONGEST + 2 * len(str(path)), message
    words = re.findall(r"--[a-z-]+|\w+", message)
    named = (
        str(path) in message
        or ": unknown key; " in message
        or not WORDS.isdisjoint(words)
    )
    assert named, f"names no field: {message}"


# ---- run files ----


def toml(value):
    """A value as TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        # as Python prints no more
        return str(value) if abs(value) < 10**4000 else f"0x{abs(value):x}"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(
                f"{json.dumps(key)} = {toml(part)}" for key, part in value.items()
            )
            + "}"
        )
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return repr(value)


def document(data):
    """A run file as text."""
    lines = [
        f"{json.dumps(key)} = {toml(value)}"
        for key, value in data.items()
        if not isinstance(value, dict)
    ]
    for section, content in data.items():
        if isinstance(content, dict):
            lines += [f"[{json.dumps(section)}]"]
            lines += [
                f"{json.dumps(key)} = {toml(value)}" for key, value in content.items()
            ]
    return "\n".join(lines) + "\n"


def sensible(rng):
    """A run file that can be used."""
    law = rng.choice(["gamma", "gamma", "gamma", "delta", "table"])
    thresholds = {"law": law}
    if law == "table":
        thresholds["file"] = "good.csv"
    else:
        thresholds["x_star"] = rng.choice([1.0, 1e-9, 1e6, 0.3])
    if law == "gamma":
        thresholds["n"] = rng.choice([0.0, 1.0, 2.5])
    data = {
        "title": rng.choice(["", "a", "β (é)"]),
        "disorder": rng.choice(["quenched", "annealed"]),
        "contacts": {
            "count": rng.choice([10, 1e3, 1000]),
            "stiffness": rng.choice([1.0, 1e3]),
            "stiffness_law": rng.choice(["sqrt", "uniform"]),
        },
        "thresholds": thresholds,
        "thermal": {
            "kT": rng.choice([0.0, 0.1, 1e-9]),
            "attempt_frequency": rng.choice([0.0, 1.0]),
        },
        "delay": {
            "time": rng.choice([0.0, 2.0]),
            "law": rng.choice(["fixed", "exponential"]),
        },
        "viscosity": {"eta": rng.choice([0.0, 1.0])},
        "drive": {
            "velocity": 10 ** rng.uniform(-3, 3),
            "start": rng.choice(["fresh", "stationary"]),
        },
        "output": {
            "points": 11,
            "seed": rng.randrange(2**40),
            "replicas": rng.choice([1, 2]),
        },
        "sweep": {"drive.velocity": [0.1, 1.0]},
    }
    data["thermal"]["barrier"] = rng.choice(["soft", "stiff"])
    if law == "gamma" and rng.random() < 0.3:
        rule = rng.choice(["flow", "langevin"])
        final = thresholds["x_star"] * rng.choice([0.5, 1.0, 2.0])
        data["aging"] = {"rule": rule, "rate": 0.1 * final**2, "x_star_final": final}
    elif data["disorder"] == "quenched" and rng.random() < 0.3:
        data["aging"] = {
            "rule": "logarithmic",
            "beta": rng.choice([0.0, 0.05, 2.0]),
            "cutoff_time": 0.1,
        }
    for name in list(data):
        if rng.random() < 0.2 and name not in (
            "drive",
            "thresholds",
            "output",
            "contacts",
        ):
            del data[name]
    return data


def magnitude(rng):
    """A number of any size."""
    special = [
        0,
        0.0,
        -0.0,
        math.nan,
        math.inf,
        -math.inf,
        1e308,
        -1e308,
        5e-324,
        1e-310,
        1e100,
        1e-100,
        1e16,
        1e-16,
    ]
    special += [2**31, 2**53 + 1, 2**63 - 1, 2**63, -(2**63), 10**18, 1.5, -1, True]
    return rng.choice(
        [
            lambda: rng.choice(special),
            lambda: rng.choice([-1, 1, 1, 1]) * 10.0 ** rng.uniform(-320, 308),
            lambda: 10.0 ** rng.uniform(-12, 12),
            lambda: 10.0 ** rng.uniform(-110, 110),
            lambda: 10 ** rng.randrange(1, 40),
            lambda: rng.choice([-1, 1]) * 10 ** rng.choice([308, 309, 400, 3999, 5000]),
        ]
    )()


def anything(rng):
    """A value of any type."""
    moment = datetime.datetime(1979, 5, 27, 7, 32, tzinfo=datetime.UTC)
    odd = [
        "",
        "many",
        "1.0",
        "é\u0000\u001b[31m\n",
        "x" * 3000,
        "inf",
        "../..",
        "/",
        "good.csv",
        "gamma",
        "sqrt",
        "flow",
    ]
    odd += [
        True,
        [],
        [1.0],
        [[1.0], "a"],
        {},
        {"a": 1},
        {"kT": 1.0},
        moment,
        moment.date(),
        moment.time(),
    ]
    return magnitude(rng) if rng.random() < 0.5 else rng.choice(odd)


def misspelt(name, rng):
    """A near miss."""
    at = rng.randrange(len(name))
    return rng.choice(
        [
            name[:at] + name[at + 1 :],
            name[:at] + rng.choice("aeX _.é\n") + name[at:],
            name[:at] + name[at:][::-1],
            name.upper(),
            name + "s",
            " " + name,
        ]
    )


def mutate(data, rng):
    """Change something about the content."""
    section = rng.choice(list(data)) if data else "drive"
    content = data.get(section)
    inside = isinstance(content, dict) and content and rng.random() < 0.9
    place, key = (content, rng.choice(list(content))) if inside else (data, section)
    kind = rng.choice(
        ["scale"] * 6
        + ["number", "number", "number", "type", "name", "move", "add", "drop", "any"]
    )
    if kind == "scale":  # plausible in type, not in size
        floats = [
            name.split(".")
            for name, type_ in keys().items()
            if type_ is float and name != "thresholds.n"
        ]
        widest = rng.choice([3, 30, 110])
        for home, last in rng.sample(floats, rng.choice([1, 2, 4])):
            if isinstance(data.get(home), dict) and isinstance(
                data[home].get(last, 1.0), int | float
            ):
                data[home][last] = 10.0 ** rng.uniform(-widest, widest)
    elif kind in ("number", "type"):
        place[key] = magnitude(rng) if kind == "number" else anything(rng)
    elif kind == "name":
        place[misspelt(key, rng)] = place.pop(key)
    elif kind == "move":
        target = data.get(rng.choice(list(data)))
        (target if isinstance(target, dict) else data)[key] = place.pop(key)
    elif kind == "add":
        name = rng.choice(list(keys()))
        home, _, last = name.rpartition(".")
        part = data.setdefault(home, {}) if home else data
        (part if isinstance(part, dict) else data)[last] = anything(rng)
    elif kind == "drop":
        place.pop(key, None)
    else:
        data[rng.choice([*data, "", "a.b", "sweep"])] = anything(rng)


def damage(text, rng):
    """The same as bytes, with something wrong about them."""
    whole = text.encode()
    at = rng.randrange(len(whole) + 1)
    nest = rng.choice([5, 20, 200, 3000])
    return rng.choice(
        [
            lambda: whole[:at],
            lambda: text.encode("latin-1", "replace") + b"# \xe9\xff",
            lambda: text.encode("utf-16"),
            lambda: b"\xef\xbb\xbf" + whole,
            lambda: whole[:at] + b"\0" + whole[at:],
            lambda: (
                whole[:at] + bytes(rng.randrange(256) for _ in range(4)) + whole[at:]
            ),
            lambda: whole.replace(b"\n", rng.choice([b"\r\n", b"\r", b"\n\n", b""])),
            lambda: b"a = " + b"[" * nest + b"]" * nest + b"\n" + whole,
            lambda: (
                b".".join([rng.choice([b"sweep", b"a", b"drive"]), *[b"a"] * nest])
                + b" = 1\n"
                + whole
            ),
            lambda: whole + b"[sweep.x]\ny = " + b"{a = " * nest + b"1" + b"}" * nest,
            lambda: whole + whole,
            lambda: b"" if rng.random() < 0.5 else b"\n# nothing\n",
            lambda: whole + b"n = " + b"9" * rng.choice([20, 4000, 5000]),
            lambda: whole.replace(b"=", b"", 1),
        ]
    )()


def case(rng):
    """The bytes of a run file, most of them wrong in one or a few ways."""
    data = sensible(rng)
    for _ in range(rng.choice([0, 1, 1, 1, 2, 4])):
        mutate(data, rng)
    text = document(data)
    return damage(text, rng) if rng.random() < 0.25 else text.encode()


def finite(*values):
    return all(value is not None and math.isfinite(value) for value in values)


def endless(ensemble, drive):
    """Fluctuating thresholds whose lives take the engine too many steps for a suite of
    thousands."""
    aging = ensemble.aging
    if aging.rule != "langevin" or ensemble.disorder == "annealed":
        return False
    return FASTEST < aging.alpha(ensemble.thresholds.scale, drive.velocity) <= 1e6


def use(path):
    """What `eqsim info` and the beginning of `eqsim run` do with a run file."""
    file = load(path)
    ensemble, drive = file.ensemble, file.drive
    if endless(ensemble, drive):
        return file, ensemble, None
    for group in groups(ensemble, drive):
        assert isinstance(group.value, str) or not math.isnan(group.value), group
    lives = check_run(ensemble, drive, file.output, 1e10)
    assert 0 < lives <= 1e10
    return file, ensemble, drive


def solve(ensemble, drive):
    """Both answers, or InputError; every number is one."""
    found = steady(ensemble, drive, rel_error=0.05, max_lives=CHEAP)
    for name in BASIC:
        e = getattr(found, name)
        assert finite(e.value, e.stderr), (name, e)
        assert e.value >= 0, (name, e)
        assert e.stderr >= 0, (name, e)
    assert found.pinned.value <= 1
    exact = reference(ensemble, drive)
    for name in (*BASIC, "f_k"):
        e = getattr(exact, name)
        assert finite(e.value, e.stderr), (name, e)
        assert e.value >= 0, (name, e)
        assert e.stderr >= 0, (name, e)
    assert exact.pinned.value <= 1
    return found, exact


def agree(found, exact):
    """Within six joint standard errors and 1e-6: events of less than that share, worth
    as much, may not be drawn."""
    for name in BASIC:
        one, other = getattr(found, name), getattr(exact, name)
        if one.reliable:
            far = abs(one.value - other.value)
            assert far <= 6 * math.hypot(one.stderr, other.stderr) + 1e-6 * abs(
                other.value
            ), (name, one, other)


def fuzz(folder, seeds, solved):
    """Cases by outcome; `solved` of those that are accepted are computed."""
    (folder / "good.csv").write_text("threshold\n1.0\n0.5\n2.0\n0.5\n")
    path = folder / "run file é.toml"
    outcomes = dict.fromkeys(("refused", "used", "solved", "not solved"), 0)
    for seed in seeds:
        rng = random.Random(seed)
        path.write_bytes(case(rng))
        stage = "refused"
        try:
            with limited(), warnings.catch_warnings():
                # a warning is a second line on standard error
                warnings.simplefilter("error")
                _, ensemble, drive = use(path)
                outcomes["used"] += 1
                if (
                    drive
                    and outcomes["solved"] + outcomes["not solved"] < solved
                    and ensemble.aging.rule != "langevin"
                ):
                    stage = "not solved"
                    found, exact = solve(ensemble, drive)
                    agree(found, exact)
                    outcomes["solved"] += 1
        except InputError as error:
            judge(str(error), path)
            outcomes[stage] += 1
        except Exception as error:
            error.add_note(f"seed {seed}: {path.read_bytes()[:3000]!r}")
            raise
    return outcomes


@pytest.mark.long  # 9 s: the default suite has to end in time on a machine that others use as well
def test_run_files(tmp_path):
    outcomes = fuzz(tmp_path, range(200), solved=6)
    # neither all is refused nor all taken
    assert min(outcomes["refused"], outcomes["used"], outcomes["solved"]) >= 6


@pytest.mark.long
def test_many_run_files(tmp_path):
    outcomes = fuzz(tmp_path, range(1000, 6000), solved=250)
    assert min(outcomes["refused"], outcomes["used"], outcomes["solved"]) >= 200


def test_the_judge_is_strict(tmp_path):
    """What must not pass for a clear line does not."""
    for bad in ("", "kT\nis bad", "something is wrong", "kT \x1b[31m", "kT" * LONGEST):
        with pytest.raises(AssertionError):
            judge(bad, tmp_path)
    with pytest.raises(TimeoutError), limited(0.05):
        time.sleep(10)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "[contacts]\ncount = 0x" + "f" * 5000,
            "contacts.count = about 1e6020: must be an integer",
        ),
        (
            "[drive]\nvelocity = 0x" + "f" * 5000,
            "drive.velocity = about 1e6020: must be a valid number",
        ),
        (
            "[contacts]\ncount = 1e308",
            "contacts.count = about 1e308: must be an integer from 1",
        ),
        (".".join(["a"] * 3000) + " = 1", "a: unknown key"),
        ('"a\\nb" = 1', "a\\nb: unknown key"),
        ("sweep." + ".".join(["a"] * 300) + " = 1", "is nested too deep"),
        (
            '[sweep]\n"drive.velocity" = [1979-05-27]',
            "sweep.drive.velocity = datetime.date(1979, 5, 27): must be",
        ),
        (
            "[sweep]\nx = 0x" + "f" * 5000,
            "sweep.x = about 1e6020: must be numbers or text",
        ),
        ('title = "' + "a" * 10_000 + '"', "must have at most 200 characters"),
    ],
)
def test_once_a_traceback(tmp_path, content, message):
    """Found by this suite: integers that Python does not print, endless nesting, what
    JSON cannot hold."""
    path = tmp_path / "run.toml"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        _ = load(path).ensemble
    assert message in str(caught.value)
    judge(str(caught.value), path)


def test_a_byte_order_mark_is_no_error(tmp_path):
    path = tmp_path / "run.toml"
    path.write_bytes(b"\xef\xbb\xbf[drive]\nvelocity = 1.0\n")
    assert load(path)["drive.velocity"] == 1.0


# ---- threshold tables ----


def table_case(rng):
    """The bytes of a threshold table."""
    odd = [
        "",
        " ",
        "soft",
        "-1",
        "0",
        "nan",
        "inf",
        "1e400",
        "1e-400",
        "1e300",
        "1_0",
        "1,5",
        '"2"',
        '"2',
        "0x10",
        "١",
    ]
    odd += [
        "9" * 500,
        "1e-90",
        "1e90",
        "\u0000",
        "é",
        "1;2",
        "'1'",
        "1\t2",
        "x" * 200_000,
    ]
    values = [repr(10 ** rng.uniform(-2, 2)) for _ in range(rng.choice([0, 1, 3, 50]))]
    for _ in range(rng.choice([0, 1, 1, 2])):
        values.insert(rng.randrange(len(values) + 1), rng.choice(odd))
    head = rng.choice(
        ["threshold"] * 6
        + ["Threshold", "xi", "", '"threshold"', " threshold ", "threshold,threshold"]
    )
    end = rng.choice(["\n", "\r\n", "\r"])
    text = end.join([head, *values]) + rng.choice(["", end])
    if rng.random() < 0.2:
        text = end.join(
            f"{index},{value}" for index, value in enumerate(["a," + head, *values])
        ).removeprefix("0,")
    whole = text.encode(
        rng.choice(["utf-8"] * 6 + ["utf-8-sig", "utf-16", "latin-1"]), "replace"
    )
    if rng.random() < 0.1:
        at = rng.randrange(len(whole) + 1)
        whole = (
            whole[:at]
            + bytes(rng.randrange(256) for _ in range(rng.choice([0, 3])))
            + whole[at + 2 :]
        )
    return whole


def fuzz_tables(folder, seeds):
    read = 0
    for seed in seeds:
        path = folder / f"x é {seed}.csv"
        path.write_bytes(table_case(random.Random(seed)))
        try:
            with limited():
                steps = read_thresholds(path).steps
        except InputError as error:
            judge(str(error).partition("thresholds.file")[2], path)
        else:
            read += 1
            assert steps.size
            assert finite(*steps)
            assert steps[0] > 0
    return read


def test_threshold_tables(tmp_path):
    assert 50 < fuzz_tables(tmp_path, range(400)) < 350


@pytest.mark.long
def test_many_threshold_tables(tmp_path):
    assert 200 < fuzz_tables(tmp_path, range(1000, 3000)) < 1800


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "threshold\n1,5\n2,5\n",
            "line 2: more values than columns (a decimal comma?)",
        ),
        ("threshold,threshold\n1,2\n", '2 columns "threshold"'),
        ("threshold\n1_5\n", "'1_5' must be a finite number"),
        ('threshold\n1\n"2\n', "line 3: '\"2' is no cell; a quote must be closed"),
        ("threshold\n1e-40\n1\n", "x.csv: threshold table: spans"),
        ("a\x1b[31mb,c\n", "found a\\x1b[31mb"),
    ],
)
def test_tables_once_misread(tmp_path, content, message):
    path = tmp_path / "x.csv"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_thresholds(path)
    assert message in str(caught.value)
    judge(str(caught.value), path)


def test_a_table_that_is_no_file(tmp_path):
    """A pipe nobody writes to, a device without end, links to nowhere and to
    themselves."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "circular").symlink_to("circular")
    for path in (
        tmp_path / "pipe",
        Path("/dev/zero"),
        tmp_path / "dangling",
        tmp_path / "circular",
        tmp_path,
    ):
        with limited(10), pytest.raises(InputError) as caught:
            read_thresholds(path)
        judge(str(caught.value), path)


# ---- points files ----

POINTS_RUN = '[contacts]\ncount = 10\n[drive]\nvelocity = 1.0\ndistance = 2.0\n[sweep]\nfile = "points.parquet"\n'


def points_case(rng):
    """The bytes of a points file."""
    names = [rng.choice(list(keys())) for _ in range(rng.choice([1, 2, 3]))]
    if rng.random() < 0.3:
        names[0] = misspelt(names[0], rng)
    rows = rng.choice([0, 1, 2, 3])
    moment = datetime.datetime(2001, 2, 3, tzinfo=datetime.UTC)
    makers = [
        lambda: pa.array(
            [
                rng.choice([None, math.nan, math.inf, 0.5, -1.0, 1e308])
                for _ in range(rows)
            ],
            pa.float64(),
        ),
        lambda: pa.array([rng.uniform(0.1, 1.0) for _ in range(rows)]),
        lambda: pa.array([rng.randrange(1, 9) for _ in range(rows)], pa.int8()),
        lambda: pa.array(
            [rng.choice(["quenched", "", "é", None]) for _ in range(rows)], pa.string()
        ),
        lambda: pa.array([b"\xff"] * rows, pa.binary()),
        lambda: pa.array([moment] * rows),
        lambda: pa.array([[1.0]] * rows, pa.list_(pa.float64())),
        lambda: pa.array([{"a": 1}] * rows, pa.struct([("a", pa.int64())])),
        lambda: pa.array([None] * rows, pa.null()),
        lambda: pa.array(["a"] * rows).dictionary_encode(),
        lambda: pa.array(
            [rng.uniform(0.1, 1.0) for _ in range(rows)], pa.float64()
        ).cast(pa.float32()),
    ]
    # names may repeat
    table = pa.Table.from_arrays([rng.choice(makers)() for _ in names], names)
    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    whole = buffer.getvalue()
    at = rng.randrange(len(whole))
    return rng.choice(
        [
            *[lambda: whole] * 6,
            lambda: whole[:at],
            lambda: whole[:at] + bytes([rng.randrange(256)]) + whole[at + 1 :],
            lambda: b"",
            lambda: b"drive.velocity\n1.0\n2.0\n",  # CSV
        ]
    )()


def fuzz_points(folder, seeds):
    run, path = folder / "run.toml", folder / "points.parquet"
    run.write_text(POINTS_RUN)
    file, planned = load(run), 0
    for seed in seeds:
        path.unlink(missing_ok=True)
        path.write_bytes(points_case(random.Random(seed)))
        try:
            with limited():
                plan = Plan(file)
        except InputError as error:
            judge(str(error), path)
        except Exception as error:
            error.add_note(f"seed {seed}")
            raise
        else:
            planned += plan.size > 0
    return planned


def test_points_files(tmp_path):
    assert 2 < fuzz_points(tmp_path, range(200)) < 190


@pytest.mark.long
def test_many_points_files(tmp_path):
    assert 20 < fuzz_points(tmp_path, range(1000, 2500)) < 1400


def test_a_points_file_that_is_no_file(tmp_path):
    (tmp_path / "run.toml").write_text(POINTS_RUN)
    place = tmp_path / "points.parquet"
    for make in (
        place.mkdir,
        lambda: place.symlink_to("points.parquet"),
        lambda: os.mkfifo(place),
    ):
        make()
        with (
            limited(10),
            pytest.raises(InputError, match=r"sweep\.file = .*points\.parquet: "),
        ):
            Plan(load(tmp_path / "run.toml"))
        place.rmdir() if place.is_dir() else place.unlink()
    pq.write_table(
        pa.table([["quenched"], ["annealed"]], ["disorder", "disorder"]), place
    )
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        Plan(load(tmp_path / "run.toml"))


AXES = [
    0,
    1,
    -1,
    0.5,
    1e308,
    -1e308,
    math.inf,
    math.nan,
    10**30,
    10**299,
    "a",
    "",
    True,
    [],
    {},
    [1],
    5e-324,
    3,
    2.0,
]


def axis_case(rng):
    """A [sweep] table."""

    def spec():
        few = [rng.choice(AXES) for _ in range(rng.choice([0, 1, 2, 3]))]
        ends = [
            rng.choice(AXES),
            rng.choice(AXES),
            rng.choice([2, 3, 3.0, 1, 10**7, math.inf, "3", *AXES]),
        ]
        forms = [
            few,
            few,
            {"log": ends},
            {"linear": ends},
            {"linear": few},
            {"log": ends, "linear": ends},
        ]
        good = [[0.25, 0.5], {"linear": [1, 2.0, 3]}]
        return rng.choice([*forms, rng.choice(AXES), *good * 4])

    def name():
        return (
            misspelt(rng.choice(list(keys())), rng)
            if rng.random() < 0.1
            else rng.choice(list(keys()))
        )

    table = {name(): spec() for _ in range(rng.choice([1, 1, 2]))}
    if rng.random() < 0.3:
        group = {name(): spec() for _ in range(rng.choice([0, 1, 2]))}
        table["zip"] = rng.choice(
            [group, [group], [], [[]], [group, group], rng.choice(AXES)]
        )
    return table


def fuzz_axes(folder, seeds):
    path, planned = folder / "run.toml", 0
    for seed in seeds:
        content = {
            "contacts": {"count": 10},
            "drive": {"velocity": 1.0},
            "sweep": axis_case(random.Random(seed)),
        }
        path.write_text(document(content))
        try:
            with limited(), warnings.catch_warnings():
                warnings.simplefilter("error")
                plan = Plan(load(path))
        except InputError as error:
            judge(str(error), path)
        except Exception as error:
            error.add_note(f"seed {seed}: {content['sweep']}")
            raise
        else:
            planned += plan.size > 0
    return planned


def test_axes(tmp_path):
    assert fuzz_axes(tmp_path, range(400)) > 10


@pytest.mark.long
def test_many_axes(tmp_path):
    assert fuzz_axes(tmp_path, range(1000, 3000)) > 50


# ---- places and disks ----

GOOD = "[contacts]\ncount = 100\n[drive]\nvelocity = 1.0\ndistance = 2.0\n[output]\npoints = 11\n"


def refused(result, path):
    """Exit code 2, one line on standard error, nothing on standard output."""
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("eqsim: ")
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    judge(result.stderr.removeprefix("eqsim: ").rstrip("\n"), path)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("name", ["-dash ☃ a'b\"c", "x{y}$_{ 100% [bold]", "n" * 200])
def test_odd_names(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    path = folder / f"{name}.toml"
    path.write_text(GOOD)
    (tmp_path / "link.toml").symlink_to(path)
    for start in (path, tmp_path / "link.toml")[len(name) > 20 :]:
        result = call("run", start, "--out", tmp_path / "out", "--threads", 1)
        assert result.exit_code == 0, result.output
        assert tree(tmp_path / "out") == [
            "force.png",
            "summary.json",
            "trajectory.parquet",
        ]


def test_links_to_nowhere(tmp_path):
    (tmp_path / "good.toml").write_text(GOOD)
    for name, target in (("dangling", "nowhere"), ("circular", "circular")):
        link = tmp_path / name
        link.symlink_to(target)
        refused(call("info", link), link)
        refused(call("run", tmp_path / "good.toml", "--out", link), link)
        refused(call("run", tmp_path / "good.toml", "--out", link / "below"), link)
    assert tree(tmp_path) == ["circular", "dangling", "good.toml"]


@pytest.mark.parametrize(
    "place", ["/proc/eqsim", "/dev/null", "/dev/null/below", "good.toml"]
)
def test_places_nobody_can_write_to(tmp_path, place):
    """Not even the superuser."""
    path, out = tmp_path / "good.toml", tmp_path / place
    path.write_text(GOOD + '[sweep]\n"drive.velocity" = [1.0, 2.0]\n')
    for command in ("run", "sweep"):
        refused(call(command, path, "--out", out), out)
    assert tree(tmp_path) == ["good.toml"]


def test_a_full_disk(tmp_path, monkeypatch):
    """ENOSPC wherever the disk notices: nothing half-written, by `run` as by `sweep`."""
    path = tmp_path / "good.toml"
    path.write_text(GOOD + '[sweep]\n"drive.velocity" = [1.0, 2.0]\n')

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    for name in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full)
            refused(call("run", path, "--out", tmp_path / "out"), "out")
            assert tree(tmp_path) == ["good.toml"]
            result = call(
                "sweep", path, "--out", tmp_path / "s", "--workers", 1, "--quiet"
            )
            assert result.exit_code == 2, result.output
            assert result.stderr.count("\n") == 1
            assert "No space left" in result.stderr
            left = [
                name for name in tree(tmp_path / "s") if name not in ("_lock", "parts")
            ]
            assert left == []
            (tmp_path / "s" / "_lock").unlink(missing_ok=True)
            for folder in (tmp_path / "s" / "parts", tmp_path / "s"):
                if folder.exists():
                    folder.rmdir()


# ---- real processes ----


def judge_process(command, path, out):
    """A result, or exit code 2 with one line; nothing else on standard error, and
    nothing half-written."""
    args = [
        command,
        str(path),
        *(["--out", str(out)] if command == "run" else []),
        "--json",
        "--threads",
        "1",
    ]
    if command in ("run", "steady"):
        args += ["--max-lives", "1e5"]
    if command == "steady":
        args += ["--rel-error", "0.05"]
    done = subprocess.run([*EQSIM, *args], capture_output=True, timeout=5 * SECONDS)
    said = done.stderr.decode()
    if done.returncode:
        assert done.returncode == 2, said
        assert said.startswith("eqsim: ")
        assert said.count("\n") == 1
        assert done.stdout == b""
        judge(said.removeprefix("eqsim: ").rstrip("\n"), path)
        assert not out.exists()
    else:
        assert "Traceback" not in said
        found = json.loads(done.stdout)
        if command == "steady":
            assert finite(*(found[name]["value"] for name in BASIC))
        if command == "reference":
            assert finite(*(found[name] for name in BASIC))
        if command == "run":
            assert tree(out) == ["force.png", "summary.json", "trajectory.parquet"]
            table = pq.read_table(out / "trajectory.parquet")
            assert all(finite(*column.to_pylist()) for column in table.columns)
    return done.returncode


def fuzz_processes(folder, seeds):
    (folder / "good.csv").write_text("threshold\n1.0\n0.5\n2.0\n0.5\n")
    codes = []
    for seed in seeds:
        path = folder / f"{seed}.toml"
        path.write_bytes(case(random.Random(seed)))
        with contextlib.suppress(InputError):
            file = load(path)
            ensemble, drive = file.ensemble, file.drive
            if endless(ensemble, drive) or ensemble.aging.rule == "langevin":
                continue
        codes.append(
            judge_process(
                ("info", "run", "steady", "reference")[seed % 4],
                path,
                folder / f"out {seed}",
            )
        )
    return codes


@pytest.mark.long
def test_processes(tmp_path):
    """A run that succeeds, and a reference of a file that is refused."""
    assert fuzz_processes(tmp_path, (97, 3)) == [0, 2]


@pytest.mark.long
def test_many_processes(tmp_path):
    codes = fuzz_processes(tmp_path, range(20_000, 20_060))
    assert len(codes) >= 50
    assert set(codes) == {0, 2}


@pytest.mark.long
def test_names_no_terminal_can_show(tmp_path):
    """A name that is no UTF-8, and a title that the terminal's encoding lacks."""
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/n\xff.toml"))
    path.write_text('title = "\u2603"\n' + GOOD)
    environment = {**os.environ, "PYTHONIOENCODING": "ascii:strict"}
    done = subprocess.run(
        [*EQSIM, "info", path],
        capture_output=True,
        env=environment,
        timeout=5 * SECONDS,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\\u2603" in done.stdout
    # the picture is named after it
    result = call("run", path, "--out", tmp_path / "out", "--set", "title=", "--json")
    assert result.exit_code == 0, result.output
    refused(call("info", path, "--set", "title=\udcff"), path)
