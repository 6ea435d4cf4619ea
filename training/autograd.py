"""The rod solver and whole deployments as differentiable functions of torch tensors."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from wrod import arguments
from wrod.deployment.result import METRIC_POINTS, interpolation
from wrod.deployment.simulate import Trial, refuse_other_plans, with_remainder_of
from wrod.deployment.tangents import Directions, lay
from wrod.errors import GraspError, RodError, needed_extras
from wrod.grasps.optimal import solve_grasps

with needed_extras():
    import torch


def tensor(value) -> str | None:
    """Finite floats in a plain tensor."""
    good = isinstance(value, torch.Tensor) and value.is_floating_point()
    good = good and value.layout == torch.strided and not value.is_meta
    if good:
        # What is expanded repeats a few numbers, and is no larger for it.
        value = value[tuple(slice(None if step else 1) for step in value.stride())]
    return None if good and bool(value.isfinite().all()) else "must be a tensor of finite floats"


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

        def found(name: str) -> torch.Tensor:
            value = getattr(grasps, name)
            value[lost] = np.nan
            return torch.from_numpy(value).to(suspended_length)

        ctx.save_for_backward(*(found(f"{name}_sensitivity") for name in names))
        return tuple(found(name) for name in names)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *gradients):
        total = sum(
            torch.einsum("ni,nij->nj", gradient, sensitivity)
            for gradient, sensitivity in zip(gradients, ctx.saved_tensors, strict=True)
        )
        return total[:, 0], total[:, 1], total[:, 2], None


@arguments.checked(GraspError, suspended_length=tensor, curvature=tensor, stretch_ratio=tensor)
def solve_grasps_differentiable(
    suspended_length: torch.Tensor,
    curvature: torch.Tensor,
    stretch_ratio: torch.Tensor,
    device: arguments.DeviceLike = None,
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
    try:
        inputs = torch.broadcast_tensors(suspended_length, curvature, stretch_ratio)
    except RuntimeError as error:
        raise GraspError(f"solve_grasps_differentiable: {error}") from None
    if inputs[0].dim() > 1:  # before what is expanded becomes numbers of its own
        shape = tuple(inputs[0].shape)
        raise GraspError(f"solve_grasps_differentiable: inputs broadcast to {shape}; give (n,)")
    return _SolveGrasps.apply(*inputs, device)


class _LayRods(torch.autograd.Function):
    @staticmethod
    def forward(ctx, correction, friction, lgb, natural_curvature, trials, points, options):
        values = [
            None if value is None else value.detach().to("cpu", torch.float64).numpy()
            for value in (correction, friction, lgb, natural_curvature)
        ]
        moves, scalars = values[0], values[1:]
        trials = [
            _changed(trial, *(None if v is None else float(v[k]) for v in scalars))
            for k, trial in enumerate(trials)
        ]
        wanted = ctx.needs_input_grad[:4]
        displacements = directions = None
        if moves is not None:
            bases = [_between_knots(t.trajectory.arc_length, moves.shape[1]) for t in trials]
            displacements = [basis @ move for basis, move in zip(bases, moves, strict=True)]
        if any(wanted):
            directions = [
                _directions(trial, bases[k] if wanted[0] else None, wanted[1:])
                for k, trial in enumerate(trials)
            ]
        laid = lay(trials, directions, displacements, **options)
        places, rates = [], []
        for trial, one in zip(trials, laid, strict=True):
            pattern = with_remainder_of(trial.pattern, trial.trajectory)
            at = np.linspace(0.0, pattern.length, points) + pattern.remainder_length
            weights = interpolation(at, one.arc_length)
            lost = np.nan if one.diverged else 0.0
            places.append(weights @ one.centerline + lost)
            rates.append(np.einsum("pn,cnd->pdc", weights, one.tangent) + lost)
        like = next(v for v in (correction, friction, lgb, natural_curvature) if v is not None)
        ctx.save_for_backward(torch.from_numpy(np.stack(rates)).to(like))
        ctx.wanted, ctx.shape = wanted, None if moves is None else moves.shape
        return torch.from_numpy(np.stack(places)).to(like)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        (rates,) = ctx.saved_tensors
        left = torch.einsum("npd,npdc->nc", gradient, rates)
        out: list[torch.Tensor | None] = []
        for k, wanted in enumerate(ctx.wanted):
            count = 0 if not wanted else int(np.prod(ctx.shape[1:])) if k == 0 else 1
            mine, left = left[:, :count], left[:, count:]
            out.append((mine.reshape(ctx.shape) if k == 0 else mine[:, 0]) if wanted else None)
        return *out, None, None, None


def _changed(trial: Trial, friction, lgb, natural_curvature) -> Trial:
    """The trial with what was given; None leaves what it has."""
    law, how = trial.friction, trial.disturbance
    if friction is not None:
        kinetic = None if law.kinetic is None else law.kinetic + friction - law.static
        law = replace(law, static=friction, kinetic=kinetic)
    if lgb is not None:
        how = replace(how, lgb_error=lgb / trial.rod.gravito_bending_length - 1.0)
    if natural_curvature is not None:
        how = replace(how, natural_curvature=natural_curvature)
    return replace(trial, friction=law, disturbance=how)


def _between_knots(arc_length: np.ndarray, knots: int) -> np.ndarray:
    """(T, knots) of the natural cubic spline through values at so many even arc lengths."""
    at = np.linspace(arc_length[0], arc_length[-1], knots)
    return CubicSpline(at, np.eye(knots), bc_type="natural")(arc_length)


def _directions(trial: Trial, basis: np.ndarray | None, scalars: Sequence[bool]) -> Directions:
    """Columns: (knots x 6) of the path, then those of friction, L_gb and natural curvature that are
    wanted."""
    nodes = len(trial.trajectory)
    rod = Directions.of_rod(nodes)
    lgb = trial.rod.gravito_bending_length * (1.0 + trial.disturbance.lgb_error)
    chosen = [k for k, wanted in enumerate(scalars) if wanted]
    out = Directions(
        rod.path[chosen],
        rod.friction[chosen],
        3.0 / lgb * rod.stiffness[chosen],  # stiffness grows with L_gb^3 under the same weight
        rod.natural_curvature[chosen],
    )
    if basis is None:
        return out
    path = np.einsum("tk,cd->kctd", basis, np.eye(6)).reshape(-1, nodes, 6)
    return Directions.of_path(path) + out


@arguments.checked(
    RodError,
    trials=arguments.several(
        arguments.like("a wrod.Trial", "pattern", "rod", "trajectory", "friction")
    ),
    points=arguments.whole(2, 100_000),
    **dict.fromkeys(
        ("correction", "friction", "gravito_bending_length", "natural_curvature"), tensor
    ),
)
def lay_differentiable(
    trials: Sequence[Trial],
    correction: torch.Tensor | None = None,
    friction: torch.Tensor | None = None,
    gravito_bending_length: torch.Tensor | None = None,
    natural_curvature: torch.Tensor | None = None,
    *,
    points: int = METRIC_POINTS,
    **options,
) -> torch.Tensor:
    """Lay rods in simulation, with gradients of what lies, for n deployments at once.

    Where the laid rod has a kink in its parameters, because a node passes from sticking to sliding
    or touches down, the gradient is that of the side on which the deployment went
    (`wrod.deployment.tangents.lay`). All derivatives are carried along forwards, eight at a time,
    and only those of tensors that require them.

    Args:
        trials: n deployments, without fixtures; their numbers hold for what is not given below.
        correction: (n, K, 6) displacement [m] and rotation vector [rad], in the robot's frame, of
            the grip at K >= 2 knots, evenly from the first to the last laid length of its
            trajectory; natural cubic splines between them, the time law unchanged.
        friction: (n,) or () static coefficient; a kinetic one keeps its difference [-].
        gravito_bending_length: (n,) or () of the rods that are laid; their weight and the plan stay
            [m].
        natural_curvature: (n,) or () of the rods at rest, to the left of the direction in which
            they are laid [1/m].
        points: P, evenly along each pattern.
        options: hold, release, speed, discretisation, friction_field and device of
            `wrod.simulate_deployments`.

    Returns:
        (n, P, 3) where the rods lie at the end of their patterns, the grip still holding, at the
        arc lengths of the points, at the height of the pattern's plane [m]; NaN where a deployment
        diverged. Type and device are those of the first tensor that is given.

    Raises:
        RodError: no tensor is given, one has another shape or values that are not possible, or a
            trial has fixtures or lets the rod roll.
    """
    trials, n = list(trials), len(trials)
    for trial in trials:
        refuse_other_plans(trial)
    given = {
        "correction": correction,
        "friction": friction,
        "gravito_bending_length": gravito_bending_length,
        "natural_curvature": natural_curvature,
    }
    if all(value is None for value in given.values()):
        raise RodError(f"lay_differentiable: give a tensor for one of {', '.join(given)}")
    for name, value in given.items():
        if value is None:
            continue
        if name == "correction":
            if value.dim() != 3 or value.shape[::2] != (n, 6) or value.shape[1] < 2:
                raise RodError(
                    f"lay_differentiable: correction has shape {tuple(value.shape)}; give "
                    f"({n}, K, 6) with 2 knots or more"
                )
            continue
        if value.shape not in ((), (n,)):
            raise RodError(
                f"lay_differentiable: {name} has shape {tuple(value.shape)}; give ({n},) or ()"
            )
        if name != "natural_curvature" and not bool((value > 0.0).all()):
            raise RodError(f"lay_differentiable: {name} has values that are not positive")
        given[name] = value.expand(n)
    return _LayRods.apply(*given.values(), trials, points, options)
