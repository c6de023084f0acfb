"""Reading and writing of trained retargetings, as attributes of a typed prim."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from pxr import Sdf, Usd

from usdface.core.controls import JOINT_WIDTH, Retargeting, RetargetScore
from usdface.core.provenance import Provenance
from usdface.usdio.authoring import (
    author_arrays,
    author_uniform,
    define_in_scope,
    file_of,
    names_in,
    prim_in_scope,
    read_arrays,
    read_training,
    shaped,
    text_of,
    trained_prim,
)
from usdface.usdio.layers import new_layer, open_stage, refusing_wrong_types, relative_path
from usdface.usdio.units import author_units

TYPE = "FaceRetargeting"


def write_retargeting(path: Path, trained: Retargeting, *, provenance: Provenance) -> None:
    """Write a retargeting, without loss."""
    kinds = Sdf.ValueTypeNames
    rig = "" if trained.target_rig is None else relative_path(trained.target_rig, path)
    with new_layer(path, provenance) as layer:
        prim = define_in_scope(layer, "Retargeting", TYPE)
        author_units(layer)
        for name, kind, value in (
            ("method", kinds.Token, trained.method),
            ("source", kinds.TokenArray, list(trained.source_shapes)),
            ("channels", kinds.TokenArray, list(trained.shapes)),
            ("joints", kinds.TokenArray, list(trained.joints)),
            ("attributes", kinds.StringArray, list(trained.attributes)),
            ("settings", kinds.String, json.dumps(trained.settings)),
            ("scores", kinds.String, json.dumps([asdict(each) for each in trained.scores])),
            ("pairs", kinds.String, trained.pairs),
            ("rig", kinds.Asset, Sdf.AssetPath(rig)),
            ("rigPrim", kinds.String, trained.target_prim),
        ):
            author_uniform(prim, f"face:retargeting:{name}", kind, value)
        fixed = {
            "mean_rotations": trained.mean_rotations,
            "scale_signs": trained.scale_signs,
            "rest": trained.rest,
            "ranges": trained.ranges,
        }
        author_arrays(prim, fixed | {f"fit_{k}": v for k, v in trained.arrays.items()})


def is_retargeting(path: Path) -> bool:
    """Whether a USD file is a trained retargeting."""
    stage = open_stage(path)  # keep a reference: prims do not outlive their stage
    return prim_in_scope(stage, TYPE) is not None


@refusing_wrong_types
def read_retargeting(path: Path) -> Retargeting:
    """Read a retargeting."""
    stage = open_stage(path)
    prim = trained_prim(path, stage, TYPE)
    settings, scores = read_training(path, prim, "retargeting", RetargetScore)
    source, shapes, joints, attributes = (
        _names(prim, name) for name in ("source", "channels", "joints", "attributes")
    )
    width = len(shapes) + JOINT_WIDTH * len(joints) + len(attributes)
    arrays = read_arrays(path, prim)
    arrays.setdefault("scale_signs", np.ones((len(joints), 3)))  # not in earlier versions
    for name, shape in (
        ("mean_rotations", (len(joints), 4)),
        ("scale_signs", (len(joints), 3)),
        ("rest", (width,)),
        ("ranges", (width, 2)),
        ("fit_source_rest", (len(source),)),
        ("fit_unused", (len(source),)),
        ("fit_unfollowed", (len(source),)),
        ("fit_target_units", (width,)),
        ("fit_pair_span", (-1, len(source))),
    ):
        arrays[name] = shaped(path, arrays.get(name), shape, f"face:array:{name}")
    return Retargeting(
        method=_text(prim, "method"),
        source_shapes=source,
        shapes=shapes,
        joints=joints,
        attributes=attributes,
        mean_rotations=arrays.pop("mean_rotations"),
        scale_signs=arrays.pop("scale_signs"),
        rest=arrays.pop("rest"),
        ranges=arrays.pop("ranges"),
        arrays={name.removeprefix("fit_"): array for name, array in arrays.items()},
        settings=settings,
        scores=scores,
        pairs=_text(prim, "pairs"),
        target_rig=file_of(prim, "face:retargeting:rig"),
        target_prim=_text(prim, "rigPrim"),
    )


def _names(prim: Usd.Prim, name: str) -> tuple[str, ...]:
    return names_in(prim.GetAttribute(f"face:retargeting:{name}"))


def _text(prim: Usd.Prim, name: str) -> str:
    return text_of(prim, f"face:retargeting:{name}")
