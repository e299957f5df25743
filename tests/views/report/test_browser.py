"""Shows pages in a browser without a window, and reads what they became."""

from __future__ import annotations

import re
import shutil
import subprocess
from html import unescape
from typing import TYPE_CHECKING

import pytest

from mbtool.cli.main import run
from tests.workflows.sick_line import sick_line

if TYPE_CHECKING:
    from pathlib import Path

PATIENCE_S = 120
HOSTILE = "</script><script>document.title='hacked'</script><b onclick=x>"

pytestmark = pytest.mark.peers


def shown(page: Path, folder: Path) -> str:
    """The page's markup after its script has run."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs chromium: apt-get install chromium")
    done = subprocess.run(
        [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1400,20000",
            f"--user-data-dir={folder}", "--virtual-time-budget=10000", "--enable-logging=stderr",
            "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=PATIENCE_S, check=True,
    )  # fmt: skip
    assert "Uncaught" not in done.stderr
    assert "Content Security Policy" not in done.stderr
    return done.stdout


def text_of(markup: str, element: str) -> str:
    match = re.search(rf"<{element}[^>]*>(.*?)</{element.split()[0]}>", markup, re.DOTALL)
    assert match is not None, element
    return unescape(re.sub(r"<[^>]+>", "", match[1]))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("browser")
    log = sick_line(folder / "sick <i>.mcap", 12, name=HOSTILE)
    assert run(["report", str(log), "-o", str(folder / "r.html")]) == 0
    return shown(folder / "r.html", folder / "profile")


def test_a_browser_shows_every_section_and_every_row(page: str) -> None:
    assert text_of(page, 'h1 id="sentence"').startswith("Unit 3 never answers (12 requests); ")
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
