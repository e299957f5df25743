"""Writes and reads logs, MCAP files of captured bytes and decoded data; exports jsonl and CSV."""

from mbtool.logs.exports import (
    CsvWriter,
    csv_columns,
    csv_line,
    event_to_jsonl,
    transaction_to_jsonl,
)
from mbtool.logs.messages import LogItem
from mbtool.logs.reader import LogReader, follow, read_log
from mbtool.logs.rotation import RotatingLog, Rotation
from mbtool.logs.schemas import json_schema
from mbtool.logs.writer import FLUSH_AFTER_NS, LogWriter

__all__ = [
    "FLUSH_AFTER_NS",
    "CsvWriter",
    "LogItem",
    "LogReader",
    "LogWriter",
    "RotatingLog",
    "Rotation",
    "csv_columns",
    "csv_line",
    "event_to_jsonl",
    "follow",
    "json_schema",
    "read_log",
    "transaction_to_jsonl",
]
