"""A rig as compressed binary data for the web viewer (``web/face_viewer.js``).

The page deforms the face itself: the data holds the neutral, the triangles and the offsets of each
key of each shape, in whole micrometres (rounding at most 0.5 µm per axis). Arrays are stored as
differences of neighbours and deflated. ``docs/face_viewer.md`` shows how a page embeds it.
"""

import base64
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from usdface.core.arrays import Float32Array, FloatArray, IntArray, index_of
from usdface.core.assets import Rig
from usdface.core.deformer import Deformer
from usdface.media.face.camera import Camera, frame_rig
from usdface.media.face.features import ColorBand
from usdface.media.face.surface import Surface, build_surface
from usdface.media.face.tracing import PATTERN_COUNT, Tracer, sky_seen, traced_triangles
from usdface.media.picture.color import bytes_from_linear
from usdface.numerics.measure.face_regions import blinks, jaw_opener, region_of_shape
from usdface.numerics.surface.triangulation import normal_operator

PAYLOAD_FORMAT = 4
"""Version of the data; the viewer refuses others."""

STEPS_PER_MM = 1000.0
_SHARE_STEPS = 32_000  # steps per 1 of the parts' weights
_NARROW = np.iinfo(np.int16).max
_SKY_RAYS = 40
_OPEN_SHARE = 0.6
_SKY_AVERAGES = 6  # averages over neighbours, against the noise of ray counts
# Set of directions of each point, random, because a regular order causes stripes along mesh rows.
_PATTERN_OF = np.random.default_rng(0).integers(0, PATTERN_COUNT, 4093)
_FLAT_FOV = 2.0  # field of view in place of an orthographic camera [degrees]
_SKY_REACH = 0.28  # reach of occlusion over the head's height, as in the ray-cast pictures
_WEB = Path(__file__).parents[1] / "web"
_VIEWER = (
    "face_model.js",
    "face_shaders.js",
    "orbit_camera.js",
    "marker_labels.js",
    "face_viewer.js",
)
_LINKS = re.compile(r"^(import .*? from \"\./.*?\"|export \{.*?\});\n", re.MULTILINE)


@dataclass(frozen=True)
class FacePayload:
    """A rig as data of the web viewer."""

    header: dict[str, Any]
    """Counts, shapes, tracks, camera, and position of each array in `data`, for JSON."""
    data: bytes
    """All arrays, deflated (zlib)."""

    def header_json(self) -> str:
        """Return the header as JSON for a ``<script>`` element."""
        return json_in_script(self.header)

    def data_base64(self) -> str:
        """Return the data as base64 text, for pages opened from disk, which cannot fetch."""
        return base64.b64encode(self.data).decode("ascii")


def json_in_script(data: Mapping[str, Any]) -> str:
    """Return data as JSON for a ``<script>`` element, with ``<`` escaped."""
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


def read_web_file(name: str) -> bytes:
    """Return a source file of the pages, such as ``face_viewer.js``."""
    return (_WEB / name).read_bytes()


def viewer_source(*scripts: str) -> str:
    """Return the viewer and a page's scripts as one ES module, for pages that cannot load files.

    Scripts use `FaceViewer`, `unpackFace` and `bytesFromBase64` without importing them.

    `*scripts`: source files of the page, appended.
    """
    parts = [read_web_file(name).decode("utf-8") for name in (*_VIEWER, *scripts)]
    return "\n".join(_LINKS.sub("", part) for part in parts)


