"""A log too long for little memory, studies of it, and threads that count, for the tests of chunks and factors."""

from __future__ import annotations

from dataclasses import dataclass, field

import pyarrow as pa
from logs import oscillator, write
from pyarrow import parquet

from odescope.likelihood.search import LikelihoodSearch
from odescope.parallel.workers import Threads
from odescope.pipeline.sample import SAMPLED, rows_in_memory
from odescope.study.options import Data, Driven, Measured, Study

LITTLE = 570.0  # MB: just above what is refused, so that 50 000 rows are too many
ROWS = 120_000
CHUNKS = -(-ROWS // (rows_in_memory(LITTLE, 3) // SAMPLED))
SCHEMA = [("t", pa.float64()), ("x", pa.float64()), ("u", pa.float64()), ("run", pa.int64())]
REGRESSED = LikelihoodSearch(enabled=False)


def long_log():
    """Return x'' = -4 x - 0.3 x' + u over forty minutes."""
    return oscillator(ROWS, noise=0.01)


def written(where, log):
    """Write the log as one Parquet file of one row group, as CSV, and as a Parquet dataset of twelve files."""
    parquet.write_table(pa.table(log), where / "log.parquet")
    write(str(where / "log.csv"), log)
    (where / "parts").mkdir()
    for k in range(12):
        part = {name: column[k * 10_000 : (k + 1) * 10_000] for name, column in log.items()}
        parquet.write_table(pa.table(part), where / "parts" / f"part-{k:02}.parquet")
    return where


def study_of(*files, memory=LITTLE, **options):
    data = Data(files=tuple(map(str, files)), time="t", memory=memory)
    given = {"coordinates": {"x": Measured(order=2)}, "inputs": {"u": Driven()}, "likelihood": REGRESSED}
    return Study(data=data, **{**given, **options})


def coefficients(result):
    return {t.text: t.coefficient for relation in result.model.relations for t in relation.terms}


@dataclass(frozen=True)
class Counted:
    """Threads that note what they are asked to do."""

    asked: list = field(default_factory=list)
    count: int = 2
    remote: bool = False

    def at_most(self, count):
        return self

    def map(self, function, items, *shared, **options):
        items = list(items)
        self.asked.append((function.__name__, len(items)))
        yield from Threads().map(function, items, *shared, **options)

    @property
    def chunks(self):
        return sum(count for name, count in self.asked if name == "reduce")
