"""Displacement fields on a head: soft pushes, rotation of lids, hinge of the jaw, lips.

Fields are (points, 3) float arrays [mm], computed over |x| in the frame of the left side, so that
left and right shapes are exact mirror images.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from usdface.core.arrays import FloatArray, smoothstep
from usdface.demo.half_cage import Mark
from usdface.demo.head import DemoHead, HeadPart, lid_edge, lip_rim

BLINK_MEETS = 0.16
"""Height at which the lids of a blink meet, as a share of the opening from the lower lid's edge."""

LID_TURNS: Mapping[str, tuple[float, float]] = {
    "eyeBlink": (1.0, 1.0),
    "eyeSquint": (0.22, 2.0),
    "eyeWide": (-0.34, -1.3),
    "eyeLookUp": (-0.24, 0.3),
    "eyeLookDown": (0.50, -1.6),
    "cheekSquint": (0.0, 1.7),
    "mouthSmile": (0.0, 0.9),
    "noseSneer": (0.06, 0.8),
    "browDown": (0.18, 0.0),
}
"""Rotation of the upper and the lower lid relative to a blink; negative opens."""

Push = tuple[float, float, float]


class FaceFields:
    """The fields of one head, with weights that they share."""

    def __init__(self, head: DemoHead) -> None:
        style = head.style
        self.head, self.style = head, style
        self.x = np.abs(head.points[:, 0])
        self.y, self.z = head.points[:, 1], head.points[:, 2]
        self.eye_ring, self.eye_side = head.marks[:, Mark.EYE_RING], head.marks[:, Mark.EYE_SIDE]
        ring, self.lip_side = head.marks[:, Mark.MOUTH_RING], head.marks[:, Mark.MOUTH_SIDE]
        inside = np.interp(ring, [-5.0, -4.0, -3.0, -2.0, -1.0, 0.0], [0, 0.05, 0.25, 0.7, 0.95, 1])
        soft = np.isin(head.parts, (HeadPart.SKIN, HeadPart.BROWS)) * smoothstep(self.z, 0.0, 40.0)
        self.soft = np.where(ring < 0.0, inside, soft)
        """Softness of the skin [0-1]: 1 in front, 0 at the back."""
        self.off_lid = smoothstep(self.eye_ring, 0.8, 3.6)
        self._lip_weights(ring)
        self._lid_angles()

    def _lip_weights(self, ring: FloatArray) -> None:
        mouth = self.style.mouth
        across = self.x / mouth.half_width
        self.above_line = self.y - (mouth.height + mouth.curve * np.minimum(across, 1.2) ** 2)
        """Height above the line of the lips [mm]."""
        self.open_width = np.maximum(1.0 - np.minimum(across, 1.0) ** 2, 0.0) ** 0.55
        """1 in the middle of the lips, 0 in the corners."""
        reach = smoothstep(ring, 4.3, 1.6) * self.soft
        self.upper = reach * np.clip(self.lip_side, 0.0, 1.0)
        self.lower = reach * np.clip(-self.lip_side, 0.0, 1.0)
        self.lips = smoothstep(ring, 3.6, 1.6) * self.soft

        # The jaw's skin is separated from the upper face by a line from the mouth to the ear.
        parted = np.clip(self.lip_side, -1.0, 1.0) * self.open_width * smoothstep(ring, 4.6, 1.0)
        line = self.above_line - 0.38 * np.maximum(78.0 - self.z, 0.0)
        down = np.clip(line / 24.0 + parted, -1.0, 1.0)
        flesh = (0.5 - 0.5 * np.sin(0.5 * np.pi * down)) * smoothstep(self.z, -14.0, 46.0)
        bag = 0.5 - 0.5 * np.clip(self.lip_side, -1.0, 1.0) * self.open_width**0.5
        skin = self.head.parts == HeadPart.SKIN
        self.jaw = np.where(skin, np.where(ring < -0.5, bag, flesh), 0.0)
        """Weight of each point in the jaw's motion [0-1]."""
        self.jaw[np.isin(self.head.parts, (HeadPart.LOWER_TEETH, HeadPart.TONGUE))] = 1.0

    def _lid_angles(self) -> None:
        head, center = self.head, np.array(self.style.eye.center)
        self.angle = np.arctan2(self.y - center[1], self.z - center[2])
        self.reach = np.hypot(self.y - center[1], self.z - center[2])
        edges = [lid_edge(head.points, head.marks, upper=up) for up in (True, False)]
        upper, lower = (
            np.interp(self.x[head.anchors], head.points[edge, 0], self.angle[edge])
            for edge in edges
        )
        opening = np.maximum(upper - lower, 0.0)
        follow = np.interp(
            self.eye_ring,
            [-3.0, -2.0, 0.0, 1.0, 2.0, 3.0, 4.0],
            [0.3, 0.8, 1, 0.82, 0.34, 0.08, 0.0],
        )
        follow[head.parts == HeadPart.LASHES] = 1.0
        side = np.where(head.parts == HeadPart.LASHES, 1.0, self.eye_side)
        self.close_upper = -follow * np.clip(8.0 * side, 0.0, 1.0) * (1.0 - BLINK_MEETS) * opening
        self.raise_lower = follow * np.clip(-8.0 * side, 0.0, 1.0) * BLINK_MEETS * opening

    def push(
        self, cx: float, cy: float, rx: float, ry: float, by: Push, mask: FloatArray | float = 1.0
    ) -> FloatArray:
        """Displace by `by`, with a Gaussian falloff of radii rx, ry around (cx, cy)."""
        fall = np.exp(-(((self.x - cx) / rx) ** 2) - ((self.y - cy) / ry) ** 2)
        return np.outer(self.soft * fall * mask, by)

    def fold(
        self, start: tuple[float, float], stop: tuple[float, float], width: float, depth: float
    ) -> FloatArray:
        """Press a crease along a line, with a bulge on its outer side."""
        axis = np.subtract(stop, start)
        offset = np.column_stack([self.x, self.y]) - start
        along = np.clip(offset @ axis / (axis @ axis), 0.0, 1.0)
        near = offset - np.outer(along, axis)
        outer = (near[:, 0] * -axis[1] + near[:, 1] * axis[0]) / np.linalg.norm(axis)
        ends = np.sin(np.pi * np.clip(0.12 + 0.76 * along, 0.0, 1.0))
        distance = np.linalg.norm(near, axis=1)
        dent = -np.exp(-((distance / width) ** 2))
        roll = np.exp(-((distance / (2.6 * width)) ** 2)) * smoothstep(outer, 0.0, width)
        amount = depth * ends * (dent + 0.8 * roll) * self.soft * (self.lips < 0.5)
        return np.outer(amount, (0.25, 0.0, 1.0))

    def lids(self, upper: float, lower: float) -> FloatArray:
        """Rotate the lids around the eyeball: 1 and 1 close the eye, negative values open it."""
        turn = upper * self.close_upper + lower * self.raise_lower
        angle = self.angle + turn
        center = self.style.eye.center
        moved = np.zeros_like(self.head.points)
        moved[:, 1] = center[1] + self.reach * np.sin(angle) - self.y
        moved[:, 2] = center[2] + self.reach * np.cos(angle) - self.z
        moved[np.abs(turn) < 1e-9] = 0.0
        return moved

    def gaze(self, outwards: float, upwards: float) -> FloatArray:
        """Rotate the eyeball [degrees]."""
        turn = Rotation.from_euler("YX", [outwards, -upwards], degrees=True).as_matrix()
        local = np.column_stack([self.x, self.y, self.z]) - self.style.eye.center
        moved: FloatArray = local @ turn.T - local
        moved[self.head.parts != HeadPart.EYES] = 0.0
        return moved

    def hinge(self, degrees: float) -> FloatArray:
        """Rotate the jaw around the axis through its joints [degrees]."""
        turn = np.radians(degrees)
        y, z = self.y + 20.0, self.z + 2.0
        moved = np.zeros_like(self.head.points)
        moved[:, 1] = np.cos(turn) * y - np.sin(turn) * z - y
        moved[:, 2] = np.sin(turn) * y + np.cos(turn) * z - z
        return self.jaw[:, None] * moved

    def lip_gap(self, opened: FloatArray) -> FloatArray:
        """Return the gap between the lips in a pose at each point's x: lower minus upper [mm]."""
        head = self.head
        rims = [lip_rim(head.points, head.marks, upper=up) for up in (True, False)]
        signed = head.points[:, 0]
        pulled = []
        for rim in rims:
            x, values = head.points[rim, 0], opened[rim]
            pulled.append(np.column_stack([np.interp(signed, x, v) for v in values.T]))
        end = max(float(head.points[rim, 0].max()) for rim in rims)
        gap: FloatArray = pulled[1] - pulled[0]
        return gap * smoothstep(self.x / end, 1.3, 1.0)[:, None]


def lid_closing(name: str) -> float:
    """Return the share of the eye's opening that a shape (name without side) closes at weight 1."""
    upper, lower = LID_TURNS[name]
    return (1.0 - BLINK_MEETS) * upper + BLINK_MEETS * lower
