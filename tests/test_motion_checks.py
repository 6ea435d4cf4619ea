"""What is refused or doubted in recordings of motion that an engineer brings."""

import warnings

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
        (
            changed(np.s_[5], lambda x: x[2]),
            "recordings 2 and 5 are the same; give each once",
        ),
        (
            changed(np.s_[1, 7, 4], lambda x: 0.0),
            "marker 4 of recording 1 is at .0, 0, 0. in frame 7 .1 such .*; give NaN where",
        ),
        (
            {"time": 10.0 * np.tile(np.arange(FRAMES), (RECORDINGS, 1))},
            r"a frame takes 10 s, 1e\+03 frames of rate_hz, 100; give time in seconds",
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


def test_one_recording_with_other_axes_is_doubted():
    x = swung_arcs()
    x[3] = x[3][..., [0, 2, 1]]
    with pytest.warns(WrodWarning, match=r"in recording 3 between its grips the rod hangs towards"):
        motion_from_arrays(recorded(x))


def coarse(rate: float) -> dict:
    """Grips and rod that swing at 3 Hz, seen so many times a second."""
    time = np.arange(FRAMES) / rate
    swing = 0.1 * np.sin(2.0 * np.pi * 3.0 * time + np.arange(RECORDINGS)[:, None])
    x = np.repeat(swung_arcs()[:, :1], FRAMES, axis=1)
    x[..., 1] += swing[..., None]
    return recorded(x) | {"rate_hz": rate}


def test_frames_too_rare_for_the_motion_are_doubted_and_none_is_taken_for_lost():
    with pytest.warns(WrodWarning, match=r"steps change by .* from frame to frame in the median"):
        assert motion_from_arrays(coarse(13.0)).lost_frames == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert motion_from_arrays(coarse(100.0)).lost_frames == 0
