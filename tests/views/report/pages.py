"""Takes a page apart, as a browser would."""

from __future__ import annotations

import json
from base64 import b64encode
from dataclasses import dataclass, field
from hashlib import sha256
from html.parser import HTMLParser
from typing import Any


@dataclass
class Page(HTMLParser):
    """The elements of a page: their tags, attributes and scripts."""

    text: str
    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    contents: list[tuple[str, str]] = field(default_factory=list)
    """The text in each script and style, with its type or tag."""

    def __post_init__(self) -> None:
        super().__init__()
        self._open: str | None = None
        self.feed(self.text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.tags.append((tag, attributes))
        if tag in ("script", "style"):
            self._open = attributes.get("type") or tag
            self.contents.append((self._open, ""))

    def handle_endtag(self, tag: str) -> None:
        self._open = None

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            kind, before = self.contents.pop()
            self.contents.append((kind, before + data))

    @property
    def document(self) -> dict[str, Any]:
        """What the page shows."""
        (data,) = [text for kind, text in self.contents if kind == "application/json"]
        document: dict[str, Any] = json.loads(data)
        return document

    @property
    def policy(self) -> dict[str, list[str]]:
        """The Content-Security-Policy, by directive."""
        (policy,) = [
            one["content"]
            for tag, one in self.tags
            if tag == "meta" and one.get("http-equiv") == "Content-Security-Policy"
        ]
        rules = (policy or "").split("; ")
        return {rule.split()[0]: rule.split()[1:] for rule in rules}


def hash_of(text: str) -> str:
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


def demand_self_contained(page: Page) -> None:
    """Fail if a page needs anything from elsewhere, or permits more than its own scripts."""
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "img", "object", "embed", "base", "form"), tag
        assert not {"src", "srcset", "style"} & attributes.keys(), (tag, attributes)
        assert not any(name.startswith("on") for name in attributes), (tag, attributes)
        assert (attributes.get("href") or "#").startswith("#"), (tag, attributes)
    policy = page.policy
    assert policy["default-src"] == ["'none'"]
    scripts = [hash_of(text) for kind, text in page.contents if kind == "script"]
    styles = [hash_of(text) for kind, text in page.contents if kind == "style"]
    assert policy["script-src"] == scripts
    assert policy["style-src"] == styles
    assert not any("@import" in text or "url(" in text for _, text in page.contents)
