"""Runs the SQL of docs/sql.md with DuckDB: python -m tests.docs.sql_page writes its answers there.

An answer is the text block behind its question.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "sql.md"
QUESTION = re.compile(
    r"^```sql\n(?P<sql>.*?)^```\n(?:\n```text\n(?P<answer>.*?)^```\n)?", re.M | re.S
)
_PROFILE = re.compile(r'^```toml title="(?P<name>[^"]+)"\n(?P<text>.*?)^```', re.M | re.S)
_COMMAND = re.compile(r"^\$ mbtool (?P<arguments>.*)$", re.M)


def questions(page: str) -> list[tuple[str, str]]:
    """Return the questions of the page with their answers, "" for one that has none."""
    return [(one["sql"], one["answer"] or "") for one in QUESTION.finditer(page)]


def make_files(page: str, folder: Path) -> None:
    """Run the commands of the page in a folder."""
    shutil.copy(ROOT / "captures/plant.pcap", folder)
    for profile in _PROFILE.finditer(page):
        (folder / profile["name"]).write_text(profile["text"], encoding="utf-8")
    for command in _COMMAND.finditer(page):
        words = [sys.executable, "-m", "mbtool", *command["arguments"].split()]
        subprocess.run(words, cwd=folder, check=True, capture_output=True)


def answered(sql: str, folder: Path) -> str:
    """Ask DuckDB in a folder; return its answer as aligned columns."""
    import duckdb

    with duckdb.connect() as connection:
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute(f"SET file_search_path = '{folder}'")
        table = connection.sql(sql).to_arrow_table()
    columns = [[name, *map(_text, table[name].to_pylist())] for name in table.column_names]
    widths = [max(map(len, column)) for column in columns]
    lines = zip(*columns, strict=True)
    return "".join("  ".join(map(str.ljust, line, widths)).rstrip() + "\n" for line in lines)


def _text(value: Any) -> str:
    if isinstance(value, datetime):
        return value.strftime("%H:%M:%S" if not value.microsecond else "%H:%M:%S.%f")
    return "" if value is None else str(value)


def main() -> None:
    """Write the answers of this run into the page."""
    page = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        make_files(page, folder)
        os.chdir(folder)

        def with_answer(one: re.Match[str]) -> str:
            return f"```sql\n{one['sql']}```\n\n```text\n{answered(one['sql'], folder)}```\n"

        PAGE.write_text(QUESTION.sub(with_answer, page), encoding="utf-8")


if __name__ == "__main__":
    main()
