"""Hypothesis strategies of hostile input (tests/test_fuzz.py): valid files with one thing broken.

What tests/hostile.py chooses is drawn by hypothesis, which shrinks what fails to the least that
still does, and prints it. The tests try the same each time; WROD_FUZZ=50 (`make fuzz`) tries others
each time, and keeps what failed in .hypothesis for the next time. Only tests that draw import this:
every process that loads hypothesis pays for it.
"""

import os
import time

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.internal.conjecture import providers

FUZZ = int(os.environ.get("WROD_FUZZ", "1"))
# Of a test of many files, so that `make fuzz` ends [s of a processor]; what was tried is told.
LONGEST = 10
# Hypothesis takes seconds to find what letters there are: the tests have those of Latin, and of
# digits, fractions, marks and signs some that are none. `make fuzz` has all.
LETTERS = "".join(map(chr, range(0x250))) + "٣३５𝟘½Ⅷ∞−٫\u202e\u2028\ufeff😀"
if FUZZ == 1:
    # What stands in source that is imported would be drawn, too: it takes seconds to find, and what
    # the tests try would depend on what else was imported. `make fuzz` has it.
    providers._get_local_constants = lambda: providers._local_constants


def try_all(strategy, count: int, attempt) -> None:
    """Call `attempt` with so many draws, FUZZ times as many where there is time for that."""
    end, failed = time.process_time() + LONGEST, []

    @settings(
        max_examples=count * FUZZ,
        derandomize=FUZZ == 1,
        deadline=None,
        print_blob=FUZZ > 1,
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def each(drawn):
        if FUZZ > 1 and time.process_time() > end and not failed:
            return
        try:
            attempt(drawn)
        except BaseException as error:
            failed.append(error)  # what shrinks it may take longer
            raise

    each()


@st.composite
def broken(draw, breaking, valid):
    """(what was done, file) as a function of tests/hostile.py breaks it."""
    return breaking(valid, draw(st.randoms(use_true_random=False)))


@st.composite
def encoded(draw, text) -> tuple[str, bytes]:
    """(what was done, bytes) of a drawn (what was done, text), mostly in UTF-8."""
    what, content = draw(text)
    encoding = draw(st.sampled_from(["utf-8"] * 8 + ["utf-8-sig", "utf-16", "utf-32", "cp037"]))
    errors = "surrogatepass" if "utf" in encoding else "replace"
    return what, content.encode(encoding, errors)


@st.composite
def edited(draw, content: bytes) -> bytes:
    """Bytes of which some in one place are others, more or fewer."""
    start = draw(st.integers(0, len(content)))
    length = draw(st.sampled_from([0, 1, 4, 64, len(content)]))
    piece = draw(
        st.binary(max_size=16)
        | st.sampled_from([b"9" * 400, b"nan", b"-", b"\xff\xfe", b"{" * 2000, bytes(64), b"1e999"])
    )
    return content[:start] + piece + content[start + length :]


def numbers():
    """Words for a number, of which few are one within bounds."""
    letters = {"alphabet": LETTERS} if FUZZ == 1 else {}
    return st.one_of(
        st.floats().map(repr),
        st.integers().map(str),
        st.fractions().map(str),
        st.from_regex(r"[-+ ]?[0-9_.,:xe%+-]{1,12}", fullmatch=True, **letters),
        st.text(max_size=20, **letters),
    )
