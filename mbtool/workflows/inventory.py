"""Reads captures and logs into an inventory, and compares it with an older one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import InputError, WireEvent
from mbtool.devices import NamedTransaction, builtin_profiles, load_profile
from mbtool.overview.baseline import changes
from mbtool.overview.identification import identify
from mbtool.overview.inventory import Inventory
from mbtool.overview.inventory_rows import INVENTORY_FORMAT, InventoryDocument
from mbtool.sources.makers import maker
from mbtool.workflows.shared.read_all import read_all, unwatched
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from mbtool.overview.baseline import InventoryChange
    from mbtool.workflows.shared.read_all import Watch

_DOCUMENT_BEGINS = b"{"


@dataclass(frozen=True, slots=True, kw_only=True)
class InventoryOptions:
    """What an inventory is taken of."""

    reading: ReadingOptions
    wanted: Callable[[NamedTransaction], bool] = lambda _: True


class InventoryRun:
    """One pass over some files for their inventory."""

    def __init__(self, files: Sequence[str], options: InventoryOptions) -> None:
        self._files = files
        self._options = options
        self.reading = Reading(files, options.reading)

    def take(
        self, on_remark: Callable[[str], None] = lambda _: None, watch: Watch = unwatched
    ) -> InventoryDocument:
        """Read the files to their end.

        `on_remark` gets a line for each thing a user should know of the files. Raises InputError
        for a file that cannot be read.
        """
        inventory = Inventory()
        wanted = self._options.wanted
        for record in read_all(self.reading, on_remark, "{error}; what is there was read", watch):
            if not isinstance(record, WireEvent) and wanted(record):
                inventory.add(record)
        profiles = {one.name: one for one in map(load_profile, builtin_profiles())}
        profiles |= {one.name: one for one in self.reading.assignments.profiles}
        return inventory.document(
            self._files, partial(identify, profiles=list(profiles.values())), maker
        )


def changes_since(
    baseline: Sequence[str],
    document: InventoryDocument,
    options: InventoryOptions,
    on_remark: Callable[[str], None] = lambda _: None,
) -> list[InventoryChange]:
    """What is new in an inventory since a baseline: an older inventory in JSON, or captures.

    Raises InputError if the baseline cannot be read or has no transaction.
    """
    first = baseline[0]
    old = _stored(first) if len(baseline) == 1 and _is_stored(first) else None
    if old is None:
        old = InventoryRun(baseline, options).take(on_remark)
    if not old.transactions:
        raise InputError(f"{', '.join(baseline)}: no transaction in it to compare with")
    return changes(old, document)


def _is_stored(path: str) -> bool:
    """True if a file looks like an inventory in JSON; captures never begin so."""
    try:
        with Path(path).open("rb") as file:
            return file.read(64).lstrip().startswith(_DOCUMENT_BEGINS)
    except OSError:
        return False  # Reading it as a capture tells why.


def _stored(path: str) -> InventoryDocument:
    try:
        document = msgspec.json.decode(Path(path).read_bytes(), type=InventoryDocument)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no inventory as --format json writes it: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if document.format != INVENTORY_FORMAT:
        raise InputError(
            f"{path}: is an inventory of format {document.format!r}; this program reads "
            f"{INVENTORY_FORMAT}"
        )
    return document
