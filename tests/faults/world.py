"""A small folder that holds what every step reads and writes, made by running them all once."""

import shutil
import wave
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tests.conftest import SHARED_DATA
from tests.faults.commands import ALL_STEPS, BEFORE, COMMANDS, contents, finish
from tests.numerics.simulated_sound import Recorder, record, speech
from tests.small_scan import small_scan, small_scan_take, write_scan
from tests.steps.capture.test_align import make_take, write_video, write_wav
from tests.steps.retarget.test_retarget_steps import build
from tests.steps.small_shot import make_inputs
from tests.usdio.small_creature import creature_acts, write_creature_performance
from usdface.core.provenance import Provenance
from usdface.media.film.sound import read_audio
from usdface.usdio.take.write import write_take

SPOKEN_SECONDS, SPOKEN_WORDS = 4, 9
"""So much of a recording; four seconds hold these words."""
RECORDING = SHARED_DATA / "speech_mfa"
MODEL = SHARED_DATA / "models" / "face_landmarker.task"
FACE = SHARED_DATA / "video_pyfeat" / "single_face.mp4"


@dataclass(frozen=True)
class World:
    """A finished folder; read only.

    Attributes
    ----------
    folder : Path
    made : dict
        By step, the files that were not there before it.
    """

    folder: Path
    made: dict[str, frozenset[str]]


def steps_here() -> tuple[str, ...]:
    """Every step that can be run here.

    Phones need a recording of somebody who speaks, tracking a face, its model and the extra.
    """
    missing = set() if RECORDING.is_dir() else {"phones"}
    if not (MODEL.is_file() and FACE.is_file() and find_spec("mediapipe")):
        missing.add("track")
    return tuple(step for step in ALL_STEPS if step not in missing)


def build_world(folder: Path) -> World:
    """Write every input, then run every step, in the order of a day's work."""
    make_inputs(folder)
    stall = build(folder)
    own = creature_acts(np.sin(np.pi * np.linspace(0, 1, 61)[:, None]) * [0.1, 0.6, 1.0])
    write_creature_performance(folder / "own.usda", stall.beast, own)
    scan = small_scan()
    write_take(folder / "talk.take.usda", small_scan_take(scan), provenance=Provenance())
    write_scan(folder / "scan.usdc", scan, z_up=True)
    _write_sounds(folder)
    if "track" in steps_here():
        shutil.copy(MODEL, folder / MODEL.name)
        shutil.copy(FACE, folder / "face.mp4")
    made: dict[str, frozenset[str]] = {}
    for step in steps_here():
        for words in BEFORE.get(step, ()):
            finish(folder, words)
        before = contents(folder)
        finish(folder, COMMANDS[step])
        made[step] = frozenset(contents(folder).keys() - before.keys())
    return World(folder, made)


def _write_sounds(folder: Path) -> None:
    rng = np.random.default_rng(0)
    rate = 32_000
    event = speech(10.0, rng)
    capture = Recorder(start=0.3, seconds=9.0, rate=rate, ppm=30, snr_db=30)
    camera = Recorder(start=2.05, seconds=6.0, rate=rate, ppm=-40, snr_db=12)
    write_video(folder / "kitchen.mov", record(event, camera, rng))
    write_wav(folder / "capture.wav", record(event, capture, rng))
    make_take(folder)
    (folder / "logic.csv").write_text("shape,parts\njawLeft,jawOpen jawRight\n")
    if RECORDING.is_dir():
        samples = read_audio(RECORDING / "wav" / "acoustic_corpus.wav")[: 16_000 * SPOKEN_SECONDS]
        words = (RECORDING / "lab" / "acoustic_corpus.lab").read_text().split()[:SPOKEN_WORDS]
        (folder / "voice.txt").write_text(" ".join(words))
        with wave.open(str(folder / "voice.wav"), "wb") as stream:
            stream.setnchannels(1)
            stream.setsampwidth(2)
            stream.setframerate(16_000)
            stream.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())


def copy_of(folder: Path, target: Path) -> Path:
    """Copy a folder, times of files included."""
    shutil.copytree(folder, target)
    return target
