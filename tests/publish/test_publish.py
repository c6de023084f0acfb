"""A version is whole, numbered, plays the edits, and is never changed again."""

import os
import re
import shutil
import threading
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdSkel

from tests.regenerate import REPOSITORY
from tests.steps.small_shot import FRAMES, Shot
from tests.usdio.small_rig import small_rig
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import controls_path
from usdface.publish import (
    Extracted,
    ReviewOptions,
    collect_performances,
    extract_performance,
    integrate_performance,
    validate_performance,
)
from usdface.publish.integrate import latest_version, read_manifest
from usdface.runner.execute import execute
from usdface.specs.edits import EditSpec, PackageSpec
from usdface.specs.performance import JoinSpec, MapSpec
from usdface.specs.review import SheetSpec
from usdface.usdio.layers import new_layer
from usdface.usdio.performance.read import PerformanceReader, read_performance
from usdface.usdio.performance.weights_layer import make_header
from usdface.usdio.performance.write import writing_performance
from usdface.usdio.rig.read import read_rig
from usdface.usdio.rig.write import write_rig
from usdface.usdio.validation import validate

NO_REVIEW = ReviewOptions(sheet=False)
DRAFT = ReviewOptions(rows=1, quality="draft")


def publish(shot: Shot, root: Path, review: ReviewOptions = NO_REVIEW):
    (item,) = collect_performances([shot / "shot.hero.usda"])
    return integrate_performance(extract_performance(item, root, review=review))


def test_a_folder_is_searched_for_performances_and_nothing_else(shot: Shot) -> None:
    (item,) = collect_performances([shot.folder])
    assert item.name == "shot.hero"
    assert item.take.resolve() == (shot / "shot.clean.take.usda").resolve()
    assert item.rig.resolve() == (shot / "hero.usdc").resolve()
    assert (item.first_frame, item.last_frame) == (1, FRAMES)
    assert item.timecode_start == "01:00:00:00"
    assert validate_performance(item) == ()


def test_a_performance_of_a_folder_is_not_passed_over_because_it_is_damaged(
    shot: Shot, caplog
) -> None:
    (shot / "broken.usdc").write_bytes(b"PXR-USDC, cut off")
    (item,) = collect_performances([shot.folder])
    assert "broken.usdc" in caplog.text
    item.performance.with_suffix(".weights.usdc").unlink()
    with pytest.raises(InputError, match=r"shot.hero.weights.usdc@? cannot be read"):
        collect_performances([shot.folder])


def test_a_folder_without_performances_is_told(tmp_path: Path, caplog) -> None:
    assert collect_performances([tmp_path]) == ()
    assert "holds no performances" in caplog.text


def test_a_folder_with_weights_in_parts_and_controls_beside_holds_one_performance(
    tmp_path: Path,
) -> None:
    names, frames = ("jawOpen", "smile", "eyeBlink"), 23
    write_rig(tmp_path / "rig.usda", small_rig())
    made = Provenance("map", "{}", {})
    with writing_performance(
        tmp_path / "hero.usda",
        make_header(
            read_rig(tmp_path / "rig.usda"),
            shape_names=names,
            rate=Fraction(24),
            first_frame=1,
            last_frame=frames,
        ),
        read_rig(tmp_path / "rig.usda"),
        part_frames=7,
        provenance=made,
    ) as writer:
        writer.append(np.random.default_rng(0).random((frames, len(names))))
    with new_layer(controls_path(tmp_path / "hero.usda"), made):
        pass  # as it lies beside a performance of joints
    assert len(list(tmp_path.glob("hero.*.usdc"))) == 1 + 4 + 1 + 1  # parts, seams, controls
    (item,) = collect_performances([tmp_path])
    assert item.name == "hero"
    assert item.performance == tmp_path / "hero.usda"


