# ruff: noqa: E501, UP042, B905  # a table of values
"""Objects that are none of what a public callable takes, and lie about it (tests/test_arguments.py):
what other libraries, test doubles and half-made objects are like."""

import collections
import ctypes
import datetime
import enum
import io
import itertools
import pathlib
import re
import types
import unittest.mock
import uuid
from contextlib import suppress

import numpy as np


class Unsaid:
    """Cannot be said."""

    def __repr__(self):
        raise RuntimeError("no words")

    __str__ = __format__ = __repr__


class Sized:
    """A sequence of a length that none has."""

    def __init__(self, length):
        self.length = length

    def __len__(self):
        return self.length

    def __getitem__(self, key):
        return 1.0


class Anything:
    """Has every attribute, each of which is itself, and can be called."""

    def __getattr__(self, name):
        return self

    def __call__(self, *_, **__):
        return self


class Pretender:
    """Says that it is a float."""

    @property
    def __class__(self):
        return float


class Interface:
    """Says that its array is at no place."""

    __array_interface__ = {"shape": (3,), "typestr": "<f8", "data": None, "version": 3}  # noqa: RUF012
    __cuda_array_interface__ = __array_interface__


class Dlpack:
    """Gives a capsule that is none."""

    def __dlpack__(self, **_):
        return 3

    def __dlpack_device__(self):
        return (1, 0)


class Elsewhere:
    """An array on a GPU, as Warp's and CuPy's: NumPy does not get it."""

    device, dtype, shape, ndim = "cuda:0", np.dtype("f8"), (4, 3), 2

    def __array__(self, dtype=None, copy=None):
        raise TypeError("no implicit conversion")

    def __len__(self):
        return 4


class Short:
    """An array whose shape is another one each time."""

    def __init__(self):
        self.count = 0

    def __array__(self, dtype=None, copy=None):
        self.count += 1
        return np.ones((self.count % 5, 3))


class Jealous(float):
    """A number that is not compared."""

    def _raise(self, *_):
        raise ZeroDivisionError("no")

    __lt__ = __gt__ = __le__ = __ge__ = __eq__ = _raise
    __hash__ = float.__hash__


class Colour(enum.IntEnum):
    RED = 1


class Letter(str, enum.Enum):
    LINE = "line"


Pair = collections.namedtuple("Pair", "x y")


def _raising():
    yield 0.1
    raise KeyError("in the middle")


def _closed():
    file = io.StringIO("line")
    file.close()
    return file


def _holding_itself():
    array = np.empty(2, dtype=object)
    array[:] = [array, 1.0]
    return array


