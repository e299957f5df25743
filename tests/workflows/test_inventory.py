"""Files into an inventory, and against a baseline."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbtool.core import InputError
from mbtool.overview.baseline import ChangeKind
from mbtool.views.inventory_documents import inventory_json
from mbtool.workflows.inventory import InventoryOptions, InventoryRun, changes_since
from mbtool.workflows.shared.reading import ReadingOptions
from tests.workflows.evidence import capture_file, capture_of

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
FA3 = str(CAPTURES / "fa3-at1m8x-setup.pcap")
OPTIONS = InventoryOptions(reading=ReadingOptions())
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


def test_what_is_not_wanted_is_left_out() -> None:
    options = InventoryOptions(reading=ReadingOptions(), wanted=lambda one: one.function == 3)
    (row,) = InventoryRun([FA3], options).take().slaves
    assert [use.function for use in row.uses] == [3]


def test_a_cut_file_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcap"
    path.write_bytes(capture_file(3)[:-20])
    remarks: list[str] = []
    document = InventoryRun([str(path)], OPTIONS).take(remarks.append)
    assert document.transactions == 3
    assert remarks[0].endswith("; what is there was read")


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
