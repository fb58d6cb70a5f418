"""What the tests of chunks and chunks_of_folders share."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pytest
from pyarrow import parquet

from odescope.errors import InputError
from odescope.recordings.chunks import cut
from odescope.recordings.layout import Layout
from odescope.recordings.readers import read_chunk, read_records, survey

LAYOUT = Layout(time="t", columns=(("x", "x"), ("u", "force")))


LAPS = Layout(time="t", columns=LAYOUT.columns, recording="lap", gaps="split")


N = 300


FORCE = np.random.default_rng(0).standard_normal(N)


TABLE = {"t": 0.25 * np.arange(N), "x": np.exp(FORCE), "note": np.array(["ok"] * N), "force": FORCE}


def write(folder, text, name="run1.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def text_of(table, separator=",", decimal="."):
    return pd.DataFrame(table).to_csv(index=False, sep=separator, decimal=decimal)


def write_parquet(folder, table, group=N, name="run.parquet"):
    parquet.write_table(pa.table(table), folder / name, row_group_size=group)
    return folder / name


def stretches(path, layout, rows, overlap=0):
    return [part for chunk in cut(survey(path, layout), rows, overlap) for part in read_chunk(chunk, layout)]


def own(parts):
    """Return the own samples of all stretches together: time, then the columns."""
    return np.concatenate([np.column_stack([p.record.t, p.record.values])[p.first : p.stop] for p in parts])


def samples(path, layout):
    return np.concatenate([np.column_stack([run.t, run.values]) for run in read_records([path], layout)])


def refused(path, layout, message, rows=100, overlap=0):
    with pytest.raises(InputError, match=message) as caught:
        stretches(path, layout, rows, overlap)
    assert path.name in str(caught.value)


def blank_lines(text):
    lines = text.split("\n")
    return (
        "\n\n" + "\n".join(line + "\n" * (k % 7 == 3) + "\n" * (k % 50 == 9) for k, line in enumerate(lines)) + "\n\n"
    )


TEXTS = {
    "plain": text_of(TABLE),
    "without a last line end": text_of(TABLE).rstrip("\n"),
    "blank lines": blank_lines(text_of(TABLE)),
    "crlf": text_of(TABLE).replace("\n", "\r\n"),
    "crlf and blank lines": "\ufeff" + blank_lines(text_of(TABLE)).replace("\n", "\r\n"),
    "decimal comma": text_of(TABLE, ";", ","),
    "semicolon and decimal point": text_of(TABLE, ";"),
    "cells that only Python reads": text_of(TABLE).replace(",0.", ",+0."),
    "tabs": text_of(TABLE, "\t"),
}
