"""Files: those that come in are checked by one reader, those that go out are whole or not there.

Everything may import this room; it imports the errors alone.
"""

from wrod.files.arrays import read_arrays, read_tensors
from wrod.files.reading import (
    checked_path,
    decode_json,
    decode_labels,
    read_bytes,
    read_json,
    read_text,
)
from wrod.files.writing import write_atomically

__all__ = [
    "checked_path",
    "decode_json",
    "decode_labels",
    "read_arrays",
    "read_bytes",
    "read_json",
    "read_tensors",
    "read_text",
    "write_atomically",
]
