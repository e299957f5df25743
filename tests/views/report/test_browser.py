"""Shows pages in a browser without a window, and reads what they became."""

from __future__ import annotations

import re
from html import unescape
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.main import run
from mbtool.modbus import rtu_adu
from tests.views.report.browser import asked, shown, text_of
from tests.workflows.sick_line import sick_line

if TYPE_CHECKING:
    from pathlib import Path

HOSTILE = "</script><script>document.title='hacked'</script><b onclick=x>"

pytestmark = pytest.mark.peers


USE = """
const told = [], rows = () => [...document.querySelectorAll("#transactions tbody tr")];
const use = (name, act) => { act(); told.push([name, rows().length, rows()[0]?.id ?? ""]); };
setTimeout(() => {
  use("search", () => document.querySelector("#verdict button").click());
  use("finding", () => document.querySelector("#findings tbody button").click());
  const field = document.querySelector("#transactions input");
  const type = (text) => { field.value = text; field.dispatchEvent(new Event("input")); };
  use("slow", () => type("unit:2 ms>=180"));
  use("fast", () => type("ms<8.5 ms>0"));
  use("damaged", () => type("wrong CRC"));
  use("code", () => type("RTU-201"));
  location.hash = "#t7";
  setTimeout(() => {
    use("link", () => {});
    told.push(["here", document.querySelector("tr.here").id, document.activeElement.id]);
    const chart = document.querySelector("#latency figure");
    chart.focus();
    chart.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
    told.push(["chart", chart.querySelector("output").textContent]);
    const details = chart.querySelector("details");
    details.open = true;
    setTimeout(() => {
      told.push(["table", details.querySelectorAll("tbody tr").length]);
      const text = (what) => details.querySelector(what).textContent;
      told.push(["paper", text("button"), text("p.printed")]);
      dispatchEvent(new Event("beforeprint"));
      const units = new Set(rows().map((row) => row.children[2].textContent));
      const sentence = document.querySelector("#transactions p.printed").textContent;
      told.push(["printed", rows().length, [...units].sort().join(), sentence]);
      dispatchEvent(new Event("afterprint"));
      told.push(["screen", rows().length]);
      tell(told);
    }, 200);
  }, 200);
}, 3000);
"""

SENTENCE = (
    "On paper 40 transactions: some of each kind of those that failed or that the findings name, "
    "with the one before."
)


def test_links_searches_and_keys_lead_where_they_say(tmp_path: Path) -> None:
    log = sick_line(tmp_path / "sick.mcap", 40)
    out = tmp_path / "r.html"
    assert run(["report", str(log), "-o", str(out)]) == 0
    assert asked(out, tmp_path / "profile", USE) == [
        ["search", 40, "t15"],
        ["finding", 40, "t15"],
        ["slow", 40, "t2"],
        ["fast", 40, "t1"],
        ["damaged", 6, "t88"],
        ["code", 6, "t88"],
        ["link", 100, "t1"],
        ["here", "t7", "t7"],
        ["chart", "2023-11-14 22:13:20.000 UTC — unit 4: 9 ms, unit 2: 180 ms, unit 1: 8 ms"],
        ["table", 12],
        ["paper", "Show 8 more", "8 rows more on the screen."],
        ["printed", 40, "1,2,3,4", SENTENCE],
        ["screen", 100],
    ]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("browser")
    log = sick_line(folder / "sick <i>.mcap", 12, name=HOSTILE)
    assert run(["report", str(log), "-o", str(folder / "r.html")]) == 0
    return shown(folder / "r.html", folder / "profile")


def test_a_browser_shows_every_section_and_every_row(page: str) -> None:
    assert text_of(page, 'h1 id="sentence"').startswith("Unit 3 never answers (12 requests): ")
    sections = re.findall(r'<section id="(\w+)" data-name="[^"]+"( hidden="")?', page)
    assert {name for name, hidden in sections if hidden} == {"against"}
    assert len(re.findall(r'<tr role="row" id="t\d+"', page)) == 48
    assert page.count("<canvas") >= 6


def test_hostile_texts_do_nothing_in_a_browser(page: str) -> None:
    body = page.replace(text_of(page, 'script type="application/json" id="data"'), "")
    assert text_of(page, "title").startswith("mbtool report: ")
    assert not re.search(
        r"<(?:b|i) ?(?:onclick|>)", re.sub(r"<figcaption.*?</figcaption>", "", body)
    )
    assert body.count("<script") == 3
    assert HOSTILE in unescape(body)


