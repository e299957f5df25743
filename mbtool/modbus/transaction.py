"""A request and its response, joined: the one record of the log, of jsonl and of Python."""

from __future__ import annotations

from enum import StrEnum

import msgspec

from mbtool.modbus.adu import DirectionBy, Transport, Verdict


class Outcome(StrEnum):
    """How a transaction ended."""

    OK = "ok"
    EXCEPTION = "exception"
    NO_ANSWER = "no-answer"
    UNSOLICITED = "unsolicited"
    """A response that no request asked for."""
    BROADCAST = "broadcast"
    """To all units, so without an answer."""
    MALFORMED = "malformed"
    """Answered, but the answer does not have the form it must have."""


# No cycle passes through one, so the garbage collector need not visit the many that are kept.
class Transaction(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, gc=False):
    """A request and its response. A field that does not apply is None, and absent in JSON.

    Times are UTC nanoseconds. Registers are integers 0..65535, bits 0 or 1.
    """

    link: str
    transport: Transport
    source: str | None = None
    """The master's endpoint, on a network."""
    destination: str | None = None
    """The slave's endpoint, on a network."""
    unit: int
    transaction_id: int | None = None
    function: int
    """Without the bit that marks an exception response."""
    function_name: str
    sub_function: int | None = None
    """Of diagnostics (08), and the MEI type of 2B."""
    address: int | None = None
    """On the wire, 0-based; where function 17H reads."""
    quantity: int | None = None
    write_address: int | None = None
    """Where function 17H writes."""
    request_values: list[int] | None = None
    response_values: list[int] | None = None
    exception: int | None = None
    exception_name: str | None = None
    outcome: Outcome
    request_ns: int | None = None
    """When the request was complete on the wire."""
    response_ns: int | None = None
    """When the response was complete on the wire."""
    latency_ns: int | None = None
    """From the end of the request to the start of the response."""
    retries: int
    """How many equal requests before this one went unanswered."""
    request_raw: bytes | None = None
    response_raw: bytes | None = None
    verdicts: list[Verdict] = []
    direction_by: DirectionBy
    confidence: float

    @property
    def start_ns(self) -> int:
        """The time of the first of its ADUs."""
        return self.request_ns if self.request_ns is not None else self.response_ns or 0
