"""What a line of a campaign's file holds: a schema each, as those of `wrod.files.schemas`."""

from typing import Annotated, Any

from msgspec import Meta, field

from wrod.files.schemas import Count, Name, _Open


class CampaignRow(_Open, frozen=True):
    """A trial of a campaign (a line of its trials.jsonl), beside what tells which it is."""

    diverged: bool
    steps: Count


class Table3Row(CampaignRow, frozen=True):
    """A trial of `wrod bench table3`: figures in cm, and the laid curve in m."""

    error_mean: float
    error_std: float
    released_error_mean: float
    released_error_std: float
    slip: float
    curve: Annotated[list[tuple[float, float]], Meta(max_length=10_000)]


class ApplicationsRow(_Open, frozen=True):
    """A trial of `wrod bench applications`."""

    case: Name
    method: Name
    trial: Count
    success: bool
    why: str
    cpu_seconds: float
    steps: Count
    curves: dict[str, list[list[list[float]]]]


class HiddenRow(_Open, frozen=True):
    """A set of `wrod bench identify --hidden`."""

    set: Name
    seed: Count
    noise: Name
    outcome: Name


class SlipperyRow(_Open, frozen=True):
    """A trial of `wrod bench slippery`: figures in cm, and the laid curve in m."""

    rod: Name
    pattern: Name
    method: Name
    engine: Name
    friction: float
    error_mean: float
    error_robot: float
    error_std: float
    curve: Annotated[list[tuple[float, float]], Meta(max_length=10_000)]


class FeedbackRow(_Open, frozen=True):
    """A trial of `wrod bench feedback`; the error is in cm."""

    effect: Name
    way: Name
    error_mean: float


class FoldRow(_Open, frozen=True):
    """A fold of `wrod bench cables`: errors of each recording that was left out, in mm."""

    rod: Name
    fold: Count
    undamped_mm: float
    base_mm: Annotated[dict[str, float], Meta(min_length=1)]
    after_mm: Annotated[dict[str, float], Meta(min_length=1)]
    rounds: list[dict[str, Any]]
    effects: list[str]
    values: list[float]
    confounded: list[Any]


class StepRow(_Open, frozen=True):
    """A step of an identification of motion that was computed."""

    step: Name
    found: dict[str, Any]


class LaidRow(_Open, frozen=True):
    """A rod that `wrod bench photographs` laid in simulation."""

    scenario: Name
    arc_length: list[float]
    nodes: list[list[float]]
    reached: bool


class LaidPlanRow(_Open, frozen=True):
    """A plan that `wrod bench photographs` made and laid; [cm], none where that failed."""

    plan: Name
    error_cm: float | None


class CosseratRow(_Open, frozen=True):
    """A run of `wrod bench cosserat`."""

    experiment: Name
    solver: Name
    elements: Count
    said: Annotated[str, Meta(max_length=1000)]
    seconds: Annotated[float, Meta(ge=0.0, le=1e9)]
    simulated: Annotated[float, Meta(gt=0.0, le=1e9)] = 1.0
    metrics: Annotated[dict[str, Any], Meta(max_length=1000)] = field(default_factory=dict)


class CosseratRows(_Open, frozen=True):
    """What `wrod bench cosserat --json` prints."""

    rows: Annotated[list[CosseratRow], Meta(max_length=10_000)]


class ArmsRow(_Open, frozen=True):
    """A joint path of `wrod bench robot`."""

    cpu: float
    position_mm: float
    rotation_deg: float
    limit_margin: float
    gap_mm: float
    turn: float
    step: float
    beyond: float
    duration: float
    hangs: float
    no_approach: str | bool | None
    stand_stays: bool | None


class ArmsRefused(_Open, frozen=True):
    """A case of `wrod bench robot` that ended without a joint path."""

    error: str
