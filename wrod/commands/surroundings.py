"""What a command finds around it: environment variables, streams and limits of its process."""

import os
import re
import resource
import sys

from wrod.errors import DataError

# Bytes of addresses that OpenUSD's threads and libraries take.
_ADDRESSES = 4 * 2**30
# Bytes of stack: with less the system ends libraries that call deeply.
_STACK = 2**19
# Bytes of data that torch takes for its threads on a server of many cores.
_DATA = 3 * 2**29
# OpenCV ends the process for a variable that is neither, but for those that take words.
_NUMBER = "[0-9]{1,18}([KM][Bb]|[km]b)?|[Tt]rue|TRUE|[Ff]alse|FALSE"
_WORDS = (
    "(DIR|PATH|LIST|BACKEND(_DEFAULT)?|DEVICE|RUNTIME|OPTIONS|LOCATION|LEVEL|IPP|DISABLE|"
    "DOMAIN_NAME)$"
)


def _refuse_low(kind: int, least: int, need: str, what: str, option: str) -> None:
    limit = resource.getrlimit(kind)[0]
    if limit != resource.RLIM_INFINITY and limit < least:
        raise DataError(
            f"{need} {least / 2**30:.3g} GiB of {what}, and this process may have "
            f"{limit / 2**30:.3g} GiB (ulimit {option}); raise that limit"
        )


def refuse_few_addresses() -> None:
    """Refuse a limit of addresses within which OpenUSD crashes, or waits for ever for threads that
    it did not get: a DataError where `ulimit -v` is below that."""
    _refuse_low(resource.RLIMIT_AS, _ADDRESSES, "scenes need", "addresses", "-v")


def refuse_little_data() -> None:
    """Refuse a limit of data within which torch ends the process, which no handler hears of: a
    DataError where `ulimit -d` is below that."""
    _refuse_low(resource.RLIMIT_DATA, _DATA, "torch needs", "data", "-d")


def settle_variables() -> None:
    """Refuse what a library reads of the environment, or lacks of stack, and would end the process
    for, and keep what OpenUSD (TF_DEBUG) and OpenCV tell of themselves out of what is printed for
    machines, and out of files.

    Raises:
        DataError: names the variable, or the limit.
    """
    limit = resource.getrlimit(resource.RLIMIT_STACK)[0]
    if limit != resource.RLIM_INFINITY and limit < _STACK:
        raise DataError(
            f"this process may have a stack of {limit >> 10} KiB, and {_STACK >> 10} are needed; "
            "raise that limit (ulimit -s)"
        )
    for name, value in os.environ.items():
        counts = name.startswith("OPENCV_") and not re.search(_WORDS, name)
        if counts and not re.fullmatch(_NUMBER, value):
            raise DataError(f"{name}={value!r:.80} is no number or truth of OpenCV's; unset it")
    path = os.environ.get("EZDXF_CONFIG_FILE", "")
    ends = path == os.devnull or os.path.isfile(path) or os.path.isdir(path)
    if os.path.exists(path) and not ends:
        raise DataError(f"EZDXF_CONFIG_FILE={path!r:.80} is a device or a pipe; unset it")
    # Pictures look the same whatever a user set for his own: LaTeX, which may be missing, fonts.
    os.environ["MATPLOTLIBRC"] = os.devnull
    os.environ["TF_DEBUG_OUTPUT_FILE"] = "stderr"
    if "TF_DEBUG" in os.environ:
        os.environ["TF_DEBUG"] += " -PCP_PRIM_INDEX_GRAPHS"  # files in the working folder
    if os.environ.get("OPENCV_LOG_LEVEL", "W")[:1].upper() not in ("S", "F", "E", "W"):
        os.environ["OPENCV_LOG_LEVEL"] = "WARNING"  # what is below goes to stdout
    date = "SOURCE_DATE_EPOCH"  # matplotlib's, of PDF
    if not re.fullmatch("-?[0-9]{1,10}|[0-9]{11}", os.environ.get(date, "0")):
        raise DataError(f"{date}={os.environ[date]!r:.80} is no date in seconds; unset it")


def open_streams() -> None:
    """Open what the process was started without of its three streams, on nothing.

    Files would take the free numbers 1 and 2 otherwise, and get what libraries print; and progress
    bars need a stream.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
        if getattr(sys, name) is None:
            stream = open(number, "r" if number == 0 else "w", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
