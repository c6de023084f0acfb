"""What the principal components of a mapping's takes say: shares of variance, and a picture."""

import numpy as np

from usdface.core.arrays import ByteImage, FloatArray
from usdface.core.assets import References, TrainedMapping
from usdface.core.text import pluralize
from usdface.media.charts.eigenspace import Eigenspace, draw_eigenspace
from usdface.model.mapping.coordinates import marker_coordinates
from usdface.model.mapping.motion_space import motion_of
from usdface.model.regressions.gaussian_rbf import PAPER_DIMENSIONS


def variance_shares(mapping: TrainedMapping) -> FloatArray:
    """Return the share of the markers' variance that each component holds: (dimensions,) [0-1]."""
    motion = motion_of(mapping)
    return np.asarray(motion.variances / motion.total_variance)


def variance_line(mapping: TrainedMapping) -> str:
    """Say how much of the motion the first components hold, and those that the mapping uses."""
    shares = variance_shares(mapping)
    first = shares[:PAPER_DIMENSIONS]
    listed = ", ".join(f"{100 * share:.2f}" for share in first)
    line = (
        f"{pluralize(len(first), 'principal component')} hold {100 * first.sum():.2f} % of the "
        f"markers' variance ({listed})"
    )
    used = mapping.settings.get("dimensions")
    if isinstance(used, int) and used != len(first):
        line += f"; the {used} in use hold {100 * shares[:used].sum():.2f} %"
    return line


def eigenspace_picture(mapping: TrainedMapping, references: References, title: str) -> ByteImage:
    """Draw the takes and the references along the first components."""
    motion = motion_of(mapping)
    markers = references.markers.astype(np.float64)
    return draw_eigenspace(
        Eigenspace(
            title=title,
            facts=(variance_line(mapping),),
            takes=mapping.arrays["takes_sample"],
            references=marker_coordinates(motion, markers).values,
            shares=variance_shares(mapping),
        )
    )
