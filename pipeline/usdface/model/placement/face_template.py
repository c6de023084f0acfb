"""Fit of labelled markers to an adult's face: size, up axis, left and right.

The template is a table of means of adults. Faces differ from it by about 15 %, and markers from
their landmarks by `spread_mm`; both are far less than the effect of wrong units, a wrong axis or
exchanged sides.
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
"""Centre and about half the breadth of regions of the left side, and of the midline [mm]."""


@dataclass(frozen=True)
class FaceTemplate:
    """Expected positions of labelled markers on an adult's face."""

    columns: np.ndarray
    """(n,): markers whose labels name a landmark or a region."""
    places: FloatArray
    """(n, 3): from the sellion, X to the performer's left, Z forward [mm]."""
    weights: FloatArray
    """(n,): inverse variances, normalised to sum 1."""


@dataclass(frozen=True)
class FaceFit:
    """Similarity transform of the template to the markers of one frame."""

    size: float
    """Of the face, relative to an adult's."""
    up: FloatArray
    """(3,): unit vector from chin to forehead."""
    explained: float
    explained_mirrored: float
    """`explained`, `explained_mirrored`: share of the markers' variance explained [0-1] by the
    template and by its mirror image."""
    marker_count: int


def face_template(labels: Sequence[str]) -> FaceTemplate:
    """Return the expected positions of the markers whose labels name a landmark or region."""
    places = [_place(label_hint(label)) for label in labels]
    known = [(column, place) for column, place in enumerate(places) if place is not None]
    spread = np.array([place[1] for _, place in known])
    return FaceTemplate(
        np.array([column for column, _ in known], dtype=np.int64),
        np.array([place[0] for _, place in known]).reshape(-1, 3),
        spread**-2.0 / (spread**-2.0).sum() if known else spread,
    )


def fit_face(places: FloatArray, positions: FloatArray, weights: FloatArray) -> FaceFit:
    """Fit the template and its mirror image to one frame by weighted least squares.

    Parameters
    ----------
    places, positions : (n, 3) float arrays
        Of the template and of the markers; not all equal.
    weights : (n,) float array

    References
    ----------
    Umeyama (1991), IEEE Trans. PAMI 13(4), 376-380; but the scale is the ratio of the standard
    deviations, which is not biased low by deviations from the template.
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
    """Return a marker's expected position on the template and its standard deviation [mm]."""
    landmarks = [place for place in map(landmark_place, hint.landmarks) if place is not None]
    if landmarks:
        return np.mean(landmarks, axis=0), hint.spread_mm
    table = _REGIONS_MM if hint.side else _MIDDLE_REGIONS_MM
    if hint.region not in table:
        return None
    place, spread = table[hint.region]
    return np.array(place) * _across(hint.side), spread


def landmark_place(name: str) -> FloatArray | None:
    """Return the position of a `rig_landmarks` landmark on an adult's face; None if unknown.

    From the sellion, X to the left, Y up, Z forward [mm].
    """
    if name in _MIDDLE_MM:
        return np.array(_MIDDLE_MM[name])
    stem, _, side = name.rpartition("_")
    return np.array(_LEFT_MM[stem]) * _across(side) if stem in _LEFT_MM else None


def _across(side: str) -> tuple[float, float, float]:
    return (-1.0 if side == "R" else 1.0, 1.0, 1.0)
