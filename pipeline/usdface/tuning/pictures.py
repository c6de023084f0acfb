"""The picture of each pair: its own where the asset names one, else from the take's video."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path

from usdface.core.arrays import ByteImage
from usdface.core.assets import References, Take
from usdface.core.errors import InputError
from usdface.media.film.image_sequence import ImageSequence, open_video
from usdface.media.film.video import VideoReader
from usdface.media.picture.image import encode_image, read_picture
from usdface.usdio.references.read import PairNotes
from usdface.usdio.take.read import TakeReader

CACHED_PICTURES = 64
"""Encoded pictures that are kept: going back and forth decodes nothing."""


class PairPictures:
    """Pictures of pairs as JPEG, found when they are first asked for.

    Parameters
    ----------
    notes : sequence of PairNotes
        One per pair.
    takes : sequence of Path
        Take files; each pair names its take.
    """

    def __init__(
        self, references: References, notes: Sequence[PairNotes], takes: Sequence[Path]
    ) -> None:
        self._references = references
        self._notes = notes
        self._faults: dict[str, str] = {}
        self._takes = self._read_takes(takes)
        self._videos: dict[str, VideoReader | ImageSequence] = {}
        self._cached: OrderedDict[tuple[int, float], bytes] = OrderedDict()
        self._guard = threading.Lock()  # one decoder, one frame at a time

    def reason_without(self, pair: int) -> str:
        """Return why a pair has no picture; empty if it should have one."""
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
        """Return a pair's picture, or the video's some seconds after its frame."""
        wanted = pair, after
        with self._guard:
            if wanted not in self._cached:
                self._cached[wanted] = encode_image(self._find(pair, after), max_height=1080)
                while len(self._cached) > CACHED_PICTURES:
                    self._cached.popitem(last=False)
            self._cached.move_to_end(wanted)
            return self._cached[wanted]

    def close(self) -> None:
        """Let go of the videos."""
        with self._guard:
            for video in self._videos.values():
                if isinstance(video, VideoReader):
                    video.close()
            self._videos.clear()

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
        seconds = (frame - take.first_frame) / float(take.rate) + after
        found = self._videos[name].frame_at(video.video_time(seconds))
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
                    # Samples are not needed: one frame says all about video and rate.
                    found[reader.name] = reader.read(reader.first_frame, reader.first_frame)
            except InputError as error:
                name = path.name.split(".")[0]
                self._faults[name] = str(error)
        return found
