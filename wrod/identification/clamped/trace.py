"""What the residual looks like as mechanics, before any effect is fitted.

Each print is an inverse problem, linear about the base model: a profile along the rod (or a few
numbers at an end), the same in every trial, that would put the base model into the measured
shapes. Its Gaussian prior is smooth and of the size that makes the data likeliest (empirical
Bayes), so that noise leaves no print. Prints are ranked by the logarithm of the evidence.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from wrod.identification.clamped.laboratory import Laboratory
from wrod.identification.clamped.memory import Memory, bent_before
from wrod.identification.effect import Effect, Model, Parameter, effects
from wrod.rods.rotation import node_frames

KNOTS = 7
# A print changes over the trials where first and last differ by so much of it, so many errors.
_CHANGE, _SURE = 0.3, 4.0
_VARIANCES = np.logspace(-4, 3, 43) ** 2
# Evidence of a print from which it is one [nats]; twice that is what an effect lowers the
# information criterion by to join.
SEEN = 5.0
# Evidence that it is another one in each trial: so many numbers take what a law leaves wrong, too.
_ANEW = 2.0 * SEEN
MEMORY = Memory.name
# Squares beyond noise's, in standard deviations of those, that are an excess.
_EXCESS = 3.0


@dataclass
class Print:
    """One way to read the residual.

    Attributes:
        name, title, unit: what it is.
        points_to: effects that leave such a print.
        evidence: log evidence over that of the base model alone [nats]; 0 where nothing is seen,
            None where it is not known.
        share: fraction of the excess of squares that it takes away, to first order; 0 where there
            is no more than noise varies by and the print is not seen.
        arc_length: (K,) places of the profile [m]; None for numbers at an end.
        components: names of the columns of `value`.
        value, stderr: (K, components) or (components,).
        drift: size of the print in the first trial and in the last, in the order in which they were
            taken (1 in their mean), and the standard error of the difference.
        change: log evidence that such a print comes or goes in that order, whatever its mean is
            [nats]; by: how much from the first trial to the last, as `value`.
        anew: log evidence that it is another one in each trial, in no order [nats].
    """

    name: str
    title: str
    unit: str
    points_to: tuple[str, ...]
    evidence: float | None
    share: float
    arc_length: np.ndarray | None
    components: tuple[str, ...]
    value: np.ndarray
    stderr: np.ndarray
    drift: tuple[float, float, float] = (1.0, 1.0, 0.0)
    change: float = 0.0
    by: np.ndarray | None = None
    anew: float = 0.0

    @property
    def seen(self) -> bool:
        """Whether the data say that it is there."""
        return self.evidence is None or self.evidence > SEEN

    @property
    def changes(self) -> str:
        """A phrase for people where the print is another one at the end than it was at first."""
        first, last, error = self.drift
        if abs(last - first) <= max(_CHANGE, _SURE * error):
            return ""
        return (
            f"{self.title} goes from {first:.2f} to {last:.2f} ± {error:.2f} of its mean in the "
            "order of the trials: something changes while it is measured"
        )

    @property
    def seen_to_change(self) -> str:
        """A phrase for people where the data say that the print is no effect, which is the same in
        every trial; empty where they do not."""
        if self.name == MEMORY:
            return f"{self.title}: {self.value[0]:.2f} ± {self.stderr[0]:.2f}" if self.seen else ""
        if self.by is None or (self.change <= SEEN and self.anew <= _ANEW):
            return ""
        if self.anew > self.change:
            return f"{self.title} is another one in each trial"
        said = f"{self.title} is another one in the last trials than in the first"
        if self.arc_length is not None:
            size = self.by.mean(axis=0)
            size = size[0] if len(size) == 1 else np.linalg.norm(size)
            said += f", by {size:.2g} {self.unit}".rstrip()
        return said

    def to_dict(self) -> dict:
        """As `report.json` has it."""
        return {
            "name": self.name,
            "title": self.title,
            "unit": self.unit,
            "log_evidence": self.evidence,
            "share_of_excess": self.share,
            "points_to": list(self.points_to),
            "components": list(self.components),
            "arc_length": None if self.arc_length is None else self.arc_length.tolist(),
            "value": self.value.tolist(),
            "stderr": self.stderr.tolist(),
            "first_trial": self.drift[0],
            "last_trial": self.drift[1],
            "stderr_of_change": self.drift[2],
            "log_evidence_of_change": self.change,
            "log_evidence_of_change_anew": self.anew,
        }


def hats(fraction: np.ndarray, knots: int = KNOTS) -> np.ndarray:
    """(n, knots) linear interpolation between equidistant knots at places along the rod."""
    return np.maximum(1.0 - np.abs(fraction[:, None] * (knots - 1) - np.arange(knots)), 0.0)


class ProbedProfile(Effect):
    """A profile of `width` components between knots that changes one array of the setup.

    Args:
        array: which one.
        relative: whether it says how much of the array it adds.
    """

    reference = ""

    def __init__(self, array: str, scale: float, width: int = 1, relative: bool = False):
        self.array, self.width, self.relative = array, width, relative
        self.parameters = tuple(
            Parameter(f"{c}_{k}", "", scale) for k in range(KNOTS) for c in range(width)
        )

    def apply(self, setup, values):
        old = getattr(setup, self.array)
        change = hats(setup.fraction) @ np.reshape(values, (KNOTS, self.width))
        if old.ndim == 1:
            change = change[:, 0]
        setattr(setup, self.array, old + (old * change if self.relative else change))


class _Force(ProbedProfile):
    """Force per length, along the columns of a frame in each trial and node."""

    def __init__(self, scale, frame):
        super().__init__("force", scale, 3)
        self.frame = frame

    def apply(self, setup, values):
        force = hats(setup.fraction) @ np.reshape(values, (KNOTS, 3))
        setup.push(np.einsum("tnij,nj->tni", self.frame, force))


def trace(
    laboratory: Laboratory,
    model: Model | None = None,
    values: np.ndarray | None = None,
    trials: np.ndarray | None = None,
) -> list[Print]:
    """Every print of what a model leaves of trials (default: those to fit), the likeliest first.

    Args:
        model, values: by default the base model. What its own parameters could still take is no
            print's.
    """
    m = laboratory.measurements
    beside, values = model or Model(), np.zeros(0) if values is None else values
    trials = m.train if trials is None else trials
    residual = laboratory.target[trials] - laboratory.observe(beside, values, trials=trials)
    residual = laboratory.whiten(residual, trials).ravel()
    solver, _ = laboratory.solver_at(beside, values)
    own = np.zeros((residual.size, 0))
    if len(values):
        _, rates = laboratory.jacobian(beside, values)
        own = np.linalg.qr(laboratory.whiten(rates[trials], trials).reshape(-1, len(values)))[0]
        residual = residual - own @ (own.T @ residual)

    def free(rates):
        """Columns of independent numbers, without what the model itself could take."""
        columns = rates.reshape(len(residual), -1)
        return columns - own @ (own.T @ columns)

    prints = []
    frames, tangents = frames_of(solver)
    plans = _plans(frames, m.material.weight)
    kept = _memory_of(frames, tangents, laboratory)
    if MEMORY not in beside.names:
        plans.append((MEMORY, kept.title, "", (MEMORY,), Model((kept,)), ("share",)))
    for name, title, unit, points_to, probe, components in plans:
        scale = np.array([p.scale for p in probe.parameters])
        together = Model((*beside.effects, *probe.effects))
        at = np.append(values, np.zeros(len(scale)))
        (rates,) = laboratory.rates(solver, [together], [at], laboratory.base, len(values))
        rates = laboratory.whiten(rates[trials] * scale, trials)
        jacobian = free(rates)
        profile = isinstance(probe.effects[0], ProbedProfile)
        prior = smooth_prior(len(components)) if profile else np.eye(len(scale))
        evidence, _, share, value, stderr = infer(jacobian, residual, prior)
        drift = _drift(trials, jacobian @ value, residual)
        change, _, _, by, _ = infer(free(rates * _order(trials)[:, None, None]), residual, prior)
        anew = 0.0
        if profile:
            anew = _anew(rates, own, residual, prior)
        value, stderr, by = value * scale, stderr * scale, by * scale
        arc_length = None
        if profile:
            arc_length = np.linspace(0.0, m.material.length, KNOTS)
            value, stderr, by = (a.reshape(KNOTS, -1) for a in (value, stderr, by))
        said = (name, title, unit, points_to, evidence, share, arc_length, components)
        prints.append(Print(*said, value, stderr, drift, change, by, anew))
    return sorted(prints, key=lambda p: -p.evidence)


def memory_of(laboratory: Laboratory, model: Model, values: np.ndarray) -> Memory:
    """The effect by which a rod keeps some of its curvature in the trial before, as a model has
    it there."""
    return _memory_of(*frames_of(laboratory.solver_at(model, values)[0]), laboratory)


def frames_of(solver) -> tuple[np.ndarray, np.ndarray]:
    """((T, node, 3, 3) material frames at the nodes between the clamps, (T, edge, 3) tangents)."""
    directors, tangents = solver.batch.material_directors(), solver.batch.state.tangent.numpy()
    return node_frames(directors[:, :, 0], tangents)[:, 1:-1], tangents


def _memory_of(frames, tangents, laboratory: Laboratory) -> Memory:
    return Memory(bent_before(frames, tangents, laboratory.measurements.material.length))


def _anew(rates, own, residual, prior) -> float:
    """Log evidence of (t, R, P) rates where each trial has numbers of its own, beside what the
    model itself could take, of which `residual` has nothing."""
    rates = rates @ np.linalg.cholesky(prior)
    trials, readings = rates.shape[:2]
    gram = rates.mT @ rates
    rhs = rates.mT @ residual.reshape(trials, readings, 1)
    if own.shape[1]:
        taken = np.hstack(list(own.reshape(trials, readings, -1).mT @ rates))
        gram, rhs = (block_diag(*gram) - taken.T @ taken)[None], rhs.reshape(1, -1, 1)
    size, vectors = np.linalg.eigh(gram)
    return _likeliest(size.ravel(), (vectors.mT @ rhs).ravel())[0]


def _order(trials) -> np.ndarray:
    """(t,) place of trials in the order in which they were taken, -0.5 to 0.5."""
    return np.linspace(-0.5, 0.5, int(np.ptp(trials)) + 1)[trials - trials.min()]


def _drift(trials, predicted, residual) -> tuple[float, float, float]:
    """Sizes that the first and the last trial ask for, and the standard error of the difference: a
    straight line over the trials' numbers, its error from their scatter about it."""
    predicted, residual = (v.reshape(len(trials), -1) for v in (predicted, residual))
    weight = (predicted**2).sum(axis=1)
    if len(trials) < 4 or not (weight > 0.0).all():
        return 1.0, 1.0, 0.0
    size = (predicted * residual).sum(axis=1) / weight
    place = _order(trials)
    middle = weight @ place / weight.sum()
    spread = weight @ (place - middle) ** 2
    slope = weight @ ((place - middle) * size) / spread
    mean = weight @ size / weight.sum()
    left = size - mean - slope * (place - middle)
    scatter = max(float(weight @ left**2) / (len(trials) - 2), 1.0)
    first, last = (mean + slope * (end - middle) for end in (-0.5, 0.5))
    return float(first), float(last), float(np.sqrt(scatter / spread))


