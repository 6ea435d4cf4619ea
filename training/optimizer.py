"""SOAP: Adam in the eigenbasis of Shampoo's preconditioner (Vyas et al. 2024, arXiv 2409.11321).

Regression to many digits is ill-conditioned, and Adam stalls where its axes are not those of the
curvature. For layers as small as ours the eigenbases cost little.
"""

from wrod.errors import needed_extras

with needed_extras():
    import torch


class Soap(torch.optim.Optimizer):
    """Adam whose axes are the running eigenvectors of G G^T and G^T G of every weight matrix.

    Args:
        parameters: to learn; vectors get plain Adam.
        lr: learning rate.
        betas: decay of the mean gradient and of its squares and products.
        eps: added to the root of the squares.
        refresh: steps between two updates of the eigenvectors.
    """

    def __init__(self, parameters, lr=3e-3, betas=(0.95, 0.95), eps=1e-8, refresh=10):
        super().__init__(parameters, {"lr": lr, "betas": betas, "eps": eps, "refresh": refresh})

    @torch.no_grad()
    def step(self, closure=None):
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                state = self.state[parameter]
                if not state:
                    self._begin(state, parameter.grad)
                else:
                    self._update(parameter, state, group)
        return loss

    @staticmethod
    def _begin(state: dict, gradient: torch.Tensor) -> None:
        """The first gradient only sets the axes."""
        state["step"] = 0
        state["mean"] = torch.zeros_like(gradient)
        state["square"] = torch.zeros_like(gradient)
        if gradient.ndim == 2:
            state["left"], state["right"] = gradient @ gradient.T, gradient.T @ gradient
            state["left_axes"] = torch.linalg.eigh(state["left"])[1]
            state["right_axes"] = torch.linalg.eigh(state["right"])[1]

    @staticmethod
    def _update(parameter: torch.Tensor, state: dict, group: dict) -> None:
        gradient, (first, second) = parameter.grad, group["betas"]
        matrix = gradient.ndim == 2
        state["step"] += 1
        state["mean"].lerp_(gradient, 1.0 - first)
        turned, mean = gradient, state["mean"]
        if matrix:
            left, right = state["left_axes"], state["right_axes"]
            turned, mean = left.T @ gradient @ right, left.T @ mean @ right
        state["square"].lerp_(turned * turned, 1.0 - second)
        size = (state["square"] / (1.0 - second ** state["step"])).sqrt() + group["eps"]
        update = mean / (1.0 - first ** state["step"]) / size
        if matrix:
            update = left @ update @ right.T
        parameter.add_(update, alpha=-group["lr"])
        if not matrix:
            return
        state["left"].lerp_(gradient @ gradient.T, 1.0 - second)
        state["right"].lerp_(gradient.T @ gradient, 1.0 - second)
        if state["step"] % group["refresh"] == 0:
            # One step of orthogonal iteration follows eigenvectors that hardly move.
            state["left_axes"] = torch.linalg.qr(state["left"] @ left)[0]
            state["right_axes"] = torch.linalg.qr(state["right"] @ right)[0]
