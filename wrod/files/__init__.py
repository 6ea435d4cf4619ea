"""Files: those that come in are checked by one reader, those that go out are whole or not there.

Everything may import this room; it imports the errors alone.
"""

from wrod.files.array_checks import check_arrays as check_arrays
from wrod.files.array_checks import read_fields as read_fields
from wrod.files.arrays import read_arrays as read_arrays
from wrod.files.arrays import read_tensors as read_tensors
from wrod.files.arrays import write_tensors as write_tensors
from wrod.files.reading import checked_path as checked_path
from wrod.files.reading import decode_json as decode_json
from wrod.files.reading import decode_labels as decode_labels
from wrod.files.reading import read_bytes as read_bytes
from wrod.files.reading import read_json as read_json
from wrod.files.reading import read_text as read_text
from wrod.files.writing import suffixed as suffixed
from wrod.files.writing import write_atomically as write_atomically
from wrod.files.writing import write_csv as write_csv
from wrod.files.writing import write_figure as write_figure
from wrod.files.writing import write_json as write_json
from wrod.files.writing import write_npz as write_npz
from wrod.files.writing import write_picture as write_picture
from wrod.files.writing import write_text as write_text
