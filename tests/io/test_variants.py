"""One record as laboratories have it, in forty forms: read rightly, with a word about
what was done to its rows, or refused with the line; none loses a row in silence."""

import math

import numpy as np
import pytest

from eqsim import InputError
from eqsim.fitting.record import read_record
from eqsim.fitting.section import section_of
from eqsim.io.runfile import check
from eqsim.io.tables import DriveRecord, read_drive

TIME = [0.0, 0.5, 1.0, 1.5, 2.0]
FORCE = [0.6, 0.61, 0.625, 0.62, 0.6]
NAMES = {"time": "time", "force": "mu"}
QUOTED = {"time": "Time (s)", "force": "mu"}


def table(names="time,mu", separator=",", decimal=".", shift=0.0, extra=""):
    """The lines of the record."""
    rows = [
        f"{t + shift:g}{separator}{F:g}".replace(".", decimal) + extra
        for t, F in zip(TIME, FORCE, strict=True)
    ]
    return [names, *rows]


def put(lines, where, *more):
    return [*lines[:where], *more, *lines[where:]]


def text(lines, end="\n", encoding="utf-8"):
    return (end.join(lines) + end).encode(encoding)


FRICTION = {"time": "Time", "force": "Friction"}
SEMI = table("Time (s);Friction", ";", ",")
PLAIN = table()
# content, keys of fit.record, and words that are said
READ = {
    "plain": (text(PLAIN), NAMES, "commas"),
    "comments with quotes": (
        text(put(put(PLAIN, 2, '# "pump off'), 5, '# on"')), NAMES, "5 rows"),
    "comments of per cent": (text(["% Matlab, 'x", *PLAIN]), NAMES, "5 rows"),
    "byte-order mark": (text(PLAIN, encoding="utf-8-sig"), NAMES, "5 rows"),
    "mark and comment": (text(['# "', *PLAIN], encoding="utf-8-sig"), NAMES, "5 rows"),
    "Latin-1": (
        text(["# Prüfstand, 20 °C", *table("time,µ")], encoding="latin-1"),
        {"time": "time", "force": "µ"}, "Latin-1"),
    "Windows": (text(PLAIN, "\r\n"), NAMES, "5 rows"),
    "old Mac": (text(PLAIN, "\r"), NAMES, "5 rows"),
    "no last line end": (text(PLAIN)[:-1], NAMES, "5 rows"),
    "semicolons": (text(table("time;mu", ";")), NAMES, "semicolons"),
    "semicolons and decimal commas": (
        text(SEMI), FRICTION, "decimal commas"),
    "Excel": (
        text(["sep=;", *SEMI], "\r\n", "utf-8-sig"),
        {"time": "Time (s)", "force": "Friction"}, "semicolons"),
    "tabs": (text(table("time\tmu", "\t")), NAMES, "tabs"),
    "tabs and decimal commas": (
        text(table("time\tmu", "\t", ",")), NAMES, "decimal commas"),
    "blanks": (text(table("time mu", "   ")), NAMES, "blanks"),
    "blanks and decimal commas": (
        text(table("time mu", " ", ",")), NAMES, "decimal commas"),
    "names of two words": (
        text(table("elapsed time (s)   mu", "  ")),
        {"time": "elapsed time", "force": "mu"}, "blanks"),
    "units in the names": (text(table("Time (s),mu [-]")), QUOTED, "5 rows"),
    "units and blanks": (text(table("Time (s) mu", " ")), QUOTED, "blanks"),
    "a row of units": (text(put(PLAIN, 1, "s,-")), NAMES, "line 2 holds units"),
    "units in brackets": (
        text(put(PLAIN, 1, "[s],[N/mm^2]")), NAMES, "line 2 holds units"),
    "names in a comment": (text(["# time mu", *table("", " ")[1:]]), NAMES, "blanks"),
    "names in a comment of Matlab": (
        text(["% 20 % of # 3", "% time mu", *table("", " ")[1:]]), NAMES, "blanks"),
    "quoted cells": (
        text([f'"{line}"'.replace(",", '","') for line in PLAIN]), NAMES, "commas"),
    "quoted decimal commas": (
        text(['"time","mu"', *(f'"{line}"'.replace(";", '","')
                               for line in table("", ";", ",")[1:])]),
        NAMES, "decimal commas"),
    "commas at the end": (text(table("time,mu,,", extra=",,")), NAMES, "5 rows"),
    "rows of a spreadsheet's end": (
        text([*PLAIN, ",", ","]), NAMES, "2 rows with gaps left out"),
    "NaN": (text(put(PLAIN, 3, "0.7,NaN")), NAMES, "1 rows with gaps"),
    "empty cells": (text(put(PLAIN, 3, "0.7,", "0.8, ")), NAMES, "2 rows with gaps"),
    "Excel's errors": (
        text(put(PLAIN, 3, "#N/A,0.6", "0.7,#DIV/0!")), NAMES, "2 rows with gaps"),
    "equal times": (text(put(PLAIN, 3, "0.5,0.61")), NAMES, "1 rows merged"),
    "a clock from 11607.7": (
        text(table(shift=11607.7)), {**NAMES, "start": "first row"}, "5 rows"),
    "a gap in the first row": (
        text(put(table(shift=11607.7)[2:], 0, "time,mu", "11607.7,", "11607.7,0.6")),
        {**NAMES, "start": "first row"}, "1 rows with gaps"),
    "a clock and a time": (
        text(put(table(shift=11607.7), 1, "11600,0.5")),
        {**NAMES, "start": 11607.7}, "1 rows before the start left out"),
    "other columns": (
        text(table("time,mu,note", extra=',"a, # ""b"""')), NAMES, "5 rows"),
    "a column of dates": (
        text([f"{a};{line}" for a, line in zip(
            ["date", *["12.03.2024"] * 5], table("time;mu", ";", ","), strict=True)]),
        NAMES, "decimal commas"),
    "shear and normal stress": (
        text([PLAIN[0] + ",sigma", *(f"{t},{20 * F},20" for t, F in
                                     zip(TIME, FORCE, strict=True))]),
        {**NAMES, "normal": "sigma"}, "5 rows"),
    "against displacement": (
        text(["X,mu", *(f"{1000 + 2 * t},{F}" for t, F in
                         zip(TIME, FORCE, strict=True))]),
        {"force": "mu", "displacement": "X", "start": "first row"}, "5 rows"),
    "a decimal sign that is named": (
        text(table("time;mu", ";", ",")), {**NAMES, "decimal": ","}, "decimal commas"),
}  # fmt: skip
REFUSED = {
    "backward": (text(put(PLAIN, 4, "0.2,0.6")), NAMES, "line 5: time = 0.2: must be later"),
    "decimal commas between commas": (text(table(decimal=",")), NAMES, "line 2: more values than columns"),
    "a cell too few": (text(put(PLAIN, 3, "0.7")), NAMES, "line 4: has 1 of 2 cells"),
    "an open quote": (text(put(PLAIN, 3, '0.7,"0.6')), NAMES, "line 4: '\"0.6' is no cell"),
    "a unit in a cell": (text(put(PLAIN, 3, "0.7,0.6 N")), NAMES, "line 4: mu = '0.6 N': must be a number"),
    "dashes in the first row": (text(put(PLAIN, 1, "-,-")), NAMES, "line 2: time = '-': must be a number"),
    "thousands": (text(put(SEMI, 3, "1.234,5;0,6")), FRICTION,
        "line 4: Time = '1.234.5 (a point among"),
    "a point among commas": (text(put(SEMI, 3, "1;0.6")), FRICTION,
        "line 4: Friction = '0.6 (a point among decimal commas)'"),
    "infinite": (text(put(PLAIN, 3, "0.7,inf")), NAMES, "line 4: mu = inf: must be finite"),
    "no such column": (text(PLAIN), {**NAMES, "force": "F"},
        'needs a column "F" in its first line; found time, mu (fit.record.force'),
    "another clock": (text(table(shift=-3.0)), NAMES,
        'begins before time 0; give the time that is 0 as start, or start = "first row"'),
    "start": (text(PLAIN), {**NAMES, "start": "now"}, 'start = \'now\': must be a time or "first row"'),
    "no normal stress": (text([PLAIN[0] + ",sigma", "0,1,20", "1,1,0"]), {**NAMES, "normal": "sigma"},
        "line 3: sigma = 0: must be > 0"),
    "gaps alone": (text([PLAIN[0], "0,", "1,nan"]), NAMES, "has 2 rows, all with gaps"),
    "UTF-16": (text(PLAIN, encoding="utf-16"), NAMES, "is text in UTF-16"),
    "no text": (b"PAR1\x00\x15\x04\xff\x15\n1,2\n", NAMES, "line 1: is not text in UTF-8"),
}  # fmt: skip


