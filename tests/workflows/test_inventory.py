"""Files into an inventory, and against a baseline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import CutError, InputError
from mbtool.ledger.baseline import ChangeKind
from mbtool.modbus import mbap_adu
from mbtool.views.inventory_documents import inventory_json
from mbtool.workflows.inventory import InventoryOptions, InventoryRun, changes_since
from mbtool.workflows.shared.reading import ReadingOptions
from tests.packets.building import End, Talk, pcap
from tests.workflows.evidence import capture_file, capture_of

if TYPE_CHECKING:
    from mbtool.core import Packet

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
FA3 = str(CAPTURES / "fa3-at1m8x-setup.pcap")
OPTIONS = InventoryOptions(reading=ReadingOptions())
_MACS = {"10.0.0.1": "0030de000001", "10.0.0.2": "0030de000002", "10.0.0.66": "000c29000066"}
_SLAVE_MAC = "0090e8000000"

Asked = tuple[str, str, int, str, str | None]
"""A master, a slave, a unit, and the PDUs of the request and the response in hexadecimal."""

PLANT: list[Asked] = [
    ("10.0.0.1", "10.0.0.10", 1, "03 0000 0002", "03 04 0001 0002"),
    ("10.0.0.1", "10.0.0.10", 1, "06 0010 0007", "06 0010 0007"),
    ("10.0.0.1", "10.0.0.10", 1, "2b 0e 01 00", "2b 0e 01 01 00 00 01 00 04 41434d45"),
    ("10.0.0.1", "10.0.0.11", 1, "04 0000 0001", "04 02 0001"),
    ("10.0.0.1", "10.0.0.20", 3, "03 0000 0001", "03 02 0001"),
    ("10.0.0.1", "10.0.0.20", 4, "03 0000 0001", "03 02 0001"),
    ("10.0.0.2", "10.0.0.20", 4, "03 0000 0001", "03 02 0001"),
]
CHANGED: list[Asked] = [
    ("10.0.0.1", "10.0.0.10", 1, "03 0000 0003", "03 06 0001 0002 0003"),  # a wider range
    ("10.0.0.1", "10.0.0.10", 1, "06 0010 0007", "06 0010 0007"),
    ("10.0.0.66", "10.0.0.10", 1, "06 0010 0001", "06 0010 0001"),  # a second writer
    ("10.0.0.1", "10.0.0.10", 1, "05 0001 ff00", "05 0001 ff00"),  # a new function
    # Another identity: vendor EVIL in place of ACME.
    ("10.0.0.1", "10.0.0.10", 1, "2b 0e 01 00", "2b 0e 01 01 00 00 01 00 04 4556494c"),
    ("10.0.0.1", "10.0.0.11", 1, "04 0000 0001", "04 02 0001"),  # It gets another MAC address.
    ("10.0.0.1", "10.0.0.20", 3, "03 0000 0001", "03 02 0001"),
    ("10.0.0.1", "10.0.0.20", 4, "03 0000 0001", None),  # a unit gone silent
    ("10.0.0.2", "10.0.0.20", 4, "03 0000 0001", None),
    ("10.0.0.1", "10.0.0.20", 5, "03 0000 0001", "03 02 0001"),  # a new unit
    ("10.0.0.2", "10.0.0.77", 1, "03 0000 0001", "03 02 0001"),  # a new host
]


def plant_capture(exchanges: list[Asked], macs: dict[str, str] | None = None) -> bytes:
    """A pcap file with one connection for each master and slave, and a MAC for each host."""
    known = {**_MACS, **(macs or {})}
    talks: dict[tuple[str, str], Talk] = {}
    packets: list[Packet] = []

    def keep(one: Packet, source: str, destination: str) -> None:
        ends = bytes.fromhex(known.get(destination, _SLAVE_MAC) + known.get(source, _SLAVE_MAC))
        packets.append(replace(one, data=ends + one.data[12:], ts_ns=len(packets) * 1_000_000))

    for number, (master, slave, unit, request, response) in enumerate(exchanges):
        if (master, slave) not in talks:
            talk = talks[master, slave] = Talk(End(master, 50000, 1000), End(slave, 502, 5000))
            for one, from_master in zip(talk.handshake(), (True, False, True), strict=True):
                keep(one, *((master, slave) if from_master else (slave, master)))
        talk = talks[master, slave]
        keep(talk.request(mbap_adu(number, unit, bytes.fromhex(request))), master, slave)
        if response is not None:
            keep(talk.response(mbap_adu(number, unit, bytes.fromhex(response))), slave, master)
    for (master, slave), talk in talks.items():
        for one, source in zip(talk.goodbye(), (master, slave, master), strict=True):
            keep(one, source, slave if source == master else master)
    return pcap(packets)


READ_INPUT = (bytes.fromhex("04 0000 0001"), bytes.fromhex("04 02 0001"))


def test_a_module_that_gives_its_model_and_answers_like_it_is_named() -> None:
    (row,) = InventoryRun([FA3], OPTIONS).take().slaves
    assert row.fit is not None
    assert (row.host, row.unit, row.fit.profile) == ("127.0.0.1", 0, "fa3-at1m8x")


def test_a_packet_capture_and_a_log_of_the_same_give_the_same() -> None:
    paths = [str(CAPTURES / f"fa3-at1m8x-setup{suffix}") for suffix in (".pcap", ".mcap")]
    document, log = (InventoryRun([path], OPTIONS).take() for path in paths)
    assert [row.identity for row in document.slaves] == [row.identity for row in log.slaves]
    assert changes_since([paths[0]], log, OPTIONS) == []


def test_eight_injected_changes_are_named_and_nothing_else(tmp_path: Path) -> None:
    old, new = tmp_path / "old.pcap", tmp_path / "new.pcap"
    old.write_bytes(plant_capture(PLANT))
    new.write_bytes(plant_capture(CHANGED, {"10.0.0.11": "000c29000011"}))
    found = changes_since([str(old)], InventoryRun([str(new)], OPTIONS).take(), OPTIONS)
    assert [(one.kind.value, one.where, one.text) for one in found] == [
        ("new host", "10.0.0.77 unit 1", "asked by 10.0.0.2"),
        ("new unit", "10.0.0.20 unit 5", "asked by 10.0.0.1"),
        (
            "new writer",
            "10.0.0.10 unit 1",
            "10.0.0.66 (a new host): 06 write register writes 16",
        ),
        ("new function", "10.0.0.10 unit 1", "05 write coil writes 1 by 10.0.0.1"),
        ("wider range", "10.0.0.10 unit 1", "03 read holding registers reads 2 by 10.0.0.1"),
        ("changed identity", "10.0.0.10 unit 1", 'vendor: "ACME" -> "EVIL"'),
        (
            "changed MAC",
            "10.0.0.11",
            "00:90:e8:00:00:00 -> 00:0c:29:00:00:11 (VMware, Inc.)",
        ),
        ("gone silent", "10.0.0.20 unit 4", "asked 2 times, and never answered"),
    ]


def test_a_capture_against_itself_has_no_change(tmp_path: Path) -> None:
    path = tmp_path / "plant.pcap"
    path.write_bytes(plant_capture(PLANT))
    assert changes_since([str(path)], InventoryRun([str(path)], OPTIONS).take(), OPTIONS) == []


def test_hosts_have_the_makers_of_their_cards(tmp_path: Path) -> None:
    path = tmp_path / "plant.pcap"
    path.write_bytes(plant_capture(PLANT))
    document = InventoryRun([str(path)], OPTIONS).take()
    assert document.slaves[0].makers == ["Moxa Technologies Corp., Ltd."]
    assert document.masters[0].makers == ["WAGO Kontakttechnik GmbH"]


def test_what_is_not_wanted_is_left_out() -> None:
    options = InventoryOptions(reading=ReadingOptions(), wanted=lambda one: one.function == 3)
    (row,) = InventoryRun([FA3], options).take().slaves
    assert [use.function for use in row.uses] == [3]


def test_a_cut_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(capture_file(3)[:-20])
    run = InventoryRun([str(path)], OPTIONS)
    assert run.take().transactions == 3
    assert isinstance(run.error, CutError)


def test_a_baseline_that_is_cut_is_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.pcap", tmp_path / "cut.pcap"
    whole.write_bytes(capture_file(3))
    cut.write_bytes(capture_file(3)[:-20])
    remarks: list[str] = []
    new = InventoryRun([str(whole)], OPTIONS).take()
    assert changes_since([str(cut)], new, OPTIONS, remarks.append) == []
    assert remarks[-1].endswith("; compared with what is there")


def test_a_baseline_is_an_inventory_or_a_capture(tmp_path: Path) -> None:
    capture, more = tmp_path / "a.pcap", tmp_path / "b.pcap"
    capture.write_bytes(capture_file(3))
    more.write_bytes(
        capture_of(
            [READ_INPUT, *[(bytes.fromhex("03 0000 0002"), bytes.fromhex("03 04 1234 5678"))] * 2]
        )
    )
    stored = tmp_path / "a.json"
    stored.write_text(inventory_json(InventoryRun([str(capture)], OPTIONS).take(), "1"))
    new = InventoryRun([str(more)], OPTIONS).take()
    by_inventory = changes_since([str(stored)], new, OPTIONS)
    by_capture = changes_since([str(capture)], new, OPTIONS)
    assert [one.kind for one in by_inventory] == [ChangeKind.FUNCTION]
    assert by_inventory == by_capture


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("{", "is no inventory as --format json writes it"),
        ("{}", "is no inventory as --format json writes it"),
        ('{"format": "other-9"}', "is an inventory of format 'other-9'"),
        ('{"format": "mbtool-inventory-1"}', "no transaction in it to compare with"),
        ('{"format": "mbtool-inventory-1", "slaves": [{"host": 5}]}', "is no inventory"),
    ],
)
def test_a_baseline_that_is_no_inventory_is_told(tmp_path: Path, text: str, error: str) -> None:
    path = tmp_path / "old.json"
    path.write_text(text)
    new = InventoryRun([FA3], OPTIONS).take()
    with pytest.raises(InputError, match=error):
        changes_since([str(path)], new, OPTIONS)


def test_a_baseline_that_is_absent_is_told() -> None:
    new = InventoryRun([FA3], OPTIONS).take()
    with pytest.raises(InputError, match="absent"):
        changes_since(["absent.pcap"], new, OPTIONS)
