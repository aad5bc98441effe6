"""CSV files: every row is read or refused with its line, whatever comments hold; what
is written is read again."""

import math
import re
import string

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eqsim.errors import InputError
from eqsim.fitting.data import read_table
from eqsim.fitting.record import read_record
from eqsim.fitting.section import section_of
from eqsim.io import csv
from eqsim.io.export import as_csv
from eqsim.io.runfile import check
from eqsim.io.tables import read_drive, read_thresholds

ROWS = [(0.0, 0.0), (1.0, 0.5), (2.0, 1.5), (3.0, 2.0)]
# Two comments with an odd quote each: to a reader that looks for quotes first, all
# between them is a single cell.
SWALLOWING = [
    "# the run of Tuesday",
    "t,X",
    "0,0",
    '# note, "pump off',
    "1,0.5",
    "2,1.5",
    '# pump on again"',
    "3,2",
]


def drive(path):
    """Instants and displacements of a recorded drive."""
    t, X = [0.0], [0.0]
    for segment in read_drive(path).segments:
        t.append(t[-1] + segment.time)
        X.append(X[-1] + segment.velocity * segment.time)
    return list(zip(t, X, strict=True))


def record(path):
    fit = {
        "record": {"file": "x.csv", "force": "X"},
        "noise": {"absolute": 1.0},
        "free": {"fit.offset": {"bounds": [-1.0, 1.0]}},
    }
    table = read_record(path, section_of(check({"fit": fit})))
    return list(zip(table.time.tolist(), table.value.tolist(), strict=True))


def sheet(path):
    found = csv.read(path, "file = x.csv")
    t, X = found.index("t"), found.index("X")
    return [(float(cells[t]), float(cells[X])) for _, cells in found.rows()]


def bytes_of(lines, end="\n", mark=""):
    return (mark + end.join(lines) + end).encode()


FORMS = {
    "comments with quotes": bytes_of(SWALLOWING),
    "comments in quotes": bytes_of(
        ['# a "b" c', "t,X", "0,0", '#"', "1,0.5", "2,1.5", '  # "x', "3,2"]
    ),
    "byte-order mark": bytes_of(SWALLOWING, mark="\ufeff"),
    "byte-order mark before the names": bytes_of(SWALLOWING[1:], mark="\ufeff"),
    "Windows": bytes_of(SWALLOWING, end="\r\n"),
    "old Mac": bytes_of(SWALLOWING, end="\r"),
    "no last line end": bytes_of(SWALLOWING).rstrip(),
    "blanks": bytes_of([" t ,\tX", "  ", "0 , 0", "1,  0.5", "", " 2,1.5 ", "3\t,2"]),
    "quotes": bytes_of(['"t","X"', '"0", "0"', '"1" ,"0.5"', "2,1.5", '3 , "2" ']),
    "commas at the end": bytes_of(["t,X,,", "0,0,,", "1,0.5,,", "2,1.5", "3,2,,,"]),
    "more columns": bytes_of(
        [
            "X,note,t",
            '0,"a, b",0',
            '0.5,"# no comment",1',
            '1.5,5" disc,2',
            '2,"say ""no""",3',
        ]
    ),
    "separators of lines inside a cell": bytes_of(
        ["t,X,note", "0,0,a\x0bb", "1,0.5,\u2028", "2,1.5,\x85x", "3,2,\x0c"]
    ),
}


@pytest.mark.parametrize("reader", [drive, record, sheet])
@pytest.mark.parametrize("form", FORMS)
def test_every_row_is_read(tmp_path, form, reader):
    (tmp_path / "x.csv").write_bytes(FORMS[form])
    assert reader(tmp_path / "x.csv") == ROWS


