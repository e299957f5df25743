from __future__ import annotations

from itertools import product

from mbtool.core.serial_format import ModemLine, ModemLines


def test_the_text_of_what_is_done_with_the_lines_is_read_back() -> None:
    for dtr, rts in product(ModemLine, ModemLine):
        lines = ModemLines(dtr, rts)
        assert ModemLines.parse(str(lines)) == lines
