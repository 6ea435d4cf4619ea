"""Rods of recorded motion as a batch: where a window's rod is held, and its first two
configurations, for models with offsets.

What takes setups is analytic, so that complex ones carry a parameter's derivative through.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from wrod.identification.motion.curves import through_markers
from wrod.identification.motion.setup import MotionSetup
from wrod.identification.motion.windows import Windows
from wrod.rods.batch import RodBatch
from wrod.rods.rotation import carried, unit


def rods_on_mesh(
    values: dict[str, np.ndarray],
    position: np.ndarray,
    director: np.ndarray,
    point_load: np.ndarray,
    device: str,
    **own,
) -> RodBatch:
    """A batch of rods that are alike.

    Args:
        values: as of `MotionSetup.arrays`, real.
        position, director, point_load, own: as `RodBatch` takes them; weight is a point load, for
            it and other forces per mass may change along the rod.
    """
    stiffness, rest = values["stiffness"], values["rest_strain"]
    return RodBatch(
        position,
        stretching_stiffness=values["stretching"],
        bending_stiffness=stiffness[None, :, :2],
        twisting_stiffness=stiffness[:, 2],
        natural_curvature=rest[:, :2],
        natural_twist=rest[:, 2],
        softening=values["softening"],
        inelastic=values["inelastic"],
        point_load=point_load,
        director=director,
        device=device,
        **own,
    )


def held_ends(windows: Windows, setup: MotionSetup, substeps: int) -> tuple[np.ndarray, ...]:
    """(W, K', 4, 3) held nodes, (W, K', 2, 3) tangents of the grips, material directors m1 and
    principal directors of bending there, at every time step; complex if the setup is."""
    w, fine = windows, substeps
    held, director = w.held, w.grip_director
    if fine > 1:
        held, director = _refine(held, fine), _refine(director, fine)
    near, far = held[:, :, [0, 2]], held[:, :, [1, 3]]
    t = unit(far - near)
    m1 = unit(director - np.sum(director * t, axis=-1, keepdims=True) * t)
    m2 = np.cross(t, m1)
    offset = setup.marker_offset[[0, 1, -2, -1]]
    turn = setup.held_turn
    nodes = np.stack([near[:, :, 0], far[:, :, 0], near[:, :, 1], far[:, :, 1]], axis=2)
    nodes = nodes.astype(complex)
    # The material frame in the grip, turned by its roll.
    c, s = np.cos(setup.roll)[:, None], np.sin(setup.roll)[:, None]
    a1, a2 = c * m1 + s * m2, -s * m1 + c * m2
    for k in range(4):
        e = k // 2
        o = offset[k]
        nodes[:, :, k] -= o[0] * a1[:, :, e] + o[1] * a2[:, :, e] + o[2] * t[:, :, e]
    # The outer node swings about the inner one.
    for e, outer, inner in ((0, 0, 1), (1, 3, 2)):
        arm = nodes[:, :, outer] - nodes[:, :, inner]
        axis = turn[e, 0] * m1[:, :, e] + turn[e, 1] * m2[:, :, e]
        nodes[:, :, outer] = nodes[:, :, inner] + arm + np.cross(axis, arm)
    c, s = np.cos(setup.principal_angle), np.sin(setup.principal_angle)
    return nodes, t, a1, c * a1 + s * a2


def moves_ends(setup: MotionSetup) -> bool:
    """Whether a complex setup's parameter moves held or first nodes at all."""
    s = setup
    parts = (s.marker_offset, s.held_turn, s.roll, s.principal_angle)
    return any(np.any(np.imag(part)) for part in parts)


def first_nodes(
    windows: Windows, setup: MotionSetup, substeps: int, ends: tuple[np.ndarray, ...]
) -> np.ndarray:
    """(W, 2, N, 3) nodes in the first two frames, held ones included; `ends`: of `held_ends`."""
    markers = windows.opening.astype(complex)
    nodes, _, a1, _ = ends
    inner = setup.marker_node
    if np.any(setup.marker_offset != 0):
        centre = _without_offsets(setup, markers, a1, substeps)
    else:
        centre = markers
    fine = int(inner[2] - inner[1])
    grips = nodes[:, [0, substeps]]
    centre = np.concatenate([grips[:, :, :2], centre[:, :, 2:-2], grips[:, :, 2:]], axis=2)
    return through_markers(centre, fine, windows.arc_length[0])


def _without_offsets(setup, markers, a1, substeps: int) -> np.ndarray:
    """Markers moved back to the centreline with frames that twist evenly between the grips."""
    out = markers.copy()
    t = markers[:, :, 2:] - markers[:, :, :-2]
    t = unit(np.concatenate([markers[:, :, 1:2] - markers[:, :, :1], t,
                              markers[:, :, -1:] - markers[:, :, -2:-1]], axis=2))  # fmt: skip
    for f, step in ((0, 0), (1, substeps)):
        d = carried(a1[:, step, 0], t[:, f])
        end = a1[:, step, 1]
        y = np.sum(np.cross(d[:, -1], end) * t[:, f, -1], axis=-1)
        x = np.sum(d[:, -1] * end, axis=-1)
        twist = np.arctan2(np.real(y), np.real(x)) + 1j * (
            np.imag(y) * np.real(x) - np.imag(x) * np.real(y)
        ) / (np.real(x) ** 2 + np.real(y) ** 2)
        angle = twist[:, None] * (np.arange(t.shape[2]) / (t.shape[2] - 1))
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        m1 = c * d + s * np.cross(t[:, f], d)
        m2 = np.cross(t[:, f], m1)
        o = setup.marker_offset
        out[:, f] -= o[:, :1] * m1 + o[:, 1:2] * m2 + o[:, 2:] * t[:, f]
    return out


def _refine(values: np.ndarray, fine: int) -> np.ndarray:
    """(W, K, ...) values at `fine` times as many instants, by cubic splines."""
    k = np.arange(values.shape[1])
    return CubicSpline(k, values, axis=1)(np.arange((len(k) - 1) * fine + 1) / fine)
