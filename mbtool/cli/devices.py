"""mbtool devices: list, show and match device profiles, built-in or the user's own."""

# `mbtool devices` lists the profiles, `mbtool devices NAME` shows one. A word that is not a
# subcommand is the name or path of a profile, and goes to the hidden subcommand "show". A file with
# the name of a subcommand can be shown by its path: ./new. The subcommands are below
# and devices_own.py.

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from mbtool.cli.command import Command, with_plain_json, write_examples
from mbtool.cli.completion import items, profile_names
from mbtool.cli.devices_own import draft, export, new, schema, survey
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import ListFormat, OverwriteOption, SourceOptions
from mbtool.cli.profile_files import (
    OutputOption,
    demand_new,
    give_imported,
    profile_name,
    read_input,
    shown,
)
from mbtool.cli.talk import say
from mbtool.core import UsageError

if TYPE_CHECKING:
    from mbtool.devices.importing.options import ImportOptions
    from mbtool.devices.importing.register_list import ImportedList
    from mbtool.workflows.shared.reading import ReadingOptions


# mbtool devices import: make a profile from a register list or another register map.


# The values of AddressStyle, Scaling and WordOrder in devices/, and the first words of the tables.
# They are repeated here because importing devices/ would make --help slow.
AddressesChoice = Literal["zero-based", "one-based", "references", "hexadecimal"]
ScalingChoice = Literal["multiply", "divide"]
WordOrderChoice = Literal["high-first", "low-first"]
TableChoice = Literal["coils", "discrete", "holding", "input"]


def import_(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="A register list: CSV with a row of headings; - is standard input. With --sunspec "
            "one model or several, in their order in the device, or a folder, whose models are all "
            "tried.",
        ),
    ],
    output: OutputOption = None,
    *,
    overwrite: OverwriteOption = False,
    sunspec: Annotated[
        bool, typer.Option("--sunspec", help="FILE is a SunSpec model in JSON.")
    ] = False,
    home_assistant: Annotated[
        bool, typer.Option("--home-assistant", help="FILE is a configuration of Home Assistant.")
    ] = False,
    base: Annotated[
        int | None,
        typer.Option(
            "--base",
            metavar="ADDRESS",
            min=0,
            max=65000,
            help="SunSpec: where the map begins. [default: 40000]",
        ),
    ] = None,
    repeat: Annotated[
        int | None,
        typer.Option(
            "--repeat",
            metavar="N",
            min=0,
            max=1000,
            help="SunSpec: how often a group is there if the device tells it. [default: 1]",
        ),
    ] = None,
    unit: Annotated[
        int | None,
        typer.Option(
            "--unit", metavar="UNIT", min=0, max=255, help="Home Assistant: which unit's values."
        ),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            "--column",
            metavar="MEANING=HEADING",
            help="Which column holds what, as in address=Modbus-Adresse; may be repeated. "
            "[default: guessed by the headings]",
        ),
    ] = None,
    table: Annotated[
        TableChoice | None,
        typer.Option(help="The table of rows that name none. [default: holding]"),
    ] = None,
    addresses: Annotated[
        AddressesChoice | None,
        typer.Option(help="What the numbers of its addresses are. [default: guessed]"),
    ] = None,
    word_order: Annotated[
        WordOrderChoice | None,
        typer.Option(
            help="Which register comes first in values that name no order. [default: high-first]"
        ),
    ] = None,
    scaling: Annotated[
        ScalingChoice | None,
        typer.Option(help="What its factors are for. [default: guessed]"),
    ] = None,
    skip_bad: Annotated[
        bool,
        typer.Option("--skip-bad", help="Leave out rows that cannot be read, and tell them."),
    ] = False,
) -> None:
    """Make a profile of a register list or another register map.

    What you name is not guessed; each guess is told in a line. If rows of a list cannot be read,
    each is told and no profile is made, unless you say --skip-bad.
    """
    from mbtool.devices.importing.options import (
        AddressStyle,
        ImportOptions,
        Scaling,
        parse_columns,
    )
    from mbtool.devices.point_types import WordOrder
    from mbtool.modbus.tables import Table

    demand_new(output, overwrite=overwrite)
    if sunspec and home_assistant:
        raise UsageError("--sunspec and --home-assistant exclude each other")
    for option, value, is_for in (
        ("--base", base, sunspec), ("--repeat", repeat, sunspec), ("--unit", unit, home_assistant)
    ):  # fmt: skip
        if value is not None and not is_for:
            form = "--home-assistant" if option == "--unit" else "--sunspec"
            raise UsageError(f"{option} goes with {form}")
    if len(files) > 1 and not sunspec:
        raise UsageError(f"{files[1]}: only --sunspec takes several files; import one at a time")
    if sunspec and len(files) == 1 and Path(files[0]).is_dir():
        _try_all(files[0], output)
        return
    if sunspec:
        made = _sunspec(files, output, 40000 if base is None else base, repeat)
        give_imported(made, output, overwrite=overwrite)
        return
    if home_assistant:
        made = _home_assistant(files[0], output, unit)
        give_imported(made, output, overwrite=overwrite)
        return
    options = ImportOptions(
        columns=parse_columns(column or ()),
        addresses=AddressStyle(addresses) if addresses is not None else None,
        table=next((one for one in Table if table and one.value.startswith(table)), None),
        scaling=Scaling(scaling) if scaling is not None else None,
        word_order=WordOrder(word_order) if word_order is not None else None,
        skip_bad=skip_bad,
    )
    give_imported(_import_list(files[0], output, options), output, overwrite=overwrite)


