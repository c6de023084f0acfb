"""Every example in the documentation runs, and every link leads somewhere."""

import json
import re
import shlex
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from develop import main as develop
from tests.model.placement.conftest import search_from_few_starts
from tests.reference_pages import anchor, reference_pages
from tests.regenerate import REFERENCE, REPOSITORY, USD_SCHEMA
from tests.small_scan import small_scan, small_scan_take, write_scan
from tests.steps.small_shot import Shot, make_inputs
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
    write_human,
    write_human_performance,
)
from usdface.cli import main
from usdface.core.provenance import Provenance
from usdface.media.picture.image import read_image_metadata
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.take.write import write_take

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def commands(page: Path) -> list[str]:
    """The command lines in a page's shell blocks, comments left out."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^ *```sh\n(.*?)^ *```", text, flags=re.DOTALL | re.MULTILINE)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split("  #")[0].strip() for line in lines if line.strip()]


def run(line: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(shlex.split(line)[1:])
    return int(stopped.value.code or 0)


def anchors(page: Path) -> set[str]:
    """What the headings of a page are linked by; the second of a name ends in -1."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    seen = Counter[str]()
    found = set()
    for title in re.findall(r"^#+ +(.+)$", text, flags=re.MULTILINE):
        name = anchor(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", title))
        found.add(f"{name}-{seen[name]}" if seen[name] else name)
        seen[name] += 1
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(REPOSITORY).as_posix())
def test_every_link_leads_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target, _, place in re.findall(r"\]\(([^)#\s]*)(#([^)\s]*))?\)", text):
        if target.startswith("http"):
            continue
        linked = page.parent / target if target else page
        assert linked.exists(), f"{page.name} links to {target}"
        if place:
            assert place in anchors(linked), f"{page.name} links to {target}#{place}"


def test_committed_reference_pages_are_those_of_the_code() -> None:
    pages = reference_pages(USD_SCHEMA / "schema.usda")
    files = {path.relative_to(REFERENCE).as_posix() for path in REFERENCE.rglob("*.md")}
    assert files == set(pages)
    for name, text in pages.items():
        assert (REFERENCE / name).read_text(encoding="utf-8") == text, "run `poe schemas`"


@pytest.mark.usefixtures("without_comparison", "placement_not_drawn", "coverage_not_drawn")
def test_the_tutorial_runs_from_top_to_bottom(tmp_path: Path, monkeypatch, capsys) -> None:
    make_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    page = REPOSITORY / "docs" / "tutorial.md"
    (job,) = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    (tmp_path / "shot.job.yaml").write_text(job, encoding="utf-8")
    lines = commands(page)
    assert len(lines) > 8
    for line in lines:
        code = run(line)
        said = capsys.readouterr()
        assert code == 0, f"{line}\n{said}"
        if line.startswith("usdface check"):  # the job is what the commands before it did
            assert said.out.count("up to date") == job.count("{step:")
        if line.startswith("usdface run"):
            assert said.out.count("up to date") == job.count("{step:")
            assert "wrote" not in said.out
    assert (tmp_path / "map.yaml").is_file()
    assert (tmp_path / "shot.sheet.jpg").is_file()


