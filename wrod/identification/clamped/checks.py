"""Can these numbers be a rod between two clamps? What cannot be right is named in one sentence."""

from dataclasses import replace

import numpy as np

from wrod.errors import DataError
from wrod.identification.clamped.measurements import ClampedMeasurements
from wrod.rods.material import RodMaterial

# A measured shape further from its clamps than this many free lengths is not that rod in metres.
_FAR = 0.5
# Over the free length: nearer no shape is solved, and squares of what lies between an effect's size
# and such a noise leave double precision.
_LEAST_NOISE = 1e-7


def check_rod(rod: RodMaterial, noise: float, where: str) -> None:
    """Radius, lengths and noise against each other: units.

    Raises:
        DataError: one of them is not in metres, or the noise is less than any measurement's.
    """
    if noise < _LEAST_NOISE * rod.length:
        raise DataError(
            f"{where}: noise_std {noise:g} is under a ten-millionth of the rod, which no "
            "measurement tells; give the standard deviation of the markers in metres"
        )
    if rod.radius > 0.1 * rod.length:
        raise DataError(
            f"{where}: radius {rod.radius:g} m is over a tenth of the free length "
            f"{rod.length:g} m; metres (millimetres?)"
        )
    if noise > 0.1 * rod.length:
        raise DataError(
            f"{where}: noise_std {noise:g} is over a tenth of the rod; metres (millimetres?)"
        )


def checked_geometry(m: ClampedMeasurements, where: str) -> ClampedMeasurements:
    """Poses and markers of every trial; a marker that is too far from the others of its trial, the
    only one there, is one that was not seen.

    Raises:
        DataError: the sentence names the field, the trial and the markers.
    """
    given, m = m, replace(m, centerline=_filled(m.centerline, m.arc_length))
    length, s = m.material.length, m.arc_length
    steps = np.diff(s)
    if len(s) < 3 or not (steps > 0).all():
        raise DataError(f"{where}: arc_length must grow from marker to marker, 3 or more markers")
    if s[-1] - s[0] < 0.1 * length:
        raise DataError(
            f"{where}: arc_length spans {s[-1] - s[0]:g} of a free length of {length:g}; give "
            "markers along the rod, metres everywhere"
        )
    if s[0] < -1e-6 * length or s[-1] > (1 + 1e-6) * length:
        raise DataError(
            f"{where}: arc_length runs from {s[0]:g} to {s[-1]:g}, outside the free length "
            f"{length:g}; metres everywhere?"
        )
    _check_scale(m, where)
    _check_ends(m, where)
    mistaken = _mistaken(m, where)
    m.centerline[mistaken] = np.nan
    _check_directions(replace(m, centerline=_filled(m.centerline, m.arc_length)), where)
    return replace(given, centerline=np.where(mistaken[..., None], np.nan, given.centerline))


def _filled(centerline: np.ndarray, arc_length: np.ndarray) -> np.ndarray:
    """(T, M, 3) markers with those not seen on the line between their neighbours."""
    out = centerline.copy()
    for trial in np.flatnonzero(~np.isfinite(out).all(axis=(1, 2))):
        seen = np.isfinite(out[trial]).all(axis=1)
        for axis in range(3):
            known = out[trial, seen, axis]
            out[trial, :, axis] = np.interp(arc_length, arc_length[seen], known)
    return out


def _check_scale(m: ClampedMeasurements, where: str) -> None:
    """Length of the polygon through the markers against their arc length: units."""
    span = m.arc_length[-1] - m.arc_length[0]
    polygon = np.linalg.norm(np.diff(m.centerline, axis=1), axis=2).sum(axis=1)
    ratio = np.median(polygon) / span
    if ratio > 100 or ratio < 0.01:
        raise DataError(
            f"{where}: centerline measures {np.median(polygon):.4g} along markers that span "
            f"{span:.4g} of arc length; both must be in metres (millimetres?)"
        )
    chord = np.linalg.norm(m.grip_position - m.clamp_position, axis=1)
    worst = int(np.argmax(chord))
    if chord[worst] > 1.2 * m.material.length:
        raise DataError(
            f"{where}: in trial {worst} the clamps are {chord[worst]:.4g} apart, more than the "
            f"free length {m.material.length:g}; metres everywhere?"
        )


