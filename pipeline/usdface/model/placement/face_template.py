"""How labelled markers lie against an adult's face: its size, which way is up, which side is which.

The template is a table of means of adults; faces differ from it by some 15 %, markers stand
beside what they are named for by their `spread_mm`, and both are far below what wrong units, a
wrong axis or exchanged sides do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import FloatArray
from usdface.model.placement.label_hints import LabelHint, label_hint

_MIDDLE_MM = {
    "nose_bridge": (0.0, 0.0, 0.0),
    "nose_tip": (0.0, -42.0, 28.0),
    "brow_centre": (0.0, 16.0, 4.0),
    "lip_upper": (0.0, -68.0, 14.0),
    "lip_lower": (0.0, -84.0, 11.0),
    "chin": (0.0, -108.0, 4.0),
}
_LEFT_MM = {
    "mouth": (26.0, -76.0, -2.0),
    "eye_inner": (16.5, -3.0, -14.0),
    "eye_outer": (45.0, -1.0, -26.0),
    "lid_crease": (31.0, 6.0, -15.0),
    "lid_lower": (31.0, -10.0, -16.0),
    "brow_inner": (14.0, 16.0, 0.0),
    "brow_middle": (32.0, 24.0, -4.0),
    "brow_outer": (52.0, 17.0, -18.0),
}
"""Landmarks of an adult's face from the sellion: X to the performer's left, Y up, Z forward [mm].
Heights and breadths after Farkas et al. (2005), J Craniofac Surg 16(4), and Young (1993), FAA
AM-93-10: nasion to chin 117, inner and outer corners of the eyes 33 and 90, mouth 52; depths by
the convexity of the profile and of the brow."""

_REGIONS_MM = {
    "nose": ((17.0, -48.0, 8.0), 8.0),
    "cheek": ((48.0, -45.0, -20.0), 18.0),
    "jaw": ((50.0, -88.0, -35.0), 22.0),
    "chin": ((20.0, -105.0, -6.0), 12.0),
    "eye": ((31.0, 0.0, -16.0), 10.0),
    "forehead": ((30.0, 50.0, -4.0), 20.0),
}
_MIDDLE_REGIONS_MM = {
    "forehead": ((0.0, 50.0, 2.0), 15.0),
    "jaw": ((0.0, -105.0, 0.0), 15.0),
    "mouth": ((0.0, -76.0, 12.0), 12.0),
}
"""The middle of a region of the left side, and of the middle; about half its breadth."""


@dataclass(frozen=True)
class FaceTemplate:
    """Where markers would be on an adult's face, by their labels."""

    columns: np.ndarray
    """(n,): markers whose labels name a place."""
    places: FloatArray
    """(n, 3): from the sellion, X to the performer's left, Z forward [mm]."""
    weights: FloatArray
    """(n,): inverse variance of each place, of sum 1."""


@dataclass(frozen=True)
class FaceFit:
    """A frame's markers fitted by the template, turned, scaled and moved."""

    size: float
    """Of the face, in those of an adult's."""
    up: FloatArray
    """(3,): the head's own, of length 1."""
    explained: float
    explained_mirrored: float
    """`explained`, `explained_mirrored`: Share of the markers' spread about their centre [0-1], by
    the template and by its mirror image."""
    marker_count: int


def face_template(labels: Sequence[str]) -> FaceTemplate:
    """Return where labels say that markers are; those that name no place are left out."""
    places = [_place(label_hint(label)) for label in labels]
    known = [(column, place) for column, place in enumerate(places) if place is not None]
    spread = np.array([place[1] for _, place in known])
    return FaceTemplate(
        np.array([column for column, _ in known], dtype=np.int64),
        np.array([place[0] for _, place in known]).reshape(-1, 3),
        spread**-2.0 / (spread**-2.0).sum() if known else spread,
    )


def fit_face(places: FloatArray, positions: FloatArray, weights: FloatArray) -> FaceFit:
    """Fit the template to one frame by weighted least squares, and its mirror image as well.

    Parameters
    ----------
    places, positions : (n, 3) float arrays
        Of the template, and of the markers; not all at one point.
    weights : (n,) float array

    References
    ----------
    Umeyama (1991), IEEE Trans. PAMI 13(4), 376-380; the scale is that of the spreads, which does
    not shrink where markers lie beside their places.
    """
    share = weights / weights.sum()
    x, y = places - share @ places, positions - share @ positions
    spread_x, spread_y = share @ (x**2).sum(axis=1), share @ (y**2).sum(axis=1)
    u, strengths, vt = np.linalg.svd((y * share[:, None]).T @ x)
    proper = float(np.sign(np.linalg.det(u @ vt)))
    explained = {
        sign: float(strengths @ (1.0, 1.0, sign * proper)) ** 2 / (spread_x * spread_y)
        for sign in (1, -1)
    }
    best = 1 if explained[1] >= explained[-1] else -1
    rotation = u @ np.diag((1.0, 1.0, best * proper)) @ vt
    return FaceFit(
        float(np.sqrt(spread_y / spread_x)),
        rotation[:, 1],
        explained[1],
        explained[-1],
        len(places),
    )


def _place(hint: LabelHint) -> tuple[FloatArray, float] | None:
    """Return where a hint's marker is on the template, and with what spread [mm]."""
    landmarks = [place for place in map(landmark_place, hint.landmarks) if place is not None]
    if landmarks:
        return np.mean(landmarks, axis=0), hint.spread_mm
    table = _REGIONS_MM if hint.side else _MIDDLE_REGIONS_MM
    if hint.region not in table:
        return None
    place, spread = table[hint.region]
    return np.array(place) * _across(hint.side), spread


def landmark_place(name: str) -> FloatArray | None:
    """Return where a landmark of `rig_landmarks` is on an adult's face; None where unknown.

    From the sellion, X to the left, Y up, Z forward [mm].
    """
    if name in _MIDDLE_MM:
        return np.array(_MIDDLE_MM[name])
    stem, _, side = name.rpartition("_")
    return np.array(_LEFT_MM[stem]) * _across(side) if stem in _LEFT_MM else None


def _across(side: str) -> tuple[float, float, float]:
    return (-1.0 if side == "R" else 1.0, 1.0, 1.0)
