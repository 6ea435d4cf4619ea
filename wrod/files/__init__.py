"""Files: those that come in are checked by one reader, those that go out are whole or not there.

Everything may import this room; it imports the errors alone.
"""

from wrod.files.array_checks import check_arrays, read_fields
from wrod.files.arrays import read_arrays, read_tensors, write_tensors
from wrod.files.reading import (
    checked_path,
    decode_json,
    decode_labels,
    read_bytes,
    read_json,
    read_text,
)
from wrod.files.writing import (
    suffixed,
    write_atomically,
    write_csv,
    write_figure,
    write_json,
    write_npz,
    write_text,
)

__all__ = [
    "check_arrays",
    "checked_path",
    "decode_json",
    "decode_labels",
    "read_arrays",
    "read_bytes",
    "read_fields",
    "read_json",
    "read_tensors",
    "read_text",
    "suffixed",
    "write_atomically",
    "write_csv",
    "write_figure",
    "write_json",
    "write_npz",
    "write_tensors",
    "write_text",
]
