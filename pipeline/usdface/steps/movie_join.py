"""Parts of a movie, made on several machines, as one."""

import json
from fractions import Fraction

from usdface.errors import InputError
from usdface.media.movie import read_movie_comment
from usdface.media.movie_join import join_movies
from usdface.progress import Progress, silent
from usdface.provenance import Provenance
from usdface.specs.movie import MovieJoinSpec
from usdface.steps.movie_clock import MovieClock
from usdface.steps.outputs import make_provenance, provenance_metadata
from usdface.steps.report import Report
from usdface.steps.take_sound import SAMPLE_RATE, take_sound
from usdface.usdio.take import TakeReader
from usdface.wording import counted


def run(
    spec: MovieJoinSpec, *, provenance: Provenance | None = None, progress: Progress = silent
) -> Report:
    """Join the parts' pictures; the sound is put in whole."""
    progress(0.0, "reading")
    said = [_said(path.name, read_movie_comment(path)) for path in spec.parts]
    rate = said[0][0]
    for path, (other, first, _), (_, before, _) in zip(
        spec.parts[1:], said[1:], said[:-1], strict=True
    ):
        if other != rate:
            raise InputError(f"{path}: has {float(other):g} pictures a second, not {float(rate):g}")
        if first <= before:
            raise InputError(
                f"{path}: begins at frame {first}, before the part that it follows; name the parts "
                "in order"
            )
    count = sum(pictures for _, _, pictures in said)
    notes: list[str] = []
    sound, timecode = None, ""
    if spec.take is not None:
        reader = TakeReader(spec.take)
        take = reader.read(reader.first_frame, reader.first_frame)
        clock = MovieClock(
            rate=rate,
            take_rate=take.rate,
            first_frame=said[0][1],
            frame_count=round(count * take.rate / rate),
        )
        sound = take_sound(take, clock, notes)
        timecode = clock.timecode(reader.timecode_at(reader.first_frame), reader.first_frame)
    progress(0.3, "joining")
    written = provenance_metadata(provenance or make_provenance(spec))
    written |= {"rate": str(rate), "first_frame": said[0][1], "pictures": count}
    join_movies(
        spec.out,
        spec.parts,
        audio=sound,
        sample_rate=SAMPLE_RATE,
        rate=rate,
        timecode=timecode,
        comment=json.dumps(written),
    )
    progress(1.0, "done")
    return Report(
        (spec.out,),
        f"{counted(len(spec.parts), 'part')}, {counted(count, 'picture')} at "
        f"{float(rate):g} per second",
        tuple(notes),
        {"pictures": count, "rate": float(rate), "sound": sound is not None},
    )


def _said(name: str, comment: str) -> tuple[Fraction, int, int]:
    """Return rate, first frame and number of pictures, as `usdface movie` wrote them."""
    try:
        data = json.loads(comment)
        rate, first, count = Fraction(data["rate"]), int(data["first_frame"]), int(data["pictures"])
        if not 0 < rate <= 1000 or not 0 < count < 1 << 31:
            raise ValueError
    except (ValueError, KeyError, TypeError, ArithmeticError, RecursionError) as error:
        raise InputError(
            f"{name}: does not say which frames it shows; give parts that `usdface movie` made"
        ) from error
    return rate, first, count