def test_a_performance_joined_from_parts_still_knows_its_take(shot: Shot) -> None:
    parts = (shot / "a.usda", shot / "b.usda")
    for frames, part in zip(("1-240", f"241-{FRAMES}"), parts, strict=True):
        execute(
            MapSpec(
                take=shot / "shot.clean.take.usda",
                mapping=shot / "hero.mapping.usdc",
                rig=shot / "hero.usdc",
                out=part,
                frames=frames,
            )
        )
    execute(JoinSpec(parts=parts, out=shot / "joined.usda"))
    (item,) = collect_performances([shot / "joined.usda"])
    assert item.take.resolve() == (shot / "shot.clean.take.usda").resolve()


def test_a_version_plays_the_edits_wherever_it_is_opened(shot: Shot, tmp_path: Path) -> None:
    hero = shot / "shot.hero.usda"
    execute(EditSpec(performance=hero, shape=("jawOpen",), add=0.05, frames="100-200", fade=60))
    published = publish(shot, tmp_path / "publish", DRAFT)
    assert published.folder == tmp_path / "publish" / "shot.hero" / "v001"
    assert set(published.files) == {"performance", "weights", "sheet"}
    wanted, got = read_performance(hero), read_performance(published.files["performance"])
    assert np.array_equal(got.weights.values, wanted.weights.values)
    assert got.rig_file.resolve() == (shot / "hero.usdc").resolve()
    assert validate(published.files["performance"]) == []
    manifest = read_manifest(published.folder)
    assert manifest["version"] == 1
    assert manifest["edited"] == ["jawOpen"]
    assert (published.folder / manifest["rig"]).resolve() == (shot / "hero.usdc").resolve()


def test_what_has_not_changed_is_not_published_again(shot: Shot, tmp_path: Path) -> None:
    first = publish(shot, tmp_path)
    again = publish(shot, tmp_path)
    assert (first.version, first.is_new, again.version, again.is_new) == (1, True, 1, False)
    execute(EditSpec(performance=shot / "shot.hero.usda", shape=("jawOpen",), add=0.1))
    changed = publish(shot, tmp_path)
    assert (changed.version, changed.is_new) == (2, True)
    parent = first.folder.parent
    assert sorted(path.name for path in parent.iterdir() if path.is_dir()) == ["v001", "v002"]


def test_the_number_of_a_deleted_version_is_not_used_again(shot: Shot, tmp_path: Path) -> None:
    publish(shot, tmp_path)
    execute(EditSpec(performance=shot / "shot.hero.usda", shape=("jawOpen",), add=0.1))
    shutil.rmtree(publish(shot, tmp_path).folder)
    assert publish(shot, tmp_path).version == 3


def test_a_damaged_manifest_of_the_newest_version_does_not_stop_a_publish(
    shot: Shot, tmp_path: Path
) -> None:
    first = publish(shot, tmp_path)
    manifest = first.folder / "publish.json"
    manifest.write_text('{"files": {"performance": "shot.hero.usda"}}')
    with pytest.raises(InputError, match="does not describe a published version"):
        read_manifest(first.folder)
    assert publish(shot, tmp_path).version == 2


def test_a_rig_that_changed_since_the_solve_is_told(shot: Shot) -> None:
    (item,) = collect_performances([shot / "shot.hero.usda"])
    stage = Usd.Stage.Open(str(shot / "hero.usdc"))
    shape = next(each for each in stage.Traverse() if each.GetName() == "jawOpen")
    offsets = UsdSkel.BlendShape(shape).GetOffsetsAttr()
    offsets.Set([0.5 * each for each in offsets.Get()])
    stage.Save()
    (finding,) = validate_performance(item)
    assert finding.severity == "warning"
    assert finding.message.startswith("hero.usdc changed since it was made")


@pytest.mark.parametrize("left", [None, b"cut off"])
def test_a_version_that_lost_a_file_is_published_again(
    shot: Shot, tmp_path: Path, left: bytes | None
) -> None:
    weights = publish(shot, tmp_path).files["weights"]
    weights.unlink() if left is None else weights.write_bytes(left)
    again = publish(shot, tmp_path)
    assert (again.version, again.is_new, again.files["weights"].is_file()) == (2, True, True)


