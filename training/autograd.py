"""The rod solver as a differentiable function of torch tensors."""

from __future__ import annotations

import numpy as np
import torch

from wrod.grasps.optimal import solve_grasps


class _SolveGrasps(torch.autograd.Function):
    @staticmethod
    def forward(ctx, suspended_length, curvature, stretch_ratio, device):
        inputs = [
            value.detach().to("cpu", torch.float64).numpy()
            for value in (suspended_length, curvature, stretch_ratio)
        ]
        grasps = solve_grasps(*inputs, device=device, sensitivities=True, shapes=False)
        names = ("position", "rotation", "force")
        lost = ~grasps.converged

        def tensor(name: str) -> torch.Tensor:
            value = getattr(grasps, name)
            value[lost] = np.nan
            return torch.from_numpy(value).to(suspended_length)

        ctx.save_for_backward(*(tensor(f"{name}_sensitivity") for name in names))
        return tuple(tensor(name) for name in names)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *gradients):
        total = sum(
            torch.einsum("ni,nij->nj", gradient, sensitivity)
            for gradient, sensitivity in zip(gradients, ctx.saved_tensors, strict=True)
        )
        return total[:, 0], total[:, 1], total[:, 2], None


def solve_grasps_differentiable(
    suspended_length: torch.Tensor,
    curvature: torch.Tensor,
    stretch_ratio: torch.Tensor,
    device: str | None = None,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Optimal grasps ("zero_tension") that gradients flow through, by the solver's sensitivities.

    Args:
        suspended_length, curvature, stretch_ratio: tensors that broadcast to (n,): l_s [L_gb],
            signed kappa [1/L_gb], k_s [-].
        device: where the solver runs; see `wrod.solve_grasps`.

    Returns:
        position (n, 3) [L_gb], rotation vector (n, 3) [rad], force (n, 3) [k_b/L_gb^2]; NaN where
        the solver did not converge.

    Raises:
        GraspError: an input is not finite or outside what can be solved.
    """
    inputs = torch.broadcast_tensors(suspended_length, curvature, stretch_ratio)
    return _SolveGrasps.apply(*inputs, device)
