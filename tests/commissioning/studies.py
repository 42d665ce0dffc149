"""Runs a study as a user does, and looks at what it wrote."""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.support.program import ROOT, softplc


@dataclass
class Done:
    """A study that ran: its folder, its JSON document, and the home folder that it had."""

    folder: Path
    document: dict[str, Any]
    home: Path

    @property
    def numbers(self) -> dict[str, Any]:
        return self.document["numbers"]

    @property
    def pictures(self) -> list[Path]:
        return [Path(name) for name in self.document["files"] if name.endswith(".png")]

    @property
    def html(self) -> str:
        return (self.folder / "report.html").read_text(encoding="utf-8")


def run_study(name: str, place: Path, *options: str) -> Done:
    """`softplc study NAME --json` in an empty folder, with an empty home."""
    home, work, folder = place / "home", place / "work", place / "out" / name
    home.mkdir(parents=True)
    work.mkdir()
    command = ("study", name, "--output", str(folder), "--json", *options)
    done = softplc(*command, cwd=work, timeout=110, **_home(home))
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert list(work.iterdir()) == []
    return Done(folder, json.loads(done.stdout), home)


def _home(home: Path) -> dict[str, str]:
    """Where a program writes when it thinks that nobody looks."""
    folders = {"XDG_CACHE_HOME": home / "cache", "XDG_CONFIG_HOME": home / "config", "TMPDIR": home}
    return {"HOME": str(home), **{name: str(folder) for name, folder in folders.items()}}


class _Loads(HTMLParser):
    """Everything that a browser would fetch, and every element's name."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.elements: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}
        ]


def is_self_contained(html: str) -> bool:
    """Whether nothing in this page is loaded from anywhere, and nothing in it runs."""
    loads = _Loads()
    loads.feed(html)
    outside = [address for address in loads.addresses if not address.startswith(("data:", "#"))]
    words = re.findall(r"https?:|@import|url\(|//[a-z]", re.sub(r"data:image/png;base64,[^\"]*", "", html))
    return outside == [] and words == [] and not {"script", "iframe", "object", "embed"} & set(loads.elements)


def shows_something(path: Path) -> bool:
    """Whether this PNG has a sensible size and lines in it."""
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"), int)
    height, width, _ = pixels.shape
    background = pixels[2, 2]
    drawn = (np.abs(pixels - background).max(axis=2) > 20).mean()
    return 600 <= width <= 2000 and 250 <= height <= 2000 and 0.01 < drawn < 0.9


def documented_figures(name: str) -> set[str]:
    """The figures of this study that docs/studies.md has a row for."""
    page = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")
    return set(re.findall(rf"^\| `({name}-[\w-]+)` \|", page, re.MULTILINE))


def chromium() -> str | None:
    """The browser, where there is one."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def rendered(page: Path, place: Path) -> tuple[str, Path]:
    """What Chromium says about this page, and its picture of it."""
    picture = place / "page.png"
    browser = chromium()
    assert browser is not None
    done = subprocess.run(
        [
            browser,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--no-first-run",
            "--disable-background-networking",
            f"--user-data-dir={place / 'profile'}",
            "--enable-logging=stderr",
            "--window-size=1200,1600",
            f"--screenshot={picture}",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line), picture
