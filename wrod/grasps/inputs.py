"""Inputs of grasps and where their results go: NumPy, torch tensors or Warp arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import GraspError
from wrod.grasps.results import LIMITS
from wrod.kernels.grasping import closures
from wrod.kernels.grasping.inputs import find_outside
from wrod.rods.device import resolve_device

CLOSURES = {
    "zero_tension": int(closures.ZERO_TENSION),
    "min_force": int(closures.MIN_FORCE),
    "min_friction": int(closures.MIN_FRICTION),
}


@dataclass(frozen=True)
class GraspOptions:
    """How grasps are solved; what is not said here is in `wrod.solve_grasps`.

    Attributes:
        closure: its number.
        device: Warp's name of it.
        curvatures: whether `solve_general` gives those of the nodes, and its ends, as well.
    """

    closure: int
    device: str
    edge_count: int
    extrapolate: bool
    eigenvalues: bool
    shapes: bool
    threads: int | None
    progress: Callable[[int], object] | None
    curvatures: bool = False


def closure_number(closure: str) -> int:
    """Raises GraspError where there is none of that name."""
    if closure not in CLOSURES:
        raise GraspError(f"unknown closure {closure!r}; use one of {', '.join(CLOSURES)}")
    return CLOSURES[closure]


def whole_range(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(l_s, kappa, k_s): l_s uniform and log-uniform in 1...50, k_s log-uniform."""
    rng = np.random.default_rng(seed)
    short, long = count // 2, count - count // 2
    ls = np.concatenate([rng.uniform(1, 50, long), np.exp(rng.uniform(0, np.log(50), short))])
    kappa = rng.uniform(-3.5, 3.5, count)
    return ls, kappa, np.exp(rng.uniform(np.log(150), np.log(15000), count))


@dataclass(frozen=True)
class GraspArrays:
    """(l_s, kappa, k_s) on a device, (n,) float64 each.

    Attributes:
        arrays: the three, as Warp arrays; those of torch tensors share their memory.
        device: Warp's name of it.
        kind: "numpy", "torch" or "warp": what results are to be.
    """

    arrays: list[wp.array]
    device: str
    kind: str

    def __len__(self) -> int:
        return self.arrays[0].shape[0]

    @classmethod
    def of(cls, *inputs, device: arguments.DeviceLike = None) -> GraspArrays:
        """Inputs that broadcast to (n,). Of tensors or Warp arrays the device is theirs.

        Raises:
            GraspError: shapes, devices or types do not go together, or a value is not finite or
                outside `LIMITS`.
        """
        kinds = {_kind(value) for value in inputs} - {"number"}
        if len(kinds) > 1:
            raise GraspError(
                f"grasp inputs mix {' and '.join(sorted(kinds))} arrays; give one kind (and "
                "numbers)"
            )
        kind = (kinds or {"numpy"}).pop()
        if kind == "numpy":
            device = resolve_device(device)
            arrays = [
                wp.array(value, dtype=wp.float64, device=device) for value in check_inputs(*inputs)
            ]
            return cls(arrays, device, kind)
        arrays, place = _on_device(inputs, kind)
        if device is not None and device != "auto" and resolve_device(device) != place:
            raise GraspError(f"grasp inputs are on {place}, not on {device}")
        _check_on_device(arrays, place)
        return cls(arrays, place, kind)

    def numpy(self) -> list[np.ndarray]:
        return [a.numpy() for a in self.arrays]

    def result(self, array: wp.array):
        """An array of results as what the inputs were."""
        if self.kind == "numpy":
            return array.numpy()
        return wp.to_torch(array) if self.kind == "torch" else array


def _kind(value) -> str:
    if isinstance(value, wp.array):
        return "warp"
    if type(value).__module__.split(".")[0] == "torch" and hasattr(value, "device"):
        return "torch"
    return "number" if np.ndim(value) == 0 else "numpy"


