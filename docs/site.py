"""What mkdocs needs to be told of these pages, see mkdocs.yml."""

import re
from typing import Any


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Links out of docs/, to the README or the notebooks, become text: they are no part of the site."""
    up = re.escape("../" * (page.file.src_uri.count("/") + 1))
    return re.sub(rf"\[([^\]]+)\]\({up}[^)]*\)", r"\1 (in the checkout)", markdown)
