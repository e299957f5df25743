"""Reads transactions and events from the lines that exports.py writes as jsonl."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from mbtool.core import InputError
from mbtool.devices import NamedTransaction
from mbtool.logs.messages import EventMessage

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from mbtool.core import WireEvent

_HEX_FIELDS = ("request_raw", "response_raw", "raw")
_decode = msgspec.json.Decoder(dict).decode


def read_jsonl(lines: Iterable[bytes], name: str) -> Iterator[NamedTransaction | WireEvent]:
    """Give the transactions and events of jsonl lines; `name` is the file's.

    Raises InputError for a line that is neither.
    """
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            fields = _decode(line)
            for field in _HEX_FIELDS:
                if field in fields:
                    fields[field] = bytes.fromhex(fields[field])
            if "kind" in fields:
                yield msgspec.convert(fields, EventMessage).item()
            else:
                yield msgspec.convert(fields, NamedTransaction)
        except (msgspec.MsgspecError, ValueError, TypeError) as error:
            raise InputError(
                f"{name}: line {number} is no transaction and no event of "
                f"`mbtool decode --format jsonl`: {error}"
            ) from error
