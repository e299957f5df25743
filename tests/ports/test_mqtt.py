"""The address of a broker."""

from __future__ import annotations

import socket
from threading import Event, Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.core import UsageError
from mbtool.ports.mqtt import Broker, MqttPublisher

if TYPE_CHECKING:
    from typing import BinaryIO

PATIENCE_S = 20.0


@pytest.mark.parametrize(
    ("text", "broker"),
    [
        ("mqtt://plc", Broker("plc", 1883, "mbtool")),
        ("mqtt://10.0.0.9:1884/site/7", Broker("10.0.0.9", 1884, "site/7")),
        ("mqtts://[fe80::1]/x", Broker("fe80::1", 8883, "x", tls=True)),
        ("mqtt://me:p%40ss@plc", Broker("plc", 1883, "mbtool", "me", "p@ss")),
        ("mqtts://plc?ca=ca.pem", Broker("plc", 8883, "mbtool", tls=True, ca="ca.pem")),
    ],
)
def test_an_address_names_host_port_topic_user_and_tls(text: str, broker: Broker) -> None:
    assert Broker.parse(text) == broker


@pytest.mark.parametrize(
    "text",
    ["http://me:secret@plc", "mqtt://me:secret@plc:x", "mqtt://me:secret@plc/a%23",
     "mqtt://me:secret@plc?ca=x", "mqtt://me:se/secret@plc:x", "me:secret@plc",
     "mqtt:/me:secret@plc", "mqtt:me:secret@plc", "mqtt://me:#secret@plc"],
)  # fmt: skip
def test_no_error_repeats_the_password(text: str) -> None:
    with pytest.raises(UsageError) as told:
        Broker.parse(text)
    assert "secret" not in str(told.value)
    assert "plc" in str(told.value)


@pytest.mark.parametrize(
    "text",
    ["plc", "http://plc", "mqtt://", "mqtt://plc:x", "mqtt://plc/a%23", "mqtt://plc?ca=x", "mqtts://plc?key=x"],
)  # fmt: skip
def test_an_address_of_another_form_is_one_clear_line(text: str) -> None:
    with pytest.raises(UsageError, match=r"--mqtt "):
        Broker.parse(text)


def _packet(client: BinaryIO) -> tuple[int, bytes]:
    """The kind and the content of the next packet; its length is below 128."""
    kind, size = client.read(2)
    return kind >> 4, client.read(size)


def test_a_message_that_is_not_confirmed_is_sent_once_more_after_the_connection_was_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed: pip install 'mbtool[mqtt]'")
    monkeypatch.setattr("mbtool.ports.mqtt._CONFIRM_S", 0.1, raising=False)
    heard: list[list[str]] = []
    was_repeated = Event()

    def serve(server: socket.socket) -> None:
        for is_confirming in (False, True):
            heard.append([])
            connection, _ = server.accept()
            connection.settimeout(PATIENCE_S)
            with connection, connection.makefile("rb") as client:
                _packet(client)
                connection.sendall(b"\x20\2\0\0")
                while heard[-1][-1:] != (["x/last"] if is_confirming else ["x/first"]):
                    kind, content = _packet(client)
                    if kind != 3:
                        continue
                    size = 2 + int.from_bytes(content[:2])
                    heard[-1].append(content[2:size].decode())
                    if is_confirming and heard[-1][-1] == "x/first":
                        was_repeated.set()
                    if is_confirming:
                        connection.sendall(b"\x40\2" + content[size : size + 2])

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        broker = Thread(target=serve, args=(server,))
        broker.start()
        address = Broker("127.0.0.1", server.getsockname()[1], "x")
        with MqttPublisher(address, lambda _: None) as publisher:
            publisher.publish("first", b"1")
            assert was_repeated.wait(PATIENCE_S)
            publisher.publish("last", b"2")
            broker.join(PATIENCE_S)
    assert [one for one in heard[1] if one != "x/status"] == ["x/first", "x/last"]


def test_a_message_that_mqtt_cannot_carry_is_dropped() -> None:
    pytest.importorskip("paho", reason="paho-mqtt is not installed: pip install 'mbtool[mqtt]'")
    publisher = MqttPublisher(Broker("127.0.0.1", 1, "x"), lambda _: None)
    publisher._send("x" * 70_000, b"1", retain=False)
    assert publisher.dropped == 1
