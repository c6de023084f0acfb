"""The video of a take, a movie or numbered pictures, and its picture at a frame of the take."""

from fractions import Fraction
from pathlib import Path

from usdface.core.arrays import ByteImage
from usdface.core.assets import Take
from usdface.core.errors import InputError
from usdface.media.film.image_sequence import SUFFIXES, ImageSequence
from usdface.media.film.video import VideoReader

OpenVideo = VideoReader | ImageSequence


def open_video(path: Path, rate: Fraction | None = None) -> OpenVideo:
    """Open a movie, or the sequence that a picture belongs to.

    Raises
    ------
    InputError
        If it is neither, or a sequence without a rate.
    """
    if path.suffix.lower() not in SUFFIXES:
        return VideoReader(path)
    if rate is None or rate <= 0:
        raise InputError(f"{path}: pictures do not state their rate; give it with --video-rate")
    return ImageSequence(path, rate)


def picture_at_frame(
    take: Take | None, video: OpenVideo | None, frame: int
) -> tuple[ByteImage | None, str]:
    """Return the picture of a take's video at a frame of the take, or None and the reason.

    Parameters
    ----------
    video : VideoReader or ImageSequence, optional
        The take's video, opened.
    """
    if take is None or take.video is None or video is None:
        return None, "no video"
    try:
        picture = video.frame_at(take.video_seconds(frame))
    except InputError:
        return None, "cannot be decoded"
    return picture, "" if picture is not None else "no video here"
