"""mbtool diff: compare two captures by their requests and values, not byte by byte."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mbtool.cli import exit_codes
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import DeviceOption, RawOption, SourceOptions, WhereOption, condition
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say, say_if_interrupted

if TYPE_CHECKING:
    from mbtool.workflows.diff import Comparison


@with_option_groups
def diff(
    a: Annotated[
        str, typer.Argument(metavar="A", help="A log or a capture, as for decode: how it was.")
    ],
    b: Annotated[str, typer.Argument(metavar="B", help="The one that is held against it.")],
    *,
    device: DeviceOption = None,
    where: WhereOption = None,
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            "--ignore",
            metavar="RANGE",
            help="Registers whose values may differ: HR400010..400020, as the device's manual "
            "writes them, or 'holding 9..19'. Repeatable.",
        ),
    ] = None,
    latency: Annotated[
        bool, typer.Option("--latency/--no-latency", help="Compare latencies, too.")
    ] = True,
    connections: Annotated[
        bool,
        typer.Option(
            "--connections/--no-connections",
            help="Compare how TCP connections began and ended, too.",
        ),
    ] = True,
    format_: Annotated[
        Literal["table", "json"], typer.Option("--format", help="How to print.")
    ] = "table",
    raw: RawOption = False,
    source: SourceOptions,
) -> None:
    """Compare two captures by meaning; exit 1 when they differ.

    Ids, order and times do not count. What counts: slaves and requests that are in one only, ways
    in which a request ended, values that registers had, latencies that differ by more than chance,
    and ways in which TCP connections began and ended.
    """
    import msgspec

    from mbtool.cli.console import PipeConsole
    from mbtool.cli.output import verdict_kept
    from mbtool.views.differences import count_text, print_differences
    from mbtool.workflows.diff import DiffOptions, compare

    options = DiffOptions(
        reading=source.read(device, raw=raw),
        wanted=condition(where),
        ignore=ignore or (),
        latency=latency,
        connections=connections,
    )
    with say_if_interrupted("interrupted; nothing was compared"):
        compared = compare(a, b, options, say, with_progress)
    with verdict_kept(lambda: bool(compared.differences)):
        if format_ == "json":
            typer.echo(msgspec.json.format(msgspec.json.encode(compared), indent=2).decode())
        else:
            print_differences(PipeConsole(), compared.differences)
    if not compared.is_whole:
        say("mbtool: there is more than can be compared at once; choose a part with --where")
    say(f"{count_text(compared.differences)} {_compared_text(compared)}")
    if compared.differences:
        raise typer.Exit(exit_codes.NO)
    if not compared.is_whole:
        raise typer.Exit(exit_codes.UNREADABLE)


def _compared_text(compared: Comparison) -> str:
    """Say what was compared: `between 120 transactions of a.mcap and 123 of b.mcap`."""
    if compared.is_whole:
        return (
            f"between {compared.a_transactions:,} transactions of {compared.a} "
            f"and {compared.b_transactions:,} of {compared.b}"
        )
    return (
        "in the part that was compared: "
        f"{compared.a_compared:,} of {compared.a_transactions:,} transactions of {compared.a} "
        f"and {compared.b_compared:,} of {compared.b_transactions:,} of {compared.b}"
    )
