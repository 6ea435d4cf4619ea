"""A synthetic camera above the table: pictures of a deployed rod whose course is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wrod.perception.metric import MarkerLayout

SUPERSAMPLING = 4  # rays per pixel and axis


@dataclass(frozen=True)
class TopCamera:
    """Pinhole camera that looks at the table from above.

    Attributes:
        position: (3,) optical centre [m]; target: (3,) the point it looks at [m].
        up: (3,) direction that is up in the picture.
        size: (width, height) of the picture [px].
        focal_length: [px].
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.8)
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    size: tuple[int, int] = (1280, 960)
    focal_length: float = 1500.0
    _rotation: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        forward = np.subtract(self.target, self.position)
        right = np.cross(forward, self.up)
        forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
        rotation = np.array([right, -np.cross(right, forward), forward])
        object.__setattr__(self, "_rotation", rotation)

    @classmethod
    def above(
        cls, points: np.ndarray, size: tuple[int, int] = (1280, 960), margin: float = 0.15
    ) -> TopCamera:
        """Camera straight above (n, 2|3) points [m], so that they fill the picture but a margin."""
        points = np.asarray(points, float)[:, :2]
        low, high = points.min(0), points.max(0)
        middle = (low + high) / 2
        extent = np.maximum(high - low, 1e-3)
        focal = 1.2 * max(size)
        height = float((extent * focal / ((1 - 2 * margin) * np.array(size))).max())
        return cls((*middle, height), (*middle, 0.0), size=size, focal_length=focal)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) camera matrix [px]."""
        f, (w, h) = self.focal_length, self.size
        return np.array([[f, 0, (w - 1) / 2], [0, f, (h - 1) / 2], [0, 0, 1.0]])

    def project(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) positions [m] -> (n, 2) pixels."""
        seen = (np.asarray(points, float) - self.position) @ self._rotation.T
        pixels = seen @ self.matrix.T
        return pixels[:, :2] / pixels[:, 2:]

    def homography(self, height: float = 0.0) -> np.ndarray:
        """(3, 3) from undistorted pixels to positions in the plane z = height [m]."""
        forward = self.matrix @ np.column_stack(
            [
                self._rotation[:, :2],
                self._rotation @ (np.array([0.0, 0.0, height]) - self.position),
            ]
        )
        return np.linalg.inv(forward)

    def render(
        self,
        centerlines: np.ndarray | list[np.ndarray],
        radius: float,
        *,
        color: tuple[int, int, int] = (214, 84, 96),
        table: tuple[int, int, int] = (18, 18, 18),
        layout: MarkerLayout | None = None,
        noise: float = 0.0,
        seed: int = 0,
    ) -> np.ndarray:
        """Picture (H, W, 3) uint8 RGB of rods on the table.

        Where rods cross, the one that lies higher covers the other.

        Args:
            centerlines: (n, 3), or (n, 2) on the table, or several of them [m].
            radius: of the rods [m].
            color: RGB of the rods; table: RGB of the table.
            layout: markers to lay out on a white sheet.
            noise: standard deviation of the sensor's noise [grey levels]; seed: of that noise.
        """
        import cv2

        if isinstance(centerlines, np.ndarray) and centerlines.ndim == 2:
            centerlines = [centerlines]
        fine = SUPERSAMPLING
        width, height = self.size
        canvas = np.empty((height * fine, width * fine, 3), np.uint8)
        cv2.rectangle(canvas, (0, 0), canvas.shape[1::-1], table, cv2.FILLED)
        if layout is not None:
            self._draw_sheet(canvas, layout)
        strokes = []
        for line in centerlines:
            line = np.asarray(line, float)
            if line.shape[1] == 2:
                line = np.column_stack([line, np.full(len(line), radius)])
            depth = (line - self.position) @ self._rotation[2]
            pixels = np.round(((self.project(line) + 0.5) * fine - 0.5) * 16).astype(int).tolist()
            half = fine * self.focal_length * radius / depth
            level = np.round((line[:-1, 2] + line[1:, 2]) / (2 * radius)).astype(int)
            length = np.hypot(*np.diff(line[:, :2], axis=0).T).mean()
            strokes.append((pixels, half, level, int(np.ceil(3 * radius / max(length, 1e-9)))))
        # Painter's order; shaded sides make the upper rod's outline visible on the lower one.
        for height_level in sorted({int(v) for stroke in strokes for v in stroke[2]}):
            for share, light in ((1.0, 0.55), (0.8, 0.8), (0.5, 1.0)):
                shade = tuple(int(light * c) for c in color)
                for pixels, half, level, near in strokes:
                    drawn = level == height_level
                    if share < 1.0:
                        # The dark end of a piece would mark where it meets the one below.
                        drawn = np.convolve(drawn, np.ones(2 * near + 1), "full") > 0
                        drawn = drawn[near : near + len(level)] & (level <= height_level)
                    for k in np.flatnonzero(drawn):
                        thickness = max(round(2 * share * half[k]), 1)
                        cv2.line(
                            canvas, pixels[k], pixels[k + 1], shade, thickness, cv2.LINE_8, shift=4
                        )
        picture = cv2.resize(canvas, self.size, interpolation=cv2.INTER_AREA)
        picture = cv2.GaussianBlur(picture, (0, 0), 0.6)
        if noise > 0:
            grain = np.random.default_rng(seed).standard_normal(picture.shape, np.float32)
            grain *= noise
            grain += picture
            np.rint(grain, out=grain)
            picture = np.clip(grain, 0.0, 255.0, out=grain).astype(np.uint8)
        return picture

    def _draw_sheet(self, canvas: np.ndarray, layout: MarkerLayout) -> None:
        import cv2

        fine = SUPERSAMPLING
        to_canvas = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1.0]])
        to_pixels = to_canvas @ np.linalg.inv(self.homography())
        if layout.paper is not None:
            w, h = layout.paper
            sheet = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1.0]]) @ to_pixels.T
            sheet = np.round(sheet[:, :2] / sheet[:, 2:]).astype(np.int32)
            cv2.fillConvexPoly(canvas, sheet, (238, 238, 234))
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        cells = 6  # 4 x 4 bits and their border
        for number, corners in layout.corners.items():
            bits = cv2.aruco.generateImageMarker(dictionary, number, cells)
            unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
            on_sheet = cv2.getPerspectiveTransform(unit, corners.astype(np.float32))
            for row in range(cells):
                for column in range(cells):
                    cell = (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + [column, row]) / cells
                    at = np.column_stack([cell, np.ones(4)]) @ on_sheet.T
                    at = np.column_stack([at[:, :2] / at[:, 2:], np.ones(4)]) @ to_pixels.T
                    shade = 20 if bits[row, column] == 0 else 238
                    at = np.round(16 * at[:, :2] / at[:, 2:]).astype(np.int32)
                    cv2.fillConvexPoly(canvas, at, (shade,) * 3, cv2.LINE_8, shift=4)
