"""Coverage by references: laws of the share that a Gaussian process leaves over."""

from dataclasses import replace

import numpy as np

from tests.model.mapping.test_uncertainty import CHOSEN, NAMES, face_in_parts
from tests.model.synthetic import SHAPES, SyntheticFace, references_of, sample_skin
from usdface.core.assets import TrainedMapping
from usdface.model.mapping.coverage import CoverageModel
from usdface.model.mapping.predict import WeightPredictor
from usdface.model.mapping.train import train_mapping
from usdface.numerics.regression.reference_design import DesignKernel, posterior_shares


def train_on(face: SyntheticFace, rows: np.ndarray, *, still: int = 0) -> TrainedMapping:
    """Train on some frames, the first `still` shapes of which no reference moves."""
    weights = face.weights[rows].copy()
    weights[:, :still] = 0.0
    markers = face.neutral + np.einsum("fs,smc->fmc", weights, face.shapes)
    references = replace(
        references_of(face, rows), shape_names=NAMES, weights=weights, markers=markers
    )
    return train_mapping(
        references,
        ranges=face.ranges,
        gram=face.gram,
        skin=sample_skin(face.shapes.reshape(SHAPES, -1)),
        method="ridge",
    )


def test_a_reference_covers_itself_and_more_references_cover_more() -> None:
    face = face_in_parts(noise=0.05)
    few, many = (
        WeightPredictor(train_on(face, CHOSEN[:count])).predict(face.positions)
        for count in (10, 40)
    )
    assert many.coverage[CHOSEN].min() > 0.9
    assert many.coverage[:, 0].mean() > few.coverage[:, 0].mean()
    assert few.coverage.min() >= 0
    assert few.coverage.max() <= 1


def test_what_no_reference_moves_is_not_covered_though_the_rest_is() -> None:
    face = face_in_parts(noise=0.05)
    found = WeightPredictor(train_on(face, CHOSEN, still=2)).predict(face.positions)
    moves = np.linalg.norm(face.weights[:, :2], axis=1) > 0.5
    brows, mouth = found.regions.index("brows"), found.regions.index("mouth")
    assert found.coverage[moves, brows].max() < 0.6
    assert found.coverage[moves, mouth].mean() > 0.85


def test_an_unseen_marker_counts_as_the_others_let_expect() -> None:
    face = face_in_parts(noise=0.05)
    mapping = train_on(face, CHOSEN)
    visible = np.ones(face.positions.shape[:2], dtype=bool)
    visible[::2, -1] = False
    spoiled = np.where(visible[:, :, None], face.positions, 1e6)
    whole = WeightPredictor(mapping).predict(face.positions).coverage
    found = WeightPredictor(mapping).predict(spoiled, visible=visible).coverage
    np.testing.assert_array_equal(found[1::2], whole[1::2])
    np.testing.assert_allclose(found[::2], whole[::2], atol=0.1)


def test_the_share_left_over_is_the_posterior_variance_of_a_gaussian_process() -> None:
    rng = np.random.default_rng(0)
    known, rows = rng.normal(size=(7, 4)), rng.normal(size=(5, 4))
    kernel = DesignKernel.for_size(3.0)
    inverse = np.linalg.inv(kernel(known, known) + 0.01 * np.eye(7))
    across = kernel(rows, known)
    posterior = np.diag(kernel(rows, rows) - across @ inverse @ across.T)
    share = posterior_shares(kernel, known, rows)[-1]
    np.testing.assert_allclose(share, posterior / kernel.diagonal(rows), atol=1e-9)
    scaled = posterior_shares(DesignKernel.for_size(3e4), 100 * known, 100 * rows)[-1]
    np.testing.assert_allclose(scaled, share, atol=1e-9)  # of no unit


def test_coverage_is_that_of_the_posterior_of_each_region() -> None:
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(3, 4, 3))
    pairs, frames = rng.normal(size=(6, 4, 3)), rng.normal(size=(9, 4, 3))
    membership = np.array([[1.0, 1, 1, 1], [0, 1, 1, 0]])
    coverage = CoverageModel(basis, pairs, membership).measure(frames)
    for column, chosen in zip(coverage.T, membership > 0, strict=True):
        kernel = DesignKernel.for_size((basis[:, chosen] ** 2).sum(axis=(1, 2)).mean())
        known, rows = (each[:, chosen].reshape(len(each), -1) for each in (pairs, frames))
        share = posterior_shares(kernel, known, rows)[-1]
        np.testing.assert_allclose(column, 1 - np.sqrt(share), atol=1e-12)
