"""The Modbus protocol: parses and encodes PDUs, ADUs and transactions. No I/O."""

from mbtool.modbus.adu import Adu, Skipped, Transport, Verdict, ascii_adu, mbap_adu, rtu_adu
from mbtool.modbus.functions import (
    FUNCTIONS,
    TABLE_FUNCTIONS,
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
    whole_pdu,
)
from mbtool.modbus.register_access import (
    RegisterAccess,
    register_access,
    response_to,
    values_after,
)
from mbtool.modbus.response import Responder, Response
from mbtool.modbus.tables import Table
from mbtool.modbus.transaction import RESPONDED, Outcome, Transaction

__all__ = [
    "FUNCTIONS",
    "RESPONDED",
    "TABLE_FUNCTIONS",
    "Adu",
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
    "encode_pdu",
    "exception_name",
    "exception_pdu",
    "function_name",
    "mbap_adu",
    "parse_pdu",
    "register_access",
    "response_to",
    "rtu_adu",
    "short_name",
    "values_after",
    "whole_pdu",
]
