"""What photographs say of the scenarios of `wrod bench photographs`, and what they predict."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from wrod.bench.photographs_deployments import Deployments
from wrod.bench.photographs_scenarios import believed_scenario, scenarios_of
from wrod.errors import DataError
from wrod.identification.laid.camera import OverheadCamera, find_camera
from wrod.identification.laid.choice import average, shrinkage, weigh
from wrod.identification.laid.photographs import LaidPhotograph
from wrod.identification.laid.placement import Parts, parts_of, raw, rigid
from wrod.identification.laid.scenario import LaidRod, Scenario

# How far a prediction goes from the model with nothing fitted to the mean of the scenarios.
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_OPTIMAL_WORLDS = 6
# Of the start, by itself [m].
FIRST = 0.22


@dataclass(frozen=True)
class Row:
    """One picture: mean distance [m] of the model with nothing fitted, raw and after one rigid
    motion; of what the other pictures predict; of the scenarios weighted by the rod's other
    pictures with nothing held back; and of the best scenario of all. Parts: of the model with
    nothing fitted, mean distance [m] in the first `FIRST`, the rest that lies and what hangs, and
    their shares of the squares."""

    rod: str
    pattern: str
    believed_raw: float
    believed: float
    left_out_raw: float
    left_out: float
    share: float
    averaged: float
    best: float
    best_scenario: str
    uncertainty: float
    parts: Parts

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
        weights: (scenario,) by all pictures; share: of their mean in a prediction, the rest of it
            the model with nothing fitted.
        rows, predicted: per picture, without the pictures of its pattern.
        cameras: per picture, found in the pictures of other patterns; camera: in all.
    """

    rod: str
    scenarios: dict[str, Scenario]
    distances: np.ndarray
    weights: np.ndarray
    share: float
    rows: tuple[Row, ...]
    predicted: tuple[LaidRod, ...]
    cameras: tuple[OverheadCamera, ...]
    camera: OverheadCamera


def judge(photographs: list[LaidPhotograph], laid: Deployments, drawn: int | None) -> list[Verdict]:
    """Lay every rod in every scenario, or in the believed one only (`drawn` None), and compare with
    its pictures.

    A picture is predicted without the pictures of its pattern, of any rod: camera, weights of the
    scenarios and the share of their mean come from the other patterns.
    """
    scenarios = {rod: scenarios_of(rod, drawn) for rod in sorted({p.rod for p in photographs})}
    laid.prepare([(p, "int", scenarios[p.rod]) for p in photographs])
    rods = [laid.of(p, "int", scenarios[p.rod]) for p in photographs]
    believed = [one[believed_scenario(p.rod)] for p, one in zip(photographs, rods, strict=True)]
    patterns = sorted({p.pattern_name for p in photographs})
    cameras = {name: _camera(photographs, believed, name) for name in patterns}
    camera = _camera(photographs, believed, None)
    columns = laid.map(
        _column,
        [
            (p, list(one.values()), cameras[p.pattern_name])
            for p, one in zip(photographs, rods, strict=True)
        ],
    )
    cases = [
        _Case(p, tuple(one.values()), tuple(scenarios[p.rod].values()), column,
              list(scenarios[p.rod]).index(believed_scenario(p.rod)), cameras[p.pattern_name])
        for p, one, column in zip(photographs, rods, columns, strict=True)
    ]  # fmt: skip
    # Costs (case, share) of predictions without a pattern's pictures and without the case's own.
    costs = dict(
        zip([None, *patterns],
            laid.map(_costs, [(cases, name) for name in (None, *patterns)]), strict=True)
    )  # fmt: skip
    verdicts = []
    for rod, names in scenarios.items():
        own = [case for case in cases if case.photograph.rod == rod]
        rows, predicted = [], []
        for case in own:
            share = SHARES[shrinkage(costs[case.photograph.pattern_name])]
            weights = _weights(own, case, share, {case.photograph.pattern_name})
            full = _weights(own, case, 1.0, {case.photograph.pattern_name})
            predicted.append(average(case.rods, case.scenarios, weights))
            rows.append(_row(case, list(names), predicted[-1], share, full))
        table = np.array([case.distances for case in own]).T
        verdicts.append(
            Verdict(rod, names, table, weigh(table), SHARES[shrinkage(costs[None])], tuple(rows),
                    tuple(predicted), tuple(case.camera for case in own), camera)
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
    """One picture with what every scenario lays there, and how far that is [m]."""

    photograph: LaidPhotograph
    rods: tuple[LaidRod, ...]
    scenarios: tuple[Scenario, ...]
    distances: np.ndarray
    believed: int
    camera: OverheadCamera


def _camera(photographs, believed, without) -> OverheadCamera:
    kept = [k for k, p in enumerate(photographs) if p.pattern_name != without]
    try:
        return find_camera([photographs[k] for k in kept], [believed[k] for k in kept])
    except DataError:
        return OverheadCamera()  # nothing hangs in the few pictures that there are


def _column(photograph, rods, camera) -> np.ndarray:
    return np.array([distances(photograph, one, camera)[1] for one in rods])


def _weights(own, case, share, without) -> np.ndarray:
    """(scenario,) weights for a picture of a rod, by its pictures of patterns not in `without`."""
    heard = [c.distances for c in own if c.photograph.pattern_name not in without]
    weights = share * weigh(np.array(heard).T) if heard else np.zeros(len(case.scenarios))
    weights[case.believed] += 1.0 - weights.sum()
    return weights


def _costs(cases, without) -> np.ndarray:
    """(case, share) distances [m] of every picture not of that pattern, predicted without it and
    its own pattern."""
    out = []
    for case in cases:
        name = case.photograph.pattern_name
        own = [c for c in cases if c.photograph.rod == case.photograph.rod]
        if name == without or len({c.photograph.pattern_name for c in own} - {name, without}) < 1:
            continue
        out.append(
            [
                distances(
                    case.photograph,
                    average(case.rods, case.scenarios, _weights(own, case, share, {name, without})),
                    case.camera,
                )[1]
                for share in SHARES
            ]
        )
    return np.array(out).reshape(-1, len(SHARES))


def _row(case, names, predicted, share, full) -> Row:
    p = case.photograph
    return Row(
        p.rod,
        p.pattern_name,
        *distances(p, case.rods[case.believed], case.camera),
        *distances(p, predicted, case.camera),
        share,
        distances(p, average(case.rods, case.scenarios, full), case.camera)[1],
        float(case.distances.min()),
        names[int(case.distances.argmin())],
        float(np.median(p.uncertainty)),
        _parts(p, case.rods[case.believed], case.camera),
    )


def _parts(photograph, one, camera) -> Parts:
    placed = rigid(photograph, camera.view(photograph, one.arc_length, one.nodes))
    return parts_of(photograph, placed, one.arc_length, one.nodes, FIRST)
