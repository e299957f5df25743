"""Makers by MAC address, from the list that scapy ships."""

from __future__ import annotations

import pytest

from mbtool.sources import makers
from mbtool.sources.makers import LOCAL, maker


@pytest.mark.parametrize(
    ("mac", "name"),
    [
        ("00:30:de:11:22:33", "WAGO Kontakttechnik GmbH"),
        ("00:03:7B:01:02:03", "IDEC IZUMI Corporation"),
        ("00:55:da:01:02:03", "Shinko Technos co.,ltd."),  # a block of 28 bits
        ("00:1b:c5:00:01:02", "Converging Systems Inc."),  # a block of 36 bits
        ("02:42:ac:11:00:02", LOCAL),
        ("00:00:00:00:00:00", None),  # a loopback interface
        ("01:00:5e:00:00:01", None),  # a group
        ("00:30:de", None),
        ("../../etc/passwd", None),
        ("", None),
    ],
)
def test_an_address_has_the_maker_of_its_block(mac: str, name: str | None) -> None:
    assert maker(mac) == name


def test_without_the_list_nobody_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(makers, "_list", lambda: "")
    makers._maker_of.cache_clear()
    assert maker("00:30:de:11:22:33") is None
    makers._maker_of.cache_clear()
