"""Several options as one object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from mbtool.cli.option_groups import OptionGroup, with_option_groups


@dataclass(frozen=True, slots=True)
class Colours(OptionGroup):
    front: Annotated[str, typer.Option("--front", help="In front.")] = "black"
    back: Annotated[list[str] | None, typer.Option("--back", help="Behind.")] = None


@with_option_groups
def paint(
    what: Annotated[str, typer.Argument()],
    *,
    colours: Colours,
    fast: Annotated[bool, typer.Option("--fast")] = False,
) -> None:
    """Paint something."""
    typer.echo(f"{what} {colours.front} {colours.back} {fast}")


app = typer.Typer(rich_markup_mode=None)
app.command()(paint)


def test_a_group_holds_what_its_options_are_given() -> None:
    words = ["wall", "--back", "red", "--back", "blue", "--front", "white", "--fast"]
    assert CliRunner().invoke(app, words).stdout == "wall white ['red', 'blue'] True\n"


def test_options_that_are_not_given_have_the_defaults_of_the_fields() -> None:
    assert CliRunner().invoke(app, ["wall"]).stdout == "wall black None False\n"


def test_options_stand_in_the_help_in_the_order_of_the_parameters() -> None:
    shown = CliRunner().invoke(app, ["--help"]).stdout
    places = [shown.index(word) for word in ("Paint something.", "--front", "--back", "--fast")]
    assert places == sorted(places)
