"""What rods do to bodies that other solvers move, and what those solvers are told of it."""

import numpy as np
import warp as wp
from newton import Model, State

from wrod.kernels.stepping.carrying import add_wrenches, tell_wrenches
from wrod.newton_solver.group import RodGroup


class Loads:
    """Forces and torques about centres of mass, of every body: those of the last step's end, and
    those that are passed on.

    Attributes:
        taken: whether anybody has asked for them.
    """

    def __init__(self, model: Model):
        self._model, self.taken = model, False
        self._force, self._torque, self._told_force, self._told_torque = (
            wp.zeros(model.body_count, dtype=wp.vec3d, device=model.device) for _ in range(4)
        )

    def measure(self, groups: list[RodGroup], share: float) -> None:
        """Take what the groups' rods do now; what is passed on goes by `share` of the way there."""
        self._force.zero_()
        self._torque.zero_()
        for group in groups:
            group.add_loads(self._force, self._torque)
        inputs = [wp.float64(share), self._force, self._torque]
        self._launch(tell_wrenches, inputs, [self._told_force, self._told_torque])

    def wrenches(self) -> np.ndarray:
        """(body, 6) at the end of the last step."""
        return np.concatenate([self._force.numpy(), self._torque.numpy()], axis=1)

    def add_to(self, state: State) -> None:
        """Add what is passed on to `state.body_f`."""
        self._launch(add_wrenches, [self._told_force, self._told_torque], [state.body_f])

    def _launch(self, kernel, inputs, outputs) -> None:
        count, device = self._model.body_count, self._model.device
        wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=device)
