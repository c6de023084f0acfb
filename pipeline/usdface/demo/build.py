"""Write all that a first walk through the pipeline needs: rig, capture, clip, animator's keys."""

import csv
from dataclasses import dataclass
from pathlib import Path

from usdface.capture.c3d_write import write_c3d
from usdface.core.arrays import columns_by_name
from usdface.core.assets import WeightsClip
from usdface.core.progress import Progress, part, silent
from usdface.demo.acting import FIRST_FRAME, Interval, performance
from usdface.demo.capture import simulate_capture
from usdface.demo.clip import OFFSET_SECONDS, write_clip
from usdface.demo.markers import demo_markers
from usdface.demo.proportions import ACTOR
from usdface.demo.rig import demo_rig
from usdface.demo.shapes import make_head
from usdface.usdio.rig.write import write_rig


@dataclass(frozen=True)
class DemoInputs:
    """The files of the built-in demo and what a user would have to know about them."""

    rig: Path
    """The character: a UsdSkel asset."""
    capture: Path
    """The actor's markers, C3D at 120 Hz [mm], Y up."""
    video: Path
    """The actor on camera, with sound."""
    animator_weights: Path
    """CSV: `frame` (of the capture), then one column per shape of the rig."""
    transcript: Path
    """What is said, as plain text."""
    rigid_markers: tuple[str, ...]
    """Names of the markers that move with the skull alone."""
    neutral_frame: int
    """Frame of the capture at which the face is at rest."""
    video_offset_seconds: float
    """Take time of the video's first frame [s]."""
    emotions: tuple[Interval, ...]
    """Moods by capture frames."""
    phones: tuple[Interval, ...]
    """Sounds by capture frames."""
    truth: WeightsClip
    """The animator's weights on every frame, of the shapes that the performance uses."""


def write_demo_inputs(folder: Path, *, workers: int = 2, progress: Progress = silent) -> DemoInputs:
    """Generate the demo's inputs.

    Parameters
    ----------
    folder : Path
        Created if missing; files of the same names are replaced.
    workers : int
        Processes that draw the video.

    Returns
    -------
    DemoInputs
        The same content on every call.
    """
    folder.mkdir(parents=True, exist_ok=True)
    progress(0.0, "sculpting the character")
    rig_file = folder / "character.usdc"
    character = demo_rig()
    write_rig(rig_file, character)
    progress(0.10, "casting the actor")
    actor = make_head(ACTOR)
    acted = performance()
    markers = demo_markers(actor)
    progress(0.15, "capturing the actor")
    captured = simulate_capture(actor, acted, markers)
    capture_file = folder / "actor.c3d"
    write_c3d(
        capture_file,
        captured.positions,
        captured.visible,
        markers.names,
        rate=acted.weights.rate,
        first_frame=FIRST_FRAME,
    )
    weights_file = folder / "animator_weights.csv"
    _write_weights(weights_file, acted.weights, character.shapes)
    transcript_file = folder / "transcript.txt"
    transcript_file.write_text(acted.transcript + "\n", encoding="utf-8")
    video_file = folder / "actor.mp4"
    write_clip(video_file, actor, acted, workers=workers, progress=part(progress, 0.2, 1.0))
    return DemoInputs(
        rig=rig_file,
        capture=capture_file,
        video=video_file,
        animator_weights=weights_file,
        transcript=transcript_file,
        rigid_markers=markers.rigid,
        neutral_frame=acted.neutral_frame,
        video_offset_seconds=OFFSET_SECONDS,
        emotions=acted.emotions,
        phones=acted.phones,
        truth=acted.weights,
    )


def _write_weights(path: Path, weights: WeightsClip, shapes: tuple[str, ...]) -> None:
    """Write what an animator keys: every shape of the rig, those left alone at 0."""
    keyed = columns_by_name(weights.values, weights.names, shapes)
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", *shapes])
        for number, row in enumerate(keyed, start=weights.first_frame):
            writer.writerow([number, *(f"{value:.4f}" for value in row)])
