"""Reads tables, CSV and Parquet, as columns of numbers."""

import csv
import math
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from simgap.formats.column_names import nearest, unused
from simgap.types import MOST_ROWS, Field, RecordingError, Schema

ROW_LIMIT = 2**20
"""Maximum characters in a row of a CSV file: some ten thousand columns."""
_TEXT_SHOWN = 40  # characters of a file's own text in a message
Columns = dict[str, Float[np.ndarray, " T"]]


def read_table(path: Path, columns: Sequence[str]) -> Columns:
    """Columns of a CSV or Parquet file as numbers, blanks as NaN; RecordingError names file, column and row."""
    schema = Schema(state=(), command=tuple(Field(name, "", "position", "world") for name in columns))
    try:
        table = table_columns(path, schema)
    except OSError as error:
        raise unreadable(path, error) from None
    missing = [name for name in columns if name not in table]
    if missing:
        there = column_names(path)
        raise RecordingError(
            f"{path}: column {', '.join(missing)} is missing{nearest(missing, there)}. {unused(there, columns)} "
            "Correct the mapping file, or leave the file out."
        )
    return table


def table_columns(path: Path, schema: Schema) -> Columns:
    """The schema's columns that a CSV or Parquet file has, blanks as NaN.

    Raises RecordingError that names column and row, and OSError where the file cannot be opened.
    """
    return _csv_columns(path, schema) if path.suffix.lower() == ".csv" else _parquet_columns(path, schema)


def column_names(path: Path) -> list[str]:
    """Names of the columns of a CSV or Parquet file; raises as `table_columns` does."""
    if path.suffix.lower() == ".csv":
        return [name.strip() for name in next(_csv_rows(path), [])]
    try:
        return pq.read_schema(path).names
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged(path, error) from None


def unreadable(path: Path, error: OSError) -> RecordingError:
    """The error for a file that the operating system refuses to open."""
    return RecordingError(f"{path}: cannot be read ({error}). Mend or remove the file.")


def _csv_columns(path: Path, schema: Schema) -> Columns:
    """The schema's columns as numbers. Rows are not kept as text, so memory is 8 bytes a number."""
    rows = _csv_rows(path)
    header = [name.strip() for name in next(rows, [])]
    if not header:
        raise RecordingError(
            f"{path}: is empty, or its first line is; it must begin with the columns' names. "
            "Add the header, or leave the file out."
        )
    _refuse_separators(path, header, schema)
    _refuse_duplicates(path, header, schema)
    numbers = {i: (name, array("d")) for i, name in enumerate(header) if name in schema.columns}
    for number, row in enumerate(rows, 1):
        if number > MOST_ROWS:
            raise _too_many(path)
        if len(row) != len(header):
            where = (
                f"{header[len(row)]} is the first without" if len(row) < len(header) else f"{header[-1]} is the last"
            )
            raise RecordingError(
                f"{path}: row {number} has {len(row)} values for {len(header)} columns; column {where}. "
                "Mend the row, or cut the session there."
            )
        for i, (name, values) in numbers.items():
            values.append(_number(path, name, number, row[i]))
    return {name: np.array(values) for name, values in numbers.values()}


def _csv_rows(path: Path) -> Iterator[list[str]]:
    """Header and rows of a CSV file as text; ignores a byte order mark, and blank lines at the end."""
    room = ROW_LIMIT

    def lines(file: TextIO) -> Iterator[str]:
        nonlocal room
        while line := file.readline(room + 1):
            room -= len(line)
            if room < 0:
                raise RecordingError(
                    f"{path}: a row has more than {ROW_LIMIT:,} characters, {line[:_TEXT_SHOWN]!r}... . Save it as "
                    "CSV, a line a row, or leave the file out."
                )
            yield line

    blank = 0
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for row in csv.reader(lines(file)):
                room = ROW_LIMIT
                if not row:
                    blank += 1
                    continue
                yield from ([] for _ in range(blank))
                blank = 0
                yield row
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is no UTF-8 text ({error}). Save it as CSV in UTF-8.") from None
    except csv.Error as error:
        raise RecordingError(f"{path}: is no CSV ({error}). Save it with commas between the values.") from None


def _refuse_separators(path: Path, header: Sequence[str], schema: Schema) -> None:
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        names = {name.strip().strip('"') for cell in header for name in cell.split(mark)}
        if names & set(schema.columns) - set(header):
            raise RecordingError(
                f"{path}: the header has {word} between the columns; there must be commas, and a point before "
                "the decimals. Save it so."
            )


def _number(path: Path, column: str, row: int, text: str) -> float:
    """A text as a number, a blank as NaN; RecordingError where it is neither."""
    try:
        if "_" in text:  # Python reads 1_000 as a number; in a table it is a mistake
            raise ValueError
        return float(text) if text.strip() else math.nan
    except ValueError:
        raise RecordingError(
            f"{path}: column {column}, row {row} holds the text {text[:_TEXT_SHOWN]!r}; every value must be a "
            "number, with a point before the decimals. Replace the text, or cut the session there."
        ) from None


def _parquet_columns(path: Path, schema: Schema) -> Columns:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            if file.metadata.num_rows > MOST_ROWS:
                raise _too_many(path)
            names = file.schema_arrow.names
            _refuse_duplicates(path, names, schema)
            table = file.read([name for name in schema.columns if name in names])
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged(path, error) from None
    return {name: _arrow_numbers(path, name, table.column(name)) for name in table.column_names}


def _arrow_numbers(path: Path, name: str, column: pa.ChunkedArray) -> Float[np.ndarray, " T"]:
    """A column of numbers, nulls as NaN; RecordingError for any other type."""
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        first = f", in row 1 {str(column[0].as_py())[:_TEXT_SHOWN]!r}" if len(column) else ""
        raise RecordingError(
            f"{path}: column {name} holds values of type {column.type}{first}; every value must be a number, in the "
            "unit of the schema. Convert the column."
        )
    return column.to_numpy().astype(np.float64)


def _damaged(path: Path, error: Exception) -> RecordingError:
    reason = " ".join(str(error).split())
    return RecordingError(f"{path}: is no whole Parquet file ({reason}). Write or copy it again, or leave it out.")


def _too_many(path: Path) -> RecordingError:
    return RecordingError(
        f"{path}: has more than {MOST_ROWS:,} rows, the most of a session. Split it, or lower its rate."
    )


def _refuse_duplicates(path: Path, header: Sequence[str], schema: Schema) -> None:
    for name in schema.columns:
        if header.count(name) > 1:
            raise RecordingError(
                f"{path}: column {name} stands {header.count(name)} times in the header; every column must be there "
                "once. Remove or rename the others."
            )
