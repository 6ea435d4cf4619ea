"""The neural controller: optimal grasps from a trained network (Sec. Training the Neural
Controller), in NumPy, or in torch where torch tensors come in."""

from __future__ import annotations

import os
import sys
import warnings
from importlib import resources

import numpy as np

from wrod import arguments
from wrod.controller.curved import curved, twisted
from wrod.controller.model import WITH_THRUST, chain, paper
from wrod.controller.trained import Trained
from wrod.errors import DataError, GraspError, OutOfRangeWarning, WrodWarning

# Networks by name, each of (xp, parameters, (n, 3) inputs): position, rotation vector and force or
# None, each (n, 3), and twist (n,), without which the rotation is given, or None. Parameters are
# "weight.i" and "bias.i" of the layers, and mean and scale of what is standardised.
ARCHITECTURES = {"chain": chain, "paper": paper, "curved": curved}
_INPUTS = ("suspended_length", "curvature", "stretch_ratio")
# Inputs are computed from SI values; their rounding is not out of range.
_SLACK = 1e-9
# Differences of a rod that are below what a controller errs by: in natural curvature [1/L_gb] and
# in Poisson's ratio.
_SAME_CURVATURE, _SAME_POISSON = 5e-4, 1e-3
# Errors of a grip's place [L_gb] and direction [rad] that are seen in what is laid: half a
# millimetre of a rod whose L_gb is 5 cm. What a tutorial trains in a minute is ten times nearer.
_SEEN = 0.01


# Closures whose networks ship, and their files' names.
SHIPPED = {"zero_tension": "default", "min_friction": "min-friction", "min_force": "min-force"}


