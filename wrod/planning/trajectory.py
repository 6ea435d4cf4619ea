"""Trajectories of the grip: what a plan returns and what robots, scenes and simulations take."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from wrod.arguments import checked, number, shown
from wrod.errors import DataError, RodError
from wrod.files import (
    check_arrays,
    decode_labels,
    read_fields,
    schemas,
    suffixed,
    write_csv,
    write_npz,
)
from wrod.records import brief, freeze, plain
from wrod.rods.model import Rod
from wrod.rods.model_file import rod_of_json

_FORMAT = "wrod-trajectory-1"
_ARRAYS = (
    "arc_length", "contact", "position", "rotation", "force", "roll", "beyond_grip", "shape",
    "twist",
)  # fmt: skip
# Of every node.
_ROWS = [name for name in _ARRAYS if name not in ("roll", "beyond_grip")]
# A grip jumps where it goes so many times as far for the rod that it lays as two poses before and
# after; plans of sharp bends, and of few poses, come to 6. None of what is shorter is a jump [m],
# and a grip that hardly moves beside it counts as one that goes as far as the contact. Fewer ways
# than that from pose to pose say nothing of what is usual.
_JUMP, _NO_JUMP, _USUAL, _FEWEST = 10.0, 0.05, 1.0, 6
# How far a grip may be below the table, or beyond what hangs, by corrections and rounding [m], and
# how much a rod may be stretched [-].
_BELOW, _STRETCHED = 0.01, 1.05


@brief
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Grip poses of a deployment, one per contact node. SI units, z up.

    Arrays are read-only copies, so that what was checked stays as it was; SciPy's `Rotation.apply`
    wants a copy of them that can be written to (`position.copy()`).

    Attributes:
        arc_length: (T,) length of rod that lies on the table, from 0 and including a remainder [m].
        contact: (T, 3) contact point between laid and suspended part [m].
        position: (T, 3) grip position [m].
        rotation: (T, 3, 3) grip frame in world coordinates; its first column is the rod's tangent
            at the grip, pointing out of the suspended part (Alg. OPT: R_t R).
        force: (T, 3) force of the table on the suspended rod at the contact, world frame [N];
            NaN where the method does not compute it.
        metadata: what made the plan (method, closure, rod, pattern, ...); plain JSON values.
        shape: (T, nodes, 3) centrelines of the suspended part from contact to grip [m], or None
            where the method does not compute them; saved in the NPZ file only. Those of a corrected
            plan are moved with the grip, no equilibria: their length is off by as much.
        twist: (T,) angle by which the rod is twisted between contact and grip [rad], or None where
            it is not; whole turns count, which `rotation` cannot tell. In the NPZ file only.
        roll: that the rod is put into the grip at: of its first material director where it begins,
            from left towards up [rad].
        beyond_grip: length of the rod that hangs from the grip on its other side [m]; `rod` ends at
            the grip, so that the whole one is longer by this (`wrod.planning.hold.as_held`).

    Raises:
        DataError: an array is not as docs/formats.md has it of a trajectory's file.
    """

    arc_length: np.ndarray
    contact: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    force: np.ndarray
    metadata: dict = field(default_factory=dict)
    shape: np.ndarray | None = None
    twist: np.ndarray | None = None
    roll: float = 0.0
    beyond_grip: float = 0.0

    def __post_init__(self):
        given = {name: getattr(self, name) for name in _ARRAYS} | {"format": _FORMAT}
        present = {name: value for name, value in given.items() if value is not None}
        object.__setattr__(self, "metadata", plain(self.metadata, "Trajectory: metadata"))
        for name in ("remainder_length", "spin"):
            if wrong := number()(self.metadata.get(name, 0.0)):
                said = shown(self.metadata[name])
                raise DataError(f"Trajectory: metadata: {name} is {said}; it {wrong}")
        freeze(self, check_arrays(present, "Trajectory", "Trajectory"))

    def __len__(self) -> int:
        return len(self.arc_length)

    @property
    def rod(self) -> Rod | None:
        """The rod that was planned for, as far as the grip; None where `metadata` does not say."""
        content = self.metadata.get("rod")
        return rod_of_json(content) if isinstance(content, dict) else None

    @property
    def method(self) -> str | None:
        """What computed the grips, as `wrod.plan` names it; None where `metadata` does not say."""
        return self.metadata.get("method")

    @property
    def remainder_length(self) -> float:
        """Length that is laid before the pattern [m]."""
        return float(self.metadata.get("remainder_length", 0.0))

    @property
    def spin(self) -> float:
        """By how much more the hand has turned about the rod at the last node than at the first,
        see `wrod.plan` [rad]."""
        return self.metadata.get("spin", 0.0)

    @property
    def closure(self) -> str | None:
        """What the grasps' one freedom was used for; None for a path without grasps."""
        return self.metadata.get("closure")

    @property
    def natural_share(self) -> float:
        """Least share of its natural curvature that the rod had in a grasp; see `wrod.plan`."""
        return self.metadata.get("natural_share", 1.0)

    @property
    def optimised(self) -> dict | None:
        """How the path was corrected for a table (`wrod.deployment.optimise`), if it was."""
        return self.metadata.get("optimised")

    @property
    def expected(self) -> dict | None:
        """What it is to be expected to do on a table, if known; see
        `wrod.deployment.expectation.expect`."""
        return self.metadata.get("expected")

    @property
    def pattern_arc_length(self) -> np.ndarray:
        """(T,) the pattern's own arc length at the contact [m]; negative on the remainder."""
        return self.arc_length - self.remainder_length

    @checked(DataError)
    def save(self, path: str | os.PathLike[str]) -> list[Path]:
        """Write `path` as CSV and NPZ (either suffix of `path` is replaced). Returns both paths.

        Raises:
            DataError: `path` names no file, or the metadata is not plain.
        """
        csv = suffixed(path, ".csv")
        columns = ["arc_length [m]"]
        columns += [f"{name}_{axis} [m]" for name in ("contact", "position") for axis in "xyz"]
        columns += [f"rotation_{i}{j} [-]" for i in "xyz" for j in "xyz"]
        columns += [f"force_{axis} [N]" for axis in "xyz"]
        turned = self.rotation.reshape(len(self), 9)
        rows = np.column_stack([self.arc_length, self.contact, self.position, turned, self.force])
        told = {**self.metadata, "beyond_grip": self.beyond_grip}
        try:
            metadata, head = (json.dumps(one, sort_keys=True) for one in (self.metadata, told))
        except (TypeError, ValueError, RecursionError) as reason:
            raise DataError(f"the trajectory's metadata cannot be JSON: {reason}") from None
        values = {name: getattr(self, name) for name in _ARRAYS}
        present = {name: value for name, value in values.items() if value is not None}
        said = [[f"{value:.12g}" for value in row] for row in rows]
        return [
            write_csv(csv, columns, said, f"{_FORMAT} {head}"),
            write_npz(
                suffixed(path, ".npz"), format=_FORMAT, units="SI: m, N", metadata=metadata,
                **present,
            ),
        ]  # fmt: skip

    @classmethod
    @checked(DataError)
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a trajectory's NPZ file.

        Raises:
            DataError: the file is missing, truncated or not a trajectory, or its grip jumps, is
                below the table, or farther from the contact than rod hangs there.
        """
        data = read_fields(path, "Trajectory")
        label, what = data.pop("metadata", "{}"), "the metadata of a trajectory"
        metadata = decode_labels(label, schemas.TrajectoryMetadata, f"{path}: metadata", what)
        # Earlier versions kept these in the metadata.
        for name in ("roll", "beyond_grip"):
            data.setdefault(name, float(metadata.pop(name, 0.0)))
        loaded = cls(**data, metadata=metadata)
        try:
            _ = loaded.rod
        except RodError as reason:
            raise DataError(f"{path}: metadata: rod: {reason}; plan it again") from None
        _refuse_jumps(loaded, path)
        _refuse_out_of_reach(loaded, path)
        return loaded


def part_of(trajectory: Trajectory, nodes: slice | np.ndarray) -> Trajectory:
    """The trajectory at some of its nodes."""
    rows = {name: getattr(trajectory, name) for name in _ROWS}
    return replace(trajectory, **{k: v[nodes] for k, v in rows.items() if v is not None})


def followed_by(trajectory: Trajectory, **rows: np.ndarray) -> Trajectory:
    """The trajectory with arrays of further nodes behind its own."""
    joined: dict[str, Any] = {
        k: np.concatenate([getattr(trajectory, k), v]) for k, v in rows.items()
    }
    return replace(trajectory, **joined)


def out_of_reach(trajectory: Trajectory) -> np.ndarray:
    """(T,) whether no rod that hangs from the grip can touch down at a pose."""
    way = trajectory.position - trajectory.contact
    wrong, rod = way[:, 2] < -_BELOW, trajectory.rod
    if rod is not None:
        hangs = rod.length - trajectory.arc_length
        wrong |= np.linalg.norm(way, axis=1) > _STRETCHED * hangs + _BELOW
    return wrong


def _refuse_out_of_reach(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    wrong = out_of_reach(trajectory)
    if wrong.any():
        k = int(np.argmax(wrong))
        way = trajectory.position[k] - trajectory.contact[k]
        raise DataError(
            f"{path}: position: contact node {k}: the grip is {np.linalg.norm(way):.3g} m from "
            f"the contact and {way[2]:.3g} m above the table, where no such rod hangs; plan it "
            "again"
        )


def _refuse_jumps(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Refuse a grip that goes much farther from a pose to the next than paths do there."""
    way = np.linalg.norm(np.diff(trajectory.position, axis=0), axis=1)
    rate = way / np.diff(trajectory.arc_length)
    if len(rate) < _FEWEST:
        return
    # A wrong pose has a jump before it and one behind.
    beside = np.pad(rate, 2)
    usual = np.maximum(np.maximum(beside[:-4], beside[4:]), _USUAL)
    wrong = np.flatnonzero((rate > _JUMP * usual) & (way > _NO_JUMP))
    if len(wrong):
        k = int(wrong[0])
        laid = trajectory.arc_length[k + 1] - trajectory.arc_length[k]
        raise DataError(
            f"{path}: position: contact node {k + 1}: the grip jumps there, by {way[k]:.3g} m "
            f"while {1e3 * laid:.3g} mm of rod are laid; plan it again"
        )
