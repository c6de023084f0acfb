"""A take's neutral face against its performer's: what differs, and what that says."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.model.mapping.performer_face import PerformerFace
from usdface.numerics.registration.marker_application import (
    compare_neighbours,
    find_offset,
    measure_distances,
    measure_stretch,
)

NEUTRAL_TOLERANCE_MM = 1.5
"""Root mean square over markers of an expression in a neutral frame worth a word: half of a smile
that moves the corners of the mouth by 8 mm."""

LEAST_OFFSET_MM = 0.5
"""Root mean square over markers below which no offset is taken out: matched expressions of one
application differ by 0.1 to 0.3 mm."""

DISJOINT_SHARE = 0.02
"""Of neighbouring pairs, whose distances have nothing in common where markers were put on again. Of
one application there are none, and a single marker that slipped makes as many."""

SHORTEST_COMPARED_SECONDS = 10.0
"""A shorter take may hold one expression, which no other take has: neither its distances nor its
nearest frames tell where markers sit."""

OTHER_SKULL = 0.04
"""Stretch of one face against another, beyond which it is not one skull: breadth, height and depth
of two adults' faces differ by 5 to 8 % (standard deviation)."""

_ERRORS_OF_STRETCH = 4.0
"""Standard errors: markers put on at random stretch a face by so much in 1 of 16,000."""

MOST_REAPPLIED_MM = 8.0
"""Root mean square shift beyond what putting markers on again explains: marks on the skin, or an
eye for where they sat, are met within 2 to 4 mm."""

_FEWEST_OF_A_FACE = 8
"""Markers from which proportions of a face can be told."""

_LISTED_MARKERS = 4


@dataclass(frozen=True)
class TakeNeutral:
    """A take's neutral face, in its performer's marker order and head space."""

    marker_names: tuple[str, ...]
    offset: FloatArray
    """(markers, 3): the take's neutral face less the performer's: subtracted from the take [mm]."""
    frame: int = 0
    stated_frame: int = 0
    """`frame`, `stated_frame`: The frame most like the performer's neutral face, and the one that
    the take states."""
    frame_mm: float = 0.0
    stated_mm: float = float("nan")
    """`frame_mm`, `stated_mm`: Distance of each from the neutral face after the offset, root mean
    square [mm]; NaN where the stated frame was not looked at."""
    reapplied_share: float = float("nan")
    """Of neighbouring pairs, whose distances have nothing in common with the performer's; NaN where
    that was not measured, as in a take of less than ten seconds."""

    @property
    def offset_mm(self) -> float:
        """Root mean square of the offset over markers [mm]."""
        return float(np.sqrt((self.offset**2).sum(axis=1).mean()))

    @property
    def is_reapplied(self) -> bool:
        """Whether markers were put on again since the performer's take."""
        return self.reapplied_share >= DISJOINT_SHARE

    @property
    def is_stated_neutral(self) -> bool:
        """Whether the stated frame is as neutral as the take's best, within the tolerance."""
        return not self.stated_mm**2 - self.frame_mm**2 > NEUTRAL_TOLERANCE_MM**2

    @property
    def neutral_frame(self) -> int:
        """The frame to take as neutral: the stated one, unless it is not neutral."""
        return self.stated_frame if self.is_stated_neutral else self.frame

    def notes(self, take: str) -> tuple[str, ...]:
        """Return what a person should know of the take's neutral face."""
        notes = []
        if self.offset.any():
            length = np.linalg.norm(self.offset, axis=1)
            worst = [
                f"{self.marker_names[i]} {length[i]:.1f}"
                for i in np.argsort(-length, kind="stable")[:_LISTED_MARKERS]
            ]
            why = (
                f"the markers of {take} were put on again ({self.reapplied_share:.0%} of the "
                "distances between neighbours have nothing in common): they sit"
                if self.is_reapplied
                else f"at the same expression the markers of {take} sit"
            )
            notes.append(
                f"{why} {self.offset_mm:.1f} mm (root mean square) from the performer's, "
                f"{', '.join(worst)}; that is taken out of its frames"
            )
        if not self.is_stated_neutral:
            notes.append(
                f"{take}: its neutral frame {self.stated_frame} is not neutral, "
                f"{self.stated_mm:.1f} mm (root mean square) from the performer's neutral face; "
                f"frame {self.frame} is nearest, {self.frame_mm:.1f} mm: clean the take with "
                f"--neutral {self.frame}"
            )
        return tuple(notes)

    def figures(self) -> dict[str, object]:
        """Return the same as plain data."""
        length = np.linalg.norm(self.offset, axis=1)
        return {
            "offset_mm": round(self.offset_mm, 4),
            "offsets_mm": {
                name: round(float(mm), 4)
                for name, mm in zip(self.marker_names, length, strict=True)
            },
            "reapplied": self.is_reapplied,
            "neutral_frame": self.neutral_frame,
        }


