"""Head poses without the jitter that few rigid markers give them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from usdface.numerics.repair.smoothing import smooth_tracks


def smooth_poses(head_motion: ArrayLike, *, center: ArrayLike) -> NDArray[np.float64]:
    """Smooth rotations, and the path of `center`, as strongly as their own noise asks for.

    A head turns far more slowly than single frames jitter. The penalties are told by generalised
    cross-validation, so a quick nod is followed as far as it stands out of the noise.

    Parameters
    ----------
    head_motion : (frames, 4, 4) array_like
        Rigid transforms for column vectors.
    center : (3,) array_like
        Point of the head's space about which it turns least, such as the middle of the rigid
        markers [mm]: the noise of turns and of paths is separate there.

    Returns
    -------
    (frames, 4, 4) float array
    """
    motion = np.asarray(head_motion, np.float64)
    middle = np.asarray(center, np.float64)
    rotations = Rotation.from_matrix(motion[:, :3, :3])
    usual = rotations.mean()  # turns are small about it: rotation vectors do not wrap
    turns = (usual.inv() * rotations).as_rotvec()
    path = motion[:, :3, :3] @ middle + motion[:, :3, 3]
    smooth = smooth_tracks(np.concatenate([turns, path], axis=1)).values
    result = np.zeros_like(motion)
    result[:, :3, :3] = (usual * Rotation.from_rotvec(smooth[:, :3])).as_matrix()
    result[:, :3, 3] = smooth[:, 3:] - result[:, :3, :3] @ middle
    result[:, 3, 3] = 1.0
    return result
