"""Puts the JSON document of a report, its script and its style into one HTML file."""

# The page needs no network and cannot use one: its Content-Security-Policy permits nothing but the
# scripts and styles whose hashes it lists. The markup contains no text of a capture. All such texts
# are in the JSON of one script element that is not executed; page.js shows them as text nodes.

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from importlib.resources import files

_ASSETS = "assets"
_SCRIPTS = ("uPlot.iife.min.js", "page.js")
_STYLES = ("uPlot.min.css", "page.css")


def page(data: str) -> str:
    """Return the HTML page. `data` is the report's document as JSON, made by contents.encoded."""
    scripts, styles = [asset(name) for name in _SCRIPTS], [asset(name) for name in _STYLES]
    policy = "; ".join((
        "default-src 'none'",
        f"script-src {' '.join(map(csp_hash, scripts))}",
        f"style-src {' '.join(map(csp_hash, styles))}",
        "img-src data:",
        "base-uri 'none'",
        "form-action 'none'",
        "require-trusted-types-for 'script'",
        "trusted-types 'none'",
    ))  # fmt: skip
    licence = asset("uPlot.LICENSE").replace("--", "- -")
    return "".join((
        asset("page.html")
        .replace("{policy}", policy)
        .replace("{styles}", "".join(f"<style>{one}</style>\n" for one in styles))
        .replace("{licence}", f"<!-- Charts by uPlot.\n{licence}-->")
        .removesuffix("</body>\n</html>\n"),
        f'<script type="application/json" id="data">{data}</script>\n',
        *(f"<script>{one}</script>\n" for one in scripts),
        "</body>\n</html>\n",
    ))  # fmt: skip


def asset(name: str) -> str:
    return (files(__package__) / _ASSETS / name).read_text(encoding="utf-8")


def csp_hash(text: str) -> str:
    """Return the CSP source expression that permits an inline script or style with this text."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"