def compare_neutral(
    face: PerformerFace,
    positions: FloatArray,
    usable: BoolArray,
    *,
    frames: IntArray,
    stated_frame: int,
    rate: float,
    performer: str = "",
    session: str = "",
) -> TakeNeutral:
    """Find a take's neutral face, and whether its markers sit where the performer's did.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        Frames spread over the take, in the face's marker order and head space [mm].
    usable : (frames, markers) bool array
    frames : (frames,) int array
        Their numbers.
    rate : float
        Frames per second.
    performer, session : str
        As the take says; empty where unknown. Of one session no marker was put on again.

    Raises
    ------
    InputError
        If the take is of another performer.
    """
    offset = find_offset(face.frames, face.usable, positions, usable, neutral=face.neutral)
    same_session = bool(session) and session == face.session
    other_session = bool(session and face.session) and not same_session
    if not same_session and not (performer and performer == face.performer):
        _check_performer(face.neutral, offset, np.asarray(usable.any(axis=0)))
    is_long = np.ptp(frames) >= SHORTEST_COMPARED_SECONDS * rate
    if np.sqrt((offset**2).sum(axis=1).mean()) < LEAST_OFFSET_MM or not (is_long or other_session):
        offset = np.zeros_like(offset)
    share = float("nan")
    if is_long and not same_session:
        ranges = compare_neighbours(face.frames, face.usable, positions, usable)
        share = len(ranges.disjoint) / max(ranges.compared, 1)
    away_mm = measure_distances(positions, usable, face.neutral + offset)
    row = int(away_mm.argmin())
    stated = away_mm[frames == stated_frame]
    return TakeNeutral(
        face.marker_names,
        offset,
        int(frames[row]),
        stated_frame,
        float(away_mm[row]),
        float(stated[0]) if np.isfinite(stated).any() else float("nan"),
        share,
    )


def _check_performer(neutral: FloatArray, offset: FloatArray, seen: BoolArray) -> None:
    """Refuse a face whose proportions are not the performer's."""
    if seen.sum() < _FEWEST_OF_A_FACE:
        return
    other = neutral + offset
    found = measure_stretch(neutral[seen], other[seen])
    strain = np.abs(np.log(np.maximum(found.stretch, 1e-3)))
    beyond = (strain > OTHER_SKULL) & (strain > _ERRORS_OF_STRETCH * found.error)
    if not beyond.any() and found.left_mm <= MOST_REAPPLIED_MM:
        return
    worst = float(found.stretch[int(np.where(beyond, strain, 0.0).argmax())])
    what = (
        f"its face is {abs(worst - 1):.0%} {'larger' if worst > 1 else 'smaller'} in one direction"
        if beyond.any()
        else f"its markers are {found.left_mm:.1f} mm (root mean square) away at the same "
        f"expression; markers that are put on again are within {MOST_REAPPLIED_MM:g}"
    )
    raise InputError(
        f"the take is of another performer: {what}. Give takes of one performer; if it is the "
        "same one, say so at `usdface ingest --performer NAME` for every take"
    )
