"""Fixtures that every test may use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from tests.captures import FOLDER, public_folder

if TYPE_CHECKING:
    from pathlib import Path

# How long an example takes depends on what else the machine does, so no test fails for it.
settings.register_profile(
    "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any machine")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="Write what captures/ decodes to into its .expected.jsonl files, to be read by eye.",
    )


@pytest.fixture(scope="session")
def public_captures() -> Path:
    """The folder of captures made by others; skips where it is absent."""
    folder = public_folder()
    if not folder.is_dir():
        pytest.skip(f"no captures made by others: set {FOLDER} to their folder")
    return folder
