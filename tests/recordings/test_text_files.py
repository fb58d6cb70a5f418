"""Text files, read through read_records: a fault counts only with the message that a user gets."""

import contextlib
import gzip
import re
import string
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from odescope.errors import InputError
from odescope.recordings.chunks import cut
from odescope.recordings.columns import numbers, times
from odescope.recordings.formats import opened
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_records
from odescope.recordings.text_headers import read_header

LAYOUT = Layout(time="t", columns=(("x", "x"), ("u", "force")))
N = 30
T, X, U = np.arange(N) * 0.5, np.sin(np.arange(N)), np.cos(np.arange(N))
ROWS = zip(T.tolist(), X.tolist(), U.tolist(), strict=True)
TEXT = "t,x,note,force\n" + "".join(f"{t!r},{x!r},ok,{u!r}\n" for t, x, u in ROWS)


def write(folder: Path, text: str | bytes | list[str], name="run1.csv") -> Path:
    path = folder / name
    text = "\n".join(text) + "\n" if isinstance(text, list) else text
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def check(records):
    (run,) = records
    assert (run.names, len(run)) == (("x", "u"), N)
    assert np.allclose(run.t, T, rtol=0, atol=1e-12)
    assert np.array_equal(run.values, np.column_stack([X, U]))


def refused(folder, text, message, layout=LAYOUT, name="run1.csv"):
    with pytest.raises(InputError, match=message) as caught:
        read_records([write(folder, text, name)], layout)
    assert name in str(caught.value)


# files that are read


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda text: text, "run.csv"),
        (lambda text: "\ufeff" + text, "run.csv"),
        (lambda text: "\n \n" + text.replace("t,x,note", ' t , "x" ,no;te'), "run.txt"),
        (lambda text: text.replace(",", "\t"), "run.tsv"),
        (lambda text: text.replace(",", ";"), "run.csv"),
        (lambda text: text.replace(",", ";").replace(".", ","), "RUN.CSV"),
        (lambda text: text.replace("\n", "\r\n"), "run.csv"),
        (lambda text: text.replace("\n", "\n\n", 5), "run.csv"),
        (lambda text: text.replace("note", "x y,q").replace(",ok,", ',"a,b",°,'), "run.csv"),
        (lambda text: re.sub(r",(\d)", r", +\1", text), "run.csv"),
        (lambda text: re.sub(r"(\d)\n", r"\1,\n", text), "run.csv"),
        (lambda text: text.replace("\n", ", \r\n"), "run.csv"),
        (lambda text: re.sub(r"(\d)\n(0|1)", r"\1,\n\2", text).replace("ok", '"a,""b"'), "run.csv"),
        (lambda text: text.replace("\n", ",\n", 5).replace("ok", '5" °'), "run.csv"),
        (lambda text: text.replace("\n", ",\n", 1), "run.csv"),
        (lambda text: "# logger v1.2\n# date 2026-01-01, 12:00\n" + text, "run.csv"),
        (lambda text: '\ufeff# a "quoted\n\n #\n' + text.replace("\n", ",\n"), "run.csv"),
        (lambda text: "# " + text, "run.csv"),
        (lambda text: "# logger, v1.2, by, me\r\n#" + text.replace("\n", "\r\n"), "run.csv"),
        (lambda text: '# 5 "\n# ' + text.replace("\n", ",\n", 2), "run.csv"),
        (lambda text: "# a, b, c, d\n#" + text.replace(",", ";").replace(".", ","), "run.csv"),
        (lambda text: "sep=|\n# a|b|c|d\n#" + text.replace(",", "|"), "run.csv"),
    ],
)
def test_csv_dialects(tmp_path, change, name):
    check(read_records([write(tmp_path, change(TEXT), name)], LAYOUT))


def test_the_header_tells_separator_names_and_lines_to_skip(tmp_path):
    file = read_header(write(tmp_path, '\n \nt; "x;1, or 2" ;force\n1;2;3\n'))
    assert (file.separator, file.names, file.skip) == (";", ("t", "x;1, or 2", "force"), 3)