def _plans(frames: np.ndarray, weight: float) -> list[tuple]:
    """What may leave a print: its name, title, unit, effects that it points to, model, components.

    Args:
        frames: (trial, node, 3, 3) material frames.
        weight: of the rod per length [N/m].
    """
    known, lab = effects(), np.broadcast_to(np.eye(3), frames.shape)
    axes, own = ("x", "y", "z"), ("m1", "m2", "tangent")
    force_unit = "N/m"
    return [
        (
            "force_in_laboratory",
            "force per length, fixed in the laboratory",
            force_unit,
            ("gravity_tilt", "air_flow", "point_mass", "density", "density_profile"),
            Model((_Force(0.1 * weight, lab),)),
            axes,
        ),
        (
            "force_in_material",
            "force per length that turns with the material",
            force_unit,
            (),
            Model((_Force(0.1 * weight, frames),)),
            own,
        ),
        (
            "moment_in_material",
            "moment that turns with the material, as a curvature dt/ds at rest",
            "1/m",
            ("natural_curvature", "natural_helix"),
            Model((ProbedProfile("natural_curvature", 1.0, 2),)),
            own[:2],
        ),
        (
            "moment_with_curvature",
            "moment that follows the curvature, as a relative change of bending stiffness",
            "",
            ("stiffness", "stiffness_gradient", "anisotropic_bending", "softening", "yielding"),
            Model((ProbedProfile("bending", 0.1, relative=True),)),
            ("stiffness",),
        ),
        *(
            (
                f"{end}_end",
                f"{who} is not where it was said to be",
                "m, rad",
                (f"{end}_offset", f"{end}_rotation", f"{end}_slip"),
                Model(tuple(known[f"{end}_{kind}"] for kind in ("offset", "rotation", "slip"))),
                (*own, "turn 1", "turn 2", "roll", "slip"),
            )
            for end, who in (("clamp", "clamp A"), ("grip", "the gripper"))
        ),
        (
            "camera",
            "cameras that shift, turn and scale",
            "m, rad",
            ("camera_offset", "camera_rotation", "camera_scale"),
            Model((known["camera_rotation"], known["camera_scale"])),
            ("turn x", "turn y", "turn z", "x", "y", "z", "scale", "x", "y", "z"),
        ),
        (
            "markers",
            "markers beside the centreline",
            "m",
            ("marker_offset",),
            Model((known["marker_offset"],)),
            own,
        ),
    ]