def _check_ends(m: ClampedMeasurements, where: str) -> None:
    """Do the first and last markers lie near their own clamps?"""
    ends = (m.centerline[:, 0], m.centerline[:, -1])
    slack = (m.arc_length[0], m.material.length - m.arc_length[-1])
    poses = (m.clamp_position, m.grip_position)
    own = np.stack([np.linalg.norm(e - p, axis=1) for e, p in zip(ends, poses, strict=True)])
    other = np.stack(
        [np.linalg.norm(e - p, axis=1) for e, p in zip(ends, poses[::-1], strict=True)]
    )
    limit = 0.1 * m.material.length + np.array(slack)[:, None] + 6 * m.noise
    exchanged = (own > limit).all(axis=0) & (other < limit).all(axis=0)
    if exchanged.any():
        raise DataError(
            f"{where}: in trial {np.argmax(exchanged)} the first marker is at the gripper and the "
            "last at clamp A; the clamps, or the order of the markers, are exchanged"
        )
    far = own > _FAR * m.material.length + np.array(slack)[:, None]
    if far.any():
        end, trial = np.argwhere(far)[0]
        raise DataError(
            f"{where}: in trial {trial} the {('first', 'last')[end]} marker is "
            f"{own[end, trial]:.3g} m from its clamp; are poses and markers in one frame?"
        )


def _check_directions(m: ClampedMeasurements, where: str) -> None:
    """Does the rod leave its clamps along their tangents?"""
    length = m.material.length
    slack = max(m.arc_length[0], length - m.arc_length[-1])
    step = int(np.argmax(m.arc_length - m.arc_length[0] >= 0.03 * length))
    if slack > 0.05 * length:
        return
    ends = (
        m.centerline[:, step] - m.centerline[:, 0],
        m.centerline[:, -1] - m.centerline[:, -1 - step],
    )
    tangents = (m.clamp_rotation[:, :, 2], m.grip_rotation[:, :, 2])

    def cosines(pairs):
        return np.stack([np.sum(e * t, axis=1) / np.linalg.norm(e, axis=1) for e, t in pairs])

    own = cosines(zip(ends, tangents, strict=True))
    other = cosines(zip(ends, tangents[::-1], strict=True))
    exchanged = (own < 0.7).all(axis=0) & (other > 0.9).all(axis=0)
    if exchanged.any():
        raise DataError(
            f"{where}: in trial {np.argmax(exchanged)} the rod leaves each clamp along the tangent "
            "of the other; the rotations of the clamps are exchanged"
        )
    against = own < -0.5
    if against.any():
        end, trial = np.argwhere(against)[0]
        raise DataError(
            f"{where}: in trial {trial} the rod runs against the tangent of "
            f"{('clamp_rotation', 'grip_rotation')[end]}; tangents point along growing arc length"
        )


def _mistaken(m: ClampedMeasurements, where: str) -> np.ndarray:
    """(T, M) the marker of a trial without which no two are further apart than the rod between them
    is long.

    Raises:
        DataError: two markers are swapped, or more than one is mistaken.
    """
    excess = _excess(m, m.centerline)
    found = np.zeros(excess.shape[:2], dtype=bool)
    first, second = np.triu_indices(len(m.arc_length), 1)
    pair = np.arange(len(first))
    for trial in np.flatnonzero((excess > 0).any(axis=(1, 2))):
        swapped = np.repeat(m.centerline[trial][None], len(first), axis=0)
        swapped[pair, first] = m.centerline[trial, second]
        swapped[pair, second] = m.centerline[trial, first]
        best = int(np.argmin(np.linalg.norm(np.diff(swapped, axis=1), axis=2).sum(axis=1)))
        if (_excess(m, swapped[best : best + 1]) <= 0).all():
            raise DataError(
                f"{where}: in trial {trial} markers {first[best]} and {second[best]} are swapped"
            )
        worst = int(np.argmax(np.maximum(excess[trial], 0.0).sum(axis=1)))
        rest = np.delete(np.delete(excess[trial], worst, axis=0), worst, axis=1)
        if (rest > 0).any():
            raise DataError(
                f"{where}: in trial {trial} markers are further apart than the rod between them, "
                f"most of all marker {worst}; it is mistaken or several are swapped"
            )
        found[trial, worst] = True
    return found


def _excess(m: ClampedMeasurements, centerline: np.ndarray) -> np.ndarray:
    """(..., M, M) how much too far apart markers are [m]."""
    rod = np.abs(m.arc_length[:, None] - m.arc_length[None])
    distance = np.linalg.norm(centerline[:, :, None] - centerline[:, None], axis=-1)
    # 15 % of room for stretch and for a scale error of the cameras, which is for the fit to find.
    return distance - 1.15 * rod - 25.0 * m.noise
