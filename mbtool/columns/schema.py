"""The columns of a table of transactions: their names and pyarrow types. docs/log-format.md
explains each.
"""

from __future__ import annotations

import pyarrow as pa

Table = pa.Table

_WORD = pa.dictionary(pa.int32(), pa.string())
"""The type of a column of text with few different values: each different text is stored once, and
each row has its index."""
_NUMBERS = pa.list_(pa.uint16())
_POINT = pa.struct(
    [
        ("name", pa.string()),
        ("reference", pa.string()),
        ("value", pa.float64()),
        ("text", pa.string()),
        ("unit", pa.string()),
        ("written", pa.bool_()),
    ]
)

SCHEMA = pa.schema(
    [
        ("link", _WORD),
        ("transport", _WORD),
        ("source", _WORD),
        ("destination", _WORD),
        ("unit", pa.uint8()),
        ("transaction_id", pa.uint16()),
        ("function", pa.uint8()),
        ("function_name", _WORD),
        ("sub_function", pa.uint16()),
        ("address", pa.uint16()),
        ("quantity", pa.uint16()),
        ("write_address", pa.uint16()),
        ("write_quantity", pa.uint16()),
        ("request_values", _NUMBERS),
        ("response_values", _NUMBERS),
        ("exception", pa.uint8()),
        ("exception_name", _WORD),
        ("outcome", _WORD),
        ("request_ns", pa.int64()),
        ("request_parts_ns", pa.int64()),
        ("response_ns", pa.int64()),
        ("latency_ns", pa.int64()),
        ("retries", pa.uint32()),
        ("request_raw", pa.binary()),
        ("response_raw", pa.binary()),
        ("verdicts", pa.list_(pa.string())),
        ("direction_by", _WORD),
        ("confidence", pa.float64()),
        ("device", _WORD),
        ("reference", _WORD),
        ("points", pa.list_(_POINT)),
        ("findings", pa.list_(pa.string())),
        ("time", pa.timestamp("ns", "UTC")),
        ("file", _WORD),
        ("response_file", _WORD),
        ("request_packet", pa.uint64()),
        ("response_packet", pa.uint64()),
        ("request_offset", pa.uint64()),
        ("response_offset", pa.uint64()),
        ("source_mac", _WORD),
        ("destination_mac", _WORD),
        ("vlan", pa.uint16()),
        ("pair_confidence", pa.float64()),
    ]
)
"""The columns in order. Other programs rely on them: a column never changes its name, type or
meaning, and new columns come last."""
