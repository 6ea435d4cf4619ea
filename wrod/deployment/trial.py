"""One deployment to simulate."""

from dataclasses import dataclass, field

from wrod.deployment.fixtures import Fixtures
from wrod.deployment.setup import Disturbance
from wrod.patterns.pattern import Pattern
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.rods.material import RodMaterial
from wrod.rods.model import RodModel
from wrod.solvers.contact import Friction


@dataclass(frozen=True)
class Trial:
    """One deployment to simulate; see `simulate_deployment`."""

    pattern: Pattern
    rod: RodModel | RodMaterial
    trajectory: Trajectory
    friction: Friction
    disturbance: Disturbance = field(default_factory=Disturbance)
    tail: Tail | None = None
    fixtures: Fixtures | None = None
