"""The site that is made of the documentation: whole, without a dead link, and nothing from afar."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.regenerate import REPOSITORY

DOCS = REPOSITORY / "docs"
MENUS = ("README", "reference/commands/README", "changes/README")
BUILD = f"""
import gc, sys, furo
from sphinx.builders.html import StandaloneHTMLBuilder
from sphinx.cmd.build import main
StandaloneHTMLBuilder.search = False
menu = furo._compute_navigation_tree
furo._compute_navigation_tree = lambda page: menu(page) if page["pagename"] in {MENUS} else ""
gc.disable()  # a third of the time, and the process is a short one
sys.exit(main(sys.argv[1:]))
"""
"""The menu is the same on all pages, and half of the time that they take: a few have it here. None
is made searchable, which is a quarter of the rest, and Sphinx's own."""


def build(docs: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Make the site as `poe docs` does."""
    return subprocess.run(
        [sys.executable, "-c", BUILD, "-W", "--keep-going", "-q", "-b", "html", docs, site],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("site")
    done = build(DOCS, made)
    assert done.returncode == 0, done.stderr
    return made


def test_every_page_is_made_and_the_menu_leads_to_every_one(site: Path) -> None:
    files = {page for page in DOCS.rglob("*.md") if not page.match("changes/[0-9]*")}
    pages = {page.relative_to(DOCS).with_suffix(".html").as_posix() for page in files}
    assert all((site / page).is_file() for page in pages)
    menu = (site / "README.html").read_text("utf-8").partition('class="sidebar-tree"')[2]
    menu = menu.partition("</div>")[0]
    led = set(re.findall(r'href="([^"#]+)"', menu)) | {"README.html"}
    assert pages <= led, pages - led


def test_a_page_loads_nothing_from_another_host(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert pages
    for page in pages:
        text = page.read_text("utf-8")
        loaded = re.findall(r'<(?:script|img|iframe)[^>]*\ssrc="([^"]+)"', text)
        loaded += re.findall(r'<link[^>]*\srel="stylesheet"[^>]*\shref="([^"]+)"', text)
        assert not [each for each in loaded if "//" in each], page


DEAD = ("gone.md", "README.md#gone", "images/gone.jpg")


@pytest.fixture(scope="module")
def small_docs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("docs")


@pytest.fixture(scope="module")
def dead_links(small_docs: Path) -> subprocess.CompletedProcess[str]:
    """A build of three pages with a dead link each, below a page with none, and of changes."""
    docs = small_docs
    (docs / "changes").mkdir()
    shutil.copy(DOCS / "conf.py", docs)
    shutil.copytree(DOCS / "site", docs / "site")
    links = "[1](1.md) [2](2.md) [3](3.md) [Changes](changes/README.md)"
    (docs / "README.md").write_text(f"# Pages\n\n{links}\n", encoding="utf-8")
    (docs / "changes" / "README.md").write_text("# Changes\n", "utf-8")
    (docs / "changes" / "7-new-option.md").write_text("An option more.\n", "utf-8")
    for number, dead in enumerate(DEAD, start=1):
        shown = f"![there]({dead})" if dead.endswith("jpg") else f"[there]({dead})"
        (docs / f"{number}.md").write_text(f"# Page {number}\n\n{shown}\n", encoding="utf-8")
    return build(docs, docs / "made")


def test_fragments_of_changes_are_on_their_page(
    small_docs: Path, dead_links: subprocess.CompletedProcess[str]
) -> None:
    assert "changes" not in dead_links.stderr
    page = (small_docs / "made" / "changes" / "README.html").read_text("utf-8")
    assert "New option" in page
    assert "An option more." in page


@pytest.mark.parametrize("number", range(1, 1 + len(DEAD)))
def test_a_dead_link_is_an_error(dead_links: subprocess.CompletedProcess[str], number: int) -> None:
    assert dead_links.returncode != 0
    warned = [line for line in dead_links.stderr.splitlines() if f"{number}.md" in line]
    assert len(warned) == 1, dead_links.stderr
    assert DEAD[number - 1].rpartition("#")[2] in warned[0]
