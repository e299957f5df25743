"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_HERE = Path(__file__).resolve().parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="Write what captures/ decodes to into its .expected.jsonl files, to be read by eye.",
    )


@pytest.fixture(scope="session")
def public_captures() -> Path:
    """The folder of captures made by others; skips where it is absent."""
    folder = Path(
        os.environ.get("MBTOOL_PUBLIC_CAPTURES", _HERE.parent / ".." / "shared" / "captures")
    )
    if not folder.is_dir():
        pytest.skip("no captures made by others: set MBTOOL_PUBLIC_CAPTURES to their folder")
    return folder
