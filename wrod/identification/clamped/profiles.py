"""Non-parametric profiles along a clamped rod, and the effects that are built from them.

Where no known effect reaches the noise, what is missing is read off the residual as a profile on
`KNOTS` knots: natural curvature, stiffness, weight, force in the laboratory. Its prior is a
Gaussian process whose size and correlation length are those of most evidence, so that only as many
of its numbers count as the data ask for. A profile is simplified to a described effect
(`described`) where that has the better information criterion, and stays a profile where it has not.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from wrod.identification.clamped.described import Attraction, LocalBend, LocalLoad, Stretch
from wrod.identification.clamped.layout import COMPLEX_STEP
from wrod.identification.clamped.setup import ClampedSetup
from wrod.identification.clamped.trace import hats
from wrod.identification.effect import Effect, Estimate, Model, Parameter

KNOTS = 21
# Correlation lengths to choose from, over the free length.
_SMOOTH = (0.06, 0.12, 0.25, 0.5)
_AMPLITUDES = np.logspace(-3, 3, 25)
# Components of a profile that explain less than this of its prior variance are left out, and so
# are those of which the data say less than the prior does.
_LEAST = 0.01
_PLACES = 3
_REACH = 0.05  # of an attraction's middle, where a search begins [m]


def _curvature(setup, profile):
    vector = np.stack([profile[:, 1], -profile[:, 0]], axis=1)
    setup.natural_curvature = setup.natural_curvature + vector


def _stiffness(setup, profile):
    factor = np.exp(profile[:, 0])
    setup.bending = setup.bending * factor[:, None]
    setup.twisting = setup.twisting * factor
    setup.stretching = setup.stretching * 0.5 * (factor[1:] + factor[:-1])


def _weight(setup, profile):
    setup.line_mass = setup.line_mass * (1.0 + profile[:, 0])


def _force(setup, profile):
    setup.push(profile)


@dataclass(frozen=True)
class _Kind:
    """What a profile may be of.

    Attributes:
        apply: changes a setup by a profile (node, width).
        told: (node, width) what a setup has of it, for reports, beside the base model's setup.
        fields: of a setup, what it is of and what may change with that.
        keys: what the components are called; unit: of what is told.
        base: of what is told, what a rod has by the base model.
    """

    apply: Callable
    told: Callable
    fields: tuple[str, ...]
    keys: tuple[str, ...]
    unit: str
    title: str
    base: float

    @property
    def width(self) -> int:
        return len(self.keys)


def _curvature_told(setup, base):
    return setup.natural_curvature


def _stiffness_told(setup, base):
    return setup.bending[:, :1] / base.bending[:, :1]


def _weight_told(setup, base):
    return setup.line_mass[:, None] / base.line_mass[:, None]


def _force_told(setup, base):
    return setup.force[0] / setup.cells()[:, None]


KINDS = {
    "curvature": _Kind(
        _curvature, _curvature_told, ("natural_curvature",),
        ("curvature_1", "curvature_2"), "1/m", "natural curvature", 0.0,
    ),
    "stiffness": _Kind(
        _stiffness, _stiffness_told, ("bending", "twisting", "stretching"),
        ("stiffness_ratio",), "", "relative stiffness", 1.0,
    ),
    "weight": _Kind(
        _weight, _weight_told, ("line_mass",),
        ("weight_ratio",), "", "relative weight", 1.0,
    ),
    "force": _Kind(
        _force, _force_told, ("force",),
        ("force_1", "force_2", "force_3"), "N/m", "force in the laboratory", 0.0,
    ),
}  # fmt: skip


class ProfileEffect(Effect):
    """A profile as an effect: numbers that are 1 large by the prior, times its components.

    Args:
        kind: of `KINDS`; basis: (KNOTS, width, P) its components.
        about: an effect of the same quantity that it is a profile about; its parameters come first.
        start: to start fits from; default: no profile.
    """

    reference = "Gaussian process along the rod, size and smoothness of most evidence"

    def __init__(
        self,
        kind: str,
        basis: np.ndarray,
        about: Effect | None = None,
        start: np.ndarray | None = None,
    ):
        self.kind, self.basis, self.about = kind, basis, about
        self.name = f"profile_of_{kind}"
        self.title = f"{KINDS[kind].title}, a profile along the rod"
        own = tuple(Parameter(f"component_{k}", "", 1.0) for k in range(basis.shape[2]))
        self.parameters = (*about.parameters, *own) if about else own
        self.start = np.zeros(len(self.parameters)) if start is None else start

    def starts(self, measurements):
        return [self.start]

    def apply(self, setup, values):
        first = len(self.parameters) - self.basis.shape[2]
        if self.about:
            self.about.apply(setup, values[:first])
        profile = hats(setup.fraction, KNOTS) @ (self.basis @ np.asarray(values[first:]))
        KINDS[self.kind].apply(setup, profile)

    def special_cases(self, values, measurements):
        """The constant and the straight line nearest to it."""
        found = told(self.kind, self, values, measurements)[0]
        slope, first = np.polyfit(np.linspace(0.0, 1.0, KNOTS), found[:, 0], 1)
        ends, mean = np.array([first - 1.0, first + slope - 1.0]), found.mean(axis=0)
        ends = np.maximum(ends, -0.9)
        factor = np.log(np.maximum(mean[:1], 0.1))
        return {
            "curvature": {"natural_curvature": mean},
            "stiffness": {"stiffness": factor, "stiffness_gradient": ends},
            "weight": {"density": factor, "density_profile": ends},
        }.get(self.kind, {})

    def describe(self, values, covariance, measurements, knots=tuple(range(KNOTS))):
        """What the rod has of the quantity at knots, the ends and the middle first."""
        kind = KINDS[self.kind]
        found, rates = told(self.kind, self, values, measurements)
        error = np.sqrt(np.einsum("kwp,pq,kwq->kw", rates, covariance, rates))
        places = np.linspace(0.0, measurements.material.length, KNOTS)
        middle = KNOTS // 2
        return {
            f"{key}_at_{1e3 * places[k]:.0f}_mm": Estimate(
                float(found[k, w]), float(error[k, w]), kind.unit
            )
            for k in sorted(knots, key=lambda k: k % middle > 0)
            for w, key in enumerate(kind.keys)
        }


def told(kind: str, effect: Effect, values, measurements) -> tuple[np.ndarray, np.ndarray]:
    """((KNOTS, width) what a rod with an effect has of a quantity at the knots, (KNOTS, width, P)
    its derivatives by the effect's parameters)."""
    base = ClampedSetup.base(measurements, measurements.train[:1], KNOTS - 1)

    def of(values):
        setup = copy.copy(base)
        effect.apply(setup, values)
        return KINDS[kind].told(setup, base)

    steps = 1j * COMPLEX_STEP * np.eye(len(values))
    rates = [of(values + step).imag / COMPLEX_STEP for step in steps]
    return of(values), np.stack(rates, axis=2)


def root_of(like: np.ndarray, width: int, least: float = 1e-6) -> np.ndarray:
    """(width * KNOTS, P) root of the prior covariance of profiles whose components are independent
    and alike, without modes of less than that share of the mean variance. What is left out is
    certain to be nothing, so that errors do not bear it."""
    sizes, vectors = np.linalg.eigh(like)
    keep = sizes > least * sizes.sum() / KNOTS
    return np.kron(np.eye(width), vectors[:, keep] * np.sqrt(sizes[keep]))


def as_basis(root: np.ndarray) -> np.ndarray:
    """(KNOTS, width, P) of (width * KNOTS, P)."""
    count, size = root.shape
    return np.moveaxis(root.reshape(count // KNOTS, KNOTS, size), 0, 1)


@dataclass(frozen=True)
class Found:
    """The likeliest profile of one kind.

    Attributes:
        evidence: log evidence over none [nats]; effective: numbers that the data determine.
        value: (KNOTS, width); basis: (KNOTS, width, P) components that the data determine, each 1
            large by the prior.
    """

    kind: str
    evidence: float
    effective: float
    value: np.ndarray
    basis: np.ndarray


class Knots(Effect):
    """Every knot of some kinds as a parameter, for one linearisation."""

    def __init__(self, kinds: Sequence[str]):
        self.quantities = [KINDS[kind] for kind in kinds]
        self.parameters = tuple(
            Parameter(f"{key}_{k}", "", 1.0)
            for own in self.quantities
            for key in own.keys
            for k in range(KNOTS)
        )

    def apply(self, setup, values):
        first, weights = 0, hats(setup.fraction, KNOTS)
        for own in self.quantities:
            count = own.width * KNOTS
            part = np.asarray(values[first : first + count]).reshape(own.width, KNOTS)
            own.apply(setup, weights @ part.T)
            first += count


@dataclass(frozen=True)
class _Linear:
    """The residual of the train trials about the base model, linear in every knot of every kind.

    Attributes:
        gram: (K, K), towards: (K,) of the whitened rates and with the residual.
        first: the first column of each kind; forces: (T, R, 3, KNOTS) rates of forces.
    """

    gram: np.ndarray
    towards: np.ndarray
    first: dict[str, int]
    forces: np.ndarray

    def scan(self, kinds: tuple[str, ...], windows) -> list[tuple[float, np.ndarray, int, int]]:
        """[(squares taken, values, first knot, last knot)] of constant values on each window of
        knots, best first; windows that overlap a better one are left out."""
        found = []
        for i, j in windows:
            columns = [
                self.first[kind] + w * KNOTS + np.arange(i, j + 1)
                for kind in kinds
                for w in range(KINDS[kind].width)
            ]
            towards = np.array([self.towards[c].sum() for c in columns])
            gram = np.array([[self.gram[np.ix_(a, b)].sum() for b in columns] for a in columns])
            values = np.linalg.solve(gram + 1e-9 * np.diag(np.diag(gram)), towards)
            found.append((float(towards @ values), values, i, j))
        found.sort(key=lambda f: -f[0])
        chosen: list[tuple[float, np.ndarray, int, int]] = []
        for one in found:
            if all(one[2] > c[3] + 1 or one[3] < c[2] - 1 for c in chosen):
                chosen.append(one)
            if len(chosen) == _PLACES:
                break
        return chosen


def _linearised(laboratory) -> _Linear:
    trials = laboratory.measurements.train
    model = Model((Knots(tuple(KINDS)),))
    seen, rates = laboratory.jacobian(model, np.zeros(len(model.parameters)))
    residual = laboratory.whiten((laboratory.target - seen)[trials], trials).ravel()
    columns = laboratory.whiten(rates[trials], trials).reshape(residual.size, -1)
    first, place = {}, 0
    for kind, own in KINDS.items():
        first[kind], place = place, place + own.width * KNOTS
    forces = rates[:, :, first["force"] :].reshape(*rates.shape[:2], 3, KNOTS)
    return _Linear(columns.T @ columns, columns.T @ residual, first, forces)


def profiles_of(linear: _Linear) -> list[Found]:
    """The likeliest profile of every kind about the base model, best first."""
    found = []
    for kind, own in KINDS.items():
        part = slice(linear.first[kind], linear.first[kind] + own.width * KNOTS)
        found.append(likeliest(kind, own.width, linear.gram[part, part], linear.towards[part]))
    return sorted(found, key=lambda f: -f.evidence)


def likeliest(kind: str, width: int, gram: np.ndarray, projected: np.ndarray) -> Found:
    """The likeliest profile of a residual that is linear in its knots.

    Args:
        gram: (width * KNOTS, width * KNOTS), projected: (width * KNOTS,) of the whitened rates
            and with the residual.
    """
    best: tuple[float, Found] | None = None
    place = np.linspace(0.0, 1.0, KNOTS)
    for smooth in _SMOOTH:
        root = root_of(np.exp(-0.5 * ((place[:, None] - place) / smooth) ** 2), width, _LEAST)
        small, modes = np.linalg.eigh(root.T @ gram @ root)
        small = np.maximum(small, 0.0)
        towards = modes.T @ (root.T @ projected)
        for amplitude in _AMPLITUDES**2:
            shrunk = amplitude / (1.0 + amplitude * small)
            gain = 0.5 * (towards**2 * shrunk).sum() - 0.5 * np.log1p(amplitude * small).sum()
            if best is None or gain > best[0]:
                value = (root @ (modes @ (shrunk * towards))).reshape(width, KNOTS).T
                seen = root @ modes[:, amplitude * small > 1.0]
                basis = np.sqrt(amplitude) * as_basis(seen)
                effective = float((amplitude * small / (1.0 + amplitude * small)).sum())
                best = (gain, Found(kind, float(gain), effective, value, basis))
    return best[1]


def built_effects(laboratory, above: float = -np.inf) -> tuple[list[Effect], list[Found]]:
    """The described effects that the profiles ask for, each with its starts, and the profiles, best
    first; none at all where no profile's log evidence is above that [nats]."""
    linear = _linearised(laboratory)
    found = profiles_of(linear)
    if found[0].evidence <= above:
        return [], []
    gap = laboratory.measurements.material.length / (KNOTS - 1)
    inner = range(1, KNOTS - 1)
    bends = [
        [*(values * gap), i * gap, np.log(width)]
        for _, values, i, _ in linear.scan(("curvature",), [(i, i) for i in inner])
        for width in (0.008, 0.04)
    ]
    narrow = [(i, j) for i in inner for j in inner if i <= j < i + 7]
    stretches = [
        [np.clip(stiff, -2.0, 1.5), np.clip(heavy, -0.8, 4.0), *_span(i, j, gap)]
        for _, (stiff, heavy), i, j in linear.scan(("stiffness", "weight"), narrow)
    ]
    # A short stretch that is much softer acts like a longer one that is a little so.
    stretches += [[3.0 * v[0], v[1], v[2], v[3]] for v in stretches if v[0] < 0.0]
    wide = [(i, j) for i in range(KNOTS) for j in range(i + 1, KNOTS)]
    spans = [(v, i, j, (j - i + 1) * gap) for _, v, i, j in linear.scan(("force",), wide)]
    loads = [[*(v * breadth), 0.5 * (i + j) * gap, breadth] for v, i, j, breadth in spans]
    effects: list[Effect] = [
        LocalBend(bends),
        Stretch(stretches),
        LocalLoad(loads),
        Attraction(_points(laboratory, linear.forces)),
    ]
    return effects, found


def _span(i: int, j: int, gap: float) -> tuple[float, float]:
    """(start, log of the length) of the stretch that knots stand for [m]."""
    return (i - 0.5) * gap, float(np.log((j - i + 1) * gap))


def _points(laboratory, forces) -> list[np.ndarray]:
    """Starts of an attraction: the points of a grid whose pull explains most, to first order."""
    m = laboratory.measurements
    trials = m.train
    knots = m.node_positions(KNOTS - 1)[trials]
    residual = laboratory.target[trials] - laboratory.observe(Model(), np.zeros(0), trials=trials)
    residual = laboratory.whiten(residual, trials).ravel()
    low, high = knots.min(axis=(0, 1)) - 0.1, knots.max(axis=(0, 1)) + 0.1
    axes = [np.linspace(a, b, max(int((b - a) / 0.05), 2)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    ranked = []
    for point in grid:
        away = point - knots
        square = (away**2).sum(axis=2, keepdims=True) + _REACH**2
        pull = Attraction.distance**2 * away / square**1.5
        response = np.einsum("trck,tkc->tr", forces[trials], pull)
        response = laboratory.whiten(response, trials).ravel()
        size = response @ response
        along = response @ residual
        ranked.append((along**2 / max(size, 1e-300), along / max(size, 1e-300), point))
    ranked.sort(key=lambda r: -r[0])
    chosen: list[np.ndarray] = []
    for _, strength, point in ranked:
        if all(np.linalg.norm(point - c[1:4]) > 0.08 for c in chosen):
            chosen.append(np.array([strength, *point, np.log(_REACH)]))
        if len(chosen) == 3:
            break
    return chosen