def test_three_who_publish_at_once_each_get_a_version(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (item,) = collect_performances([shot / "shot.hero.usda"])
    made = []
    for index in range(3):
        extracted = extract_performance(item, tmp_path, review=NO_REVIEW)
        with (extracted.folder / "shot.hero.weights.usdc").open("ab") as stream:
            stream.write(b"\0" * index)  # each its own
        made.append(extracted)
    together = threading.Barrier(len(made), timeout=60)

    def latest(folder: Path, *, deleted: bool = False) -> int:
        version = latest_version(folder, deleted=deleted)
        if deleted:
            together.wait()  # now all try the same number
        return version

    monkeypatch.setattr("usdface.publish.integrate.latest_version", latest)
    done = []
    threads = [
        threading.Thread(target=lambda each=each: done.append(integrate_performance(each)))
        for each in made
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(each.version for each in done) == [1, 2, 3]
    for each in done:
        assert read_manifest(each.folder)["version"] == each.version
    assert latest_version(tmp_path / "shot.hero") == 3


def test_a_version_and_a_package_show_the_variant_that_was_chosen(
    shot: Shot, tmp_path: Path
) -> None:
    rig = Sdf.Layer.FindOrOpen(str(shot / "hero.usdc"))
    top = rig.rootPrims[0]
    groom = Sdf.VariantSetSpec(top, "groom")
    for name in ("long", "short"):
        made = Sdf.VariantSpec(groom, name).primSpec
        Sdf.AttributeSpec(made, "hair", Sdf.ValueTypeNames.String).default = name
    top.variantSetNameList.prependedItems = ["groom"]
    top.variantSelections["groom"] = "long"
    rig.Save()
    performance = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    performance.rootPrims[0].variantSelections["groom"] = "short"
    performance.Save()
    published = publish(shot, tmp_path)
    package = shot / "shot.usdz"
    execute(PackageSpec(performance=shot / "shot.hero.usda", out=package))
    for file in (published.files["performance"], package):
        shown = Usd.Stage.Open(str(file))
        assert shown.GetDefaultPrim().GetAttribute("hair").Get() == "short", file
    again = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    again.rootPrims[0].variantSelections.clear()
    again.Save()
    execute(PackageSpec(performance=shot / "shot.hero.usda", out=package), overwrite=True)
    shown = Usd.Stage.Open(str(package))
    shown.Reload()
    assert shown.GetDefaultPrim().GetAttribute("hair").Get() == "long"


@pytest.mark.parametrize("opened", ["shot.hero.usda", "cut.usda"])
def test_a_version_and_a_package_play_the_joints_that_the_performance_plays(
    shot: Shot, tmp_path: Path, opened: str
) -> None:
    rig = Usd.Stage.Open(str(shot / "hero.usdc"))
    top = rig.GetDefaultPrim()
    skeleton = next(each for each in rig.Traverse() if each.IsA(UsdSkel.Skeleton))
    body = UsdSkel.Animation.Define(rig, top.GetPath().AppendChild("body"))
    body.GetJointsAttr().Set(UsdSkel.Skeleton(skeleton).GetJointsAttr().Get())
    body.SetTransforms([Gf.Matrix4d(1).SetTranslate((0, 7, 0))], 50)
    bound = UsdSkel.BindingAPI.Apply(skeleton).CreateAnimationSourceRel()
    bound.SetTargets([body.GetPath()])
    rig.Save()
    performance = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    solve = Sdf.CreatePrimInLayer(performance, top.GetPath().AppendChild("FaceSolve"))
    solve.referenceList.prependedItems = [Sdf.Reference("", body.GetPath())]
    performance.Save()
    if opened == "cut.usda":
        cut = Sdf.Layer.CreateNew(str(shot / opened))
        cut.TransferContent(performance)
        cut.subLayerPaths.clear()
        cut.rootPrims.clear()
        placed = Sdf.CreatePrimInLayer(cut, "/cast/actor")
        placed.specifier = placed.nameParent.specifier = Sdf.SpecifierDef
        moved = Sdf.LayerOffset(40)
        reference = Sdf.Reference("./shot.hero.usda", top.GetPath(), moved)
        placed.referenceList.prependedItems = [reference]
        cut.defaultPrim = "cast"
        cut.Save()
    (item,) = collect_performances([shot / opened])
    extracted = extract_performance(item, tmp_path, review=NO_REVIEW)
    execute(PackageSpec(performance=shot / opened, out=tmp_path / "review.usdz"))
    reader = PerformanceReader(shot / opened)
    wanted = UsdSkel.Animation(reader.animation).GetTranslationsAttr()
    assert len(wanted.GetTimeSamples()) == 1
    for file in (extracted.path("performance"), tmp_path / "review.usdz"):
        got = PerformanceReader(file)
        played = UsdSkel.Animation(got.animation).GetTranslationsAttr()
        assert played.GetTimeSamples() == wanted.GetTimeSamples()


def test_a_version_turns_the_head_as_the_performance_does(
    shot: Shot, tmp_path: Path, caplog
) -> None:
    hero = shot / "shot.hero.usda"
    execute(
        MapSpec(
            take=shot / "shot.clean.take.usda",
            mapping=shot / "hero.mapping.usdc",
            rig=shot / "hero.usdc",
            out=hero,
            drive=("head=head",),
        ),
        overwrite=True,
    )
    published = publish(shot, tmp_path)
    assert published.files["head"].name == "shot.hero.head.usdc"
    assert "only weights" not in caplog.text
    readers = [PerformanceReader(each) for each in (hero, published.files["performance"])]
    wanted, got = (UsdSkel.Animation(each.animation).GetTransforms(100) for each in readers)
    assert wanted
    assert got == wanted


def test_a_layer_of_an_animator_above_the_performance_has_its_take(shot: Shot) -> None:
    above = Sdf.Layer.CreateNew(str(shot / "animator.usda"))
    above.subLayerPaths = ["./shot.hero.usda"]
    below = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    above.timeCodesPerSecond = below.timeCodesPerSecond
    above.defaultPrim = below.defaultPrim
    above.Save()
    (item,) = collect_performances([shot / "animator.usda"])
    assert item.take is not None
    assert item.take.resolve() == (shot / "shot.clean.take.usda").resolve()
    above.subLayerOffsets[0] = Sdf.LayerOffset(40)  # its frames are others
    above.Save()
    (item,) = collect_performances([shot / "animator.usda"])
    assert item.take is None


@pytest.mark.parametrize(
    ("name", "slower", "moved"),
    [
        ("shot.hero.usda", 1, "by +40 frames"),
        ("cut.usda", 1, "by +40 frames"),
        ("cut.usda", 5, "by +8 frames and scales their times by 0.2"),
    ],
)
def test_what_was_moved_in_time_is_not_shown_beside_the_take_as_it_was(
    shot: Shot, tmp_path: Path, name: str, slower: int, moved: str, caplog
) -> None:
    mapped = Sdf.Layer.FindOrOpen(str(shot / "shot.hero.usda"))
    top = mapped
    if name == "cut.usda":  # moved in a shot above
        top = Sdf.Layer.CreateNew(str(shot / name))
        top.subLayerPaths = ["./shot.hero.usda"]
        top.timeCodesPerSecond = mapped.timeCodesPerSecond / slower
        top.defaultPrim = mapped.defaultPrim
    top.subLayerOffsets[0] = Sdf.LayerOffset(40 / slower)
    top.Save()
    take = shot / "shot.clean.take.usda"
    with pytest.raises(InputError, match=re.escape(f"moves its weights {moved}")):
        execute(SheetSpec(performance=shot / name, take=take, out=shot / "moved.jpg", rows=1))
    (item,) = collect_performances([shot / name])
    extracted = extract_performance(replace(item, take=take), tmp_path, review=DRAFT)
    assert set(extracted.files) == {"performance", "weights"}
    assert f"no pictures: a layer moves it {moved}" in caplog.text
    left_out = f"{FRAMES - FRAMES // slower} of {FRAMES} samples lie between the frames of {name}"
    assert (left_out in caplog.text) == (slower > 1)


def test_what_a_publish_left_that_was_killed_long_ago_is_cleared(
    shot: Shot, tmp_path: Path
) -> None:
    there = tmp_path / "shot.hero"
    kept = there / ".0123456789ab", there / ".somebody's"
    for folder in (left := there / ".ba9876543210", *kept):
        folder.mkdir(parents=True)
    for old in (left, kept[1]):
        os.utime(old, (0, 0))
    publish(shot, tmp_path)
    assert not left.exists()
    assert all(folder.is_dir() for folder in kept)


def test_a_publish_that_fails_leaves_nothing_behind(shot: Shot, tmp_path: Path) -> None:
    (item,) = collect_performances([shot / "shot.hero.usda"])
    (shot / "hero.usdc").unlink()
    with pytest.raises(InputError):
        extract_performance(item, tmp_path, review=NO_REVIEW)
    assert list((tmp_path / "shot.hero").iterdir()) == []


def test_without_its_take_a_performance_is_published_without_a_sheet(
    shot: Shot, tmp_path: Path
) -> None:
    shutil.move(shot / "shot.clean.take.usda", tmp_path / "elsewhere.usda")
    (item,) = collect_performances([shot / "shot.hero.usda"])
    assert item.take is None
    (finding,) = validate_performance(item)
    assert (finding.severity, finding.check) == ("warning", "usdface:take")
    extracted = extract_performance(item, tmp_path / "publish", review=DRAFT)
    assert set(extracted.files) == {"performance", "weights"}
    extracted.discard()
    assert list((tmp_path / "publish" / "shot.hero").iterdir()) == []


def test_what_cannot_be_published_is_refused(shot: Shot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        collect_performances([tmp_path / "no.usda"])
    with pytest.raises(InputError, match="no active SkelAnimation"):
        collect_performances([shot / "hero.usdc"])
    other = tmp_path / "shot.hero.usda"
    shutil.copy(shot / "shot.hero.usda", other)
    with pytest.raises(InputError, match="has the same name as"):
        collect_performances([shot / "shot.hero.usda", other])
    with pytest.raises(InputError, match="is this a published version"):
        read_manifest(tmp_path)


def test_a_version_that_cannot_be_made_keeps_what_was_extracted(shot: Shot, tmp_path: Path) -> None:
    (item,) = collect_performances([shot / "shot.hero.usda"])
    extracted = extract_performance(item, tmp_path, review=NO_REVIEW)
    gone: Extracted = replace(extracted, files={"performance": extracted.files["performance"]})
    (extracted.folder / "publish.json").mkdir()
    with pytest.raises(InputError, match=r"publish\.json: is a folder"):
        integrate_performance(gone)
    assert extracted.path("weights").is_file()


def test_the_script_on_the_page_publishes(shot: Shot, monkeypatch, capsys) -> None:
    page = REPOSITORY / "docs" / "publish.md"
    # At a line's start: what is indented belongs to another tool's own file.
    (code,) = re.findall(r"(?ms)^```python\n(.*?)^```", page.read_text("utf-8"))
    monkeypatch.chdir(shot.folder)
    monkeypatch.setattr(
        "usdface.publish.extract_performance", partial(extract_performance, review=NO_REVIEW)
    )
    exec(compile(code, str(page), "exec"), {})
    assert Path(capsys.readouterr().out.strip()) == Path("publish/shot.hero/v001")
    assert (shot / "publish" / "shot.hero" / "v001" / "publish.json").is_file()
