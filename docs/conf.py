"""Sphinx configuration of the documentation site: `poe docs`.

The pages are plain Markdown, to be read in a repository, too: the site's menu is made of the links
in README.md, and in those of the folders.
"""

import re
from pathlib import Path, PurePosixPath

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
CHANGES = "changes/README"

project = "usdface"
extensions = ["myst_parser"]
root_doc = "README"
exclude_patterns = ["changes/[0-9]*"]  # parts of changes/README
html_theme = "furo"
html_title = "usdface"
html_show_copyright = False
html_static_path = ["site"]
html_css_files = ["tables.css"]
smartquotes = False  # they would merge the two dashes of an option
myst_heading_anchors = 4
# Pages outside the menu are linked, which is tested.
# Printed tables start at any level of heading.
suppress_warnings = ["toc.not_included", "myst.header"]


def add_menu(_app: Sphinx, docname: str, source: list[str]) -> None:
    """Append a menu of the links of an index page, one part per heading."""
    if PurePosixPath(docname).name != "README":
        return
    menus = []
    for part in re.split(r"^## ", source[0], flags=re.MULTILINE):
        caption, _, _ = part.partition("\n")
        linked = dict.fromkeys(re.findall(r"\]\(((?!\.)[\w/-]+)\.md\)", part))
        if linked:
            named = "" if caption.startswith("#") else f":caption: {caption}\n"
            pages = "\n".join(linked)
            menus.append(f"\n\n```{{toctree}}\n:hidden:\n{named}\n{pages}\n```\n")
    source[0] += "".join(menus)


def gather_changes(_app: Sphinx, docname: str, source: list[str]) -> None:
    """Append the fragments of the next release to the page of changes."""
    if docname != CHANGES:
        return
    for fragment in sorted((HERE / CHANGES).parent.glob("[0-9]*.md")):
        topic = fragment.stem.partition("-")[2].replace("-", " ").capitalize()
        text = re.sub(r"^# .*\n", "", fragment.read_text(encoding="utf-8"))
        source[0] += f"\n\n## {topic}\n\n{text}"


def setup(app: Sphinx) -> None:
    """Complete pages when they are read."""
    app.connect("source-read", add_menu)
    app.connect("source-read", gather_changes)