def run_file(**record):
    """A slider along two segments, 4 s in all."""
    programme = [{"velocity": 2.0, "time": 1.0}, {"velocity": 2.0, "time": 3.0}]
    fit = {"noise": {"absolute": 1e-3}, "free": {"fit.offset": {"bounds": [-1.0, 1.0]}}}
    fit["record"] = {"file": "x.csv", **record}
    return check({"drive": {"programme": programme}, "fit": fit})


def read(path, keys):
    file = run_file(**keys)
    return read_record(path, section_of(file), file)


@pytest.mark.parametrize("name", READ)
def test_a_variant_is_read_or_refused(tmp_path, name):
    content, keys, said = READ[name]
    (tmp_path / "x.csv").write_bytes(content)
    found = read(tmp_path / "x.csv", keys)
    # 11607.7 + t has rounding of 2e-12
    np.testing.assert_allclose(found.time, TIME, rtol=0, atol=4e-12)
    np.testing.assert_allclose(found.value, FORCE, rtol=1e-15, atol=0)
    assert said in "; ".join(found.said)


def test_errors_are_divided_by_the_normal_stress(tmp_path):
    """Errors are those of the coefficient, as the section's noise is; decimals of the
    file are rounded to 1e-16."""
    rows = [f"{t},{20 * F},20,0.04" for t, F in zip(TIME, FORCE, strict=True)]
    (tmp_path / "x.csv").write_bytes(text([PLAIN[0] + ",sigma,error", *rows]))
    found = read(tmp_path / "x.csv", {**NAMES, "normal": "sigma", "stderr": "error"})
    sigma = np.full(len(TIME), math.hypot(0.04 / 20, 1e-3))
    np.testing.assert_allclose(found.sigma, sigma, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", REFUSED)
def test_a_variant_is_refused(tmp_path, name):
    content, keys, said = REFUSED[name]
    (tmp_path / "x.csv").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read(tmp_path / "x.csv", keys)
    assert said in str(caught.value)


def test_equal_times_are_merged_with_their_errors(tmp_path):
    """The mean of two has the error sqrt(e_1^2 + e_2^2)/2."""
    (tmp_path / "x.csv").write_text("time,mu,e\n0,1,0.1\n1,2,0.3\n1,4,0.4\n2,1,0.2\n")
    file = run_file(**NAMES, stderr="e")
    section = section_of(file)
    found = read_record(
        tmp_path / "x.csv",
        section.model_copy(update={"noise": type(section.noise)()}),
        file,
    )
    assert found.value.tolist() == [1.0, 3.0, 1.0]
    np.testing.assert_allclose(found.sigma, [0.1, 0.25, 0.2], rtol=1e-14, atol=0)


def test_a_recorded_load_point(tmp_path):
    """Columns, a clock and a displacement that start anywhere; gaps and equal times,
    which are said."""
    lines = ["Time (s);LP (um)", "100,5;7", "101;8", "101;8", "102;", "103,5;9"]
    (tmp_path / "x.csv").write_text("\n".join(lines))
    drive = {"file": "x.csv"}
    with pytest.raises(InputError, match='needs a column "t"'):
        _ = check({"drive": drive}, tmp_path).drive
    drive["record"] = {"time": "Time", "displacement": "LP", "start": "first row"}
    file = check({"drive": drive}, tmp_path)
    assert [(one.velocity, one.time) for one in file.drive.segments] == [
        (2.0, 0.5),
        (0.4, 2.5),
    ]
    (said,) = file.said
    for words in ("3 instants", "decimal commas", "1 rows with gaps", "1 rows merged"):
        assert words in said
    with pytest.raises(InputError, match=r"drive\.record: needs drive\.file"):
        _ = check({"drive": {"record": {}}}).drive
    (tmp_path / "x.csv").write_text("Time,LP\n1,\n2,0.5\n3,2\n")
    with pytest.raises(InputError, match=r"line 3: Time = 1, .* gaps come before"):
        _ = check({"drive": drive}, tmp_path).drive
    drive["record"]["start"] = 2
    (shifted,) = check({"drive": drive}, tmp_path).drive.segments
    assert (shifted.velocity, shifted.time) == (1.5, 1.0)


def test_steps_and_holds_are_told_from_noise(tmp_path):
    """4000 rows of noise: four segments, velocities to 4 standard errors (.05/sqrt(1000)
    of a displacement over 100/sqrt(12) of time: 6e-5)."""
    t, rng = np.arange(0.0, 400.0, 0.1), np.random.default_rng(2)
    velocity = np.repeat([1.0, 0.0, 10.0, 1.0], 1000)
    X = 5.0 + np.cumsum(velocity) * 0.1 + 0.05 * rng.standard_normal(t.size)
    np.savetxt(tmp_path / "x.csv", np.c_[t, X], delimiter=",", header="t,X")
    rough, smooth = (
        read_drive(tmp_path / "x.csv", DriveRecord(smooth=smooth)).segments
        for smooth in (False, True)
    )
    assert len(rough) == 3999
    found = [one.velocity for one in smooth]
    np.testing.assert_allclose(found, [1.0, 0.0, 10.0, 1.0], rtol=0, atol=2.4e-4)
    assert found[1] == 0.0
    assert [round(one.time, 0) for one in smooth] == [100.0] * 4


def test_short_records_are_smoothed_or_refused(tmp_path):
    """A ramp of 20 in 20 and a hold as long, whose corner hides in the scatter of two
    stretches; and a hold, which has none."""
    how = DriveRecord(smooth=True)

    def smoothed(X):
        rows = zip(np.linspace(0.0, 40.0, len(X)).tolist(), X, strict=True)
        lines = ["t,X", *(f"{t!r},{x!r}" for t, x in rows)]
        (tmp_path / f"{len(X)}.csv").write_text("\n".join(lines))
        return read_drive(tmp_path / f"{len(X)}.csv", how).segments

    for size in (12, 13, 14):
        X = np.minimum(np.linspace(0.0, 40.0, size), 20.0).tolist()
        found = [[one.velocity, one.time] for one in smoothed(X)]
        # lines take rows to have errors of 1e-9 of their range, here 2e-8
        np.testing.assert_allclose(found, [[1.0, 20.0], [0.0, 20.0]], rtol=0, atol=1e-6)
        with pytest.raises(InputError, match=r"needs 12 instants .* smooth = true"):
            smoothed(X[:-3])
    (hold,) = smoothed([0.0] * 20)
    assert (hold.velocity, hold.time) == (0.0, 40.0)
