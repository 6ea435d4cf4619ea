"""Networks that were trained, with what they say of themselves: in memory and in files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from wrod.arguments import checked, shown
from wrod.errors import DataError
from wrod.files import check_arrays, decode_labels, read_tensors, schemas, write_tensors
from wrod.records import frozen, plain


class Trained:
    """Weights and metadata, which fit together and are this object's own.

    Args:
        parameters: arrays by name, as docs/formats.md has them of its kind.
        metadata: plain JSON values, as docs/formats.md has them of its kind.
        source: what to call it in messages.

    Raises:
        DataError: they are not as docs/formats.md has them, or do not fit together.
    """

    # Schemas of the metadata and of the weights by that name, and the command that writes it.
    kind: ClassVar[str]
    writer: ClassVar[str]

    @checked(DataError)
    def __init__(self, parameters: dict[str, np.ndarray], metadata: dict, source: str = ""):
        kind, source = self.kind, source or self.kind
        if not isinstance(parameters, dict) or not all(isinstance(k, str) for k in parameters):
            raise DataError(f"{source}: parameters are {shown(parameters)}; give arrays by name")
        label = plain(metadata, f"{source}: metadata") | {"format": f"wrod-{kind.lower()}-1"}
        label.pop("sha256", None)
        schema, what = getattr(schemas, kind), self._what()
        self.metadata: dict[str, Any] = decode_labels(json.dumps(label), schema, source, what)
        self._parameters = {
            name: frozen(np.asarray(value))
            for name, value in check_arrays(parameters, kind, source).items()
        }
        try:
            with np.errstate(all="ignore"):
                self._settle()
                whole = all(np.isfinite(one).all() for one in self._probe())
        except (AttributeError, KeyError, TypeError, ValueError, IndexError):
            whole = False
        if not whole:
            raise DataError(
                f"{source}: its weights or metadata do not fit together; {self.writer} it again"
            )

    @classmethod
    def _what(cls) -> str:
        return f"a {cls.kind.lower()} that `wrod {cls.writer}` wrote"

    @classmethod
    def _read(cls, path: str | os.PathLike[str]):
        label, parameters = read_tensors(path, cls._what())
        metadata = decode_labels(label, getattr(schemas, cls.kind), str(path), cls._what())
        return cls(parameters, metadata, str(path))

    def _settle(self) -> None:
        """Read from metadata and weights what is asked for often."""

    def _probe(self) -> tuple[np.ndarray, ...]:
        """What it says of some input; raises ValueError where that has another shape."""
        raise NotImplementedError

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write weights and metadata as safetensors."""
        return write_tensors(path, self.metadata, self._parameters)
