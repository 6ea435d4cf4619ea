"""What an identification of motion has computed, in a file, so that one that was stopped goes on.

What is computed next depends on what came before alone, so one that begins anew finds its way
through what is remembered at once.
"""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from wrod import __version__
from wrod.errors import DataError
from wrod.files import row_schemas
from wrod.files.ledger import Ledger
from wrod.identification.motion.data import MotionMeasurements


class KnownSteps:
    """Arrays by what they were computed from.

    Args:
        path: of the file.
        measurements: of all that is in it.

    Raises:
        DataError: the file was begun with other measurements, or by another version of wrod, or
            is damaged, or cannot be written.
    """

    def __init__(self, path: Path, measurements: MotionMeasurements):
        m, hashed = measurements, hashlib.sha256()
        for part in (m.positions, m.gap, m.fit, m.validation, m.test, m.rate, m.gravity):
            hashed.update(np.ascontiguousarray(part).tobytes())
        settings = {"data": hashed.hexdigest(), "version": __version__}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(f"{path.parent} is not to be written to")
        except OSError as reason:
            raise DataError(f"{path}: cannot be kept ({reason}); choose another place") from None
        self._ledger = Ledger(
            path, settings, ("step",), "identification-steps", row_schemas.StepRow
        )
        self._known = {row["step"]: row["found"] for row in self._ledger.rows}

    def recall(self, key: list, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `work` returns, which is called where nothing is known by that key."""
        step = hashlib.sha256(json.dumps(key).encode()).hexdigest()
        if step not in self._known:
            found = {k: np.asarray(v).tolist() for k, v in work().items()}
            self._ledger.add([{"step": step, "found": found}])
            self._known[step] = found
        return {k: np.array(v) if isinstance(v, list) else v for k, v in self._known[step].items()}

    def forget(self) -> None:
        """Remove the file: all is done."""
        self._ledger.path.unlink(missing_ok=True)
