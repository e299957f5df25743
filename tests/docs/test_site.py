"""The site: every page is in its navigation, its pictures are what the program prints."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mbtool.version import __version__
from tests.docs import pictures
from tests.docs.man_page import man_page
from tests.docs.searching import found
from tests.docs.site import OTHERS, SITE

ROOT = Path(__file__).parents[2]
SETTINGS = (ROOT / "docs" / "mkdocs.yml").read_text()
ZENSICAL = Path(sys.executable).with_name("zensical")


def test_the_citation_names_the_version() -> None:
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_every_page_is_in_the_navigation() -> None:
    shown = re.findall(r": ([\w/.-]+\.md)$", SETTINGS, re.MULTILINE)
    pages = {str(path.relative_to(ROOT / "docs")) for path in ROOT.glob("docs/**/*.md")}
    assert sorted(shown) == sorted(pages | set(OTHERS.values()))


@pytest.mark.skipif(not ZENSICAL.exists(), reason="zensical is not installed: make docs")
def test_the_site_builds_without_a_dead_link_or_a_load_from_a_network_and_can_be_searched(
    tmp_path: Path,
) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "tests.docs.site"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    for from_disk in (True, False):
        folder = tmp_path / str(from_disk)
        protocol, result = found(SITE, folder, "anonymous", from_disk=from_disk)
        assert protocol == ("file:" if from_disk else "http:")
        assert "A copy that does not show the plant" in result


def test_the_picture_of_a_plant_shows_what_was_never_recorded() -> None:
    words = re.sub(r"<[^>]*>|&#160;", " ", (pictures.FOLDER / "site.svg").read_text())
    text = " ".join(words.split())
    assert "10.0.0.12: 3 different requests to units 1, 2 on tcp:127.0.0.12:1502" in text
    assert "unrecorded: the request above was never recorded" in text
    assert "never recorded of 10.0.0.11: unit 1 03 holding 200 (1 time)" in text


def test_the_picture_of_decode_is_its_output() -> None:
    assert (pictures.FOLDER / "decode.svg").read_text() == pictures.decode_picture()


def test_the_picture_of_watch_is_a_frame_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("NO_COLOR", raising=False)
    picture = asyncio.run(pictures.watch_picture())
    assert (pictures.FOLDER / "watch.svg").read_text() == picture


def test_no_picture_loads_anything() -> None:
    for path in pictures.FOLDER.glob("*.svg"):
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http" not in text, path


def test_the_manual_page_has_each_command_that_help_lists_as_it_is_typed() -> None:
    page = man_page()
    assert "\n.SS mbtool devices import\n" in page
    assert "devices show" not in page
    assert "\n.B mbtool devices\n[NAME]\n" in page
    assert "\n    mbtool decode " in page
