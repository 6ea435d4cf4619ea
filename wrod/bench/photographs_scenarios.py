"""The scenarios that `wrod bench photographs` tries."""

import numpy as np
from scipy.stats import norm, qmc

from wrod.bench.table3_paper import friction
from wrod.identification.laid.scenario import Scenario

HELD_FRICTIONS = (0.3, 0.4, 0.6)
# Excess below the grip that the free end's places and the waves of the lines ask for [m].
_EXCESS = {"rope": (0.03, 0.01, 0.05)}
_EXCESS_VPS = (0.012, 0.004, 0.022)
# A rope hardly stretches: its radius for stretching is half, its stretch a quarter of a solid's.
_RADIUS_RATIO = {"rope": 0.5}


# Of the drawn scenarios: range of friction, standard deviation of the logarithm of L_gb's ratio,
# largest natural curvature [1/m], and excess [m] of the rods that stretch and of the rope.
_FRICTION, _LOG_LGB, _CURVATURE = (0.2, 0.7), 0.08, 3.0
_DRAWN_EXCESS = {"rope": (-0.005, 0.05)}
_DRAWN_EXCESS_VPS = (-0.005, 0.03)
_SEED = 0


def scenarios_of(rod: str, drawn: int | None = 0) -> dict[str, Scenario]:
    """The scenarios by name: the free end held as in all simulations before, or hung and let go;
    and as many drawn as asked for, half of them held. With None the believed one only."""
    if drawn is None:
        return {believed_scenario(rod): straight_held()[believed_scenario(rod)]}
    much = _EXCESS.get(rod, _EXCESS_VPS)
    thin = _RADIUS_RATIO.get(rod, 1.0)

    def hung(mu=0.3, lgb=1.0, curvature=2.0, roll=0.0, excess=much[0]):
        return Scenario(mu, lgb, curvature, roll, excess, thin)

    return (
        straight_held()
        | {
            "hung": hung(),
            "hung, friction 0.5": hung(mu=0.5),
            "hung, L_gb x 1.12": hung(lgb=1.12),
            "hung, curved to the right": hung(roll=float(np.pi)),
            "hung, less excess": hung(excess=much[1]),
            "hung, more excess": hung(excess=much[2]),
            "hung, hardly curved": hung(curvature=0.5),
            "hung, friction 0.2": hung(mu=0.2),
        }
        | _drawn(rod, drawn)
    )


def _drawn(rod: str, count: int) -> dict[str, Scenario]:
    """Scenarios spread evenly (a scrambled Sobol sequence, the same for every rod and pattern) over
    what may differ: friction, L_gb, natural curvature and how it is rolled, excess."""
    if count == 0:
        return {}
    unit = qmc.Sobol(5, seed=_SEED).random(count)
    low, high = np.log(_FRICTION)
    shortest, longest = _DRAWN_EXCESS.get(rod, _DRAWN_EXCESS_VPS)
    scenarios = {}
    for k, (mu, lgb, curvature, roll, excess) in enumerate(unit):
        held = k % 2 == 0
        scenarios[f"drawn {k}, {'held' if held else 'hung'}"] = Scenario(
            float(np.exp(low + (high - low) * mu)),
            float(np.exp(_LOG_LGB * norm.ppf(lgb))),
            float(_CURVATURE * curvature),
            float(2.0 * np.pi * (roll - 0.5)),
            # Where the free end is held, what hangs too low is no excess behind the start.
            0.0 if held else float(shortest + (longest - shortest) * excess),
            _RADIUS_RATIO.get(rod, 1.0),
            held,
        )
    return scenarios


def straight_held() -> dict[str, Scenario]:
    """The straight rod on tables of several frictions, the free end held: as table 3 is laid."""
    return {f"held, friction {mu:g}": Scenario(mu, held=True) for mu in HELD_FRICTIONS}


def believed_scenario(rod: str) -> str:
    """Name of the scenario of the model with nothing fitted: the fabric's friction in the table's
    words, the free end held."""
    return f"held, friction {friction(rod, 'fabric'):g}"
