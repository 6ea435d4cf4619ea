"""What displacements of a grip ask of its arm, beside a joint path that is known."""

import numpy as np

from wrod.robot.joint_path import JointPath
from wrod.robot.kinematics import one_torch_thread

# Distance from the joints' limits that is kept [rad], more than what a joint path needs: the arm is
# linearised, and may have to move between the nodes.
_MARGIN = 0.05
_DAMPING = 1e-6


class ArmLimits:
    """Joint limits and speeds of an arm, linearised about a joint path.

    A moved grip is followed by the joints' smallest change, J^+ of the grip's Jacobian J; what a
    redundant arm could do besides is left aside.

    Args:
        path: of the trajectory that is to be corrected, at its own pace.
    """

    def __init__(self, path: JointPath):
        import torch

        arm = path.robot
        if arm is None:
            raise ValueError("a joint path that was loaded has no robot; solve it anew")
        self.positions = np.asarray(path.node_positions)
        with one_torch_thread(), torch.no_grad():
            jacobian = arm.chain.jacobian_tensor(torch.from_numpy(self.positions)).numpy()
        square = jacobian @ jacobian.transpose(0, 2, 1) + _DAMPING * np.eye(6)
        follow = np.linalg.solve(square, jacobian).transpose(0, 2, 1)
        # (N, joint, 6) change of the joints by what moves the grip, in the pattern's frame.
        turn = path.placement.base_from_world[:3, :3]
        self.rates = follow @ np.kron(np.eye(2), turn)
        self.interval = np.maximum(np.diff(path.node_time), 1e-6)
        self.velocity = np.asarray(arm.velocity)
        low, high = np.asarray(arm.lower), np.asarray(arm.upper)
        self.middle, self.reach = np.zeros_like(low), np.full_like(low, np.inf)
        bounded = np.isfinite(high - low)
        self.middle[bounded] = 0.5 * (low + high)[bounded]
        self.reach[bounded] = 0.5 * (high - low)[bounded] - _MARGIN

    def excess(self, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far displacements [m] and rotation vectors [rad] (T, 6) take joints beyond their
        range and their speed, in parts of these (m,), and the derivatives (m, T, 6) of that."""
        q = self.positions + np.einsum("tjd,td->tj", self.rates, moves)
        away = q - self.middle
        node, joint = np.nonzero(np.abs(away) > self.reach)
        side = np.sign(away[node, joint]) / self.reach[joint]
        beyond = side * away[node, joint] - 1.0
        rates = np.zeros((len(node), *moves.shape))
        rates[np.arange(len(node)), node] = side[:, None] * self.rates[node, joint]
        speed = np.diff(q, axis=0) / self.interval[:, None]
        node, joint = np.nonzero(np.abs(speed) > self.velocity)
        side = np.sign(speed[node, joint]) / self.velocity[joint]
        fast = side * speed[node, joint] - 1.0
        pace = np.zeros((len(node), *moves.shape))
        row, each = np.arange(len(node)), (side / self.interval[node])[:, None]
        pace[row, node] = -each * self.rates[node, joint]
        pace[row, node + 1] = each * self.rates[node + 1, joint]
        return np.concatenate([beyond, fast]), np.concatenate([rates, pace])
