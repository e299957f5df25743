"""Recordings of every kind, read back."""

from __future__ import annotations

import gzip
import io
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
import zstandard

from mbtool.core import (
    CutError,
    DamageError,
    EventKind,
    InputError,
    UsageError,
    WireEvent,
    parse_line,
)
from mbtool.decode.decoder import Decoder
from mbtool.devices import Assignments, NamedTransaction, Namer, parse_assignment, profile_to_json
from mbtool.logs import LogWriter
from mbtool.logs.layout import Opcode
from mbtool.workflows.shared.log_records import followed
from mbtool.workflows.shared.reading import Reading, ReadingOptions
from tests.logs.samples import changed, records_of
from tests.packets.building import Pcapng, packet, pcap
from tests.records import without_origins
from tests.workflows.evidence import (
    LINE,
    READ,
    REFUSED,
    capture_file,
    captured,
    damaged,
    damaged_log,
    exchange,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mbtool.core import LineSettings
    from mbtool.decode.decoder import Record


def _devices(*texts: str) -> Assignments:
    return Assignments([parse_assignment(text) for text in texts])


def _read(path: Path, **options: object) -> list[Record]:
    reading = Reading([str(path)], ReadingOptions(**options))  # type: ignore[arg-type]
    return without_origins(reading.records())


def _transactions(records: list[Record]) -> list[NamedTransaction]:
    return [record for record in records if not isinstance(record, WireEvent)]


def _serial_log(path: Path, *devices: str, baud: str = "19200-8E1") -> Path:
    """A log of two exchanges on a serial line, decoded with these devices."""
    assignments = _devices(*devices)
    decoder = Decoder(Namer(assignments), lines={LINE.name: LINE})
    with LogWriter(path, capture={"host": "bench"}) as log:
        log.add_link(LINE.name, {"spec": f"rtu:/dev/rs485@{baud}"})
        for one in assignments:
            log.add_device(str(one.who), one.profile.name)
            log.add_profile(one.profile.name, profile_to_json(one.profile))
        for chunk in [*exchange(0), *exchange(100, READ, REFUSED)]:
            log.write(chunk)
            for record in decoder.feed(chunk):
                log.write(record)
        for record in decoder.close():
            log.write(record)
    return path


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zstandard.compress])
def test_reads_a_capture_plain_and_packed(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "capture"
    path.write_bytes(pack(capture_file(3)))
    records = _read(path)
    assert [one.response_values for one in _transactions(records)] == [[0x1234, 0x5678]] * 3


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zstandard.compress])
def test_reads_a_log_plain_and_packed(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    plain = _serial_log(tmp_path / "plain.mcap")
    packed = tmp_path / "packed"
    packed.write_bytes(pack(plain.read_bytes()))
    assert len(_read(packed)) == 2
    assert _read(packed) == _read(plain)
    assert _read(packed, raw=True) == _read(plain)


def test_several_captures_are_parts_of_one(tmp_path: Path) -> None:
    packets = captured(3)
    paths = [tmp_path / "a.pcap", tmp_path / "b.pcap"]
    # The first part ends between a request and its response.
    paths[0].write_bytes(pcap(packets[:4]))
    paths[1].write_bytes(pcap(packets[4:]))
    records = list(Reading([str(path) for path in paths], ReadingOptions()).records())
    whole = tmp_path / "whole.pcap"
    whole.write_bytes(capture_file(3))
    assert without_origins(records) == _read(whole)
    assert all(one.latency_ns is not None for one in _transactions(records))


def test_ports_say_what_is_modbus(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file())
    assert _read(path, ports=(1502,)) == []
    assert len(_transactions(_read(path, ports=(1502, 502)))) == 3


def test_a_log_is_decoded_afresh_by_what_it_says_of_its_links_and_devices(tmp_path: Path) -> None:
    path = _serial_log(tmp_path / "a.mcap", "1=idec-ft1a-touch")
    raw = _read(path, raw=True)
    assert raw == _read(path)
    assert {one.device for one in _transactions(raw)} == {"idec-ft1a-touch"}


@pytest.mark.parametrize("raw", [False, True])
def test_a_given_profile_takes_the_place_of_the_logs(tmp_path: Path, raw: bool) -> None:
    path = _serial_log(tmp_path / "a.mcap", "1=idec-ft1a-touch")
    records = _transactions(_read(path, raw=raw, assignments=_devices("1=fa3-at1m8x")))
    assert {one.device for one in records} == {"fa3-at1m8x"}
    assert records[0].reference == "RWw0..RWw1"


@pytest.mark.parametrize("raw", [False, True])
def test_a_profile_given_for_others_leaves_the_logs_own(tmp_path: Path, raw: bool) -> None:
    path = _serial_log(tmp_path / "a.mcap", "1=idec-ft1a-touch")
    records = _transactions(_read(path, raw=raw, assignments=_devices("9=fa3-at1m8x")))
    assert {one.device for one in records} == {"idec-ft1a-touch"}


def test_the_profiles_in_use_are_known_while_a_log_is_read(tmp_path: Path) -> None:
    reading = Reading(
        [str(_serial_log(tmp_path / "a.mcap", "1=idec-ft1a-touch"))], ReadingOptions()
    )
    one = next(reading.records())
    assert isinstance(one, NamedTransaction)
    profile = reading.assignments.profile_for(one)
    assert profile is not None
    assert profile.name == "idec-ft1a-touch"


@pytest.mark.parametrize("raw", [False, True])
def test_a_log_with_a_profile_from_elsewhere_is_read_or_refused(tmp_path: Path, raw: bool) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}) as log:
        log.add_device("1", "new")
        log.add_profile("new", b'{"name": "new", "colour": "red"}')
        for chunk in exchange(0):
            log.write(chunk)
    if raw:
        with pytest.raises(UsageError, match="profile new"):
            _read(path, raw=True)
    else:
        assert _read(path) == []


