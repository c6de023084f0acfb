"""The command line: what it prints, what it returns, what it refuses."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from pxr import Sdf, Vt
from typer.core import TyperGroup

from tests.usdio.small_rig import small_rig
from usdface.cli import main
from usdface.cli.app import make_app
from usdface.cli.command_list import HEADINGS
from usdface.cli.console import show_result
from usdface.core.errors import InputError
from usdface.core.version import __version__
from usdface.demo.job import make_folder
from usdface.runner.result import StepResult
from usdface.specs.capture import IngestSpec
from usdface.usdio.rig.write import write_rig


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    return int(stopped.value.code or 0)


@pytest.mark.parametrize("command", ["describe", "validate", "edits list", "names"])
def test_commands_that_print_refuse_folders_and_pipes(
    tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, pipe = tmp_path / "takes.usda", tmp_path / "pipe.usda"
    folder.mkdir()
    os.mkfifo(pipe)
    write_rig(tmp_path / "rig.usda", small_rig())
    first = [str(tmp_path / "rig.usda")] if command == "names" else []
    assert run(*command.split(), *first, str(folder)) == 2
    assert f"a folder; {command} reads files: name them" in capsys.readouterr().err
    assert run(*command.split(), *first, str(pipe)) == 2
    assert "pipe.usda: a pipe or a device, not a file" in capsys.readouterr().err


def test_the_installed_command_tells_its_version() -> None:
    command = Path(sys.executable).with_name("usdface")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"usdface {__version__}\n"


ERRORS = ("strict", "backslashreplace")
"""What Python does with letters that the locale lacks, on standard output and standard error."""


@pytest.mark.parametrize("as_json", [(), ("--json",)])
def test_names_are_printed_in_locales_that_lack_their_letters(
    tmp_path: Path, as_json: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_rig(tmp_path / "顔.usda", small_rig())
    monkeypatch.chdir(tmp_path)
    for out, code in (("a.csv", 0), ("無/a.csv", 2)):
        shown, told = (io.TextIOWrapper(io.BytesIO(), "ascii", how) for how in ERRORS)
        monkeypatch.setattr(sys, "stdout", shown)
        monkeypatch.setattr(sys, "stderr", told)
        assert run("names", "顔.usda", "--out", out, *as_json) == code
        shown.flush()
        printed = shown.buffer.getvalue().decode("ascii")
        if as_json:
            assert out in json.dumps(json.loads(printed), ensure_ascii=False)


GROUPS = ("references", "pairs", "edits")


@pytest.mark.parametrize("command", sorted(set(make_app(listed=True).commands) - set(GROUPS)))
def test_every_command_answers_help_with_an_example(command: str, capsys) -> None:
    assert run(command, "--help") == 0
    told = capsys.readouterr().out
    assert "Example:" in told
    assert f"usdface {command}" in told
    assert "Exit codes: 0 done, 1 a check failed, 2 bad input, 3 interrupted." in told


def test_validate_passes_a_sound_layer_and_names_what_is_wrong(
    tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.usda", small_rig())
    assert run("validate", "rig.usda") == 0
    assert "1 layer: 0 errors, 0 warnings" in capsys.readouterr().out
    layer = Sdf.Layer.FindOrOpen("rig.usda")
    prim = Sdf.CreatePrimInLayer(layer, "/Hero/anim")
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "SkelAnimation"
    names = Sdf.AttributeSpec(prim, "blendShapes", Sdf.ValueTypeNames.TokenArray)
    names.default = Vt.TokenArray(["jawOpen", "grin"])
    Sdf.AttributeSpec(prim, "blendShapeWeights", Sdf.ValueTypeNames.FloatArray)
    layer.SetTimeSample("/Hero/anim.blendShapeWeights", 1, [0.5])
    layer.Save()
    assert run("validate", "rig.usda", "--json") == 1
    captured = capsys.readouterr()
    found = json.loads(captured.out)["figures"]["rig.usda"]
    told = " ".join(finding["message"] for finding in found)
    assert "1 weights for 2 shapes" in told
    assert "1 shapes are on no mesh: grin" in told
    assert "timeCodesPerSecond is not authored" in told
    assert "errors in 1 layer" in captured.err


def test_json_is_the_only_thing_on_standard_output(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.usda", small_rig())
    assert run("validate", "rig.usda", "--json") == 0
    assert json.loads(capsys.readouterr().out)["failures"] == []


def test_farm_progress_is_spoken_in_the_farms_language(tmp_path, capsys) -> None:
    from usdface.cli.console import progress_listener

    with progress_listener("openjd") as progress:
        progress(0.25, "mapping")
    assert capsys.readouterr().out == "openjd_progress: 25.0\nopenjd_status: mapping\n"


def test_a_farm_is_not_told_of_every_block_but_of_the_end(monkeypatch, capsys) -> None:
    from usdface.cli import console

    monkeypatch.setattr(console.time, "monotonic", lambda: 0.0)  # all within a second
    with console.progress_listener("openjd") as progress:
        for frame in range(10_001):
            progress(frame / 10_000, f"mapped to frame {frame}")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 2 * 101
    assert lines[-2:] == ["openjd_progress: 100.0", "openjd_status: mapped to frame 10000"]


def test_unknown_options_and_missing_ones_are_bad_input(capsys) -> None:
    assert run("clean", "x.usda", "--out", "y.usda", "--polish") == 2
    assert run("clean", "x.usda") == 2
    assert "--out" in capsys.readouterr().err


def test_the_demo_refuses_a_folder_that_holds_something_else(tmp_path: Path, capsys) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    assert run("demo", "--out", str(tmp_path)) == 2
    assert "holds no demo; choose another --out" in capsys.readouterr().err
    assert [each.name for each in tmp_path.iterdir()] == ["thesis.txt"]


def test_an_interrupted_demo_can_be_run_again(tmp_path: Path) -> None:
    folder, job = tmp_path / "demo", tmp_path / "demo" / "demo.job.yaml"
    make_folder(folder, job)
    (folder / "character.usdc").write_text("half of it")
    make_folder(folder, job)
    job.unlink()
    with pytest.raises(InputError, match="holds no demo"):
        make_folder(folder, job)


def test_a_bug_is_reported_as_one_and_not_as_the_users_fault(monkeypatch, capsys) -> None:
    from usdface.steps.performance import describe

    def broken(path: Path, **options: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(describe, "describe_mapping", broken)
    assert run("describe", "x.usda") == 2
    assert "internal error: ZeroDivisionError: oops" in capsys.readouterr().err


def test_a_line_end_in_a_name_begins_no_second_message_to_the_farm(capsys) -> None:
    from usdface.cli.console import progress_listener

    with progress_listener("openjd") as progress:
        progress(1.0, "mapped kitchen\nopenjd_env: PATH=/tmp\r\nopenjd_fail: no")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["openjd_progress", "openjd_status"]


def test_a_farm_is_told_why_a_task_failed(capsys) -> None:
    from usdface.cli.console import progress_listener

    with pytest.raises(InputError), progress_listener("openjd"):
        raise InputError("kitchen.usda: is no take\nrecord it again")
    told = capsys.readouterr().out
    assert told == "openjd_fail: kitchen.usda: is no take record it again\n"


def test_a_farms_worker_makes_the_folders_it_writes_to(tmp_path: Path, capsys) -> None:
    job = tmp_path / "job.yaml"
    job.write_text("{step: clean, take: x.usda, out: parts/deep/out.usda}")
    assert run("run", str(job), "--make-folders") == 2  # there is no take
    assert (tmp_path / "parts" / "deep").is_dir()
    assert "x.usda: no such file" in capsys.readouterr().err


@pytest.mark.parametrize(("level", "color"), [("good", 32), ("check", 33), ("bad", 31)])
def test_a_verdict_is_the_last_line_and_coloured_on_a_terminal(
    level: str, color: int, monkeypatch, capsys
) -> None:
    result = StepResult((Path("x.usda"),), "Check: as it is", ("a note",), level=level)
    show_result(result, as_json=False)
    assert capsys.readouterr().out.splitlines()[-1] == "Check: as it is"
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    show_result(result, as_json=False)
    assert f"\x1b[{color}m" in capsys.readouterr().out.splitlines()[-1]


def test_control_characters_of_names_in_files_do_not_reach_the_terminal(capsys) -> None:
    show_result(StepResult((), "1 frame", ("label \x1b[2J\x00", "two\nlines")), as_json=False)
    assert capsys.readouterr().out == "1 frame\n  note: label  [2J \n  note: two\nlines\n"


def test_a_log_gets_a_line_of_progress_now_and_then(monkeypatch, capsys) -> None:
    from usdface.cli import console

    now = [100.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress_listener("auto") as progress:  # pytest is no terminal
        for second in range(30):
            now[0] = 100.0 + second
            progress(second / 30, f"frame {second}")
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == ["  7% frame 2", " 40% frame 12", " 73% frame 22"]
    with console.progress_listener("auto") as progress:
        progress(0.5, "short")
        progress(1.0, "done")
    assert capsys.readouterr().err == ""


def test_every_command_is_listed_under_a_heading() -> None:
    group = make_app()
    assert isinstance(group, TyperGroup)
    assert {command.rich_help_panel for command in group.commands.values()} == set(HEADINGS)


def test_a_wrong_name_in_a_group_is_refused_with_the_nearest(capsys) -> None:
    assert run("pairs", "imprt") == 2
    assert "Did you mean 'import'?" in capsys.readouterr().err


def test_a_list_of_commands_says_what_each_says_of_itself(capsys) -> None:
    """Whole summaries, which click would cut to a line."""
    assert run("--help") == 0
    listed = " ".join(capsys.readouterr().out.split())
    for name, command in make_app().commands.items():
        assert f"{name} {command.get_short_help_str(500)}" in listed


def test_the_list_of_commands_says_whole_sentences(capsys) -> None:
    assert run("--help") == 0
    told = capsys.readouterr().out
    assert "...\n" not in told.replace("[ARGS]...", "")
    assert told.index("Capture:") < told.index("Review:")
    assert "Find the time offset and clock drift between video and capture" in " ".join(
        told.split()
    )


@pytest.mark.parametrize(
    "given", [["--panels", "markers, performance"], ["--panels", "markers", "--panels=performance"]]
)
def test_names_are_given_with_commas_or_one_by_one(tmp_path: Path, given: list[str]) -> None:
    """Of an option given twice the last alone counted, and nothing said so."""
    line = ["movie", "a.usda", "--take", "t.usda", "--out", "m.mp4"]
    saved = tmp_path / "movie.yaml"
    assert run(*line, *given, "--save-spec", str(saved)) == 0
    assert yaml.safe_load(saved.read_text())["panels"] == ["markers", "performance"]
    assert run(*line, "--save-spec", str(saved)) == 2  # a file is never written over
    saved.unlink()
    assert run(*line, "--save-spec", str(saved)) == 0
    assert "panels" not in yaml.safe_load(saved.read_text())
    assert run(*line, "--panels", "faces", "--save-spec", str(saved)) == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is always full")
@pytest.mark.parametrize(
    "line", ["--version", "--help", "map -h", "check job.yaml", "check job.yaml --json"]
)
def test_output_that_nobody_can_keep_is_an_error_in_words(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("job.yaml").write_text(JOB_OF_ONE)
    Path("a.usda").write_text("#usda 1.0\n")
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert run(*line.split()) == 2
    said = capfd.readouterr().err
    assert "standard output cannot be written (No space left on device)" in said


JOB_OF_ONE = "step: bake\nperformance: a.usda\nout: b.usda\n"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("a\\b.usda", "cannot be part of a name"),
        ("a\nb.usda", "cannot be part of a name"),
        (f"{'x' * 250}.usda", "the name is too long"),
        (f"{'x' * 400}.usda", "the name is too long"),
    ],
)
def test_a_name_that_nothing_could_refer_to_is_refused(
    name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("x")
    assert run("ingest", "a.csv", "--out", name.replace(".usda", ".take.usda")) == 2
    assert reason in capsys.readouterr().err
    assert [each.name for each in tmp_path.iterdir()] == ["a.csv"]


def test_a_demo_from_video_needs_a_model_before_anything_is_made(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.delenv("USDFACE_FACE_MODEL", raising=False)
    out = tmp_path / "demo"
    assert run("demo", "--from", "video", "--out", str(out)) == 2
    assert "no model is named" in capsys.readouterr().err
    assert run("demo", "--model", "x.task", "--out", str(out)) == 2
    assert "--model has no effect without --from video" in capsys.readouterr().err
    assert run("demo", "--from", "video", "--model", "x.task", "--out", str(out)) == 2
    assert "x.task: no such file" in capsys.readouterr().err
    assert not out.exists()


def test_help_is_where_people_look_for_it(capsys) -> None:
    assert run("map", "--help") == 0
    shown = capsys.readouterr().out
    for arguments in (("help", "map"), ("map", "-h")):
        assert run(*arguments) == 0
        assert capsys.readouterr().out == shown
    assert run("help", "references", "import") == 0
    assert "usdface references import" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("shell", "given"),
    [
        ("bash", {"COMP_WORDS": "usdface map --ta", "COMP_CWORD": "2"}),
        ("zsh", {"_TYPER_COMPLETE_ARGS": "usdface map --ta"}),
        (
            "fish",
            {
                "_TYPER_COMPLETE_ARGS": "usdface map --tem",
                "_TYPER_COMPLETE_FISH_ACTION": "get-args",
            },
        ),
    ],
)
def test_a_shell_completes_commands_and_options(
    shell: str,
    given: dict[str, str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert run("completion", shell) == 0
    assert f"_USDFACE_COMPLETE=complete_{shell}" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["usdface"])
    for name, text in given.items():
        monkeypatch.setenv(name, text.replace("--ta", "--tem"))
    monkeypatch.setenv("_USDFACE_COMPLETE", f"complete_{shell}")
    assert run() == 0
    assert "--temporal" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ("map", "no.usda", "--mapping", "m", "--rig", "r", "--out", "o.usda", "--json"),
        ("map", "--json"),
        ("run", "no.job.yaml", "--json"),
    ],
)
def test_an_error_is_json_where_a_script_asked_for_it(arguments, capsys) -> None:
    assert run(*arguments) == 2
    shown = capsys.readouterr()
    assert json.loads(shown.out)["exit_code"] == 2
    assert json.loads(shown.out)["error"].splitlines()[0] in shown.err


def test_a_folder_where_a_file_is_read_is_refused(tmp_path, capsys) -> None:
    assert run("phones", str(tmp_path), "--text", "a", "--out", str(tmp_path / "a.json")) == 2
    assert "a folder; phones reads files" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("deform", "t", "--mesh", "m", "--method", "rbf", "--sampler", "hmc"),
            "--method rbf does not use --sampler",
        ),
        (
            ("map", "t", "--mapping", "m", "--rig", "r", "--lag", "5"),
            "lag has no effect with temporal none",
        ),
        (("deform", "t", "--mesh", "m", "--rows", "3"), "rows has no effect without picture"),
        (("bind", "t", "m", "--quality", "draft"), "quality has no effect without picture"),
        (
            ("sheet", "p", "--camera-stage", "shot.usda"),
            "camera_stage has no effect without camera",
        ),
        (("movie", "p", "--camera-stage", "s"), "camera_stage has no effect without camera"),
        (("sheet", "p", "--layout", "strip", "--no-baseline"), "with layout strip"),
        (
            ("sheet", "p", "--frames", "1,4", "--rows", "3"),
            "--rows has no effect with listed --frames",
        ),
        (("bake", "p", "--unit", "mm"), "unit has no effect without tolerance"),
        (
            ("cyclic", "x", "--source", "s", "--methods", "rbf", "--published"),
            "published has no effect with methods rbf",
        ),
        (
            ("select", "t", "--rig", "r", "--landmarks", "l.csv", "--placement", "p"),
            "landmarks has no effect with placement",
        ),
        (
            ("deform", "t", "--mesh", "m", "--choose-blend", "--blend", "0.5"),
            "blend has no effect with choose_blend",
        ),
        (
            ("make-shapes", "t", "--mesh", "m", "--count", "3", "--names", "n.csv"),
            "count has no effect with names",
        ),
        (
            ("pairs", "propose", *"--source s --target t --names n.csv --match name".split()),
            "match has no effect with names",
        ),
    ],
)
def test_an_option_that_would_be_ignored_is_refused(arguments, message, capsys) -> None:
    out = {"sheet": "o.jpg", "movie": "o.mp4", "cyclic": "o.json"}.get(arguments[0], "o.usda")
    assert run(*arguments, "--out", out) == 2
    assert message in capsys.readouterr().err


def test_words_of_an_option_are_taken_in_any_case(capsys) -> None:
    assert run("ingest", "missing.c3d", "--up", "-Z", "--units", "MM", "--out", "x.usda") == 2
    assert "missing.c3d: no such file" in capsys.readouterr().err
    assert IngestSpec(sources=("a.c3d",), up="Z", out="x.usda").up == "z"


def test_values_that_an_option_does_not_take_are_said_in_our_words(capsys) -> None:
    for given, words in (
        (("--units", "mete"), "'--units': 'mete' is not one of 'mm', 'cm', 'm', 'in'"),
        (("--rate", "abc"), "'--rate': give a number (got 'abc')"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["ingest", "x.c3d", "--out", "x.take.usda", *given])
        assert ended.value.code == 2
        told = capsys.readouterr().err
        assert words in told
        assert "Value error" not in told


@pytest.mark.parametrize("command", sorted(make_app(listed=True).commands))
def test_a_command_by_itself_has_the_options_that_it_has_among_all(command: str) -> None:
    def options(name: str, found: Any) -> dict[str, list[str]]:
        inner = getattr(found, "commands", {})
        own = {name: [each.name for each in found.params]}
        return own | {k: v for n, c in inner.items() for k, v in options(f"{name} {n}", c).items()}

    alone, among_all = make_app(command).commands, make_app().commands
    assert list(alone) == [command]
    assert options(command, alone[command]) == options(command, among_all[command])
