"""The worked messages of the manuals, from worked_examples.toml."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import msgspec

from mbtool.modbus.adu import Transport
from mbtool.modbus.pdu import pdu_of

_FILE = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkedExample:
    """One message of a manual, its answer, and what they mean."""

    name: str
    devices: list[str]
    """The built-in profiles it belongs to."""
    what: str
    source: str
    origin: str
    """`printed` in the manual, or `derived` from its text."""
    transport: str
    """`pdu`, or a transport: the bytes are whole ADUs."""
    request: str = ""
    """Spaced hex, of ASCII its characters; empty where only the response is known."""
    response: str = ""
    """The same; empty where nobody answers, or no answer is given."""
    well_formed: bool = True
    """Whether the request has the form of its function."""
    foreign: bool = False
    """Whether the protocol ID says that this is not Modbus."""
    playable: bool = True
    """Whether a slave that goes by the profile alone gives this response."""
    row: list[str] = field(default_factory=list)
    """What `decode` shows of it: function, what is addressed or written, and the result."""
    reference: str | None = None
    function_name: str | None = None
    """The maker's name for a function of his own."""
    points: list[str] | None = None
    """`reference | name | text` of each, in the order of addresses."""
    says: str = ""
    findings: list[str] | None = None

    @property
    def request_bytes(self) -> bytes:
        return self._bytes(self.request)

    @property
    def response_bytes(self) -> bytes:
        return self._bytes(self.response)

    @property
    def request_pdu(self) -> bytes:
        return self._pdu(self.request_bytes)

    @property
    def response_pdu(self) -> bytes:
        return self._pdu(self.response_bytes)

    @property
    def unit(self) -> int:
        """The unit of the ADU; 1 where the example is a PDU."""
        raw = self.request_bytes or self.response_bytes
        return 1 if self.transport == "pdu" else pdu_of(Transport(self.transport), raw)[0]

    def __str__(self) -> str:
        return self.name

    def _bytes(self, text: str) -> bytes:
        if self.transport == "ascii":
            return f"{text}\r\n".encode() if text else b""
        return bytes.fromhex(text)

    def _pdu(self, raw: bytes) -> bytes:
        if not raw or self.transport == "pdu":
            return raw
        return pdu_of(Transport(self.transport), raw)[1]


class _File(msgspec.Struct, forbid_unknown_fields=True):
    example: list[WorkedExample]


@cache
def worked_examples() -> list[WorkedExample]:
    """All of them, in the order of the file."""
    return msgspec.convert(tomllib.loads(_FILE.read_text(encoding="utf-8")), _File).example
