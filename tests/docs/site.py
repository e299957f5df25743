"""Builds the documentation site: python -m tests.docs.site, or make docs; the result is build/site.

Copies docs/ and the pages of the repository's root to build/pages, as zensical takes pages from one
folder only, and lets zensical build them; its warnings are errors (docs/mkdocs.yml: strict).
Afterwards it looks through the result: no link may be dead, and nothing may be loaded from a
network.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "build" / "pages"
SITE = ROOT / "build" / "site"
OTHERS = {
    "CHANGELOG.md": "changelog.md",
    ".github/CODE_OF_CONDUCT.md": "conduct.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    ".github/SECURITY.md": "security.md",
    "captures/README.md": "captures.md",
}
"""Pages outside docs/, and their names in the site."""
_LINK = re.compile(r"(?<=\]\()(?P<path>[^)#\s:]+)(?=[)#])")
_LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src"}
_BOX = re.compile(r"<pre(?=[^>]*>(?:<span></span>)?<code)")
_NAME = re.compile(r"<code>(?=[^<\s]{1,24}</code>)")
_FOREIGN_SHIM = "https://unpkg.com/iframe-worker/shim"
"""The script by which zensical's plugin `offline` lets a page on disk search; it would come from a
network."""
_ORDER = re.compile(r"^<!-- console: .*? -->\n", re.MULTILINE | re.DOTALL)


def assemble() -> None:
    """Copy all pages to one folder, with their links to each other put right."""
    shutil.rmtree(PAGES, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES)
    shutil.move(PAGES / "mkdocs.yml", PAGES.parent / "mkdocs.yml")
    for source, name in OTHERS.items():
        shutil.copyfile(ROOT / source, PAGES / name)
    for page in PAGES.rglob("*.md"):
        name = page.relative_to(PAGES).as_posix()
        origin = next((ROOT / key for key, value in OTHERS.items() if value == name), None)
        origin = origin or ROOT / "docs" / name
        page.write_text(_for_the_site(page.read_text(), origin, page))


def _for_the_site(text: str, origin: Path, page: Path) -> str:
    def moved(link: re.Match[str]) -> str:
        target = (origin.parent / link["path"]).resolve()
        path = target.relative_to(ROOT).as_posix() if target.is_relative_to(ROOT) else ""
        if path in OTHERS:
            return os.path.relpath(PAGES / OTHERS[path], page.parent)
        if path.startswith("docs/"):
            return os.path.relpath(PAGES / path.removeprefix("docs/"), page.parent)
        return link["path"]

    return _ORDER.sub("", _LINK.sub(moved, text))


def build() -> None:
    """Let zensical make the site; raises if it has a warning."""
    shutil.rmtree(SITE, ignore_errors=True)
    command = [str(Path(sys.executable).with_name("zensical")), "build", "--strict", "--clean"]
    subprocess.run(command, cwd=PAGES.parent, check=True, env={**os.environ, "NO_COLOR": "1"})
    for page in SITE.rglob("*.html"):
        # Boxes and tables wider than the page scroll, so the keyboard must reach them.
        text = _BOX.sub(r'<pre tabindex="0"', page.read_text())
        text = text.replace("<table>", '<table tabindex="0">')
        # The search of pages that are opened from disk.
        text = text.replace(
            _FOREIGN_SHIM, os.path.relpath(SITE / "worker-from-disk.js", page.parent)
        )
        page.write_text(_NAME.sub('<code class="name">', text))


class _Document(HTMLParser):
    """What a page links to and loads, and the places within it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.places.update(values[one] for one in ("id", "name") if one in values)
        if tag in _LOADS and _LOADS[tag] in values:
            self.loads.append(values[_LOADS[tag]])
        elif tag == "link" and values.get("rel") not in ("prev", "next", "canonical"):
            self.loads.append(values.get("href", ""))
        elif tag == "a":
            self.links.append(values.get("href", ""))


@cache
def _document(path: Path) -> _Document:
    return _Document(path.read_text())


def problems() -> Iterator[str]:
    """Yield each dead link of the site, and each thing that it loads from a network."""
    for page in sorted(SITE.rglob("*.html")):
        name = page.relative_to(SITE)
        for target in (*_document(page).links, *_document(page).loads):
            path, _, place = target.partition("#")
            if re.match(r"[a-z]+:", path) or not target:
                if target in _document(page).loads:
                    yield f"{name}: loads {target}"
                continue
            file = (
                (SITE / path[1:] if path.startswith("/") else page.parent / path) if path else page
            )
            file = file.resolve()
            file = file / "index.html" if file.is_dir() else file
            if not file.exists():
                yield f"{name}: {target}: no such page"
            elif place and file.suffix == ".html" and place not in _document(file).places:
                yield f"{name}: {target}: no such place"
    for style in SITE.rglob("*.css"):
        if re.search(r"url\(\s*[\"']?https?:|@import", style.read_text()):
            yield f"{style.relative_to(SITE)}: loads from a network"


def main() -> int:
    assemble()
    build()
    found = list(problems())
    pages = sum(1 for _ in SITE.rglob("*.html"))
    print("\n".join([*found, f"{SITE.relative_to(ROOT)}: {pages} pages, {len(found)} problems"]))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