@pytest.mark.parametrize("form", ['1,"{}"\n', "1;{}\n"])
def test_commas_that_may_stand_between_thousands(tmp_path, form):
    """Refused where some numbers have one and others none, unless another comma shows
    that all are decimal."""
    path = tmp_path / "x.csv"

    def written(*cells):
        head = f"sample{form[1]}threshold\n"
        path.write_text(head + "".join(form.format(cell) for cell in cells))
        return read_thresholds(path).steps.tolist()

    said = (
        "x.csv, line 3: threshold = '1,050': must be 1050 or 1.050; other cells have no"
    )
    with pytest.raises(InputError, match=re.escape(said)):
        written("950", "1,050", "2,310")
    assert written("1,25", "1,050", "2") == [1.05, 1.25, 2.0]
    assert written("0,125", "1,050", "2") == [0.125, 1.05, 2.0]
    assert written("1,050", "2,310") == [1.05, 2.31]


def test_comments_with_quotes_in_tables_of_thresholds_and_measurements(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text(
        '# "\n\ufeffthreshold\n'.replace("\ufeff", "")
        + '1\n# note, "off\n2\n3\n# on"\n4\n'
    )
    assert read_thresholds(path).steps.tolist() == [1, 2, 3, 4]
    path.write_text(
        '\ufeff# "\ndrive.velocity,friction\n1,1\n# note, "off\n2,2\n3,3\n# on"\n4,4\n,\n',
        encoding="utf-8",
    )
    fit = {"noise": {"relative": 0.1}, "free": {"thresholds.n": {"bounds": [0.5, 2.0]}}}
    file = check({"fit": fit})
    table = read_table(path, file, section_of(file))
    assert table.value.tolist() == [1, 2, 3, 4]
    assert [one.line for one in table.conditions] == [3, 5, 6, 8]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"# only a comment", "is empty"),
        (
            b't,X\n0,0\n1,"2\n2,3"\n',
            "line 3: '\"2' is no cell; a quote must be closed before the next comma or line end",
        ),
        (b't,X\n0,0\n1,"2" 3\n', "line 3: '\"2\" 3' is no cell"),
        (b"t,X\n0,0\n# x\n1,2,3\n", "line 4: more values than columns"),
        (b"t,X\n0,0\n1\n", "line 3: has 1 of 2 cells"),  # a file that ends in a row
        (b"t,X\n0,0\n1;2\n", "line 3: has 1 of 2 cells"),
        (b"t,X\n0,0\n1,1,234.5\n", "line 3: more values than columns"),
        (
            b't,X\n0,0\n1,"1,234.5"\n',
            "line 3: X = '1,234.5': must be a number; decimal commas must be points",
        ),
        (b"t,X\n0,0\n1,2 # bad\n", "line 3: X = '2 # bad': must be a number"),
        (b"t,X\n0,0\n1,2 um\n", "line 3: X = '2 um': must be a number"),
        (b"t,X\n0,0\n1,1_0\n", "line 3: X = '1_0': must be a number"),
        (b"t,X\n0,0\n1,\n", "line 3: X = '': must be a number"),
        (b"t,X\nNA,N/A\n1,2\n", "line 2: t = 'NA': must be a number"),  # no units
        (b"t,X\n0,0\n1,1e999\n", "line 3: X = 1e999: must be finite"),
        (b"t,X,t\n0,0,1\n", 'has 2 columns "t"'),
        (b"0,0\n1,2\n", 'needs a column "t"'),
        (b"t,X\r\n0,0\r\n\xb5\0,0\r\n", "line 3: is not text in UTF-8"),
        ("t,X\n0,0\n".encode("utf-16"), "is text in UTF-16"),
    ],
)
def test_a_line_that_is_no_row_is_refused(tmp_path, content, message):
    (tmp_path / "x.csv").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_drive(tmp_path / "x.csv")
    assert message in str(caught.value)


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.text('"#,; \t1.5aé', max_size=8), max_size=12),
    st.sampled_from(["\n", "\r\n", "\r"]),
)
def test_no_row_is_lost_in_silence(tmp_path_factory, lines, end):
    """Any lines: as many rows as there are lines that are neither empty nor a comment,
    or an error."""
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(end.join(["a,b", *lines]).encode())
    wanted = [
        number
        for number, line in enumerate(lines, 2)
        if line.strip() and not line.strip().startswith("#")
    ]
    try:
        found = [number for number, _ in csv.read(path, "file").rows()]
    except InputError as error:
        found = [number for number in wanted if f"line {number}:" in str(error)]
        wanted = found[:1]
        assert found
    assert found == wanted


