"""Reads a report as a browser would, as far as tests ask for it."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

VOID = {"meta", "link", "img", "input", "br"}
FOREIGN = re.compile(r"""(?:https?:)?//[\w.]|@import|url\(""")


class Page(HTMLParser):
    """Checks that elements are closed in order, and keeps what tests ask for."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.images, self.scripts, self.rows = [], [], [], [], [], 0
        self.text = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.links += [attributes["href"]] if tag in ("a", "link") else []
        self.images += [attributes] if tag == "img" else []
        assert not (tag == "script" and "src" in attributes)
        if tag == "script":
            self.scripts.append([attributes.get("type"), ""])
        self.rows += tag == "tr" and "data-push" in attributes
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1][1] += data
        elif self.open and self.open[-1] != "style":
            self.text += data


def assert_alone(text: str) -> Page:
    """The page, after checks that it needs nothing else: no network, no fonts, no link that leads nowhere."""
    parsed = Page(text)
    assert len(set(parsed.ids)) == len(parsed.ids)
    assert {link[1:] for link in parsed.links if link.startswith("#")} <= set(parsed.ids)
    assert all(link.startswith("#") or link == "data:," for link in parsed.links)
    assert all(image["src"].startswith("data:image/svg+xml;base64,") for image in parsed.images)
    assert all(image["alt"] for image in parsed.images)
    without_names = text.replace('"http://www.w3.org/2000/svg"', "")  # a name, not an address
    assert FOREIGN.search(re.sub(r"base64,[\w+/=]+", "", without_names)) is None
    for image in parsed.images:
        svg = base64.b64decode(image["src"].split(",", 1)[1]).decode()
        assert "<text" not in svg  # letters are drawn: no font is needed
        assert all(link.startswith(("#", "data:")) for link in re.findall(r'href="([^"]*)"', svg))
    return parsed
