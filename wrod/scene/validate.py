"""OpenUSD's own checks of a stage."""

from __future__ import annotations

import os

from wrod.errors import SceneError


def open_stage(path: str | os.PathLike[str]):
    """Open a stage.

    Raises:
        SceneError: there is no such file, or it is not a USD stage.
    """
    from pxr import Tf, Usd

    if not os.path.isfile(path):
        raise SceneError(f"{path}: no such file; give a .usdc, .usda or .usd stage")
    try:
        return Usd.Stage.Open(os.fspath(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise SceneError(f"{path}: not a readable USD stage ({reason})") from error


def validation_errors(path: str | os.PathLike[str]) -> list[str]:
    """Everything that OpenUSD's validators say about a stage, empty where it is in order."""
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    return [
        f"{error.GetErrorAsString()}".strip() or str(error.GetName())
        for error in context.Validate(open_stage(path))
    ]
