"""The page of troubles has a section for each row of the table of words, and no other."""

from __future__ import annotations

import re
from pathlib import Path

from mbtool.troubles.words import WORDS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "troubles.md").read_text(encoding="utf-8")


def test_each_trouble_has_a_section() -> None:
    assert sorted(re.findall(r"^### (\S+)$", PAGE, re.MULTILINE)) == sorted(WORDS)


def test_what_a_trouble_explains_is_a_trouble_or_a_rule() -> None:
    from mbtool.devices.checking.rules import RULES

    for row in WORDS.values():
        assert {*row.explains} <= {*WORDS, *RULES}, row.code