def test_a_log_with_senseless_ports_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}) as log:
        log.add_link("eth0", {"spec": "net:eth0", "ports": "x 502 99999999999", "rtu_ports": "-1"})
        for packet in captured(2):
            log.write(packet)
    assert len(_transactions(_read(path, raw=True))) == 2


def test_a_log_with_a_link_of_another_version_gives_what_was_decoded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    records = _transactions(_read(_serial_log(tmp_path / "b.mcap")))
    with LogWriter(path, capture={}) as log:
        log.add_link(LINE.name, {"spec": "subspace:7@warp"})
        for record in records:
            log.write(record)
    assert _read(path) == records != []


def test_a_cut_capture_gives_all_before_the_cut(tmp_path: Path) -> None:
    whole = capture_file(3)
    path = tmp_path / "cut.pcap"
    # In the last packet: two of the goodbye's three are whole.
    path.write_bytes(whole[:-1])
    records: list[Record] = []
    with pytest.raises(CutError, match=r"cut\.pcap"):
        records.extend(Reading([str(path)], ReadingOptions()).records())
    assert len(_transactions(records)) == 3


def test_a_request_before_a_cut_has_an_answer_that_is_not_captured(tmp_path: Path) -> None:
    whole = pcap(captured(1)[:5])
    path = tmp_path / "cut.pcap"
    path.write_bytes(whole[:-3])
    records: list[Record] = []
    with pytest.raises(CutError):
        records.extend(Reading([str(path)], ReadingOptions()).records())
    assert [one.outcome.value for one in _transactions(records)] == ["not-captured"]