@pytest.mark.parametrize(
    ("text", "names", "skip"),
    [
        ("#,t,item #2\n1,0.0,2\n", ("#", "t", "item #2"), 1),
        ("# logger v1.2\n#;t\n1;0,5\n", ("#", "t"), 2),
        ("# a, b\nt,x\n0,1\n", ("t", "x"), 2),
        ("# by me\n0,1,2\n", ("0", "1", "2"), 2),
        ("## t,x\n2026-01-01 12:00,NA\n", ("t", "x"), 1),
        ("# t,x,u\n0,1,\n", ("t", "x", "u"), 1),
        ("#\n# t,x,u\n0,1,2,\n", ("t", "x", "u"), 2),
        ("# t\n#\n0,1\n", ("0", "1"), 3),
    ],
)
def test_comments_before_the_header_are_skipped_and_the_last_may_be_it(tmp_path, text, names, skip):
    file = read_header(write(tmp_path, f"{text}5,6\n"))
    assert (file.names, file.skip) == (names, skip)


def test_labels_read_the_same_cell_by_cell(tmp_path):
    text = ["lap,t,x", *(f"NA,{k},{k}" for k in range(20)), *(f'"1,5",{k},{k}' for k in range(20, 40))]
    layout = Layout("t", columns=(("x", "x"),), recording="lap")
    for body in (text, [*text[:-1], text[-1].replace("39,39", "39,+39")]):  # Arrow refuses the plus sign
        runs = read_records([write(tmp_path, body)], layout)
        assert [(run.source, run.values[-1, 0]) for run in runs] == [
            ("run1.csv (lap NA)", 19),
            ("run1.csv (lap 1,5)", 39),
        ]


def test_gzip(tmp_path):
    check(read_records([write(tmp_path, gzip.compress(TEXT.encode()), "run.csv.GZ")], LAYOUT))


def test_an_unused_column_may_be_in_another_encoding_or_repeat(tmp_path):
    text = TEXT.replace(",note", ",note,note").replace("ok", "grün,")
    check(read_records([write(tmp_path, text.encode("latin-1"))], LAYOUT))


@settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=hnp.arrays(float, st.tuples(st.integers(2, 40), st.just(2)), elements=st.floats(-1e300, 1e300)))
def test_written_floats_read_back_bit_exact(tmp_path, values):
    frame = pd.DataFrame({"x": values[:, 0], "force": values[:, 1]})
    frame.to_csv(tmp_path / "run.csv", index=False)
    (run,) = read_records([tmp_path / "run.csv"], Layout(sample_period=0.1, columns=LAYOUT.columns))
    assert run.values.tobytes() == values.tobytes()


@pytest.mark.parametrize("zone", ["", "Z"])
@pytest.mark.parametrize("gap", [" ", "T"])
def test_dates_are_times(tmp_path, zone, gap):
    stamps = [f"2026-11-22{gap}13:{k // 60:02}:{k % 60:02}.250{zone}" for k in range(100)]
    text = ["t,x,force", *(f"{stamp},{k},{-k}" for k, stamp in enumerate(stamps))]
    (run,) = read_records([write(tmp_path, text)], LAYOUT)
    assert run.t == pytest.approx(1795352400.25 + np.arange(100), abs=1e-6)
    text[50] = "2026-11-22 25:00:00,1,2"
    refused(tmp_path, text, r"column 't' in run1\.csv has cells that are not numbers")


@pytest.mark.parametrize("stamp", ["2026-11-22 13:00:{:02}", "22.11.2026 13:00:{:02}", "13:00:{:02}"])
def test_a_cell_at_fault_beside_dates_is_named_and_no_date_is(tmp_path, stamp):
    text = ["t,x,force", *(f"{stamp.format(k)},{k},{-k}" for k in range(50))]
    text[20] = f"{stamp.format(19)},error 7,-19"
    refused(tmp_path, text, r"column 'x' in run1\.csv has cells that are not numbers \(line 21: 'error 7'\)")
    text[20] = f"{stamp.format(19)},+19,-19"  # a number that Arrow does not take for one
    (run,) = read_records([write(tmp_path, text)], LAYOUT)
    assert run.t - run.t[0] == pytest.approx(np.arange(50), abs=1e-6)
    assert run.column("x") == pytest.approx(np.arange(50))


