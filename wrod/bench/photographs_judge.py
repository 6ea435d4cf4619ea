"""What photographs say of the scenarios of `wrod bench photographs`, and what they predict."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from wrod.bench.photographs_deployments import Deployments, believed_scenario, scenarios_of
from wrod.errors import DataError
from wrod.identification.laid.camera import OverheadCamera, begin, find_camera
from wrod.identification.laid.choice import aligned, average, heard, simplest, spread, weigh
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import MissesByPart, foot, parts_of, raw, rigid
from wrod.identification.laid.scenario import LaidRod, Scenario

# Ways of predicting, the simplest first: the model with nothing fitted (None), or the scenarios'
# mean with their weights' softness [m]: each picture of a rod in the same scenario or its own, by
# where it is nearest to the picture or, with no motion, by where the picture shows the rod.
SOFT = (4e-3, 2e-3, 1e-3, 0.5e-3)
ONE, MIXTURE, PLACED = "one scenario for all", "a mixture", "one scenario for all, by place"
KINDS = (ONE, MIXTURE, PLACED)
WAYS = (None, *((kind, soft) for kind in KINDS for soft in SOFT))
# What intervals of a prediction are to hold of the points seen.
HELD = 0.8
_OPTIMAL_WORLDS = 6
# Of the start, by itself [m].
FIRST = 0.22


@dataclass(frozen=True)
class Row:
    """One picture: mean distance [m] of the model with nothing fitted, raw and after one rigid
    motion; of what the other pictures predict, by which way, and of the scenarios' means whatever
    they gain, with the softness that serves the other pictures best; and of the best scenario of
    all. Inside: share of the points seen that are in the intervals the rod's other pictures ask
    for. Parts: of the model with nothing fitted, mean distance [m] in the first `FIRST`, the rest
    that lies and what hangs, and their shares of the squares."""

    rod: str
    pattern: str
    believed_raw: float
    believed: float
    left_out_raw: float
    left_out: float
    way: str
    means: dict[str, float]
    best: float
    best_scenario: str
    uncertainty: float
    inside: float
    parts: MissesByPart

    def as_dict(self) -> dict:
        out = asdict(self)
        out["parts"]["mean"] = [v if np.isfinite(v) else None for v in self.parts.mean]
        return out


@dataclass(frozen=True)
class Verdict:
    """What the pictures of one rod say.

    Attributes:
        rod: its name; scenarios: by name.
        distances: (scenario, picture) mean distance after one rigid motion [m].
        weights: (scenario,) by all pictures; fitted: whether their mean is predicted, otherwise
            the model with nothing fitted; width: half width of an interval that holds `HELD` of
            the points seen, over the spread.
        rows, predicted: per picture, without the pictures of its pattern.
        cameras: per picture, found in the pictures of other patterns; camera: in all.
    """

    rod: str
    scenarios: dict[str, Scenario]
    distances: np.ndarray
    weights: np.ndarray
    fitted: bool
    width: float
    rows: tuple[Row, ...]
    predicted: tuple[LaidRod, ...]
    cameras: tuple[OverheadCamera, ...]
    camera: OverheadCamera


def judge(photographs: list[LaidPhotograph], laid: Deployments, drawn: int | None) -> list[Verdict]:
    """Lay every rod in every scenario, or in the believed one only (`drawn` None), and compare with
    its pictures.

    A picture is predicted without the pictures of its pattern, of any rod: camera, weights of the
    scenarios, their softness and whether their mean is taken come from the other patterns.
    """
    scenarios = {rod: scenarios_of(rod, drawn) for rod in sorted({p.rod for p in photographs})}
    laid.prepare([(p, "int", scenarios[p.rod]) for p in photographs])
    rods = [laid.of(p, "int", scenarios[p.rod]) for p in photographs]
    believed = [one[believed_scenario(p.rod)] for p, one in zip(photographs, rods, strict=True)]
    patterns = sorted({p.pattern_name for p in photographs})
    begun = laid.map(begin, list(zip(photographs, believed, strict=True)))
    told = list(zip(photographs, believed, begun, strict=True))
    *found, camera = laid.map(_camera, [(told, name) for name in (*patterns, None)])
    cameras = dict(zip(patterns, found, strict=True))
    columns = laid.map(
        _column,
        [
            (p, list(one.values()), cameras[p.pattern_name])
            for p, one in zip(photographs, rods, strict=True)
        ],
    )
    cases = [
        _Case(p, tuple(one.values()), tuple(scenarios[p.rod].values()), column[:, 0], column[:, 1],
              list(scenarios[p.rod]).index(believed_scenario(p.rod)), cameras[p.pattern_name])
        for p, one, column in zip(photographs, rods, columns, strict=True)
    ]  # fmt: skip
    # Costs (pattern, way) of predictions without a pattern's pictures and without each's own.
    costs = dict(
        zip([None, *patterns],
            laid.map(_costs, [(cases, name) for name in (None, *patterns)]), strict=True)
    )  # fmt: skip
    verdicts = []
    for rod, names in scenarios.items():
        own = [case for case in cases if case.photograph.rod == rod]
        missed = [_missed(own, case) for case in own]
        rows, predicted = [], []
        for case, (off, wide) in zip(own, missed, strict=True):
            name = case.photograph.pattern_name
            way = WAYS[simplest(costs[name])]
            predicted.append(average(case.rods, case.scenarios, _weights(own, case, way, {name})))
            others = [m for c, m in zip(own, missed, strict=True) if c is not case]
            inside = float((off <= _width(others) * wide).mean())
            means = _means(own, case, costs[name])
            rows.append(_row(case, list(names), predicted[-1], way, means, inside))
        table = np.array([case.distances for case in own]).T
        way = WAYS[simplest(costs[None])]
        verdicts.append(
            Verdict(rod, names, table, _weigh(own, way), way is not None, _width(missed),
                    tuple(rows), tuple(predicted), tuple(case.camera for case in own), camera)
        )  # fmt: skip
    return verdicts


def scenarios_for_optimal(verdict: Verdict) -> dict[str, Scenario]:
    """Scenarios in which the optimal path is laid, the first 5 cm held as the paper's controller
    wants them: the model with nothing fitted, then ones alike in weight, quantiles of the weights.
    """
    names = list(verdict.scenarios)
    # In the order of what they say of the pictures, so that quantiles spread over good and bad.
    order = np.argsort(verdict.distances.mean(axis=1), kind="stable")
    below = np.cumsum(verdict.weights[order])
    at = (np.arange(_OPTIMAL_WORLDS) + 0.5) / _OPTIMAL_WORLDS
    chosen = [names[order[k]] for k in np.minimum(np.searchsorted(below, at), len(names) - 1)]
    first = believed_scenario(verdict.rod)
    out = {first: verdict.scenarios[first]}
    for name in chosen:
        scenario = verdict.scenarios[name]
        key = name if scenario.held else f"{name}, then held"
        while key in out:
            key += " again"
        out[key] = replace(scenario, held=True)
    return out


def scenario_found(verdict: Verdict) -> Scenario:
    """The mean scenario: friction and L_gb by their logarithms, natural curvature as a vector."""
    scenarios, w = list(verdict.scenarios.values()), verdict.weights

    def mean(values):
        return float(w @ np.array(list(values)))

    left = mean(one.curvature * np.cos(one.roll) for one in scenarios)
    up = mean(one.curvature * np.sin(one.roll) for one in scenarios)
    return Scenario(
        float(np.exp(mean(np.log(one.friction) for one in scenarios))),
        float(np.exp(mean(np.log(one.lgb_ratio) for one in scenarios))),
        float(np.hypot(left, up)),
        float(np.arctan2(up, left)),
        held=True,
    )


def distances(
    photograph: LaidPhotograph, one: LaidRod, camera: OverheadCamera
) -> tuple[float, float]:
    """Mean distance [m] raw and after one rigid motion; infinite where the simulation did not get
    there."""
    if not one.reached:
        return np.inf, np.inf
    curve = camera.view(photograph, one.arc_length, one.nodes)
    return raw(photograph, curve).mean, rigid(photograph, curve).mean


@dataclass(frozen=True)
class _Case:
    """One picture with what every scenario lays there, and how far that is [m], where it is and
    after one rigid motion."""

    photograph: LaidPhotograph
    rods: tuple[LaidRod, ...]
    scenarios: tuple[Scenario, ...]
    raw: np.ndarray
    distances: np.ndarray
    believed: int
    camera: OverheadCamera


def _camera(told, without) -> OverheadCamera:
    kept = [one for one in told if one[0].pattern_name != without]
    photographs, rods, begun = ([one[k] for one in kept] for k in range(3))
    try:
        return find_camera(photographs, rods, begun)
    except DataError:
        return OverheadCamera()  # nothing hangs in the few pictures that there are


def _column(photograph, rods, camera) -> np.ndarray:
    """(scenario, 2)"""
    return np.array([distances(photograph, one, camera) for one in rods])


def _weigh(cases, way) -> np.ndarray:
    """(scenario,) weights of a way of predicting by these pictures of a rod; where the way is none,
    the usual ones."""
    if way is None:
        return weigh(np.array([c.distances for c in cases]).T)
    kind, soft = way
    told = np.array([c.raw if kind == PLACED else c.distances for c in cases]).T
    return weigh(told, soft, mixture=kind == MIXTURE, placed=kind == PLACED)


def _weights(own, case, way, without) -> np.ndarray:
    """(scenario,) weights for a picture of a rod, by its pictures of patterns not in `without`."""
    others = [c for c in own if c.photograph.pattern_name not in without]
    if way is None or not others:
        return np.eye(len(case.scenarios))[case.believed]
    return _weigh(others, way)


def _costs(cases, without) -> np.ndarray:
    """(pattern, way) mean distances [m] of the pictures of every pattern but that one, predicted
    without it and their own pattern."""
    out: dict[str, list] = {}
    for case in cases:
        name = case.photograph.pattern_name
        own = [c for c in cases if c.photograph.rod == case.photograph.rod]
        if name == without or len({c.photograph.pattern_name for c in own} - {name, without}) < 1:
            continue
        cost = [_cost(own, case, way, {name, without}) for way in WAYS]
        out.setdefault(name, []).append(heard(np.array(cost)))
    return np.array([np.mean(one, axis=0) for one in out.values()]).reshape(-1, len(WAYS))


def _cost(own, case, way, without) -> float:
    rod = average(case.rods, case.scenarios, _weights(own, case, way, without))
    return distances(case.photograph, rod, case.camera)[1]


def _means(own, case, costs) -> dict[str, float]:
    """Distance [m] of the scenarios' means, each with the softness of the least cost."""
    total = costs.sum(axis=0)
    out = {}
    for kind in KINDS:
        of = [k for k, way in enumerate(WAYS) if way is not None and way[0] == kind]
        way = WAYS[min(of, key=lambda k: total[k])]
        out[kind] = _cost(own, case, way, {case.photograph.pattern_name})
    return out