def pack_face(
    rig: Rig,
    *,
    camera: Camera | None = None,
    shares: sparse.csc_array | None = None,
    parts: tuple[str, ...] = (),
) -> FacePayload:
    """Pack a rig for the web viewer.

    The surface is that of `usdface.media.face.render`: without hidden meshes and lash cards, coarse
    cages subdivided, eyes, teeth and the inside of the mouth coloured if the rig has no colours.
    ``header["tracks"]`` lists the keys in the order of ``Deformer(rig).shapes.key_offsets``, so
    that markers attached to the rig can use the same key weights.

    Parameters
    ----------
    camera : Camera, optional
        Initial view; default: the head with hair from the front. Roll and lens shift are ignored.
    shares : sparse array, optional
        (points, parts): weights of the moving parts (joints, Xforms) that carry each point.
    parts : tuple of str, optional
        Text that tells the region of each shape, see
        `usdface.model.placement.shape_parts.shape_parts`; default: the shapes' names.
    """
    surface = build_surface(rig.meshes)
    deformer = Deformer(rig)
    used = np.unique(surface.triangles)
    matrix = sparse.csr_array(surface.matrix)[used]
    triangles = np.searchsorted(used, surface.triangles)
    if surface.outward < 0:
        triangles = triangles[:, ::-1]
    keys, neutral = _Keys.of(deformer, matrix), _micrometres(surface.rest[used])
    arrays: dict[str, NDArray[Any]] = {
        "neutral": np.diff(neutral.T, prepend=0, axis=1).astype(np.int32),
        "triangles": np.diff(triangles.ravel(), prepend=0).astype(np.int32),
        "middles": np.searchsorted(used, _middles(surface, used)).astype(np.int32),
        "colors": _colors(rig, deformer, surface)[used].T,
        "parts": _of_points(surface.parts, surface, fill=0)[used].astype(np.uint8),
        "eyes": _of_points(surface.eyes, surface, fill=-1)[used].astype(np.int8),
        "bare": np.round(255 * surface.band_opacity[used]).astype(np.uint8),
        "keyPoints": keys.points,
        "offsets16": keys.narrow,
        "offsets32": keys.wide,
    }
    if shares is not None:
        followed = (matrix @ shares).toarray().T
        arrays["carriers"] = np.round(_SHARE_STEPS * followed).astype(np.int16)
    header = {
        "format": PAYLOAD_FORMAT,
        "points": len(used),
        "triangles": len(triangles),
        "shapes": _shapes(rig, parts or rig.shapes),
        "tracks": _tracks(rig, keys),
        "combinations": rig.logic.tables(),
        "eyeCenters": np.round(surface.eye_centers, 4).tolist(),
        "bands": [_band(band) for band in surface.bands],
        "camera": _camera(camera or frame_rig(rig.meshes, hair=True)),
        "size": round(surface.size, 3),
        "eyesPutIn": surface.has_stand_in_eyes,
        "carriers": 0 if shares is None else shares.shape[1],
    }
    return _joined(header, arrays)


def _middles(surface: Surface, used: IntArray) -> IntArray:
    """Return each used point at the centre of a quad, and its four corners: (n, 5)."""
    middles = surface.middles
    rows = np.concatenate([middles.points[:, None], middles.corners], axis=1)
    return rows[np.isin(middles.points, used)]


@dataclass(frozen=True)
class _Keys:
    """Offsets of all keys, concatenated."""

    points: NDArray[np.int32]
    """(n,): differenced within each key."""
    narrow: NDArray[np.int16]
    wide: NDArray[np.int32]
    """`narrow`, `wide`: (m,) int16 and int32 arrays: offsets [µm], each key's x, then y, then z,
    differenced; keys with offsets above 32 mm are wide."""
    counts: list[int]
    is_wide: list[bool]

    @classmethod
    def of(cls, deformer: Deformer, matrix: sparse.csr_array) -> "_Keys":
        """Compute the offsets of the drawn points for each key of the rig."""
        cage = deformer.shapes.key_offsets.tocsc()
        axes = [sparse.csr_array(cage[:, axis::3] @ matrix.T) for axis in range(3)]
        points, narrow, wide = (list[NDArray[np.int64]]() for _ in range(3))
        counts, is_wide = list[int](), list[bool]()
        for key in range(cage.shape[0]):
            dense = np.stack([axis[[key]].toarray()[0] for axis in axes])
            offsets = _micrometres(dense)
            moved = np.flatnonzero(offsets.any(axis=0))
            planes = np.diff(offsets[:, moved], prepend=0, axis=1).ravel()
            # Differences wrap modulo the type, so the width follows from the offsets.
            far = bool(np.abs(offsets).max(initial=0) > _NARROW)
            (wide if far else narrow).append(planes)
            points.append(np.diff(moved, prepend=0))
            counts.append(len(moved))
            is_wide.append(far)
        return cls(
            points=_concatenated(points).astype(np.int32),
            narrow=_concatenated(narrow).astype(np.int16),
            wide=_concatenated(wide).astype(np.int32),
            counts=counts,
            is_wide=is_wide,
        )


def _shapes(rig: Rig, parts: tuple[str, ...]) -> list[dict[str, Any]]:
    return [
        {"name": name, "region": region_of_shape(part), "low": float(low), "high": float(high)}
        for name, part, (low, high) in zip(rig.shapes, parts, rig.ranges, strict=True)
    ]


def _tracks(rig: Rig, keys: _Keys) -> list[dict[str, Any]]:
    """Return the keys of each mesh's shapes, ascending, in the deformer's order."""
    channels = index_of((*rig.shapes, *(each.shape for each in rig.combinations)))
    tracks, first = list[dict[str, Any]](), 0
    for shape in (shape for mesh in rig.meshes for shape in mesh.shapes):
        of_shape = range(first, first + len(shape.keys))
        first = of_shape.stop
        tracks.append(
            {
                "shape": channels[shape.name],
                "weights": sorted(float(key.weight) for key in shape.keys),
                "counts": [keys.counts[key] for key in of_shape],
                "wide": [keys.is_wide[key] for key in of_shape],
            }
        )
    return tracks


