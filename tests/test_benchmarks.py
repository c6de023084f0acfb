"""The benchmarks' runner: what is printed is what is kept."""

import json
from pathlib import Path

import pytest

from tests.benchmarks import __main__ as runner
from tests.benchmarks._index import is_met
from tests.benchmarks._report import Measured, machine, read_tables, write_report

TEXT = "On a head.\n\n| measure | value |\n|---|---|\n| speed | 3× |\n| size | 2 MB |\n\nDone.\n"


def test_every_benchmark_can_be_run_by_name() -> None:
    assert {"capture", "crosstake", "warp", "manifold", "review"} <= set(runner.names())
    for name in runner.names():
        text = (Path(runner.__file__).parent / f"{name}.py").read_text(encoding="utf-8")
        assert "\ndef run(" in text, name


def test_tables_are_kept_for_people_and_for_scripts(tmp_path: Path) -> None:
    write_report(tmp_path, [Measured("speed", TEXT, 1.5, 0.2)])
    data = json.loads((tmp_path / "speed.json").read_text(encoding="utf-8"))
    assert data["tables"] == [
        [{"measure": "speed", "value": "3×"}, {"measure": "size", "value": "2 MB"}]
    ]
    assert data["machine"] == machine()
    assert "| speed | 3× |" in (tmp_path / "speed.md").read_text(encoding="utf-8")
    write_report(tmp_path, [Measured("size", TEXT, 1.0, 0.0)])
    index = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "speed.md" in index
    assert "size.md" in index


def test_two_tables_are_told_apart() -> None:
    assert [len(table) for table in read_tables(f"{TEXT}\n{TEXT}")] == [2, 2]


def test_an_unknown_benchmark_is_refused_by_name(monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks", "nope"])
    assert runner.main() == 2
    assert "no benchmark nope; there are alignment" in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["benchmarks", "--help"])
    with pytest.raises(SystemExit):
        runner.main()


@pytest.mark.parametrize(
    ("measured", "wanted", "met"),
    [
        ("0.107 mm", "< 0.3 mm", True),
        ("0.31 mm", "≤ 0.3 mm", False),
        ("12 of 12", "≥ 95 %", True),
        ("11 of 12", "≥ 95 %", False),
        ("2.11×", "linear", None),
        ("1.9", "1.8", False),
        ("1,200 frames", "≥ 1,000", True),
        ("some", "≤ 1", None),
    ],
)
def test_what_is_measured_is_held_against_what_is_wanted(measured, wanted, met) -> None:
    assert is_met(measured, wanted) is met


def test_the_index_says_which_claims_are_met(tmp_path: Path) -> None:
    table = "| measure | value | wanted |\n|---|---|---|\n| speed | 3× | ≤ 2 |\n| size | 1 | |\n"
    write_report(tmp_path, [Measured("speed", table, 1.0, 0.0)])
    index = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "| [speed](speed.md) | speed | ≤ 2 | 3× | **no** |" in index
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert [claim["met"] for claim in report["claims"]] == [False]
    write_report(tmp_path, [Measured("speed", table, 1.0, 0.0)])
    assert json.loads((tmp_path / "report.json").read_text(encoding="utf-8")) == report
