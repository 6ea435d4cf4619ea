"""Motion of batches of rods: implicit time steps, each rod at its own pace."""

from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from wrod import arguments
from wrod.errors import RodError
from wrod.kernels.stepping import pace
from wrod.rods.batch import IS_ROD, RodBatch
from wrod.rods.discretisation import damping, models_of, quadratic_drag
from wrod.solvers.banded import BandedSystem
from wrod.solvers.bodies import Bodies
from wrod.solvers.condensed import paired_system
from wrod.solvers.inelastic import InternalVariables
from wrod.solvers.inertia import edge_masses, lumped_masses, rounding_of, usual_force
from wrod.solvers.newton_steps import Follower, NewtonSteps, Touching
from wrod.solvers.readback import read
from wrod.solvers.recording import launching, record, replay
from wrod.solvers.rod_contact import RodContact
from wrod.solvers.steps import SCHEMES, Motion, Progress
from wrod.solvers.viscosity import Viscosity

# A rod is cut out when it wants steps shorter than this fraction of the largest.
_SMALLEST_STEP = 1.0 / 4096.0
# Rounds that are taken without looking whether to go on: on end where a device decides by itself,
# and one after the other where it cannot.
_ROUNDS, _ROUNDS_BLIND, _ENDLESS = 128, 16, 2**31 - 1


_IS_CONTACT = arguments.like("a wrod.Contact or wrod.RodContact", "add", "settle", "restart")


