"""What the programs that make pages of the docs have in common."""

import re
from collections.abc import Iterable, Mapping, Sequence


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [headings, ["---"] * len(headings), *rows]
    escaped = ([cell.replace("|", r"\|") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in escaped)


def filled(page: str, texts: Mapping[str, str]) -> str:
    """The page with texts in their places, each between a comment that names it and the next that ends it."""
    for name, text in texts.items():
        parts = re.split(rf"(<!-- {name} -->\n).*?(?=<!-- end -->)", page, flags=re.DOTALL)
        if len(parts) != 3:
            raise ValueError(f"the page must have one place for {name}")
        page = parts[0] + parts[1] + text + parts[2]
    return page
