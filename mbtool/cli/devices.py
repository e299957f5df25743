"""mbtool devices: list, show and match device profiles, built-in or the user's own."""

# `mbtool devices` lists the profiles, `mbtool devices NAME` shows one. A word that is not a
# subcommand is the name or path of a profile, and goes to the hidden subcommand "show". A file with
# the name of a subcommand can be shown by its path: ./new. The subcommands are in devices_import.py
# and devices_own.py.

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from mbtool.cli.command import Command, with_plain_json, write_examples
from mbtool.cli.completion import items, profile_names
from mbtool.cli.devices_import import import_
from mbtool.cli.devices_own import draft, export, new, schema
from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import ListFormat, SourceOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.workflows.shared.reading import ReadingOptions

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
    from mbtool.core import UsageError

    if matched is None:
        if source != SourceOptions():
            raise UsageError("--port, --rtu-port and --link go with --match FILE")
        if context.invoked_subcommand is None:
            _list(format_)
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
    from mbtool.core import UsageError
    from mbtool.devices import load_profile, profile_to_json
    from mbtool.views.profile import profile_page

    if len(names) > 1:
        raise UsageError(f"one profile is shown at a time, not {len(names)}: {', '.join(names)}")
    profile = load_profile(names[0])
    if format_ == "table":
        PipeConsole().print(profile_page(profile))
    else:
        typer.echo(profile_to_json(profile))


def _list(format_: ListFormat) -> None:
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
    from mbtool.cli.devices_own import survey
    from mbtool.cli.talk import say
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
