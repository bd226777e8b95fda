"""Contact points and directions in which a finger may push: Algorithm 3, lines 8 to 10, and its first
candidate.

Two numbers identify a line of push, which makes neighbours easy to find: the arc length of the contact along
the contours, and the angle between the push and the inward normal there. The contours are the exterior and,
after it, the openings in which the finger can come down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from slipmap.models.geometry import compose, rotated
from slipmap.models.objects import contour_cells
from slipmap.models.objects.footprints import wide_holes
from slipmap.models.physics.cell_grid import CellGrid, FloatArray
from slipmap.planners.exploration import DESCENT, TOUCH, NoReachablePush

_TRIES = 20  # rounds of drawing the wanted number of lines before fewer are accepted


@dataclass(frozen=True, eq=False)
class ContactLines:
    """C lines along which a round finger can push, all clear until first touch; object frame."""

    places: FloatArray  # (C,) arc length along the contours, m
    angles: FloatArray  # (C,) from the inward normal to the direction, counter-clockwise, rad
    touches: FloatArray  # (C, 2) finger centre at first touch, m
    directions: FloatArray  # (C, 2) unit vectors of the finger's motion

    def __len__(self) -> int:
        return len(self.places)

    def chosen(self, which: slice | np.ndarray) -> ContactLines:
        """A subset of them."""
        return ContactLines(*(values[which] for values in vars(self).values()))

    def joined(self, others: ContactLines) -> ContactLines:
        """These, followed by others."""
        pairs = zip(vars(self).values(), vars(others).values(), strict=True)
        return ContactLines(*(np.concatenate(pair) for pair in pairs))


class ContactContour:
    """The contours of an object, for a finger.

    Args:
        finger_radius: m.
        approach: length that must be clear before first touch, m.
    """

    def __init__(self, grid: CellGrid, finger_radius: float, approach: float) -> None:
        self._polygon = grid.polygon
        self._radius = finger_radius
        self._approach = approach
        room = finger_radius + DESCENT
        rings = [grid.exterior, *wide_holes(grid, room)]
        self._corners = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings])
        edges = self._corners - np.concatenate(rings)
        lengths = np.linalg.norm(edges, axis=1)
        self._ends = np.cumsum(lengths)
        self._along = edges / np.where(lengths > 0, lengths, 1.0)[:, None]
        # (R + 1,) arc lengths at which rings begin, and the end of the last one.
        self._limits = np.append(0.0, self._ends[np.cumsum([len(ring) for ring in rings]) - 1])
        self._cells = contour_cells(grid, room)[1]
        points = shapely.points(self._cells)
        lines = np.array([shapely.LinearRing(ring) for ring in rings])
        of = np.argmin(shapely.distance(lines[:, None], points), axis=0)
        self._outer = of == 0
        self.cell_places: FloatArray = self._limits[of] + shapely.line_locate_point(lines[of], points)
        """(c,) arc lengths of the contact points of the contours' cells, m."""

    def lines(self, places: FloatArray, angles: FloatArray) -> ContactLines:
        """The lines, out of those at C arc lengths and angles, that the finger can follow."""
        places = np.mod(places, self._ends[-1])
        edge = np.minimum(np.searchsorted(self._ends, places, side="right"), len(self._ends) - 1)
        back = (self._ends[edge] - places)[:, None]
        corner, along = self._corners[edge], self._along[edge]
        inward = np.column_stack([-along[:, 1], along[:, 0]])
        touches = corner - back * along - self._radius * inward
        directions = rotated(inward, angles)
        ways = shapely.linestrings(np.stack([touches - self._approach * directions, touches], axis=1))
        free = shapely.distance(ways, self._polygon) >= self._radius - TOUCH
        begins = shapely.points(touches - self._approach * directions)
        free &= shapely.distance(begins, self._polygon) >= self._radius + DESCENT
        return ContactLines(places, angles, touches, directions).chosen(free)

    def nearest_to_axis(self, center: FloatArray, ways: FloatArray) -> FloatArray:
        """Contacts most in line with the required motion of the expected centre of mass.

        i = argmax cos(x̂ - x_target, p^i - x̂) over the cells of the exterior (section V.D of the paper).

        Args:
            center: (2,) expected centre of mass x̂, object frame, m.
            ways: (G, 2) its required displacements, x_target - x̂, object frame, m.

        Returns:
            (G',) distinct arc lengths, m; none for a target at which the centre of mass already is.
        """
        wanted = ways[np.linalg.norm(ways, axis=1) > 1e-6]
        spokes = self._cells[self._outer] - center
        spokes = spokes / np.linalg.norm(spokes, axis=1)[:, None]
        return self.cell_places[self._outer][np.unique(np.argmax(-wanted @ spokes.T, axis=1))]

    def spread(self, first: FloatArray, count: int, cone: float, rng: np.random.Generator) -> ContactLines:
        """Candidates all around the contours: `first`, then random ones; half of all are along the normals.

        Args:
            first: (f,) arc lengths to put before all others, m.
            count: wanted number of lines.
            cone: largest angle from the inward normal, rad.

        Raises:
            NoReachablePush: the finger fits nowhere.
        """
        straight = np.concatenate([first, rng.permutation(self.cell_places)])
        half = slice(max(count // 2, len(first)))
        found = self.lines(straight, np.zeros(len(straight))).chosen(half)
        for _ in range(_TRIES):
            if len(found) >= count:
                break
            places = rng.uniform(0.0, self._ends[-1], count)
            found = found.joined(self.lines(places, rng.uniform(-cone, cone, count)))
        if not len(found):
            raise NoReachablePush(
                f"planning: a finger of radius {self._radius:.4g} m reaches no point of the contour;"
                " take a thinner finger"
            )
        return found.chosen(slice(count))

    def near(
        self,
        lines: ContactLines,
        chosen: np.ndarray,
        count: int,
        shift: float,
        tilt: float,
        cone: float,
        rng: np.random.Generator,
    ) -> ContactLines:
        """Perturbed contact points and directions around some of the lines; may be none.

        Args:
            lines: tried so far.
            chosen: (m,) indices of those to vary, in turn.
            count: wanted number of lines.
            shift: standard deviation along the contact's ring, m.
            tilt: standard deviation of the angle, rad.
            cone: largest angle from the inward normal, rad.
        """
        base = np.resize(chosen, count)
        ring = np.searchsorted(self._limits[1:-1], lines.places[base], side="right")
        begin, end = self._limits[ring], self._limits[ring + 1]
        places = begin + np.mod(lines.places[base] - begin + shift * rng.standard_normal(count), end - begin)
        angles = lines.angles[base] + tilt * rng.standard_normal(count)
        return self.lines(places, np.clip(angles, -cone, cone))


def ways_of_center(center: FloatArray, targets: FloatArray) -> FloatArray:
    """(G, 2) displacement of a point (2,) of the object to its place in targets (G, 3), object frame, m."""
    return compose(targets, np.append(center, 0.0))[:, :2] - center
