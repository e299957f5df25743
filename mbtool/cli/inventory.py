"""mbtool inventory: list hosts, units and masters of captures, and what is new among them."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from mbtool.cli import exit_codes
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import (
    CaptureOptions,
    OverwriteOption,
    WhereOption,
    condition,
)
from mbtool.cli.output_file import report_kept, report_left
from mbtool.cli.output_path import chosen_format, demand_new, demand_other_file, named_file
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import say
from mbtool.core.moments import counted
from mbtool.version import __version__
from mbtool.workflows.shared.named_files import named_files

if TYPE_CHECKING:
    from mbtool.ledger.baseline import InventoryChange
    from mbtool.ledger.inventory_rows import InventoryDocument
    from mbtool.workflows.inventory import InventoryRun


class InventoryFormat(StrEnum):
    """The form in which an inventory is printed."""

    TABLE = "table"
    JSON = "json"
    CSV = "csv"


_SUFFIXES = {
    ".txt": InventoryFormat.TABLE,
    ".json": InventoryFormat.JSON,
    ".csv": InventoryFormat.CSV,
}


@with_option_groups
def inventory(
    files: Annotated[
        list[str], typer.Argument(metavar="FILE", help="Captures and logs, as for decode.")
    ],
    *,
    capture: CaptureOptions,
    where: WhereOption = None,
    baseline: Annotated[
        list[str] | None,
        typer.Option(
            "--baseline",
            metavar="OLD",
            help="Print what is new since OLD: an inventory of --format json, or a capture or log. "
            "Repeatable for several captures. Exit code 1 means that there is something.",
        ),
    ] = None,
    format_: Annotated[
        InventoryFormat | None,
        typer.Option(
            "--format",
            help="How to print. [default: table, or what the name of --output says]",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("--output", "-o", metavar="OUT", help="Write to a file: .txt, .json or .csv."),
    ] = None,
    overwrite: OverwriteOption = False,
    each: Annotated[
        bool,
        typer.Option(
            "--all", help="In a table, a row for units that never answered, and all ranges."
        ),
    ] = False,
) -> None:
    """List hosts and units of captures, and who asks them what.

    A profile is named only where enough was seen to be sure. docs/inventory.md explains the
    columns.
    """
    from mbtool.cli.output import as_output_error, opened, say_if_empty, say_troubles
    from mbtool.workflows.inventory import InventoryOptions, InventoryRun, changes_since

    files, baseline = named_files(files), named_files(baseline or ())
    options = InventoryOptions(
        reading=capture.read(),
        wanted=None if where is None else condition(where),
    )
    demand_other_file([*files, *baseline], output)
    path = named_file(output)
    chosen = chosen_format(format_, path, _SUFFIXES, InventoryFormat.TABLE)
    with report_left(path):
        run = InventoryRun(files, options)
        # The output is opened only after all inputs were read, so that an error does not overwrite
        # an older output.
        run.reading.demand_files()
        demand_new(path, overwrite=overwrite)
        with report_kept(path):
            document = run.take(say, with_progress)
            run.reading.demand_readable()
            new = changes_since(baseline, document, options, say) if baseline else None
        with opened(path, lambda: None, overwrite=overwrite) as (file, name), as_output_error(name):
            if chosen is InventoryFormat.JSON:
                file.write(_json(run, document, new, __version__))
            else:
                _write(file, chosen, document, new, everything=each)
            file.flush()
    say_if_empty(run.reading)
    if document.transactions:
        say_troubles(run.judgement())
    say(_sentence(document, new) + ("" if path is None else f" -> {path}"))
    for what, count in document.left_out.items():
        say(f"mbtool: {count:,} {what}: there are more than are kept at once")
    if run.error is not None:
        raise run.error
    if new:
        raise typer.Exit(exit_codes.NO)


def _json(
    run: InventoryRun,
    document: InventoryDocument,
    new: Sequence[InventoryChange] | None,
    version: str,
) -> str:
    """Return the inventory and the changes since the baseline (None: no baseline) as JSON."""
    from mbtool.views.inventory_documents import inventory_json

    why = run.reading.why_empty if run.error is None else str(run.error)
    remarks = [*run.reading.remarks, *([] if why is None else [why])]
    return inventory_json(
        document,
        version,
        new,
        judgement=run.judgement(),
        remarks=remarks,
        is_whole=run.error is None,
    )


def _write(
    file: TextIO,
    format_: InventoryFormat,
    document: InventoryDocument,
    new: Sequence[InventoryChange] | None,
    *,
    everything: bool,
) -> None:
    """Write the inventory in one of the formats but JSON to `file`.

    `new` are the changes since the baseline, None without a baseline. With a baseline, a table or
    CSV has only the changes. `everything` lets the table show all rows.
    """
    from mbtool.cli.console import PipeConsole
    from mbtool.views.inventory_documents import changes_csv, inventory_csv
    from mbtool.views.inventory_table import print_changes, print_inventory

    match format_:
        case InventoryFormat.TABLE if new is not None:
            print_changes(PipeConsole(file=file), new)
        case InventoryFormat.TABLE:
            print_inventory(PipeConsole(file=file), document, everything=everything)
        case InventoryFormat.CSV:
            file.write(inventory_csv(document) if new is None else changes_csv(new))


def _sentence(document: InventoryDocument, new: Sequence[InventoryChange] | None) -> str:
    """Sum up an inventory: `2 hosts with 5 units, 1 master in 812 transactions`.

    `new` are the changes since the baseline, which are counted first; None without a baseline.
    """
    from mbtool.ledger.inventory_rows import Role

    quiet = sum(row.role in (Role.SILENT, Role.UNHEARD) for row in document.slaves)
    rows = [row for row in document.slaves if row.role not in (Role.SILENT, Role.UNHEARD)]
    hosts = len({row.place for row in rows})
    text = f"{counted(hosts, 'host', ',')} with {counted(len(rows), 'unit', ',')}"
    text += f", {counted(len(document.masters), 'master', ',')}"
    if quiet:
        text += f", {counted(quiet, 'unit', ',')} that never answered"
    text += f" in {counted(document.transactions, 'transaction', ',')}"
    if new is not None:
        text = f"{counted(len(new), 'change', ',')} since the baseline; {text}"
    return text
