"""What capture files hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.sources.files import open_capture

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from mbtool.core import Packet


def read_packets(path: str | Path) -> Iterator[Packet]:
    """Give the packets of a pcap or pcapng file. Raises InputError, CutError."""
    with open_capture(path) as capture:
        yield from capture.packets()
