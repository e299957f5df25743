"""What capture files hold."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from mbtool.sources.files import open_capture

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import Packet


FOLDER = "MBTOOL_PUBLIC_CAPTURES"
_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "captures"


def public_folder() -> Path:
    """The folder of captures made by others, whether it is there or not."""
    return Path(os.environ.get(FOLDER) or _BESIDE)


def read_packets(path: str | Path) -> Iterator[Packet]:
    """Give the packets of a pcap or pcapng file. Raises InputError, CutError."""
    with open_capture(path) as capture:
        yield from capture.packets()
