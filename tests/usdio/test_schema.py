"""The codeless schema: generated from its source, known to USD on both ways in."""

import os
import subprocess
import sys

from pxr import Usd, UsdGeom, UsdSkel

from tests.regenerate import USD_SCHEMA, usd_schema
from usdface.core.plugin_path import schema_folder

APPLIED = {
    "FaceTakeAPI": UsdGeom.Xform,
    "FaceMarkersAPI": UsdGeom.Points,
    "FaceReferencesAPI": UsdGeom.Xform,
    "FaceSolveAPI": UsdSkel.Animation,
}


def test_committed_schema_is_what_usd_generates() -> None:
    for name, text in usd_schema().items():
        assert (USD_SCHEMA / name).read_text(encoding="utf-8") == text, "run `poe schemas`"


def test_apis_apply_to_their_prims_and_to_no_others() -> None:
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh").GetPrim()
    for api, kind in APPLIED.items():
        prim = kind.Define(stage, f"/{api}").GetPrim()
        assert prim.CanApplyAPI(api)
        assert prim.ApplyAPI(api)
        assert api == "FaceReferencesAPI" or not mesh.CanApplyAPI(api)
    assert stage.DefinePrim("/m", "FaceMapping").GetPrimTypeInfo().GetSchemaTypeName()


def test_another_tool_finds_the_schema_through_the_environment() -> None:
    script = (
        "from pxr import Usd; "
        "print(Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('FaceTakeAPI') is not None)"
    )
    environment = os.environ | {"PXR_PLUGINPATH_NAME": str(schema_folder())}
    found = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "True"


def test_coming_after_usd_says_what_to_do() -> None:
    script = (
        "from pxr import Usd; Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('CollectionAPI'); "
        "import usdface.usdio"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PXR_PLUGINPATH_NAME"}
    found = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False
    )
    assert found.returncode
    assert "PXR_PLUGINPATH_NAME=" in found.stderr
