"""Writes a log with only the packets and bytes that were heard, without decoded transactions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from typing import TYPE_CHECKING

from mbtool.core import Chunk, LinkSpec, Packet, TapLink, WireEvent
from mbtool.logs.undecoded import UNDECODED_PIECES
from mbtool.workflows.shared.undecoded_logs import is_of_source

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding
    from mbtool.logs import LogItem
    from mbtool.logs.messages import DecodingMark
    from mbtool.workflows.shared.heartbeat import StatusLog


def begin_evidence_only(
    begin: Callable[[], StatusLog], links: Sequence[LinkSpec]
) -> EvidenceOnlyLog:
    """Create a log with `begin`, and return a writer that passes only evidence to it. `links` are
    all recorded links.
    """
    return EvidenceOnlyLog(begin(), {link.name for link in links if isinstance(link, TapLink)})


class EvidenceOnlyLog:
    """Passes to a log the packets and chunks, and those events that decoding these again cannot
    find, such as errors of a port or a connection that a tap refused.
    """

    def __init__(self, log: StatusLog, taps: Set[str]) -> None:
        """`log` is the log writer. `taps` are the names of the links that are taps (relays between
        masters and a slave).
        """
        self._log = log
        self._taps = taps

    def write(self, item: LogItem | DecodingMark) -> None:
        is_kept = isinstance(item, Chunk | Packet)
        if is_kept or (isinstance(item, WireEvent) and is_of_source(item, self._taps)):
            self._log.write(item)

    def add_finding(self, finding: Finding, known_ns: int) -> None:
        pass  # A finding is a result of decoding, so it is not written.

    def add_status(self, values: Mapping[str, str]) -> None:
        self._log.add_status(values)

    def tick(self, now_ns: int) -> None:
        self._log.tick(now_ns)

    def close(self, final: Mapping[str, str]) -> None:
        # A log without transactions needs no count of the packets and chunks that were not decoded.
        self._log.close({key: value for key, value in final.items() if key != UNDECODED_PIECES})
