"""What all tables share."""

from __future__ import annotations

import io

from rich.console import Console

from mbtool.views.tables import plain, plain_table, printable


def test_what_a_terminal_would_obey_is_a_question_mark() -> None:
    assert printable("a\x1b[31mb\n") == "a?[31mb?"
    assert printable("CH1 27.5 \u00b0C") == "CH1 27.5 \u00b0C"


def test_brackets_in_a_cell_are_no_markup() -> None:
    assert plain("[bold]a[/]").plain == "[bold]a[/]"


def test_a_table_has_its_headings_and_no_frame() -> None:
    table = plain_table("name", "value")
    table.add_row(plain("[a]"), "1")
    out = io.StringIO()
    Console(file=out, width=40).print(table)
    assert [line.rstrip() for line in out.getvalue().splitlines()] == ["name  value", "[a]   1"]
