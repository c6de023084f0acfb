"""Files, tests, variables, modules, options and commands named in the documentation exist."""

import inspect
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.regenerate import REFERENCE, REPOSITORY
from tests.test_docs import commands, run
from usdface.demo.build import write_demo_inputs
from usdface.demo.capture import demo_markers
from usdface.demo.rig import demo_rig, make_head
from usdface.demo.sculpt import CHARACTER
from usdface.specs.surface import BindSpec

DOCS = REPOSITORY / "docs"


def test_every_test_that_the_security_page_names_is_there() -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (DOCS / "security.md").read_text("utf-8"))
    assert len(named) > 40
    for file, test in named:
        assert f"def {test}(" in (REPOSITORY / file).read_text("utf-8"), f"{file}::{test}"


def test_every_variable_that_the_code_reads_is_on_the_security_page() -> None:
    page = (DOCS / "security.md").read_text("utf-8")
    for folder in ("pipeline", "hooks"):
        for file in (REPOSITORY / folder).rglob("*.py"):
            text = file.read_text("utf-8")
            for name in re.findall(r'environ(?:\.get\(|\.setdefault\(|\[)"(\w+)"', text):
                assert f"`{name}`" in page, f"{file.name} reads {name}"


PACKAGE = REPOSITORY / "pipeline" / "usdface"
FOLDERS = "|".join(
    sorted(each.name for each in PACKAGE.iterdir() if (each / "__init__.py").exists())
)
PLACEHOLDERS = ("WORKFLOW", "USDFACE_HOOKS")
"""Parts of paths that stand for others."""


