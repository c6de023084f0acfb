"""Motion of one marker between gaps: of dropped frames, or of this marker alone."""

import numpy as np
import pytest

from tests.numerics.simulated_face import simulate_face
from usdface.numerics.repair.fit_low_rank import fit_low_rank
from usdface.numerics.repair.outliers import find_outliers


@pytest.mark.parametrize("dropped", [True, False], ids=["dropped frames", "gaps of the marker"])
def test_motion_between_dropped_frames_is_no_outlier(dropped: bool) -> None:
    """Dropped frames at both ends of a motion that no other marker predicts erased it."""
    face = simulate_face(frames=1200, noise=0.1)
    marker = max(set(range(face.truth.shape[1])) - set(face.rigid))
    visible = np.ones(face.truth.shape[:2], bool)
    model = fit_low_rank(face.truth, visible)
    positions = face.truth.copy()
    positions[600:640, marker, 1] += 8.0 * np.sin(np.linspace(0, np.pi, 40)) ** 2
    columns = slice(None) if dropped else marker
    for end in (605, 633):
        visible[end : end + 2, columns] = False
        positions[end : end + 2, columns] = positions[end - 1, columns]
    noise = np.full(visible.shape[1], 0.1)
    found = find_outliers(positions, visible, model=model, noise=noise, rate=120.0)
    assert found[608:630, marker].any() == (not dropped)
