"""Gradients through the grasp solver: which rod is it whose grip stands at these heights?

Three heights of the grip were read off a robot. Their rod's L_gb is found by gradient descent
through `solve_grasps`, as any torch function.
"""

from pathlib import Path

import torch
from _picture import panels, save
from wrod.training.autograd import solve_grasps_differentiable


def main(out: str | Path = "out/examples", steps: int = 12) -> Path:
    suspended = torch.tensor([0.20, 0.35, 0.50], dtype=torch.float64)  # [m]
    radius, true_lgb = 0.0016, 0.032

    def heights(lgb: torch.Tensor) -> torch.Tensor:
        position, _, _ = solve_grasps_differentiable(
            suspended / lgb, torch.zeros(3, dtype=torch.float64), 4.0 * (lgb / radius) ** 2
        )
        return position[:, 2] * lgb

    with torch.no_grad():
        read = heights(torch.tensor(true_lgb, dtype=torch.float64))
    lgb = torch.tensor(0.045, dtype=torch.float64, requires_grad=True)
    path = []
    for _ in range(steps):
        misfit = heights(lgb) - read
        (slope,) = torch.autograd.grad(misfit.sum(), lgb)
        path.append((lgb.item(), misfit.abs().max().item()))
        with torch.no_grad():
            lgb -= misfit.sum() / slope  # Newton's step on the sum of the misfits
    print(f"L_gb {lgb.item():.6f} m, read from a rod of {true_lgb} m")
    figure, axes = panels()
    axes.semilogy([1e-12 + worst for _, worst in path], "o-", color="#0b5fa5")
    axes.set(xlabel="step", ylabel="largest misfit of a height [m]")
    return save(figure, out, "gradients_in_torch")


if __name__ == "__main__":
    main()
