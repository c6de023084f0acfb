"""Animated meshes: points over time as overs on the mesh's asset, in one layer or in value clips.

NAME.usda is the layer to open: it references the mesh's asset and sublayers NAME.points.usdc, which
has only overs. The samples of a long take are in value clips, of which only one needs to be in
memory.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from pxr import Sdf, Vt

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing_group
from usdface.core.sidecars import points_path
from usdface.usdio.authoring import (
    apply_api,
    author_timing,
    author_uniform,
    prim_paths_in,
    top_path,
)
from usdface.usdio.layers import new_layer, open_layer, sublayer_asset
from usdface.usdio.performance.clips import author_clips, clip_files
from usdface.usdio.rig.mesh import FaceMesh
from usdface.usdio.rig.reference import define_reference, remove_reference
from usdface.usdio.units import author_units

UNCERTAINTY = "primvars:face:uncertainty"
UNSAVED_BYTES = 128 << 20
"""Size of samples after which they are saved to disk."""


@dataclass(frozen=True)
class PointsHeader:
    """Timing, prim path and method of an animated mesh."""

    rate: Fraction
    """Frames per second."""
    first_frame: int
    last_frame: int
    """`first_frame`, `last_frame`: Inclusive."""
    rig_path: str | None = None
    """Prim path of the mesh's asset in the new layer; by default that in its file."""
    method: str = ""
    """Method by which the points were computed; written on the mesh."""
    timecode_start: str = ""
    """Of the first frame; empty if unknown."""


@dataclass(frozen=True)
class PointsFormat:
    """Attributes written for each frame."""

    normals: bool = False
    """Normals over time, if the mesh has authored ones that a renderer would use."""
    uncertainty: bool = False
    """The primvar ``face:uncertainty`` [mm]."""
    clip_bytes: int = 512 << 20
    """Larger takes are written as value clips of about this size."""


class PointsWriter:
    """Appends frames of an animated mesh; made by `writing_points`."""

    def __init__(
        self,
        face: FaceMesh,
        place: Sdf.Path,
        format_: PointsFormat,
        first_frame: int,
        layer: Sdf.Layer | None = None,
    ) -> None:
        self._face, self._place, self._format = face, place, format_
        self._layer = layer
        self._unsaved = 0
        self.next_frame = first_frame

    def append(
        self,
        points: FloatArray,
        *,
        normals: FloatArray | None = None,
        uncertainty_mm: FloatArray | Float32Array | None = None,
    ) -> None:
        """Append frames.

        Parameters
        ----------
        points : (frames, points, 3) float array
            In the mesh's space and unit.
        normals : (frames, n, 3) float array, optional
        uncertainty_mm : (frames, points) float array, optional
            Predictive standard deviation.
        """
        for index in range(len(points)):
            rows: list[tuple[str, FloatArray | Float32Array]] = [
                ("points", points[index]),
                ("extent", np.stack([points[index].min(axis=0), points[index].max(axis=0)])),
            ]
            if self._format.normals and normals is not None:
                rows.append((self._face.normals_attribute, normals[index]))
            if self._format.uncertainty and uncertainty_mm is not None:
                rows.append((UNCERTAINTY, uncertainty_mm[index]))
            self._put(self.next_frame, rows)
            self.next_frame += 1

    def _put(self, frame: int, rows: list[tuple[str, FloatArray | Float32Array]]) -> None:
        assert self._layer is not None
        for name, values in rows:
            value = _sample(values)
            self._layer.SetTimeSample(self._place.AppendProperty(name), frame, value)
            self._unsaved += 4 * values.size
        if self._unsaved >= UNSAVED_BYTES:
            self._layer.Save()  # frees the memory of samples in a binary layer
            self._unsaved = 0