@pytest.mark.parametrize(
    ("form", "first"),
    [
        ("{d:02}.03.2024 {h:02}:{m:02}:{s:02}", 1709596800.0),
        ("{d}.3.2024 {h}:{m:02}:{s:02}", 1709596800.0),
        ("2024/03/{d:02} {h:02}:{m:02}:{s:02}", 1709596800.0),
        ("2024-03-{d:02}T{h:02}:{m:02}:{s:02},250", 1709596800.25),
        ("{h:02}:{m:02}:{s:02},250", 0.25),
    ],
)
def test_dates_and_clocks_of_other_countries(tmp_path, form, first):
    at = 8 * 3600 + 10 * np.arange(600)
    stamps = [form.format(d=5, h=k // 3600, m=k // 60 % 60, s=k % 60) for k in at.tolist()]
    text = ["t;x;force", *(f"{stamp};{k},5;-{k},25" for k, stamp in enumerate(stamps))]
    (run,) = read_records([write(tmp_path, text)], LAYOUT)
    assert run.t == pytest.approx(first + at, abs=1e-6)
    assert run.column("x") == pytest.approx(np.arange(600) + 0.5)
    text[300] = f";{text[300].partition(';')[2]}"
    (run,) = read_records([write(tmp_path, text)], replace(LAYOUT, gaps="bridge"))
    assert run.t == pytest.approx(first + at, abs=1e-6)


def test_a_header_of_a_spreadsheet_in_western_europe(tmp_path):
    text = "t;Größe [°];Kraft (µN)\n" + "".join(f"{k};{k * k},5;{k}\n" for k in range(40))
    path = write(tmp_path, text.encode("cp1252"))
    assert read_header(path).names == ("t", "Größe [°]", "Kraft (µN)")
    (run,) = read_records([path], Layout("t", columns=(("a", "Größe [°]"), ("f", "Kraft (µN)"))))
    assert run.column("a")[-1] == 39.0**2 + 0.5


@pytest.mark.parametrize("cell", ["", "NaN", "NA", "nan", " ", " NaN ", "#N/A", "None", "-1.#IND"])
def test_missing_cells_are_gaps(tmp_path, cell):
    text = ["t,x,force", *(f"{k},{cell if k == 20 else k * k},{k}" for k in range(40))]
    refused(tmp_path, text, r"column 'x' has 1 gap \(data row 21\)", replace(LAYOUT, gaps="refuse"))
    (run,) = read_records([tmp_path / "run1.csv"], LAYOUT)
    assert np.array_equal(run.counted("x"), np.arange(40) != 20)
    assert run.column("x")[20] == pytest.approx(400.0)
    runs = read_records([tmp_path / "run1.csv"], Layout("t", columns=LAYOUT.columns, gaps="split"))
    assert [(run.t[0], run.t[-1]) for run in runs] == [(0, 19), (21, 39)]


def test_cells_of_loose_columns_that_are_no_numbers_are_missing(tmp_path):
    text = ["t;x;force;u", *(f"{k};{k},5;{k};{k}" for k in range(40))]
    text[1], text[21], text[31] = "0;s;0;0", "20;20.5;?;20", "30;;30;30"
    columns = (*LAYOUT.columns, ("v", "u"))
    refused(tmp_path, text, r"'x' .*\(line 2: 's', line 22: '20.5'\)", replace(LAYOUT, columns=columns))
    (run,) = read_records([tmp_path / "run1.csv"], replace(LAYOUT, columns=columns, loose=frozenset({"x", "force"})))
    counted = np.flatnonzero(run.counted("x") == 0.0).tolist(), np.flatnonzero(run.counted("u") == 0.0).tolist()
    assert counted == ([19, 29], [19])  # a recording begins with the first row of which all is there
    assert run.column("x")[[0, 38]].tolist() == [1.5, 39.5]
    assert run.column("v").tolist() == list(range(1, 40))


# files that are refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("\n\n \n", "is empty"),
        ("t,x,force\n", "column names but no rows of data"),
        ("t,x,force", "column names but no rows of data"),
        ("t,xx,force\n1,2,3\n", r"no column 'x' in run1.csv; did you mean 'xx'\? Its columns are: t, xx, force"),
        ("t,x,y\n1,2,3\n", "no column 'force' in run1.csv; there are: t, x, y"),
        ("0.0,1.5,-2e3\n1,2,3\n", "first line holds numbers, where column names are expected"),
        ("t,x,x,force\n1,2,3,4\n", "has 2 columns named 'x'"),
        ("t,x,force\n1,2,3\n\n2,2\n", r"line 4 of run1.csv has 2 cells where the header has 3"),
        ("t,x,force\n1,2,3,\n2,3,4,5\n", r"line 3 of run1.csv has 4 cells where the header has 3"),
        ("t,x,force\n1,2,3,,\n", r"line 2 of run1.csv has 5 cells where the header has 3"),
        ("t,x,force,\n1,2,3\n1,2\n", r"line 3 of run1.csv has 2 cells where the header has 4"),
        ("# t,x,force\n", "column names but no rows of data"),
        ("# by me\nt,x,force\n1,a,3\n2,2,3\n", r"'x' .*\(line 3: 'a'\)"),
        ("# by me\n1,2,3\n2,3,4\n", "first line holds numbers, where column names are expected"),
        ("t,x,force\n31/01/2024 12:00:00,2,3\n", r"line 2: .* read as 2024-01-31 12:00:00.5 or .* may be two days"),
        ("t,x,force\n1,2,2024-01-31 12:00:00\n", r"'force' .* dates are read in the column of the time alone"),
        ("t,x,force\ns,m,N\n1,2,3\n2,3,4\n", r"'t' .* not numbers \(line 2: 's'\); delete that line"),
        (
            "\nt,x,force\n1,2,3\n\n2,1e,4\n3,a,4\n4,0x1,4\n5,?,4\n",
            r"'x' .*5: '1e', line 6: 'a', line 7: '0x1' and 1 more",
        ),
        ("t,x,force\n1,1_0,3\n2,1d3,4\n", r"line 2: '1_0', line 3: '1d3'"),
        ("t;x;force\n1;1.000,5;3\n2;2;3\n", r"\(line 2: '1.000,5'\)"),
        ("t;x;force\n1;1,5;3\n2;2.5;3\n", r"column 'x' in run1.csv has cells that are not numbers \(line \d: '\d.5'\)"),
        ("t\tx\tforce\n1\t1,5\t3\n2\t2.5\t3\n", r"'x' .*\(line \d: '\d[,.]5'\)"),
        ("t,x,force\n2024-01-01 00:00,1,3\n2,1,4\n", r"'t' .*line 2: '2024-01-01 00:00'"),
        ("t,x,force\n1,²,3\n2,1,4\n", r"'x' .*line 2: '²'"),
        ("t,x,force\n1,2,3\n".encode("utf-16"), "not a text file in UTF-8"),
        ("t,x,force\n1,2,3\n".encode("utf-16-le"), "not a text file in UTF-8"),
        (b"t,x,force\n1,2\xb0,3\n2,3,4\n", r"'x' .*\(line 2: '2\ufffd'\)"),
        ("x" * 200_000 + "\n1\n", "cannot be read: field larger"),
    ],
)
def test_bad_text_files(tmp_path, text, message):
    refused(tmp_path, text, message)


