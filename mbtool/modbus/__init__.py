"""The Modbus protocol without I/O: bytes and times in, transactions out."""

from mbtool.modbus.adu import Adu, Checksum, DirectionBy, Skipped, Transport, Verdict
from mbtool.modbus.answer import Answer, Responder
from mbtool.modbus.ascii import AsciiSplitter
from mbtool.modbus.conversation import Bus, Conversation, Decoded
from mbtool.modbus.framing import ascii_adu, crc, lrc, mbap_adu, rtu_adu
from mbtool.modbus.functions import (
    FUNCTIONS,
    ExceptionCode,
    exception_name,
    function_name,
    short_name,
)
from mbtool.modbus.mbap import MbapSplitter
from mbtool.modbus.pdu import (
    Pdu,
    encode_pdu,
    exception_pdu,
    parse_pdu,
    pdu_length,
    pdu_of,
    whole_pdu,
)
from mbtool.modbus.reach import REACHING, Reach, reach_of, response_to, values_after
from mbtool.modbus.recognition import Recognition, State
from mbtool.modbus.rtu import RtuSplitter
from mbtool.modbus.rtu_stream import RtuStreamSplitter
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome, Transaction
from mbtool.modbus.two_taps import TwoTaps

__all__ = [
    "FUNCTIONS",
    "REACHING",
    "Adu",
    "Answer",
    "AsciiSplitter",
    "Bus",
    "Checksum",
    "Conversation",
    "Decoded",
    "DirectionBy",
    "ExceptionCode",
    "MbapSplitter",
    "Outcome",
    "Pdu",
    "Reach",
    "Recognition",
    "Responder",
    "RtuSplitter",
    "RtuStreamSplitter",
    "Skipped",
    "State",
    "Table",
    "Transaction",
    "Transport",
    "TwoTaps",
    "Verdict",
    "ascii_adu",
    "crc",
    "encode_pdu",
    "exception_name",
    "exception_pdu",
    "function_name",
    "lrc",
    "mbap_adu",
    "parse_pdu",
    "pdu_length",
    "pdu_of",
    "reach_of",
    "response_to",
    "rtu_adu",
    "short_name",
    "values_after",
    "whole_pdu",
]
