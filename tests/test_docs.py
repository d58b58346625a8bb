"""The committed pages: the reference is what the code gives, and every link and picture is there."""

import importlib
import json
import re
from pathlib import Path

import pytest

from tissue_contact.study.front import percent

ROOT = Path(__file__).parents[1]
PAGES = sorted(path for pattern in ("*.md", "docs/**/*.md", "scenarios/*/README.md") for path in ROOT.glob(pattern))
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)


def generated() -> dict[str, str]:
    """File name -> content, from docs/generate.py."""
    return importlib.import_module("generate").pages()


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    titles = re.findall(r"^#+ +(.*?) *$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page: Path) -> list[str]:
    """Targets of the links and pictures of a page, those of the web left out."""
    found = LINK.findall(CODE.sub("", page.read_text("utf-8")))
    return [target for target in found if not re.match(r"[a-z]+:", target)]


def test_reference_pages_are_what_the_code_gives():
    folder = ROOT / "docs" / "reference"
    pages = generated()
    assert sorted(pages) == sorted(p.name for p in folder.iterdir())
    stale = [name for name, content in pages.items() if (folder / name).read_text("utf-8") != content]
    assert stale == [], "run python docs/generate.py"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_pictures_exist(page):
    for target in links(page):
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(file), f"{page.name} links to {target}"


def test_every_page_and_picture_is_linked():
    targets = {(page.parent / target.partition("#")[0]).resolve() for page in PAGES for target in links(page)}
    folder = ROOT / "docs"
    shown = {*folder.rglob("*.md"), *folder.rglob("*.png")}
    assert sorted(p for p in shown if p.resolve() not in targets) == []


def test_the_page_of_the_trade_says_what_its_data_say():
    data = json.loads((ROOT / "docs" / "data" / "trade-press.json").read_text("utf-8"))
    page = " ".join((ROOT / "docs" / "trade.md").read_text("utf-8").split())
    assert data["advice"] in page
    for point in data["points"]:
        if point["front"]:
            assert f"| {point['label']} | {point['us']:,.0f} | {percent(point['error']['force'])} |" in page
