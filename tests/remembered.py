"""What tests ask many times of the same files, computed once for all processes of a run."""

import os
import pickle
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from pkgutil import resolve_name
from typing import Any
from unittest.mock import patch

from usdface.core import deformer
from usdface.numerics.registration import face_skin

COARSE_SAMPLES = 4000
"""Samples of a face's skin; a third of the usual number, as time is proportional to it."""

PLACING = (
    ("usdface.model.selection.baseline", "place_markers"),
    ("usdface.model.selection.baseline", "match_peaks"),
    ("usdface.model.selection.baseline", "_noise_mm"),
)
REMEMBERED = (
    *PLACING,
    ("usdface.demo.rig", "bare_head"),
    ("usdface.model.mapping.corrected_pairs", "fit_pairs_forward"),
    ("usdface.model.mapping.corrected_pairs", "fit_marker_basis"),
    ("usdface.model.mapping.evaluation", "points_by_region"),
    ("usdface.model.mapping.take_neutral", "find_offset"),
    ("usdface.model.regressions.forward_model", "_maximise_evidence"),
    ("usdface.model.retarget.face_correspondence", "align_cloud"),
    ("usdface.model.selection.baseline", "solve_weights"),
    ("usdface.model.surface.binding", "place_markers"),
    ("usdface.numerics.rigid.pose_error:ExpressionMotion", "find_errors"),
    ("usdface.steps.capture.ingest", "judge_markers"),
    ("usdface.steps.inputs.cleaned_takes", "find_head_space"),
    ("usdface.steps.inputs.placed_takes", "place_markers"),
    ("usdface.steps.inputs.placed_takes", "judge_placement"),
    ("usdface.steps.inputs.placed_takes", "bind_at"),
    ("usdface.steps.inputs.placed_takes", "draw_binding"),
    ("usdface.steps.inputs.coverage_report", "draw_coverage"),
    ("usdface.steps.surface.plan", "fit_gp_surface"),
    ("tests.steps.small_shot", "coarse_head"),
    ("usdface.media.face.surface", "_rest_exposure"),
    ("usdface.media.face.render", "build_surface"),
    ("usdface.media.page.face_payload", "build_surface"),
    ("usdface.media.page.face_payload", "_sky_of"),
)
"""The demo's heads, where the shot's markers are placed and how far they move there, the picture of
it, what is drawn of a rig, how much light falls on each of the face's points, the basis of a scan's
variances, how far a take's markers lie from the references', its head space, whether captured
markers can be a face, the errors of poses, the forward models of pairs, and what the blendshape
equation solves: most steps ask for them. What is remembered goes by the content of all arguments.
Tests of one of these call it under its own name."""


def remember(
    folder: Path, names: tuple[tuple[str, str], ...], replace: Callable[[Any, str, Any], None]
) -> None:
    """Replace functions by ones that compute once what follows from their arguments."""
    folder.mkdir(exist_ok=True)
    for owner_name, name in names:
        owner = resolve_name(owner_name)
        replace(owner, name, _remembering(getattr(owner, name), folder))
    # Tests of where markers lie call `sample_face_skin` themselves.
    replace(deformer, "sample_face_skin", _remembering(coarse_face_skin, folder))


def coarse_face_skin(*rig: Any) -> face_skin.FaceSkin:
    """Sample the skin as `sample_face_skin`, coarsely."""
    uncached = face_skin.sample_face_skin.__wrapped__  # type: ignore[attr-defined]
    with patch.object(face_skin, "_SAMPLE_COUNT", COARSE_SAMPLES):
        return uncached(*rig)  # type: ignore[no-any-return]


def _remembering(function: Callable[..., object], folder: Path) -> Callable[..., object]:
    def remembering(*given: object, **named: object) -> object:
        content = pickle.dumps((given, named))
        file = folder / f"{function.__name__}.{sha256(content).hexdigest()}"
        if not file.is_file():
            store(file, function(*given, **named))
        return pickle.loads(file.read_bytes())

    return remembering


def store(file: Path, value: object) -> None:
    """Write a file that other processes see whole or not at all."""
    part = file.with_name(f"{file.name}.{os.getpid()}")
    part.write_bytes(pickle.dumps(value))
    part.replace(file)
