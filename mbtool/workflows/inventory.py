"""Makes the inventory (the slaves and masters) of captures, and compares it with an older one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from mbtool.core import InputError
from mbtool.devices import NamedTransaction, builtin_profiles, load_profile
from mbtool.ledger.baseline import InventoryChange, changes
from mbtool.ledger.identification import identify
from mbtool.ledger.inventory import inventory
from mbtool.ledger.inventory_rows import INVENTORY_FORMAT, InventoryDocument
from mbtool.sources.files import shown_name
from mbtool.sources.makers import maker
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.read_all import Watch, unwatched
from mbtool.workflows.shared.reading import ReadingOptions

if TYPE_CHECKING:
    from mbtool.troubles.judge import Judgement

_DOCUMENT_BEGINS = b"{"
MAX_DOCUMENT_BYTES = 256 << 20
"""The largest size (bytes) of a stored inventory that is read. An inventory of 65,536 units, the
most possible, has some tens of megabytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InventoryOptions:
    """Options of an inventory: how its files are read, and which of their transactions are used."""

    reading: ReadingOptions
    wanted: Callable[[NamedTransaction], bool] | None = None
    """Returns True for a transaction to use; None to use all transactions."""


class InventoryRun:
    """Reads files once, and makes the inventory of the slaves and masters in them."""

    def __init__(self, files: Sequence[str], options: InventoryOptions) -> None:
        self._files = files
        self._options = options
        self._check = CheckRun(files, options.reading, wanted=options.wanted, observes=True)
        self.reading = self._check.reading
        self.error: InputError | None = None
        """The error of a file that could be read only in part; None if all files were read to their
        ends."""

    def judgement(self) -> Judgement:
        """Judge what was read."""
        return self._check.judgement()

    def take(
        self, on_remark: Callable[[str], None] = lambda _: None, watch: Watch = unwatched
    ) -> InventoryDocument:
        """Read the files as far as they can be read, and return their inventory.

        `on_remark` gets lines for the user about the files. `watch` passes on the items as they are
        read, and may show the progress. Raises InputError if an error comes before the first
        transaction.
        """
        try:
            for _ in watch(self.reading, self._check.checked()):
                pass
        except InputError as error:
            if not self._check.ledger.transactions:
                raise
            self.error = error
        for remark in self.reading.remarks:
            on_remark(remark)
        profiles = {one.name: one for one in map(load_profile, builtin_profiles())}
        profiles |= {one.name: one for one in self.reading.assignments.profiles}
        return inventory(
            self._check.ledger,
            [*map(shown_name, self._files)],
            partial(identify, profiles=list(profiles.values())),
            maker,
            profiles,
        )


def changes_since(
    baseline: Sequence[str],
    document: InventoryDocument,
    options: InventoryOptions,
    on_remark: Callable[[str], None] = lambda _: None,
) -> list[InventoryChange]:
    """Return the changes from a baseline to the inventory `document`.

    The baseline is an older inventory in JSON, or the captures to make one from; `options` is for
    reading these. `on_remark` gets lines for the user. Raises InputError if the baseline cannot be
    read or has no transaction.
    """
    first = baseline[0]
    old = _stored(first) if len(baseline) == 1 and _is_stored(first) else None
    if old is None:
        run = InventoryRun(baseline, options)
        run.reading.demand_files()
        old = run.take(on_remark)
        if run.error is not None:
            on_remark(f"{run.error}; compared with what is there")
    if not old.transactions:
        raise InputError(f"{', '.join(baseline)}: no transaction in it to compare with")
    return changes(old, document)


def _is_stored(path: str) -> bool:
    """True if a file begins with `{`, as an inventory in JSON does and captures never do."""
    try:
        with Path(path).open("rb") as file:
            return file.read(64).lstrip().startswith(_DOCUMENT_BEGINS)
    except OSError:
        return False  # Reading the file as a capture will raise the error.


def _stored(path: str) -> InventoryDocument:
    try:
        with Path(path).open("rb") as file:
            data = file.read(MAX_DOCUMENT_BYTES + 1)
        if len(data) > MAX_DOCUMENT_BYTES:
            raise InputError(f"{path}: more than {MAX_DOCUMENT_BYTES} bytes are no inventory")
        document = msgspec.json.decode(data, type=InventoryDocument)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: is no inventory as --format json writes it: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if document.format != INVENTORY_FORMAT:
        raise InputError(
            f"{path}: is an inventory of format {document.format!r}; this program reads "
            f"{INVENTORY_FORMAT}"
        )
    return document
