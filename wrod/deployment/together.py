"""Courses of deployments side by side: what several ask for at a time is laid in one batch.

A course is a generator: it yields what it wants laid (`Asked`), is sent what lies, and returns its
result. A GPU takes as long for hundreds of rods as for one, so that courses of many plans go on in
step there; a CPU takes one course after the other.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from wrod import arguments
from wrod.deployment.discretisation import USUAL, Discretisation
from wrod.deployment.remembered import LastDeployments
from wrod.deployment.simulate import Trial, nodes_needed
from wrod.deployment.tangents import Directions, Laid, lay
from wrod.rods.device import resolve_device

T = TypeVar("T")


@dataclass(frozen=True)
class Asked:
    """Rods that a course wants laid.

    Attributes:
        trials: what to lay.
        directions: of each trial, all with the same number of columns; None: no derivatives.
        remembered: deployments of each trial from which it may go on: on a CPU it does. A GPU takes
            as long for one rod as for hundreds.
        how: options of `lay`. Rods whose discretisation has a node count are laid with those that
            have the same alone; of others a batch has the largest that any of them needs.
    """

    trials: list[Trial]
    directions: list[Directions] | None = None
    how: dict[str, Any] = field(default_factory=dict)
    remembered: list[LastDeployments] | None = None


Course = Generator[Asked, list[Laid], T]


def follow(
    courses: Sequence[Course[T]],
    *,
    device: arguments.DeviceLike = "cpu",
    progress: Callable[[int], object] | None = None,
    **options,
) -> list[T]:
    """The results of courses, which go on side by side on a GPU and one by one on a CPU.

    Args:
        courses: what to follow.
        device: "cpu", "cuda:0" or "auto".
        progress: called with the number of courses that have ended since the last call.
        options: of `wrod.deployment.tangents.lay`, for all that do not ask for another.
    """
    device = resolve_device(device)
    results: dict[int, T] = {}
    size = 1 if device == "cpu" else max(len(courses), 1)
    for first in range(0, len(courses), size):
        answers: dict[int, Any] = dict.fromkeys(range(first, min(first + size, len(courses))))
        asked: dict[int, Asked] = {}
        while answers or asked:
            before = len(asked) + len(answers)
            for k, answer in answers.items():
                try:
                    asked[k] = courses[k].send(answer)
                except StopIteration as end:
                    results[k] = end.value
            if progress is not None and len(asked) < before:
                progress(before - len(asked))
            # Those that are few wait until others ask for the like.
            groups = sorted(_groups(asked), key=len)
            chosen = {k: asked.pop(k) for k in groups[-1]} if groups else {}
            answers = _laid(chosen, {"device": device, **options})
    return [results[k] for k in range(len(courses))]


def _groups(asked: dict[int, Asked]) -> list[list[int]]:
    """Courses that can be laid in one batch: those that agree on how, and on whether they want
    derivatives, but for the length of their edges and the time of their release."""
    groups: dict[tuple, list[int]] = {}
    for k, one in asked.items():
        how = {"discretisation": USUAL, **one.how, "release": None}
        how["discretisation"] = replace(how["discretisation"], spacing=USUAL.spacing)
        # A field of friction is that very one.
        known = (str, float, int, Discretisation, type(None))
        said = {n: v if isinstance(v, known) else id(v) for n, v in how.items()}
        key = (one.directions is None, *sorted(said.items()))
        groups.setdefault(key, []).append(k)
    return list(groups.values())


def _laid(asked: dict[int, Asked], options: dict[str, Any]) -> dict[int, list[Laid]]:
    """What lies of what each course asked for: one batch for all that can be."""
    answers: dict[int, list[Laid]] = {}
    for members in _groups(asked):
        ones = [asked[k] for k in members]
        trials = [trial for one in ones for trial in one.trials]
        directions = None
        if ones[0].directions is not None:
            every = [d for one in ones for d in one.directions or ()]
            most = max(map(len, every))
            directions = [_padded(d, most) for d in every]
        meshes = [one.how.get("discretisation", USUAL) for one in ones]
        nodes = meshes[0].node_count or max(
            nodes_needed(one.trials, mesh.spacing, mesh.laid)
            for one, mesh in zip(ones, meshes, strict=True)
        )
        given = {**options, **ones[0].how, "discretisation": replace(meshes[0], node_count=nodes)}
        known = ones[0].remembered if len(ones) == 1 else None
        if known is not None and given["device"] == "cpu":
            given["remembered"] = known
        given["release"] = [one.how.get("release") for one in ones for _ in one.trials]
        laid = lay(trials, directions, **given)
        for k, one in zip(members, ones, strict=True):
            answers[k], laid = laid[: len(one.trials)], laid[len(one.trials) :]
            if one.directions is not None:
                answers[k] = [
                    replace(x, tangent=x.tangent[: len(d)])
                    for x, d in zip(answers[k], one.directions, strict=True)
                ]
    return answers


def _padded(columns: Directions, count: int) -> Directions:
    """With so many columns, the last of which change nothing."""
    more = count - len(columns)
    none = Directions.of_path(np.zeros((more, *columns.path.shape[1:])))
    return columns + none if more else columns
