"""docs/python.md tells the interface as the docstrings do."""

from __future__ import annotations

import re
import shutil
from typing import TYPE_CHECKING, Any

import pytest

import mbtool
from tests.interface_page import CLASSES, FUNCTIONS, PAGE, written_page

if TYPE_CHECKING:
    from pathlib import Path

CAPTURES = PAGE.parents[1] / "captures"


def test_the_page_is_what_the_docstrings_say() -> None:
    page = PAGE.read_text()
    assert written_page(page) == page, "run: python -m tests.interface_page"


def test_the_page_describes_every_function_class_and_error() -> None:
    described = {*FUNCTIONS, *CLASSES, *(one for one in mbtool.__all__ if one.endswith("Error"))}
    values = {"NamedTransaction", "PointValue", "WireEvent", "EventKind", "Outcome", "__version__"}
    assert described | values == set(mbtool.__all__)


@pytest.mark.parametrize("name", ["python.md", "pytest.md"])
def test_the_python_of_a_page_can_be_read_and_names_what_is_there(name: str) -> None:
    page = (PAGE.parent / name).read_text().partition("<!--")[0]
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert blocks
    for block in blocks:
        compile(block, name, "exec")
        assert set(re.findall(r"\bmbtool\.(\w+)", block)) <= set(mbtool.__all__)


def test_the_programs_that_read_a_capture_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("pandas", "polars"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install 'mbtool[data]'")
    shutil.copy(CAPTURES / "fa3-at1m8x-setup.pcapng", tmp_path / "plant.pcapng")
    shutil.copy(CAPTURES / "plant.pcap", tmp_path)
    monkeypatch.chdir(tmp_path)
    part = PAGE.read_text().partition("## Read a capture")[2].partition("## Listen")[0]
    blocks = re.findall(r"```python\n(.*?)```", part, re.DOTALL)
    assert len(blocks) == 3
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    out = capsys.readouterr().out
    assert "UNIT-SLOW" in out
    assert "10.0.0.12 2 19\n" in out
