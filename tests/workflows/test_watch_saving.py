"""Saving what is marked or filtered."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.core import EventKind, UsageError, WireEvent, parse_link
from mbtool.devices import Assignments
from mbtool.logs.opening import create_log
from mbtool.watching.watched import Watched
from mbtool.workflows.shared.reading import Reading
from mbtool.workflows.shared.reading_options import ReadingOptions
from mbtool.workflows.watch_saving import EvidenceSaver, FrameSaver, Saver
from tests.workflows.sick_line import LINE as LINK
from tests.workflows.sick_line import sick_line

if TYPE_CHECKING:
    from mbtool.devices import NamedTransaction

ROOT = Path(__file__).resolve().parents[2]
LINE = str(ROOT / "captures" / "ft1a-touch-line.mcap")
NET = str(ROOT / "captures" / "fa3-at1m8x-setup.pcap")


def read(path: str, *, raw: bool = False) -> list[NamedTransaction]:
    reading = Reading([path], ReadingOptions(raw=raw))
    return [one for one in reading.records() if not isinstance(one, WireEvent)]


def watched(path: str) -> Watched:
    model = Watched()
    for one in read(path):
        model.add(one)
    return model


def frames(transactions: list[NamedTransaction]) -> list[tuple[bytes | None, bytes | None]]:
    return [(one.request_raw, one.response_raw) for one in transactions]


@pytest.mark.parametrize("source", [LINE, NET])
@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
def test_marked_transactions_are_saved_from_the_evidence(
    source: str, suffix: str, tmp_path: Path
) -> None:
    model = watched(source)
    chosen = [one for one in model.whole.records if one.number in (2, 4)]
    for one in chosen:
        model.toggle_mark(one)
    saver = EvidenceSaver([source])
    assert saver.what(model, is_filtered=False) == "2 marked transactions"
    out = str(tmp_path / f"part{suffix}")
    assert saver.job(model, is_filtered=False, out=out)().endswith(f"-> {out}")
    assert frames(read(out)) == frames(read(source)[1:4:2])


def test_without_marks_the_filter_chooses_and_without_a_filter_all(tmp_path: Path) -> None:
    model = watched(LINE)
    model.set_filter(lambda one: one.function == 6)
    saver = EvidenceSaver([LINE])
    assert saver.what(model, is_filtered=True) == "what passes the filter"
    saver.job(model, is_filtered=True, out=str(tmp_path / "part.mcap"))()
    assert {one.function for one in read(str(tmp_path / "part.mcap"))} == {6}
    assert saver.what(model, is_filtered=False) == "everything"
    saver.job(model, is_filtered=False, out=str(tmp_path / "all.mcap"))()
    assert len(read(str(tmp_path / "all.mcap"))) == len(read(LINE))


@pytest.mark.parametrize(
    ("source", "link"),
    [(LINE, "rtu:/dev/{link}@19200-8E1"), (NET, "net:lo")],
)
@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
def test_without_a_log_the_frames_become_evidence_that_decodes_to_the_same(
    source: str, link: str, suffix: str, tmp_path: Path
) -> None:
    model = watched(source)
    spec = parse_link(link.format(link=read(source)[0].link))
    saver = FrameSaver(
        partial(create_log, links=[spec], assignments=Assignments(), ports=[502, 1502])
    )
    assert saver.what(model, is_filtered=False) == "the last transactions"
    assert saver.what(model, is_filtered=True) == "the last ones that pass"
    first = next(one for one in model.whole.records if one.number == 3)
    model.toggle_mark(first)
    assert saver.what(model, is_filtered=False) == "1 marked transaction"
    model.toggle_mark(first)
    out = str(tmp_path / f"part{suffix}")
    saver.job(model, is_filtered=False, out=out)()
    assert frames(read(out, raw=True)) == frames(read(source))


@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
@pytest.mark.parametrize("from_files", [False, True])
def test_marked_requests_keep_their_damaged_answers_and_no_fault_of_others(
    suffix: str, from_files: bool, tmp_path: Path
) -> None:
    source, out = str(sick_line(tmp_path / "sick.mcap", 24)), str(tmp_path / f"part{suffix}")
    model = Watched()
    for one in Reading([source], ReadingOptions()).records():
        model.add(one)
    saver: Saver = EvidenceSaver([source])
    if not from_files:
        saver = FrameSaver(
            partial(create_log, links=[LINK], assignments=Assignments(), ports=[502])
        )
    blamed = model.whole.blamed
    asked = [one for one in model.whole.records if not isinstance(one.record, WireEvent)]
    damaged = [one for one in asked if one.order in blamed][1:3]
    for kept in [*damaged, asked[-8]]:
        model.toggle_mark(kept)
    chosen = [one.record for one in model.marked.values() if not isinstance(one.record, WireEvent)]
    saver.job(model, is_filtered=False, out=out)()
    for raw in (False, True):
        records = list(Reading([out], ReadingOptions(raw=raw)).records())
        events = [one for one in records if isinstance(one, WireEvent)]
        assert [one.kind for one in events] == [EventKind.BAD_CHECK] * 2
        assert frames([one for one in records if not isinstance(one, WireEvent)]) == frames(chosen)


def test_a_name_of_another_format_is_refused(tmp_path: Path) -> None:
    job = EvidenceSaver([LINE]).job(watched(LINE), is_filtered=False, out=str(tmp_path / "x.txt"))
    with pytest.raises(UsageError, match=r"x\.txt: let it end in \.mcap, \.pcapng or \.pcap$"):
        job()


@pytest.mark.parametrize("suffix", [".mcap", ".pcapng"])
def test_a_file_that_exists_is_kept_and_another_name_asked_for(suffix: str, tmp_path: Path) -> None:
    out = tmp_path / f"x{suffix}"
    out.write_text("a file")
    begin = partial(create_log, links=[], assignments=Assignments(), ports=[], overwrite=True)
    for saver in (EvidenceSaver([LINE]), FrameSaver(begin)):
        job = saver.job(watched(LINE), is_filtered=False, out=str(out))
        with pytest.raises(UsageError, match=rf"x{suffix}: the file exists; name another$"):
            job()
    assert out.read_text() == "a file"
