"""What is no capture says what to do with it."""

import shlex
from pathlib import Path

import pytest

from usdface.capture.sniff import read_capture, recognise_format
from usdface.cli import main
from usdface.core.confinement import ROOT_VARIABLE
from usdface.core.errors import InputError

MEDIAPIPE = ",".join(["frame", *(f"{axis}_{n}" for n in range(478) for axis in "xyz")])
DLIB = ",".join(["frame", *(f"x_{n}" for n in range(68)), *(f"y_{n}" for n in range(68))])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("talk.mp4", b"\0\0\0 ftypisom", r"is a movie, .*usdface track talk\.mp4 --out talk\.take"),
        ("talk.mov", b"", r"is a movie, which holds no markers: track the face in it"),
        ("scene.ma", b"//Maya ASCII", r"is a scene, which is not read: export the markers .* USD"),
        ("scene.fbx", b"Kaydara FBX", r"is a scene, .* or C3D"),
        ("walk.bvh", b"HIERARCHY", r"is a scene, which is not read"),
        ("a.json", b'[{"faceLandmarks": [[{"x": 0.5', r"landmarks in JSON.*usdface track"),
        ("a.json", b'{"frames": [{"landmarks": [', r"landmarks in JSON.* marker-csv"),
        (
            "a.json",
            b'{"faceLandmarks": [[{"x": 0.5}]], "faceBlendshapes": []}',
            r"landmarks in JSON",
        ),
        ("a.csv", MEDIAPIPE.encode(), r"holds MediaPipe's landmarks, .*usdface track"),
        ("a.pts", b"version: 1\nn_points: 68\n{\n", r"68 landmarks in the picture"),
        ("a.csv", DLIB.encode(), r"68 landmarks in the picture \(dlib, iBUG\), without depth"),
        ("x_frame_log.csv", b"V,0", r"frame log of Live Link Face.* MOV as --video"),
        ("notes.txt", b"hello", r"known are c3d .* and USD \(\.usd, \.usda, \.usdc, \.usdz\);"),
    ],
)
def test_what_is_no_capture_says_the_way(tmp_path: Path, name, content, message) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as refused:
        recognise_format(path)
    if name.endswith((".mp4", ".ma", ".fbx")):
        assert "begins with" not in str(refused.value)


@pytest.mark.parametrize("format", [None, "trc", "openface-csv", "face-cap"])
def test_a_capture_outside_the_confinement_is_refused_also_by_its_named_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, format
) -> None:
    (tmp_path / "show").mkdir()
    (tmp_path / "walk.trc").write_text("PathFileType\t4\n")
    monkeypatch.setenv(ROOT_VARIABLE, str(tmp_path / "show"))
    with pytest.raises(InputError, match="lies outside"):
        read_capture(tmp_path / "walk.trc", format=format)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            ["--video", "x.mp4"],
            "a video alone holds no markers: track the face in it with `usdface",
        ),
        ([], "name the capture file of the take"),
        (
            ["movies"],
            "holds 1 movie and no capture: track the face in each, as with `usdface track",
        ),
    ],
)
def test_ingest_without_a_capture_says_what_to_do(
    tmp_path: Path, monkeypatch, capsys, given, message
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "movies").mkdir()
    (tmp_path / "movies" / "a.mp4").write_bytes(b"x")
    with pytest.raises(SystemExit) as stopped:
        main(["ingest", *given, "--out", "a.take.usda"])
    assert stopped.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "a.take.usda").exists()


def test_a_proposed_command_can_be_pasted_though_a_name_has_spaces(tmp_path: Path) -> None:
    movie = tmp_path / "día 2 kitchen.mov"
    movie.write_bytes(b"moov")
    with pytest.raises(InputError) as refused:
        recognise_format(movie)
    command = str(refused.value).split("`")[1]
    assert shlex.split(command)[2:] == [movie.name, "--out", "día 2 kitchen.take.usda"]
