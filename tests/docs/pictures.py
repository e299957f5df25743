"""Draws the pictures of the pages from the program's own output: python -m tests.docs.pictures.

docs/pictures/decode.svg is the output of `mbtool decode`, site.svg that of a replay of a whole
plant, watch.svg a frame of `mbtool watch`. rich draws them; its reference to a
font on a network is left out.
"""

from __future__ import annotations

import asyncio
import io
import os
import re
import signal
import socket
import struct
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


def site_picture() -> str:
    """A plant that is played, asked twice, and what it says at the end."""
    command = ["replay", "plant.pcap", "--as-slave", "--on", "all=tcp:127.0.0.0/24:1502", "--print"]
    asked = (("127.0.0.12", 2, 4, 0, 2), ("127.0.0.11", 1, 3, 200, 1))
    with subprocess.Popen(
        [sys.executable, "-m", "mbtool", *command],
        cwd=_WATCHED.parent,
        env={**os.environ, "FORCE_COLOR": "1", "TERM": "xterm-256color", "COLUMNS": "84"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as player:
        assert player.stdout is not None
        lines: list[str] = []
        while "Ctrl-C ends" not in "".join(lines):
            lines.append(player.stdout.readline())
        for host, unit, function, address, quantity in asked:
            with socket.create_connection((host, 1502)) as master:
                pdu = struct.pack(">BHH", function, address, quantity)
                master.sendall(struct.pack(">HHHB", 1, 0, len(pdu) + 1, unit) + pdu)
                master.recv(260)
        player.send_signal(signal.SIGINT)
        lines.append(player.stdout.read().replace("interrupted\n", ""))
    console = Console(record=True, width=84, file=io.StringIO(), force_terminal=True)
    console.print(f"[bold]$ mbtool {' '.join(command)}[/]", highlight=False)
    console.print(Text.from_ansi("".join(lines).rstrip()))
    return _plain(console.export_svg(title="mbtool replay", unique_id="site"))


def _plain(svg: str) -> str:
    svg = re.sub(r"<!--.*?-->", "", _FONT.sub("", svg)).replace("Fira Code, monospace", _FONTS)
    svg = re.sub(r"terminal-\d+-", "watch-", svg)
    return re.sub(r"[ \t]+$", "", re.sub(r"\n{2,}", "\n", svg), flags=re.MULTILINE).strip() + "\n"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "decode.svg").write_text(decode_picture())
    (FOLDER / "site.svg").write_text(site_picture())
    (FOLDER / "watch.svg").write_text(asyncio.run(watch_picture()))


if __name__ == "__main__":
    main()