class _ClipsWriter(PointsWriter):
    """Writes consecutive clips, each of which is complete when the next begins."""

    def __init__(
        self,
        face: FaceMesh,
        place: Sdf.Path,
        format_: PointsFormat,
        header: PointsHeader,
        *,
        clip_frames: int,
        stem: Path,
        used: set[Path],
    ) -> None:
        super().__init__(face, place, format_, header.first_frame)
        self._header, self._clip_frames = header, clip_frames
        self._stem, self._used = stem, used
        self.files: list[Path] = []
        self.starts: list[int] = []
        self._open = contextlib.ExitStack()

    def _put(self, frame: int, rows: list[tuple[str, FloatArray | Float32Array]]) -> None:
        if (frame - self._header.first_frame) % self._clip_frames == 0:
            if self.files:
                # A clip ends with the next one's first frame, to which motion is interpolated.
                super()._put(frame, rows)
                self.close()
            self._begin_clip(frame)
        super()._put(frame, rows)

    def _begin_clip(self, frame: int) -> None:
        path = self._stem.with_name(f"{self._stem.name}.{len(self.files) + 1:04d}.usdc")
        last = min(frame + self._clip_frames, self._header.last_frame)
        layer = self._open.enter_context(new_layer(path))
        part = replace(self._header, first_frame=frame, last_frame=last)
        _declare(layer, self._face, self._place, part, self._format)
        self._layer, self._unsaved = layer, 0
        self.files.append(path)
        self.starts.append(frame)

    def close(self) -> None:
        self._layer = None
        self._open.close()

    def abandon(self, error: BaseException) -> None:
        """Remove the clips written so far, unless the existing asset uses files of these names."""
        self._layer = None
        with contextlib.suppress(BaseException):
            self._open.__exit__(type(error), error, error.__traceback__)
        for file in self.files:
            if file not in self._used:
                file.unlink(missing_ok=True)


@contextlib.contextmanager
def writing_points(
    path: Path,
    face: FaceMesh,
    header: PointsHeader,
    format_: PointsFormat,
    *,
    provenance: Provenance,
) -> Iterator[PointsWriter]:
    """Write an animated mesh frame by frame; the files are replaced if the block succeeds.

    Parameters
    ----------
    path : Path
        The layer to open. Its other opinions and sublayers are preserved.
    face : FaceMesh
        The mesh at rest.
    """
    asset = Rig(face.file, face.path, (), (), np.zeros((0, 2)))
    source = top_path(face.path)
    top = header.rig_path or str(source)
    at = Sdf.Path(face.path).ReplacePrefix(source, Sdf.Path(top))
    points_file = points_path(path)
    outdated, before = clip_files(points_file), _deformed_prim(points_file)
    with replacing_group((points_file, path)):
        with _writing_samples(points_file, face, at, header, format_, provenance) as writer:
            yield writer
        with new_layer(path, provenance) as layer:
            if path.is_file():
                layer.TransferContent(open_layer(path))
            _author_header(layer, face, at, header)
            name = sublayer_asset(layer, points_file, path)
            is_open = name in list(layer.subLayerPaths)
            define_reference(layer, top, asset, path, replace_rig=is_open)
            for each in before.GetPrefixes() if before != at else ():
                if each != top:  # where the mesh was before
                    remove_reference(layer, str(each), {face.file.resolve()}, path)
            if not is_open:
                layer.subLayerPaths.append(name)
    for file in outdated - clip_files(points_file):
        file.unlink(missing_ok=True)