STRANGE = {
    "unsaid": Unsaid(), "no length": Sized(-1), "endless length": Sized(2**62),
    "text length": Sized("a"), "anything": Anything(), "pretender": Pretender(),
    "interface": Interface(), "dlpack": Dlpack(), "short": Short(), "elsewhere": Elsewhere(), "jealous": Jealous(0.5),
    "mock": unittest.mock.MagicMock(), "mock of an array": unittest.mock.MagicMock(spec=np.ndarray),
    "sentinel": unittest.mock.sentinel.x, "int enum": Colour.RED, "text enum": Letter.LINE,
    "named pair": Pair(0.1, 0.2), "deque": collections.deque([0.1, 0.2]),
    "counter": collections.Counter("line"), "default": collections.defaultdict(list),
    "chain": collections.ChainMap({"a": 1}), "user list": collections.UserList([0.1, 0.2]),
    "user text": collections.UserString("line"), "keys": {"a": 1}.keys(), "zip": zip("ab", "cd"),
    "namespace": types.SimpleNamespace(shape=(3,), dtype=float), "raising": _raising(),
    "closed file": _closed(), "open text": io.StringIO("0 0\n1 1\n"), "open bytes": io.BytesIO(b"x"),
    "itself in an array": _holding_itself(), "moment": datetime.datetime.now(),
    "span": datetime.timedelta(1), "uuid": uuid.uuid4(), "match": re.match("a", "a"),
    "pattern of text": re.compile("a"), "windows path": pathlib.PureWindowsPath("C:\\x"),
    "posix path": pathlib.PurePosixPath("/proc/x"), "here": pathlib.Path("."),
    "no path": pathlib.Path(""), "long path": pathlib.Path("x/" * 3000),
    "bytes path": b"/proc/nothing/\xff", "c numbers": (ctypes.c_double * 3)(1.0, 2.0, 3.0),
    "c number": ctypes.c_double(0.5), "c pointer": ctypes.pointer(ctypes.c_double(0.5)),
    "product": itertools.product([1.0], repeat=2), "not implemented": NotImplemented,
    "partial": types.MethodType(print, 1), "super": super, "static": staticmethod(print),
    "recarray": np.rec.array([(1.0, 2)], dtype=[("x", "f8"), ("y", "i4")]),
    "text dtype": np.array(["0.1", "0.2"], dtype=np.dtypes.StringDType()),
    "text numbers array": np.array([["0.1", "0.2", "0.3"]] * 4), "bytes numbers": np.array([b"0.1"]),
    "unaligned": np.frombuffer(bytes(97), np.uint8)[1:].view("f8").reshape(4, 3),
    "packed": np.zeros(4, dtype=np.dtype([("p", "f8", 3)]))["p"], "char": np.char.chararray((3,)),
    "object numbers": np.array([[0.1, 0.2, 0.3]] * 4, dtype=object), "32 axes": np.zeros((1,) * 32),
    "float128": np.longdouble("1e4000"), "negative zero": np.full((4, 3), -0.0),
    "subnormal array": np.full((4, 3), 5e-324), "signalling": np.array([0x7FF0000000000001]).view("f8"),
    "one nan": np.array([[0.0, 0.0, 0.0], [0.1, 0.0, np.nan], [0.2, 0, 0], [0.3, 0, 0]]),
    "all masked": np.ma.masked_all((4, 3)), "masked": np.ma.masked, "errstate": np.errstate(),
    "random": np.random.default_rng(0), "random of a seed": np.random.RandomState(0),
    "dtype": np.dtype("f8"), "index": np.s_[1:2],
    "view of bytes": memoryview(np.ones((4, 3))), "memory of other": memoryview(b"a")[::-1],
    "huge text": "9" * 1_000_000, "right to left": "\u202eenil", "null in text": "line\0",
    "combining": "e\u0301" * 2000, "digits of others": "٣", "full width": "１", "line end": "line\n",
    "braces": "{0.__class__}", "percent": "%(x)s%n", "markup": "<b>&amp;", "ansi": "\x1b[2J",
    "underscored": "1_0", "hexadecimal": "0x10", "unicode minus": "−1", "space": " ",
    "empty bytes": b"", "empty tuple": (), "empty set": set(), "empty range": range(0),
    "big minus": -(2**63) - 1, "word": 2**64, "small": np.float16(6e-8), "int8 least": np.int8(-128),
    "tuple of arrays": (np.zeros(3), np.zeros(2)), "list of arrays": [np.zeros(3)] * 4,
    "list of lists": [[[[[0.1]]]]], "ragged": [[0.1, 0.2], [0.3]], "nan in list": [0.1, float("nan")],
    "numbers and text": [0.1, "0.2"], "truths": [True] * 3, "huge in list": [10**400],
    "self in dict": {}, "coroutine code": compile("1", "a", "eval"), "frame type": types.FrameType,
}  # fmt: skip
STRANGE["self in dict"]["a"] = STRANGE["self in dict"]
with suppress(ImportError):
    import torch

    STRANGE |= {
        "zero-d tensor": torch.tensor(0.5), "grad number": torch.tensor(0.5, requires_grad=True),
        "parameter": torch.nn.Parameter(torch.ones(4, 3)), "device": torch.device("cpu"),
        "torch dtype": torch.float64, "size": torch.Size([4, 3]),
        "expanded": torch.ones(1, 3).expand(2**31, 3), "turned": torch.ones(3, 4).T,
        "negated": torch.ones(3, dtype=torch.cdouble).imag.neg(), "int tensor": torch.ones(3, dtype=torch.int8),
        "inf tensor": torch.full((4, 3), torch.inf), "huge tensor": torch.full((4, 3), 1e300, dtype=torch.float64),
        "nested tensor": torch.nested.nested_tensor([torch.ones(2), torch.ones(3)]),
        "quantized": torch.quantize_per_tensor(torch.ones(3), 0.1, 0, torch.qint8),
        "inference": torch.inference_mode()(lambda: torch.ones(3))(), "generator": torch.Generator(),
        "deep tensor": torch.zeros((1,) * 20), "text in grad": [torch.tensor(0.1), "a"],
        "on a GPU": torch.ones((4, 3), device="cuda" if torch.cuda.is_available() else "cpu"),
        "tensors": [torch.tensor(0.1), torch.tensor(0.2)],
    }  # fmt: skip
