"""What a mapping says of frames of several takes."""

from dataclasses import dataclass

import numpy as np

from usdface.assets import FloatArray, IntArray, Mapping, Markers
from usdface.model.head_space import HeadSpace, find_head_space
from usdface.model.predict import predict_weights
from usdface.steps.cleaned_takes import CleanedTakes

GLANCE_FRAMES = 2000
"""Frames spread over a take by which its head is put where the mapping's was."""


@dataclass(frozen=True)
class MappedRows:
    """A mapping laid on takes that were brought together."""

    mapping: Mapping
    takes: CleanedTakes
    space: HeadSpace

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Order of the weights."""
        return self.mapping.shape_names

    def weights(self, rows: IntArray) -> FloatArray:
        """Return the mapping's weights at rows of all takes: (rows, shapes)."""
        placed = self.space.place(_markers(self.takes, rows))
        return predict_weights(self.mapping, placed.positions, visible=placed.visible).weights


def mapped_rows(mapping: Mapping, takes: CleanedTakes) -> MappedRows:
    """Find the head space of takes that share one, by frames spread over them."""
    count = len(takes.frames)
    rows = np.unique(np.linspace(0, count - 1, min(count, GLANCE_FRAMES)).astype(np.int64))
    return MappedRows(mapping, takes, find_head_space(mapping, _markers(takes, rows)))


def _markers(takes: CleanedTakes, rows: IntArray) -> Markers:
    starts = np.cumsum([0, *(len(clip) for clip in takes.positions)])
    clip = np.searchsorted(starts, rows, side="right") - 1
    own = rows - starts[clip]
    at = list(zip(clip.tolist(), own.tolist(), strict=True))
    visible = np.array([takes.usable[i][row] for i, row in at])
    return Markers(
        names=takes.marker_names,
        positions=np.array([takes.positions[i][row] for i, row in at], dtype=np.float32),
        visible=visible,
        confidence=visible.astype(np.float32),
        rigid=takes.rigid,
        space="stabilized",
    )
