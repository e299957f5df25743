"""Bytes of a program's own."""

from __future__ import annotations

import pytest

import mbtool

REQUEST = bytes.fromhex("01 03 0000 0002 c40b")  # unit 1, read holding registers from address 0
RESPONSE = bytes.fromhex("01 03 04 0064 00c8 ba7a")


def outcomes(records: list[mbtool.NamedTransaction | mbtool.WireEvent]) -> list[str]:
    return [
        one.kind if isinstance(one, mbtool.WireEvent) else f"{one.reference} {one.outcome}"
        for one in records
    ]


def test_a_line_without_times_is_decoded_byte_by_byte() -> None:
    decoder = mbtool.Decoder(devices={1: "idec-ft1a-touch"})
    records = [record for byte in REQUEST + RESPONSE for record in decoder.feed(bytes([byte]))]
    assert outcomes([*records, *decoder.close()]) == ["HR400001..400002 ok"]


def test_silence_ends_a_frame_before_the_next_one_comes() -> None:
    decoder = mbtool.Decoder()
    records = decoder.feed(REQUEST, 1_000_000_000) + decoder.feed(RESPONSE, 1_020_000_000)
    records += decoder.quiet(2_000_000_000)
    assert outcomes(records) == ["holding 0..1 ok"]
    assert decoder.close() == []


def test_bytes_that_are_no_frame_are_an_event() -> None:
    decoder = mbtool.Decoder()
    (event,) = decoder.feed(b"\xff\xfe\xfd") + decoder.close()
    assert isinstance(event, mbtool.WireEvent)
    assert event.raw == b"\xff\xfe\xfd"


def test_ascii_is_decoded() -> None:
    decoder = mbtool.Decoder("ascii@9600-7E1")
    records = decoder.feed(b":010300000002FA\r\n:0103040064 00C8CC\r\n".replace(b" ", b""))
    assert outcomes([*records, *decoder.close()]) == ["holding 0..1 ok"]


@pytest.mark.parametrize(
    ("link", "request_adu", "response"),
    [
        ("tcp", "0001 0000 0006 01 03 0000 0002", "0001 0000 0007 01 03 04 0064 00c8"),
        ("rtu+tcp", REQUEST.hex(), RESPONSE.hex()),
    ],
)
def test_a_connection_is_decoded_with_its_directions(
    link: str, request_adu: str, response: str
) -> None:
    decoder = mbtool.Decoder(link)
    records = decoder.feed(bytes.fromhex(request_adu), 1_000, direction="request")
    records += decoder.feed(bytes.fromhex(response), 2_000, direction="response")
    assert "holding 0..1 ok" in outcomes([*records, *decoder.quiet(3_000), *decoder.close()])


def test_a_connection_needs_a_direction() -> None:
    with pytest.raises(mbtool.UsageError, match='direction None: write "request" or "response"'):
        mbtool.Decoder("tcp").feed(b"\x00")


@pytest.mark.parametrize("link", ["rtu@1", "ascii@9600-8X9", "tcp:10.0.0.1", "serial", ""])
def test_a_wrong_link_is_refused(link: str) -> None:
    with pytest.raises(mbtool.UsageError, match=f"link '{link}'"):
        mbtool.Decoder(link)