def names_in(dotted: str) -> bool:
    """Whether a dotted name is a module of the package, or a name in one."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        path = PACKAGE.joinpath(*parts[:count])
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if file.is_file():
            rest = parts[count:]
            return not rest or re.search(rf"\b{rest[0]}\b", file.read_text("utf-8")) is not None
    return False


def test_every_module_and_file_that_a_page_names_is_there() -> None:
    """Fragments of changes tell of the past, and may name what is gone."""
    gone = []
    for page in [REPOSITORY / "README.md", *DOCS.rglob("*.md")]:
        if page.parent.name == "changes":
            continue
        text = page.read_text("utf-8")
        dotted = re.findall(rf"`(?:usdface\.)?((?:{FOLDERS})(?:\.(?!json`)\w+)+)`", text)
        gone += [f"{page.name}: {name}" for name in dotted if not names_in(name)]
        paths = re.findall(r"(?<![\w/.-])((?:[\w-]+/)+(?:[\w-]+\.(?:py|js|yaml))?)(?=[`:])", text)
        paths += re.findall(r"(?<![\w/.-])((?:[\w-]+/)+[\w-]+\.py)\b", text)
        gone += [
            f"{page.name}: {path}"
            for path in paths
            if not any((top / path).exists() for top in (REPOSITORY, PACKAGE, page.parent))
            and not any(part in path for part in PLACEHOLDERS)
        ]
    assert gone == []


HOW_TO = sorted((DOCS / "howto").glob("*.md"))
NO_SPEC = ("check", "describe", "edits list", "names", "run", "submit", "tune", "validate")
"""Commands without `--save-spec`: their options are looked up in the reference."""


@pytest.mark.parametrize("page", HOW_TO, ids=lambda page: page.stem)
def test_every_command_of_a_how_to_page_is_understood(
    page: Path, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = commands(page)
    assert lines or page.stem == "README"
    for line in lines:
        name = next((each for each in NO_SPEC if line.startswith(f"usdface {each} ")), None)
        if name is None:
            Path("spec.yaml").unlink(missing_ok=True)
            assert run(f"{line} --save-spec spec.yaml") == 0, f"{line}\n{capsys.readouterr()}"
        else:
            command = REFERENCE / "commands" / f"{name.replace(' ', '-')}.md"
            known = command.read_text("utf-8")
            for word in shlex.split(line):
                assert not word.startswith("--") or f"`{word}`" in known, f"{line}: {word}"


def test_every_how_to_page_is_listed_and_no_other() -> None:
    listed = re.findall(r"\]\((\w+\.md)\)", (DOCS / "howto" / "README.md").read_text("utf-8"))
    assert sorted(listed) == [page.name for page in HOW_TO if page.stem != "README"]


def test_every_page_is_in_the_index() -> None:
    linked = set(re.findall(r"\]\(([\w/.-]+\.md)\)", (DOCS / "README.md").read_text("utf-8")))
    pages = {page.name for page in DOCS.glob("*.md")} - {"README.md"}
    folders = {page.relative_to(DOCS).as_posix() for page in DOCS.glob("*/README.md")}
    assert pages | folders <= linked


def test_landmarks_in_the_example_are_those_points_of_the_demos_character() -> None:
    shown = commands(DOCS / "howto" / "scan_without_shapes.md")[0]
    named = re.findall(r"(\w+)=(\d+)", shown)
    assert named == re.findall(r"(\w+)=(\d+)", BindSpec.example)
    assert len(named) >= 3
    head = make_head(CHARACTER)
    markers = demo_markers(head)
    (skin,) = (mesh for mesh in demo_rig().meshes if mesh.path.endswith("/skin"))
    for name, point in named:
        at = head.points[markers.points[markers.names.index(name)]]
        assert np.linalg.norm(skin.points[int(point)] - at) < 1.0, f"{name} is not point {point}"


def test_the_files_that_the_tutorial_takes_from_the_demo_are_made_by_it() -> None:
    page = (DOCS / "tutorial.md").read_text("utf-8")
    made = inspect.getsource(write_demo_inputs)
    taken = dict(re.findall(r"^cp demo/(\S+) (\S+)$", page, flags=re.MULTILINE))
    assert list(taken.values()) == ["shot.c3d", "hero.usdc", "keys.csv"]
    for name in taken:
        assert f'folder / "{name}"' in made, name


OTHERS = {
    "--background --python": "Blender",
    "--project --shot --status --task --sequence": "the Kitsu hook",
    "--install": "rez",
    "--require-hashes": "pip",
    "--out --quick --full": "poe bench",
}
"""Options of other programs."""


def test_pages_name_no_option_command_or_task_that_is_not_there() -> None:
    files = (REFERENCE / "commands").glob("*.md")
    reference = "".join(page.read_text("utf-8") for page in files)
    options = {*re.findall(r"`(--[a-z0-9-]+)`", reference), "--verbose", "--version", "--help"}
    options |= {option for given in OTHERS for option in given.split()}
    project = (REPOSITORY / "pyproject.toml").read_text("utf-8")
    tasks = set(re.findall(r"^(\w+) = \{ (?:cmd|sequence)", project, flags=re.MULTILINE))
    benchmarks = {path.stem for path in (REPOSITORY / "benchmarks").glob("*.py")}
    wrong = []
    for page in [REPOSITORY / "README.md", *DOCS.rglob("*.md")]:
        if page.parent.name == "changes":
            continue
        text = page.read_text("utf-8")
        wrong += [
            f"{page.name}: {name}"
            for name in set(re.findall(r"(?<![\w-])(--[a-z][a-z0-9-]+)", text)) - options
        ]
        wrong += [
            f"{page.name}: poe {name}" for name in set(re.findall(r"`poe (\w+)", text)) - tasks
        ]
        wrong += [
            f"{page.name}: poe bench {name}"
            for name in set(re.findall(r"`poe bench ([a-z]\w*)", text)) - benchmarks
        ]
        wrong += [
            f"{page.name}: usdface {name}"
            for name in re.findall(r"`usdface ([a-z][a-z-]+)", text)
            if f"\n# usdface {name}" not in f"\n{reference}"
        ]
    assert wrong == []
