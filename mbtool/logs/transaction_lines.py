"""Reads transactions and events from the lines that exports.py writes as jsonl."""

# Limit: a line has at most MAX_LINE bytes; the longest transaction takes some kilobytes.

from __future__ import annotations

from codecs import BOM_UTF8
from collections.abc import Iterator
from functools import partial
from typing import BinaryIO

import msgspec

from mbtool.core import InputError, WireEvent
from mbtool.devices import NamedTransaction
from mbtool.logs.messages import EventMessage

MAX_LINE = 1 << 20
_HEX_FIELDS = ("request_raw", "response_raw", "raw")
_decode = msgspec.json.Decoder(dict).decode


def read_jsonl(file: BinaryIO, name: str) -> Iterator[NamedTransaction | WireEvent]:
    """Yield the transactions and events of a jsonl file; `name` is shown in error messages.

    Raises InputError for a line that is neither a transaction nor an event.
    """
    lines = iter(partial(file.readline, MAX_LINE + 1), b"")
    for number, line in enumerate(lines, 1):
        if len(line) > MAX_LINE:
            raise InputError(f"{name}: line {number} has more than {MAX_LINE} bytes")
        if number == 1:
            line = line.removeprefix(BOM_UTF8)
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
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError) as error:
            raise InputError(
                f"{name}: line {number} is no transaction and no event of "
                f"`mbtool decode --format jsonl`: {error}"
            ) from error
