"""The questions of docs/sql.md, asked with DuckDB, polars and pandas."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stdout
from typing import TYPE_CHECKING

import pytest

from tests.docs.sql_page import PAGE, answered, make_files, questions

if TYPE_CHECKING:
    from pathlib import Path

TEXT = PAGE.read_text(encoding="utf-8")
PYTHON = dict(re.findall(r"^```python\nimport (\w+)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("sql")
    make_files(TEXT, made)
    return made


def needs(name: str) -> None:
    pytest.importorskip(name, reason=f"{name} is not installed: pip install 'mbtool[data]'")


def test_there_are_ten_questions() -> None:
    assert len(questions(TEXT)) == 10
    assert set(PYTHON) == {"pandas", "polars"}


@pytest.mark.parametrize(
    ("sql", "answer"), questions(TEXT), ids=re.findall("^### (.*)$", TEXT, re.MULTILINE)
)
def test_duckdb_answers_as_the_page_says(sql: str, answer: str, folder: Path) -> None:
    needs("duckdb")
    assert answered(sql, folder) == answer


def test_duckdb_calculates_with_times_as_they_are(folder: Path) -> None:
    needs("duckdb")
    asked = """SELECT count(*) AS many, max(time) - min(time) > INTERVAL 19 SECOND AS longer
        FROM 'plant.parquet' WHERE time > TIMESTAMPTZ '2026-01-01 00:00:00+00'"""
    assert answered(asked, folder).split() == ["many", "longer", "63", "True"]


@pytest.mark.parametrize("name", ["polars", "pandas"])
def test_the_program_of_the_page_prints_the_average_of_each_minute(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs(name)
    monkeypatch.chdir(folder)
    out = io.StringIO()
    with redirect_stdout(out):
        exec(f"import {name}\n{PYTHON[name]}", {})
    assert "2026-01-01 00:00:00" in out.getvalue()
    assert re.search(r"\b23\.095.*\b23\.0\d*\b", out.getvalue(), re.DOTALL)


def test_polars_and_pandas_read_times_in_microseconds(folder: Path) -> None:
    needs("polars")
    needs("pandas")
    import pandas
    import polars

    for file in ("plant.parquet", "points.parquet"):
        assert polars.read_parquet(folder / file)["time"].dtype == polars.Datetime("us", "UTC")
        assert str(pandas.read_parquet(folder / file)["time"].dtype) == "datetime64[us, UTC]"
