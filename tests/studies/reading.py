"""Reads an HTML page as a browser without pictures would, for tests of its structure."""

import html.parser
import itertools
import re

_ALONE = ("meta", "img", "input", "br")


class Reading(html.parser.HTMLParser):
    """What a page holds."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.ids, self.headings = [], [], []  # (tag, attributes); ids; (level, text)
        self.tables = []  # {"caption", "rows": [[text, …], …], "scopes"}
        self.text = ""  # what is read, without scripts and styles
        self._open = []
        self.feed(text)
        assert self._open == [], "a tag is not closed"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if "id" in dict(attrs):
            self.ids.append(dict(attrs)["id"])
        if tag not in _ALONE:
            self._open.append(tag)
        if re.fullmatch(r"h\d", tag):
            self.headings.append([int(tag[1]), ""])
        elif tag == "table":
            self.tables.append({"caption": "", "rows": [], "scopes": []})
        elif tag == "tr":
            self.tables[-1]["rows"].append([])
        elif tag in ("td", "th"):
            self.tables[-1]["rows"][-1].append("")
            self.tables[-1]["scopes"].append((tag, dict(attrs).get("scope")))
        elif tag == "br":
            self.handle_data("\n")

    def handle_endtag(self, tag):
        assert self._open.pop() == tag, f"{tag} is closed, but not open"

    def handle_data(self, data):
        if {"script", "style"} & set(self._open):
            return
        self.text += data
        if self._open and re.fullmatch(r"h\d", self._open[-1]):
            self.headings[-1][1] += data
        elif "caption" in self._open:
            self.tables[-1]["caption"] += data
        elif "td" in self._open or "th" in self._open:
            self.tables[-1]["rows"][-1][-1] += data


def checked(text):
    """Return what a page holds, once it has what every page must have."""
    page = Reading(text)
    names = [tag for tag, _ in page.tags]
    assert text.startswith("<!doctype html>")
    for name in ("html", "title", "h1", "header", "nav", "main", "footer"):
        assert names.count(name) == 1, name
    assert ("html", {"lang": "en"}) in page.tags
    # It needs nothing but itself.
    assert not {"link", "iframe", "object", "embed", "base"} & set(names)
    assert not re.search(r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(", text)
    for tag, attributes in page.tags:
        assert "http" not in str(attributes.get("src", "")) + str(attributes.get("href", ""))
        if "src" in attributes:
            assert attributes["src"].startswith("data:image/png;base64,"), tag
        if "href" in attributes:
            assert attributes["href"].startswith("#")
            assert attributes["href"][1:] in page.ids, attributes["href"]
        for name in ("aria-labelledby",):
            assert name not in attributes or attributes[name] in page.ids
        if tag == "img":
            assert len(attributes["alt"]) > 10
        if tag == "svg":
            assert attributes.get("aria-hidden") or len(attributes["aria-label"]) > 10
    assert len(page.ids) == len(set(page.ids))
    levels = [level for level, _ in page.headings]
    assert levels[0] == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    assert all(heading.strip() for _, heading in page.headings)
    for table in page.tables:
        assert table["caption"].strip()
        assert len({len(row) for row in table["rows"]}) == 1
        assert all(scope in ("col", "row") for tag, scope in table["scopes"] if tag == "th")
    return page
