"""The Modbus protocol: PDUs, ADUs and transactions as values; parsing, encoding, no I/O."""

from mbtool.modbus.adu import Adu, Checksum, DirectionBy, Skipped, Transport, Verdict
from mbtool.modbus.adu_bytes import ascii_adu, crc, lrc, mbap_adu, rtu_adu
from mbtool.modbus.functions import (
    FUNCTIONS,
    ExceptionCode,
    exception_name,
    function_name,
    short_name,
)
from mbtool.modbus.pdu import (
    Pdu,
    encode_pdu,
    exception_pdu,
    parse_pdu,
    pdu_length,
    pdu_of,
    whole_pdu,
)
from mbtool.modbus.register_access import (
    REACHING,
    RegisterAccess,
    register_access,
    response_to,
    values_after,
)
from mbtool.modbus.response import Responder, Response
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import Outcome, Transaction

__all__ = [
    "FUNCTIONS",
    "REACHING",
    "Adu",
    "Checksum",
    "DirectionBy",
    "ExceptionCode",
    "Outcome",
    "Pdu",
    "RegisterAccess",
    "Responder",
    "Response",
    "Skipped",
    "Table",
    "Transaction",
    "Transport",
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
    "register_access",
    "response_to",
    "rtu_adu",
    "short_name",
    "values_after",
    "whole_pdu",
]
