"""Reads capture files: pcap and pcapng, recognised by their first bytes."""

# A reader takes an open binary stream and yields one packet at a time, so memory does not grow with
# the file. The stream must be buffered: `read(n)` returns fewer than n bytes only at its end.
#
# A reader raises DamageError where the file is damaged, and CutError where the file ends in the
# middle of a record; all packets before that place are yielded first. `name` is the file's name in
# the text of these errors.

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, BinaryIO

from mbtool.core import CutError, InputError, Packet
from mbtool.packets.pcap import PCAP_MAGICS, read_pcap
from mbtool.packets.pcapng import PCAPNG_MAGIC, read_pcapng

if TYPE_CHECKING:
    from mbtool.packets.line_packets import CaptureHead

CAPTURE_MAGICS = (*PCAP_MAGICS, PCAPNG_MAGIC)


def read_capture(
    stream: BinaryIO,
    name: str = "capture",
    on_head: Callable[[CaptureHead], None] = lambda _: None,
) -> Iterator[Packet]:
    """Yield the packets of a pcap or pcapng file.

    `on_head` is called with the description of serial lines and taps that `convert` writes into a
    pcapng file, if there is one. Raises InputError if the file is of another kind, DamageError or
    CutError if it is damaged or ends too early.
    """
    magic = stream.read(4)
    if magic in PCAP_MAGICS:
        return read_pcap(stream, magic, name)
    if magic == PCAPNG_MAGIC:
        return read_pcapng(stream, name, on_head)
    if not magic:
        raise InputError(f"{name}: empty; a capture has at least a header")
    if any(known.startswith(magic) for known in CAPTURE_MAGICS):
        raise CutError(f"{name}: ends inside the first bytes of its header")
    raise InputError(
        f"{name}: not a capture (it begins with {magic.hex(' ')}); pcap and pcapng are read"
    )
