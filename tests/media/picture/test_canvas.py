import numpy as np

from usdface.media.picture.canvas import space_rows


def test_labels_keep_their_order_their_distance_and_the_page() -> None:
    rng = np.random.default_rng(0)
    rows = np.sort(rng.uniform(0, 400, 30))
    spread = space_rows(rows, spacing=12.0, height=400, margin=14)
    assert np.diff(spread).min() >= 12.0 - 1e-9
    assert spread.min() >= 14 - 1e-9
    assert spread.max() <= 386 + 1e-9
    far = np.array([50.0, 150.0, 300.0])
    np.testing.assert_allclose(space_rows(far, spacing=12.0, height=400, margin=14), far)
