"""The built-in head as a rig: the 52 shapes of ARKit, in named meshes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import FloatArray, IntArray, smoothstep
from usdface.core.assets import MeshShape, Rig, RigMesh, ShapeKey
from usdface.demo.fields import LID_TURNS, FaceFields
from usdface.demo.head import DemoHead, HeadPart, bare_head
from usdface.demo.sculpt import CHARACTER, Style

Keys = tuple[tuple[float, FloatArray], ...]

JAW_OPEN_DEGREES = 17.0


def make_head(style: Style) -> DemoHead:
    """Build the head of a style: 19,000 points and 52 shapes, with in-betweens of blinks."""
    return with_shapes(bare_head(style))


def with_shapes(head: DemoHead) -> DemoHead:
    """Add the shapes to a head at rest."""
    fields = FaceFields(head)
    pairs = {**_brow_pairs(fields), **_eye_pairs(fields), **_mouth_pairs(fields)}
    left: dict[str, Keys] = {name: ((1.0, _sided(head, field)),) for name, field in pairs.items()}
    left["eyeBlink"] = tuple(
        (weight, _sided(head, _blink(fields, weight))) for weight in (0.25, 0.5, 0.75, 1.0)
    )
    left |= {name: ((1.0, field),) for name, field in _sideways(fields).items()}
    shapes: dict[str, Keys] = {}
    for name, keys in left.items():
        shapes[name + "Left"] = keys
        shapes[name + "Right"] = tuple((weight, _flipped(head, field)) for weight, field in keys)
    for name, field in _whole(fields).items():
        signed = field * _sign(head)
        shapes[name] = ((1.0, 0.5 * (signed + _flipped(head, signed))),)
    return replace(head, shapes={name: _followed(head, shapes[name]) for name in sorted(shapes)})


def _sign(head: DemoHead) -> FloatArray:
    """Return factors that mirror a field of the left frame at x < 0, smooth across the midline."""
    x = head.points[:, 0]
    hard = np.isin(head.parts, (HeadPart.EYES, HeadPart.LASHES))
    sign = np.where(hard, np.sign(x), np.tanh(x / 2.5))
    return np.column_stack([sign, np.ones_like(x), np.ones_like(x)])


def _sided(head: DemoHead, field: FloatArray) -> FloatArray:
    """Return the left side of a field."""
    x = head.points[:, 0]
    left = np.where(
        np.isin(head.parts, (HeadPart.EYES, HeadPart.LASHES)), x > 0.0, smoothstep(x, -5.5, 5.5)
    )
    return field * _sign(head) * left[:, None]


def _flipped(head: DemoHead, field: FloatArray) -> FloatArray:
    return np.asarray(field[head.mirror] * (-1.0, 1.0, 1.0))


def _followed(head: DemoHead, keys: Keys) -> Keys:
    """Move lashes that a field does not move with the edge of the lid."""
    lash = head.parts == HeadPart.LASHES
    done = []
    for weight, field in keys:
        moved = field.copy()
        still = lash & ~np.any(np.abs(field) > 0.0, axis=1)
        moved[still] = field[head.anchors[still]]
        done.append((weight, moved))
    return tuple(done)


def _blink(f: FaceFields, amount: float) -> FloatArray:
    eye = f.style.eye
    drop = f.push(eye.center[0], eye.center[1] + 19.0, 18, 9, (0, -1.6 * amount, 0), f.off_lid)
    lift = f.push(eye.center[0] + 3, eye.center[1] - 17.0, 17, 9, (0, 1.0 * amount, 0.3), f.off_lid)
    return f.lids(amount, amount) + drop + lift * amount


def _brow_pairs(f: FaceFields) -> dict[str, FloatArray]:
    ex, ey = f.style.eye.center[:2]
    by = ey + f.style.skull.brow_height + 2.0

    def brow(x: float, width: float, by_mm: tuple[float, float, float]) -> FloatArray:
        hanging = np.exp(-((np.minimum(f.y - by + 5.0, 0.0) / 9.0) ** 2))  # without the fold below
        return f.push(x, by, width, 15.0, by_mm, f.off_lid * hanging)

    frown = f.fold((4.0, by - 6.0), (5.5, by + 9.0), 2.4, 1.4)
    return {
        "browDown": brow(13, 17, (-3.2, -7.6, 1.6))
        + brow(ex + 8, 18, (-1.0, -4.2, 0.6))
        + frown
        + f.lids(*LID_TURNS["browDown"]),
        "browOuterUp": brow(ex + 12, 17, (0.4, 8.0, -1.0)) + brow(ex - 4, 14, (0, 2.0, 0)),
    }


def _eye_pairs(f: FaceFields) -> dict[str, FloatArray]:
    ex, ey = f.style.eye.center[:2]
    by = ey + f.style.skull.brow_height
    return {
        "eyeWide": f.lids(*LID_TURNS["eyeWide"]) + f.push(ex, by, 20, 14, (0, 1.6, 0), f.off_lid),
        "eyeSquint": f.lids(*LID_TURNS["eyeSquint"])
        + f.push(ex + 3, ey - 20, 18, 9, (0, 2.6, 1.8), f.off_lid)
        + f.push(ex + 22, ey - 3, 9, 10, (-1.6, 0.4, 0.5), f.off_lid),
        "cheekSquint": f.lids(*LID_TURNS["cheekSquint"])
        + f.push(ex + 4, ey - 25, 19, 12, (0.6, 5.2, 3.6), f.off_lid)
        + f.fold((ex - 14, ey - 15), (ex + 16, ey - 17), 2.6, 0.8),
        "eyeLookUp": f.gaze(0, 24)
        + f.lids(*LID_TURNS["eyeLookUp"])
        + f.push(ex, by, 18, 12, (0, 0.8, 0), f.off_lid),
        "eyeLookDown": f.gaze(0, -26) + f.lids(*LID_TURNS["eyeLookDown"]),
        "eyeLookOut": f.gaze(30, 0) + _lid_bulge(f, 1.0),
        "eyeLookIn": f.gaze(-30, 0) + _lid_bulge(f, -1.0),
    }


def _lid_bulge(f: FaceFields, outwards: float) -> FloatArray:
    """Move the lids slightly to the side of the gaze."""
    eye = f.style.eye
    near = np.exp(-(((f.x - eye.center[0]) / eye.half_width) ** 2)) * smoothstep(
        f.eye_ring, 3.0, 1.0
    )
    return np.outer(near * (np.abs(f.eye_side) > 0.2), (0.9 * outwards, 0.0, 0.0))


def _mouth_pairs(f: FaceFields) -> dict[str, FloatArray]:
    m, n = f.style.mouth, f.style.nose
    w, my = m.half_width, m.height
    eye_x, eye_y = f.style.eye.center[:2]
    aside = 1.0 - np.exp(-((f.x / (0.68 * w)) ** 2.6))

    def corner(x: float, y: float, z: float, size: float = 1.0) -> FloatArray:
        return f.push(w, my + m.curve, 19 * size, 14.5 * size, (x, y, z), aside)

    along_lip = np.exp(-((np.maximum(f.x - 0.45 * w, 0.0) / (0.6 * w)) ** 2))
    press = f.lips * np.exp(-(((f.x - 0.55 * w) / (0.7 * w)) ** 2))
    pressed = np.column_stack([0 * press, -0.30 * press * f.above_line, -1.8 * press])
    smile_line = ((n.wing[0] + 6.5, n.wing[1] + 2.0), (w + 13.0, my - 2.0))
    return {
        "mouthSmile": corner(8.0, 8.6, -6.5)
        + f.push(w + 9, my + 21, 17, 14, (1.6, 5.0, 4.6))
        + f.fold(*smile_line, 3.6, 0.9)
        + f.push(n.wing[0], n.wing[1], 8, 8, (1.2, 0.6, 0))
        + f.lids(*LID_TURNS["mouthSmile"])
        + f.push(eye_x + 3, eye_y - 22, 18, 9, (0, 1.6, 1.2), f.off_lid),
        "mouthFrown": corner(1.5, -8.0, -2.2, 0.92)
        + f.push(w + 4, my - 17, 11, 10, (0.5, -2.6, 1.6))
        + f.push(0, f.style.skull.chin[1] + 3, 14, 9, (0, 1.6, 1.0))
        + f.fold((w + 1, my - 5), (w + 3, my - 22), 2.6, 1.0),
        "mouthDimple": corner(5.0, 1.2, -5.5, 0.72)
        + f.fold((w + 9, my + 9), (w + 9, my - 8), 3.0, 2.0),
        "mouthStretch": corner(8.5, -4.0, -5.5, 1.08)
        + f.push(w + 5, my - 22, 17, 16, (1.5, -2.5, 0))
        + f.push(w - 5, -125.0, 9, 22, (1.0, 0, 2.5)),
        "mouthPress": pressed + corner(0.8, 0.6, -1.6, 0.6),
        "mouthLowerDown": np.outer(f.lower * along_lip, (1.2, -8.0, 0.4))
        + f.push(0.5 * w, my - 18, 15, 10, (0.4, -2.6, 0.8), 1.0 - f.lips),
        "mouthUpperUp": np.outer(f.upper * along_lip, (0.6, 7.0, 1.2))
        + f.push(0.65 * w, my + 15, 12, 9, (0.5, 3.0, 1.4), 1.0 - f.lips)
        + f.fold(*smile_line, 2.8, 0.9),
        "noseSneer": f.push(n.wing[0] + 1, n.wing[1] + 1, 9.5, 10, (1.6, 4.4, 1.2))
        + f.push(9, n.wing[1] + 26, 8, 16, (0, 2.2, 1.4))
        + f.push(12, eye_y + 20, 12, 11, (-1.0, -3.4, 0.6), f.off_lid)
        + np.outer(f.upper * np.exp(-(((f.x - 0.55 * w) / (0.5 * w)) ** 2)), (0, 4.0, 0.8))
        + f.fold(*smile_line, 2.8, 1.6)
        + f.fold((5.0, n.root[0] - 9.0), (9.0, n.root[0] - 2.0), 2.0, 0.8)
        + f.lids(*LID_TURNS["noseSneer"]),
    }


def _whole(f: FaceFields) -> dict[str, FloatArray]:
    m, skull = f.style.mouth, f.style.skull
    w, my = m.half_width, m.height
    zero = np.zeros_like(f.x)
    side = np.clip(f.lip_side, -1.0, 1.0)
    by = f.style.eye.center[1] + skull.brow_height + 2.0
    round_mouth = f.soft * np.exp(-((f.x / (1.25 * w)) ** 4) - ((f.above_line / 21.0) ** 2))
    gather = round_mouth * f.x
    wide_open = f.hinge(JAW_OPEN_DEGREES)
    # Opening pulls the corners of the mouth inwards and stretches the cheeks.
    wide_open += f.push(w + 2.0, my - 8.0, 14, 22, (-3.6, 0.8, 1.6))
    closing = f.lip_gap(wide_open)
    tall = np.maximum(np.abs(f.above_line) - 7.0, 0.0)
    # Lips part by side; around the corners, which have no side, skin parts by height.
    by_height = np.clip(f.above_line / 7.0, -1.0, 1.0)
    parted = by_height + smoothstep(f.lips, 0.0, 0.6) * (np.clip(4.0 * side, -1, 1) - by_height)
    share = np.where(parted > 0.0, 0.40 * parted, 0.60 * parted)
    # The jaw moves back as it opens, which only the lower lip compensates.
    forward = np.minimum(parted, 0.0)
    near = f.soft * np.exp(-((tall / 13.0) ** 2))
    upper_cone, lower_cone = f.upper * f.open_width, f.lower * f.open_width
    chin = f.push(0, skull.chin[1] + 2.0, 17, 12, (0, 4.4, 1.8))
    tongue = f.head.parts == HeadPart.TONGUE
    back = f.z[tongue].min() if np.any(tongue) else 0.0
    along = np.clip((f.z - back) / 36.0, 0.0, 1.0) * tongue
    return {
        "browInnerUp": f.push(9, by, 15, 15, (-0.4, 8.6, 0.4), f.off_lid)
        + f.fold((0.0, by + 22.0), (20.0, by + 21.0), 3.0, -0.9),
        "jawOpen": wide_open,
        "jawForward": np.outer(f.jaw, (0, -0.6, 7.5)),
        "mouthClose": closing * np.column_stack([share, share, forward]) * near[:, None]
        + f.push(w + 3.0, my - 2.0, 9, 10, (0, 2.4, 0)),
        "cheekPuff": f.push(w + 14, my + 2, 17, 21, (6.5, 0, 8.5), 1.0 - 0.7 * f.lips)
        + f.push(0, my + 12, 22, 7, (0, 0, 2.4))
        + f.push(0, my - 14, 20, 6, (0, 0, 1.6))
        + f.lips[:, None] * np.column_stack([-0.07 * f.x, -0.2 * f.above_line, zero + 0.6]),
        "mouthFunnel": np.column_stack([-0.36 * gather, zero, 6.0 * round_mouth])
        + np.outer(upper_cone, (0, 5.0, 4.0))
        + np.outer(lower_cone, (0, -5.6, 4.0)),
        "mouthPucker": np.column_stack([-0.50 * gather, zero, 6.5 * round_mouth])
        + np.outer(upper_cone, (0, 0.1, 4.6))
        + np.outer(lower_cone, (0, -0.1, 4.6)),
        "mouthRollUpper": _rolled(f, f.upper, 1.0),
        "mouthRollLower": _rolled(f, f.lower, -1.0),
        "mouthShrugLower": np.outer(f.lower, (0, 3.4, 3.0))
        + np.outer(upper_cone, (0, 3.2, 1.4))
        + chin,
        "mouthShrugUpper": np.outer(f.upper, (0, 3.8, 2.6)) + np.outer(lower_cone, (0, 2.8, 1.0)),
        "tongueOut": (np.outer(along, (0.0, 9.5, 27.0)) - np.outer(along**4, (0.0, 4.0, 0.0))),
    }


def _rolled(f: FaceFields, lip: FloatArray, sign: float) -> FloatArray:
    """Curl a lip inwards over the teeth, around the line of the lips."""
    width = (0.35 + 0.65 * f.open_width) * lip
    return np.column_stack(
        [0 * width, -0.42 * width * f.above_line - 0.2 * sign * width, -3.6 * width]
    )


def _sideways(f: FaceFields) -> dict[str, FloatArray]:
    m = f.style.mouth
    around = f.soft * np.exp(-((f.x / (1.5 * m.half_width)) ** 2) - ((f.above_line / 20.0) ** 2))
    return {"jaw": np.outer(f.jaw, (8.0, -0.8, 0.0)), "mouth": np.outer(around, (8.0, 0.0, -0.6))}


MESHES = {
    "skin": (HeadPart.SKIN, HeadPart.EARS),
    "eyes": (HeadPart.EYES,),
    "teeth": (HeadPart.UPPER_TEETH, HeadPart.LOWER_TEETH),
    "tongue": (HeadPart.TONGUE,),
    "brows": (HeadPart.BROWS,),
    "lashes": (HeadPart.LASHES,),
    "hair": (HeadPart.HAIR,),
}
"""Mesh names and the parts of the head in each, in drawing order."""

SMALLEST_OFFSET = 1e-4
"""Least displacement of a point in a sparse shape [mm]."""


def demo_rig(style: Style = CHARACTER) -> Rig:
    """Build a style's head as a rig; `Rig.file` is empty until it is written."""
    return rig_from_head(make_head(style))


