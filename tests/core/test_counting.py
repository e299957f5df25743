"""Words for a number of things."""

from __future__ import annotations

from mbtool.core.counting import counted, plural


def test_one_is_singular_and_all_else_plural() -> None:
    assert [plural(number, "byte") for number in (0, 1, 2)] == ["bytes", "byte", "bytes"]
    assert [counted(number, "byte") for number in (1, 2000)] == ["1 byte", "2,000 bytes"]
