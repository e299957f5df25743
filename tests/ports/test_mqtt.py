"""The address of a broker."""

from __future__ import annotations

import pytest

from mbtool.core import UsageError
from mbtool.ports.mqtt import Broker


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
