"""Courses of deployments of a bench: side by side on a GPU, in processes on a CPU."""

from collections.abc import Callable, Sequence
from typing import Any

from wrod import side_by_side


def run(
    course: Callable[..., Any],
    jobs: Sequence[tuple],
    done: Callable[[tuple, Any], object],
    *,
    device: str,
    workers: int = 1,
    **options,
) -> None:
    """Tell `done` every job, and the result of its course, as they end.

    Args:
        course: of a module, so that other processes can import it: `course(*job)` is a
            `wrod.deployment.together.Course`.
        jobs: its arguments.
        done: called in this process.
        device: where rods are laid.
        workers: processes, on a CPU.
        options: of `wrod.deployment.together.follow`.
    """
    from wrod.deployment.together import follow

    if device == "cpu":
        asked = [(course, job, options) for job in jobs]
        for (_, job, _), result in side_by_side.run(_alone, asked, workers):
            done(job, result)
        return

    def noted(job: tuple):
        done(job, (yield from course(*job)))

    follow([noted(job) for job in jobs], device=device, **options)


def _alone(course: Callable[..., Any], job: tuple, options: dict) -> Any:
    from wrod.deployment.together import follow

    return follow([course(*job)], device="cpu", **options)[0]
