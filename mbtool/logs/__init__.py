"""The log: an MCAP file of evidence and what was decoded from it; and exports of it."""

from mbtool.logs.creating import demand_place
from mbtool.logs.exports import (
    CSV_COLUMNS,
    CsvWriter,
    csv_row,
    event_to_jsonl,
    transaction_to_jsonl,
)
from mbtool.logs.messages import LogItem
from mbtool.logs.reader import LogReader, follow, read_log
from mbtool.logs.rotation import RotatingLog, Rotation
from mbtool.logs.schemas import MESSAGE_TYPES, json_schema
from mbtool.logs.writer import FLUSH_AFTER_NS, LogWriter

__all__ = [
    "CSV_COLUMNS",
    "FLUSH_AFTER_NS",
    "MESSAGE_TYPES",
    "CsvWriter",
    "LogItem",
    "LogReader",
    "LogWriter",
    "RotatingLog",
    "Rotation",
    "csv_row",
    "demand_place",
    "event_to_jsonl",
    "follow",
    "json_schema",
    "read_log",
    "transaction_to_jsonl",
]