def test_a_capture_too_short_for_charts_says_all_in_tables(tmp_path: Path) -> None:
    log = sick_line(tmp_path / "short.mcap", 1)
    out = tmp_path / "r.html"
    assert run(["report", str(log), "--end", "2023-11-14T22:13:20.1Z", "-o", str(out)]) == 0
    page = shown(out, tmp_path / "profile")
    assert page.count("<canvas") == 0
    assert "All answers of all units took about 8.0 ms." in page
    assert "No request failed." in page


def test_a_capture_without_times_has_none_in_its_table_and_tells_its_failures(
    tmp_path: Path,
) -> None:
    refused = rtu_adu(1, bytes.fromhex("03 0000 0002")) + rtu_adu(1, bytes.fromhex("83 02"))
    (tmp_path / "line.bin").write_bytes(refused * 20)
    out = tmp_path / "r.html"
    line = ["--link", "rtu@19200-8E1"]
    assert run(["report", str(tmp_path / "line.bin"), *line, "-o", str(out)]) == 0
    page = shown(out, tmp_path / "profile")
    table = text_of(page, 'section id="transactions"')
    assert "The capture has no times." in table
    assert "1970" not in table
    assert "02 illegal data address ×20" in text_of(page, 'section id="failures"')


def test_a_histogram_of_one_bar_tells_of_longer_answers(tmp_path: Path) -> None:
    log = sick_line(tmp_path / "short.mcap", 1)
    out = tmp_path / "r.html"
    assert run(["report", str(log), "--end", "2023-11-14T22:13:20.1Z", "-o", str(out)]) == 0
    text = out.read_text()
    assert text.count('"beyond":0') >= 1
    text = re.sub(r'"latency":\{"count":1,', '"latency":{"count":201,', text)
    text = re.sub(r'"max_ms":[\d.]+', '"max_ms":3000', text)
    text = re.sub(r'"min_ms":[\d.]+', '"min_ms":0.003', text)
    out.write_text(text.replace('"beyond":0', '"beyond":1'))
    page = shown(out, tmp_path / "profile")
    assert '">&lt;0.01</td>' in page
    assert "200 answers of all units took about 8.0 ms; 1 longer answer, up to 3000 ms." in page


PHONE = """
setTimeout(() => {
  const folds = () => [...document.querySelectorAll("section > details")].filter((one) => one.open);
  const opened = () => folds().map((one) => one.parentElement.id);
  const told = { narrow: innerWidth <= 640, first: opened() };
  const cut = (one) => one.getBoundingClientRect().right > innerWidth;
  told.menu = [...document.querySelectorAll("nav a")].filter(cut).length;
  told.drawn = charts.length;
  document.querySelector("nav a[href='#latency']").click();
  document.querySelector("#verdict button").click();
  setTimeout(() => {
    told.then = opened();
    dispatchEvent(new Event("beforeprint"));
    const folds = [...document.querySelectorAll("section:not([hidden]) > details")];
    told.foldedOnPaper = folds.filter((one) => !one.open).length;
    const shown = charts.filter((one) => one.root.isConnected);
    told.onPaper = [...new Set(shown.map((one) => one.width))].sort();
    dispatchEvent(new Event("afterprint"));
    told.after = opened();
    const kept = (id) => document.querySelectorAll(`#${id} tbody tr:not(.on-paper)`);
    told.cycle = kept("cycle").length;
    told.polls = [...kept("polls")].map((row) => row.firstChild.textContent);
    told.drawnThen = charts.length > 0;
    for (const fold of document.querySelectorAll("details")) fold.open = true;
    setTimeout(() => {
      const page = document.documentElement;
      told.overflow = page.scrollWidth - page.clientWidth;
      told.rows = document.querySelectorAll("#transactions tbody tr").length;
      tell(told);
    }, 500);
  }, 500);
}, 2000);
"""


def test_a_phone_folds_long_sections_and_nothing_is_wider_than_its_screen(tmp_path: Path) -> None:
    log = sick_line(tmp_path / "sick.mcap", 40, name=HOSTILE * 3)
    out = tmp_path / "r.html"
    assert run(["report", str(log), "-o", str(out)]) == 0
    out.write_text(out.read_text().replace("FEW_ROWS = narrow.matches ? 5 :", "FEW_ROWS = 2 ??"))
    assert asked(out, tmp_path / "profile", PHONE, width=400) == {
        "narrow": True,
        "first": ["findings"],
        "menu": 0,
        "drawn": 0,
        "then": ["findings", "latency", "transactions"],
        "foldedOnPaper": 0,
        "onPaper": [330, 690],
        "after": ["findings", "latency", "transactions"],
        "drawnThen": True,
        "cycle": 4,
        "polls": ["3 03 holding 0..1", "4 03 holding 0..1"],
        "overflow": 0,
        "rows": 25,
    }
