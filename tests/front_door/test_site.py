"""The documentation site builds without a warning; its links lead somewhere; every page loads, on a phone too.

`make docs` runs this on what it has built (`INVDYN_SITE=build/site`). By itself it builds one, in a minute: without
the effects' pictures, and with notebooks that are not executed (tests/notebooks does that).
"""

import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import jupytext
import pytest
from browsing import chromium, opened, requests

from invdyn import ROOMS

ROOT = Path(__file__).parents[2]
PHONE = 390  # pixels
GENERATED = ("_static/", "genindex.html", "py-modindex.html", "search.html")
"""Pages that the generator makes of its own accord."""


def built(folder: Path) -> Path:
    """The site, made in a copy of what it is made of, so that the tree stays as it is."""
    if "INVDYN_SITE" in os.environ:
        return Path(os.environ["INVDYN_SITE"]).resolve()
    pytest.importorskip("sphinx", reason="the site's packages are not installed: pip install .[docs]")
    source = folder / "source"
    for name in ("docs", "benchmarks", "notebooks"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("*.ipynb", "__pycache__"))
    for room in ROOMS:
        (source / room).symlink_to(ROOT / room)
    for page in ROOT.glob("*.md"):
        shutil.copy(page, source)
    for notebook in sorted((ROOT / "notebooks").glob("[0-9]*.py")):
        text = notebook.read_text("utf-8").replace("(../docs/", "(../")  # as the Makefile does
        text = re.sub(r"\((0\d_\w+)\.py\)", r"(\1.ipynb)", text)
        jupytext.write(jupytext.reads(text, "py:percent"), source / "docs" / "tutorials" / f"{notebook.stem}.ipynb")
    site = folder / "site"
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        "-D",
        "effect_pictures=0",
        "-b",
        "html",
        source / "docs",
        site,
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return site


class Page(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, file: Path):
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(file.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        said = dict(attrs)
        self.anchors |= {said[key] for key in ("id", "name") if said.get(key)}
        self.links |= {said[key] for key in ("href", "src") if said.get(key)}


def dead_links(site: Path) -> list[str]:
    """Links within the site that lead to no file, or to no such place in it."""
    pages = {file: Page(file) for file in site.rglob("*.html")}
    dead = []
    for file, page in pages.items():
        for link in page.links:
            path, place = urlsplit(link).path, urlsplit(link).fragment
            if urlsplit(link).scheme:
                continue
            target = (file.parent / unquote(path)).resolve() if path else file
            found = target.exists() and (not place or target not in pages or unquote(place) in pages[target].anchors)
            if not found:
                dead.append(f"{file.relative_to(site)}: {link}")
    return dead


@pytest.mark.slow
def test_the_site_builds_its_links_lead_somewhere_and_every_page_loads(tmp_path):
    site = built(tmp_path)
    assert dead_links(site) == []
    pages = [page for page in sorted(site.rglob("*.html")) if not str(page.relative_to(site)).startswith(GENERATED)]
    assert len(pages) > 30
    with chromium(tmp_path / "chromium") as browser:
        for page in pages:
            opened(browser, page, width=PHONE)
            assert browser.find_element("tag name", "h1").text, page
            assert browser.execute_script("return document.documentElement.scrollWidth") <= PHONE, page
            assert all(url.startswith(site.as_uri()) for url in requests(browser, page)), page
            assert browser.get_log("browser") == [], page
