"""docs/python.md tells the interface as the docstrings do."""

from __future__ import annotations

import re

import pytest

import mbtool
from tests.interface_page import CLASSES, FUNCTIONS, PAGE, written_page


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
