"""Chunks, packets and connections, as sources deliver them."""

from __future__ import annotations

from mbtool.core.evidence import Chunk, Connection, Direction, Endpoint, Stamp


def test_endpoint_writes_an_ipv6_address_in_brackets() -> None:
    assert str(Endpoint("10.0.0.9", 502)) == "10.0.0.9:502"
    assert str(Endpoint("fe80::1", 502)) == "[fe80::1]:502"


def test_link_of_a_connection_names_the_slave() -> None:
    master = Endpoint("10.0.0.1", 40000)
    assert Connection(master, Endpoint("10.0.0.9", 502)).link == "10.0.0.9"
    assert Connection(master, Endpoint("10.0.0.9", 1502)).link == "10.0.0.9:1502"
    assert Connection(master, Endpoint("fe80::9", 1502)).link == "[fe80::9]:1502"


def test_connections_between_the_same_ends_differ_by_number() -> None:
    ends = Endpoint("10.0.0.1", 40000), Endpoint("10.0.0.9", 502)
    assert Connection(*ends) != Connection(*ends, 1)


def test_chunk_is_by_default_a_serial_read_of_unknown_direction() -> None:
    chunk = Chunk(ts_ns=1, link="rs485", data=b"\x01")
    assert chunk.direction is Direction.UNKNOWN
    assert chunk.stamp is Stamp.LAST_BYTE
    assert chunk.connection is None