def smooth_prior(width: int) -> np.ndarray:
    """Prior covariance of a profile: neighbouring knots, a sixth of the rod apart, are alike."""
    place = np.arange(KNOTS)
    like = np.exp(-0.5 * ((place[:, None] - place) / 1.5) ** 2) + 1e-6 * np.eye(KNOTS)
    return np.kron(like, np.eye(width))


def infer(jacobian, residual, prior):
    """Evidence, likeliest variance of the prior, share and posterior of a linear model."""
    root = np.linalg.cholesky(prior)
    whitened = jacobian @ root
    size, vectors = np.linalg.eigh(whitened.T @ whitened)
    projected = vectors.T @ (whitened.T @ residual)
    evidence, amplitude = _likeliest(size, projected)
    size = np.maximum(size, 0.0)
    shrunk = amplitude / (1.0 + amplitude * size)
    mean = root @ (vectors @ (shrunk * projected))
    spread = root @ (vectors * np.sqrt(shrunk))
    left = residual - jacobian @ mean
    excess, square = residual @ residual - len(residual), residual @ residual
    there = excess > _EXCESS * np.sqrt(2.0 * len(residual)) or (excess > 0.0 and evidence > SEEN)
    share = float((square - left @ left) / excess) if amplitude > 0.0 and there else 0.0
    return evidence, amplitude, min(share, 1.0), mean, np.sqrt((spread**2).sum(axis=1))


def _likeliest(size: np.ndarray, projected: np.ndarray) -> tuple[float, float]:
    """(evidence, variance) of a prior at its best, of columns whose products have these eigenvalues
    and along whose eigenvectors the residual has these products; (0, 0) where none is the best."""
    part = _VARIANCES[:, None] * np.maximum(size, 0.0)
    gain = 0.5 * ((projected**2 * _VARIANCES[:, None] / (1.0 + part)) - np.log1p(part)).sum(axis=1)
    k = int(np.argmax(gain))
    return (float(gain[k]), float(_VARIANCES[k])) if gain[k] > 0.0 else (0.0, 0.0)
