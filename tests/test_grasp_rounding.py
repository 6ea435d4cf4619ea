"""Grasps to the last digits: what rounding makes of them, and another device."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from wrod.grasps.optimal import solve_grasps
from wrod.grasps.rod_grasps import solve_rod_grasps
from wrod.rods.catalogue import rod
from wrod.rods.law import Softening
from wrod.rods.model import RodModel
from wrod.rods.profile import Profile

GREEN = rod("green-vps")
CLOSURES = ("zero_tension", "min_force", "min_friction")
COUNT = 64
needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")


def varying() -> RodModel:
    """Anisotropic, tapered, curved, twisted and softening."""
    model = RodModel.of(GREEN)
    ends, stiffness = (0.0, model.length), model.bending_stiffness[0].values[0]
    return replace(
        model,
        bending_stiffness=tuple(Profile((k * stiffness, stiffness), ends) for k in (1.4, 0.8)),
        natural_curvature=(Profile((2.0, 0.0), ends), Profile((1.0, -1.0), ends)),
        natural_twist=Profile((1.0,)),
        law=Softening(critical_curvature=25.0, kept_stiffness=0.6),
    )


def solve(kind: str, closure: str, device: str, shaken: float = 0.0) -> dict[str, np.ndarray]:
    """Fields of grasps over the range, dimensionless; lengths multiplied by 1 + `shaken`."""
    rng = np.random.default_rng(11)
    kappa = rng.uniform(-1.0, 1.0, COUNT)
    if kind == "varying":
        part = rng.uniform(0.1, 0.85, COUNT) * GREEN.length
        lgb = GREEN.gravito_bending_length
        grasps = solve_rod_grasps(
            varying(),
            part * (1.0 + shaken),
            kappa / lgb,
            closure=closure,
            device=device,
            held_roll=0.3,
        )
        units = {"position": grasps.length_unit, "rotation": 1.0, "force": grasps.force_unit}
    else:
        length, ratio = rng.uniform(2.0, 14.0, COUNT), 10.0 ** rng.uniform(3.0, 5.0, COUNT)
        natural = rng.uniform(-0.4, 0.4, (COUNT, 2)) if kind == "curved" else None
        grasps = solve_grasps(
            length * (1.0 + shaken), kappa, ratio, closure=closure, natural_curvature=natural,
            device=device,
        )  # fmt: skip
        units = {"position": 1.0, "rotation": 1.0, "force": 1.0}
    fields = {name: getattr(grasps, name) / unit for name, unit in units.items()}
    return fields | {"converged": grasps.converged}


@pytest.mark.parametrize("kind", ["straight", "curved", "varying"])
@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
def test_rounding_and_another_device_leave_the_tenth_digit(kind, closure, device):
    """A GPU rounds otherwise than a CPU; so does a CPU on which every length is rounded otherwise.
    A minimum is flat: what rounding leaves of its slope would be multiplied by how far the grip
    goes with the force."""
    expected = solve(kind, closure, "cpu")
    found = solve(kind, closure, device, 0.0 if device != "cpu" else 3e-15)
    both = expected.pop("converged") & found.pop("converged")
    assert both.sum() > 0.6 * COUNT
    for name, right in expected.items():
        assert np.abs(found[name] - right)[both].max() < 1e-10, name
