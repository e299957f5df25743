"""The table of plants, and the cells of it that the decoder reads without a mistake."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tests.benchmarks.line import main
from tests.benchmarks.plants.catalog import PLANTS, record
from tests.benchmarks.plants.decoding import hear
from tests.benchmarks.plants.delivery import Adapter
from tests.benchmarks.plants.examples import judged, piece, shortest_failure
from tests.benchmarks.plants.judging import PlantFigures, Told
from tests.benchmarks.plants.measuring import PlantCell, measure_plant
from tests.benchmarks.plants.peers import plant_decoders
from tests.benchmarks.plants.recording import Recording, Role
from tests.benchmarks.plants.report import HEADINGS, percent, times_cost
from tests.benchmarks.plants.through_command import differences

if TYPE_CHECKING:
    from pathlib import Path

SEED = 11
READ_RIGHTLY = [
    *((plant, adapter)
      for plant in ("clean", "glued", "register scan", "late responses", "radio gaps", "slow slave")
      for adapter in Adapter),
    *((plant, adapter) for plant in ("slave of two", "set points")
      for adapter in (Adapter.EXACT, Adapter.GRID, Adapter.FTDI, Adapter.BACK)),
    *((plant, Adapter.EXACT) for plant in ("dead units", "lost responses", "unit scan",
                                           "user-defined")),
    *((plant, Adapter.NO_TIMES) for plant in ("lost responses", "slow writes", "user-defined",
                                              "stray bytes")),
]  # fmt: skip


@pytest.mark.parametrize(("plant", "adapter"), READ_RIGHTLY)
def test_a_plant_is_read_rightly(plant: str, adapter: Adapter) -> None:
    one = measure_plant(PlantCell(plant, adapter, "mbtool"), [SEED], 200, hear).figures
    assert one.misses == []
    assert (one.found, one.sure_wrong, one.frames_false) == (one.transactions, 0, 0)
    assert one.transactions >= 150


@pytest.mark.parametrize("adapter", [Adapter.EXACT, Adapter.FTDI, Adapter.NO_TIMES])
def test_the_command_says_the_same_as_the_class(adapter: Adapter, tmp_path: Path) -> None:
    recording = record("mixed", SEED, 100)
    assert differences(recording, adapter, tmp_path) == []


def test_what_the_command_says_otherwise_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = record("clean", SEED, 10)
    shorter = piece(recording, 0, len(recording.sent) - 2)
    monkeypatch.setattr(
        "tests.benchmarks.plants.through_command.written",
        lambda *_: written_of(shorter, tmp_path),
    )
    (last,) = differences(recording, Adapter.NO_TIMES, tmp_path)
    assert last.startswith("the command tells ")


def written_of(recording: Recording, folder: Path) -> tuple[Path, list[str]]:
    path = folder / "other.raw"
    path.write_bytes(recording.data)
    return path, ["--link", f"rtu@{recording.line}"]


def test_a_peer_searches_pymodbus_frames_at_every_byte() -> None:
    searched = plant_decoders(peers=True)["pymodbus searched"]
    for plant in ("clean", "glued", "stray bytes"):
        recording = record(plant, SEED, 100)
        one = judged(recording, Adapter.NO_TIMES, searched)
        assert one.frames_found >= 0.99 * one.frames
        assert one.told == 0


def deaf(recording: Recording, adapter: Adapter) -> Told:
    """Hears no response to unit 1."""
    told = hear(recording, adapter)
    assert told.transactions is not None
    told.transactions = [one for one in told.transactions if one.request and one.request[1][0] != 1]
    return told


def test_a_recording_is_cut_down_to_what_a_decoder_gets_wrong() -> None:
    recordings = (record("clean", seed, 40) for seed in range(50))
    recording = next(one for one in recordings if any(sent.unit == 1 for sent in one.sent))
    short = shortest_failure(recording, Adapter.EXACT, deaf)
    assert short is not None
    assert [one.role for one in short.sent] == [Role.REQUEST, Role.RESPONSE]
    assert short.sent[0].unit == 1
    assert short.data == short.sent[0].raw + short.sent[1].raw
    assert shortest_failure(recording, Adapter.EXACT, hear) is None


def test_times_cost_what_is_right_without_them_and_wrong_with_them() -> None:
    without = PlantCell("clean", Adapter.NO_TIMES, "a", PlantFigures(all=100, right=100))
    with_times = PlantCell("clean", Adapter.EXACT, "a", PlantFigures(all=100, right=97))
    other = PlantCell("glued", Adapter.EXACT, "a", PlantFigures(all=100, right=97))
    assert times_cost(with_times, [without, with_times]) == pytest.approx(0.03)
    assert times_cost(without, [without, with_times]) is None
    assert times_cost(other, [without, with_times]) is None


def test_shares_are_never_rounded_towards_what_is_good() -> None:
    assert percent(0.99999) == "99.99 %"
    assert percent(0.00001, up=True) == "0.01 %"
    assert (percent(1.0), percent(0.0, up=True), percent(None)) == ("100.00 %", "0.00 %", "-")


def test_the_table_has_a_row_for_each_plant_and_adapter(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["--plants", "--no-peers", "--transactions", "20", "--cell", "glued/bursts"]
    main([*arguments, "--markdown", "--seeds", "3", "4"])
    heading, _, *rows, seeds = capsys.readouterr().out.splitlines()
    assert heading == "| plant | bursts of 32 | bursts of 62 | bursts of 64 | bursts of 8 KB |"
    assert rows == [f"| glued |{' 100.00 / 0.00 |' * 4}"]
    assert seeds == "seeds 3 4"
    main(arguments)
    heading, *rows, seeds = capsys.readouterr().out.splitlines()
    assert heading.split()[:3] == list(HEADINGS[:3])
    assert [row.split("  ")[0] for row in rows] == ["glued"] * 4
    assert seeds == "seeds 1"


def test_json_has_an_object_for_each_plant_and_adapter(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--plants", "--no-peers", "--transactions", "10", "--cell", "/exact", "--json"])
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one["plant"] for one in rows] == list(PLANTS)
    assert all(one["transactions"] + one["hidden"] == one["all"] for one in rows)


def test_a_plant_that_does_not_exist_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--plants", "--cell", "submarine"])
    assert "submarine" in capsys.readouterr().err
