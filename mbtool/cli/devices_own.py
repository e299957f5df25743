"""mbtool devices new, import, draft, export and schema: profiles of the user's own."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import takes_groups
from mbtool.cli.options import SourceOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices import Who
    from mbtool.devices.importing.options import ImportOptions
    from mbtool.devices.importing.register_list import ImportedList
    from mbtool.workflows.shared.observed_slaves import ObservedSlaves
    from mbtool.workflows.shared.reading import ReadingOptions


class AddressesChoice(StrEnum):
    """How a register list writes addresses: from 0, from 1, as references or hexadecimal."""

    ZERO_BASED = "zero-based"
    ONE_BASED = "one-based"
    REFERENCES = "references"
    HEXADECIMAL = "hexadecimal"


class ScalingChoice(StrEnum):
    """The use of the factors in a register list: to multiply or to divide values of registers."""

    MULTIPLY = "multiply"
    DIVIDE = "divide"


class WordOrderChoice(StrEnum):
    """The register that comes first if a value takes several: the high or the low word."""

    HIGH_FIRST = "high-first"
    LOW_FIRST = "low-first"


class TableChoice(StrEnum):
    """The tables of Modbus, each by the first word of its name."""

    COILS = "coils"
    DISCRETE = "discrete"
    HOLDING = "holding"
    INPUT = "input"


_SUFFIX = ".toml"
_STANDARD = "-"

OutputOption = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE.toml",
        help="Write to a new file. [default: standard output]",
    ),
]


def new(
    file: Annotated[str, typer.Argument(metavar="FILE.toml", help="The file to write.")],
) -> None:
    """Write a commented start of a profile, to be edited."""
    from mbtool.cli.talk import say
    from mbtool.devices.profile_template import name_for, starting_profile

    _write(file, starting_profile(file, name_for(file)))
    say(f"{file}: written; edit it, and look at it with mbtool devices {_as_argument(file)}")


def import_(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE",
            help="A register list: CSV with a row of headings; - is standard input. With --sunspec "
            "one model or several, in their order in the device.",
        ),
    ],
    output: OutputOption = None,
    sunspec: Annotated[
        bool, typer.Option("--sunspec", help="FILE is a SunSpec model in JSON.")
    ] = False,
    home_assistant: Annotated[
        bool, typer.Option("--home-assistant", help="FILE is a configuration of Home Assistant.")
    ] = False,
    base: Annotated[
        int | None,
        typer.Option(
            "--base", min=0, max=65000, help="SunSpec: where the map begins. [default: 40000]"
        ),
    ] = None,
    repeat: Annotated[
        int | None,
        typer.Option(
            "--repeat",
            min=0,
            max=1000,
            help="SunSpec: how often a group is there if the device tells it. [default: 1]",
        ),
    ] = None,
    unit: Annotated[
        int | None,
        typer.Option("--unit", min=0, max=255, help="Home Assistant: which unit's values."),
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
    from mbtool.core import UsageError
    from mbtool.devices.importing.options import (
        AddressStyle,
        ImportOptions,
        Scaling,
        parse_columns,
    )
    from mbtool.devices.point_types import WordOrder
    from mbtool.modbus.tables import Table

    _demand_new(output)
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
    if sunspec:
        _import_sunspec(files, output, 40000 if base is None else base, repeat)
        return
    if home_assistant:
        _import_home_assistant(files[0], output, unit)
        return
    options = ImportOptions(
        columns=parse_columns(column or ()),
        addresses=AddressStyle(addresses) if addresses is not None else None,
        table=next((one for one in Table if table and one.value.startswith(table)), None),
        scaling=Scaling(scaling) if scaling is not None else None,
        word_order=WordOrder(word_order) if word_order is not None else None,
        skip_bad=skip_bad,
    )
    _import_list(files[0], output, options)


def _import_list(file: str, output: str | None, options: ImportOptions) -> None:
    from mbtool.cli.talk import say
    from mbtool.devices.importing.register_list import BadRowsError, import_register_list

    try:
        imported = import_register_list(_read(file), _shown(file), options, _name(file, output))
    except BadRowsError as wrong:
        for line in wrong.lines:
            say(line)
        raise
    _give_imported(imported, output)


def _import_sunspec(
    files: Sequence[str], output: str | None, base: int, repeat: int | None
) -> None:
    from mbtool.devices.importing.sunspec import import_sunspec

    models = [(_shown(file), _read(file)) for file in files]
    name = _name(files[0], output) or "sunspec"
    count = 1 if repeat is None else repeat
    _give_imported(import_sunspec(models, name, base=base, repeat=count), output)


def _import_home_assistant(file: str, output: str | None, unit: int | None) -> None:
    from mbtool.devices.importing.home_assistant import import_home_assistant

    name = _name(file, output) or "home-assistant"
    _give_imported(import_home_assistant(_read(file), _shown(file), name, unit=unit), output)


def _name(file: str, output: str | None) -> str | None:
    """The profile's name after the file's; None if both are standard streams."""
    from mbtool.devices.profile_template import name_for

    return name_for(output or file) if _STANDARD not in (output or file,) else None


def _give_imported(imported: ImportedList, output: str | None) -> None:
    from mbtool.cli.talk import say

    for remark in imported.remarks:
        say(remark)
    _give(imported.text, output)
    if _is_file(output):
        say(f"{len(imported.profile.points)} points -> {output}")


@takes_groups
def draft(
    file: Annotated[
        str, typer.Argument(metavar="CAPTURE", help="A capture or log, as for decode.")
    ],
    *,
    unit: Annotated[
        str | None,
        typer.Option(
            "--unit",
            metavar="WHO",
            help="The slave: a unit (5), an address (192.168.3.250) or both (192.168.3.250/5). "
            "[default: the only one that answers]",
        ),
    ] = None,
    output: OutputOption = None,
    source: SourceOptions,
) -> None:
    """Draft a profile from what a slave was asked and answered.

    Areas, functions and exceptions are those seen. Types of registers are guessed from their
    values; each guess has its reason above it.
    """
    from mbtool.cli.talk import say
    from mbtool.devices import parse_who
    from mbtool.devices.drafting.draft import draft_profile
    from mbtool.devices.profile_template import name_for

    _demand_new(output)
    who = parse_who(unit) if unit is not None else None
    seen = survey(file, source.read(), who, with_values=True).only("--unit")
    name = name_for(output) if output is not None and _is_file(output) else f"unit-{seen.unit}"
    drafted = draft_profile(seen, name, _shown(file))
    _give(drafted.text, output)
    if _is_file(output):
        areas, points = len(drafted.profile.areas), len(drafted.profile.points)
        say(f"unit {seen.unit}: {areas} areas, {points} points -> {output}")


def export(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="A profile's name, or the path of a TOML file.")
    ],
    output: Annotated[
        str | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Write to a new file. [default: standard output]"
        ),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="A register list.")] = False,
    json_: Annotated[bool, typer.Option("--json", help="The profile as JSON.")] = False,
    telegraf: Annotated[
        bool, typer.Option("--telegraf", help="A configuration of Telegraf's Modbus input.")
    ] = False,
    home_assistant: Annotated[
        bool, typer.Option("--home-assistant", help="A configuration of Home Assistant.")
    ] = False,
    sunspec: Annotated[
        bool, typer.Option("--sunspec", help="A SunSpec model in JSON, of a profile that is one.")
    ] = False,
    unit: Annotated[
        int,
        typer.Option(
            "--unit", min=0, max=255, help="The unit that Telegraf or Home Assistant will ask."
        ),
    ] = 1,
) -> None:
    """Print a profile as TOML, or in a form for other programs.

    As TOML it has all that it extends. What another form cannot say is told, a line for each kind.
    """
    from mbtool.cli.talk import say
    from mbtool.core import UsageError
    from mbtool.devices import load_profile
    from mbtool.workflows.export_profile import ExportForm, exported

    chosen = {
        ExportForm.CSV: csv,
        ExportForm.JSON: json_,
        ExportForm.TELEGRAF: telegraf,
        ExportForm.HOME_ASSISTANT: home_assistant,
        ExportForm.SUNSPEC: sunspec,
    }
    forms = [form for form, is_chosen in chosen.items() if is_chosen]
    if len(forms) > 1:
        raise UsageError(f"--{forms[0]} and --{forms[1]}: choose one form")
    form = forms[0] if forms else ExportForm.TOML
    _demand_new(output, form.suffixes)
    made = exported(load_profile(name), form, unit)
    for line in made.lacking:
        say(f"mbtool: {line}")
    _give(made.text, output, form.suffixes)


def schema() -> None:
    """Print the JSON Schema of profiles, for editors."""
    import json

    from mbtool.devices import profile_schema

    typer.echo(json.dumps(profile_schema(), indent=2))


def survey(
    file: str, options: ReadingOptions, who: Who | None = None, *, with_values: bool = False
) -> ObservedSlaves:
    """Read a capture or log to its end, print remarks about it, and return its slaves."""
    from mbtool.cli.talk import interruptible, say
    from mbtool.workflows.shared.observed_slaves import ObservedSlaves
    from mbtool.workflows.shared.reading import Reading

    found = ObservedSlaves(who, with_values=with_values)
    reading = Reading([file], options)
    try:
        with interruptible() as interrupt:
            found.add(interrupt.breakable(reading.records()))
    finally:
        for remark in reading.remarks:
            say(remark)
    reading.demand_readable()
    return found


def _read(file: str) -> bytes:
    from mbtool.core import InputError
    from mbtool.devices.importing.register_list import MAX_BYTES

    try:
        if file == _STANDARD:
            if sys.stdin is None:
                raise InputError("standard input: closed; name a file")
            return sys.stdin.buffer.read(MAX_BYTES + 1)
        with Path(file).open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from error


def _shown(file: str) -> str:
    return "standard input" if file == _STANDARD else file


def _is_file(output: str | None) -> bool:
    return output is not None and output != _STANDARD


def _demand_new(output: str | None, suffixes: Sequence[str] = (_SUFFIX,)) -> None:
    """Raise UsageError if a profile cannot be written to a new file of this name.

    The name must have one of the suffixes, and the file must not exist, as it may have been edited
    by hand.
    """
    from mbtool.core import UsageError

    if output is None or output == _STANDARD:
        return
    if not output.lower().endswith(tuple(suffixes)):
        what = (
            "a profile is a TOML file" if _SUFFIX in suffixes else "the suffix is of another form"
        )
        raise UsageError(f"{output}: {what}; let its name end in {' or '.join(suffixes)}")
    if Path(output).exists():
        raise UsageError(f"{output}: is there already; name another, or remove it first")


def _give(text: str, output: str | None, suffixes: Sequence[str] = (_SUFFIX,)) -> None:
    if output is None or output == _STANDARD:
        typer.echo(text, nl=False)
    else:
        _write(output, text, suffixes)


def _write(file: str, text: str, suffixes: Sequence[str] = (_SUFFIX,)) -> None:
    from mbtool.core import UsageError

    _demand_new(file, suffixes)
    try:
        # Mode "x" does not overwrite a file that was made after the check of _demand_new.
        with Path(file).open("x", encoding="utf-8") as stream:
            stream.write(text)
    except OSError as error:
        raise UsageError(f"{file}: cannot be written: {error.strerror or error}") from error


def _as_argument(file: str) -> str:
    import shlex

    return shlex.quote(file)
