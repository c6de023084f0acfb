"""The benchmarks' runner: what is printed is what is kept."""

import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from benchmarks import __main__ as runner
from benchmarks._index import is_met
from benchmarks._log_plot import HEIGHT, Line, log_plot
from benchmarks._power_law import fit_power_law
from benchmarks._report import Measured, machine, read_tables, write_report

TEXT = "On a head.\n\n| measure | value |\n|---|---|\n| speed | 3× |\n| size | 2 MB |\n\nDone.\n"


def test_every_benchmark_can_be_run_by_name() -> None:
    assert {"crosstake", "warp", "manifold", "review"} <= set(runner.names())
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


def test_a_power_law_is_found_again_and_noise_is_in_its_spread() -> None:
    sizes = np.array([10.0, 20.0, 40.0, 80.0, 160.0])
    exact = fit_power_law(sizes, 3e-4 * sizes**1.7)
    assert exact.exponent == pytest.approx(1.7)
    assert exact.last == pytest.approx(1.7)
    assert exact.factor == pytest.approx(3e-4)
    assert exact.spread == pytest.approx(0.0, abs=1e-9)
    noise = np.exp(np.random.default_rng(0).normal(0, 0.1, (2000, len(sizes))))
    found = [fit_power_law(sizes, 3e-4 * sizes**1.7 * each) for each in noise]
    true = np.std([each.exponent for each in found])
    assert np.sqrt(np.mean([each.spread**2 for each in found])) == pytest.approx(true, rel=0.05)


def test_what_is_paid_once_flattens_the_law_and_least_at_its_end() -> None:
    sizes = [100.0, 200.0, 400.0, 800.0]
    law = fit_power_law(sizes, [1.0 + 0.01 * size for size in sizes])
    assert law.exponent < law.last < 1.0


def test_two_sizes_have_no_spread_and_one_has_no_law() -> None:
    assert math.isnan(fit_power_law([1, 2], [1, 2]).spread)
    with pytest.raises(ValueError, match="two or more positive"):
        fit_power_law([1], [1])
    with pytest.raises(ValueError, match="two or more positive"):
        fit_power_law([1, 2], [0.0, 1])


def test_a_plot_names_every_line_and_keeps_the_names_apart() -> None:
    names = [f"call <{number}>" for number in range(7)]
    lines = [Line(name, "#000000", [10, 100], [0.1, 1.0], (0.1, 1.0)) for name in names]
    drawn = log_plot("Time", "frames", lines)
    assert drawn == log_plot("Time", "frames", lines)  # no date, no random names
    texts = [each for each in ElementTree.fromstring(drawn).iter() if each.tag.endswith("text")]
    places = {each.text: float(each.get("y", "nan")) for each in texts}
    assert {"Time", "frames", "linear", *names} <= set(places)
    heights = sorted(places[name] for name in names)
    assert min(np.diff(heights)) >= 14
    assert heights[-1] < HEIGHT


def test_a_benchmark_with_pictures_leaves_them_beside_its_table(tmp_path, monkeypatch) -> None:
    def run(*, pictures: Path | None = None) -> None:
        sys.stdout.write("| a | b |\n|---|---|\n| 1 | 2 |\n")
        if pictures is not None:
            (pictures / "drawn.svg").write_text("<svg/>", encoding="utf-8")
            sys.stdout.write("\n![drawn](drawn.svg)\n")

    monkeypatch.setattr(runner, "import_module", lambda name: SimpleNamespace(run=run))
    out = tmp_path / "kept"
    monkeypatch.setattr("sys.argv", ["benchmarks", "scaling", "--out", str(out)])
    assert runner.main() == 0
    assert (out / "drawn.svg").is_file()
    assert "![drawn](drawn.svg)" in (out / "scaling.md").read_text(encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["benchmarks", "scaling"])
    assert runner.main() == 0


def test_a_benchmark_that_fails_does_not_stop_the_others(tmp_path, monkeypatch, capsys) -> None:
    def fail() -> None:
        raise RuntimeError("no such machine")

    def tell() -> None:
        sys.stdout.write(TEXT)

    ran = {"first": SimpleNamespace(run=fail), "second": SimpleNamespace(run=tell)}
    monkeypatch.setattr(runner, "names", lambda: ["first", "second"])
    monkeypatch.setattr(runner, "import_module", lambda name: ran[name.rpartition(".")[2]])
    monkeypatch.setattr(sys, "argv", ["benchmarks", "--out", str(tmp_path)])
    assert runner.main() == 1
    told = capsys.readouterr().err
    assert "no such machine" in told
    assert told.endswith("failed: first\n")
    assert (tmp_path / "second.md").is_file()
    assert not (tmp_path / "first.md").exists()
