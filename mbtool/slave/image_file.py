"""Reads the values that a slave is to start with from a TOML file."""

# A key is a reference in the device's own notation, a value what stands there, a list what stands
# there and behind it:
#
#     HR400001 = 4660
#     HR400010 = [1, 2, -3]      # negative numbers are 16-bit two's complement
#     C1 = 1
#
# The file speaks in the order of its lines: where ranges overlap, the later line counts. A master's
# rights do not matter here, so inputs can be given values too.
#
# Limits: a file of at most 4 MiB, room for every address of all tables.

from __future__ import annotations

import reprlib
from typing import TYPE_CHECKING

from mbtool.core import UsageError
from mbtool.devices import parse_reference
from mbtool.slave.toml_file import read_toml

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from mbtool.devices import Profile
    from mbtool.modbus.tables import Table
    from mbtool.slave.image import RegisterImage

MAX_FILE_BYTES = 4 << 20

_LOWEST, _HIGHEST = -0x8000, 0xFFFF


def load_image(
    path: Path,
    profile: Profile,
    image: RegisterImage,
    only: Sequence[tuple[Table, range]] | None = None,
) -> None:
    """Write the values of a file into an image; `only` is what the file may speak of.

    Raises InputError for a file that is no TOML, UsageError for what it says; the image then holds
    what came before.
    """
    hint = "write lines such as HR400001 = 4660"
    for key, value in read_toml(path, MAX_FILE_BYTES, "register image", hint).items():
        try:
            table, address = parse_reference(profile, key)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from error
        values = [_number(path, key, one, table) for one in _listed(path, key, value)]
        if profile.area(table, address, len(values)) is None:
            area = profile.area(table, address)
            end = f", which ends at {area.reference(area.last)}" if area is not None else ""
            raise UsageError(f"{path}: {key}: {len(values)} values do not fit its area{end}")
        span = range(address, address + len(values))
        if only is not None and not _is_among(table, span, only):
            raise UsageError(
                f"{path}: {key}: {profile.name} does not keep this over a restart; "
                f"is this a file of start values, for --image?"
            )
        image.set(table, address, values)


def _is_among(table: Table, span: range, parts: Sequence[tuple[Table, range]]) -> bool:
    return any(
        table is each and span.start in part and span.stop <= part.stop for each, part in parts
    )


def _listed(path: Path, key: str, value: object) -> list[object]:
    values = value if isinstance(value, list) else [value]
    if not values:
        raise UsageError(f"{path}: {key}: the list is empty; write a number or numbers")
    return values


def _number(path: Path, key: str, value: object, table: Table) -> int:
    if isinstance(value, bool) and table.is_bits:
        return int(value)
    lowest, highest = (0, 1) if table.is_bits else (_LOWEST, _HIGHEST)
    if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
        shown = str(value).lower() if isinstance(value, bool) else reprlib.repr(value)
        raise UsageError(f"{path}: {key}: {shown}: write a number from {lowest} to {highest}")
    return value & _HIGHEST
