"""Positions of a performer's markers on a mesh, from its shapes or from a few landmarks."""

from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from usdface.core.arrays import BoolArray, FloatArray, IntArray, rms_radius, sample_frames
from usdface.core.assets import Rig, RigMesh
from usdface.core.deformer import Deformer
from usdface.core.errors import InputError, as_input_error
from usdface.model.placement.marker_cloud import MarkerCloud, marker_cloud
from usdface.model.placement.place import place_markers
from usdface.numerics.registration.cloud_alignment import align_landmarks
from usdface.numerics.registration.face_skin import SurfaceSamples, sample_outer_surface
from usdface.numerics.registration.marker_binding import (
    FEWEST_MARKERS,
    MarkerBinding,
    choose_by_motion,
    fit_proportions,
    motion_agreement,
)
from usdface.numerics.registration.motion_correspondence import place_by_motion
from usdface.numerics.surface.geodesic import geodesic_distances
from usdface.numerics.surface.surface_places import SurfacePoints, nearest_places, places_of_corners
from usdface.numerics.surface.triangulation import triangle_normals, triangulate

FEWEST_LANDMARKS = 3

UNCERTAIN_CONFIDENCE = 0.5
"""Confidence [0-1] below which a marker's position should be checked."""

_HALF_DISTANCE_SHARE = 0.05
"""Excess distance at which confidence is 1/2, as a share of the face's size."""

_HALF_MOTION_RATIO = 3.0
"""Excess of `motion_agreement` over 1 at which confidence is 1/2: the difference of a marker's
motion from its neighbours', in units of the median difference."""

_SKIN_RADIUS_SHARE = 0.35
"""Standard deviation of the weight of skin over its distance from the nearest marker, as a share of
the face's size."""

_FOLD_REACH = 0.08
"""[of the face's size] Distance of skin from a marker's expected position up to which the marker
may be on it, and least detour along the surface from one side of a fold to the other."""
_FOLD_DETOUR = 3.0
"""Ratio of the distance along the surface to the straight one from which skin is across a fold."""

_SAMPLE_FRAMES = 400
_MOST_POINTS = 60_000
"""Points of a mesh up to which distances between markers are geodesic, so that a proposal takes
seconds."""


def propose_binding(
    mesh: RigMesh,
    *,
    names: tuple[str, ...],
    neutral: FloatArray,
    positions: FloatArray,
    visible: BoolArray,
    rigid: tuple[int, ...],
    pins: dict[int, SurfacePoints],
    sources: dict[int, str],
) -> MarkerBinding:
    """Find the position of every marker on a mesh.

    If the mesh has shapes, their motion is compared with the markers'. Otherwise three or more
    pinned markers give a similarity, which a smooth warp refines.

    Parameters
    ----------
    mesh : RigMesh
        At rest; its shapes are used if it has any.
    neutral : (markers, 3) float array
        The performer's neutral face [mm].
    positions : (frames, markers, 3) float array
        Frames of a stabilised take [mm].
    visible : (frames, markers) bool array
    rigid : tuple of int
        Markers that move with the skull only.
    pins : dict of int to SurfacePoints
        The place that a person gave to each of some markers.
    sources : dict of int to str
        How each pinned marker was placed: ``'landmark'`` or ``'corrected'``.
    """
    if len(neutral) < FEWEST_MARKERS:
        raise InputError(
            f"the take has {len(neutral)} markers; at least {FEWEST_MARKERS} are needed to lay a "
            "face on a mesh"
        )
    pinned = {marker: place.positions(mesh.points)[0] for marker, place in pins.items()}
    picks = sample_frames(len(positions), _SAMPLE_FRAMES)
    sample, seen = positions[picks].astype(np.float64), visible[picks]
    with as_input_error(f"the markers cannot be placed on <{mesh.path}>"):
        if mesh.shapes:
            cloud = marker_cloud(names, neutral, sample, visible=seen, rigid=rigid)
            places = _by_shapes(mesh, cloud, pinned)
        elif len(pins) >= FEWEST_LANDMARKS:
            places = _by_landmarks(mesh, neutral, sample, pinned)
        else:
            raise InputError(
                f"<{mesh.path}>: has no shapes from which markers could be placed, and {len(pins)} "
                f"landmarks are given; name at least {FEWEST_LANDMARKS} that are not on a line, as "
                f"--landmarks {','.join(f'{names[at]}=POINT' for at in (0, len(names) // 2, -1))}"
            )
        return bind_at(
            mesh, places.replaced(pins), names, neutral=neutral, sample=sample, sources=sources
        )


