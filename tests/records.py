"""Compares what was decoded from different files, or live and from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from mbtool.core import WireEvent

if TYPE_CHECKING:
    from collections.abc import Iterable

    from mbtool.decode.decoder import Record


def without_origins(records: Iterable[Record]) -> list[Record]:
    """The records without what says in which file, and where in it, they stand."""
    return [
        one
        if isinstance(one, WireEvent)
        else replace(
            one,
            file=None,
            response_file=None,
            request_packet=None,
            response_packet=None,
            request_offset=None,
            response_offset=None,
        )
        for one in records
    ]
