"""The files of the demo, read back by the readers that everything else uses."""

import csv
from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from usdface.capture.c3d import read_c3d_take
from usdface.capture.marker_take import CaptureOptions
from usdface.cli import main
from usdface.core.arrays import columns_by_name
from usdface.core.assets import WeightsClip
from usdface.demo.acting import ActedPerformance
from usdface.demo.build import (
    CLIP_SIZE,
    OFFSET_SECONDS,
    VIDEO_RATE,
    DemoInputs,
    Studio,
    film,
    weights_on_video,
    write_demo_inputs,
)
from usdface.demo.capture import head_poses
from usdface.demo.head import DemoHead
from usdface.demo.rig import rig_from_head
from usdface.demo.script import timed_phones
from usdface.media.film.sound import read_audio
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig


def test_the_rig_survives_usd(character: DemoHead, tmp_path: Path) -> None:
    rig = rig_from_head(character)
    write_rig(tmp_path / "character.usdc", rig)
    again = read_rig(tmp_path / "character.usdc")
    assert set(again.shapes) == set(rig.shapes)
    at = {mesh.path: mesh for mesh in again.meshes}
    for mesh in rig.meshes:
        np.testing.assert_allclose(at[mesh.path].points, mesh.points, atol=1e-3)
        assert len(at[mesh.path].shapes) == len(mesh.shapes)


def test_the_camera_sees_a_face_that_moves(actor: DemoHead, acted: ActedPerformance) -> None:
    studio = Studio(actor)
    clip = acted.weights
    weights = columns_by_name(clip.values[[30, 1020]], clip.names, tuple(actor.shapes))
    poses = head_poses(acted)[[30, 1020]]
    posed = [studio.pose(pose, row) for pose, row in zip(poses, weights, strict=True)]
    rest, angry = film(studio.meshes, posed)
    assert rest.shape == (CLIP_SIZE[1], CLIP_SIZE[0], 3)
    assert rest.std() > 20.0
    assert np.abs(rest.astype(int) - angry.astype(int)).mean() > 3.0


def test_the_clip_is_filmed_at_the_lines_asked_for(
    character: DemoHead, actor: DemoHead, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filmed = []
    monkeypatch.setattr("usdface.demo.build.demo_rig", lambda: rig_from_head(character))
    monkeypatch.setattr("usdface.demo.build.make_head", lambda sculpture: actor)
    monkeypatch.setattr("usdface.demo.build.drawing_processes", nullcontext)
    monkeypatch.setattr("usdface.demo.build.simulate_capture", _nothing_captured)
    monkeypatch.setattr("usdface.demo.build.write_c3d", lambda *args, **options: None)
    monkeypatch.setattr(
        "usdface.demo.build.write_clip", lambda *args, size, **options: filmed.append(size)
    )
    for lines in (240, 720):
        write_demo_inputs(tmp_path, video_lines=lines)
    assert filmed == [CLIP_SIZE, (648, 720)]


def _nothing_captured(*args: object) -> tuple[None, None]:
    return None, None


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ("--dog --from video", "--from and --model have no effect with --dog"),
        ("--dog --video-lines 720", "--video-lines has no effect with --dog"),
        ("--model x.task", "--model has no effect without --from video"),
    ],
)
def test_options_without_effect_on_the_demo_are_refused(
    options: str, refused: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["demo", "--out", str(tmp_path / "x"), *options.split()])
    assert stopped.value.code == 2
    assert refused in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> DemoInputs:
    return write_demo_inputs(tmp_path_factory.mktemp("demo"))


@pytest.mark.slow
def test_the_capture_reads_back_with_its_frames_and_rate(inputs: DemoInputs) -> None:
    options = CaptureOptions(rigid=inputs.rigid_markers, neutral=inputs.neutral_frame)
    take = read_c3d_take(inputs.capture, options).take
    assert take.rate == Fraction(120)
    assert take.first_frame == inputs.truth.first_frame
    assert take.frame_count == len(inputs.truth.values)
    assert take.markers is not None
    assert len(take.markers.names) == 102
    assert set(inputs.rigid_markers) <= set(take.markers.names)


@pytest.mark.slow
def test_the_animators_file_holds_the_truth(inputs: DemoInputs) -> None:
    with inputs.animator_weights.open(encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    values = np.array(rows[1:], float)
    np.testing.assert_array_equal(values[:, 0], np.arange(len(values)) + inputs.truth.first_frame)
    assert set(rows[0][1:]) == set(read_rig(inputs.rig).shapes)
    for name, truth in zip(inputs.truth.names, inputs.truth.values.T, strict=True):
        np.testing.assert_allclose(values[:, rows[0].index(name)], truth, atol=1e-4)


@pytest.mark.slow
def test_the_clip_runs_ahead_of_the_capture_by_its_offset(inputs: DemoInputs) -> None:
    """The first sound is heard when the script says, on the video's own clock."""
    sound = read_audio(inputs.video, rate=16000)
    assert len(sound) / 16000 > 15.0
    assert VIDEO_RATE == 24
    first = timed_phones()[1]
    loud = np.convolve(sound.astype(float) ** 2, np.ones(320) / 320, mode="same")
    heard = np.flatnonzero(loud > 0.05 * loud.max())[0] / 16000
    assert abs(heard + OFFSET_SECONDS - first.start) < 0.12


def test_keys_on_the_clip_are_those_of_the_moment_it_shows() -> None:
    """The camera ran before the capture did: its first frames show nothing that was keyed."""
    times = np.arange(1800)[:, None] / 120
    truth = WeightsClip(("jawOpen",), times.astype(np.float32), 1, Fraction(120))
    keys = weights_on_video(truth)
    assert keys.rate == VIDEO_RATE
    shown = (np.arange(len(keys.values)) + keys.first_frame - 1) / float(VIDEO_RATE)
    np.testing.assert_allclose(keys.values[:, 0], shown + OFFSET_SECONDS, atol=1e-6)
    assert 0 <= keys.values[0, 0] < 1 / VIDEO_RATE
