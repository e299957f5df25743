"""Draws the pictures of the pages from the program's own output: python -m tests.docs.pictures.

docs/pictures/decode.svg is the output of `mbtool decode`, docs/pictures/watch.svg a frame of
`mbtool watch`. rich draws both; its reference to a font on a network is left out.
"""

from __future__ import annotations

import asyncio
import io
import os
import re
import subprocess
import sys
from pathlib import Path

from rich.console import Console
from rich.text import Text

import mbtool
from tests.cli.watching.screens import GivenFeed, screen

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "pictures"
_COMMAND = ("decode", "captures/ft1a-touch-line.mcap")
_WATCHED = ROOT / "captures" / "plant.pcap"
_FONT = re.compile(r"@font-face\s*\{.*?\}", re.DOTALL)
_FONTS = "ui-monospace, 'DejaVu Sans Mono', Menlo, Consolas, monospace"


def decode_picture() -> str:
    """The output of one command, with its command line above it."""
    ran = subprocess.run(
        [sys.executable, "-m", "mbtool", *_COMMAND],
        cwd=ROOT,
        env={**os.environ, "FORCE_COLOR": "1", "TERM": "xterm-256color", "COLUMNS": "80"},
        capture_output=True,
        text=True,
        check=True,
    )
    console = Console(record=True, width=80, file=io.StringIO(), force_terminal=True)
    console.print(f"[bold]$ mbtool {' '.join(_COMMAND)}[/]", highlight=False)
    console.print(Text.from_ansi(ran.stdout + ran.stderr))
    return _plain(console.export_svg(title="mbtool decode", unique_id="decode"))


async def watch_picture() -> str:
    """A frame of the full screen after 19 s of a capture."""
    feed = GivenFeed(mbtool.open(_WATCHED).records())
    feed.at_ns = max(one.request_ns or 0 for one in mbtool.open(_WATCHED)) + 400_000_000
    async with screen(feed, (92, 14)) as seen:
        await seen.redraw()
        return _plain(seen.app.export_screenshot(title="mbtool watch plant.pcap"))


def _plain(svg: str) -> str:
    svg = re.sub(r"<!--.*?-->", "", _FONT.sub("", svg)).replace("Fira Code, monospace", _FONTS)
    svg = re.sub(r"terminal-\d+-", "watch-", svg)
    return re.sub(r"[ \t]+$", "", re.sub(r"\n{2,}", "\n", svg), flags=re.MULTILINE).strip() + "\n"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "decode.svg").write_text(decode_picture())
    (FOLDER / "watch.svg").write_text(asyncio.run(watch_picture()))


if __name__ == "__main__":
    main()
