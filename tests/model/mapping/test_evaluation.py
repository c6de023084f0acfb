from dataclasses import replace

import numpy as np
import pytest

from usdface.core.assets import MeshShape, Rig
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError
from usdface.demo.rig import demo_rig
from usdface.model.mapping.evaluation import Evaluation, evaluate_weights

FRAMES = 40


@pytest.fixture(scope="module")
def rig() -> Rig:
    return demo_rig()


def performance(rig: Rig, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(rng.normal(0.2, 0.3, (FRAMES, len(rig.shapes))), 0, 1)


def evaluate(rig: Rig, solved: np.ndarray, truth: np.ndarray, **changes: object) -> Evaluation:
    given: dict[str, object] = {
        "frames": np.arange(101, 101 + len(truth)),
        "compared": np.ones(len(rig.shapes), dtype=bool),
        "observable": np.ones(len(rig.shapes), dtype=bool),
    }
    return evaluate_weights(rig, solved, truth, **(given | changes))  # type: ignore[arg-type]


def straightened(rig: Rig) -> Rig:
    """Return the rig without its in-betweens: each shape's last key is its full target."""
    return replace(
        rig,
        meshes=tuple(
            replace(
                mesh,
                shapes=tuple(MeshShape(shape.name, shape.keys[-1:]) for shape in mesh.shapes),
            )
            for mesh in rig.meshes
        ),
    )


@pytest.mark.parametrize("bent", [False, True])
def test_the_surface_error_is_the_distance_of_the_deformed_points(rig: Rig, bent: bool) -> None:
    face = rig if bent else straightened(rig)
    assert any(len(shape.keys) > 1 for mesh in face.meshes for shape in mesh.shapes) == bent
    truth, solved = performance(rig), performance(rig, seed=1)
    deformer = Deformer(face)
    distance = np.linalg.norm(deformer.points(solved) - deformer.points(truth), axis=2)
    found = evaluate(face, solved, truth).surface
    np.testing.assert_allclose(found.frames_mm, np.sqrt((distance**2).mean(axis=1)), rtol=1e-9)
    assert found.rms_mm == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-9)


def test_gaze_and_tongue_are_no_error_of_the_skin_and_have_figures_of_their_own(rig: Rig) -> None:
    truth, solved = performance(rig), performance(rig, seed=1)
    columns = [i for i, name in enumerate(rig.shapes) if "Look" in name or "tongue" in name]
    assert len(columns) == 9
    seen = solved.copy()
    seen[:, columns] = truth[:, columns]
    found, expected = evaluate(rig, solved, truth), evaluate(rig, seen, truth)
    np.testing.assert_allclose(found.skin.frames_mm, expected.surface.frames_mm, rtol=1e-9)
    for one, other in zip(found.regions, expected.regions, strict=True):
        np.testing.assert_allclose(one.skin.frames_mm, other.surface.frames_mm, atol=1e-9)
    tongue = truth.copy()
    tongue[:, rig.shapes.index("tongueOut")] += 0.5
    alone = evaluate(rig, tongue, truth)
    assert alone.skin.max_mm == 0.0
    assert alone.excluded_mm == {"gaze": 0.0, "tongue": pytest.approx(alone.surface.mean_mm)}
    assert alone.excluded_mm["tongue"] > 0.0


def test_the_truth_itself_has_no_error(rig: Rig) -> None:
    truth = performance(rig)
    found = evaluate(rig, truth, truth)
    assert (found.weight_rmse, found.surface.max_mm, found.blink_bias) == (0.0, 0.0, 0.0)
    assert found.jitter == 1.0
    assert found.lips is not None
    assert found.lips.rms_mm == 0.0
    assert not found.shape_mm.any()


def test_an_error_of_the_brows_is_found_in_the_brows(rig: Rig) -> None:
    truth = performance(rig)
    solved = truth.copy()
    solved[:, rig.shapes.index("browInnerUp")] += 0.3
    found = evaluate(rig, solved, truth)
    weights = {region.name: region.weight_rmse for region in found.regions}
    surface = {region.name: region.surface.rms_mm for region in found.regions}
    assert [name for name, error in weights.items() if error] == ["brows"]
    assert max(surface, key=lambda name: surface[name]) == "brows"
    assert surface["mouth"] < 0.01 * surface["brows"]
    worst = found.shape_names[int(found.shape_mm.argmax())]
    assert worst == "browInnerUp"


def test_a_mouth_that_stays_open_is_an_error_of_the_lips(rig: Rig) -> None:
    truth = np.zeros((FRAMES, len(rig.shapes)))
    solved = truth.copy()
    solved[:, rig.shapes.index("jawOpen")] = 0.1
    found = evaluate(rig, solved, truth)
    assert found.lips is not None
    assert found.lips.closed_bias_mm == pytest.approx(found.lips.rms_mm)
    assert 1.0 < found.lips.closed_bias_mm < 5.0


def test_shapes_that_do_not_count_leave_the_weights_alone_and_not_the_surface(rig: Rig) -> None:
    truth = performance(rig)
    solved = truth.copy()
    gaze = np.array([name.startswith("eyeLook") for name in rig.shapes])
    solved[:, gaze] += 0.4
    found = evaluate(rig, solved, truth, observable=~gaze)
    assert found.weight_rmse == 0.0
    assert found.surface.rms_mm > 0.0


def test_shapes_whose_names_say_nothing_are_measured_by_what_they_move(rig: Rig) -> None:
    called = {name: f"shape{index}" for index, name in enumerate(rig.shapes)}
    unnamed = replace(
        rig,
        shapes=tuple(called.values()),
        meshes=tuple(
            replace(
                mesh, shapes=tuple(replace(each, name=called[each.name]) for each in mesh.shapes)
            )
            for mesh in rig.meshes
        ),
    )
    found, named = (
        evaluate(r, performance(rig), performance(rig, seed=1), observable=None)
        for r in (unnamed, rig)
    )
    hidden = [
        name for name, seen in zip(named.shape_names, named.observable, strict=True) if not seen
    ]
    assert len(hidden) == 9  # looks and tongue
    np.testing.assert_array_equal(found.observable, named.observable)
    assert found.weight_rmse == named.weight_rmse
    assert [each.name for each in found.regions] == [each.name for each in named.regions]
    for each, other in zip(found.regions, named.regions, strict=True):
        assert each.skin.rms_mm == pytest.approx(other.skin.rms_mm, rel=1e-9)
    assert found.excluded_mm.keys() == named.excluded_mm.keys()
    assert found.lips is None
    assert np.isnan(found.blink_bias)
    assert found.surface.rms_mm > 0.0


def test_nothing_to_compare_and_nan_are_refused(rig: Rig) -> None:
    truth = performance(rig)
    with pytest.raises(InputError, match="no frame or no shape"):
        evaluate(rig, truth, truth, compared=np.zeros(len(rig.shapes), dtype=bool))
    broken = truth.copy()
    broken[3, 4] = np.nan
    with pytest.raises(InputError, match="must be finite"):
        evaluate(rig, broken, truth)
