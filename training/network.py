"""Networks to train: the formulas of `wrod.controller` with parameters that torch learns."""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation
from wrod.training.dataset import GraspTable

from wrod.controller import curved as controller_curved
from wrod.controller import model as controller_model
from wrod.controller.controller import ARCHITECTURES
from wrod.errors import needed_extras

with needed_extras():
    import torch

_LEAST = 1e-9
# Below it a thrust at the contact is the solver's rounding; one that is so many times kappa squared
# does not vanish on a straight pattern.
_NO_THRUST, _PULL = 1e-6, 10.0


class GraspNetwork(torch.nn.Module):
    """A controller in training; float64.

    Args:
        architecture: a name of `wrod.controller.controller.ARCHITECTURES`.
        width, depth: units of a hidden layer, and number of these.
        table: grasps whose mean and scale standardise inputs or outputs.
        generator: of the first weights.
        natural_curvature: size of the rod's, for the architecture "curved" [1/L_gb].
    """

    def __init__(
        self,
        architecture: str,
        width: int,
        depth: int,
        table: GraspTable,
        generator: torch.Generator,
        natural_curvature: float = 0.0,
    ):
        super().__init__()
        self.architecture = architecture
        self.formula = ARCHITECTURES[architecture]
        known = {}
        if architecture == "chain":
            first, gain = controller_model.FEATURES, 5.0 / 3.0
            known["mean"], known["scale"] = _moments(_raw_outputs(table))
            last = len(known["mean"])
        elif architecture == "curved":
            first, last, gain = controller_curved.FEATURES, controller_curved.OUTPUTS, 5.0 / 3.0
            seen = controller_curved.features(np, table.inputs)
            known["input_mean"], known["input_scale"] = _moments(seen)
            known["mean"], known["scale"] = _curved_moments(table, natural_curvature)
        else:
            first, last, gain = 3, 6, 2.0**0.5
            known["mean"], known["scale"] = _moments(table.inputs)
        self.known = tuple(known)
        for name, value in known.items():
            self.register_buffer(name, torch.tensor(value))
        sizes = [first, *[width] * depth, last]
        self.weights, self.biases = torch.nn.ParameterList(), torch.nn.ParameterList()
        for layer, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
            spread = (gain if layer < depth else 0.1) * fan_in**-0.5
            noise = torch.randn(fan_out, fan_in, generator=generator, dtype=torch.float64)
            self.weights.append(torch.nn.Parameter(spread * noise))
            self.biases.append(torch.nn.Parameter(torch.zeros(fan_out, dtype=torch.float64)))

    def tensors(self) -> dict[str, torch.Tensor]:
        """Parameters under the names that the formulas know."""
        named = {name: getattr(self, name) for name in self.known}
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named[f"weight.{layer}"], named[f"bias.{layer}"] = weight, bias
        return named

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(n, 9) position, rotation vector and force; (n, 6) if the network knows no force; (n, 10)
        with the twist, without which the rotation is then."""
        parts = self.formula(torch, self.tensors(), inputs)
        columns = [part.reshape(len(inputs), -1) for part in parts if part is not None]
        return torch.cat(columns, dim=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Parameters as NumPy arrays of their own."""
        return {k: v.detach().cpu().numpy().copy() for k, v in self.tensors().items()}


def _moments(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and scale of columns; what is always the same keeps a scale."""
    return values.mean(axis=0), np.maximum(values.std(axis=0), _LEAST)


def _quaternions(table: GraspTable) -> np.ndarray:
    quaternion = Rotation.from_rotvec(table.outputs[:, 3:6]).as_quat(scalar_first=True)
    return quaternion * np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)


def _raw_outputs(table: GraspTable) -> np.ndarray:
    rows = table.take(np.abs(table.inputs[:, 1]) > 1e-2)
    force = rows.outputs[:, 6:]
    thrust = np.abs(force[:, 0])
    columns = controller_model.OUTPUTS
    if thrust.max() > _NO_THRUST:
        pulls = (thrust / rows.inputs[:, 1] ** 2).max() > _PULL
        columns = controller_model.WITH_PULL if pulls else controller_model.WITH_THRUST
    return controller_model.encode(
        np, rows.inputs, rows.outputs[:, :3], _quaternions(rows), force, columns
    )


def _curved_moments(table: GraspTable, natural_curvature: float) -> tuple[np.ndarray, np.ndarray]:
    # Sideways forces over kappa are known where kappa is more than the rod's own curvature.
    bent = np.abs(table.inputs[:, 1]) > np.quantile(np.abs(table.inputs[:, 1]), 0.2)
    rows = table.take(bent)
    mean, scale = _moments(
        controller_curved.encode(
            np, rows.inputs, rows.outputs[:, :3], _quaternions(rows), rows.outputs[:, 6:9],
            rows.outputs[:, 9],
        )
    )  # fmt: skip
    added = np.full(controller_curved.OUTPUTS, natural_curvature)
    slow = controller_curved.SLOW - 1  # the last slow output is added by the natural curvature
    added[:slow] = scale[:slow]
    return np.concatenate([mean, np.zeros(len(added) - len(mean))]), added
