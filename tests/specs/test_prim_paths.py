"""Paths of prims, in any script that USD takes."""

import pytest
from pxr import Sdf
from pydantic import TypeAdapter, ValidationError

from usdface.specs.paths import PrimPath
from usdface.specs.review import CameraName

PATHS = {
    "/shot/cast/hero": True,
    "/_x/a1": True,
    "/Größe/顔/ünï": True,
    "/a·b": True,
    "shot": False,
    "/": False,
    "/a/": False,
    "/a//b": False,
    "/1a": False,
    "/a b": False,
    "/a.b": False,
    "/a😀": False,
    "/a—b": False,
    '/a" def "b': False,
}


@pytest.mark.parametrize(("path", "good"), PATHS.items(), ids=PATHS)
@pytest.mark.parametrize("kind", [PrimPath, CameraName])
def test_a_prim_s_path_is_what_usd_takes_for_one(kind: object, path: str, good: bool) -> None:
    adapter = TypeAdapter(kind)
    if good:
        assert adapter.validate_python(path) == path
        assert Sdf.Path(path).IsPrimPath()
        return
    with pytest.raises(ValidationError):
        adapter.validate_python(path)


def test_a_camera_may_be_left_to_the_command() -> None:
    assert TypeAdapter(CameraName).validate_python("auto") == "auto"