TEXTS = st.text(
    st.characters(exclude_characters="\r\n", exclude_categories=["Cs"]), max_size=8
)
# With a letter: a line of numbers alone is read as a row without names.
NAMES = (
    st.text(string.ascii_letters + string.digits + '.,"# _é', min_size=1, max_size=8)
    .map(str.strip)
    .filter(lambda name: any(map(str.isalpha, name)))
)
COLUMNS = [
    (pa.float64(), st.none() | st.floats()),
    (pa.int64(), st.none() | st.integers(-(2**63), 2**63 - 1)),
    (pa.bool_(), st.none() | st.booleans()),
    (pa.string(), st.none() | TEXTS),
]


@st.composite
def tables(draw):
    names = draw(st.lists(NAMES, min_size=1, max_size=5, unique=True))
    count = draw(st.integers(0, 5))
    kinds = [draw(st.sampled_from(COLUMNS)) for _ in names]
    return pa.table(
        [
            pa.array(draw(st.lists(values, min_size=count, max_size=count)), kind)
            for kind, values in kinds
        ],
        names,
    )


def read_as(cell, value):
    """Whether a cell holds a value, to the last bit. Missing numbers, NaN and missing
    text are empty cells."""
    if value is None or value != value:
        return cell == ""
    if isinstance(value, float):
        return float(cell) == value and math.copysign(1, float(cell)) == math.copysign(
            1, value
        )
    return cell == value if isinstance(value, str) else cell == str(value)


@settings(max_examples=150, deadline=None)
@given(tables())
@example(pa.table({"0 A": pa.array([], pa.float64())}))
def test_what_is_exported_is_read_again(tmp_path_factory, table):
    folder = tmp_path_factory.getbasetemp()
    pq.write_table(table, folder / "t.parquet")
    (folder / "t.csv").write_bytes(as_csv([folder / "t.parquet"]))
    found = csv.read(folder / "t.csv", "file = t.csv")
    assert found.columns == table.column_names
    rows = list(found.rows())
    assert len(rows) == table.num_rows
    for (_, cells), row in zip(
        rows,
        zip(*(column.to_pylist() for column in table.columns), strict=True),
        strict=True,
    ):
        assert all(map(read_as, cells, row)), (cells, row)


def test_pandas_reads_what_is_exported(tmp_path):
    """Whole numbers beyond 2^53, too, beside missing ones, and names with commas and
    comment signs."""
    columns = {
        "a,b": [2**63 - 1, 1],
        "c # d": ["# x", 'say "no"'],
        "e": [math.nan, 0.1],
        "f": [2**53 + 1, None],
    }
    pq.write_table(pa.table(columns), tmp_path / "t.parquet")
    (tmp_path / "t.csv").write_bytes(as_csv([tmp_path / "t.parquet"]))
    found = pd.read_csv(tmp_path / "t.csv", comment="#", dtype={"f": "Int64"})
    assert list(found) == list(columns)
    assert found["a,b"].tolist() == columns["a,b"]
    assert found["c # d"].tolist() == columns["c # d"]
    assert found["f"][0] == 2**53 + 1
    assert found["e"][1] == 0.1
    assert np.isnan(found["e"][0])


def test_text_with_line_breaks_is_not_exported(tmp_path):
    pq.write_table(pa.table({"text": ["a\nb"]}), tmp_path / "t.parquet")
    with pytest.raises(InputError, match="has a line break"):
        as_csv([tmp_path / "t.parquet"])