@pytest.mark.parametrize("raw", [False, True])
def test_a_cut_log_gives_all_before_the_cut(tmp_path: Path, raw: bool) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}) as log:
        log.add_link(LINE.name, {"spec": str(LINE)})
        for at_ms in range(0, 1000, 100):
            for chunk in exchange(at_ms):
                log.write(chunk)
            log.write(_read_of(tmp_path))
            log.tick(at_ms * 10_000_000)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    records: list[Record] = []
    with pytest.raises(CutError):
        records.extend(Reading([str(path)], ReadingOptions(raw=raw)).records())
    assert 1 <= len(_transactions(records)) < 10


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("raw", [False, True])
def test_a_damaged_log_gives_all_that_is_whole_and_says_where_some_is_missing(
    tmp_path: Path, number: int, raw: bool
) -> None:
    path = damaged_log(tmp_path / "a.mcap", number)
    records: list[Record] = []
    with pytest.raises(DamageError, match=r"damaged at byte \d+: .* all else was read"):
        records.extend(Reading([str(path)], ReadingOptions(raw=raw)).records())
    assert [one.outcome.value for one in _transactions(records)] == ["ok", "ok"]
    (hole,) = (record for record in records if isinstance(record, WireEvent))
    assert hole.kind is EventKind.GAP
    assert "are damaged and left out" in hole.message
    assert records.index(hole) == number


def test_a_request_is_not_joined_to_a_response_behind_damage(tmp_path: Path) -> None:
    first, second = exchange(0), exchange(1000)
    path = damaged(tmp_path / "a.mcap", [first[:1], [first[1], second[0]], second[1:]], 1)
    records: list[Record] = []
    with pytest.raises(DamageError):
        records.extend(Reading([str(path)], ReadingOptions(raw=True)).records())
    assert [getattr(one, "outcome", None) or one.kind for one in records] == [  # type: ignore[union-attr]
        "not-captured", "gap", "not-captured",
    ]  # fmt: skip


@pytest.mark.parametrize("raw", [False, True])
def test_a_log_whose_profile_is_damaged_is_read_as_without_it(tmp_path: Path, raw: bool) -> None:
    path = _serial_log(tmp_path / "a.mcap", "1=idec-ft1a-touch")
    data = path.read_bytes()
    ((offset, size),) = records_of(data, Opcode.ATTACHMENT)
    path.write_bytes(changed(data, offset + 9 + size // 2))
    records: list[Record] = []
    with pytest.raises(DamageError, match=r"an attachment whose CRC is wrong; .* all else"):
        records.extend(Reading([str(path)], ReadingOptions(raw=raw)).records())
    assert len(_transactions(records)) == len(records) == 2
    assert {one.device for one in _transactions(records)} == {None if raw else "idec-ft1a-touch"}


def _read_of(tmp_path: Path) -> NamedTransaction:
    path = tmp_path / "one.pcap"
    path.write_bytes(capture_file(1))
    return _transactions(_read(path))[0]


def test_the_parts_after_an_absent_file_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(1))
    reading = Reading([str(path), str(tmp_path / "absent"), str(path)], ReadingOptions())
    records: list[Record] = []
    with pytest.raises(InputError, match="absent: there is no such file"):
        records.extend(reading.records())
    assert len(_transactions(records)) == 1


def test_files_that_cannot_be_read_stop_no_other_and_are_told_at_the_end(tmp_path: Path) -> None:
    good, text, cut, foreign = (tmp_path / name for name in ("good", "text", "cut", "foreign"))
    good.write_bytes(capture_file(3))
    text.write_bytes(b"hello\n")
    cut.write_bytes(capture_file(2)[:-3])
    foreign.write_bytes(capture_file(1))
    paths = [str(one) for one in (text, good, tmp_path / "absent", cut, foreign)]
    reading = Reading(paths, ReadingOptions())
    reading.demand_files()
    records: list[Record] = []
    with pytest.raises(CutError):
        records.extend(reading.records())
    assert len(_transactions(records)) == 6
    heading, *rows = reading.remarks[-6:]
    assert heading.split() == ["file", "transactions", "events"]
    told = [row.removeprefix(str(tmp_path)).split(maxsplit=3) for row in rows]
    assert [[one[0][1:], one[1], " ".join(one[3:])[:12]] for one in told] == [
        ["text", "0", "not read: a "],
        ["good", "3", ""],
        ["absent", "0", "not read: th"],
        ["cut", "2", "read in part"],
        ["foreign", "1", ""],
    ]


def test_if_no_file_can_be_read_the_first_error_is_raised_at_once(tmp_path: Path) -> None:
    paths = [str(tmp_path / "absent"), str(tmp_path / "too")]
    with pytest.raises(InputError, match="absent: there is no such file"):
        Reading(paths, ReadingOptions()).demand_files()


def test_says_how_far_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(3))
    reading = Reading([str(path), str(path)], ReadingOptions())
    assert reading.fraction == 0.0
    fractions = [reading.fraction or 0.0 for _ in reading.records()]
    assert fractions == sorted(fractions)
    assert 0 < fractions[0] <= 0.5
    assert 0.5 < fractions[-1] <= 1


