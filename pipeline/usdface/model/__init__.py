"""Trained mappings: markers to a rig's weights, fitted on references and applied to takes."""

from usdface.model.head_space import MappedMarkers, into_head_space
from usdface.model.motion import fit_motion_space
from usdface.model.predict import Prediction, predict_weights
from usdface.model.skin import sample_skin
from usdface.model.train import train_mapping

__all__ = [
    "MappedMarkers",
    "Prediction",
    "fit_motion_space",
    "into_head_space",
    "predict_weights",
    "sample_skin",
    "train_mapping",
]
