"""Tables of sites and others: text, or a Parquet file of very many rows."""

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

from signorini_fenicsx.solving.solved import Columns


def write_columns(path: Path, tables: Iterable[Columns]) -> None:
    """Write tables with the same columns below each other as CSV (rank 0)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for number, columns in enumerate(tables):
            if number == 0:
                writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def write_sites(path: Path, tables: Iterator[Columns], *, many: bool) -> None:
    """Write tables of sites below each other as `<path>.csv`, or as `<path>.parquet` if they are many (rank 0)."""
    if not many:
        write_columns(path.with_suffix(".csv"), tables)
        return
    import pyarrow.parquet  # takes a second to import

    first = pyarrow.table(dict(next(tables)))
    with pyarrow.parquet.ParquetWriter(path.with_suffix(".parquet"), first.schema) as writer:
        writer.write_table(first)
        for columns in tables:
            writer.write_table(pyarrow.table(dict(columns), schema=first.schema))
