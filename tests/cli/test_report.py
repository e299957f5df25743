from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from tests.cli.test_stats import LINE, NETWORK
from tests.columns.test_equality import poll
from tests.packets.building import Talk, pcap
from tests.views.report.pages import Page

if TYPE_CHECKING:
    from tests.cli.program import CommandLine


def test_the_page_is_written_and_said(mbtool: CommandLine, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    told = mbtool("report", LINE, "-o", out)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"11 transactions -> {out} ({out.stat().st_size / 1e6:.1f} MB)\n"
    assert Page(out.read_text()).document["stats"]["transactions"] == 11


def test_a_page_is_not_written_as_if_it_were_a_pdf(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("report", LINE, "-o", tmp_path / "r.pdf")
    assert told.code == exit_codes.USAGE
    assert f"the page is HTML: write -o {tmp_path / 'r.html'}; a browser" in told.err
    assert not list(tmp_path.iterdir())


def test_the_page_can_go_to_standard_output(mbtool: CommandLine) -> None:
    told = mbtool("report", LINE, "-o", "-")
    assert (told.code, told.err) == (exit_codes.DONE, "")
    assert Page(told.out).document["stats"]["transactions"] == 11


def test_findings_can_be_left_out(mbtool: CommandLine, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    mbtool("report", LINE, "-o", out, "--ignore", "FT1A")
    codes = {one["code"] for one in Page(out.read_text()).document["findings"]["rows"]}
    assert not any(code.startswith("FT1A") for code in codes)


def test_a_part_can_be_chosen(mbtool: CommandLine, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    mbtool("report", LINE, "-o", out, "--start", "0.2", "--end", "0.4")
    told = Page(out.read_text()).document
    rows = mbtool("decode", LINE, "--format", "jsonl", "--start", "0.2", "--end", "0.4").lines
    assert told["stats"]["transactions"] == len(rows) < 11
    assert len(told["transactions"]["rows"]) == len(rows)


def test_an_error_leaves_an_older_page_alone(mbtool: CommandLine, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    out.write_text("older")
    told = mbtool("report", tmp_path / "absent.pcap", "-o", out)
    assert (told.code, out.read_text()) == (exit_codes.UNREADABLE, "older")


def test_a_cut_capture_gives_a_page_and_an_error(
    mbtool: CommandLine, tmp_path: Path, capture: Path
) -> None:
    cut, out = tmp_path / "cut.pcap", tmp_path / "r.html"
    cut.write_bytes(capture.read_bytes()[:-5])
    told = mbtool("report", cut, "-o", out)
    assert told.code == exit_codes.UNREADABLE
    assert Page(out.read_text()).document["stats"]["transactions"] > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((LINE,), "Missing option '--output'"),
        ((LINE, NETWORK, "-o", "r.html", "--against", LINE), "--against goes with one FILE"),
        ((LINE, "-o", "r.html", "--against", NETWORK, "--end", "1"), "compares whole captures"),
        ((LINE, "-o", LINE), "is an input and would be overwritten"),
        ((LINE, "-o", "r.html", "--ignore", "XYZ"), "no code begins with 'XYZ'"),
    ],
)
def test_wrong_usage_is_one_line(
    mbtool: CommandLine,
    arguments: tuple[object, ...],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    told = mbtool("report", *arguments)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert said in told.err
    assert told.err.count("\n") == 1


def test_a_folder_gives_a_line_for_each_file_the_worst_first(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    folder, out = tmp_path / "captures", tmp_path / "r.html"
    folder.mkdir()
    talk = Talk()
    (folder / "a-well.pcap").write_bytes(pcap([*talk.handshake(), *poll(talk, 30)]))
    (folder / "b-line.mcap").write_bytes(Path(LINE).read_bytes())
    (folder / "c-plant.pcap").write_bytes(Path(NETWORK).read_bytes())
    (folder / "d-none.pcap").write_bytes(b"none")
    told = mbtool("report", folder, "-o", out, "--title", "Hall <3>", "--note", "One\nTwo")
    assert told.code == exit_codes.UNREADABLE
    assert told.err.splitlines()[0].startswith("4 files: 1 not read, ")
    page = out.read_text()
    names = re.findall(r'class="name"[^>]*>([^<]*)</td>', page)
    assert names[0] == "d-none.pcap"
    assert names[1] == "b-line.mcap"
    assert names[-1] == "a-well.pcap"
    assert "<title>Hall &lt;3&gt;</title>" in page
    assert "<p class=words>One</p><p class=words>Two</p>" in page
    assert mbtool("report", folder, "-o", out, "--all").code == exit_codes.USAGE


def test_a_page_of_a_folder_shows_no_text_as_markup(tmp_path: Path, mbtool: CommandLine) -> None:
    folder, out = tmp_path / "captures", tmp_path / "r.html"
    folder.mkdir()
    (folder / "<b>x.pcap").write_bytes(Path(NETWORK).read_bytes())
    assert mbtool("report", folder, "-o", out).code == exit_codes.DONE
    page = out.read_text()
    assert "&lt;b&gt;x.pcap" in page
    assert "<b>" not in page
    assert "<script" not in page


def test_a_page_can_be_about_chosen_transactions_with_words_of_ones_own(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    out = tmp_path / "r.html"
    words = ("--title", "Hall 3", "--note", "Look at </script> unit 1.")
    told = mbtool("report", LINE, "-o", out, "--where", "function == 3", *words)
    assert told.code == exit_codes.DONE
    document = Page(out.read_text()).document
    rows = mbtool("decode", LINE, "--format", "jsonl", "--where", "function == 3").lines
    assert document["stats"]["transactions"] == len(rows) < 11
    assert len(document["transactions"]["rows"]) == len(rows)
    assert document["words"] == {
        "title": "Hall 3", "note": "Look at </script> unit 1.", "where": "function == 3",
    }  # fmt: skip
