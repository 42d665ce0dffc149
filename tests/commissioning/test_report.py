"""Reports in pieces: text, numbers, tables."""

import math

import pytest

from softplc.commissioning.report import Claim, Report, Section, Table, number, page
from tests.commissioning.studies import is_self_contained


def report(*blocks) -> Report:
    claims = [Claim("a", "b", "c", holds=True), Claim("d", "e", "f", holds=False)]
    return Report("T", "S", [("1 u", "what")], claims, [Section("One", blocks)], "made by `softplc`")


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 3, "0"),
        (2.4353, 3, "2.44"),
        (-0.0231, 3, "−0.0231"),
        (248.0, 3, "248"),
        (67932.0, 5, "67\u202f932"),
        (4.684e-11, 3, "4.68·10⁻¹¹"),
        (-2.8e-11, 2, "−2.8·10⁻¹¹"),
        (1.5e7, 2, "1.5·10⁷"),
        (math.nan, 3, "–"),
        (math.inf, 3, "–"),
    ],
)
def test_numbers_are_written_as_an_engineer_writes_them(value: float, digits: int, text: str):
    assert number(value, digits) == text


def test_text_is_escaped_and_backticks_are_code():
    html = page(report("a < b & <script>alert(1)</script> `x`"))
    assert "<script" not in html
    assert "a &lt; b &amp; &lt;script&gt;" in html
    assert "<code>x</code>" in html


def test_a_table_has_its_caption_and_numbers_at_the_right():
    html = page(report(Table(("name", "value"), [("<K0>", "0.17")], "caption")))
    assert '<p class="caption">caption</p>' in html
    assert "<td>&lt;K0&gt;</td>" in html
    assert '<td class="n">0.17</td>' in html


def test_a_claim_that_fails_is_marked():
    html = page(report("text"))
    assert html.count("✔") == 1
    assert html.count("✘") == 1


def test_the_page_is_a_document_of_its_own():
    html = page(report("text"))
    assert html.startswith("<!DOCTYPE html>")
    assert "default-src 'none'" in html  # a browser would refuse to load anything, too
    assert is_self_contained(html)


@pytest.mark.parametrize(
    "text",
    [
        '<img src="https://example.invalid/a.png">',
        '<link rel="stylesheet" href="style.css">',
        '<style>@import "a.css"</style>',
        "<script>1</script>",
        '<p style="background: url(a.png)">',
    ],
)
def test_the_judge_of_self_contained_pages_sees_what_loads(text: str):
    assert not is_self_contained(f"<html>{text}</html>")