def _by_shapes(mesh: RigMesh, cloud: MarkerCloud, pins: dict[int, FloatArray]) -> SurfacePoints:
    names = tuple(shape.name for shape in mesh.shapes)
    ranges = np.tile([0.0, 1.0], (len(names), 1))
    deformer = Deformer(Rig(Path(), mesh.path, names, (mesh,), ranges))
    skin = deformer.face_skin()
    virtual = place_markers(cloud, skin, names, pinned=pins).virtual
    return places_of_corners(mesh.face_counts, mesh.face_indices, virtual.points, virtual.weights)


def _by_landmarks(
    mesh: RigMesh, neutral: FloatArray, sample: FloatArray, pins: dict[int, FloatArray]
) -> SurfacePoints:
    markers = list(pins)
    targets = np.array([pins[marker] for marker in markers])
    start = align_landmarks(neutral[markers], targets)
    skin = _skin_near(mesh, start.apply(neutral), targets)
    found = place_by_motion(
        neutral,
        skin.positions,
        start,
        skin_deltas=np.zeros((0, *skin.positions.shape), np.float32),
        motion=np.zeros((0, *neutral.shape)),
        ranges=np.zeros((0, 2)),
        pinned=pins,
    )
    # Samples are millimetres apart; the point nearest to the warped marker is between them.
    near = nearest_places(mesh.points, mesh.face_counts, mesh.face_indices, found.warped)
    sampled = places_of_corners(
        mesh.face_counts,
        mesh.face_indices,
        skin.corners[found.samples],
        skin.weights[found.samples],
    )
    distance = np.linalg.norm(near.positions(mesh.points) - sampled.positions(mesh.points), axis=1)
    same = distance < 2 * np.sqrt(np.median(skin.areas))  # else it is on other skin
    places = sampled.replaced({row: near.select([row]) for row in np.flatnonzero(same).tolist()})
    return _on_sides_that_move_alike(mesh, places, skin, found.warped, sample - neutral, pins)


def _on_sides_that_move_alike(
    mesh: RigMesh,
    places: SurfacePoints,
    skin: SurfaceSamples,
    expected: FloatArray,
    moved: FloatArray,
    pins: dict[int, FloatArray],
) -> SurfacePoints:
    """Put markers on the side of a fold, such as a lip, whose other markers move as they do.

    A marker has a second place if skin near its expected position (markers, 3) is far from its
    place along the surface. Meshes of more than `_MOST_POINTS` points are not examined.
    """
    if len(mesh.points) > _MOST_POINTS:
        return places
    at, size = places.positions(mesh.points), rms_radius(expected)
    surface = (mesh.points, mesh.face_counts, mesh.face_indices)
    reach = np.full(len(expected), _FOLD_REACH * size)
    nearby = KDTree(skin.positions).query_ball_point(expected, reach)
    farthest = float(reach[0] + np.linalg.norm(at - expected, axis=1).max())
    to_points = geodesic_distances(
        *surface,
        places,
        metric="dijkstra-diagonals",
        limit=_FOLD_DETOUR * farthest + reach[0],  # beyond it, all skin in reach is across
    ).to_points
    second: dict[int, int] = {}
    for marker, samples in enumerate(nearby):
        near = np.array(sorted(samples), np.int64)
        straight = np.linalg.norm(skin.positions[near] - at[marker], axis=1)
        along = to_points[marker][skin.corners[near]].min(axis=1)
        across = near[along > _FOLD_DETOUR * straight + reach[0]]
        if len(across) and marker not in pins:
            away = np.linalg.norm(skin.positions[across] - expected[marker], axis=1)
            second[marker] = int(across[away.argmin()])
    if not second:
        return places
    markers, rows = np.array(list(second)), list(second.values())
    others = places_of_corners(*surface[1:], skin.corners[rows], skin.weights[rows])
    squares = [
        ((each - expected[markers]) ** 2).sum(axis=1) / (2 * reach[0] ** 2)
        for each in (others.positions(mesh.points), at[markers])
    ]
    chosen = choose_by_motion(
        moved,
        _distances_between(mesh, SurfacePoints.join([places, others])),
        markers,
        squares[0] - squares[1],
    )
    return places.replaced(
        {int(markers[row]): others.select([row]) for row in np.flatnonzero(chosen).tolist()}
    )


