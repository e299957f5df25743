from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import OutputError, UsageError
from mbtool.logs.reader import LogReader, read_log
from mbtool.logs.rotation import RotatingLog, Rotation, with_parts
from mbtool.logs.writer import LogWriter
from tests.logs.samples import chunk

if TYPE_CHECKING:
    from pathlib import Path

SECOND_NS = 1_000_000_000


@pytest.mark.parametrize(
    ("text", "rotation"),
    [
        ("100MB", Rotation(size=100_000_000)),
        ("20kb", Rotation(size=20_000)),
        ("2GB", Rotation(size=2_000_000_000)),
        ("1h", Rotation(time_ns=3600 * SECOND_NS)),
        ("90s", Rotation(time_ns=90 * SECOND_NS)),
        ("30m", Rotation(time_ns=1800 * SECOND_NS)),
        ("7D", Rotation(time_ns=7 * 86400 * SECOND_NS)),
    ],
)
def test_a_rotation_is_a_size_or_a_time(text: str, rotation: Rotation) -> None:
    assert Rotation.parse(text) == rotation


@pytest.mark.parametrize("text", ["", "100", "MB", "0MB", "1.5h", "-1h", "1w", "100MB|1h", "1 h"])
def test_a_rotation_that_is_neither_is_the_users_mistake(text: str) -> None:
    with pytest.raises(UsageError, match="for example 100MB or 1h"):
        Rotation.parse(text)


def test_a_rotation_below_the_fixed_part_of_a_file_is_the_users_mistake() -> None:
    with pytest.raises(UsageError, match=r"rotation '2KB': .*; write 20KB or more"):
        Rotation.parse("2KB")