def test_every_command_of_the_readme_is_understood(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    for line in commands(REPOSITORY / "README.md"):
        words = shlex.split(line)
        if words[0] == "python3":
            monkeypatch.setattr("sys.argv", [words[1], "--help"])
            with pytest.raises(SystemExit, match="0"):
                develop()
            assert words[2] in capsys.readouterr().out
        elif words[1] in ("run", "check"):
            assert run(f"{words[0]} {words[1]} --help") == 0
        else:
            Path("spec.yaml").unlink(missing_ok=True)
            assert run(f"{line} --save-spec spec.yaml") == 0, line
            assert Path("spec.yaml").read_text(encoding="utf-8").startswith("step: ")


def test_examples_in_the_help_are_understood(tmp_path: Path, monkeypatch) -> None:
    from usdface.specs.job import STEP_SPECS

    monkeypatch.chdir(tmp_path)
    for spec in STEP_SPECS:
        assert run(f"{spec.example} --save-spec {spec.model_fields['step'].default}.yaml") == 0


CUT = """#usda 1.0
(
    metersPerUnit = 0.01
    subLayers = [@shot.hero.usda@]
)
def Scope "Cut"
{
    def Camera "main"
    {
        double3 xformOp:translate = (0, 3, 70)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"""
"""A cut whose camera looks at the character."""


@pytest.mark.usefixtures("without_comparison", "coverage_not_drawn")
def test_the_review_page_runs(shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    (shot / "cut010.usda").write_text(CUT, encoding="utf-8")
    version = PerformanceReader(shot / "shot.hero.usda").version
    note = {"id": "a", "frame": 333, "version": version, "shape": "jawOpen", "add": 0.1}
    notes = json.dumps({"usdface_notes": 1, "notes": [note]})
    (shot / "shot.hero.notes.json").write_text(notes, encoding="utf-8")
    for line in commands(REPOSITORY / "docs" / "review.md"):
        command = line.split()[1]
        if command == "tune":  # a server; it has tests of its own
            continue
        small = {
            "sheet": " --tile 64 --quality draft --rows 2",
            "movie": " --height 64 --rate 3 --workers 1",
            "report": " --height 120 --frames 1-60",
        }
        replacing = "" if command == "edit" else " --overwrite"
        code = run(f"{line}{small.get(command, '')}{replacing}")
        assert code == 0, f"{line}\n{capsys.readouterr()}"
    assert (shot / "shot.review.mp4").is_file()


def test_every_command_of_the_references_page_is_understood(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = commands(REPOSITORY / "docs" / "references.md")
    assert len(lines) == 13
    for line in lines:
        Path("spec.yaml").unlink(missing_ok=True)
        assert run(f"{line} --save-spec spec.yaml") == 0, line


@pytest.mark.usefixtures("without_comparison", "placement_not_drawn", "coverage_not_drawn")
@pytest.mark.parametrize("page", ["edits", "checks"])
def test_the_pages_on_edits_and_checks_run(page: str, shot: Shot, monkeypatch, capsys) -> None:
    monkeypatch.chdir(shot.folder)
    lines = commands(REPOSITORY / "docs" / f"{page}.md")
    assert lines
    for line in lines:
        # Comparing the methods takes long, and is tested elsewhere.
        code = run(f"{line} --method face_map" if line.startswith("usdface train ") else line)
        assert code == 0, f"{line}\n{capsys.readouterr()}"


@pytest.mark.usefixtures("without_comparison", "placement_not_drawn", "coverage_not_drawn")
def test_the_page_on_any_mesh_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    search_from_few_starts(monkeypatch)
    scan = small_scan()
    write_scan(tmp_path / "scan.usdc", scan)
    write_take(tmp_path / "talk.take.usda", small_scan_take(scan), provenance=Provenance())
    monkeypatch.chdir(tmp_path)
    lines = commands(REPOSITORY / "docs" / "deform.md")
    assert len(lines) == 6
    for line in lines:
        draft = " --quality draft" if "--picture" in line else ""
        assert run(line + draft) == 0, f"{line}\n{capsys.readouterr()}"
    for name in ("scan.binding.jpg", "talk.scan.jpg", "talk.acted.usda"):
        assert (tmp_path / name).is_file()
    assert read_image_metadata(tmp_path / "talk.scan.jpg")["step"] == "deform"
    weights = read_performance(tmp_path / "talk.acted.usda").weights.values
    assert weights.shape[1] == 6
    assert weights.max() > 0.8, "the scan acts"


def test_the_page_about_retargeting_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    human, dog = write_human(Path("human.usda")), write_creature(Path("dog.usda"))
    rng = np.random.default_rng(0)
    poses = np.concatenate([np.zeros((1, 3)), np.eye(3), rng.random((20, 3))])
    write_human_performance(Path("kitchen.human.usda"), human, human_moves(200))
    write_human_performance(Path("human_poses.usda"), human, poses, first=1)
    write_creature_performance(Path("dog_poses.usda"), dog, creature_acts(poses))
    write_creature_performance(Path("dog_surprise.usda"), dog, creature_acts(human_moves(50)))
    lines = commands(REPOSITORY / "docs" / "retarget.md")
    assert len(lines) == 12
    for line in lines:
        code = run(line)
        if "--source-rig human.usda --rig" in line:
            assert code == 2
            assert "too flat for a face" in capsys.readouterr().err  # so are these three points
            continue
        assert code == 0, f"{line}\n{capsys.readouterr()}"
    for name in ("kitchen.warped.usda", "kitchen.faces.jpg", "kitchen.cyclic.jpg"):
        assert Path(name).is_file()
