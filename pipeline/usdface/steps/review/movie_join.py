"""Join parts of a movie without encoding them again."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

from usdface.core.errors import InputError
from usdface.core.progress import Progress
from usdface.core.provenance import Provenance
from usdface.core.text import pluralize
from usdface.media.film.movie import read_movie_comment
from usdface.media.film.movie_join import join_movies
from usdface.runner.result import StepResult
from usdface.specs.review import MovieJoinSpec
from usdface.steps.review.clock import MovieClock, take_sound
from usdface.usdio.take.read import read_first_frame


def run(spec: MovieJoinSpec, *, provenance: Provenance, progress: Progress) -> StepResult:
    """Join the pictures of the parts, and encode the sound."""
    parts_info = [_read_part(path.name, read_movie_comment(path)) for path in spec.parts]
    rate = parts_info[0].rate
    for path, part, before in zip(spec.parts[1:], parts_info[1:], parts_info[:-1], strict=True):
        if part.rate != rate:
            raise InputError(
                f"{path}: has {float(part.rate):g} pictures a second, not {float(rate):g}; draw "
                "all parts with the same --rate"
            )
        if part.first <= before.first:
            raise InputError(
                f"{path}: begins at frame {part.first}, before the part given before it; give the "
                "parts in order"
            )
    pictures = [part.pictures for part in parts_info]
    count = sum(pictures)
    notes: list[str] = []
    sound, timecode = None, ""
    if spec.take is None:
        notes.append("no sound, no timecode and no search for missing frames; they need --take")
    else:
        take = read_first_frame(spec.take)
        _check_consecutive(spec.parts, parts_info, take.rate)
        pictures = _synchronised_counts(parts_info, take.rate)
        if sum(pictures) < count:
            notes.append(
                f"{pluralize(count - sum(pictures), 'picture')} at the ends of parts left out, to "
                "keep sound and picture synchronous: parts lasted no whole number of pictures"
            )
        count = sum(pictures)
        clock = MovieClock(
            rate=rate,
            take_rate=take.rate,
            first_frame=parts_info[0].first,
            frame_count=round(count * take.rate / rate),
        )
        sound = take_sound(take, clock, notes)
        timecode = clock.timecode(take.timecode_start, take.first_frame)
    progress(0.3, "joining")
    written = provenance.metadata
    written |= {"rate": str(rate), "first_frame": parts_info[0].first, "pictures": count}
    written["movie_parts"] = sum(part.movies for part in parts_info)
    join_movies(
        spec.out,
        spec.parts,
        pictures=pictures,
        audio=sound,
        rate=rate,
        timecode=timecode,
        comment=json.dumps(written),
    )
    return StepResult(
        (spec.out,),
        f"{pluralize(len(spec.parts), 'part')}, {pluralize(count, 'picture')} at "
        f"{float(rate):g} per second",
        tuple(notes),
        {"pictures": count, "rate": float(rate), "sound": sound is not None},
    )


@dataclass(frozen=True)
class _Part:
    """Metadata of a part."""

    rate: Fraction
    first: int
    """Frame number of the first picture."""
    pictures: int
    movies: int
    """Number of movies that were joined to make it."""


def _check_consecutive(
    parts: tuple[Path, ...], parts_info: Sequence[_Part], take_rate: Fraction
) -> None:
    """Refuse parts with frames missing between them, or shown twice.

    The last picture of a part may last longer than its frames: less than a picture is ignored.
    """
    for path, part, before in zip(parts[1:], parts_info[1:], parts_info[:-1], strict=True):
        shown = part.first - before.first
        surplus = before.pictures - shown * part.rate / take_rate
        if -1 < surplus < before.movies:
            continue
        end = before.first + math.floor(before.pictures * take_rate / part.rate)
        low, high = sorted((end, part.first))
        frames = f"frame {low}" if high - low == 1 else f"frames {low}-{high - 1}"
        fault = "in no part" if surplus < 0 else "in both parts"
        raise InputError(
            f"{path}: begins at frame {part.first}, and the part before ends with frame "
            f"{end - 1}: {frames} would be {fault}; give consecutive parts"
        )


def _synchronised_counts(parts_info: Sequence[_Part], take_rate: Fraction) -> list[int]:
    """Return the number of pictures to use of each part, so that each part starts on time.

    If parts last no whole number of pictures, the excess of their last pictures would add up to a
    delay of the pictures.
    """
    shown: list[int] = []
    for part, after in pairwise(parts_info):
        end = math.floor(
            (after.first - parts_info[0].first) * part.rate / take_rate + Fraction(1, 2)
        )
        shown.append(min(max(end - sum(shown), 0), part.pictures))
    return [*shown, parts_info[-1].pictures]


def _read_part(name: str, comment: str) -> _Part:
    """Return rate, first frame and number of pictures, as `usdface movie` wrote them."""
    try:
        data = json.loads(comment)
        rate, first, count = Fraction(data["rate"]), int(data["first_frame"]), int(data["pictures"])
        movies = int(data.get("movie_parts", 1))
        if not 0 < rate <= 1000 or not 0 < count < 1 << 31 or not 0 < movies <= count:
            raise ValueError
    except (ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
        raise InputError(
            f"{name}: does not state its frames; give parts made by `usdface movie`"
        ) from error
    return _Part(rate, first, count, movies)
