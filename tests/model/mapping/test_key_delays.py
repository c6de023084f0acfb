"""Keys of a video that is not in sync with the capture."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from tests.model.synthetic import SyntheticFace, references_of, synthetic_face
from usdface.core.assets import References, TrainedMapping
from usdface.core.trajectories import read_trajectories
from usdface.model.mapping.key_delays import measure_step, whiten_pairs
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.model.regressions.forward_model import ForwardScales, fit_forward_model

pytestmark = pytest.mark.usefixtures("without_comparison")

FIRST, OTHER = synthetic_face(frames=2400), synthetic_face(frames=2400, seed=4)
CHOSEN = np.random.default_rng(3).permutation(np.arange(20, 2380, 40))[:24]
RATE = 60.0


def keyed(
    face: SyntheticFace, late_frames: int, *, error: float = 0.1, seed: int = 0
) -> References:
    """Return pairs whose keys are of earlier frames, with errors as an animator's."""
    pairs = references_of(face, CHOSEN)
    around = read_trajectories(
        CHOSEN, rate=RATE, first=0, last=2399, positions_at=face.positions.__getitem__
    )
    keys = face.weights[CHOSEN - late_frames]
    keys = keys * (1 + error * np.random.default_rng(seed).normal(size=keys.shape))
    return replace(
        pairs,
        weights=np.clip(keys, 0, 1),
        trajectories=around - pairs.markers[:, None],
        neutral_take="take",
    )


def delay_frames(mapping: TrainedMapping) -> dict[str, float]:
    """Return the delay of each take's keys that was found, in frames."""
    found = re.findall(r"(\w+) \((\d+) ms (late|early)\)", str(mapping.settings["key_delays"]))
    return {take: RATE * int(ms) / 1000 * (1 if way == "late" else -1) for take, ms, way in found}


def trained(pairs: References) -> TrainedMapping:
    given = {"ranges": FIRST.ranges, "gram": FIRST.gram, "skin": FIRST.shapes}
    return train_mapping(pairs, method="face_map", **given)  # type: ignore[arg-type]


def joined(first: References, second: References) -> References:
    names = ("markers", "weights", "frames", "tuned", "trajectories")
    both = {
        name: np.concatenate([getattr(each, name) for each in (first, second)]) for name in names
    }
    takes = ("take",) * len(first.takes) + ("other",) * len(second.takes)
    return replace(first, takes=takes, **both)


def test_steps_are_those_of_generalised_least_squares() -> None:
    pairs = keyed(FIRST, 2)
    weights = (pairs.weights, pairs.markers - FIRST.neutral)
    forward = fit_forward_model(
        *weights, expected=FIRST.shapes, neutral=FIRST.neutral, scales=ForwardScales(tau=0.1)
    )
    velocity = np.random.default_rng(2).normal(size=pairs.markers.shape)
    step, _ = measure_step(*whiten_pairs(forward, velocity))
    precise = residual = 0.0
    for k, inverse in enumerate(forward.inverse):
        precise += np.trace(velocity[:, k].T @ inverse @ velocity[:, k])
        residual += np.trace(velocity[:, k].T @ forward.dual[:, k])
    assert step == pytest.approx(residual / precise)


def test_the_critical_step_is_that_of_errors_that_markers_share() -> None:
    rng = np.random.default_rng(8)
    pairs, coordinates, draws = 12, 60, 2000
    velocity = rng.normal(size=(pairs, coordinates)) * np.exp(rng.normal(size=(pairs, 1)))
    shared = rng.normal(size=(3, coordinates))
    errors = rng.normal(size=(draws, pairs, 3)) @ shared
    errors += 0.3 * rng.normal(size=(draws, pairs, coordinates))
    found = np.array([measure_step(velocity, each) for each in errors])
    error = np.sqrt((found[:, 1] ** 2).mean()) / student.ppf(0.995, pairs - 1)
    assert found[:, 0].std() == pytest.approx(error, rel=0.1)
    assert 0 < (np.abs(found[:, 0]) > found[:, 1]).mean() <= 0.01


@pytest.mark.parametrize(
    "late_frames",
    [pytest.param(-4, marks=pytest.mark.slow), -1, pytest.param(2, marks=pytest.mark.slow), 7],
)
def test_the_delay_is_found_and_the_mapping_is_that_of_keys_in_sync(late_frames: int) -> None:
    mapping = trained(keyed(FIRST, late_frames))
    assert delay_frames(mapping) == pytest.approx({"take": late_frames}, abs=0.6)
    rms = [
        np.sqrt(
            ((WeightPredictor(each).predict(FIRST.positions).weights - FIRST.weights) ** 2).mean()
        )
        for each in (mapping, trained(keyed(FIRST, 0)))
    ]
    assert rms[0] < 1.2 * rms[1]
    at_its_frame = replace(keyed(FIRST, late_frames), trajectories=None)
    without = WeightPredictor(trained(at_its_frame)).predict(FIRST.positions).weights
    assert np.sqrt(((without - FIRST.weights) ** 2).mean()) > rms[0]


def test_keys_in_sync_have_no_delay() -> None:
    found = [delay_frames(trained(keyed(FIRST, 0, error=0.2, seed=seed))) for seed in range(4)]
    assert not any(found)


def test_each_take_has_its_delay() -> None:
    mapping = trained(joined(keyed(FIRST, 3), keyed(OTHER, -2)))
    assert delay_frames(mapping) == pytest.approx({"take": 3, "other": -2}, abs=0.6)


@pytest.mark.parametrize("seed", [0, 1])
def test_one_take_in_sync_does_not_halve_the_delay_of_the_other(seed: int) -> None:
    """The delay of all takes, from which each starts, is a mean of both."""
    in_sync = keyed(OTHER, 0, seed=seed).rows(np.arange(12))
    mapping = trained(joined(keyed(FIRST, 4, seed=seed), in_sync))
    assert {"other": 0} | delay_frames(mapping) == pytest.approx({"take": 4, "other": 0}, abs=0.6)


def test_one_delay_of_takes_with_few_pairs_each_is_found() -> None:
    few = [keyed(face, 3).rows(np.arange(8)) for face in (FIRST, OTHER)]
    assert not delay_frames(trained(few[0]))
    both = delay_frames(trained(joined(*few)))
    assert both == pytest.approx({"take": 3, "other": 3}, abs=0.6)


def test_pairs_are_kept_by_which_takes_are_aligned() -> None:
    pairs = keyed(FIRST, 3)
    stored = trained(pairs).arrays["pair_markers"]
    np.testing.assert_allclose(stored, pairs.markers)


def test_proposals_have_no_delay() -> None:
    late, proposals = keyed(FIRST, 4), keyed(OTHER, 0, error=0.0)
    pairs = joined(late, proposals)
    pairs = replace(pairs, takes=("take",) * len(pairs.takes))
    pairs = replace(pairs, tuned=np.arange(len(pairs.weights)) < len(CHOSEN))
    assert delay_frames(trained(pairs)) == pytest.approx({"take": 4}, abs=0.6)
