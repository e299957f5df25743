"""Puts captures into one Parquet file, and asks it: parquet_and_duckdb.py OUT.parquet CAPTURE...

Parquet is read by DuckDB, Polars, pandas, Spark and Grafana's plugins. The question at the end is
asked with DuckDB if it is installed (pip install duckdb), and with pyarrow otherwise.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec

import pyarrow.compute as pc
import pyarrow.parquet as pq

import mbtool

QUESTION = """
    select destination, count(*) as asked, max(latency_ns) / 1e6 as slowest_ms
    from 'FILE' group by destination order by slowest_ms desc
"""


def main(out: str, *captures: str) -> None:
    """Write the file and print the slowest answer of each slave."""
    table = mbtool.open(*captures).to_arrow()
    pq.write_table(table, out)
    print(f"{table.num_rows} transactions -> {out}")
    if find_spec("duckdb"):
        import duckdb  # type: ignore[import-not-found,unused-ignore]

        print(duckdb.sql(QUESTION.replace("FILE", out)))
        return
    slaves = pq.read_table(out)
    for slave in pc.unique(slaves["destination"]).to_pylist():
        rows = slaves.filter(pc.equal(slaves["destination"], slave))
        slowest_ms = pc.max(rows["latency_ns"]).as_py() / 1e6
        print(f"{slave}: asked {rows.num_rows}, slowest {slowest_ms:.1f} ms")


if __name__ == "__main__":
    main(*sys.argv[1:])
