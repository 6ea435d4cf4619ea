"""One deployment to simulate."""

from dataclasses import dataclass, field

from wrod.arguments import like, optional
from wrod.deployment.fixtures import Fixtures
from wrod.deployment.setup import Disturbance
from wrod.errors import RodError
from wrod.patterns.pattern import Pattern
from wrod.planning.hold import as_held
from wrod.planning.tail import Tail
from wrod.planning.trajectory import Trajectory
from wrod.records import checked_fields
from wrod.rods.model import Rod
from wrod.solvers.friction import Friction


@checked_fields(
    RodError,
    friction=like("a wrod.Friction", "static", "kinetic"),
    disturbance=like("a wrod.Disturbance", "jitter", "offset"),
    tail=optional(like("a Tail", "laid", "contact", "position", "rotation")),
    fixtures=optional(like("a wrod.Fixtures", "items", "gates")),
)
@dataclass(frozen=True)
class Trial:
    """One deployment to simulate; see `simulate_deployment`.

    Attributes:
        rod: what is laid; of a whole one that the trajectory holds nearer than at its end, kept as
            far as the grip.
        another_rod: `rod` has another length or radius than that of the plan, on purpose.
    """

    pattern: Pattern
    rod: Rod
    trajectory: Trajectory
    friction: Friction
    disturbance: Disturbance = field(default_factory=Disturbance)
    tail: Tail | None = None
    fixtures: Fixtures | None = None
    another_rod: bool = False

    def __post_init__(self):
        object.__setattr__(self, "rod", as_held(self.trajectory, self.rod))