def _colors(rig: Rig, deformer: Deformer, surface: Surface) -> NDArray[np.uint8]:
    """Return red, green, blue (sRGB) and visible share of the sky of every drawn point: bytes."""
    paint = bytes_from_linear(surface.albedo[None])[0]
    # At rest, eyes shut and mouth open: lids are lit in a blink, and teeth not black.
    poses = np.zeros((3, len(rig.shapes)))
    poses[1, blinks(rig.shapes)] = 1.0
    jaw = jaw_opener(rig.shapes)
    if jaw is not None:
        poses[2, jaw] = 0.7
    best = np.zeros(len(surface.rest), np.float32)
    for index, cage in enumerate(deformer.points(poses)):
        if index and not poses[index].any():
            continue
        # Points that are open at rest need no other pose.
        rows = np.flatnonzero(best < _OPEN_SHARE)
        best[rows] = np.maximum(best[rows], _sky_of(surface, cage, rows))
    opened = np.round(255 * np.clip(_averaged(best, surface), 0, 1)).astype(np.uint8)
    return np.concatenate([paint, opened[:, None]], axis=1)


def _sky_of(surface: Surface, cage: FloatArray, rows: IntArray) -> Float32Array:
    """Return the visible share of the sky of some drawn points in one pose of the rig [0-1]."""
    fine = np.asarray(surface.matrix @ cage)
    normals = surface.normals_at(fine)[rows]
    aim = (surface.outward * normals).astype(np.float32)
    return sky_seen(
        Tracer(fine.astype(np.float32), traced_triangles(surface.triangles)),
        fine[rows].astype(np.float32) + np.float32(2e-3 * surface.size) * aim,
        aim,
        patterns=_PATTERN_OF[rows % len(_PATTERN_OF)],
        ray_count=_SKY_RAYS,
        reach=_SKY_REACH * surface.size,
    )


def _averaged(values: Float32Array, surface: Surface) -> Float32Array:
    """Average each point with its adjacent triangles."""
    operator = normal_operator(surface.triangles, point_count=len(values))
    uses = np.maximum(np.asarray(operator.sum(axis=1)).ravel(), 1)
    for _ in range(_SKY_AVERAGES):
        around = np.asarray(operator @ values[surface.triangles].mean(axis=1)) / uses
        values = np.asarray(0.4 * values + 0.6 * around, np.float32)
    return values


def _of_points(of_triangles: IntArray, surface: Surface, *, fill: int) -> IntArray:
    """Return values of triangles at their points, which pieces do not share."""
    values = np.full(len(surface.rest), fill, np.int64)
    values[surface.triangles] = of_triangles[:, None]
    return values


def _band(band: ColorBand) -> dict[str, Any]:
    return {
        "ends": [round(x, 3) for x in band.ends],
        "rows": np.round(band.rows.ravel().astype(float), 3).tolist(),
        "edge": round(band.edge, 3),
        "color": np.round(band.color.astype(float), 4).tolist(),
    }


def _camera(camera: Camera) -> dict[str, Any]:
    back = np.subtract(camera.eye, camera.target)
    distance, fov = float(np.linalg.norm(back)), camera.fov_degrees
    if camera.span_mm is not None:  # the page has perspective only: approximated by a long lens
        fov = _FLAT_FOV
        distance = camera.span_mm / 2 / float(np.tan(np.radians(fov / 2)))
    back = back / np.linalg.norm(back)
    return {
        "target": [round(each, 4) for each in camera.target],
        "distance": round(distance, 4),
        "fov": fov,
        "yaw": round(float(np.arctan2(back[0], back[2])), 6),
        "pitch": round(float(np.arcsin(np.clip(back[1], -1, 1))), 6),
        "framedWidth": round(camera.framed_width, 4),
    }


def _micrometres(lengths: FloatArray | Float32Array) -> NDArray[np.int64]:
    return np.round(np.asarray(lengths, np.float64) * STEPS_PER_MM).astype(np.int64)


def _concatenated(parts: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.zeros(0, np.int64)


def _joined(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> FacePayload:
    """Concatenate arrays, the widest types first so that all are aligned."""
    ordered = sorted(arrays.items(), key=lambda item: -item[1].dtype.itemsize)
    blocks = [
        np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes() for _, array in ordered
    ]
    starts = np.cumsum([0, *map(len, blocks)]).tolist()
    header["arrays"] = {
        name: {"type": f"{array.dtype.kind}{array.dtype.itemsize}", "start": a, "count": array.size}
        for (name, array), (a, _) in zip(ordered, pairwise(starts), strict=True)
    }
    header["bytes"] = starts[-1]
    return FacePayload(header, zlib.compress(b"".join(blocks), level=6))
