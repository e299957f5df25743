"""Makes a profile from SunSpec models in JSON, as github.com/sunspec/models has them."""

# The register map of a SunSpec device begins with the text "SunS" in two registers, at 40000, 0 or
# 50000. The device's models (tables of registers) follow one another. The registers of the device
# tell the number and length of each model (devices/sunspec_map.py). If these registers were not
# read, each model is taken to be as long as its file says.

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.errors import UsageError
from mbtool.devices.importing.assembling import ImportedDevice, assemble
from mbtool.devices.importing.sunspec_layout import ModelLayout, SunModel, words_of
from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from mbtool.devices.importing.register_list import ImportedList
    from mbtool.devices.sunspec_map import FoundModel, SunSpecMap

BASE = 40000
_END_WORDS = 2
"""Number of registers that end the map of a device: one with FFFFH and one with 0."""
MAX_REPEAT = 1000


def import_sunspec(
    files: Sequence[tuple[str, bytes]], name: str, *, base: int = BASE, repeat: int = 1
) -> ImportedList:
    """Make the profile of a device with these SunSpec models, one after the other.

    `files` are the names and contents of the models' files. `base` is the address of the text
    "SunS". `repeat` is the number of copies of each group of points whose count only the device
    knows. Raises UsageError if a file is no model, or if the models need too many addresses.
    """
    models = [read_model(file, data) for file, data in files]
    layout = ModelLayout(base)
    prefixes = _prefixes(models)
    for (file, _), model, prefix in zip(files, models, prefixes, strict=True):
        layout.add_model(file, model, prefix, repeat)
    remarks = [f"the map begins at {base}; devices have it there, at 0 or at 50000 (--base)"]
    title = f"SunSpec models {_titles(models)}"
    return _assembled(name, title, "unknown", models, layout, layout.at, remarks, files[0][0])


def import_sunspec_map(
    found: SunSpecMap, files: Sequence[tuple[str, bytes] | None], name: str
) -> ImportedList:
    """Make the profile of a device whose SunSpec models were read from its registers.

    `files` has the name and content of the file of each model of the device, or None for a model
    without a file. Raises UsageError if a file is no model, if the models need too many addresses,
    or if no model has a file.
    """
    known = [(each, *file) for each, file in zip(found.models, files, strict=True) if file]
    if not known:
        raise UsageError(f"{name}: none of its models has a file")
    layout = ModelLayout(found.base)
    models = [read_model(file, data) for _, file, data in known]
    for (place, file, _), model, prefix in zip(known, models, _prefixes(models), strict=True):
        layout.begin(place.address)
        layout.add_model(file, model, prefix, _repeat(file, model, place), place.words)
    remarks = [f"the map begins at {found.base}, and was read from the device"]
    without = ", ".join(
        str(each.id) for each, file in zip(found.models, files, strict=True) if not file
    )
    if without:
        remarks.append(f"left out, as there is no file of the model: {without}")
    title = found.device or f"SunSpec models {_titles(models)}"
    vendor = found.maker or "unknown"
    return _assembled(name, title, vendor, models, layout, found.end, remarks, known[0][1])


def read_model(file: str, data: bytes) -> SunModel:
    """Read the JSON file of a SunSpec model. Raises UsageError if it is no such file."""
    try:
        return msgspec.json.decode(data, type=SunModel)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{file}: is no SunSpec model in JSON: {error}") from error


def _assembled(
    name: str,
    title: str,
    vendor: str,
    models: Sequence[SunModel],
    layout: ModelLayout,
    end: int,
    remarks: Sequence[str],
    file: str,
) -> ImportedList:
    numbers = ", ".join(str(one.id) for one in models)
    device = ImportedDevice(
        name=name,
        title=title[:200],
        vendor=vendor[:200],
        source=f"SunSpec model{'s' if len(models) > 1 else ''} {numbers}",
        points=layout.points,
        remarks=[*remarks, *layout.remarks()],
        span=range(layout.base, min(end + _END_WORDS, ADDRESSES)),
        finding_prefix="SUNSPEC",
    )
    return assemble(device, file)


def _titles(models: Sequence[SunModel]) -> str:
    return ", ".join(f"{one.id} {one.group.label or one.group.name}" for one in models)


def _prefixes(models: Sequence[SunModel]) -> list[str]:
    """Return for each model the prefix of the names of its points: `inverter.`, `inverter[2].`.

    If there is only one model, its prefix is empty.
    """
    if len(models) == 1:
        return [""]
    counts: Counter[str] = Counter()
    prefixes = []
    for model in models:
        name = model.group.name
        counts[name] += 1
        prefixes.append(f"{name}." if counts[name] == 1 else f"{name}[{counts[name]}].")
    return prefixes


def _repeat(file: str, model: SunModel, place: FoundModel) -> int:
    """Compute the number of times that the repeating groups of a model occur in a device.

    The number follows from the length of the model in the device, which `place` has. `file` is the
    name of the model's file, for messages.
    """
    once, none = words_of(file, model, 1), words_of(file, model, 0)
    if once <= none:
        return 1
    return min(max((place.words - none) // (once - none), 0), MAX_REPEAT)