@pytest.mark.parametrize(
    ("data", "ports", "why"),
    [
        (pcap([]), (), "a.pcap: empty; there is neither a packet nor a transaction in it"),
        (
            capture_file(),
            (1502, 4001),
            "a.pcap: no Modbus at TCP port 1502, 4001; --port any looks at all ports, --port N "
            "and for RTU over TCP --rtu-port N at some",
        ),
        (capture_file(), (), None),
    ],
)
def test_says_why_nothing_came(
    tmp_path: Path, data: bytes, ports: tuple[int, ...], why: str | None
) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(data)
    reading = Reading([str(path)], ReadingOptions(ports=ports))
    assert reading.why_empty is None
    list(reading.records())
    assert reading.why_empty == (f"{tmp_path}/{why}" if why is not None else None)


def test_says_that_nothing_came_from_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(pcap([]))))
    reading = Reading(["-"], ReadingOptions())
    assert list(reading.records()) == []
    assert reading.why_empty is not None
    assert reading.why_empty.startswith("standard input: empty;")


@pytest.mark.parametrize("ways", [(0, 0), (0, 1)], ids=["both hear all", "each hears one way"])
def test_the_interfaces_of_a_file_hear_one_network(tmp_path: Path, ways: tuple[int, int]) -> None:
    make = Pcapng()
    heard = []
    for each in captured():
        is_request = each.data[26:30] == bytes([10, 0, 0, 1])
        numbers = (0, 1) if ways == (0, 0) else (ways[is_request],)
        heard += [make.enhanced(each.data, each.ts_ns // 1000, number) for number in numbers]
    interfaces = make.interface(options={2: b"eth0"}) + make.interface(options={2: b"eth1"})
    path = tmp_path / "two.pcapng"
    path.write_bytes(make.section() + interfaces + b"".join(heard))
    one = tmp_path / "one.pcap"
    one.write_bytes(capture_file())
    assert _read(path) == _read(one)


def test_the_interfaces_of_a_log_are_apart_unless_they_are_one_link(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}) as log:
        for name in ("eth0", "eth1", "eth2+eth3"):
            log.add_link(name, {"spec": f"net:{name.replace('+', ',')}"})
        for each in captured(1):
            for link in ("eth0", "eth1", "eth2+eth3", "eth2+eth3"):
                log.write(replace(each, link=link))
    assert len(_transactions(_read(path, raw=True))) == 3


class _Growing:
    """A log that gets one exchange more each time a reader waits, and is closed at last."""

    def __init__(self, path: Path, rounds: int, *, closes: bool) -> None:
        self._log = LogWriter(path, capture={})
        self._rounds = rounds
        self._closes = closes
        self._now_ns = 0
        self.waited = 0

    def wait(self) -> bool:
        if self.waited == self._rounds:
            if not self._closes:
                return False
            self._log.close()
            return True
        self.waited += 1
        decoder = Decoder(Namer(), lines={LINE.name: LINE})
        for chunk in exchange(self.waited * 100):
            self._log.write(chunk)
            decoder.feed(chunk)
        for record in decoder.close():
            self._log.write(record)
        self._now_ns += 1_000_000_000
        self._log.tick(self._now_ns)
        return True

    def close(self) -> None:
        self._log.close()


@pytest.mark.parametrize("closes", [True, False])
def test_follows_a_log_until_it_is_closed_or_nobody_waits(tmp_path: Path, closes: bool) -> None:
    path = tmp_path / "a.mcap"
    growing = _Growing(path, 3, closes=closes)
    records = list(followed(str(path), Assignments(), growing.wait))
    growing.close()
    assert len(records) == 3


def test_follows_in_the_words_of_a_given_profile(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    growing = _Growing(path, 1, closes=True)
    options = ReadingOptions(assignments=_devices("1=idec-ft1a-touch"))
    (one,) = followed(str(path), options.assignments, growing.wait)
    assert isinstance(one, NamedTransaction)
    assert one.reference == "HR400001..400002"


def _never() -> bool:
    raise AssertionError("there is nothing to wait for")


def test_only_a_log_on_disk_can_be_followed(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file())
    packed = tmp_path / "a.mcap.gz"
    packed.write_bytes(gzip.compress(_serial_log(tmp_path / "a.mcap").read_bytes()))
    with pytest.raises(UsageError, match=r"a\.pcap: not a log"):
        next(followed(str(path), Assignments(), _never))
    with pytest.raises(UsageError, match="name the log"):
        next(followed("-", Assignments(), _never))
    with pytest.raises(UsageError, match=r"a\.mcap\.gz: not a log \(\.mcap\); only a plain one"):
        next(followed(str(packed), Assignments(), _never))


def test_events_of_a_log_come_in_their_place(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    event = WireEvent(ts_ns=1, link=LINE.name, kind=EventKind.GAP, message="gap", missing=3)
    with LogWriter(path, capture={}) as log:
        log.write(event)
    assert _read(path) == [event]


def test_a_reading_that_is_left_early_closes_its_file(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(3))
    reading = Reading([str(path)], ReadingOptions())
    records = reading.records()
    next(records)
    assert reading.fraction is not None
    del records
    assert reading.fraction is None


RTU = parse_line("rtu@19200-8E1")
_BUS = b"".join(chunk.data for chunk in [*exchange(0), *exchange(100, READ, REFUSED)])
_TIMES = "t_start_s,t_end_s,line,byte_hex\n" + "".join(
    f"{number * 11 / 19200 + (0.01 if number >= 8 else 0):.7f},"
    f"{(number * 11 + 8) / 19200 + (0.01 if number >= 8 else 0):.7f},rx,{byte:02x}\n"
    for number, byte in enumerate(b"".join(chunk.data for chunk in exchange(0)))
)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, zstandard.compress])
@pytest.mark.parametrize("content", [_BUS, _BUS.hex(" ").encode()])
def test_reads_the_bytes_of_a_line_that_the_user_names(
    tmp_path: Path, pack: Callable[[bytes], bytes], content: bytes
) -> None:
    path = tmp_path / "bench.bin"
    path.write_bytes(pack(content))
    good, refused = _transactions(_read(path, line=RTU))
    assert (good.link, good.response_values) == ("bench", [0x1234, 0x5678])
    assert refused.exception == 2
    if content is _BUS:
        with pytest.raises(InputError, match="--link rtu@19200-8E1"):
            _read(path)


def test_reads_byte_times_with_what_they_show_of_the_line(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    path.write_text(_TIMES)
    (one,) = _transactions(_read(path))
    assert one.response_values == [0x1234, 0x5678]
    assert one.latency_ns == pytest.approx(10_000_000, abs=1000)
    assert one.start_ns == pytest.approx(8 * 11 * 1_000_000_000 // 19200, abs=1000)


def test_each_file_of_bytes_is_a_line_of_its_own(tmp_path: Path) -> None:
    request, response = (chunk.data for chunk in exchange(0))
    paths = [tmp_path / "a" / "bench.bin", tmp_path / "b" / "bench.bin"]
    for path, data in zip(paths, (request, response), strict=True):
        path.parent.mkdir()
        path.write_bytes(data)
    options = ReadingOptions(line=RTU)
    found = _transactions(list(Reading([str(path) for path in paths], options).records()))
    assert [one.outcome for one in found] == ["not-captured"] * 2


@pytest.mark.parametrize(
    ("text", "row"), [(_TIMES + "0.2,0.3,rx,zz\n", 19), (_TIMES + "0.2,0.3\n", 19)]
)
def test_what_comes_before_a_wrong_row_is_given(tmp_path: Path, text: str, row: int) -> None:
    path = tmp_path / "bench.csv"
    path.write_text(text)
    records: list[Record] = []
    with pytest.raises(InputError, match=f"row {row}: "):
        records.extend(Reading([str(path)], ReadingOptions()).records())
    assert len(_transactions(records)) == 1


def test_a_cut_packed_file_of_bytes_gives_what_comes_before(tmp_path: Path) -> None:
    path = tmp_path / "bench.bin.gz"
    path.write_bytes(gzip.compress(_BUS)[:-8])
    records: list[Record] = []
    with pytest.raises(CutError, match="the compressed stream ends"):
        records.extend(Reading([str(path)], ReadingOptions(line=RTU)).records())
    assert len(_transactions(records)) == 2


def _packed(exchanges: int, link_type: int = 147) -> bytes:
    """Exchanges a second apart, of which the response comes 20 ms after the request."""
    chunks = [chunk for number in range(exchanges) for chunk in exchange(1000 * number)]
    return pcap([packet(chunk.data, chunk.ts_ns, link_type=link_type) for chunk in chunks])


def test_says_as_what_line_serial_bytes_are_taken_and_doubts_a_wrong_rate(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(_packed(1))
    taken = f"{path}: taken as 19200-8E1; name the line with --link rtu@19200-8E1"
    doubt = f"{path}: 1 of 2 packets overlap at 300 baud: is the rate right?"
    slow = parse_line("rtu@300")
    for line, remarks in ((None, [taken]), (RTU, []), (slow, [doubt])):
        reading = Reading([str(path)], ReadingOptions(line=line))
        assert len(_transactions(list(reading.records()))) == 1
        assert reading.remarks == remarks


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", RTU),
        (b"# nothing\n", RTU),
        (b"t_start_s,t_end_s,byte_hex\n", None),
        (pcap([packet(b"", 1000, link_type=147)]), None),
        (pcap([packet(b"", 1000, link_type=147)]), RTU),
        (pcap([packet(bytes(12), 0, link_type=250)]), None),
        (pcap([packet(b"", 1000, link_type=150)]), RTU),
    ],
)
@pytest.mark.parametrize("any_port", [False, True])
def test_without_a_byte_of_a_line_there_is_no_talk_of_networks_nor_of_baud_rates(
    tmp_path: Path, content: bytes, line: LineSettings | None, any_port: bool
) -> None:
    path = tmp_path / "a"
    path.write_bytes(content)
    reading = Reading([str(path)], ReadingOptions(line=line, any_port=any_port))
    assert list(reading.records()) == []
    assert reading.why_empty == f"{path}: no byte of a serial line in it"
    assert reading.remarks == []


def test_beside_packets_of_a_network_other_ports_are_worth_a_try(tmp_path: Path) -> None:
    one, other = tmp_path / "serial.pcap", tmp_path / "network.pcap"
    one.write_bytes(pcap([packet(b"", 1000, link_type=147)]))
    other.write_bytes(capture_file())
    reading = Reading([str(one), str(other)], ReadingOptions(ports=(1502,)))
    assert list(reading.records()) == []
    assert (reading.why_empty or "").startswith(f"{one}, {other}: no Modbus at TCP port 1502; ")


def test_as_what_line_is_said_once_for_all_files(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a", "b", "c")]
    for path in paths:
        path.write_bytes(_packed(1))
    reading = Reading([str(path) for path in paths], ReadingOptions())
    list(reading.records())
    taken = [remark for remark in reading.remarks if "taken as" in remark]
    assert [one.partition(";")[0] for one in taken] == [
        f"{paths[0]} and 2 more: taken as 19200-8E1"
    ]


def test_options_without_effect_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(1))
    reading = Reading([str(path)], ReadingOptions(raw=True, line=parse_line("rtu@19200-8E1")))
    list(reading.records())
    assert reading.remarks == [
        "--raw has no effect: it is for logs (.mcap), and there is none",
        "--link has no effect: these are packets of a network",
    ]


def test_a_packet_capture_needs_no_remark(tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file())
    reading = Reading([str(path)], ReadingOptions())
    list(reading.records())
    assert reading.remarks == []


@pytest.mark.parametrize("raw", [False, True])
def test_says_where_a_log_ends_that_was_not_closed(tmp_path: Path, raw: bool) -> None:
    path, killed = _serial_log(tmp_path / "a.mcap"), tmp_path / "killed.mcap"
    growing = _Growing(killed, 2, closes=True)
    for _ in range(2):
        growing.wait()
    growing_copy = tmp_path / "copy.mcap"
    growing_copy.write_bytes(killed.read_bytes())
    growing.close()
    for one, remarks in (
        (path, []),
        (killed, []),
        (growing_copy, [f"{growing_copy}: was not closed; it ends at 2023-11-14 22:13:20.220 UTC"]),
    ):
        reading = Reading([str(one)], ReadingOptions(raw=raw))
        assert _transactions(list(reading.records()))
        assert reading.remarks == remarks


def _killed_late(path: Path) -> Path:
    """A log of three exchanges whose recorder was killed before it had decoded the last one."""
    decoder = Decoder(Namer(Assignments()), lines={LINE.name: LINE})
    with LogWriter(path.with_name("open.mcap"), capture={"host": "bench"}) as log:
        log.add_link(LINE.name, {"spec": "rtu:/dev/rs485@19200-8E1"})
        for chunk in [*exchange(0), *exchange(100)]:
            log.write(chunk)
            for record in decoder.feed(chunk):
                log.write(record)
        for chunk in exchange(200):
            log.write(chunk)
        log.tick(0)
        log.tick(10**10)
        path.write_bytes(path.with_name("open.mcap").read_bytes())
    return path


def test_the_last_moments_of_a_log_that_was_not_closed_are_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _killed_late(tmp_path / "killed.mcap")
    reading = Reading([str(path)], ReadingOptions())
    assert len(_transactions(list(reading.records()))) == 3
    (remark,) = reading.remarks
    assert remark.endswith(" UTC; it is decoded again, for its last moments")
    monkeypatch.setattr("mbtool.workflows.shared.undecoded_logs.MAX_LOOKED_THROUGH", 1)
    too_large = Reading([str(path)], ReadingOptions())
    assert len(_transactions(list(too_large.records()))) < 3
    (remark,) = too_large.remarks
    assert remark.endswith(" UTC; --raw also decodes its last moments")
    packed = path.with_suffix(".gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert len(_transactions(_read(packed))) < 3


def test_an_empty_log_that_was_not_closed_holds_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with LogWriter(path, capture={}):
        copy = tmp_path / "copy.mcap"
        copy.write_bytes(path.read_bytes())
    reading = Reading([str(copy)], ReadingOptions())
    assert list(reading.records()) == []
    assert reading.remarks == [f"{copy}: was not closed; it holds nothing"]


@pytest.mark.parametrize("raw", [False, True])
def test_a_log_knows_its_lines(tmp_path: Path, raw: bool) -> None:
    path = _serial_log(tmp_path / "a.mcap")
    reading = Reading([str(path)], ReadingOptions(line=RTU, raw=raw))
    for look in (reading.demand_files, lambda: list(reading.records())):
        with pytest.raises(UsageError, match=r"--link is not for a log.*--raw with --t3-5"):
            look()
