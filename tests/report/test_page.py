"""The page needs nothing but itself, and shows what it was given."""

import base64
import re
import struct
from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.report._page import (
    GENERATOR,
    KeyNumbers,
    ReportPicture,
    ReportTable,
    Section,
    Text,
    page_html,
)

PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 1800, 750) + b" and so on"


class Page(HTMLParser):
    """Collects text, tags and addresses; complains where tags do not close in order."""

    VOID = ("meta", "img", "br")

    def __init__(self, html: str):
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data


def page(*blocks, title: str = "A title") -> str:
    return page_html(title, [], [Section("1 First part", tuple(blocks))], "the end")


def test_nothing_is_loaded_from_elsewhere():
    html = page(ReportPicture("p", PNG, "a picture"), Text("words"))
    addresses = [
        value
        for _, attributes in Page(html).seen
        for name, value in attributes.items()
        if name in ("src", "href") and value is not None
    ]
    assert addresses
    assert all(re.match(r"data:image/png;base64,|#", address) for address in addresses)
    assert "url(" not in html
    assert "@import" not in html
    assert "<script" not in html


def test_pictures_are_inside_once():
    assert page(ReportPicture("p", PNG, "a picture")).count(base64.b64encode(PNG).decode()) == 1


def test_a_picture_is_enlarged_and_put_back_by_links():
    """Targets that the style shows over the whole window; its width in pixels is the PNG's own."""
    html = page(ReportPicture("p", PNG, "a picture"))
    seen = Page(html).seen
    links = [attributes["href"] for tag, attributes in seen if tag == "a"]
    assert {"#p", "#at-p"} <= set(links)
    targets = {
        attributes["id"]: (tag, attributes) for tag, attributes in seen if "id" in attributes
    }
    assert targets["at-p"][0] == "div"
    assert targets["p"] == ("figure", {"id": "p", "style": "--pixels: 1800"})
    (image,) = [attributes for tag, attributes in seen if tag == "img"]
    assert (image["width"], image["height"]) == ("1800", "750")
    assert "figure:target" in html


def test_the_contents_lead_to_the_parts():
    seen = Page(page(Text("words"))).seen
    links = [attributes["href"] for tag, attributes in seen if tag == "a"]
    parts = ["#" + str(attributes["id"]) for tag, attributes in seen if tag == "section"]
    assert links == parts == ["#1-first-part"]


def test_columns_of_numbers_are_set_to_the_right_and_marks_lose_their_sign():
    html = page(
        ReportTable("t", ("name", "value"), [("a", "-1.5e-5"), ("b", "!10 000"), ("c", "-")])
    )
    ranges = page(
        ReportTable("t", ("interval",), [("3.1e-7 to 0.84",), ("-0.5 to 0.3",), ("unknown",)])
    )
    assert ranges.count("<td class=n>") == 3
    assert "<td class=n>-1.5e-5</td>" in html
    assert "<td class=n><mark>10 000</mark></td>" in html
    assert "<td class=short>a</td>" in html


def test_words_between_backticks_are_code():
    assert "<code>jaxtwin &lt;demo&gt;</code>" in page(Text("see `jaxtwin <demo>`"))


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=30))
def test_any_text_comes_out_as_it_went_in(text):
    """Nothing that a file name or an error holds can become markup."""
    html = page(
        Text(text),
        KeyNumbers(((text, text),)),
        ReportTable(text, (text,), [(text,)]),
        title=f"a{text}",
    )
    parsed = Page(html)
    shown = re.sub("`([^`]+)`", r"\1", text)
    assert parsed.words.count(shown) >= 3
    assert GENERATOR in html
    assert [tag for tag, _ in parsed.seen].count("script") == 0
