"""Refine a symmetric cage and keep track of which point mirrors which."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from usdface.core.arrays import IntArray
from usdface.media.face.subdivision import catmull_clark


@dataclass(frozen=True)
class Refinement:
    """A finer mesh and how its points follow from the cage's.

    Attributes
    ----------
    matrix : (fine points, points) sparse array
        Rows sum to 1: it carries positions and any attribute that varies smoothly.
    faces : (fine faces, 4) int array
    mirror : (fine points,) int array
        Index of each fine point's mirror image.
    """

    matrix: sparse.csr_array
    faces: IntArray
    mirror: IntArray


def refine(faces: IntArray, mirror: IntArray, *, levels: int) -> Refinement:
    """Subdivide a cage by Catmull and Clark's rules, borders as smooth curves of their own.

    Parameters
    ----------
    faces : (faces, 4) int array
    mirror : (points,) int array
        The cage's topology must be symmetric under it.
    levels : int

    Returns
    -------
    Refinement
    """
    count = len(mirror)
    matrix = sparse.eye_array(count, format="csr")
    for _ in range(levels):
        step = catmull_clark(
            np.full(len(faces), 4, np.int64), faces.ravel(), point_count=matrix.shape[0]
        )
        matrix = sparse.csr_array(step.matrix @ matrix)
        faces = step.face_indices.reshape(-1, 4)
    # Mirror images see mirrored cage points with the same weights: a random label tells them apart.
    label = np.random.default_rng(0).random(count)
    labels, images = (np.asarray(matrix @ values) for values in (label, label[mirror]))
    own, other = np.argsort(labels), np.argsort(images)
    partner = np.empty(len(own), np.int64)
    partner[other] = own
    return Refinement(matrix, faces, partner)
