"""A stage's camera in the space of a rig.

A shot may move and scale its characters, and have other units. Pictures of a face are drawn in the
rig's space, so the camera is transformed by the inverse of the character's transform.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.text import first_few
from usdface.usdio.authoring import prims_below
from usdface.usdio.layers import open_stage, refusing_wrong_types
from usdface.usdio.rig.rig_motion import RigMotion
from usdface.usdio.units import column_matrix, millimetres_per_unit, rest_transforms, stage_to_ours

_UNITS_PER_TENTH = 0.1  # apertures and focal lengths count tenths of a scene unit


@dataclass(frozen=True)
class StageView:
    """View of a stage's camera at one frame."""

    eye: FloatArray
    """(3,): in the rig's space [mm], Y up."""
    forward: FloatArray
    up: FloatArray
    """`forward`, `up`: (3,): unit."""
    fov_degrees: float
    """Vertical field of view [degrees]."""
    shift: tuple[float, float]
    """Lens shift, right and up [half heights]."""
    span_mm: float | None
    """Height of the view of an orthographic camera [mm]."""
    aspect: float
    """Width over height of the film."""


class StageCamera:
    """A camera of a stage, in the space of a rig.

    Parameters
    ----------
    rig : Rig
        The character.
    rate : Fraction
        Frames per second of the frame numbers; converted to the stage's rate.
    motion : RigMotion, optional
        Of the drawn points; a stage with its performance moves the character by it as well.
    """

    @refusing_wrong_types
    def __init__(
        self, path: Path, prim: str, rig: Rig, *, rate: Fraction, motion: RigMotion | None = None
    ) -> None:
        self.path = path
        self._stage = open_stage(path)
        self._camera = UsdGeom.Camera(_camera(self._stage, path, prim))
        self._time_codes = self._stage.GetTimeCodesPerSecond() / float(rate)
        rig_stage = open_stage(rig.file)
        home = rig_stage.GetPrimAtPath(rig.prim)
        self._root = _character(self._stage, path, home)
        self.holds_character = self._root is not None
        """If not, the character is assumed at the stage's origin."""
        # USD does not convert the units of a referenced character.
        unit = rig_stage if self.holds_character else self._stage
        self._ours = stage_to_ours(unit)
        self._millimetres_per_unit = millimetres_per_unit(unit)
        used = {Path(each.realPath).resolve() for each in self._stage.GetUsedLayers()}
        levels = motion.levels_up if motion is not None and motion.path.resolve() in used else 0
        self._root = self._root and _up_from(self._root)[: levels + 1][-1]
        self._home = rest_transforms(home).GetLocalToWorldTransform(_up_from(home)[levels])

    @refusing_wrong_types
    def at(self, frame: int) -> StageView:
        """Return the view at a frame."""
        time = Usd.TimeCode(frame * self._time_codes)
        camera = self._camera.GetCamera(time)
        placed = self._into_rig(camera.transform, time)
        up, back = placed[:3, 1], placed[:3, 2]
        scale = float(np.linalg.norm(up))
        where = f"{self.path} <{self._camera.GetPath()}> frame {frame}"
        if not np.isfinite(placed).all() or abs(np.linalg.det(placed[:3, :3])) < 1e-18:
            raise InputError(f"{where}: its transform has no inverse; repair the camera's place")
        wide, high, focal = camera.horizontalAperture, camera.verticalAperture, camera.focalLength
        flat = camera.projection == Gf.Camera.Orthographic
        if not (wide > 0 and high > 0 and (flat or focal > 0)):
            raise InputError(
                f"{where}: an aperture of {wide:g} × {high:g} and a focal length of {focal:g} see "
                "nothing; repair the camera, or use --camera auto"
            )
        return StageView(
            eye=self._ours @ placed[:3, 3],
            forward=_unit(self._ours @ -back),
            up=_unit(self._ours @ up),
            fov_degrees=45.0 if flat else float(np.degrees(2 * np.arctan(high / 2 / focal))),
            shift=(
                2 * camera.horizontalApertureOffset / high,
                2 * camera.verticalApertureOffset / high,
            ),
            span_mm=_UNITS_PER_TENTH * high * scale * self._millimetres_per_unit if flat else None,
            aspect=float(wide / high),
        )

    def _into_rig(self, transform: Gf.Matrix4d, time: Usd.TimeCode) -> FloatArray:
        """Return the camera's transform in the rig's stage, for column vectors."""
        if self._root is None:
            return column_matrix(transform)
        world = UsdGeom.XformCache(time).GetLocalToWorldTransform(self._root)
        if abs(world.GetDeterminant()) < 1e-18:
            raise InputError(
                f"{self.path} <{self._root.GetPath()}> time code {time.GetValue():g}: its "
                "transform has no inverse; repair the character's place, or use --camera auto"
            )
        return column_matrix(transform * world.GetInverse() * self._home)


def _camera(stage: Usd.Stage, path: Path, name: str) -> Usd.Prim:
    prim = stage.GetPrimAtPath(name)
    if prim and prim.IsA(UsdGeom.Camera):
        return prim
    cameras = prims_below(stage.GetPseudoRoot(), UsdGeom.Camera)
    found = [f"<{each.GetPath()}>" for each in cameras]
    kind = prim.GetTypeName() or "prim without a type" if prim else ""
    what = f"<{name}> is a {kind}, no camera" if prim else f"there is no prim <{name}>"
    remedy = (
        f"its cameras are {first_few(found)}"
        if found
        else "it has no camera: name the shot with --camera-stage, or use --camera auto"
    )
    raise InputError(f"{path}: {what}; {remedy}")


def _character(stage: Usd.Stage, path: Path, home: Usd.Prim) -> Usd.Prim | None:
    """Return the SkelRoot composed of specs of the rig's; None without one.

    Of characters of one base, that with the most specs of the rig's, with those of prims above.
    """
    specs, every = _specs((home,)), _specs(_up_from(home))
    roots = prims_below(stage.GetPseudoRoot(), UsdSkel.Root)
    shared = {
        each: len(every & _specs(_up_from(each))) for each in roots if specs & _specs((each,))
    }
    found = [each for each, count in shared.items() if count == max(shared.values())]
    if len(found) > 1:
        paths = first_few(f"<{prim.GetPath()}>" for prim in found)
        raise InputError(
            f"{path}: the character is there {len(found)} times, {paths}; give a stage with one of "
            "them as --camera-stage"
        )
    return found[0] if found else None


def _specs(prims: Iterable[Usd.Prim]) -> set[tuple[str, Sdf.Path]]:
    return {(spec.layer.realPath, spec.path) for prim in prims for spec in prim.GetPrimStack()}


def _up_from(prim: Usd.Prim) -> list[Usd.Prim]:
    """Return a prim and those above it, up to the pseudo-root."""
    above = prim.GetParent()
    return [prim, *(_up_from(above) if above else ())]


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))