def rig_from_head(head: DemoHead) -> Rig:
    """Split a head into meshes with sparse shapes."""
    prim = f"/{head.style.name}"
    names = tuple(head.shapes)
    return Rig(
        file=Path(),
        prim=prim,
        shapes=names,
        meshes=tuple(
            _mesh(head, f"{prim}/geometry/{name}", points)
            for name, points in mesh_points(head).items()
        ),
        ranges=np.tile([0.0, 1.0], (len(names), 1)),
    )


def mesh_points(head: DemoHead) -> dict[str, IntArray]:
    """Return the head's points of each mesh of its rig, in the mesh's order."""
    return {
        name: np.flatnonzero(np.isin(head.parts, [int(part) for part in parts]))
        for name, parts in MESHES.items()
    }


def _mesh(head: DemoHead, path: str, points: IntArray) -> RigMesh:
    place = np.full(len(head.points), -1)
    place[points] = np.arange(len(points))
    faces = place[head.faces[np.all(place[head.faces] >= 0, axis=1)]]
    shapes = []
    for name, keys in head.shapes.items():
        sparse = tuple(_key(weight, offsets[points]) for weight, offsets in keys)
        if any(len(key.points) for key in sparse):
            shapes.append(MeshShape(name, sparse))
    return RigMesh(
        path=path,
        points=head.points[points],
        face_counts=np.full(len(faces), 4, np.int64),
        face_indices=faces.ravel(),
        shapes=tuple(shapes),
        colors=head.colors[points],
        subdivision="none",
    )


def _key(weight: float, offsets: FloatArray) -> ShapeKey:
    moved = np.flatnonzero(np.linalg.norm(offsets, axis=1) > SMALLEST_OFFSET)
    return ShapeKey(weight, moved, offsets[moved])