def _skin_near(mesh: RigMesh, aligned: FloatArray, landmarks: FloatArray) -> SurfaceSamples:
    """Sample the skin around the aligned markers, on the front of the face."""
    triangles, _ = triangulate(mesh.face_counts, mesh.face_indices)
    points = mesh.points
    size = rms_radius(aligned)
    distance, _ = KDTree(np.concatenate([aligned, landmarks])).query(points)
    weight = np.exp(-(distance**2) / (2 * (_SKIN_RADIUS_SHARE * size) ** 2))
    return sample_outer_surface(
        points, triangles, facing=_facing(points, triangles, aligned, weight), activity=weight
    )


def facing_yaw(mesh: RigMesh, places: FloatArray) -> float:
    """Return the angle about Y from +Z to the direction that a face looks in [degrees].

    Parameters
    ----------
    mesh : RigMesh
        At rest.
    places : (markers, 3) float array
        Positions of the markers on it [mm].
    """
    triangles, _ = triangulate(mesh.face_counts, mesh.face_indices)
    size = rms_radius(places)
    distance, _ = KDTree(places).query(mesh.points)
    weight = np.exp(-((distance / (_SKIN_RADIUS_SHARE * size)) ** 2))
    facing = _facing(mesh.points, triangles, places, weight)
    return float(np.degrees(np.arctan2(facing[0], facing[2])))


def _facing(
    points: FloatArray, triangles: IntArray, aligned: FloatArray, skin: FloatArray
) -> FloatArray:
    """Return the horizontal direction of the mean normal of the skin under the markers."""
    outward = skin[triangles].mean(axis=1) @ triangle_normals(points, triangles)
    # The face is convex: outer markers are behind the inner ones, for either winding.
    radius = np.linalg.norm(aligned - aligned.mean(axis=0), axis=1)
    inner = radius <= np.median(radius)
    forward = aligned[inner].mean(axis=0) - aligned[~inner].mean(axis=0)
    sign = 1.0 if outward @ forward >= 0 else -1.0
    horizontal = sign * np.array([outward[0], 0.0, outward[2]])
    length = float(np.linalg.norm(horizontal))
    if length < 1e-9:
        raise ValueError("the direction of the face cannot be found from the landmarks; add one")
    return np.asarray(horizontal / length)


def bind_at(
    mesh: RigMesh,
    places: SurfacePoints,
    names: tuple[str, ...],
    *,
    neutral: FloatArray,
    sample: FloatArray,
    sources: dict[int, str],
) -> MarkerBinding:
    """Return the binding at given places, with its confidence; see `propose_binding`.

    Parameters
    ----------
    sample : (frames, markers, 3) float array
        Frames of the take [mm].
    """
    places = places.rounded()  # as steps that read the binding find them
    at = places.positions(mesh.points)
    fitted = fit_proportions(neutral, at, weight=np.ones(len(neutral)))
    size = rms_radius(at)
    # The residual of the affine map is mostly proportion, equal among neighbours: use the excess.
    near = np.argsort(np.linalg.norm(at[:, None] - at[None], axis=2), axis=1)[:, 1:5]
    median = np.median(fitted.away_mm[near], axis=1)
    excess = np.maximum(fitted.away_mm - median, 0.0)
    confidence = 1 / (1 + (excess / (_HALF_DISTANCE_SHARE * size)) ** 2)
    moved = (sample - neutral) @ fitted.linear.T
    difference = motion_agreement(moved, _distances_between(mesh, places))
    confidence *= 1 / (1 + (np.maximum(difference - 1, 0) / _HALF_MOTION_RATIO) ** 4)
    confidence[list(sources)] = 1.0
    return MarkerBinding(
        names=names,
        places=places,
        confidence=confidence,
        distance_mm=fitted.away_mm,
        sources=tuple(sources.get(i, "proposed") for i in range(len(names))),
    )


def _distances_between(mesh: RigMesh, places: SurfacePoints) -> FloatArray:
    """Return geodesic distances between places, which are large across the lips.

    On meshes of more than `_MOST_POINTS` points they are Euclidean.
    """
    at = places.positions(mesh.points)
    straight: FloatArray = np.linalg.norm(at[:, None] - at[None], axis=2)
    if len(mesh.points) > _MOST_POINTS:
        return straight
    between = geodesic_distances(
        mesh.points, mesh.face_counts, mesh.face_indices, places, metric="dijkstra-diagonals"
    ).between
    return np.where(np.isfinite(between), between, straight)
