"""Opens pages in a browser without a window, and asks what they became."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pathlib import Path

PATIENCE_S = 120
WIDE = 1400
_CSP = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
_OWN_SCRIPT = "<script>/* Fills the page"
_END = "</body>\n</html>"
_KEEP_CHARTS = """
const charts = [];
uPlot = new Proxy(uPlot, { construct(Chart, given) {
  const one = new Chart(...given);
  charts.push(one);
  return one;
} });
const tell = (told) => {
  const pre = document.createElement("pre");
  pre.textContent = JSON.stringify(told);
  document.body.append(pre);
};
"""


def shown(page: Path, folder: Path, width: int = WIDE) -> str:
    """The page's markup after its script has run."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs chromium: apt-get install chromium")
    done = subprocess.run(
        [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu",
            f"--window-size={width},20000",
            f"--user-data-dir={folder}", "--virtual-time-budget=10000", "--enable-logging=stderr",
            "--dump-dom", page.as_uri(),
        ],
        capture_output=True, text=True, timeout=PATIENCE_S, check=True,
    )  # fmt: skip
    assert "Uncaught" not in done.stderr
    assert "Content Security Policy" not in done.stderr
    return done.stdout


def asked(page: Path, folder: Path, script: str, width: int = WIDE) -> Any:
    """What a script in the page tells, which calls `tell` once; `charts` has the charts of uPlot.

    The page's file is changed so that it lets the script in.
    """
    text = _CSP.sub("", page.read_text())
    text = text.replace(_OWN_SCRIPT, f"<script>{_KEEP_CHARTS}</script>{_OWN_SCRIPT}")
    page.write_text(text.replace(_END, f"<script>{script}</script>{_END}"))
    return json.loads(text_of(shown(page, folder, width), "pre"))


def text_of(markup: str, element: str) -> str:
    match = re.search(rf"<{element}[^>]*>(.*?)</{element.split()[0]}>", markup, re.DOTALL)
    assert match is not None, element
    return unescape(re.sub(r"<[^>]+>", "", match[1]))
