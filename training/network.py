"""Networks to train: the formulas of `wrod.controller_model` with parameters that torch learns."""

from __future__ import annotations

import itertools

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from wrod.training.dataset import GraspTable

from wrod import controller_model


class GraspNetwork(torch.nn.Module):
    """A controller in training; float64.

    Args:
        architecture: a name of `controller_model.ARCHITECTURES`.
        width, depth: units of a hidden layer, and number of these.
        table: grasps whose mean and scale standardise inputs or outputs.
        generator: of the first weights.
    """

    def __init__(
        self,
        architecture: str,
        width: int,
        depth: int,
        table: GraspTable,
        generator: torch.Generator,
    ):
        super().__init__()
        self.architecture = architecture
        self.formula = controller_model.ARCHITECTURES[architecture]
        if architecture == "chain":
            first, last, gain = controller_model.FEATURES, controller_model.OUTPUTS, 5.0 / 3.0
            standardised = _raw_outputs(table)
        else:
            first, last, gain = 3, 6, 2.0**0.5
            standardised = table.inputs
        self.register_buffer("mean", torch.tensor(standardised.mean(axis=0)))
        self.register_buffer("scale", torch.tensor(standardised.std(axis=0)))
        sizes = [first, *[width] * depth, last]
        self.weights, self.biases = torch.nn.ParameterList(), torch.nn.ParameterList()
        for layer, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
            spread = (gain if layer < depth else 0.1) * fan_in**-0.5
            noise = torch.randn(fan_out, fan_in, generator=generator, dtype=torch.float64)
            self.weights.append(torch.nn.Parameter(spread * noise))
            self.biases.append(torch.nn.Parameter(torch.zeros(fan_out, dtype=torch.float64)))

    def tensors(self) -> dict[str, torch.Tensor]:
        """Parameters under the names of `controller_model`."""
        named = {"mean": self.mean, "scale": self.scale}
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            named[f"weight.{layer}"], named[f"bias.{layer}"] = weight, bias
        return named

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(n, 9) position, rotation vector and force; (n, 6) if the network knows no force."""
        parts = self.formula(torch, self.tensors(), inputs)
        return torch.cat([part for part in parts if part is not None], dim=1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Parameters as NumPy arrays of their own."""
        return {k: v.detach().cpu().numpy().copy() for k, v in self.tensors().items()}


def _raw_outputs(table: GraspTable) -> np.ndarray:
    bent = np.abs(table.inputs[:, 1]) > 1e-2
    rows = table.take(bent)
    quaternion = Rotation.from_rotvec(rows.outputs[:, 3:6]).as_quat(scalar_first=True)
    quaternion *= np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)
    return controller_model.encode(
        np, rows.inputs, rows.outputs[:, :3], quaternion, rows.outputs[:, 6:]
    )
