"""A hook of mkdocs: on the site, links to files outside of docs/ become the paths of these files."""

import posixpath
import re
from typing import Any

_LINK = re.compile(r"\[([^\]\[]+)\]\((\.\./[^)\s#]+)(?:#[^)\s]*)?\)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """The page's text with such links replaced by text, as ``benchmarks/policy.py``."""
    folder = posixpath.dirname("docs/" + page.file.src_uri)

    def replace(match: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(folder, match[2]))
        if path.startswith("docs/"):
            return match[0]
        return f"`{path}`" if match[1].strip("`") in path else f"{match[1]} (`{path}`)"

    return _LINK.sub(replace, markdown)
