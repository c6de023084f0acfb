"""Movies that state a timecode or a comment, as those of `usdface movie`."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from usdface.media.film.movie import write_movie
from usdface.media.film.movie_join import join_movies


def write_stated_movie(
    path: Path, pictures: Iterable[np.ndarray], *, rate: Fraction, **stated: object
) -> None:
    """Write a movie with the sound, timecode and comment that `join_movies` takes."""
    plain = path.with_name(f"plain.{path.name}")
    write_movie(plain, pictures, rate=rate)
    join_movies(path, [plain], rate=Fraction(rate), **stated)
    plain.unlink()
