"""Every command of the page on meshes without a rig runs, one after the other."""

from pathlib import Path

import pytest

from tests.small_scan import small_scan, small_scan_take, write_scan
from tests.test_docs import commands, run
from usdface.core.provenance import Provenance
from usdface.media.picture.image import read_image_metadata
from usdface.usdio.performance.read import read_performance
from usdface.usdio.take.write import write_take

PAGE = Path(__file__).resolve().parents[1] / "docs" / "deform.md"


@pytest.mark.usefixtures("without_comparison", "placement_not_drawn", "coverage_not_drawn")
def test_the_page_on_any_mesh_runs_from_top_to_bottom(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = small_scan()
    write_scan(tmp_path / "scan.usdc", scan)
    write_take(tmp_path / "talk.take.usda", small_scan_take(scan), provenance=Provenance())
    monkeypatch.chdir(tmp_path)
    lines = commands(PAGE)
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
