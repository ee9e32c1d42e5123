"""Casting rays at triangles: which one is hit first, and exactly how far away.

Embree (single precision, quick) finds the triangle; the distance is then computed again in double
precision from the triangle's plane, so it does not depend on the instruction set that Embree chose.

Letters in shapes: T triangles, N rays.
"""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class RayCaster:
    """Triangles that rays can be cast at.

    Args:
        triangles: (T, 3, 3) corners, metres; T may be 0.
    """

    def __init__(self, triangles: Floats) -> None:
        self.triangles = np.ascontiguousarray(triangles, dtype=np.float64)
        self._scene = EmbreeScene(robust=True)
        if len(self.triangles):
            self._mesh = TriangleMesh(self._scene, self.triangles.astype(np.float32))

    def first_hit(self, origins: Floats, directions: Floats) -> NDArray[np.int32]:
        """Number of the first triangle on each ray, -1 where there is none.

        Args:
            origins: (N, 3) metres.
            directions: (N, 3) of any length > 0.

        Returns:
            (N,) int32.
        """
        if not len(self.triangles) or not len(origins):
            return np.full(len(origins), -1, np.int32)
        found = self._scene.run(_single(origins), _single(directions), query="INTERSECT")
        return np.asarray(found, dtype=np.int32)

    def distances(self, origins: Floats, directions: Floats, triangle: NDArray[np.int32]) -> Floats:
        """How far along each ray its triangle's plane lies, in lengths of the direction.

        Args:
            origins: (N, 3) metres.
            directions: (N, 3).
            triangle: (N,) numbers from `first_hit`.

        Returns:
            (N,) float64, infinity where the number is -1 or the ray is parallel to the plane.
        """
        out = np.full(len(triangle), np.inf)
        hit = np.flatnonzero(triangle >= 0)
        corners = self.triangles[triangle[hit]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        above = ((corners[:, 0] - origins[hit]) * normal).sum(axis=1)
        speed = (directions[hit] * normal).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = above / speed
        out[hit] = np.where(speed != 0, distance, np.inf)
        return out

    def occluded(self, origins: Floats, directions: Floats) -> NDArray[np.bool_]:
        """(N,) whether anything lies on each ray, however far."""
        if not len(self.triangles) or not len(origins):
            return np.zeros(len(origins), np.bool_)
        found = self._scene.run(_single(origins), _single(directions), query="OCCLUDED")
        return np.asarray(found) >= 0


def _single(array: Floats) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)
