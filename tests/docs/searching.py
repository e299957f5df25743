"""Searches the site in a browser, as a reader would."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from queue import Empty, Queue
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

import pytest

if TYPE_CHECKING:
    from pathlib import Path

PATIENCE_S = 120
_PAGE = "searching.html"
_SCRIPT = """<script>
const looked = (find) => new Promise((found) => {
  const look = () => { const one = find(); if (one) found(one); else setTimeout(look, 50); };
  look();
});
const hosts = () => [...document.querySelectorAll("*")].filter((one) => one.shadowRoot);
const roots = () => [document, ...hosts().map((one) => one.shadowRoot)];
const first = (selector) => roots().map((root) => root.querySelector(selector)).find(Boolean);
addEventListener("load", async () => {
  (await looked(() => first(".md-search__button"))).click();
  const box = await looked(() => first("input[autofocus]"));
  box.value = "SOUGHT";
  box.dispatchEvent(new Event("input", { bubbles: true, composed: true }));
  const links = () => roots().slice(1).flatMap((root) => [...root.querySelectorAll("li a")]);
  const fits = (one) => one.textContent.toLowerCase().includes("SOUGHT");
  const link = await looked(() => links().find(fits));
  const told = JSON.stringify([location.protocol, link.textContent]);
  new Image().src = `http://127.0.0.1:PORT/told?${new URLSearchParams({ told })}`;
});
</script>"""


class _Handler(SimpleHTTPRequestHandler):
    """Serves the site, and keeps what the page tells."""

    told: Queue[list[str]]

    def do_GET(self) -> None:
        asked = urlsplit(self.path)
        if asked.path == "/told":
            self.told.put(json.loads(parse_qs(asked.query)["told"][0]))
            self.send_error(404)
        else:
            super().do_GET()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


def found(site: Path, folder: Path, sought: str, *, from_disk: bool) -> list[str]:
    """Search for a text; return the protocol of the page and the first result that has it.

    `folder` is for the browser's own files.
    """
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("needs chromium: apt-get install chromium")
    told: Queue[list[str]] = Queue()
    handler = type("_Told", (_Handler,), {"told": told})
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(site))) as server:
        script = _SCRIPT.replace("SOUGHT", sought).replace("PORT", str(server.server_port))
        page = site / _PAGE
        page.write_text((site / "index.html").read_text().replace("</body>", f"{script}</body>"))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = page.as_uri() if from_disk else f"http://127.0.0.1:{server.server_port}/{_PAGE}"
        command = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu",
            f"--user-data-dir={folder}", address,
        ]  # fmt: skip
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as running:
            try:
                return told.get(timeout=PATIENCE_S)
            except Empty:
                return []
            finally:
                running.kill()
                server.shutdown()
                page.unlink()
