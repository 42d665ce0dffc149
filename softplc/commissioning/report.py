"""A report as one HTML file: nothing is loaded from anywhere, pictures are inside, and it prints well."""

import base64
import html
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure: `name` is its file name without .png, `alt` says in words what is to be seen."""

    name: str
    png: bytes = field(repr=False)
    alt: str
    caption: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells that are text; all columns but the first `words` are numbers and stand at the right."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    words: int = 1


@dataclass(frozen=True, slots=True)
class Claim:
    """One thing that the study sets out to show: what was expected, what was found, whether it holds."""

    text: str
    expected: str
    found: str
    holds: bool


@dataclass(frozen=True, slots=True)
class Section:
    """A heading with paragraphs (str), tables and pictures below it, in this order."""

    title: str
    blocks: Sequence["str | Table | Picture"]


@dataclass(frozen=True, slots=True)
class Report:
    """`headline` are pairs of a number with its unit, and what it is; `origin` says how the report was made."""

    title: str
    subtitle: str
    headline: Sequence[tuple[str, str]]
    claims: Sequence[Claim]
    sections: Sequence[Section]
    origin: str

    def pictures(self) -> list[Picture]:
        """All pictures, in the order in which they appear."""
        return [block for section in self.sections for block in section.blocks if isinstance(block, Picture)]


def number(value: float, digits: int = 3) -> str:
    """A number as an engineer writes it: `digits` significant ones, a real minus, powers of ten where they help."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        return f"{value:,.{max(0, digits - 1 - exponent)}f}".replace(",", "\u202f").replace("-", "−")
    mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}·10{str(int(power)).translate(_RAISED)}".replace("-", "−")


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def page(report: Report) -> str:
    """The whole report as one HTML document."""
    anchors = [(f"s{index}", section.title) for index, section in enumerate(report.sections, 1)]
    parts = [
        f"<header><h1>{_text(report.title)}</h1><p>{_text(report.subtitle)}</p></header>",
        '<div class="cards">',
        *(f"<div><b>{_text(value)}</b><span>{_text(what)}</span></div>" for value, what in report.headline),
        "</div>",
        "<nav>",
        *(f'<a href="#{anchor}">{_text(title)}</a>' for anchor, title in anchors),
        "</nav>",
        "<h2>What was to be shown</h2>",
        _claims(report.claims),
    ]
    count = 0
    for (anchor, title), section in zip(anchors, report.sections, strict=True):
        parts.append(f'<h2 id="{anchor}">{_text(title)}</h2>')
        for block in section.blocks:
            if isinstance(block, str):
                parts.append(f"<p>{_text(block)}</p>")
            elif isinstance(block, Table):
                parts.append(_table(block))
            else:
                count += 1
                parts.append(_figure(block, count))
    parts.append(f"<footer><p>{_text(report.origin)}</p></footer>")
    return _PAGE.format(title=html.escape(report.title), style=_STYLE, body="\n".join(parts))


def _text(text: str) -> str:
    """Escaped; what stands between backticks is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def _claims(claims: Sequence[Claim]) -> str:
    rows = "".join(
        f'<tr><td class="{"yes" if claim.holds else "no"}">{"✔" if claim.holds else "✘"}</td>'
        f"<td>{_text(claim.text)}</td><td>{_text(claim.expected)}</td><td>{_text(claim.found)}</td></tr>"
        for claim in claims
    )
    head = "".join(f'<th scope="col">{column}</th>' for column in ("", "claim", "expected", "found"))
    return (
        f'<div class="wide"><table class="claims"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _table(table: Table) -> str:
    def cells(row: Sequence[str], tag: str) -> str:
        extra = ' scope="col"' if tag == "th" else ""
        kinds = ("" if index < table.words else ' class="n"' for index in range(len(row)))
        return "".join(f"<{tag}{extra}{kind}>{_text(cell)}</{tag}>" for cell, kind in zip(row, kinds, strict=True))

    caption = f'<p class="caption">{_text(table.caption)}</p>' if table.caption else ""
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in table.rows)
    return (
        f'{caption}<div class="wide"><table><thead><tr>{cells(table.columns, "th")}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _figure(picture: Picture, count: int) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    return (
        f'<figure id="{html.escape(picture.name)}">'
        f'<img alt="{html.escape(picture.alt)}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>Figure {count}.</b> {_text(picture.caption)}</figcaption></figure>"
    )


_STYLE = """
:root { color-scheme: light; --ink: #1f2933; --soft: #5b6770; --line: #dfe3e8; --accent: #ef7d00; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 0 1.25rem 4rem; background: #fff; color: var(--ink);
  font: 16px/1.55 system-ui, "Segoe UI", "Liberation Sans", "DejaVu Sans", sans-serif; }
header { border-bottom: 3px solid var(--accent); margin: 2rem 0 1.5rem; padding-bottom: .75rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0; }
header p { color: var(--soft); margin: .4rem 0 0; max-width: 52rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
p { max-width: 52rem; margin: .6rem 0; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); gap: .75rem; }
.cards div { border: 1px solid var(--line); border-left: 4px solid var(--accent); border-radius: 4px;
  padding: .55rem .8rem; }
.cards b { display: block; font-size: 1.35rem; font-variant-numeric: tabular-nums; }
.cards span { color: var(--soft); display: block; font-size: .82rem; line-height: 1.35; }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; margin-top: 1.2rem; font-size: .9rem; }
nav a { color: #1769aa; text-decoration: none; }
nav a:hover { text-decoration: underline; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; min-width: 50%; }
.caption { color: var(--soft); font-size: .88rem; margin: 1.4rem 0 0; }
.caption + .wide { margin-top: .4rem; }
th { text-align: left; border-bottom: 2px solid var(--ink); padding: .3rem .9rem .3rem 0; vertical-align: bottom; }
td { border-bottom: 1px solid var(--line); padding: .3rem .9rem .3rem 0; vertical-align: top; }
th.n, td.n { text-align: right; }
td.n { white-space: nowrap; }
.claims td:first-child { font-weight: bold; width: 1.6rem; }
.yes { color: #2e7d32; }
.no { color: #c62828; }
figure { margin: 1.4rem 0; }
img { display: block; width: 100%; height: auto; border: 1px solid var(--line); border-radius: 4px; }
figcaption { color: var(--soft); font-size: .88rem; margin-top: .5rem; max-width: 56rem; }
figcaption b { color: var(--ink); }
code { font: .9em ui-monospace, "Liberation Mono", "DejaVu Sans Mono", monospace; background: #f1f3f5;
  border-radius: 3px; padding: .05rem .3rem; }
footer { border-top: 1px solid var(--line); color: var(--soft); font-size: .85rem; margin-top: 3rem; }
@media print { body { max-width: none; font-size: 10.5pt; } nav { display: none; }
  figure, tr, .cards div { break-inside: avoid; } h2 { break-after: avoid; } }
"""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""