def _import_list(file: str, output: str | None, options: ImportOptions) -> ImportedList:
    from mbtool.devices.importing.register_list import BadRowsError, import_register_list

    try:
        return import_register_list(
            read_input(file), shown(file), options, profile_name(file, output)
        )
    except BadRowsError as wrong:
        for line in wrong.lines:
            say(line)
        raise


def _sunspec(
    files: Sequence[str], output: str | None, base: int, repeat: int | None
) -> ImportedList:
    from mbtool.devices.importing.sunspec import import_sunspec

    models = [(shown(file), read_input(file)) for file in files]
    name = profile_name(files[0], output) or "sunspec"
    count = 1 if repeat is None else repeat
    return import_sunspec(models, name, base=base, repeat=count)


def _try_all(folder: str, output: str | None) -> None:
    """Try to import each SunSpec model of a folder, and print which ones cannot be imported.

    No profile is written. Raises UsageError if --output is given (`output` not None), and if a
    model cannot be imported.
    """
    from mbtool.workflows.shared.sunspec_devices import SunSpecFolder

    if output is not None:
        raise UsageError(
            f"{folder}: all of its models are tried, and no profile is written; a device has only "
            "some of them: name their files"
        )
    count, wrong = SunSpecFolder(folder).try_all()
    for line in wrong:
        say(line)
    say(f"{folder}: {count} of {count + len(wrong)} models can be imported")
    if wrong:
        raise UsageError(f"{folder}: {len(wrong)} models cannot be imported")


def _home_assistant(file: str, output: str | None, unit: int | None) -> ImportedList:
    from mbtool.devices.importing.home_assistant import import_home_assistant

    name = profile_name(file, output) or "home-assistant"
    return import_home_assistant(read_input(file), shown(file), name, unit=unit)


_SHOW = "show"