def _missed(own, case) -> tuple[np.ndarray, np.ndarray]:
    """Of every point seen: how far the model with nothing fitted misses it, and the spread there of
    the scenarios that the rod's other pictures allow and the picture's own uncertainty [m]."""
    p = case.photograph
    mixture = _weights(own, case, (MIXTURE, 1e-3), {p.pattern_name})
    # So little weight that the believed scenario is among them whatever the pictures say.
    mixture[case.believed] += 1e-5 * mixture.max()
    s, lines, weights = aligned(case.rods, case.scenarios, mixture)
    line = average(case.rods, case.scenarios, np.eye(len(case.scenarios))[case.believed])
    wide = spread(lines[:, :, :2], weights, line.nodes[:, :2])
    placed = rigid(p, case.camera.view(p, line.arc_length, line.nodes))
    at = foot(p, placed, line.arc_length)
    return placed.distance, np.hypot(np.interp(at, s, wide), p.uncertainty)


def _width(missed) -> float:
    """Half width, over the spread, of intervals that hold `HELD` of the points seen, every picture
    counting as much."""
    if not missed:
        return np.inf
    ratio = np.concatenate([off / wide for off, wide in missed])
    share = np.concatenate([np.full(len(off), 1.0 / len(off)) for off, _ in missed])
    order = np.argsort(ratio)
    below = np.cumsum(share[order]) / share.sum()
    return float(ratio[order][np.searchsorted(below, HELD)])


def _row(case, names, predicted, way, means, inside) -> Row:
    p = case.photograph
    return Row(
        p.rod,
        p.pattern_name,
        *distances(p, case.rods[case.believed], case.camera),
        *distances(p, predicted, case.camera),
        "nothing fitted" if way is None else f"{way[0]}, {1e3 * way[1]:g} mm",
        means,
        float(case.distances.min()),
        names[int(case.distances.argmin())],
        float(np.median(p.uncertainty)),
        inside,
        _parts(p, case.rods[case.believed], case.camera),
    )


def _parts(photograph, one, camera) -> MissesByPart:
    placed = rigid(photograph, camera.view(photograph, one.arc_length, one.nodes))
    return parts_of(photograph, placed, one.arc_length, one.nodes, FIRST)