@contextlib.contextmanager
def _writing_samples(
    points_file: Path,
    face: FaceMesh,
    at: Sdf.Path,
    header: PointsHeader,
    format_: PointsFormat,
    provenance: Provenance,
) -> Iterator[PointsWriter]:
    """Write the points layer, and its clips if the take is larger than one."""
    frames = header.last_frame - header.first_frame + 1
    clip_frames = max(format_.clip_bytes // _frame_bytes(face, format_), 1)
    with new_layer(points_file, provenance) as layer:
        _declare(layer, face, at, header, format_)
        prim = layer.GetPrimAtPath(at)
        apply_api(prim, "FaceDeformAPI")
        author_uniform(prim, "face:deform:method", Sdf.ValueTypeNames.Token, header.method)
        if header.timecode_start:
            kind = Sdf.ValueTypeNames.String
            author_uniform(prim, "face:timecode:start", kind, header.timecode_start)
        if frames * _frame_bytes(face, format_) <= format_.clip_bytes:
            writer = PointsWriter(face, at, format_, header.first_frame, layer)
            yield writer
        else:
            # By provenance, so that clips of another are not replaced.
            stem = points_file.with_name(f"{points_file.stem}.{provenance.digest}")
            used = clip_files(points_file)
            writer = clips = _ClipsWriter(
                face, at, format_, header, clip_frames=clip_frames, stem=stem, used=used
            )
            try:
                yield writer
                clips.close()
            except BaseException as error:
                clips.abandon(error)
                raise
            manifest = stem.with_name(f"{stem.name}.manifest.usda")
            with new_layer(manifest) as declared:
                _declare(declared, face, at, header, format_)
            author_clips(
                prim,
                "default",
                clips.files,
                manifest,
                active=[(start, index) for index, start in enumerate(clips.starts)],
                ends=(header.first_frame, header.last_frame),
                path=points_file,
            )
        if writer.next_frame != header.last_frame + 1:
            raise ValueError(
                f"{points_file}: {writer.next_frame - header.first_frame} frames were appended "
                f"where {frames} were announced"
            )


def _frame_bytes(face: FaceMesh, format_: PointsFormat) -> int:
    normals = (
        0 if face.authored_normals is None or not format_.normals else len(face.authored_normals)
    )
    count = len(face.local)
    return 4 * (3 * (count + normals + 2) + (count if format_.uncertainty else 0))


def _sample(values: FloatArray | Float32Array) -> Vt.FloatArray | Vt.Vec3fArray:
    array = np.ascontiguousarray(values, dtype=np.float32)
    if not np.isfinite(array).all():
        raise InputError("points to write hold NaN or infinity; check the take and the mesh")
    return Vt.FloatArray.FromNumpy(array) if array.ndim == 1 else Vt.Vec3fArray.FromNumpy(array)


def _author_header(layer: Sdf.Layer, face: FaceMesh, at: Sdf.Path, header: PointsHeader) -> None:
    """Set timing and the mesh's units."""
    author_timing(layer, rate=header.rate, first=header.first_frame, last=header.last_frame)
    layer.defaultPrim = top_path(at).name
    author_units(layer, like=face.file)


def _declare(
    layer: Sdf.Layer, face: FaceMesh, at: Sdf.Path, header: PointsHeader, format_: PointsFormat
) -> None:
    """Write a header, and an over of the mesh with its animated attributes.

    Without default values, which would be stronger than the samples of a clip.
    """
    _author_header(layer, face, at, header)
    prim = Sdf.CreatePrimInLayer(layer, at)
    kinds = Sdf.ValueTypeNames
    Sdf.AttributeSpec(prim, "points", kinds.Point3fArray)
    Sdf.AttributeSpec(prim, "extent", kinds.Float3Array)
    if face.normals:
        normals = Sdf.AttributeSpec(prim, face.normals_attribute, kinds.Normal3fArray)
        if format_.normals:
            normals.SetInfo("interpolation", face.normals)
        else:  # block those of the face at rest
            normals.default = Sdf.ValueBlock()
        if face.normals_attribute.startswith("primvars:"):
            indices = Sdf.AttributeSpec(prim, "primvars:normals:indices", kinds.IntArray)
            indices.default = Sdf.ValueBlock()
    if format_.uncertainty:
        uncertainty = Sdf.AttributeSpec(prim, UNCERTAINTY, kinds.FloatArray)
        uncertainty.SetInfo("interpolation", "vertex")


def _deformed_prim(points_file: Path) -> Sdf.Path:
    """Return the mesh of an existing points layer, or an empty path."""
    if not points_file.is_file():
        return Sdf.Path()
    layer = open_layer(points_file)
    prims = map(layer.GetPrimAtPath, prim_paths_in(layer))
    return next((prim.path for prim in prims if prim.HasInfo("apiSchemas")), Sdf.Path())
