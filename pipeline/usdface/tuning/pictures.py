"""Picture, sound and head rotation of each pair, from the asset or the take's video."""

import io
import threading
import wave
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import ByteImage
from usdface.core.assets import References, Take
from usdface.core.errors import InputError
from usdface.media.film.timed_frames import OpenVideo
from usdface.media.film.video import open_video
from usdface.media.picture.image import encode_image, read_picture
from usdface.model.retarget.head_pose import HEAD
from usdface.steps.inputs.head_drive import take_head_source
from usdface.steps.review.clock import recorded_sound, sound_between
from usdface.usdio.references.read import PairNotes
from usdface.usdio.take.read import TakeReader

SOUND_RATE = 24000
"""[Hz] Speech has little energy above half of it."""
SOUND_SECONDS = 1.0
"""Before and after a pair's frame."""
CACHED_PICTURES = 64
"""Most encoded pictures in the cache."""


class PairPictures:
    """Pictures and sound of pairs, read on request. `notes`: one per pair."""

    def __init__(
        self, references: References, notes: Sequence[PairNotes], takes: Sequence[Path]
    ) -> None:
        self._references = references
        self._notes = notes
        self._faults: dict[str, str] = {}
        self._readers: dict[str, TakeReader] = {}
        self._takes = self._read_takes(takes)
        self._videos: dict[str, OpenVideo] = {}
        self._encoded = lru_cache(CACHED_PICTURES)(self._encode)
        self._recorded = lru_cache(1)(
            lambda name: recorded_sound(self._takes[name], [], SOUND_RATE)
        )
        self._guard = threading.Lock()  # of the decoders
        self._hearing = threading.Lock()

    def reason_without(self, pair: int) -> str:
        """Return the reason why a pair has no picture; empty if it should have one."""
        if self._notes[pair].image is not None:
            return ""
        return self._reason_without_video(self._references.takes[pair])

    def _reason_without_video(self, name: str) -> str:
        if name in self._faults:
            return self._faults[name]
        take = self._takes.get(name)
        if take is None:
            return f"the take {name} was not found; name its file with --takes"
        return "" if take.video is not None else f"the take {name} has no video"

    def jpeg(self, pair: int, after: float = 0.0) -> bytes:
        """Return a pair's picture as JPEG, or the video frame `after` seconds later."""
        with self._guard:
            return self._encoded(pair, after)

    def sound(self, pair: int) -> bytes | None:
        """Return the sound around a pair's frame as WAV; None if the take has none.

        The sound of the last take is cached.
        """
        name = self._references.takes[pair]
        take = self._takes.get(name)
        if take is None:
            return None
        with self._hearing:
            recorded = self._recorded(name)
        if recorded is None:
            return None
        at = take.seconds(int(self._references.frames[pair]))
        ends = at - SOUND_SECONDS, at + SOUND_SECONDS
        samples = sound_between(take, recorded, *ends, SOUND_RATE)
        out = io.BytesIO()
        with wave.open(out, "wb") as stream:
            stream.setnchannels(1)
            stream.setsampwidth(2)
            stream.setframerate(SOUND_RATE)
            stream.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
        return out.getvalue()

    def head_degrees(self) -> list[list[float] | None]:
        """Return yaw to the left, pitch down and roll to the right of the head at each pair.

        Relative to the neutral frame; None if the take has no head motion.
        """
        takes, frames = self._references.takes, self._references.frames.tolist()
        return [
            _head_degrees(self._readers[name], frame) if name in self._readers else None
            for name, frame in zip(takes, frames, strict=True)
        ]

    def close(self) -> None:
        """Close the videos."""
        with self._guard:
            for video in self._videos.values():
                video.close()
            self._videos.clear()

    def _encode(self, pair: int, after: float) -> bytes:
        return encode_image(self._find(pair, after), max_height=1080)

    def _find(self, pair: int, after: float) -> ByteImage:
        image = self._notes[pair].image
        if image is not None and not after:
            return read_picture(image)
        name, frame = self._references.takes[pair], int(self._references.frames[pair])
        reason = self._reason_without_video(name)
        take = self._takes.get(name)
        if reason or take is None or take.video is None:
            raise InputError(reason)
        video = take.video
        if name not in self._videos:
            self._videos[name] = open_video(video.file, video.rate)
        found = self._videos[name].frame_at(video.video_time(take.seconds(frame) + after))
        if found is None:
            when = f"frame {frame}" + (f" {after:+.2f} s" if after else "")
            raise InputError(f"the video of {name} does not show {when}")
        return found

    def _read_takes(self, files: Sequence[Path]) -> dict[str, Take]:
        wanted = set(self._references.takes)
        found = {}
        for path in files:
            try:
                reader = TakeReader(path)
                if reader.name in wanted:
                    # One frame suffices for video and rate.
                    found[reader.name] = reader.read(reader.first_frame, reader.first_frame)
                    self._readers[reader.name] = reader
            except InputError as error:
                name = path.name.split(".")[0]
                self._faults[name] = str(error)
        return found


def _head_degrees(take: TakeReader, frame: int) -> list[float] | None:
    try:
        source = take_head_source(take, frame, frame)
    except InputError:
        return None
    turn = source.turns[HEAD][0] if HEAD in source.turns else None
    if turn is None and source.motion is not None:
        turn = source.motion[0, :3, :3]
    if turn is None:
        return None
    # In the order of the page's camera, not of the head's axes.
    roll, pitch, yaw = Rotation.from_matrix(turn).as_euler("ZXY", degrees=True).tolist()
    return [yaw, pitch, roll]
