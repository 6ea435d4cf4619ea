"""What is refused or doubted in recordings of motion that an engineer brings."""

import numpy as np
import pytest
from test_motion_selection import FRAMES, RECORDINGS, recorded, swung_arcs

from wrod.errors import DataError, WrodWarning
from wrod.identification.motion.loading import motion_from_arrays


def changed(part, values) -> dict:
    x = swung_arcs()
    x[part] = values(x)
    return {"positions": x}


def stamped(jump: float) -> dict:
    """Times of the frames, with one jump [s] in recording 2."""
    time = np.tile(np.arange(FRAMES) / 100.0, (RECORDINGS, 1))
    time[2, 9:] += jump
    return {"time": time}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"positions": np.repeat(swung_arcs(), 2, axis=1)},
            f"frame 1 of recording 0 repeats the one before it .{RECORDINGS * FRAMES} such",
        ),
        (
            {"positions": np.repeat(swung_arcs()[:, :1], 20, axis=1)},
            "no marker moves by more than 0.000 mm in any recording",
        ),
        (
            changed(np.s_[3, :, 4], lambda x: x[3, :1, 4]),
            "marker 4 of recording 3 stands still while its neighbours move by",
        ),
        (
            changed(np.s_[3, 9:], lambda x: x[3, 9:, ::-1]),
            "in frame 9 of recording 3 each grip is where the other one was",
        ),
        (stamped(0.005), "1.5 frames of rate_hz .1 such steps in all.; bring the frames to even"),
        (stamped(-0.03), "from 0.08 s in frame 8 to 0.06 s in the next, .* in their order"),
        (stamped(3.0), "301 frames of rate_hz .*; make two recordings of it"),
    ],
)
def test_what_no_grips_and_cameras_do_is_named(change, sentence):
    with pytest.raises(DataError, match=sentence):
        motion_from_arrays(recorded(swung_arcs()) | change)


def test_a_rate_of_rounded_stamps_is_named():
    """60 frames a second by stamps in whole milliseconds have differences of 17."""
    time = np.tile(np.round(np.arange(FRAMES) / 60.0, 3), (RECORDINGS, 1))
    data = recorded(swung_arcs()) | {"time": time}
    with pytest.raises(DataError, match=r"rate_hz is 58.82, but .* 60.* frames a second"):
        motion_from_arrays(data | {"rate_hz": 1.0 / 0.017})
    assert motion_from_arrays(data | {"rate_hz": 60.0}).lost_frames == 0


def test_time_stamps_tell_lost_frames():
    gap = motion_from_arrays(recorded(swung_arcs()) | stamped(0.05)).gap
    assert gap[2, 8] == 6 and gap.sum() == gap.size + 5


@pytest.mark.parametrize("axes", [[0, 2, 1], [2, 0, 1]])
def test_axes_without_z_up_are_doubted(axes):
    with pytest.warns(WrodWarning, match=r"between its grips the rod hangs towards"):
        motion_from_arrays(recorded(swung_arcs()[..., axes]))
