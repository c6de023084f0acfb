"""Reading of references assets."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdSkel

from usdface.core.arrays import FloatArray, IntArray
from usdface.core.assets import MotionSpace, References, Rig
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few, json_object
from usdface.core.trajectories import TRAJECTORY_SECONDS
from usdface.usdio.authoring import file_of, names_in, read_array_samples, text_of, value_of
from usdface.usdio.layers import read_provenance, refusing_wrong_types
from usdface.usdio.references.pair_layers import open_pair_stage
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.reference import combinations_of, rig_of
from usdface.usdio.units import MM_PER_STAGE_UNIT

ROOT = Sdf.Path("/References")
MARKERS_PATH = ROOT.AppendChild("Markers")
RIG = ROOT.AppendChild("Rig")
WEIGHTS_PATH = ROOT.AppendChild("Weights")
SOURCE_PATH = ROOT.AppendChild("Source")
WEIGHTS_ATTRIBUTE = WEIGHTS_PATH.AppendProperty("blendShapeWeights")
FRAME_PATH = ROOT.AppendProperty("face:reference:frame")
TAKE = ROOT.AppendProperty("face:reference:take")
TUNED = ROOT.AppendProperty("face:reference:tuned")
DONE = ROOT.AppendProperty("face:reference:done")
VISEME = ROOT.AppendProperty("face:reference:viseme")
EMOTION = ROOT.AppendProperty("face:reference:emotion")
AUTHOR = ROOT.AppendProperty("face:reference:author")
PLACEMENT = "face:reference:placement"
RATE = "face:reference:rate"
TRAJECTORY = ROOT.AppendProperty("face:reference:trajectory")
TRAJECTORY_TIMES = "face:reference:trajectoryTimes"


def _open(path: Path) -> Usd.Stage:
    return open_pair_stage(
        path, ROOT, api="FaceReferencesAPI", kind="references", command="usdface select"
    )


@refusing_wrong_types
def read_references(path: Path) -> References:
    """Read a references asset, with tuned weights where there are any, else proposals."""
    stage = _open(path)
    root = stage.GetPrimAtPath(ROOT)
    points = UsdGeom.Points(stage.GetPrimAtPath(MARKERS_PATH))
    animation = UsdSkel.Animation(stage.GetPrimAtPath(WEIGHTS_PATH))
    if not points or not animation:
        raise InputError(f"{path}: </References/Markers> or </References/Weights> is missing")
    pairs = range(1, round(stage.GetEndTimeCode()) + 1)
    marker_names = tuple(map(str, points.GetPrim().GetAttribute("face:markers:names").Get()))
    shape_names = tuple(map(str, animation.GetBlendShapesAttr().Get()))
    weights = _stack(path, animation.GetBlendShapeWeightsAttr(), pairs, shape_names)
    markers = _stack(path, points.GetPointsAttr(), pairs, marker_names, (3,))
    samples = points.GetPointsAttr().GetNumTimeSamples()
    if samples != len(pairs):
        raise InputError(
            f"{path}: its end time code says {len(pairs)} pairs, and its samples hold {samples}: "
            "they are of another selection; select again, which keeps what is tuned"
        )
    frames, takes, tuned = (root.GetAttribute(path.name) for path in (FRAME_PATH, TAKE, TUNED))
    neutral = np.array(value_of(points.GetPrim(), "face:markers:neutral"), np.float64)
    rig_file, rig_prim = rig_of(stage, animation.GetPrim())
    combinations = combinations_of(stage, animation.GetPrim(), path)
    driven = {each.shape for each in combinations}
    columns = [index for index, name in enumerate(shape_names) if name not in driven]
    source = UsdSkel.Animation(stage.GetPrimAtPath(SOURCE_PATH))
    source_names = tuple(map(str, source.GetBlendShapesAttr().Get())) if source else ()
    take_of = tuple(str(takes.Get(pair)) for pair in pairs)
    frame_of = np.array([frames.Get(pair) for pair in pairs], dtype=np.int64)
    _check_layers(stage, take_of, frame_of)
    references = References(
        marker_names=marker_names,
        shape_names=tuple(shape_names[index] for index in columns),
        markers=markers * MM_PER_STAGE_UNIT,
        weights=weights[:, columns],
        frames=frame_of,
        takes=take_of,
        tuned=np.array([bool(tuned.Get(pair)) for pair in pairs]),
        rigid=names_in(points.GetPrim().GetAttribute("face:markers:rigid")),
        neutral=neutral.reshape(-1, 3) * MM_PER_STAGE_UNIT,
        rig_file=rig_file,
        rig_prim=rig_prim,
        combinations=combinations,
        motion=_read_motion(root),
        visemes=_labels(root, VISEME, pairs),
        emotions=_labels(root, EMOTION, pairs),
        authors=_labels(root, AUTHOR, pairs),
        performer=text_of(root, "face:performer"),
        session=text_of(root, "face:session"),
        neutral_take=text_of(root, "face:neutralTake"),
        rate=_read_rate(root, path),
        placement=_read_placement_path(root),
        trajectories=_read_trajectories(root, path, pairs, marker_names),
        source_names=source_names,
        source=_stack(path, source.GetBlendShapeWeightsAttr(), pairs, source_names)
        if source
        else None,
    )
    _check_contents(path, references)
    return references


def _check_contents(path: Path, references: References) -> None:
    """Refuse references without shapes, of other markers, or whose motion is not finite."""
    names, faults = references.marker_names, list[str]()
    if not references.shape_names:
        faults.append("they have no shapes")
    if unknown := [name for name in references.rigid if name not in names]:
        faults.append(f"their rigid markers {first_few(unknown)} are none of their markers")
    if len(references.neutral) != len(names):
        faults.append(f"their neutral has {len(references.neutral)} of {len(names)} markers")
    motion = references.motion
    if motion is not None and not all(np.isfinite(each).all() for each in vars(motion).values()):
        faults.append("their motion space holds values that are not finite")
    if faults:
        raise InputError(f"{path}: {'; '.join(faults)}: restore the layers, or select again")


def read_rig_of(references: References, path: Path) -> Rig:
    """Read the rig of references, and check that it has their shapes; `path` is for messages."""
    rig = read_rig(references.rig_file, prim=references.rig_prim)
    remedy = "it was selected for another rig: select again"
    rig.check_has(references.shape_names, source=path, remedy=remedy)
    return rig


def _read_rate(root: Usd.Prim, path: Path) -> float:
    """Return the takes' rate, or 0 if it is unknown."""
    rate = float(value_of(root, RATE) or 0.0)
    if rate:
        exact_rate(rate, where=f"{path} {RATE}")
    return rate


