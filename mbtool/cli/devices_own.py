"""mbtool devices new, draft, export and schema: make profiles, and export them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from mbtool.cli.option_groups import with_option_groups
from mbtool.cli.options import OverwriteOption, SourceOptions
from mbtool.cli.profile_files import (
    OutputOption,
    demand_new,
    give,
    give_imported,
    is_file,
    profile_name,
    shown,
    write,
)
from mbtool.cli.progress import with_progress
from mbtool.cli.talk import interruptible, say, say_if_interrupted
from mbtool.core import CutError, DamageError, InputError, UsageError
from mbtool.core.moments import counted

if TYPE_CHECKING:
    from mbtool.decode.decoder import Record
    from mbtool.devices import Who
    from mbtool.workflows.shared.observed_slaves import ObservedSlaves
    from mbtool.workflows.shared.reading import ReadingOptions


def new(
    file: Annotated[str, typer.Argument(metavar="FILE.toml", help="The file to write.")],
    *,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the file if there is one.")
    ] = False,
) -> None:
    """Write a commented start of a profile, to be edited."""
    from mbtool.devices.profile_template import name_for, starting_profile

    if not is_file(file):
        raise UsageError(f"{file}: name the file to write, for example pump.toml")
    write(file, starting_profile(file, name_for(file)), overwrite=overwrite)
    say(f"{file}: written; edit it, and look at it with mbtool devices {_as_argument(file)}")


@with_option_groups
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
    overwrite: OverwriteOption = False,
    sunspec: Annotated[
        str | None,
        typer.Option(
            "--sunspec",
            metavar="FOLDER",
            help="Of a SunSpec device: take the models that it says it has from FOLDER, a copy of "
            "json of github.com/sunspec/models.",
        ),
    ] = None,
    source: SourceOptions,
) -> None:
    """Draft a profile from what a slave was asked and answered.

    Areas, functions and exceptions are those seen. Types of registers are guessed from their
    values; each guess has its reason above it.
    """
    from mbtool.devices import parse_who
    from mbtool.devices.profile_template import name_for
    from mbtool.values.draft import draft_profile

    demand_new(output, overwrite=overwrite)
    who = parse_who(unit) if unit is not None else None
    if sunspec is not None:
        _draft_sunspec(file, source.read(), who, sunspec, output, overwrite=overwrite)
        return
    found, broken = survey(file, source.read(), who, with_values=True)
    seen = found.only("--unit")
    name = name_for(output) if output is not None and is_file(output) else f"unit-{seen.unit}"
    drafted = draft_profile(seen, name, shown(file))
    give(drafted.text, output, overwrite=overwrite)
    if is_file(output):
        areas = counted(len(drafted.profile.areas), "area")
        points = counted(len(drafted.profile.points), "point")
        say(f"unit {seen.unit}: {areas}, {points} -> {output}")
    if broken is not None:
        raise broken


def _draft_sunspec(
    file: str,
    options: ReadingOptions,
    who: Who | None,
    folder: str,
    output: str | None,
    *,
    overwrite: bool,
) -> None:
    """Write the profile of a SunSpec device, made of the models that masters read in the capture.

    `folder` has the definitions of the models, in JSON. `who` chooses the device; with None the
    capture must show only one. `output` is the file to write, None for standard output.
    """
    from mbtool.workflows.shared.sunspec_devices import SunSpecDevices, SunSpecFolder, only_map

    models, devices = SunSpecFolder(folder), SunSpecDevices()
    broken = _survey(file, options, devices.note_all)
    if broken is not None and not devices.maps:
        raise broken
    found = only_map(devices, who, "--unit")
    made = models.profile(found, profile_name(file, output) or "sunspec")
    give_imported(made, output, overwrite=overwrite)
    if broken is not None:
        raise broken


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
    *,
    overwrite: OverwriteOption = False,
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
            "--unit",
            metavar="UNIT",
            min=0,
            max=255,
            help="The unit that Telegraf or Home Assistant will ask.",
        ),
    ] = 1,
) -> None:
    """Print a profile as TOML, or in a form for other programs.

    As TOML it has all that it extends. What another form cannot say is told, a line for each kind.
    """
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
    demand_new(output, form.suffixes, overwrite=overwrite)
    made = exported(load_profile(name), form, unit)
    for line in made.lacking:
        say(f"mbtool: {line}")
    give(made.text, output, form.suffixes, overwrite=overwrite)


def schema() -> None:
    """Print the JSON Schema of profiles, for editors."""
    import json

    from mbtool.devices import profile_schema

    typer.echo(json.dumps(profile_schema(), indent=2))


def survey(
    file: str, options: ReadingOptions, who: Who | None = None, *, with_values: bool = False
) -> tuple[ObservedSlaves, InputError | None]:
    """Read a capture or log to its end, print remarks about it, and return its slaves.

    `who` limits the slaves; None takes all. The second returned value is None if the whole file
    was read. If the file is cut or damaged, it is the error, to be raised by the caller after
    printing the slaves before the damage; without such slaves the error is raised here.
    """
    from mbtool.workflows.shared.observed_slaves import ObservedSlaves

    found = ObservedSlaves(who, with_values=with_values)
    broken = _survey(file, options, found.add)
    if broken is not None and not found.slaves:
        raise broken
    return found, broken


def _survey(
    file: str, options: ReadingOptions, take: Callable[[Iterator[Record]], None]
) -> InputError | None:
    """Call `take` once with all records of a capture or log, and print remarks about the file.

    Returns the error if the file is cut or damaged, else None. Raises InputError if nothing in the
    file could be decoded.
    """
    from mbtool.workflows.shared.reading import Reading

    reading = Reading([file], options)
    broken: InputError | None = None
    try:
        with say_if_interrupted(), interruptible() as interrupt:
            take(with_progress(reading, interrupt.breakable(reading.records())))
    except (CutError, DamageError) as error:
        broken = error
    finally:
        for remark in reading.remarks:
            say(remark)
    if broken is None:
        reading.demand_readable()
    return broken


def _as_argument(file: str) -> str:
    import shlex

    return shlex.quote(file)
