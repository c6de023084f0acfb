"""Shading: key, fill and two rim lights fixed to the camera, and approximate subsurface light.

All colours are linear. Directions are in the camera's axes (right, up, towards the eye), so that
all views of a sheet are lit alike.
"""

from dataclasses import dataclass

import numpy as np

from usdface.core.arrays import Float32Array, IntArray, row_lengths
from usdface.media.face.parts import FacePart

SKIN = np.array([0.50, 0.31, 0.235], np.float32)
LIPS = np.array([0.40, 0.165, 0.14], np.float32)
BROWS = np.array([0.13, 0.075, 0.055], np.float32)
INNER_MOUTH = np.array([0.16, 0.045, 0.04], np.float32)
TONGUE = np.array([0.34, 0.12, 0.105], np.float32)
TEETH = np.array([0.62, 0.58, 0.50], np.float32)
HAIR = np.array([0.035, 0.025, 0.02], np.float32)
SCLERA = np.array([0.66, 0.64, 0.62], np.float32)
IRIS = np.array([0.11, 0.15, 0.17], np.float32)
PUPIL = np.array([0.006, 0.006, 0.006], np.float32)

KEY_SPREAD = 0.09
"""Radius of the key light over its distance, which softens its shadow."""


@dataclass(frozen=True)
class Light:
    """A distant light; only the key casts a shadow."""

    direction: tuple[float, float, float]
    color: tuple[float, float, float]


LIGHTS = (
    Light((-0.42, 0.46, 0.78), (1.20, 1.13, 1.05)),
    Light((0.85, 0.05, 0.45), (0.20, 0.235, 0.28)),
    Light((0.72, 0.45, -0.62), (0.55, 0.60, 0.68)),
    Light((-0.85, 0.25, -0.55), (0.30, 0.33, 0.37)),
)
KEY_DIRECTION = np.array(LIGHTS[0].direction, np.float32)
_SKY = np.array([0.30, 0.315, 0.345], np.float32)
_GROUND = np.array([0.15, 0.13, 0.12], np.float32)
# Extent of light beyond the terminator, by channel: red scatters furthest in skin.
_SKIN_WRAP = np.array([0.34, 0.17, 0.10], np.float32)
# Exponent of ambient visibility by channel, for reddish interreflection in shallow occlusion.
_SKIN_BOUNCE = np.array([0.80, 1.08, 1.18], np.float32)


@dataclass(frozen=True)
class Hits:
    """Surface samples to shade."""

    normals: Float32Array
    """(n, 3): unit, towards the camera, in its axes."""
    views: Float32Array
    """(n, 3): unit, from the surface to the camera, in its axes."""
    albedo: Float32Array
    """(n, 3)"""
    parts: IntArray
    """(n,)"""
    openness: Float32Array
    """(n,): visible share of the sky [0-1]."""
    lit: Float32Array
    """(n,): visible share of the key light [0-1]."""


# Specular strength and Blinn exponent of each part, in the order of `FacePart`.
_GLOSS = np.array([0.045, 0.9, 0.25, 0.10, 0.05, 0.0], np.float32)
_SHINE = np.array([26.0, 420.0, 70.0, 40.0, 20.0, 1.0], np.float32)


def shade(hits: Hits, *, plain: bool = False) -> Float32Array:
    """Return the light from each hit towards the camera: (n, 3), linear, tone-mapped to [0-1].

    `plain`: without highlights and coloured light, so that a heat map keeps its colours.
    """
    if plain:
        key = KEY_DIRECTION / np.linalg.norm(KEY_DIRECTION)
        facing = np.clip((hits.normals @ key + 0.3) / 1.3, 0, 1)
        light = 0.50 * hits.openness + 0.55 * facing * (0.4 + 0.6 * hits.lit)
        return np.asarray(hits.albedo * light[:, None], np.float32)
    # Planes of channels, (3, n): twice as fast as rows of three.
    normals, albedo = hits.normals, np.ascontiguousarray(hits.albedo.T)
    skin = hits.parts == FacePart.SKIN
    bounced = np.where(skin, hits.openness ** _SKIN_BOUNCE[:, None], hits.openness)
    total = albedo * bounced * _ambient(normals)
    wrap = np.where(skin, _SKIN_WRAP[:, None], np.float32(0.05))
    for number, light in enumerate(LIGHTS):
        direction = np.asarray(light.direction, np.float32)
        direction = direction / np.linalg.norm(direction)
        color = np.asarray(light.color, np.float32)[:, None]
        facing = normals @ direction
        reach = hits.lit if number == 0 else hits.openness
        diffuse = np.maximum((facing + wrap) / (1 + wrap), 0)
        total += albedo * diffuse * color * reach
        if number == 0:  # a single highlight
            gloss, shine = _GLOSS[hits.parts], _SHINE[hits.parts]
            half = hits.views + direction
            half /= row_lengths(half)
            lobe = np.clip(np.einsum("ij,ij->i", normals, half), 0, 1) ** shine
            strength = gloss * (shine + 2) / 28 * lobe * np.clip(facing * 4, 0, 1) * reach
            total += strength * color
    return np.ascontiguousarray(_tone(total).T)


def _ambient(normals: Float32Array) -> Float32Array:
    up = 0.5 + 0.5 * normals[:, 1]
    return np.asarray(_GROUND[:, None] * (1 - up) + _SKY[:, None] * up, np.float32)


def _tone(light: Float32Array) -> Float32Array:
    """Compress light above 0.6 into the range below 1; below 0.6 it is unchanged."""
    knee = np.float32(0.6)
    over = np.maximum(light - knee, 0)
    room = 1 - knee
    return np.asarray(np.minimum(light, knee) + room * over / (over + room), np.float32)