def test_the_log_goes_on_in_the_next_file_by_size(tmp_path: Path) -> None:
    log = RotatingLog(tmp_path / "x.mcap", Rotation(size=5_000), capture={"host": "bench"})
    log.add_link("rs485", {"spec": "rtu:/dev/ttyUSB0"})
    log.add_profile("pump", b"x" * 10_000)
    log.add_device("all", "pump")
    for number in range(3):
        log.write(chunk(number))
        for second in range(3):  # A file longer than its limit from the start goes on.
            log.tick((10 * number + second) * SECOND_NS)
    log.close({"dropped": "0"})
    names = ["x-0001.mcap", "x-0002.mcap", "x-0003.mcap", "x-0004.mcap"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names  # As a shell lists them.
    items = [list(read_log(tmp_path / name)) for name in names]
    assert items == [[chunk(0)], [chunk(1)], [chunk(2)], []]
    for number, name in enumerate(names, 1):
        with LogReader.open(tmp_path / name) as reader:
            assert list(reader.links) == ["rs485"]
            assert list(reader.profiles) == ["pump"]
            assert reader.devices == {"all": "pump"}
            assert reader.capture["part"] == str(number)
            list(reader.items())
            assert reader.closed


def test_the_log_goes_on_in_the_next_file_by_time(tmp_path: Path) -> None:
    with RotatingLog(tmp_path / "x.mcap", Rotation(time_ns=SECOND_NS), capture={}) as log:
        for number in range(5):
            log.tick(number * SECOND_NS // 2)
            log.write(chunk(number))
        log.tick(100 * SECOND_NS)
        log.tick(200 * SECOND_NS)  # Nothing was written since, so no empty file follows.
    parts = [list(read_log(path)) for path in (tmp_path / "x-0001.mcap", tmp_path / "x-0002.mcap")]
    assert parts == [[chunk(0), chunk(1)], [chunk(2), chunk(3)]]
    assert len(list(tmp_path.iterdir())) == 4


def test_a_number_whose_file_exists_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "x-0002.mcap").write_bytes(b"evidence")
    with RotatingLog(tmp_path / "x.mcap", Rotation(size=1_000), capture={}) as log:
        log.add_profile("pump", bytes(1_000))
        log.write(chunk())
        log.tick(SECOND_NS)
        assert log.path.name == "x-0003.mcap"
        assert 0 < log.size < 2_000
    assert (tmp_path / "x-0002.mcap").read_bytes() == b"evidence"


def test_with_a_limit_of_files_the_oldest_goes_before_the_next_begins(tmp_path: Path) -> None:
    seen = []
    with RotatingLog(tmp_path / "x.mcap", Rotation(time_ns=1), capture={}, keep=3) as log:
        for number in range(6):
            log.tick(number)
            log.write(chunk(number))
            log.tick(number + 1)
            seen.append(sorted(path.name for path in tmp_path.iterdir()))
    assert max(map(len, seen)) == 3
    assert seen[-1] == ["x-0005.mcap", "x-0006.mcap", "x-0007.mcap"]
    assert list(read_log(tmp_path / "x-0005.mcap")) == [chunk(4)]


def test_a_series_that_goes_on_counts_the_parts_of_the_runs_before(tmp_path: Path) -> None:
    for number in (7, 12, 10001):
        path = tmp_path / f"x-{number:04}.mcap"
        LogWriter(path, capture={"part": str(number)}).close()
    for name in ("x-old.mcap", "y-0001.mcap"):
        (tmp_path / name).write_bytes(b"old")
    rotation = Rotation(time_ns=1)
    with RotatingLog(tmp_path / "x.mcap", rotation, capture={}, keep=3, continues=True) as log:
        names = sorted(path.name for path in tmp_path.iterdir())
        assert names == [
            "x-0012.mcap", "x-10001.mcap", "x-10002.mcap", "x-old.mcap", "y-0001.mcap"
        ]  # fmt: skip
        assert log.path.name == "x-10002.mcap"


def test_a_file_that_only_has_the_name_of_a_part_is_never_removed(tmp_path: Path) -> None:
    LogWriter(tmp_path / "x-0007.mcap", capture={"part": "3"}).close()  # Renamed by its owner.
    (tmp_path / "x-0008.mcap").write_bytes(b"of another program")
    (tmp_path / "x-00001.mcap").write_bytes(b"a number that no part is written with")
    others = {path: path.read_bytes() for path in tmp_path.iterdir()}
    rotation = Rotation(time_ns=1)
    with RotatingLog(tmp_path / "x.mcap", rotation, capture={}, keep=2, continues=True) as log:
        for number in range(5):
            log.tick(number)
            log.write(chunk(number))
        assert log.path.name == "x-0013.mcap"
    assert {path: path.read_bytes() for path in others} == others
    assert sorted(path.name for path in tmp_path.iterdir() if path not in others) == [
        "x-0012.mcap", "x-0013.mcap"
    ]  # fmt: skip


def test_with_a_limit_files_of_others_stay(tmp_path: Path) -> None:
    (tmp_path / "x-0003.mcap").write_bytes(b"evidence")
    with pytest.raises(UsageError, match=r"x-0003\.mcap: the file exists"):
        RotatingLog(tmp_path / "x.mcap", Rotation(time_ns=1), capture={}, keep=2)
    assert [path.name for path in tmp_path.iterdir()] == ["x-0003.mcap"]


@pytest.mark.parametrize("replace", [False, True])
def test_a_series_that_is_written_is_not_begun_again(tmp_path: Path, replace: bool) -> None:
    with RotatingLog(tmp_path / "x.mcap", Rotation(time_ns=1), capture={}, keep=2) as log:
        for number in range(4):
            log.tick(number)
            log.write(chunk(number))
        assert not (tmp_path / "x-0001.mcap").exists()
        with pytest.raises((OutputError, UsageError)):
            RotatingLog(
                tmp_path / "x.mcap", Rotation(time_ns=1), capture={}, keep=2, replace=replace
            )
        assert not (tmp_path / "x-0001.mcap").exists()


def test_the_first_file_must_not_exist(tmp_path: Path) -> None:
    (tmp_path / "x-0001.mcap").write_bytes(b"evidence")
    with pytest.raises(UsageError, match="the file exists"):
        RotatingLog(tmp_path / "x.mcap", Rotation(size=1_000), capture={})


def test_files_around_a_trouble_are_kept_and_leave_the_series(tmp_path: Path) -> None:
    log = RotatingLog(tmp_path / "x.mcap", Rotation(size=1), capture={}, keep=3)
    for number in range(12):
        if number == 5:  # The sixth file is the present one, still empty.
            log.keep_around()
        log.write(chunk(number))
        log.tick(number * SECOND_NS)
    log.close()
    kept = [f"x-{number:04}-kept.mcap" for number in (5, 6, 7)]
    left = [f"x-{number:04}.mcap" for number in (11, 12, 13)]
    assert sorted(path.name for path in tmp_path.iterdir()) == [*kept, *left]
    assert [list(read_log(tmp_path / name)) for name in kept] == [
        [chunk(4)],
        [chunk(5)],
        [chunk(6)],
    ]
    again = RotatingLog(tmp_path / "x.mcap", Rotation(size=1), capture={}, keep=2, continues=True)
    again.close()
    assert {*kept} <= {path.name for path in tmp_path.iterdir()}


def test_kept_files_are_read_with_the_others_and_their_numbers_are_not_used_again(
    tmp_path: Path,
) -> None:
    log = RotatingLog(tmp_path / "x.mcap", Rotation(size=1), capture={}, keep=3)
    log.write(chunk(0))
    log.tick(SECOND_NS)
    log.keep_around()
    log.write(chunk(1))
    log.close()
    kept = [tmp_path / f"x-{number:04}-kept.mcap" for number in (1, 2)]
    assert with_parts([str(tmp_path / "x.mcap")]) == [str(path) for path in kept]
    again = RotatingLog(tmp_path / "x.mcap", Rotation(size=1), capture={}, keep=2, continues=True)
    assert again.number == 3
    again.keep_around()
    again.close()
    assert list(read_log(kept[1])) == [chunk(1)]