def _read_placement_path(root: Usd.Prim) -> Path | None:
    """Return the asset's placement, if the file exists."""
    file = file_of(root, PLACEMENT)
    return file if file is not None and file.is_file() else None


def _labels(root: Usd.Prim, path: Sdf.Path, pairs: range) -> tuple[str, ...]:
    attribute = root.GetAttribute(path.name)
    return tuple(str(attribute.Get(pair) or "") for pair in pairs) if attribute else ()


def _check_layers(stage: Usd.Stage, takes: tuple[str, ...], frames: IntArray) -> None:
    """Refuse layers with weights of other frames than those of the asset."""
    for layer in stage.GetLayerStack(includeSessionLayers=False)[1:]:
        times = layer.ListTimeSamplesForPath(TUNED)
        done = "tuned" if times else "proposed"
        for time in times or layer.ListTimeSamplesForPath(FRAME_PATH):
            if times and not layer.QueryTimeSample(TUNED, time):
                continue
            pair = round(time) - 1
            take, frame = (layer.QueryTimeSample(path, time) for path in (TAKE, FRAME_PATH))
            here = (takes[pair], int(frames[pair])) if 0 <= pair < len(takes) else None
            if here != (str(take), frame):
                is_now = "no pair" if here is None else f"frame {here[1]} of {here[0]}"
                raise InputError(
                    f"{layer.realPath} time code {time:g}: was {done} for frame {frame} of {take}, "
                    f"and the asset has {is_now} there: it is of an older selection. Select again "
                    "with --out of this asset, which keeps what is tuned, or put the asset's own "
                    f"{done} layer back"
                )


