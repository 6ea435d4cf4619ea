"""Patterns: the planar curves along which a rod is laid (paper, Sec. Motion Planning)."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly

from wrod import arguments
from wrod.errors import PatternError
from wrod.patterns import drawings
from wrod.patterns.corners import distance_from_lines, find_corners, heading_with_corners
from wrod.patterns.curve import heading_of_curve, integrate_heading, lead_in
from wrod.patterns.expressions import compile_expression, value_of
from wrod.patterns.files import (
    RawPoints,
    checked_points,
    read_points,
    refuse_spikes,
    unit_scale,
    write_points,
)
from wrod.patterns.smoothing import fit_heading
from wrod.records import frozen

# Of a bend as wide as the thinnest fibre [1/m].
_SHARPEST = 1e6


class Pattern:
    """A smooth curve in a horizontal plane, parametrised by its arc length s [m].

    s = 0 is the first point of what was drawn. A remainder (`with_remainder`) is laid before it
    and has negative s, so the pattern runs over [-remainder_length, length].

    Attributes:
        name: what to call it in pictures.
        source: what to call it in messages: the file that it was read from, or its name.
        points: (n, 3) points that it was made from [m], or None for a closed form.
        noise: estimated standard deviation of these points across the curve [m].
    """

    @arguments.checked(
        PatternError,
        heading=arguments.like("a scipy.interpolate.PPoly", "c", "x", "antiderivative"),
        origin=arguments.array((2,)),
        height=arguments.number(),
        points=arguments.optional(arguments.array((None, 3))),
        noise=arguments.number(0.0),
    )
    def __init__(
        self,
        heading: PPoly,
        origin: np.ndarray,
        *,
        name: str = "pattern",
        source: str | None = None,
        height: float = 0.0,
        points: np.ndarray | None = None,
        noise: float = 0.0,
    ):
        self.name, self.noise = name, noise
        self.points = None if points is None else frozen(np.asarray(points, float))
        self.source = name if source is None else source
        if heading.c.ndim != 2 or not np.isfinite(heading.c).all():
            raise PatternError(f"{self.source}: heading must be of finite numbers, one for each s")
        self._heading = PPoly(heading.c.copy(), heading.x.copy())
        self._origin, self._height = frozen(np.asarray(origin, float)), float(height)
        self._position = integrate_heading(heading, self._origin)
        s, curvature = self.sharpest()
        if not abs(curvature) <= _SHARPEST:
            raise PatternError(
                f"{self.source}: has a curvature of {curvature:.3g} 1/m at s = {s:.4g} m, which no "
                "rod follows; smooth it or check its units"
            )

    @classmethod
    @arguments.checked(
        PatternError,
        smoothing=arguments.optional(arguments.number(0.0, 100.0)),
        stroke=arguments.optional(arguments.whole(1)),
    )
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        units: str | None = None,
        smoothing: float | None = None,
        name: str | None = None,
        layer: str | None = None,
        stroke: int | None = None,
    ) -> Pattern:
        """Pattern from a file of points: text or CSV (one point a line), NPY or NPZ ('points'), or
        from a vector drawing: SVG or DXF.

        A header line may name the columns (x, y, z) and the units (`units: mm`, `x [mm]`); lines
        that begin with # or % are comments. Coordinates are metres unless a unit is named.

        Args:
            path: the file.
            units: m, cm, mm, um or in; must agree with the header's.
            smoothing: as in `from_points`.
            name: defaults to the file's stem.
            layer, stroke: of a drawing that holds several (see `drawings.read_drawing`).

        Raises:
            PatternError: names the file, and the line or point where there is one.
        """
        if Path(path).suffix.lower() in drawings.SUFFIXES:
            raw = drawings.read_drawing(Path(path), units, layer, stroke)
            level = drawings.EXACT if smoothing is None else smoothing
            return cls._from_raw(raw, "m", level, name or Path(path).stem)
        if layer is not None or stroke is not None:
            raise PatternError(f"{path}: layers and strokes belong to SVG and DXF drawings")
        raw = read_points(path)
        return cls._from_raw(raw, units, smoothing, name or Path(path).stem)

    @classmethod
    @arguments.checked(
        PatternError,
        points=arguments.array(finite=False),
        smoothing=arguments.optional(arguments.number(0.0, 100.0)),
    )
    def from_points(
        cls,
        points: ArrayLike,
        *,
        units: str = "m",
        smoothing: float | None = None,
        name: str = "pattern",
        traced: bool = False,
    ) -> Pattern:
        """Pattern along points in deployment order.

        Args:
            points: (n, 2) or (n, 3), n >= 2, all at one height.
            units: m, cm, mm, um or in.
            smoothing: standard deviation of the points' noise [m]; None estimates it from the
                points by generalised cross-validation, 0 interpolates them.
            name: what to call the pattern.
            traced: the points sample one unbroken line that was seen, so that a sharp turn is the
                line's own and no slip of a point.

        Raises:
            PatternError: not finite, fewer than 3 distinct points, repeated, not planar, unknown
                units, or a spike of curvature; names the point.
        """
        raw = RawPoints(np.asarray(points, dtype=float), name)
        return cls._from_raw(raw, units, smoothing, name, traced)

    @classmethod
    def _from_raw(
        cls,
        raw: RawPoints,
        units: str | None,
        smoothing: float | None,
        name: str,
        traced: bool = False,
    ) -> Pattern:
        points = checked_points(raw, units)
        corners = find_corners(points[:, :2])
        if not traced:
            refuse_spikes(points, raw, corners)
        if len(corners):
            heading, origin, noise = heading_with_corners(points[:, :2], corners, smoothing)
        else:
            heading, origin, noise = fit_heading(points[:, :2], smoothing)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        far = int(steps.argmax())
        if heading.x[-1] > 100.0 * steps.sum() and steps[far] > 20.0 * np.median(steps):
            raise PatternError(
                f"{raw.where(far + 1)}: is {steps[far]:.3g} m from the point before it, where "
                f"others are {np.median(steps):.3g} m apart; give points between the two"
            )
        return cls(
            heading,
            origin,
            name=name,
            source=raw.source,
            height=float(points[0, 2]),
            points=points,
            noise=noise,
        )

    @classmethod
    @arguments.checked(
        PatternError,
        expressions=arguments.several(arguments.either(arguments.text, arguments.callback)),
        start=arguments.number(-1e9, 1e9),
        stop=arguments.number(-1e9, 1e9),
    )
    def from_expression(
        cls,
        *expressions: str | Callable[[np.ndarray], np.ndarray],
        start: float,
        stop: float,
        units: str = "m",
        name: str = "expression",
    ) -> Pattern:
        """Pattern of a closed form: y(x), or x(t) and y(t).

        Args:
            expressions: one expression in x, such as "0.04*sin(20*x)", or two in t; or Python
                functions of an array. Text is read as arithmetic only, never run as code.
            start, stop: range of x or t, in deployment order.
            units: unit of the values.
            name: what to call the pattern.

        Raises:
            PatternError: the expression is not understood or not finite on the range.
        """
        scale = unit_scale(units, name)
        if len(expressions) not in (1, 2):
            raise PatternError("give one expression y(x), or two: x(t) and y(t)")
        if not (np.isfinite(start) and np.isfinite(stop) and start != stop):
            raise PatternError(f"range {start!r} to {stop!r} is empty; give two finite numbers")
        variable = "x" if len(expressions) == 1 else "t"
        parts = [
            part if callable(part) else compile_expression(part, variable) for part in expressions
        ]

        def curve(t):
            t = np.asarray(start + (stop - start) * t, dtype=float)
            values = [
                arguments.spread(value_of(part, t, name), t.shape, name, PatternError)
                for part in parts
            ]
            if not np.all(np.isfinite(values)):
                raise PatternError(f"{name}: has no finite value everywhere in {start} to {stop}")
            x, y = values if len(values) == 2 else (t, values[0])
            return scale * x, scale * y

        x, y = curve(np.linspace(0.0, 1.0, 4001))
        steps = np.hypot(np.diff(x), np.diff(y))
        if np.any(steps <= 0.0):
            raise PatternError(f"{name}: stands still on part of {start} to {stop}")
        if not 1e-4 <= steps.sum() <= 1e3:
            raise PatternError(
                f"{name}: is {steps.sum():.3g} m long; a pattern has 0.1 mm to 1 km, so check "
                "units and range"
            )
        return cls(*heading_of_curve(curve, 1.0), name=name)

    def __repr__(self) -> str:
        return f"<Pattern {self.name!r}, {self.length:.4g} m>"

    @property
    def length(self) -> float:
        """Length of the pattern itself, without a remainder [m]."""
        return float(self._heading.x[-1])

    @property
    def remainder_length(self) -> float:
        """Length of the remainder laid before s = 0 [m]; 0 if there is none."""
        return max(0.0, -float(self._heading.x[0]))

    def sharpest(self) -> tuple[float, float]:
        """Arc length [m] and signed curvature [1/m] of the tightest bend, where its
        pieces meet and at 2001 points between."""
        knots = self._heading.x
        s = np.union1d(knots, np.linspace(knots[0], knots[-1], 2001))
        curvature = self._heading(s, nu=1)
        worst = int(np.argmax(np.abs(curvature)))
        return float(s[worst]), float(curvature[worst])

    def sample(self, s: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (n, 3) [m], unit tangent (n, 3) and signed curvature (n,) [1/m] at s (n,) [m].

        Curvature is positive where the pattern turns left, seen from above.

        Raises:
            PatternError: s is outside [-remainder_length, length].
        """
        s = self._checked(s)
        flat, angle = self._position(s), self._heading(s)
        position = np.column_stack([flat, np.full(len(s), self._height)])
        tangent = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(s))])
        return position, tangent, self._heading(s, nu=1)

    @arguments.checked(PatternError, order=arguments.whole(0, 2))
    def curvature_derivative(self, s: np.ndarray, order: int) -> np.ndarray:
        """d^order kappa / ds^order (n,) [1/m^(1 + order)] at s (n,) [m], order 0, 1 or 2."""
        return self._heading(self._checked(s), nu=1 + order)

    def _checked(self, s: ArrayLike) -> np.ndarray:
        s = np.atleast_1d(arguments.floats(s, f"{self.source}: s", PatternError))
        first, last = self._heading.x[0], self._heading.x[-1]
        slack = 1e-9 * (last - first)
        outside = ~((s >= first - slack) & (s <= last + slack))
        if s.ndim != 1 or np.any(outside):
            what = f"arc length {s[outside][0]:g} m" if s.ndim == 1 else f"an array of {s.shape}"
            raise PatternError(
                f"{self.source}: {what} is outside the pattern, which runs from {first:g} to "
                f"{last:g} m"
            )
        return np.clip(s, first, last)

    @arguments.checked(PatternError)
    def with_remainder(self, length: float) -> Pattern:
        """The pattern with a lead-in whose curvature grows smoothly from zero to its own.

        Joined with continuous position, tangent, curvature, and two derivatives of the curvature
        (paper, Sec. Accuracy), so that the free end needs little friction.

        Args:
            length: length of the remainder [m]; `wrod.plan` chooses one that suits the rod.

        Raises:
            PatternError: the length is not positive, or there is a remainder already.
        """
        if (own := self.remainder_length) > 0.0:
            raise PatternError(f"{self.source}: has a remainder of {own:g} m already")
        if arguments.number(above=0.0, high=1e3)(length) is not None:
            raise PatternError(
                f"remainder length is {arguments.shown(length)}; give a positive number of metres"
            )
        return self.redrawn(lead_in(self._heading, float(length)))

    def redrawn(self, heading: PPoly, **changed) -> Pattern:
        """The pattern with another heading, and with what else is `changed`."""
        kept: dict[str, Any] = {"origin": self._origin, "height": self._height}
        kept |= {name: getattr(self, name) for name in ("name", "source", "points", "noise")}
        return Pattern(heading, **kept | changed)

    def departure(self) -> tuple[float, float]:
        """How far the curve leaves the straight lines between the points that it was made from, or
        a point the curve [m], and at which arc length [m]; zeros for a closed form."""
        if self.points is None:
            return 0.0, 0.0
        s = np.linspace(0.0, self.length, 1500)
        points, curve = self.points[:, :2], self.sample(s)[0][:, :2]
        far, place = distance_from_lines(points, curve)
        missed, point = distance_from_lines(curve, points)
        if missed > far:  # taken for noise
            far, place = missed, int(((curve - points[point]) ** 2).sum(axis=1).argmin())
        return far, float(s[place])

    @arguments.checked(PatternError)
    def scaled(self, factor: float) -> Pattern:
        """The pattern drawn `factor` times as large, about its first point.

        Raises:
            PatternError: the factor is not a positive number.
        """
        if arguments.number(1e-9, 1e9)(factor) is not None:
            raise PatternError(f"size factor is {arguments.shown(factor)}; give a positive number")
        first = self._heading.x[0]
        powers = factor ** -np.arange(len(self._heading.c) - 1, -1, -1, dtype=float)
        points = None
        if self.points is not None:
            anchor = np.append(self._origin, self._height)
            points = anchor + factor * (self.points - anchor)
        s = first * factor + factor * (self._heading.x - first)
        heading = PPoly(self._heading.c * powers[:, None], s)
        return self.redrawn(heading, points=points, noise=self.noise * factor)

    def reversed(self) -> Pattern:
        """The pattern from its last point to its first.

        Raises:
            PatternError: it has a remainder, which leads in to its first point.
        """
        if self.remainder_length > 0.0:
            raise PatternError(f"{self.name}: has a remainder; reverse it before it gets one")
        x, widths = self._heading.x, np.diff(self._heading.x)
        terms, flipped = self._heading.c, np.empty_like(self._heading.c)
        # Each piece about its other end: Taylor's coefficients there, odd ones negated.
        for power in range(len(terms)):
            value = np.zeros_like(widths)
            for k, term in enumerate(terms[: len(terms) - power]):
                degree = len(terms) - 1 - k
                value = value + math.comb(degree, power) * term * widths ** (degree - power)
            flipped[len(terms) - 1 - power] = (-1) ** power * value
        flipped = flipped[:, ::-1]
        flipped[-1] += np.pi
        return self.redrawn(
            PPoly(flipped, x[-1] - x[::-1]),
            origin=self._position(x[-1]),
            points=None if self.points is None else self.points[::-1],
        )

    @arguments.checked(PatternError, spacing=arguments.number(1e-6, 1e3))
    def save(self, path: str | os.PathLike[str], spacing: float = 0.001) -> Path:
        """Write points along the pattern (without a remainder) as CSV that `load` reads, or raise a
        PatternError where `path` has the suffix of another kind of file."""
        s = np.linspace(0.0, self.length, max(int(np.ceil(self.length / spacing)), 8) + 1)
        return write_points(path, self.sample(s)[0], drawings.SUFFIXES)