def test_a_blank_line_without_a_time_column_is_a_lost_sample(tmp_path):
    layout = Layout(sample_period=1.0, columns=(("x", "x"),))
    refused(tmp_path, "x\n1\n\n2\n3\n", "line 3 of run1.csv is blank", layout)
    assert len(next(iter(read_records([write(tmp_path, "\nx\n1\n2\n3\n\n\n")], layout)))) == 3


def test_damaged_gzip_is_refused(tmp_path):
    refused(tmp_path, b"not gzip at all", "cannot be read", name="run.csv.gz")
    refused(tmp_path, gzip.compress(TEXT.encode())[:-30], "cannot be read", name="cut.csv.gz")


def test_hostile_names_and_cells_stay_text(tmp_path):
    name = "__import__('os').abort()"
    text = [f"t,{name},force", *(f"{k},{k},{k}" for k in range(20))]
    refused(tmp_path, text, "'x' in run1.csv; there are: t, __import__")
    (run,) = read_records([tmp_path / "run1.csv"], Layout("t", columns=(("x", name),)))
    assert run.names == ("x",)


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.one_of(st.binary(max_size=80), st.text("tx,;\n\r\"'1.e- " + string.ascii_lowercase, max_size=80)))
def test_no_text_gets_past_an_input_error(tmp_path, text):
    body = b"t,x,force\n0,1,2\n" + (text if isinstance(text, bytes) else text.encode())
    with contextlib.suppress(InputError):
        assert all(np.isfinite(run.values).all() for run in read_records([write(tmp_path, body)], LAYOUT))


