"""mbtool read and mbtool write: ask a slave once, as its master."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli import exit_codes
from mbtool.cli.ask_options import AskOptions, LinkArgument, ReferencesArgument, print_asked
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import Format, TableOptionGroup
from mbtool.cli.talk import say
from mbtool.core import UsageError

if TYPE_CHECKING:
    from mbtool.cli.ask_options import AskedSlave
    from mbtool.views.table_options import TableOptions


@with_option_groups
def read(
    link: LinkArgument,
    references: ReferencesArgument,
    *,
    ask: AskOptions,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    table: TableOptionGroup,
) -> None:
    """Read from a slave, once, as its master.

    A long range is read with several requests, as many as the device's manual asks for. Exit 1 when
    a request gets an exception or no answer.
    """
    asked, options = ask.read(link, references), table.read()
    requests = [pdu for each in asked.references for pdu in asked.wording.reads(each)]
    _ask_all(asked, requests, format_, options)


@with_option_groups
def write(
    link: LinkArgument,
    values: Annotated[
        list[str],
        typer.Argument(
            metavar="REFERENCE=VALUE",
            help="What to write: HR400001=4660, 'holding 0=1,2,3', 'coil 3=on', or the name of a "
            "point and a value in its unit; with a type, hr10=23.4:f32cdab. References are those "
            "of mbtool read.",
        ),
    ],
    *,
    ask: AskOptions,
    yes: Annotated[
        bool, typer.Option("--yes", help="Write without asking; needed where there is no terminal.")
    ] = False,
    format_: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.TABLE,
    table: TableOptionGroup,
) -> None:
    """Write to a slave, once, as its master.

    It shows what it will write, and asks at the terminal. Each REFERENCE=VALUE is one request.
    Exit 1 when a request gets an exception or no answer, or when you say no.
    """
    asked, options = ask.read(link, values, writes=True), table.read()
    requests = [asked.wording.write(each) for each in asked.references]
    if not yes:
        _demand_consent(asked, values)
    if_interrupted = "interrupted; the slave may have taken what was sent, or may take it yet"
    _ask_all(asked, requests, format_, options, if_interrupted)


def _demand_consent(asked: AskedSlave, values: Sequence[str]) -> None:
    """Ask the user at the terminal for consent to a write.

    Raises typer.Exit if the answer is no, UsageError if there is no terminal to ask at.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise UsageError("write: nobody can be asked here, as there is no terminal; give --yes")
    say(f"write {'; '.join(values)} to unit {asked.unit} at {asked.link}")
    if not typer.confirm("really?", err=True):
        say("nothing is written")
        raise typer.Exit(exit_codes.NO)


def _ask_all(
    asked: AskedSlave,
    requests: Sequence[bytes],
    format_: Format,
    options: TableOptions,
    if_interrupted: str = "interrupted",
) -> None:
    """Send the requests, print their transactions, and exit with 1 if one failed.

    `requests` are PDUs. A request fails if it gets an exception response, a malformed response or
    none. If Ctrl-C comes before the first transaction, `if_interrupted` is printed.
    """
    from mbtool.workflows.ask import ANSWERED_OUTCOMES

    with asked.open(format_, options, if_interrupted=if_interrupted) as (asker, out):
        done = [print_asked(asker, out, pdu) for pdu in requests]
    if any(one.outcome not in ANSWERED_OUTCOMES for one in done):
        raise typer.Exit(exit_codes.NO)
