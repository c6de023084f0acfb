"""Comparison of a take's neutral face with its performer's: offset, reapplied markers, identity."""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.model.mapping.performer_face import PerformerFace
from usdface.model.regressions.forward_model import ForwardModel
from usdface.numerics.registration.marker_application import (
    compare_neighbours,
    expression_covariance,
    find_offset,
    measure_distances,
    measure_stretch,
)
from usdface.numerics.rigid.rigid_alignment import is_mirror_image

NEUTRAL_TOLERANCE_MM = 1.5
"""Root mean square over markers of the expression in a neutral frame that is reported: half of a
smile that moves the corners of the mouth by 8 mm."""

MIN_OFFSET_MM = 0.5
"""Root mean square over markers from which an offset is removed: matched expressions of one
application of the markers differ by 0.1 to 0.3 mm."""

DISJOINT_SHARE = 0.02
"""Share of neighbouring pairs with disjoint ranges of distance from which markers were reapplied:
without, there are none; a single marker that slipped reaches this share."""

_SHORTEST_COMPARED_SECONDS = 10.0
"""Shorter takes may consist of one expression that no other take has, and their distances do not
pass through all values."""

_MIN_GAIN = 5.0
"""Log-likelihood per coordinate that an offset of a shorter take gains at least, unless its session
is another: expressions that the performer's frames do not show pass for offsets that gain 3.5."""

MAX_STRETCH = 0.04
"""Largest stretch between faces of one performer: breadth, height and depth of adults' faces have
standard deviations of 5 to 8 %."""

_CRITICAL_STRETCH_T = 4.0
"""Standard errors of the stretch, which neutral faces of one person exceed with p = 1 / 16,000."""

_REAPPLIED_MM, MAX_REAPPLIED_MM = 4.0, 8.0
"""Usual and largest root mean square shift of reapplied markers: marks on the skin are met within 2
to 4 mm."""

_EXCHANGED_SHARE = 0.3
"""Distance of a marker from another's place, over that of the two places, below which it lies
there."""

_MIN_MARKERS = 8
"""Fewest markers for an estimate of a face's proportions."""

_LISTED_MARKERS = 4
"""Markers of largest offset named in a note."""


_MIN_KEYED_OFFSET_MM = 0.3
"""Root mean square over markers from which an offset told by keys is removed."""

_OFFSET_DEVIATIONS_MM = (0.3, 0.6, 1.2, 2.4, 4.8)
"""Candidates of the standard deviation of a marker's offset on an axis: from what differs between
matched expressions to markers that were applied by eye."""


