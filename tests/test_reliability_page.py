"""The table of hostile inputs in docs/reliability.md."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROW = re.compile(r"^\| (?P<input>.+) \| `(?P<file>tests/\S+\.py)::(?P<test>\w+)` \|$", re.MULTILINE)


def test_at_least_100_hostile_inputs_have_a_test_that_exists() -> None:
    rows = ROW.findall((ROOT / "docs" / "reliability.md").read_text(encoding="utf-8"))
    assert len({(file, test) for _, file, test in rows}) >= 100
    missing = [
        (file, test)
        for _, file, test in rows
        if f"def {test}(" not in (ROOT / file).read_text(encoding="utf-8")
    ]
    assert not missing