def _on_device(inputs, kind: str) -> tuple[list[wp.array], str]:
    """The inputs as contiguous (n,) float64 Warp arrays on their own device, copied only where
    they are something else."""
    if kind == "torch":
        import torch

        tensors = [value for value in inputs if _kind(value) == "torch"]
        places = {str(value.device) for value in tensors}
        if len(places) > 1:
            raise GraspError(f"grasp inputs are on {' and '.join(sorted(places))}; use one device")
        try:
            whole = torch.broadcast_tensors(
                *(torch.as_tensor(v, dtype=torch.float64, device=tensors[0].device) for v in inputs)
            )
        except RuntimeError:
            shapes = ", ".join(str(tuple(np.shape(v))) for v in inputs)
            raise GraspError(f"grasp inputs have shapes {shapes}, which do not broadcast") from None
        if whole[0].ndim > 1:
            raise GraspError(
                f"grasp inputs have shape {tuple(whole[0].shape)}; give one-dimensional arrays"
            )
        arrays = [wp.from_torch(v.detach().reshape(-1).contiguous()) for v in whole]
        return arrays, str(arrays[0].device)
    given = [value for value in inputs if isinstance(value, wp.array)]
    for value in given:
        if value.dtype != wp.float64 or value.ndim != 1 or value.shape != given[0].shape:
            raise GraspError(
                "Warp arrays of grasp inputs must be (n,) float64 of one length, not "
                f"{value.shape} of {value.dtype.__name__}"
            )
        if value.device != given[0].device:
            raise GraspError(f"grasp inputs are on {given[0].device} and {value.device}")
    device = given[0].device
    arrays = [
        v.contiguous()
        if isinstance(v, wp.array)
        else wp.full(given[0].shape, float(v), dtype=wp.float64, device=device)
        for v in inputs
    ]
    return arrays, str(device)


def _check_on_device(arrays: list[wp.array], device: str) -> None:
    """Only the index of the first bad value comes back."""
    for (name, (low, high)), array in zip(LIMITS.items(), arrays, strict=False):
        first = wp.full(1, array.shape[0], dtype=wp.int32, device=device)
        wp.launch(
            find_outside,
            dim=array.shape[0],
            inputs=[array, wp.float64(low), wp.float64(high)],
            outputs=[first],
            device=device,
        )
        index = int(first.numpy()[0])
        if index < array.shape[0]:
            value = float(array[index : index + 1].numpy()[0])
            raise GraspError(_outside(name, index, value))


def _outside(name: str, index: int, value: float) -> str:
    low, high = LIMITS[name]
    return (
        f"{name}[{index}] is {value:g}, outside the {low:g} to {high:g} that can "
        "be solved (dimensionless: lengths over L_gb, curvature times L_gb)"
    )


def check_inputs(*inputs) -> tuple[np.ndarray, ...]:
    """(l_s, kappa, k_s) and anything after them as arrays of one shape (n,), or GraspError."""
    names = ("suspended_length", "curvature", "stretch_ratio", "natural_curvature")
    arrays = []
    for value, name in zip(inputs, (*names, *names), strict=False):
        try:
            arrays.append(np.asarray(value, dtype=np.float64))
        except (TypeError, ValueError, OverflowError):
            raise GraspError(f"{name} must be numbers, not {value!r:.60}") from None
    try:
        arrays = [np.atleast_1d(a) for a in np.broadcast_arrays(*arrays)]
    except ValueError:
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise GraspError(f"grasp inputs have shapes {shapes}, which do not broadcast") from None
    if arrays[0].ndim != 1:
        raise GraspError(f"grasp inputs have shape {arrays[0].shape}; give one-dimensional arrays")
    names = ("suspended_length", "curvature", "stretch_ratio")
    for name, value in zip(names, arrays, strict=False):
        low, high = LIMITS[name]
        bad = np.flatnonzero(~((value >= low) & (value <= high)))
        if bad.size:
            raise GraspError(_outside(name, int(bad[0]), value[bad[0]]))
    return tuple(np.array(a) for a in arrays)