@dataclass(frozen=True)
class TakeNeutral:
    """A take's neutral face, in its performer's marker order and head space."""

    marker_names: tuple[str, ...]
    offset: FloatArray
    """(markers, 3): the take's neutral face minus the performer's; it is subtracted [mm]."""
    offset_mm: float = 0.0
    """Root mean square of the offset over the markers that the take shows; if its pairs told an
    offset, which is subtracted before, of that one [mm]."""
    frame: int = 0
    stated_frame: int = 0
    """`frame`, `stated_frame`: The frame nearest to the performer's neutral face, and the one that
    the take states."""
    frame_mm: float = 0.0
    stated_mm: float = float("nan")
    """`frame_mm`, `stated_mm`: Distance of each from the neutral face after the offset, root mean
    square [mm]; NaN if the stated frame was not compared."""
    other_face: str = ""
    """How its proportions differ from the performer's, of whom it is stated to be."""
    reapplied_share: float = float("nan")
    """Share of neighbouring pairs whose ranges of distance are disjoint from the performer's; NaN
    if not measured, as in takes of less than ten seconds."""

    @property
    def is_reapplied(self) -> bool:
        """Whether markers were reapplied between the performer's take and this one."""
        return self.reapplied_share >= DISJOINT_SHARE

    @property
    def is_stated_neutral(self) -> bool:
        """Whether the stated frame is as neutral as the take's best, within the tolerance."""
        return not self.stated_mm**2 - self.frame_mm**2 > NEUTRAL_TOLERANCE_MM**2

    @property
    def neutral_frame(self) -> int:
        """The stated frame if it is neutral, else the nearest."""
        return self.stated_frame if self.is_stated_neutral else self.frame

    def notes(self, take: str) -> tuple[str, ...]:
        """Return notes on the take's neutral face."""
        notes = []
        if self.other_face:
            notes.append(
                f"{take} may be of another performer than it states: {self.other_face}; look at it"
            )
        if self.offset.any():
            length = np.linalg.norm(self.offset, axis=1)
            worst = [
                f"{self.marker_names[i]} {length[i]:.1f}"
                for i in np.argsort(-length, kind="stable")[:_LISTED_MARKERS]
            ]
            subject = (
                f"the markers of {take} were reapplied ({self.reapplied_share:.0%} of the "
                "distances between neighbours have disjoint ranges): they are"
                if self.is_reapplied
                else f"at the same expression the markers of {take} are"
            )
            notes.append(
                f"{subject} {self.offset_mm:.1f} mm (root mean square) from the performer's, "
                f"{', '.join(worst)}; this offset is subtracted from its frames, as is an "
                "expression that the take holds throughout"
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
        """Return the comparison as plain data."""
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
    """Estimate a take's neutral face and its offset from the performer's.

    Parameters
    ----------
    positions : (frames, markers, 3) float array
        Frames spread over the take, in the face's marker order and head space [mm].
    usable : (frames, markers) bool array
        Where a position was measured or repaired.
    frames : (frames,) int array
        Their frame numbers.
    rate : float
        Frames per second.
    performer, session : str
        Of the take; empty if unknown. Within a session, markers are not reapplied.

    Raises
    ------
    InputError
        If the labels of two markers are exchanged throughout, or the take is of another performer.
    """
    stated = np.full_like(face.neutral, np.nan)
    for at in np.flatnonzero(frames == stated_frame):
        stated = np.where(usable[at, :, None], positions[at], np.nan)
    offset, gain = find_offset(
        face.frames, face.usable, positions, usable, neutral=face.neutral, others_neutral=stated
    )
    same_session = bool(session) and session == face.session
    _check_labels(face.marker_names, face.neutral, positions, usable)
    seen = np.asarray(usable.any(axis=0))
    difference = _compare_proportions(face, offset, seen)
    if difference and not same_session and not (performer and performer == face.performer):
        raise InputError(
            f"the take is of another performer: {difference}. Give takes of one performer; if it "
            "is the same one, ingest every take with `usdface ingest --performer NAME`"
        )
    offset_mm = float(np.sqrt((offset[seen] ** 2).sum(axis=1).mean()))
    is_long = np.ptp(frames) >= _SHORTEST_COMPARED_SECONDS * rate
    is_certain = is_long or gain >= _MIN_GAIN or bool(session and face.session and not same_session)
    if offset_mm < MIN_OFFSET_MM or not is_certain:
        offset, offset_mm = np.zeros_like(offset), 0.0
    reapplied = float("nan")
    if is_long and not same_session:
        reapplied = compare_neighbours(face.frames, face.usable, positions, usable)
    away_mm = measure_distances(positions, usable, face.neutral + offset)
    row = int(away_mm.argmin())
    stated_mm = away_mm[frames == stated_frame]
    return TakeNeutral(
        face.marker_names,
        offset,
        offset_mm,
        int(frames[row]),
        stated_frame,
        float(away_mm[row]),
        float(stated_mm[0]) if np.isfinite(stated_mm).any() else float("nan"),
        difference,
        reapplied,
    )


def check_not_mirrored(places: FloatArray, others: FloatArray) -> None:
    """Refuse a take whose markers, (n, 3), are the mirror image of the performer's."""
    if is_mirror_image(places, others):
        raise InputError(
            "the take is the mirror image of those it is compared with; ingest it with --mirrored "
            "axes, or with --mirrored labels if the names of left and right alone are exchanged"
        )


def _check_labels(
    names: tuple[str, ...], neutral: FloatArray, positions: FloatArray, usable: BoolArray
) -> None:
    """Refuse a mirrored take, and one in which two markers lie at each other's place.

    Medians are compared, since frames of one expression are matched by the labels as they are.
    """
    seen = usable.any(axis=0)
    hidden = np.where(usable[:, seen, None], positions[:, seen], np.nan)
    median = np.full_like(neutral, np.nan)
    median[seen] = np.nanmedian(hidden, axis=0)
    check_not_mirrored(median[seen], neutral[seen])
    away = np.linalg.norm(median[:, None] - neutral, axis=2)
    apart = np.linalg.norm(neutral[:, None] - neutral, axis=2)
    near = (away < _EXCHANGED_SHARE * apart) & (apart > MAX_REAPPLIED_MM)
    pairs = [(names[i], names[j]) for i, j in np.argwhere(near & near.T).tolist() if i < j]
    if pairs:
        listed = first_few([f"{one} and {other}" for one, other in pairs], most=_LISTED_MARKERS)
        raise InputError(
            f"the labels of {listed} are exchanged throughout the take: each lies at the other's "
            "place. Exchange them in the capture, and ingest it again"
        )


def _compare_proportions(face: PerformerFace, offset: FloatArray, seen: BoolArray) -> str:
    """Return how a face's proportions differ from the performer's; empty if they do not.

    Two neutral faces of one person differ by an expression of theirs, and by reapplied markers.
    """
    places = face.neutral[seen]
    if len(places) < _MIN_MARKERS or np.linalg.matrix_rank(places - places[0]) < 3:
        return ""  # few markers, or all in one plane, as of a capture in two dimensions
    covariance = expression_covariance(face.frames[:, seen], face.usable[:, seen], places)
    covariance += _REAPPLIED_MM**2 / 3 * np.eye(len(covariance))
    fit = measure_stretch(places, places + offset[seen], covariance)
    strain = np.abs(np.log(np.maximum(fit.stretch, 1e-3)))
    beyond = (strain > MAX_STRETCH) & (strain > _CRITICAL_STRETCH_T * fit.error)
    if beyond.any():
        worst = float(fit.stretch[int(np.where(beyond, strain, 0.0).argmax())])
        larger = "larger" if worst > 1 else "smaller"
        return f"its face is {abs(worst - 1):.0%} {larger} in one direction"
    reapplied_mm = _REAPPLIED_MM * fit.chi2**0.5
    if reapplied_mm <= MAX_REAPPLIED_MM:
        return ""
    return (
        f"its markers are {reapplied_mm:.1f} mm (root mean square) away at the same expression; "
        f"reapplied markers are within {MAX_REAPPLIED_MM:g} mm"
    )


def find_take_offsets(forward: ForwardModel, take: IntArray) -> FloatArray:
    """Return the offset of each take's markers, as its keys tell: (takes, markers, 3) [mm].

    The residuals of a marker's pairs under the forward model are r ~ N(0, C). Each take but the
    first adds an offset to its pairs, Z o with o ~ N(0, s^2) on each axis::

        o = (Z'C^-1 Z + 1/s^2)^-1 Z'C^-1 r

    s, of all markers, maximises the likelihood of r. A take whose own offset does not raise it has
    none.

    Parameters
    ----------
    forward : ForwardModel
        Fitted to the pairs.
    take : (pairs,) int array
        Index of each pair's take, 0 that of the neutral.
    """
    count = int(take.max()) + 1
    member = (take[:, None] == np.arange(1, count)).astype(np.float64)
    precision = member.T @ forward.inverse @ member
    score = np.einsum("nt,nkc->ktc", member, forward.dual)
    alone = [_most_probable_offsets(precision, score, [take])[0] for take in range(count - 1)]
    moved = np.flatnonzero(np.array(alone) > 0).tolist()
    offsets = np.zeros((count, *forward.dual.shape[1:]))
    if moved:
        _, mean = _most_probable_offsets(precision, score, moved)
        offsets[1:][moved] = mean.transpose(1, 0, 2)
    size = np.sqrt((offsets**2).sum(axis=2).mean(axis=1))
    return np.asarray(offsets * (size >= _MIN_KEYED_OFFSET_MM)[:, None, None])


def _most_probable_offsets(
    precision: FloatArray, score: FloatArray, takes: list[int]
) -> tuple[float, FloatArray]:
    """Return the gain of log likelihood by offsets of some takes, and their mean.

    The mean is (markers, takes, 3) [mm].
    """
    precision, score = precision[:, takes][:, :, takes], score[:, takes]
    found = []
    for deviation in _OFFSET_DEVIATIONS_MM:
        posterior = precision + np.eye(len(takes)) / deviation**2
        mean: FloatArray = np.asarray(np.linalg.solve(posterior, score), np.float64)
        log_volume = np.linalg.slogdet(posterior * deviation**2)[1]
        found.append((0.5 * float((score * mean).sum() - 3 * log_volume.sum()), mean))
    return max(found, key=lambda each: each[0])
