"""Tables in memory: dataframes with the Arrow interface, mappings of name to array."""

from __future__ import annotations

from collections.abc import Mapping

from odescope.errors import InputError, said
from odescope.recordings.columns import Columns, check_columns, first_line, from_arrays, from_table
from odescope.recordings.layout import Layout


def frame_columns(data: object, layout: Layout, source: str) -> Columns:
    """Return the used columns of a dataframe or a mapping as Arrow columns.

    Args:
        data: with the Arrow interface, or name to array.
        layout: says which columns are used.
        source: what to call the data in messages.

    Raises:
        InputError: data of another kind, or columns that are missing or do not fit together.
    """
    import pyarrow as pa

    if hasattr(data, "__arrow_c_stream__"):
        try:
            table = pa.table(data)
        except (pa.ArrowException, ValueError, TypeError) as error:
            raise InputError(f"{source} cannot be read as a table: {first_line(error)}") from error
        check_columns(layout.used, table.column_names, source)
        return from_table(table, layout)
    if isinstance(data, Mapping):
        named = {str(name): column for name, column in data.items()}
        check_columns(layout.used, list(named), source)
        return from_arrays({label: named[label] for label in layout.used}, source)
    raise InputError(
        f"{source} is {said(data)}; expected a dataframe with the Arrow interface (pandas, polars, pyarrow)"
        ", a mapping of name to array, or a list of these; files go to read_records"
    )


def table_names(data: object) -> tuple[str, ...]:
    """Return the names of the columns of a dataframe or a mapping; none of what is neither."""
    import pyarrow as pa

    if isinstance(data, Mapping):
        return tuple(map(str, data))
    if hasattr(data, "__arrow_c_stream__"):
        try:
            return tuple(pa.RecordBatchReader.from_stream(data).schema.names)
        except (pa.ArrowException, ValueError, TypeError):
            return ()  # reading it says why it cannot be read
    return ()
