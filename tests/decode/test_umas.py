"""Function 5AH (UMAS), whose PDUs may be longer than the standard allows, through the decoder."""

from __future__ import annotations

import io
import random
import zipfile
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, WireEvent
from mbtool.decode.decoder import Decoder, Record
from mbtool.devices import NamedTransaction, Namer
from mbtool.modbus import Verdict, mbap_adu
from tests.packets.building import Talk

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import Packet

PAIRS = 90


def noise(count: int) -> bytes:
    return random.Random(count).randbytes(count)


def zipped(count: int) -> bytes:
    """The bytes of a zip file with many small files, so with many headers that hold zeros."""
    file = io.BytesIO()
    chance = random.Random(count)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        while file.tell() < count:
            name = f"folder/{chance.randrange(1 << 30)}.txt"
            archive.writestr(zipfile.ZipInfo(name), chance.randbytes(40) + bytes(40))
    return file.getvalue()[:count]


def modbus(count: int) -> bytes:
    """The bytes of Modbus/TCP ADUs, as a file with a capture of Modbus has them."""
    one = mbap_adu(0, 1, bytes.fromhex("03 0000 0001")) + mbap_adu(
        0, 1, bytes.fromhex("03 02 1234")
    )
    return (one * (count // len(one) + 1))[:count]


CONTENTS: dict[str, Callable[[int], bytes]] = {
    "random": noise,
    "zip": zipped,
    "zeros": bytes,
    "Modbus": modbus,
}


def conversation(content: bytes, pdu_bytes: int) -> list[tuple[bytes, bytes]]:
    """Pairs of requests and responses that transport the content."""
    body = pdu_bytes - 3
    pieces = [content[at : at + body].ljust(body, b"\0") for at in range(0, 2 * PAIRS * body, body)]
    adus = [mbap_adu(at // 2, 0, b"\x5a\x00\x29" + piece) for at, piece in enumerate(pieces)]
    return list(zip(adus[::2], adus[1::2], strict=True))


def packets(pairs: list[tuple[bytes, bytes]], *cuts: int) -> list[Packet]:
    """A connection in which each ADU is in segments that end at `cuts`."""
    talk = Talk()
    sent = talk.handshake()
    for request, response in pairs:
        for send, adu in ((talk.request, request), (talk.response, response)):
            ends = [0, *cuts, len(adu)]
            sent += [send(adu[a:b]) for a, b in pairwise(ends)]
    return sent + talk.goodbye()


def decoded(sent: list[Packet]) -> list[Record]:
    decoder = Decoder(Namer(), ports=(502,))
    records = [record for packet in sent for record in decoder.feed(packet)]
    return records + decoder.close()


def transactions(records: list[Record]) -> list[NamedTransaction]:
    return [record for record in records if isinstance(record, NamedTransaction)]


def troubles(records: list[Record]) -> list[WireEvent]:
    quiet = (EventKind.OPENED, EventKind.CLOSED)
    return [one for one in records if isinstance(one, WireEvent) and one.kind not in quiet]


@pytest.mark.parametrize("cuts", [(), (7,), (100, 200)], ids=["whole", "header apart", "in three"])
@pytest.mark.parametrize("pdu_bytes", [253, 254, 255, 256, 500, 1021, 1453])
@pytest.mark.parametrize("content", CONTENTS)
def test_every_adu_is_read_and_none_invented(
    content: str, pdu_bytes: int, cuts: tuple[int, ...]
) -> None:
    pairs = conversation(CONTENTS[content](2 * PAIRS * pdu_bytes), pdu_bytes)
    records = decoded(packets(pairs, *cuts))
    done = transactions(records)
    assert [(one.request_raw, one.response_raw) for one in done] == pairs
    assert all((Verdict.OVER_LENGTH in one.verdicts) is (pdu_bytes > 253) for one in done)
    assert troubles(records) == []


@pytest.mark.parametrize("cuts", [(), (100,)], ids=["whole", "in two"])
@pytest.mark.parametrize("pdu_bytes", [254, 1021])
@pytest.mark.parametrize("content", ["random", "zip", "zeros"])
def test_one_lost_segment_costs_one_adu(
    content: str, pdu_bytes: int, cuts: tuple[int, ...]
) -> None:
    pairs = conversation(CONTENTS[content](2 * PAIRS * pdu_bytes), pdu_bytes)
    adus = {adu for pair in pairs for adu in pair}
    sent = packets(pairs, *cuts)
    for lost in range(60, 60 + 2 * (1 + len(cuts))):
        done = transactions(decoded([*sent[:lost], *sent[lost + 1 :]]))
        halves = [raw for one in done for raw in (one.request_raw, one.response_raw) if raw]
        whole = [raw for raw in halves if raw in adus]
        assert len(whole) == 2 * PAIRS - 1
        cut = [raw for raw in halves if raw not in adus]
        assert len(cut) <= 1
        assert all(any(adu.startswith(raw) for adu in adus) for raw in cut)
        assert {one.function for one in done} == {0x5A}
