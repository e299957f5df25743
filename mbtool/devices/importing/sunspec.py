"""Makes a profile of SunSpec models in JSON, as github.com/sunspec/models has them."""

# The register map of a device begins with the two registers of the text "SunS", at 40000, 0 or
# 50000; the models follow one another. Where each begins and how long it is, a device says itself
# (devices/sunspec_map.py); without that, each is as long as its file says.

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import msgspec

from mbtool.core.errors import UsageError
from mbtool.devices.importing.assembling import ImportedDevice, assemble
from mbtool.devices.importing.sunspec_layout import ModelLayout, SunModel, words_of
from mbtool.modbus.tables import ADDRESSES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.devices.importing.register_list import ImportedList
    from mbtool.devices.sunspec_map import FoundModel, SunSpecMap

BASE = 40000
_END_WORDS = 2
"""The registers FFFFH and 0 that end the map."""
MAX_REPEAT = 1000


def import_sunspec(
    files: Sequence[tuple[str, bytes]], name: str, *, base: int = BASE, repeat: int = 1
) -> ImportedList:
    """Make the profile of a device with these models, one behind the other from `base` on.

    `files` are names and contents. `repeat` is how often groups are there whose number the device
    tells. Raises UsageError if a file is no model, or if the models need too many addresses.
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
    """Make the profile of a device that was asked for its models.

    `files` are the name and content for each model of the device; None for a model that is not
    known. Raises UsageError as `import_sunspec` does, and if no model is known.
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
    """Read a model. Raises UsageError if it is none."""
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
    """What the names of each model's points begin with; of equal models the later have a number."""
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
    """How often the groups are there whose number the device tells, by the model's length."""
    once, none = words_of(file, model, 1), words_of(file, model, 0)
    if once <= none:
        return 1
    return min(max((place.words - none) // (once - none), 0), MAX_REPEAT)
