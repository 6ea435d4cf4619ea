"""The sheet of markers that gives a photograph its scale, and the layout to read it by."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wrod.errors import PerceptionError, needed_extras
from wrod.files import write_atomically, write_figure, write_json

# Width and height [m], lying on their long side.
PAPERS = {"a4": (0.297, 0.210), "a3": (0.420, 0.297), "letter": (0.2794, 0.2159)}
_INCH = 0.0254  # [m]
_CODE = 6  # squares across a marker of DICT_4X4: four of code in a border of one
# Of A0, whose picture has 140 million pixels [m].
_LARGEST = 1.2


@dataclass(frozen=True)
class MarkerSheet:
    """Four ArUco markers (DICT_4X4_50, ids 0 to 3) in the corners of a sheet.

    The origin is the sheet's lower left corner, x right and y up. Marker 0 is in the upper left
    corner, and the others follow clockwise.

    Attributes:
        size: width and height of the sheet [m].
        side: of a marker [m].
        margin: from the sheet's edge to the markers, which printers leave white [m].

    Raises:
        PerceptionError: markers do not fit on the sheet with room between them, or are too small to
            be read.
    """

    size: tuple[float, float]
    side: float = 0.024
    margin: float = 0.008

    def __post_init__(self):
        numbers = (*self.size, self.side, self.margin)
        if not all(np.isfinite(n) and n > 0 for n in numbers):
            raise PerceptionError("a sheet's size, markers and margin must be positive [m]")
        if max(self.size) > _LARGEST:
            raise PerceptionError(
                f"a sheet of {self.size[0]:g} x {self.size[1]:g} m is larger than any that is "
                f"printed; give at most {_LARGEST:g} m, and metres"
            )
        if self.side < 0.005:
            raise PerceptionError(
                f"markers of {1e3 * self.side:g} mm are too small for a camera; give 5 mm or more"
            )
        if 2 * self.margin + 3 * self.side > min(self.size):
            raise PerceptionError(
                f"markers of {1e3 * self.side:g} mm leave no room on a sheet of "
                f"{1e3 * self.size[0]:g} x {1e3 * self.size[1]:g} mm; give smaller ones or more "
                "paper"
            )

    @property
    def span(self) -> float:
        """Between the outer edges of the upper markers [m]: what a ruler checks a print by. A line
        to measure would be taken for a stroke."""
        return self.size[0] - 2 * self.margin

    @property
    def corners(self) -> dict[int, np.ndarray]:
        """id -> (4, 2) corners [m], from the upper left one clockwise."""
        near, far = self.margin, self.margin + self.side
        width, height = self.size
        found = {}
        for number, (x, y) in enumerate(
            ((near, height - near), (width - far, height - near), (width - far, far), (near, far))
        ):
            s = self.side
            found[number] = np.array([(x, y), (x + s, y), (x + s, y - s), (x, y - s)])
        return found

    def layout(self) -> dict:
        """What `--markers` reads; see MarkerLayout in docs/formats.md."""
        return {
            "paper_size_m": list(self.size),
            "marker_side_m": self.side,
            "dictionary": "DICT_4X4_50",
            "marker_corners_m": {
                str(number): np.round(corners, 9).tolist()
                for number, corners in self.corners.items()
            },
        }

    @needed_extras()
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write markers.pdf (true size), markers.png (300 dots per inch) and layout.json."""
        folder = Path(folder)
        figure = self._drawn()
        return [
            write_atomically(
                # Without the time, so that the same sheet is the same file.
                folder / "markers.pdf",
                lambda f: figure.savefig(f, format="pdf", metadata={"CreationDate": None}),
                "wb",
            ),
            write_figure(folder / "markers.png", figure, 300),
            write_json(folder / "layout.json", self.layout()),
        ]

    def _drawn(self):
        import cv2
        from matplotlib.figure import Figure
        from matplotlib.patches import Rectangle

        width, height = self.size
        figure = Figure(figsize=(width / _INCH, height / _INCH), facecolor="white")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.set_axis_off()
        book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        cell = self.side / _CODE
        for number, corners in self.corners.items():
            code = cv2.aruco.generateImageMarker(book, number, _CODE)
            left, top = corners[0]
            for row, column in np.argwhere(code == 0):
                axes.add_patch(
                    Rectangle(
                        (left + column * cell, top - (row + 1) * cell), cell, cell,
                        color="black", linewidth=0, antialiased=False,
                    )
                )  # fmt: skip
        return figure
