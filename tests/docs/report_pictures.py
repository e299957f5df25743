"""Takes pictures of a page of `report` in chromium: python -m tests.docs.report_pictures [FOLDER].

Without FOLDER it draws docs/pictures/report.png anew. With it, FOLDER gets what is to be looked at
after a change of the page: 400 and 1400 columns wide, dark, and on A4, of a sick line.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

from mbtool.cli.main import run
from tests.docs.pictures import FOLDER
from tests.workflows.sick_line import sick_line

CYCLES = 240
PATIENCE_S = 120
_DARK = ("--force-dark-mode", "--blink-settings=preferredColorScheme=0")
_SHOWN = {
    "report-400.png": (400, 6000, ()),
    "report-1400.png": (1400, 4000, ()),
    "report-dark.png": (1400, 4000, _DARK),
}


def browse(page: Path, *arguments: str) -> None:
    """Run chromium without a window on a page."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    with tempfile.TemporaryDirectory() as profile:
        command = [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--hide-scrollbars", "--virtual-time-budget=8000",
            f"--user-data-dir={profile}", *arguments, page.as_uri(),
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)


def screenshot(page: Path, out: Path, width: int, height: int, *flags: str) -> None:
    browse(page, f"--window-size={width},{height}", f"--screenshot={out}", *flags)


def main(folder: Path | None) -> None:
    with tempfile.TemporaryDirectory() as name:
        page = Path(name) / "site.html"
        sick_line(Path(name) / "site.mcap", CYCLES)
        with chdir(name):  # The page names the log as the command does.
            code = run(["report", "site.mcap", "-o", str(page)])
        if code:
            raise SystemExit("report failed")
        if folder is None:
            screenshot(page, FOLDER / "report.png", 1100, 900)
            return
        folder.mkdir(exist_ok=True)
        for out, (width, height, flags) in _SHOWN.items():
            screenshot(page, folder.resolve() / out, width, height, *flags)
        browse(page, "--no-pdf-header-footer", f"--print-to-pdf={folder.resolve() / 'report.pdf'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
