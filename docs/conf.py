"""How Sphinx makes a site of these pages: `poe docs`.

The pages stay plain Markdown that reads well in a repository: what the site's menu holds comes from
the links of README.md, and of those in its folders.
"""

import re
from pathlib import Path, PurePosixPath

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
CHANGES = "changes/README"

project = "usdface"
extensions = ["myst_parser"]
root_doc = "README"
exclude_patterns = ["changes/[0-9]*"]  # which are parts of a page
html_theme = "furo"
html_title = "usdface"
html_show_copyright = False
html_static_path = ["site"]
html_css_files = ["tables.css"]
smartquotes = False  # which make one dash of an option's two
myst_heading_anchors = 4
# A page that no menu holds is reached by a link; that there is one is tested.
# Tables as printed begin their headings where the printing has them.
suppress_warnings = ["toc.not_included", "myst.header"]


def add_menu(_app: Sphinx, docname: str, source: list[str]) -> None:
    """Append the menu that the links of an index page stand for, a part for each heading."""
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
    """Show the fragments that the next release gathers on the page that tells of them."""
    if docname != CHANGES:
        return
    for fragment in sorted((HERE / CHANGES).parent.glob("[0-9]*.md")):
        topic = fragment.stem.partition("-")[2].replace("-", " ").capitalize()
        text = re.sub(r"^# .*\n", "", fragment.read_text(encoding="utf-8"))
        source[0] += f"\n\n## {topic}\n\n{text}"


def setup(app: Sphinx) -> None:
    """Let pages be completed as they are read."""
    app.connect("source-read", add_menu)
    app.connect("source-read", gather_changes)