class Controller(Trained):
    """A trained map from (l_s, kappa, k_s) to the optimal grasp, of all straight rods or of one
    naturally curved rod.

    Attributes:
        metadata: architecture, range, command, seed, versions and figures of the training.
        closure: that of the grasps it learnt.
        natural_curvature: (left, up) of the rods it was made for, as they are laid [1/L_gb].
        poisson: of the rod that it was made for; None for straight ones, which are not twisted.
        range: smallest and largest of each input that it was trained for; of the curvature, the
            absolute value counts.
    """

    kind, writer = "Controller", "train"

    def _settle(self) -> None:
        metadata = self.metadata
        self.closure = str(metadata["closure"])
        self.range = {name: tuple(metadata["range"][name]) for name in _INPUTS}
        rod = metadata.get("rod") or {}
        left, up = rod.get("natural_curvature", (0.0, 0.0))
        self.natural_curvature = (float(left), float(up))
        twists = self.natural_curvature != (0.0, 0.0)
        self.poisson = float(rod["poisson"]) if twists else None
        self._network = ARCHITECTURES[metadata["architecture"]]
        # One that learnt a closure with a thrust at the contact before thrusts were learnt.
        self._lacks_thrust = (
            metadata["architecture"] == "chain"
            and self.closure != "zero_tension"
            and len(self._parameters["mean"]) < WITH_THRUST
        )
        self._on_device: dict = {}

    def _probe(self) -> tuple[np.ndarray, ...]:
        lowest = np.array([[low for low, _ in self.range.values()]])
        position, rotation, *_ = self._network(np, self._parameters, lowest)
        return position.reshape(1, 3), rotation.reshape(1, 3)

    @classmethod
    @arguments.checked(DataError)
    def load(
        cls, path: str | os.PathLike[str] | None = None, *, closure: str = "zero_tension"
    ) -> Controller:
        """Read a controller that `wrod train` wrote, by its file or its folder; None is the one of
        a closure that ships with the package, for `SHIPPED` closures.

        Raises:
            DataError: the file is missing, truncated or not a controller, or none ships for that
                closure.
        """
        if path is None:
            if closure not in SHIPPED:
                raise DataError(
                    f"no controller ships for closure {closure!r}, only for "
                    f"{' and '.join(SHIPPED)}; train one with `wrod dataset --closure` and "
                    "`wrod train`"
                )
            shipped = resources.files("wrod.scenes") / "controller"
            path = str(shipped / f"{SHIPPED[closure]}.safetensors")
        if os.path.isdir(path):
            path = os.path.join(path, "controller.safetensors")
        return cls._read(path)

    def predict(self, suspended_length, curvature, stretch_ratio):
        """Optimal grasps.

        Args:
            suspended_length, curvature, stretch_ratio: (n,) arrays that broadcast: l_s [L_gb],
                signed kappa [1/L_gb], k_s [-].

        Returns:
            position (n, 3) [L_gb] and rotation vector (n, 3) [rad] in the contact frame, as
            `wrod.solve_grasps` gives them: float64 NumPy, or tensors of the input's kind, device
            and graph if one input is a torch tensor.

        Raises:
            GraspError: an input is not finite, not positive, or the shapes do not broadcast.

        Warns:
            OutOfRangeWarning: some inputs are outside `range`.
        """
        position, rotation, _ = self.predict_with_force(suspended_length, curvature, stretch_ratio)
        return position, rotation

    def predict_with_force(self, suspended_length, curvature, stretch_ratio):
        """As `predict`, and the force (n, 3) [k_b/L_gb^2] on the suspended rod at the contact, or
        None where the network does not know it."""
        return self.predict_with_twist(suspended_length, curvature, stretch_ratio)[:3]

    def predict_with_twist(self, suspended_length, curvature, stretch_ratio):
        """As `predict_with_force`, and the twist (n,) between contact and grip [rad], which may be
        more than a turn; None for straight rods."""
        xp, inputs = self._inputs(suspended_length, curvature, stretch_ratio)
        plain = inputs if xp is np else inputs.detach().cpu().numpy()
        outside = self.out_of_range(*plain.T)
        if outside.any():
            first = plain[np.argmax(outside)]
            bounds = ", ".join(f"{n} {lo:g} to {hi:g}" for n, (lo, hi) in self.range.items())
            warnings.warn(
                f"{outside.sum()} of {len(plain)} grasps are outside the trained range ({bounds}; "
                f"first: {first[0]:.4g}, {first[1]:.4g}, {first[2]:.4g}) and may be wrong; use "
                "the numeric solver there (method 'auto')",
                OutOfRangeWarning,
                stacklevel=4,
            )
        position, rotation, force, twist = self._network(xp, self._tensors(xp, inputs), inputs)
        if twist is not None:
            rotation = twisted(xp, rotation, twist)
        return position, rotation, None if self._lacks_thrust else force, twist

    def side_of(self, natural_curvature: tuple[float, float], poisson: float) -> float:
        """1 for a rod that is held with the natural curvature (left, up) [1/L_gb] that the
        controller was made for, -1 for its mirror image, whose grasps are mirror images too.

        Raises:
            GraspError: it was made for another rod.
        """
        left, up = natural_curvature
        own_left, own_up = self.natural_curvature
        for side in (1.0, -1.0):
            apart = max(abs(side * left - own_left), abs(up - own_up))
            twists = self.poisson is not None
            if apart <= _SAME_CURVATURE:
                if twists and abs(poisson - self.poisson) > _SAME_POISSON:
                    raise GraspError(
                        f"the controller was made for a rod with Poisson's ratio {self.poisson:g} "
                        f"and this one has {poisson:g}; train one for it with `wrod dataset --rod` "
                        "and `wrod train`, or use method 'numeric'"
                    )
                return side
        made, left, up = "naturally straight rods", round(left, 6) + 0.0, round(up, 6) + 0.0
        if self.poisson is not None:
            made = f"a natural curvature of ({own_left:.4g}, {own_up:.4g}) / L_gb (left, up)"
        raise GraspError(
            f"the controller was made for {made} and this rod is held with ({left:.4g}, {up:.4g}) "
            "/ L_gb; train one for it with `wrod dataset --rod` and `wrod train`, or use method "
            "'numeric'"
        )

    def warn_of_errors(self) -> None:
        """Say that the controller errs by so much on fresh inputs that what is laid shows it.

        Warns:
            WrodWarning: it does; the figures are its `metadata["held_out"]`.
        """
        said = self.metadata.get("held_out")
        if said is None:
            return
        off, turned = said["position_error_p99"], said["rotation_error_p99"]
        if max(off, turned) > _SEEN:
            warnings.warn(
                f"the controller is badly trained: one in a hundred of its grips is more than "
                f"{off:.2g} L_gb, or {turned:.2g} rad, off the rod solver's; train it longer or on "
                "more grasps, or use method 'numeric'",
                WrodWarning,
                stacklevel=4,
            )

    def within(self, name: str, low: float, high: float) -> Controller:
        """The same controller for a smaller range of one input."""
        limits = {**self.metadata["range"], name: [low, high]}
        return Controller(self._parameters, {**self.metadata, "range": limits})

    def out_of_range(self, suspended_length, curvature, stretch_ratio) -> np.ndarray:
        """(n,) whether the controller was not trained for an input."""
        values = np.broadcast_arrays(suspended_length, np.abs(curvature), stretch_ratio)
        outside = np.zeros(values[0].shape, dtype=bool)
        for (low, high), value in zip(self.range.values(), values, strict=True):
            outside |= (value < low * (1.0 - _SLACK)) | (value > high * (1.0 + _SLACK))
        return outside

    def _inputs(self, *inputs):
        for name, value in zip(_INPUTS, inputs, strict=True):
            if isinstance(value, (str, bytes, dict, type(None))):
                raise GraspError(f"{name} must be numbers, not {arguments.shown(value)}")
        torch = sys.modules.get("torch")
        if torch is not None and any(isinstance(value, torch.Tensor) for value in inputs):
            given = [value for value in inputs if isinstance(value, torch.Tensor)]
            for one in given:
                odd = one.is_sparse or one.is_quantized or one.is_nested or one.is_meta
                if not odd and one.numel() > arguments.MOST_NUMBERS:  # an expanded one takes none
                    raise GraspError(f"grasp inputs have {one.numel()} numbers; give fewer at once")
                if odd or one.dtype in (torch.bfloat16, torch.float16):
                    raise GraspError(
                        f"grasp inputs are of {one.dtype} on {one.device}; give dense tensors of "
                        "float32 or float64 that hold numbers"
                    )
            like = given[0]
            kind = like.dtype if like.dtype.is_floating_point else torch.float64
            try:
                tensors = [torch.as_tensor(v, dtype=kind, device=like.device) for v in inputs]
            except Exception as error:  # as of NumPy below
                raise GraspError(f"grasp inputs must be numbers ({error})") from None
            xp, stack = torch, lambda arrays: torch.stack(arrays, -1)
            broadcast, finite = torch.broadcast_tensors, torch.isfinite
            tensors = [torch.atleast_1d(tensor) for tensor in tensors]
        else:
            xp, stack = np, lambda arrays: np.stack(arrays, -1)
            broadcast, finite = np.broadcast_arrays, np.isfinite
            try:
                tensors = [np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in inputs]
            except Exception as error:  # whatever an object does that is asked to be numbers
                raise GraspError(f"grasp inputs must be numbers ({error})") from None
        try:
            tensors = broadcast(*tensors)
        except (ValueError, RuntimeError):
            shapes = ", ".join(str(tuple(tensor.shape)) for tensor in tensors)
            raise GraspError(f"grasp inputs have shapes {shapes}, which do not broadcast") from None
        if tensors[0].ndim != 1:
            shape = tuple(tensors[0].shape)
            raise GraspError(f"grasp inputs have shape {shape}; give one-dimensional arrays")
        for name, value in zip(_INPUTS, tensors, strict=True):
            good = finite(value) if name == "curvature" else finite(value) & (value > 0.0)
            if not bool(good.all()):
                bad = int(good.tolist().index(False))
                raise GraspError(f"{name}[{bad}] is {float(value[bad]):g}; give a usable number")
        return xp, stack(list(tensors))

    def _tensors(self, xp, inputs):
        if xp is np:
            return self._parameters
        key = (inputs.dtype, inputs.device)
        if key not in self._on_device:
            self._on_device[key] = {
                name: xp.tensor(value, dtype=inputs.dtype, device=inputs.device)
                for name, value in self._parameters.items()
            }
        return self._on_device[key]
