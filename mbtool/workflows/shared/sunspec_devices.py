"""Makes profiles for SunSpec devices from the model lists that their master reads in a capture."""

# A master reads the map of a SunSpec device, usually once: the mark "SunS", then the number and the
# length of each model (devices/sunspec_map.py). The user provides the definitions of the models: a
# copy of the folder `json` of github.com/sunspec/models, where model 103 is model_103.json.
#
# Files are read twice, the first time only for the maps. So all transactions get names, even those
# before the map was read.
#
# Memory: the maps of at most MAX_DEVICES slaves.

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.core import InputError, UsageError, WireEvent
from mbtool.core.limits import MODBUS_PORT
from mbtool.devices import Assignment, Assignments, Who
from mbtool.devices.sunspec_map import READ_HOLDING, SunSpecMap, mark_in
from mbtool.sources.files import place_of
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from os import PathLike

    from mbtool.decode.decoder import Record
    from mbtool.devices.importing.register_list import ImportedList

MAX_DEVICES = 1024
STANDARD_INPUT = "-"
_SHOWN = 12

Slave = tuple[str, str | None, int]
"""Identifies a slave: its link, its address and port (None on a serial line), and its unit."""


class SunSpecDevices:
    """Collects the maps (the lists of models) of the SunSpec devices in a capture."""

    def __init__(self) -> None:
        self.maps: dict[Slave, SunSpecMap] = {}

    def note_all(self, records: Iterable[Record]) -> None:
        for record in records:
            self.note(record)

    def note(self, record: Record) -> Slave | None:
        """Look at the next transaction or event. If it completes the map of a slave, return the
        slave, else None.
        """
        if isinstance(record, WireEvent) or record.function != READ_HOLDING:
            return None
        values, address = record.response_values, record.address
        if not values or address is None:
            return None
        key = (record.link, record.destination, record.unit)
        found = self.maps.get(key)
        if found is None:
            base = mark_in(address, values)
            if base is None or len(self.maps) >= MAX_DEVICES:
                return None
            found = self.maps[key] = SunSpecMap(base)
        had_end = found.is_complete
        found.note(address, values)
        return key if found.is_complete and not had_end else None


class SunSpecFolder:
    """The user's folder with the definitions of SunSpec models: files such as model_103.json."""

    def __init__(self, path: str | PathLike[str]) -> None:
        """Open the folder `path`, or its folder `json` if it has one. Raises InputError if there is
        no model in it.
        """
        self._path = path
        folder = Path(path)
        inner = folder / "json"
        self._folder = inner if inner.is_dir() else folder
        if not any(self._paths()):
            raise InputError(
                f"{path}: no folder with SunSpec models, such as model_1.json; they are the folder "
                "json of github.com/sunspec/models"
            )

    def file(self, number: int) -> tuple[str, bytes] | None:
        """Return the path and the content of the file of model `number`; None if the folder lacks
        it.
        """
        path = self._folder / f"model_{number}.json"
        try:
            return str(path), path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error

    def try_all(self) -> tuple[int, list[str]]:
        """Import each model by itself, to check the folder.

        Returns the number of models that can be imported, and an error message for each that
        cannot.
        """
        from mbtool.devices.importing.sunspec import import_sunspec

        wrong = []
        count = 0
        for path in sorted(self._paths()):
            try:
                import_sunspec([(path.name, path.read_bytes())], path.stem)
                count += 1
            except (UsageError, OSError) as error:
                wrong.append(str(error))
        return count, wrong

    def profile(self, found: SunSpecMap, name: str) -> ImportedList:
        """Make a profile, called `name`, for a device with the map `found`. Raises UsageError if
        none of its models can be used.
        """
        from mbtool.devices.importing.sunspec import import_sunspec_map

        return import_sunspec_map(found, [self.file(one.id) for one in found.models], name)

    def _paths(self) -> Iterator[Path]:
        return self._folder.glob("model_*.json")


def with_sunspec(
    paths: Sequence[str], options: ReadingOptions, folder: SunSpecFolder, say: Callable[[str], None]
) -> ReadingOptions:
    """Return the options with a new profile for each SunSpec device in the files that has none.

    Reads the files to their ends, to find the devices. `say` gets a line for the user about each
    device.
    """
    for path in paths:
        if path == STANDARD_INPUT or place_of(path)[1]:
            raise UsageError(f"{path}: --sunspec reads a file twice; save the pipe to a file first")
    devices = SunSpecDevices()
    reading = Reading(paths, options)
    reading.demand_files()
    devices.note_all(_unbroken(reading))
    more: list[Assignment] = []
    for (link, destination, unit), found in devices.maps.items():
        who = Who.of_slave(destination, unit)
        known = [*options.assignments, *more]
        if not found.models or any(one.who.fits_slave(destination, unit) for one in known):
            continue
        where = destination or link
        try:
            made = folder.profile(found, _profile_name(destination, unit))
        except UsageError as error:
            say(f"unit {unit} at {where}: {error}")
            continue
        say(f"unit {unit} at {where}: {described(found)}")
        more.append(Assignment(who, made.profile))
    if not more:
        say("--sunspec: no slave was asked for its SunSpec models here")
    return replace(options, assignments=Assignments([*options.assignments, *more]))


def only_map(devices: SunSpecDevices, who: Who | None, option: str) -> SunSpecMap:
    """Return the map of the only SunSpec device; with `who`, of the only one that has this address
    and unit.

    Raises UsageError if there is none, or if there are several. Then the message names `option`,
    the command's option that chooses one.
    """
    maps = {
        Who.of_slave(destination, unit): found
        for (_, destination, unit), found in devices.maps.items()
        if found.models and (who is None or who.fits_slave(destination, unit))
    }
    if not maps:
        raise UsageError("no such slave was asked for its SunSpec models there")
    if len(maps) > 1:
        names = ", ".join(str(one.at_any_port) for one in [*maps][:_SHOWN])
        raise UsageError(f"{len(maps)} SunSpec devices are there: {names}; name one with {option}")
    return next(iter(maps.values()))


def described(found: SunSpecMap) -> str:
    """Describe a SunSpec device in a text: maker, device, the numbers of its models, and the
    address where its map begins.
    """
    numbers = ", ".join(str(one.id) for one in found.models)
    name = f"{found.device}, " if found.device else ""
    return f"{name}SunSpec models {numbers} from {found.base} on"


def _unbroken(reading: Reading) -> Iterator[Record]:
    """Yield the records up to the first error. The files are read a second time later, which raises
    the error.
    """
    try:
        yield from reading.records()
    except InputError:
        return


def _profile_name(destination: str | None, unit: int) -> str:
    who = Who.of_slave(destination, unit)
    place = "" if who.host is None else f"{who.host.replace(':', '-').strip('-')}-"
    port = "" if who.port in (None, MODBUS_PORT) else f"{who.port}-"
    return f"sunspec-{place}{port}{unit}"
