"""Trained mappings: markers to a rig's weights, fitted on references and applied to takes."""

from usdface.model.mapping.head_space import MappedMarkers, align_markers
from usdface.model.mapping.motion_space import fit_motion_space
from usdface.model.mapping.predict import Prediction, predict_weights
from usdface.model.mapping.regions import sample_skin
from usdface.model.mapping.train import train_mapping

__all__ = [
    "MappedMarkers",
    "Prediction",
    "align_markers",
    "fit_motion_space",
    "predict_weights",
    "sample_skin",
    "train_mapping",
]
