"""From pixels to metres on the table: lens, homography, and where the scale comes from."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from wrod.errors import PerceptionError, needed_extras
from wrod.files import read_json, schemas

# Numbers of distortion coefficients that OpenCV knows.
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
_STRAIGHT, _ELSEWHERE = 0.01, 0.03  # how far a sheet's outline leaves straight edges, and how much
_DARKER = (0.85, 0.7, 0.55)  # shares of what parts bright from dark, of a sheet in a shadow
MARKER_MISFIT = 0.02  # largest rms of the marker corners to their layout, in marker sides


@dataclass(frozen=True)
class CameraIntrinsics:
    """Intrinsics of a camera.

    Attributes:
        matrix: (3, 3) camera matrix [px].
        distortion: (k,) OpenCV distortion coefficients; zeros for none.
    """

    matrix: np.ndarray
    distortion: np.ndarray

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> CameraIntrinsics:
        """Read {"camera_matrix": 3 x 3, "distortion": [k1, k2, p1, p2, ...]} from a JSON file."""
        found = read_json(path, schemas.CameraIntrinsics, "a camera file", error=PerceptionError)
        matrix = np.array(found.camera_matrix)
        focal = np.diag(matrix)[:2]
        off = [matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0]
        if focal.min() < 1.0 or np.abs(off).max() > 1e-9:
            raise PerceptionError(
                f"{path}: camera_matrix is not that of a camera; give "
                "[[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in pixels"
            )
        if len(found.distortion) not in _COEFFICIENTS:
            raise PerceptionError(
                f"{path}: distortion holds {len(found.distortion)} numbers; OpenCV's models have "
                f"{', '.join(str(n) for n in _COEFFICIENTS)}"
            )
        return cls(matrix, np.array(found.distortion or [0.0] * 5))

    @needed_extras()
    def undistort(self, points: np.ndarray) -> np.ndarray:
        """Where (n, 2) pixels would lie without lens distortion [px]."""
        import cv2

        if len(points) == 0:
            return np.zeros((0, 2))
        points = np.asarray(points, float).reshape(-1, 1, 2)
        return cv2.undistortPoints(points, self.matrix, self.distortion, P=self.matrix)[:, 0]


@dataclass(frozen=True)
class SeenPlane:
    """The table as seen by the camera.

    Attributes:
        homography: (3, 3) from undistorted pixels to metres.
        camera: lens of the picture, None for none.
    """

    homography: np.ndarray
    camera: CameraIntrinsics | None = None

    def to_metres(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) pixels -> (n, 2) positions on the table [m]."""
        points = np.asarray(points, float)
        if self.camera is not None:
            points = self.camera.undistort(points)
        return _project(self.homography, points)

    def to_pixels(self, points: np.ndarray) -> np.ndarray:
        """(n, 2) positions on the table [m] -> (n, 2) undistorted pixels."""
        return _project(np.linalg.inv(self.homography), np.asarray(points, float))

    def fill(self, region: np.ndarray, corners: np.ndarray, value: int) -> None:
        """Set (H, W) uint8 to a value within convex corners (n, 2) on the table [m]."""
        import cv2

        cv2.fillConvexPoly(region, np.round(self.to_pixels(corners)).astype(np.int32), value)

    def sheet(self, low: np.ndarray, high: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """(H, W) uint8, 255 within the rectangle of two corners (2,) on the table [m]."""
        region = np.zeros(shape, np.uint8)
        self.fill(region, np.array([low, [high[0], low[1]], high, [low[0], high[1]]]), 255)
        return region

    @classmethod
    @needed_extras()
    def from_markers(
        cls, image: np.ndarray, layout: MarkerLayout, camera: CameraIntrinsics | None = None
    ) -> SeenPlane:
        """From the ArUco markers (DICT_4X4_50, ids 0 to 3) in a picture.

        Raises:
            PerceptionError: a marker is missing or there twice, or they do not lie as laid out.
        """
        import cv2

        corners = find_markers(image, layout)
        pixels = np.vstack([corners[i] for i in sorted(corners)])
        if camera is not None:
            pixels = camera.undistort(pixels)
        metres = np.vstack([layout.corners[i] for i in sorted(corners)])
        homography, _ = cv2.findHomography(pixels, metres, 0)
        side = np.hypot(*(metres[1] - metres[0]))
        misfit = _project(homography, pixels) - metres
        rms = float(np.sqrt((misfit**2).sum(1).mean())) if homography is not None else np.inf
        if rms > MARKER_MISFIT * side:
            raise PerceptionError(
                f"the markers lie {1e3 * rms:.1f} mm off their layout; is it the layout of this "
                "sheet, is the sheet flat, and does the camera need its distortion?"
            )
        return cls(homography, camera)

    @classmethod
    def from_sheet(
        cls, image: np.ndarray, size: tuple[float, float], camera: CameraIntrinsics | None = None
    ) -> SeenPlane:
        """From the four corners of a bright sheet (width, height) [m] on a darker table.

        The origin is its lower left corner in the picture, x right and y up.
        """
        import cv2

        if not (len(size) == 2 and all(np.isfinite(s) and s > 0 for s in size)):
            raise PerceptionError(f"sheet size {size!r}: give width and height in metres")
        corners = find_sheet(image)
        if camera is not None:
            corners = camera.undistort(corners)
        width, height = size
        metres = np.array([[0, height], [width, height], [width, 0], [0, 0]], float)
        return cls(cv2.findHomography(corners, metres, 0)[0], camera)

    @classmethod
    def from_scale(
        cls, metres_per_pixel: float, height: int, camera: CameraIntrinsics | None = None
    ) -> SeenPlane:
        """A camera that looks straight down: origin at the picture's lower left pixel, y up.

        Args:
            metres_per_pixel: [m/px].
            height: of the picture [px].
        """
        if not (np.isfinite(metres_per_pixel) and metres_per_pixel > 0):
            raise PerceptionError(f"scale is {metres_per_pixel!r}; give metres per pixel, above 0")
        k = metres_per_pixel
        return cls(np.array([[k, 0, 0], [0, -k, k * (height - 1)], [0, 0, 1.0]]), camera)


@dataclass(frozen=True)
class MarkerLayout:
    """Where the markers lie on the sheet.

    Attributes:
        corners: id -> (4, 2) corners in the order in which `detectMarkers` returns them [m].
        paper: (width, height) of the sheet [m] with the origin at its lower left corner, or None.
    """

    corners: dict[int, np.ndarray]
    paper: tuple[float, float] | None = None

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> MarkerLayout:
        """Read {"marker_corners_m": {"0": 4 x [x, y], ...}, "paper_size_m": [w, h]} (JSON)."""
        found = read_json(path, schemas.MarkerLayout, "a marker layout", error=PerceptionError)
        corners = {int(i): np.array(c) for i, c in found.marker_corners_m.items()}
        if sorted(corners) != [0, 1, 2, 3]:
            raise PerceptionError(f"{path}: the layout must place the markers 0, 1, 2 and 3")
        for number, corner in corners.items():
            sides = np.diff(corner, axis=0, append=corner[:1])
            lengths = np.hypot(*sides.T)
            turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
            square = np.abs(turns) > 0.9 * lengths.max() ** 2
            if lengths.max() < 1e-4 or not square.all() or (turns > 0.0).any():
                raise PerceptionError(
                    f"{path}: marker {number} is no square; give its four corners [x, y], y up, in "
                    "metres, clockwise from its upper left one"
                )
        middles = np.array([corner.mean(axis=0) for corner in corners.values()])
        if np.linalg.svd(middles - middles.mean(axis=0))[1][1] < 1e-3:
            raise PerceptionError(
                f"{path}: the markers lie on one line or spot; give the four corners of a sheet"
            )
        return cls(corners, found.paper_size_m)

    def region(self, plane: SeenPlane, shape: tuple[int, int]) -> np.ndarray:
        """(H, W) uint8, 255 on the sheet and beside its markers, where strokes may be."""
        every = np.vstack(list(self.corners.values()))
        side = np.hypot(*(self.corners[0][1] - self.corners[0][0]))
        if self.paper is None:
            low, high = every.min(0), every.max(0)
        else:
            # A sheet's rim is in the shade of its edge.
            low, high = np.array([0.15, 0.15]) * side, np.array(self.paper) - 0.15 * side
        region = plane.sheet(low, high, shape)
        for corners in self.corners.values():
            middle = corners.mean(0)
            plane.fill(region, middle + 1.2 * (corners - middle), 0)
        return region


@needed_extras()
def find_markers(image: np.ndarray, layout: MarkerLayout) -> dict[int, np.ndarray]:
    """id -> (4, 2) sub-pixel corners [px] of the layout's markers.

    Raises:
        PerceptionError: one is missing or there twice.
    """
    import cv2

    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    ids = [] if ids is None else [int(i) for i in np.ravel(ids)]
    wanted = sorted(layout.corners)
    missing = [i for i in wanted if i not in ids]
    if len(missing) == len(wanted):
        raise PerceptionError(
            "no marker of the layout is in the picture; show the whole sheet, flat and sharp, or "
            "give the scale another way"
        )
    if missing:
        names = ", ".join(map(str, missing))
        raise PerceptionError(f"marker {names} is not in the picture; all four must be visible")
    twice = sorted({i for i in wanted if ids.count(i) > 1})
    if twice:
        names = ", ".join(map(str, twice))
        raise PerceptionError(f"marker {names} is in the picture twice; cover one of them")
    return {i: found[ids.index(i)].reshape(4, 2).astype(float) for i in wanted}


@needed_extras()
def find_sheet(image: np.ndarray) -> np.ndarray:
    """(4, 2) corners [px] of the one bright sheet: upper left, upper right, lower right, left."""
    # The edges of a whole sheet are straight; a dog's ear is forgiven what is bright.
    tries = [(mask, _STRAIGHT) for mask in _sheets(image)]
    for mask, off in [*tries, (tries[0][0], 1.0)]:
        corners = _quadrilateral(mask, off)
        if corners is not None:
            by_height = corners[np.argsort(corners[:, 1])]
            top, bottom = (half[np.argsort(half[:, 0])] for half in (by_height[:2], by_height[2:]))
            return np.array([top[0], top[1], bottom[1], bottom[0]])
    raise PerceptionError(
        "no whole sheet with four corners stands out of the table; show it all, or use markers"
    )


def _sheets(image: np.ndarray) -> Iterator[np.ndarray]:
    """(H, W) masks of what may be the sheet, most likely first: what is bright; what has no colour,
    in a shadow too; what is bright enough in a shadow."""
    import cv2

    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    grey = cv2.GaussianBlur(grey, (5, 5), 0)
    level, bright = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    yield bright
    if image.ndim == 3:
        colour = cv2.cvtColor(cv2.GaussianBlur(image, (9, 9), 0), cv2.COLOR_RGB2HSV)[..., 1]
        yield cv2.threshold(colour, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1]
    for share in _DARKER:
        yield cv2.threshold(grey, share * level, 255, cv2.THRESH_BINARY)[1]


def _quadrilateral(mask: np.ndarray, off: float) -> np.ndarray | None:
    """(4, 2) corners [px] of a mask's largest piece where it is one within the picture, whose
    outline leaves its edges by such a share of its length at most."""
    import cv2

    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=cv2.contourArea, default=None)
    if outline is None or cv2.contourArea(outline) < 0.1 * mask.size:
        return None
    around = cv2.arcLength(outline, True)
    corners = cv2.approxPolyDP(outline, 0.03 * around, True)[:, 0]
    border = (corners < 2) | (corners > np.array(mask.shape[::-1]) - 3)
    if len(corners) != 4 or border.any() or not cv2.isContourConvex(corners):
        return None
    line = np.zeros(mask.shape, np.uint8)
    cv2.polylines(line, [corners], True, 255, max(int(2.0 * off * around), 1))
    if (line[outline[:, 0, 1], outline[:, 0, 0]] == 0).mean() > _ELSEWHERE:
        return None
    return _fit_edges(outline[:, 0].astype(float), corners.astype(float))


def _fit_edges(outline: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners as intersections of straight lines through the outline between rough corners."""
    import cv2

    lines = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (b - a) / np.hypot(*(b - a))
        offset = outline - a
        s = offset @ along / np.hypot(*(b - a))
        near = np.abs(offset @ [-along[1], along[0]]) < 0.02 * np.hypot(*(b - a)) + 2
        side = outline[near & (s > 0.1) & (s < 0.9)]
        vx, vy, x, y = cv2.fitLine(side.astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
        lines.append(np.array([vy, -vx, vy * x - vx * y]))
    return np.array(
        [
            np.linalg.solve([p[:2], q[:2]], [p[2], q[2]])
            for p, q in zip(lines[-1:] + lines[:-1], lines, strict=True)
        ]
    )


def _project(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    lifted = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return lifted[:, :2] / lifted[:, 2:]
