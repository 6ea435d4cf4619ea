"""Pulling a knot tight with both hands."""

from __future__ import annotations

import numpy as np

from wrod.tying_course import Course
from wrod.tying_moves import approach, grasp
from wrod.workbench import Poses

_SETTLE = 0.4  # [s]


def pull(course: Course) -> None:
    """Both hands grasp where the rods' ends are put down, and pull until the load is there."""
    bench, knot = course.bench, course.knot
    heights = [course.plans[one.rod][1].radius for one in knot.pull]
    approach(course, {h: np.array([*one.where, heights[h]]) for h, one in enumerate(knot.pull)})
    begin = since = bench.time
    way = np.zeros((len(course.trials), 2))
    going = np.ones(len(course.trials), dtype=bool)
    starts = [np.array([*one.where, 0.0]) for one in knot.pull]
    for one, start in zip(knot.pull, starts, strict=True):
        start[2] = course.plans[one.rod][1].radius
    directions = [np.array([*one.direction, 0.0]) for one in knot.pull]
    directions = [d / np.linalg.norm(d) for d in directions]

    far = np.array([one.distance for one in knot.pull])
    speed = 0.5 * course.hand_speed * far / far.max()

    def at(t: float) -> np.ndarray:
        return way + going[:, None] * speed * (t - since)

    def poses(t: float) -> list[Poses]:
        here = at(t)
        return [
            course.hand_pose(h, starts[h] + here[:, h, None] * directions[h], 0.0) for h in range(2)
        ]

    for hand, one in enumerate(knot.pull):
        grasp(course, hand, one, "pull", poses(begin)[hand])
        course.closed[hand] = True
    load = np.zeros((len(course.trials), 2))

    def after() -> None:
        nonlocal load, way, since
        load = bench.load()
        way, since = at(bench.time), bench.time
        going[(load.min(axis=1) >= knot.load) | (way[:, 0] >= far[0])] = False
        watch()

    watch = course.watch(poses, "pull")
    longest = max(one.distance for one in knot.pull) / (0.5 * course.hand_speed)
    while bench.time < begin + longest and going.any():
        bench.run(bench.time + 0.4, poses, after)
    bench.run(bench.time + _SETTLE, poses, watch)
    load = bench.load()
    for result, forces in zip(course.results, load, strict=True):
        result.load = forces
    course.now = poses(bench.time)