class _ShowsByDefault(TyperGroup):
    """A group in which a word that is not the name of a subcommand is the name of a profile."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        # A subcommand has a --json of its own, so only the options before its name are replaced.
        end = next((at for at, one in enumerate(args) if one in self.commands), len(args))
        plain = with_plain_json(self.params, args[:end])
        return super().parse_args(ctx, [*plain, *args[end:]])

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        if args[0] not in self.commands or args[0] == _SHOW:
            args = [_SHOW, *args]
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        return [*super().shell_complete(ctx, incomplete), *items(profile_names(), incomplete)]

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        formatter.write_usage(ctx.command_path, "[NAME]")
        formatter.write_usage(ctx.command_path, "--match FILE [NAME]...")
        formatter.write_usage(ctx.command_path, "COMMAND [ARGS]...")

    def format_options(self, ctx: Any, formatter: Any) -> None:
        super().format_options(ctx, formatter)
        write_examples(ctx, formatter)


devices = typer.Typer(
    cls=_ShowsByDefault,
    help="List device profiles, show one in full, or make your own.\n\n"
    "NAME is a profile's name, or the path of a TOML file.",
)
devices.command("new", cls=Command)(new)
devices.command("import", cls=Command)(import_)
devices.command("draft", cls=Command)(draft)
devices.command("export", cls=Command)(export)
devices.command("schema", cls=Command)(schema)


@devices.callback(invoke_without_command=True)
@with_option_groups
def _devices(
    context: typer.Context,
    *,
    matched: Annotated[
        str | None,
        typer.Option(
            "--match",
            metavar="FILE",
            help="Say which profiles explain the traffic of each slave in a capture or log best, "
            "and why. A NAME behind it adds a profile of your own to the built-in ones.",
        ),
    ] = None,
    format_: Annotated[
        ListFormat, typer.Option("--format", help="How to print; --json is short for jsonl.")
    ] = "table",
    source: SourceOptions,
) -> None:
    if matched is None:
        if source != SourceOptions():
            raise UsageError("--port, --rtu-port and --link go with --match FILE")
        if context.invoked_subcommand is None:
            _print_list(format_)
        elif format_ != "table" and context.invoked_subcommand != _SHOW:
            raise UsageError("--format goes with the list of profiles, a NAME and --match FILE")
        else:
            context.obj = lambda names, shown: _show_one(names, shown or format_)
        return
    if context.invoked_subcommand not in (None, _SHOW):
        raise UsageError(f"--match does not go with {context.invoked_subcommand}")
    options = source.read()
    if context.invoked_subcommand is None:
        _match(matched, (), options, format_)
    else:
        context.obj = lambda names, shown: _match(matched, names, options, shown or format_)


@devices.command(_SHOW, cls=Command, hidden=True)
def _show(
    context: typer.Context,
    names: Annotated[list[str], typer.Argument(metavar="NAME")],
    *,
    format_: Annotated[ListFormat | None, typer.Option("--format")] = None,
) -> None:
    """Show a profile in full."""
    context.obj(names, format_)


def _show_one(names: Sequence[str], format_: ListFormat) -> None:
    from mbtool.cli.console import PipeConsole
    from mbtool.devices import load_profile, profile_to_json
    from mbtool.views.profile import profile_page

    if len(names) > 1:
        raise UsageError(f"one profile is shown at a time, not {len(names)}: {', '.join(names)}")
    profile = load_profile(names[0])
    if format_ == "table":
        PipeConsole().print(profile_page(profile))
    else:
        typer.echo(profile_to_json(profile))


def _print_list(format_: ListFormat) -> None:
    import json

    from mbtool.cli.console import PipeConsole
    from mbtool.devices import builtin_profiles, load_profile
    from mbtool.views.profile import profile_list, profile_record

    profiles = [load_profile(one) for one in builtin_profiles()]
    if format_ == "table":
        PipeConsole().print(profile_list(profiles))
        return
    for one in profiles:
        typer.echo(json.dumps(profile_record(one), ensure_ascii=False))


def _match(file: str, names: Sequence[str], options: ReadingOptions, format_: ListFormat) -> None:
    import json

    from mbtool.cli.console import PipeConsole
    from mbtool.devices import builtin_profiles, load_profile
    from mbtool.devices.profile_match import match_profiles
    from mbtool.views.matches import match_record, print_match_results

    profiles = [load_profile(one) for one in dict.fromkeys((*builtin_profiles(), *names))]
    found, broken = survey(file, options)
    results = [match_profiles(slave, profiles) for slave in found.slaves]
    if format_ == "jsonl":
        for result in results:
            typer.echo(json.dumps(match_record(result), separators=(",", ":")))
    else:
        print_match_results(PipeConsole(), results)
    if not results:
        say(f"{file}: no transaction in it, so nothing to match")
    if found.forgotten:
        say(f"{found.forgotten:,} transactions of further slaves were not looked at")
    if broken is not None:
        raise broken
