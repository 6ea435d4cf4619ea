"""Errors and warnings: one clear sentence each, saying what, where and what to do.

The command line turns every `WrodError` into that sentence and exit code 2; the API raises it.
"""

import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

# Beginnings of the names of environment variables that are not the library's own name.
_PREFIXES = {"numpy": ("NUMPY", "NPY"), "matplotlib": ("MPL",), "cv2": ("OPENCV",)}
# Modules that a base install lacks, and the extra that brings each.
EXTRAS = {
    "torch": "train",
    "pytorch_kinematics": "robot",
    "ruckig": "robot",
    "trimesh": "robot",
    "collada": "robot",
    "pxr": "scene",
    "newton": "newton",
    "viser": "view",
    "cv2": "perception",
    "PIL": "perception",
    "skimage": "perception",
    "networkx": "perception",
    "ezdxf": "drawings",
    "svgelements": "drawings",
    "mcap": "mcap",
    "gymnasium": "gym",
    "coal": "meshes",
    "xacro": "meshes",
    "mujoco": "peers",
    "cosseratbench": "peers",
    "elastica": "peers",
    "numba": "peers",
}


def blamed_variables(error: BaseException) -> str | None:
    """The sentence for an error of a library that has environment variables of its own set, or a
    file of settings here, which it reads when it is loaded or first called; None if there is none.
    """
    frames = [
        frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(error.__traceback__)
    ]
    library = str(frames[-1] if frames else "").partition(".")[0]
    if library == "wrod":  # compiled libraries have no frames of their own
        library = type(error).__module__.partition(".")[0]
    prefixes = _PREFIXES.get(library, (library.upper(),))
    found = [f"{k}={v!r:.80}" for k, v in os.environ.items() if k.partition("_")[0] in prefixes]
    if library == "matplotlib" and os.path.exists("matplotlibrc"):
        found.append("./matplotlibrc")  # before all others
    if not found or library in ("wrod", "builtins"):
        return None
    return (
        f"{library} stops with {type(error).__name__}: {str(error)[:300]}; it reads "
        f"{', '.join(found[:5])}: unset what it cannot mean"
    )


class WrodError(ValueError):
    """Base of every error that wrod raises for input it cannot use."""


class RodError(WrodError):
    """A rod property that is unknown or not physical."""


class PatternError(WrodError):
    """A pattern that cannot be read, is degenerate, or does not fit the rod."""


class GraspError(WrodError):
    """Grasp inputs outside what can be solved, or grasps that did not converge."""


class PerceptionError(WrodError):
    """A picture from which no trustworthy centreline can be taken."""


class RobotError(WrodError):
    """A robot description, placement or path that the arm cannot follow."""


class SceneError(WrodError):
    """A scene that cannot be written or read."""


class DataError(WrodError):
    """A data file that is truncated, foreign or inconsistent."""


class MissingExtraError(WrodError, ModuleNotFoundError):
    """A package that one of the extras brings is not installed."""

    def __init__(self, module: str):
        super().__init__(
            f"this needs {module}; install it with: pip install 'wrod[{EXTRAS[module]}]'"
        )
        self.name = module

    @classmethod
    def of(cls, error: ModuleNotFoundError) -> "MissingExtraError | None":
        """What Python's error is where an extra brings the module; None where none does."""
        module = (error.name or "").partition(".")[0]
        return cls(module) if module in EXTRAS else None


class WrodWarning(UserWarning):
    """Base of every warning: the result stands, with the reservation that is named."""


class OutOfRangeWarning(WrodWarning):
    """The neural controller was asked outside the range that it was trained on."""


class StabilityWarning(WrodWarning):
    """A plan comes close to an elastic instability."""


@contextmanager
def retold_as(error: type[WrodError]) -> Iterator[None]:
    """What a library refuses within, by a TypeError or a ValueError, is an `error`."""
    try:
        yield
    except (TypeError, ValueError) as refused:
        raise error(str(refused)) from None


@contextmanager
def within_precision() -> Iterator[None]:
    """A matrix within, or in the function that it decorates, that cannot be solved is a
    `DataError`: which numbers of the input lie too far apart is known to no single check."""
    try:
        yield
    except Exception as error:
        said = unsolved(error)
        if said is None:
            raise
        raise DataError(said) from error


def unsolved(error: BaseException) -> str | None:
    """The sentence for a singular matrix of NumPy's, SciPy's or torch's; None for others."""
    if not type(error).__name__.endswith("LinAlgError"):
        return None
    return (
        f"numbers of the input lie too far apart for double precision ({error}); check its units, "
        "and give less extreme ones"
    )


@contextmanager
def needed_extras() -> Iterator[None]:
    """A package of an extra that is not found within, or in the function that it decorates, is a
    `MissingExtraError`."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = MissingExtraError.of(error)
        if missing is None or isinstance(error, MissingExtraError):
            raise
        raise missing from error
