"""OpenUSD's own checks of a stage."""

import os
import warnings

from wrod.errors import SceneError, WrodWarning, needed_extras
from wrod.files import checked_path
from wrod.files.reading import MIB, shown

_MOST_BYTES = 512 * MIB


@needed_extras()
def open_stage(path: str | os.PathLike[str]):
    """Open a stage.

    Raises:
        SceneError: there is no such file, or it is not a USD stage.

    Warns:
        WrodWarning: a file or a prim that it is composed of cannot be read.
    """
    from pxr import Tf, Usd, UsdUtils

    checked_path(path, "a .usdc, .usda or .usd stage", error=SceneError, limit=_MOST_BYTES)
    unprinted = UsdUtils.CoalescingDiagnosticDelegate()  # OpenUSD tells in its own words
    try:
        stage = Usd.Stage.Open(os.fspath(path))
    except Tf.ErrorException as error:
        # Its last line is "Error in ... at line ... in file ... : 'what went wrong'".
        try:
            reason = str(error).strip().splitlines()[-1].rpartition(" : ")[2].strip("')\" ")
        except UnicodeError:
            reason = "it holds text that is not UTF-8"
        raise SceneError(
            f"{path}: not a readable USD stage ({shown(reason, 200)}); give a whole .usdc, .usda "
            "or .usdz file, as `wrod plan` writes scene.usdc"
        ) from None
    finally:
        del unprinted
    missing = stage.GetCompositionErrors()
    if missing:
        said = f"{path}: {len(missing)} of what it is composed of cannot be read, and is left out"
        warnings.warn(WrodWarning(f"{said} ({shown(str(missing[0]), 200)})"), stacklevel=2)
    return stage


@needed_extras()
def validation_errors(path: str | os.PathLike[str]) -> list[str]:
    """Everything that OpenUSD's validators say about a stage, empty where it is in order."""
    from pxr import UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    return [
        f"{error.GetErrorAsString()}".strip() or str(error.GetName())
        for error in context.Validate(open_stage(path))
    ]