def test_columns_that_several_spaces_separate_are_told(tmp_path):
    for before, between in (("", "   "), (" ", " ")):
        rows = [
            before + between.join(cells) for cells in (("t", "x", "force"), ("0.0", "1.5", "2"), ("0.5", "2.5", "3"))
        ]
        refused(tmp_path, rows, "several spaces stand between the columns of run1.csv: expected a comma, a semicolon")


LAID_OUT = {
    "tabs": "t\tx\n0,00\t1,5\n0,25\t-2,250\n",
    "quoted, and commas between": 't,x\n"0,00","1,5"\n"0,25","-2,250"\n',
    "said by a spreadsheet": "sep=;\nt;x\n0,00;1,5\n0,25;-2,25\n",
    "said to be commas": "sep=,\nt,x;y\n0.00,1.5\n0.25,-2.25\n",
    "a name over two lines": 't,"x\n(m)"\n0.00,1.5\n0.25,-2.25\n',
    "blank before a name over two lines": '\n"t","x\r\n(m)"\r\n0.00,1.5\r\n0.25,-2.25\r\n',
    "semicolons at the ends of lines": "t;x\n0,00;1,5;\n0,25;-2,25;\n",
    "semicolons at the ends of some": "t;x;\n0,00;1,5\n0,25;-2,25;\n",
    "said to be bars, and some end lines": "sep=|\nt|x\n0.00|1.5|\n0.25|-2.25\n",
    "comments, and names in the last": "# by me\n# t;x\n0,00;1,5\n0,25;-2,25\n",
    "bars": "t|x\n0.00|1.5\n0.25|-2.25\n",
    "bars that end all lines": "t|x|\n0.00|1.5|\n0.25|-2.25|\n",
    "bars that end some, and names in quotes": '"t"|"x"\n0.00|1.5|\n0.25|-2.25|\n',
    "single spaces": "t x\n0.00 1.5\n0.25 -2.25\n",
    "single spaces, also at the ends": "t x \n0.00 1.5 \n0.25 -2.25 \n",
    "single spaces, and names in a comment": "# t x\n0.00 1.5\n0.25 -2.25\n",
    "tabs, and dates": "t\tx\n00:00:00,00\t1,5\n00:00:00,25\t-2,250\n",
}


@pytest.mark.parametrize("kind", LAID_OUT)
@pytest.mark.parametrize("rows", [2, 40_000])
def test_what_spreadsheets_of_all_countries_write_is_read(tmp_path, kind, rows):
    head, lines = LAID_OUT[kind].rsplit("\n", 3)[0], LAID_OUT[kind].splitlines()[-2:]
    path = tmp_path / "a.csv"
    path.write_bytes(("\n".join([head, *lines * (rows // 2)]) + "\n").encode())
    name = {"said to be commas": "x;y", "a name over two lines": "x (m)"}.get(kind, "x (m)" if "blank" in kind else "x")
    layout = Layout(time="t", columns=(("x", name),))
    with opened(path) as format_of:
        found = format_of.read(path, layout)
        np.testing.assert_allclose(times(found["t"], layout, "a"), [0.0, 0.25] * (rows // 2))
        np.testing.assert_allclose(numbers(found[name], name, "a"), [1.5, -2.25] * (rows // 2))
        survey = format_of.survey(path, layout)
        assert survey.rows == rows
        parts = [format_of.read_chunk(chunk, layout) for chunk in cut(survey, 10_000)]
        np.testing.assert_allclose(
            np.concatenate([numbers(p[name], name, "a") for p in parts]), [1.5, -2.25] * (rows // 2)
        )


@pytest.mark.parametrize("separator", ["\t", ","])
def test_commas_that_may_stand_between_thousands_are_refused(tmp_path, separator):
    path, quote = tmp_path / "a.csv", '"' if separator == "," else ""
    cells = [(k, f"{quote}{k + 900:,}{quote}") for k in range(200)]
    path.write_text("\n".join([f"t{separator}x", *(f"{k}{separator}{x}" for k, x in cells)]) + "\n")
    with pytest.raises(InputError, match="such as '1,000', whose comma may stand between thousands or before decimals"):
        read_records([path], Layout(time="t", columns=(("x", "x"),)))