def _stack(
    path: Path,
    attribute: Usd.Attribute,
    pairs: range,
    names: tuple[str, ...],
    size: tuple[int, ...] = (),
) -> FloatArray:
    samples = attribute.GetNumTimeSamples()
    if len(pairs) > samples:  # the end time code may be damaged
        raise InputError(
            f"{path}: its end time code says {len(pairs)} pairs, and <{attribute.GetPath()}> holds "
            f"{samples}; restore the layer or select again"
        )
    remedy = "restore the layer or select again"
    return read_array_samples(path, attribute, pairs, names, size, remedy=remedy)


def _read_trajectories(
    root: Usd.Prim, path: Path, pairs: range, marker_names: tuple[str, ...]
) -> FloatArray | None:
    """Return the motion about each pair [mm]; None of earlier versions, or at other times."""
    times = np.array(value_of(root, TRAJECTORY_TIMES) or (), np.float64)
    if len(times) != len(TRAJECTORY_SECONDS) or not np.allclose(times, TRAJECTORY_SECONDS):
        return None
    names = tuple(f"{time:g} s {marker}" for time in times for marker in marker_names)
    found = _stack(path, root.GetAttribute(TRAJECTORY.name), pairs, names, (3,))
    return found.reshape(len(pairs), len(times), len(marker_names), 3) * MM_PER_STAGE_UNIT


def _read_motion(root: Usd.Prim) -> MotionSpace | None:
    def get(name: str) -> FloatArray:
        return np.array(root.GetAttribute(name).Get() or [], dtype=np.float64)

    mean, variances = get("face:motion:mean"), get("face:motion:variances")
    sample = get("face:motion:sample")
    if not (len(mean) and len(variances) and len(sample)):
        return None
    return MotionSpace(
        mean=mean * MM_PER_STAGE_UNIT,
        components=get("face:motion:components").reshape(len(variances), len(mean)),
        variances=variances * MM_PER_STAGE_UNIT**2,
        total_variance=float(root.GetAttribute("face:motion:totalVariance").Get())
        * MM_PER_STAGE_UNIT**2,
        sample=sample.reshape(-1, len(variances)) * MM_PER_STAGE_UNIT,
        sample_starts=tuple(get("face:motion:sampleStarts").astype(int).tolist()) or (0,),
    )


@dataclass(frozen=True)
class PairNotes:
    """Labels of a pair; empty if unknown."""

    frame: int = 0
    take: str = ""
    """`frame`, `take`: Frame number, and the name of its take."""
    viseme: str = ""
    emotion: str = ""
    image: Path | None = None
    """The pair's picture."""


@refusing_wrong_types
def read_pair_notes(path: Path) -> list[PairNotes]:
    """Return the labels of the pairs of a references asset."""
    stage = _open(path)
    root = stage.GetPrimAtPath(ROOT)
    frames = root.GetAttribute(FRAME_PATH.name)
    notes = []
    for time in frames.GetTimeSamples():
        image = root.GetAttribute("face:reference:image")
        resolved = str(getattr(image.Get(time) if image else None, "resolvedPath", "") or "")
        notes.append(
            PairNotes(
                frame=int(frames.Get(time)),
                take=text_of(root, TAKE.name, time),
                viseme=text_of(root, VISEME.name, time),
                emotion=text_of(root, EMOTION.name, time),
                image=Path(resolved) if resolved else None,
            )
        )
    return notes


def take_files(path: Path) -> tuple[Path, ...]:
    """Return the takes of a references asset, from its provenance and that of its performances."""
    made = read_provenance(path)
    spec = {} if made is None else json_object(made.spec)
    takes, added = (
        each if isinstance(each, list) else []
        for each in (spec.get("takes"), spec.get("performances"))
    )
    files = [path.parent / str(take) for take in takes]
    added = [*added, *([spec["performance"]] if "performance" in spec else [])]
    for performance in (path.parent / str(each) for each in added):
        made = read_provenance(performance) if performance.is_file() else None
        of = {} if made is None else json_object(made.spec)
        files += [performance.parent / str(of[name]) for name in ("take", "source") if name in of]
    return tuple(files)
