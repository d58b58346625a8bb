"""What the pages of the docs that hold measured tables have in common."""

import re
from collections.abc import Mapping, Sequence


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    return "".join(f"| {' | '.join(line)} |\n" for line in (headings, ["---"] * len(headings), *rows))


def filled(page: str, texts: Mapping[str, str]) -> str:
    """The page with texts in their places, each between a comment that names it and the next that ends it."""
    for name, text in texts.items():
        parts = re.split(rf"(<!-- {name} -->\n).*?(?=<!-- end -->)", page, flags=re.DOTALL)
        if len(parts) != 3:
            raise ValueError(f"the page must have one place for {name}")
        page = parts[0] + parts[1] + text + parts[2]
    return page
