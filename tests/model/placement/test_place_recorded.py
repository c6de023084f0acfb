"""Placed markers and the blendshape equation on whole takes, head motion out, nothing repaired."""

import json
from dataclasses import dataclass

import ezc3d
import numpy as np
import pytest
from scipy import sparse

from tests.model.placement.conftest import search_from_few_starts
from tests.numerics.simulated_face import hold_head
from tests.remembered import coarse_face_skin
from usdface.model.placement import place
from usdface.model.placement.marker_cloud import marker_cloud
from usdface.numerics.registration.virtual_markers import character_motion, marker_deltas
from usdface.numerics.rigid.stabilization import stabilize
from usdface.numerics.solve.blendshape_equation import solve_least_squares, solve_weights
from usdface.usdio.rig.read import read_rig

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Surface:
    points: np.ndarray
    triangles: np.ndarray
    offsets: np.ndarray
    shapes: tuple[str, ...]

    @property
    def flat_offsets(self):
        return sparse.csr_array(self.offsets.reshape(len(self.offsets), -1))


def read_surface(path):
    rig = read_rig(path)
    (mesh,) = [mesh for mesh in rig.meshes if mesh.shapes]
    starts = np.concatenate([[0], np.cumsum(mesh.face_counts)[:-1]])
    fans = []
    for corner in range(1, int(mesh.face_counts.max()) - 1):
        first = starts[mesh.face_counts > corner + 1]
        fans.append(mesh.face_indices[first[:, None] + [0, corner, corner + 1]])
    offsets = np.zeros((len(rig.shapes), len(mesh.points), 3))
    for shape in mesh.shapes:
        key = shape.keys[-1]
        offsets[rig.shapes.index(shape.name), key.points] = key.offsets
    return Surface(mesh.points, np.concatenate(fans), offsets, rig.shapes)


def read_c3d(path):
    file = ezc3d.c3d(str(path))
    positions = file["data"]["points"][:3].transpose(2, 1, 0)
    visible = file["data"]["meta_points"]["residuals"][0].T >= 0
    visible &= np.isfinite(positions).all(axis=2)
    return np.where(visible[..., None], positions, 0.0), visible, labels_of(file)


def labels_of(file):
    return list(file["parameters"]["POINT"]["LABELS"]["value"])


@dataclass(frozen=True)
class Crossing:
    """A take whose truth is known, registered on its rig."""

    face: Surface
    deltas: np.ndarray
    motion: np.ndarray
    visible: np.ndarray
    truth: np.ndarray
    mobile: np.ndarray


@pytest.fixture(scope="module")
def crossing(shared_data):
    folder = shared_data / "crosstake"
    face = read_surface(shared_data / "rigs" / "facecap_head.usdc")
    meta = json.loads((folder / "take.json").read_text())
    truth = np.load(folder / "truth.npz")
    order = [[str(name) for name in truth["shapes"]].index(shape) for shape in face.shapes]
    positions, visible, labels = read_c3d(folder / "take.c3d")
    rigid = [labels.index(name) for name in meta["rigid"]]
    head = stabilize(positions, visible, rigid=rigid, neutral=meta["neutral_frame"])
    still = hold_head(positions, head)
    step = slice(meta["neutral_frame"] % 4, None, 4)
    moved, seen = np.asarray(still[step], float), visible[step]
    neutral = np.asarray(still[meta["neutral_frame"]], float)
    hidden = ~visible[meta["neutral_frame"]]
    neutral[hidden] = np.nanmedian(np.where(seen[..., None], moved, np.nan), axis=0)[hidden]
    moved = np.where(seen[..., None], moved, neutral)
    skin = coarse_face_skin(face.points, face.triangles, face.flat_offsets)
    cloud = marker_cloud(tuple(labels), neutral, moved, visible=seen, rigid=rigid)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(place, "_POSE_ROUNDS", 0)
        search_from_few_starts(patch)
        virtual = place.place_markers(cloud, skin, face.shapes).virtual
    mobile = np.ones(len(labels), bool)
    mobile[rigid] = False
    return Crossing(
        face,
        marker_deltas(virtual, face.flat_offsets),
        character_motion(virtual, moved, neutral),
        seen,
        truth["weights"][step][:, order].astype(float),
        mobile,
    )


def surface_rms(face, error):
    gram = np.einsum("spc,tpc->st", face.offsets, face.offsets) / len(face.points)
    return float(np.sqrt(np.einsum("fs,st,ft->f", error, gram, error).mean()))


def test_true_weights_move_the_virtual_markers_as_the_performer_moved(crossing):
    said = np.einsum("fs,smc->fmc", crossing.truth, crossing.deltas)[:, crossing.mobile]
    seen = crossing.motion[:, crossing.mobile]
    said, seen = said - said.mean(axis=0), seen - np.median(seen, axis=0)
    mask = crossing.visible[:, crossing.mobile, None]
    shared = (said * seen * mask).sum((0, 2))
    correlation = shared / np.sqrt(
        (said**2 * mask).sum((0, 2)) * (seen**2 * mask).sum((0, 2)) + 1e-9
    )
    assert np.median(correlation) > 0.85


def test_bounded_proposals_beat_plain_least_squares(crossing):
    options = {"visible": crossing.visible, "marker_trust": crossing.mobile.astype(float)}
    plain = solve_least_squares(crossing.deltas, crossing.motion, **options)
    bounded = solve_weights(crossing.deltas, crossing.motion, ridge=10, **options).weights
    before = surface_rms(crossing.face, np.clip(plain, 0, 1) - crossing.truth)
    after = surface_rms(crossing.face, bounded - crossing.truth)
    assert after < 1.6  # mm; the same head at rest is 5.6 away
    assert after < 0.75 * before


@pytest.mark.parametrize("rig", ["ict_face", "facecap_head"])
def test_a_recorded_performer_without_labels_lands_on_the_right_parts(shared_data, rig):
    face = read_surface(shared_data / "rigs" / f"{rig}.usdc")
    positions, visible, labels = read_c3d(shared_data / "markers_animface" / "CheeksMoCap.c3d")
    forehead = ["NoseTop", "Leye_Inside", "Reye_Inside", "Eyebrow_Center", "ForeHead_M"]
    head = stabilize(positions, visible, rigid=[labels.index(name) for name in forehead], neutral=0)
    moved = np.asarray(hold_head(positions, head), float)
    skin = coarse_face_skin(face.points, face.triangles, face.flat_offsets)
    cloud = marker_cloud(tuple(f"m{i}" for i in range(len(labels))), moved[0], moved)
    virtual = place.place_markers(cloud, skin, face.shapes).virtual
    at = dict(zip(labels, virtual.places(face.points), strict=True))
    down = ["ForeHead_M", "Eyebrow_Center", "NoseTop", "NoseHead", "Mouth_Up", "Mouth_Down", "Chin"]
    assert (np.diff([at[name][1] for name in down]) < 0).all()
    for left, right in (("Leye_Outside", "Reye_Outside"), ("Mouth_Lend", "Mouth_Rend")):
        assert at[left][0] > 0 > at[right][0]
    jaw = marker_deltas(virtual, face.flat_offsets)[face.shapes.index("jawOpen"), :, 1]
    fall = dict(zip(labels, jaw, strict=True))
    assert fall["Mouth_Down"] < -10  # mm: lips are told apart
    assert abs(fall["Mouth_Up"]) < 0.2 * abs(fall["Mouth_Down"])