class Dynamics(NewtonSteps):
    """Time stepping of a batch; allocates everything once.

    Degrees of freedom that are not free stand still unless `motion` moves them.

    Args:
        batch: the rods, with node masses; their state is the initial configuration, at rest.
        scheme: "euler" (first order, dissipates), "bdf2" (second order, hardly dissipates) or
            "midpoint" (second order, a quarter of its error, dissipates nothing of itself; steps in
            which anything is touched are of "bdf2").
        radius: (rod,) or (rod, node - 1) radius of the section, for the rotational inertia of the
            edges.
        air_damping: (rod,) drag per mass and velocity [1/time].
        inertia: "lumped" at the nodes, or "consistent": of mass that is spread along the edges,
            with which a swinging cable's period is off by a tenth as much.
        internal_damping: Kelvin-Voigt time of the material [time], which does not oppose rigid
            motion: (rod,), or for every strain as in `wrod.solvers.viscosity.Viscosity`.
        contact: what the rods touch, one or several (`wrod.solvers.newton_steps.Touching`), or
            None; at most one `RodContact`.
        motion: what moves prescribed degrees of freedom, or None.
        bodies: rigid bodies that hold rods and move with them, or None.
        force_scale: (rod,) what residuals are measured against; default: the rod's weight, or
            k_b / L^2 if that is larger.
        tolerance: largest residual of a step over the force scale.
        keeps_recording: record the launches of a round on any device, and replay them in later
            calls of `advance` too. `motion`, contacts and bodies must then keep their arrays and
            numbers, or `forget_recording` be called. Default: where there are none.

    Attributes:
        max_iterations: of Newton; a step that needs more is halved.
        shrinks: by how much an iteration is taken to divide the residual at most [-]: a step that
            would not converge even so is halved at once.
        refuses_saddles: halve steps, too, whose matrix is indefinite where they end.
        follower: what is carried along with the steps, or None; see `forget_recording`.

    Raises:
        RodError: unknown scheme or inertia, a node without mass, or two `RodContact`.
    """

    max_iterations = 12
    shrinks = np.inf
    refuses_saddles = True
    follower: Follower | None = None

    @launching()
    @arguments.checked(
        RodError,
        radius=arguments.numbers_of_any_shape,
        air_damping=arguments.array((), (None,)),
        internal_damping=arguments.numbers_of_any_shape,
        contact=arguments.optional(
            arguments.either(_IS_CONTACT, arguments.several(_IS_CONTACT, 0))
        ),
        motion=arguments.optional(arguments.like("a motion", "prescribe")),
        bodies=arguments.optional(arguments.like("rigid bodies", "columns", "push", "carried")),
        force_scale=arguments.optional(arguments.array((), (None,))),
        tolerance=arguments.number(1e-16, 1e3),
    )
    def __init__(
        self,
        batch: RodBatch,
        *,
        scheme: str = "bdf2",
        radius: np.ndarray | float,
        air_damping: np.ndarray | float = 0.0,
        inertia: str = "lumped",
        internal_damping: np.ndarray | float = 0.0,
        contact: Touching | Sequence[Touching] | None = None,
        motion: Motion | None = None,
        bodies: Bodies | None = None,
        force_scale: np.ndarray | float | None = None,
        tolerance: float = 1e-6,
        keeps_recording: bool | None = None,
    ):
        if scheme not in SCHEMES:
            raise RodError(f"unknown scheme {scheme!r}; use one of {', '.join(SCHEMES)}")
        if inertia not in ("lumped", "consistent"):
            raise RodError(f"inertia is {inertia!r}; use lumped or consistent")
        super().__init__(batch)
        self._scheme, self.tolerance = SCHEMES.index(scheme), tolerance
        self.contact, self.motion, self.bodies = contact, motion, bodies
        rods, device = batch.rod_count, batch.device
        if contact is None:
            contact = ()
        self.contacts = tuple(contact) if isinstance(contact, Sequence) else (contact,)
        coupling = [c for c in self.contacts if isinstance(c, RodContact)]
        if len(coupling) > 1:
            raise RodError("two RodContact for one batch; one covers all pairs of its edges")
        self.rod_contact = coupling[0] if coupling else None
        columns = 1 if bodies is None else 1 + bodies.columns
        if coupling:
            self.system = paired_system(coupling[0], columns)
        else:
            self.system = BandedSystem(batch, columns)

        def floats(name, value):
            return batch.array(arguments.spread(value, (rods,), f"Dynamics: {name}", RodError))

        self.mass = batch.array(lumped_masses(batch, radius))
        self.edge_mass = None
        if inertia == "consistent":
            self.edge_mass = batch.array(edge_masses(batch))
        self.air_damping = floats("air_damping", air_damping)
        self.drag = None
        # The last change of velocity tells Newton's start, but for what hits something.
        self.growth = 0.0 if self.contacts else 0.5
        self.viscosity = Viscosity(batch, internal_damping)
        self.internal = InternalVariables(batch)
        scale = usual_force(batch) if force_scale is None else force_scale
        self.force_scale = floats("force_scale", scale)
        self.length_scale = batch.array(batch.rest_length.numpy().sum(axis=1))
        rounding = rounding_of(batch, self.length_scale.numpy(), self.force_scale.numpy())
        self.rounding = batch.array(rounding, dtype=wp.vec2d)
        for one in self.contacts:
            one.time_step, one.iteration = self.span, self.iteration
        if self.rod_contact is not None:
            self.rod_contact.balance = (self.residual, self.step_tolerance)
            self.rod_contact.velocity = self.velocity
            self.rod_contact.rubbing.iteration = self.iteration
        # Rounds since last asked; whether to take another, and whether any rod still runs, starts
        # a step, iterates on, has ended a step.
        self._rounds = wp.zeros(1, dtype=wp.int32, device=device)
        self._going = wp.zeros(5, dtype=wp.int32, device=device)
        self._goes_on = self._going[:1]  # a condition of a graph is one number
        alone = not self.contacts and motion is None and bodies is None
        self.keeps_recording = alone if keeps_recording is None else keeps_recording
        self._recording: tuple[tuple, object] | None = None

    @classmethod
    @arguments.checked(
        RodError,
        rods=arguments.each(IS_ROD),
        batch=arguments.like("a wrod.RodBatch", "rest_length", "rod_count"),
        clamped=arguments.several(arguments.flag, least=2),
        air_damping=arguments.number(0.0),
        internal_damping=arguments.number(0.0),
    )
    def of(
        cls,
        rods,
        batch: RodBatch,
        *,
        clamped: tuple[bool, bool] = (False, False),
        air_damping: float = 0.0,
        internal_damping: float = 0.0,
        **options,
    ) -> "Dynamics":
        """Time stepping of rods that are braked, inside and by air, as their models say.

        Args:
            rods: a `RodModel` or `RodMaterial` for all rows, or one for each.
            batch: made of them, as by `RodBatch.of`.
            clamped: as there: the ghost of a clamp feels no air.
            air_damping, internal_damping: of rods that say nothing of it [1/s, s].
            options: other arguments of the constructor.

        Raises:
            RodError: there are neither one nor as many rods as rows, or the constructor refuses.
        """
        models = models_of(rods)
        models = models * batch.rod_count if len(models) == 1 else models
        if len(models) != batch.rod_count:
            raise RodError(f"{len(models)} rods and a batch of {batch.rod_count}; give one each")
        made = cls(batch, **damping(models, air_damping, internal_damping), **options)
        made.relax(np.array([m.relaxation_time for m in models]))
        ghosts = tuple(map(int, clamped))
        edge = batch.rest_length.numpy()
        drag = quadratic_drag(models, edge[:, ghosts[0] : edge.shape[1] - ghosts[1]])
        if drag is not None:
            made.set_drag(np.pad(drag, ((0, 0), ghosts, (0, 0))))
        return made

    def forget_recording(self) -> None:
        """Record afresh: what `motion` or contacts launch has changed."""
        self._recording = None

    @launching()
    @arguments.checked(
        RodError,
        until=arguments.array((), (None,)),
        step=arguments.number(),
        smallest_step=arguments.optional(arguments.number(above=0.0)),
        frames=arguments.optional(arguments.like("a Warp array", "ptr", "device", "shape")),
        frame_interval=arguments.number(above=0.0),
    )
    def advance(
        self,
        until: np.ndarray | float,
        step: float,
        *,
        smallest_step: float | None = None,
        frames: wp.array | None = None,
        frame_interval: float = 1.0,
        progress: Callable[[np.ndarray], object] | None = None,
        then: Callable[[], object] | None = None,
    ) -> Progress:
        """Let every rod that has not diverged move on to its time `until`.

        Args:
            until: (rod,) time to reach.
            step: largest time step; a rod whose step fails takes half of it, and recovers.
            smallest_step: a rod that wants less is cut out; default: step / 4096.
            frames: (rod, frame, dof) array that receives the configurations at the multiples of
                `frame_interval`.
            progress: called now and then with the (rod,) times.
            then: launched after every round: kernels that may give rods which are there another
                time `until` and let them run on, so that none waits for the others; what is
                recorded may be replayed until `forget_recording` is called.

        Raises:
            RodError: the step is not positive.
        """
        if arguments.wrong(arguments.number(above=0.0), step):
            raise RodError(f"time step is {arguments.shown(step)}; give a positive finite number")
        batch = self.batch
        smallest = step * _SMALLEST_STEP if smallest_step is None else smallest_step
        self.until.assign(
            arguments.spread(until, (batch.rod_count,), "Dynamics.advance: until", RodError)
        )
        self._begin_advance(step)

        def take_round() -> None:
            self._take_round(step, smallest, frames, frame_interval)
            if then is not None:
                then()
            self._ask(_ROUNDS)

        key = (step, smallest, None if frames is None else frames.ptr, frame_interval, then)
        graph = self._recorded(key)
        taken = 0
        if graph is None:
            self._ask(_ROUNDS)
        going = graph is not None or read(self._going)[1] != 0
        while going:
            # Launches are replayed faster than they can be made, but recording costs as much as
            # taking them; the first round has compiled the kernels.
            if (
                graph is None
                and taken > 0
                and (self.keeps_recording or not wp.get_device(self.batch.device).is_cpu)
            ):
                graph = self._record(take_round)
                self._keep(key, graph)
            self._rounds.zero_()
            if graph is None:
                take_round()
            else:
                replay(graph)
            taken += 1
            going = read(self._going)[1] != 0
            if progress is not None and (graph is not None or taken % _ROUNDS == 0):
                progress(read(self.time))
        if self.rod_contact is not None:
            self.rod_contact.check_capacity()
        return Progress(
            read(self.time),
            read(self.diverged) != 0,
            read(self.step_count),
            read(self.iteration_count),
        )

    @launching()
    def advance_by(self, duration: float, step: float) -> None:
        """Let every rod that has not diverged move on by a duration, as `advance` does, but tell
        nothing: from the second call on nothing is allocated, and nothing comes back to the host.
        May be captured into a graph of the caller's, after a first call.

        Args:
            duration: time to go on by.
            step: largest time step.

        Raises:
            RodError: it is captured on a device that cannot decide by itself how often to iterate
                (CUDA before 12.4).
        """
        smallest = step * _SMALLEST_STEP
        self._begin_advance(step, duration)

        def take_round() -> None:
            self._take_round(step, smallest, None, 1.0)
            self._ask(_ENDLESS)

        def take_rounds() -> None:
            self._rounds.zero_()
            self._ask(_ENDLESS)
            wp.capture_while(self._goes_on, take_round)

        device = wp.get_device(self.batch.device)
        decides = device.is_cpu or wp.is_conditional_graph_supported()
        if device.is_capturing and not decides:
            raise RodError("a step in a CUDA graph needs CUDA 12.4 or newer; step without a graph")
        key = (duration, step, smallest)
        records = self.keeps_recording and decides and not device.is_capturing
        graph = self._recorded(key) if records else None
        if graph is None and records and device.is_cpu:
            # It replays rounds five times as fast as it makes their launches: all but the first,
            # which compiles the kernels.
            take_round()
            graph = record(device, take_rounds)
            self._keep(key, graph)
        if graph is not None:
            replay(graph)
            return
        take_rounds()
        if records and not device.is_cpu:
            graph = record(device, take_rounds)
            self._keep(key, graph)

    def launch_times(self, until: float, step: float, rounds: int) -> list[tuple[str, float]]:
        """(name, milliseconds) of all that rounds of steps towards `until` launch on a GPU, one by
        one and not as a graph: what they cost, and where."""
        self.until.fill_(until)
        self._begin_advance(step)
        wp.timing_begin(cuda_filter=wp.TIMING_ALL)
        for _ in range(rounds):
            self._take_round(step, step * _SMALLEST_STEP, None, 1.0)
        wp.synchronize_device(self.batch.device)
        return [(event.name, event.elapsed) for event in wp.timing_end()]

    def _begin_advance(self, step: float, duration: float = 0.0) -> None:
        self._per_rod(pace.begin_advance, [wp.float64(step), wp.float64(duration)], [self.pace])

    def _recorded(self, key: tuple) -> wp.Graph | None:
        """What was recorded for the same numbers and arrays."""
        if self._recording is not None and self._recording[0] == (key, self._launched):
            return self._recording[1]
        return None

    def _keep(self, key: tuple, graph: wp.Graph | None) -> None:
        keeps = graph is not None and self.keeps_recording
        self._recording = ((key, self._launched), graph) if keeps else None

    @property
    def _launched(self) -> tuple:
        """What rounds are launched with, where contacts, `motion` and bodies do not change."""
        own = tuple(a.ptr for a in vars(self).values() if isinstance(a, wp.array))
        numbers = self.tolerance, self.max_iterations, self.refuses_saddles, self.follower
        return (*numbers, *own, *self.batch.launched)

    @property
    def is_recorded(self) -> bool:
        """Whether launches of a round are recorded and kept."""
        return self._recording is not None

    def _ask(self, most: int) -> None:
        """Find out on the device whether to take another round, `most` of them at a time."""
        outputs = [self._rounds, self._going]
        self.batch.launch_lanes(pace.ask_on, [self.pace, most], outputs, rods=1)

    def _record(self, take_round: Callable[[], None]) -> wp.Graph | None:
        """What takes rounds until all rods are there, or for a while; asking a GPU from outside
        would make it wait. None on a CPU where other threads launch."""
        device = self.batch.device
        decides = wp.get_device(device).is_cpu or wp.is_conditional_graph_supported()

        def take_rounds() -> None:
            if decides:
                self._ask(_ROUNDS)
                wp.capture_while(self._goes_on, take_round)
            else:
                for _ in range(_ROUNDS_BLIND):
                    take_round()

        return record(device, take_rounds)
