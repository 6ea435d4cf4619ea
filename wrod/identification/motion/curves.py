"""Curves through the markers of a rod, and their lengths."""

import numpy as np
from scipy.interpolate import CubicSpline

# Pieces between two markers of a curve whose length is wanted.
_FINE = 8


def spline_lengths(position: np.ndarray) -> np.ndarray:
    """(..., M - 1) arc lengths between markers of the curves through (..., M, 3)."""
    return _lengths(through_markers(position, _FINE))


def _lengths(nodes: np.ndarray) -> np.ndarray:
    """(..., M - 1) lengths between markers of curves of `_FINE` pieces."""
    pieces = np.linalg.norm(np.diff(nodes, axis=-2), axis=-1)
    inner = pieces[..., 1:-1]
    inner = inner.reshape(*inner.shape[:-1], -1, _FINE).sum(axis=-1)
    return np.concatenate([pieces[..., :1], inner, pieces[..., -1:]], axis=-1)


def _running(lengths: np.ndarray) -> np.ndarray:
    """(M,) arc lengths out of (..., M - 1) pieces, their mean."""
    mean = lengths.reshape(-1, lengths.shape[-1]).mean(axis=0)
    return np.concatenate([[0.0], np.cumsum(mean)])


def through_markers(position: np.ndarray, fine: int, s: np.ndarray | None = None) -> np.ndarray:
    """Curves through markers: cubic splines that leave the grips along the lines through their
    markers, `fine` pieces of equal parameter between neighbours; inside the grips straight.

    Args:
        position: (..., M, 3), complex where they carry a derivative.
        s: (M,) arc lengths of the markers; default: the mean chords.

    Returns:
        (..., (M - 3) fine + 3, 3) points.
    """
    x = np.asarray(position)
    if s is None:
        # By its chords a strongly bent curve would run too fast where its direction is given.
        s = _running(np.linalg.norm(np.diff(x, axis=-2), axis=-1))
        s = _running(_lengths(through_markers(x, _FINE, s)))
    ends = [x[..., 1, :] - x[..., 0, :], x[..., -1, :] - x[..., -2, :]]
    first, last = (e / np.sqrt(np.sum(e * e, axis=-1, keepdims=True)) for e in ends)
    inner = s[1:-1]
    u = np.interp(np.arange((len(inner) - 1) * fine + 1) / fine, np.arange(len(inner)), inner)

    def curve(part):
        slopes = ((1, part(first)), (1, part(last)))
        return CubicSpline(inner, part(x)[..., 1:-1, :], axis=x.ndim - 2, bc_type=slopes)(u)

    between = curve(np.real) + (1j * curve(np.imag) if np.iscomplexobj(x) else 0.0)
    return np.concatenate([x[..., :1, :], between, x[..., -1:, :]], axis=-2)
