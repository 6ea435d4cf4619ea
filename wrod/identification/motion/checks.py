"""Whether the markers of recordings can be those of one rod between two grips, in metres."""

import warnings

import numpy as np

from wrod.errors import DataError, WrodWarning
from wrod.rods.rotation import unit

# A rod of this length [m], or a thousandth of it, was not given in metres; nor moves one so [m/s].
_FAR = 10.0
_FAST = 15.0
# How many times farther something is from its own place than from another's, to be taken for it.
_FARTHER = 3.0
# No hand or robot shakes a rod so [m/s^2]; part of its length that another order may save.
_HURRIED, _SHORTER = 60.0, 0.05
# Change of a distance between neighbours from frame to frame, over their usual distance, that is an
# exchange: those of real cables change by 0.25 at most, exchanged ones by about 1.
_JUMP = 0.6
# Inertia over gravity, of the moments about the line of the grips, that no hanging rod has, and how
# well the two must follow each other to be told so.
_SLOW, _TOGETHER = 0.3, 0.9
# Noise over the rod's length that no marker has.
_RESTLESS = 0.02
# Over the rod's length, what does not move; over its neighbours' way, that of a marker that is
# something else than one.
_STILL, _STUCK = 1e-3, 0.02
# Change of the grips' steps from frame to frame, over themselves, that leaves open what they do.
_COARSE = 0.3
# A rod that hangs so much of its length to one side, this far from straight down (cosine).
_SAGS, _DOWN = 0.03, 0.5


def check_positions(x: np.ndarray, names, rate: float, where: str) -> None:
    bad = np.argwhere(~np.isfinite(x).all(axis=3))
    if len(bad):
        r, f, m = bad[0]
        raise DataError(
            f"{where}: marker {m} of recording {names[r]} is not finite in frame {f} "
            f"({len(bad)} such markers in all); interpolate them or leave the recording out"
        )
    _check_different(x, names, where)
    edge = np.linalg.norm(np.diff(x, axis=2), axis=3)
    mean = np.median(edge, axis=(0, 1))
    length = mean.sum()
    if not 1e-3 * _FAR <= length <= _FAR or np.abs(x).max() > 10 * _FAR:
        raise DataError(
            f"{where}: the rod would be {length:.3g} m long; positions must be in metres"
        )
    if not (mean > 0).all():
        m = int(np.argmin(mean))
        raise DataError(f"{where}: markers {m} and {m + 1} are in the same place")
    step = np.linalg.norm(np.diff(x, axis=1), axis=3)
    _check_moving(x, step, length, names, where)
    ratio = np.median(edge, axis=1) / mean
    if ratio.max() > 1.5 or ratio.min() < 0.5:
        r, m = np.unravel_index(np.argmax(np.abs(np.log(ratio))), ratio.shape)
        raise DataError(
            f"{where}: markers {m} and {m + 1} of recording {names[r]} are "
            f"{1e3 * np.median(edge[r, :, m]):.0f} mm apart, {1e3 * mean[m]:.0f} mm in the others; "
            "are its markers in another order, or is it of another rod?"
        )
    middle = np.median(step, axis=2)
    typical = np.median(middle)
    if typical * rate > _FAST:
        raise DataError(
            f"{where}: markers move at {typical * rate:.0f} m/s; check rate_hz and the unit"
        )
    # Markers inside the grips are put right later; the distances of all others are the rod's own.
    usual = np.quantile(edge, 0.25, axis=(0, 1))  # exchanged markers are farther apart
    jump = (np.abs(np.diff(edge, axis=1)) / usual)[:, :, 1:-1]
    if jump.max() > _JUMP:
        unseen = np.argwhere((x == 0.0).all(axis=3))
        if len(unseen):
            r, f, m = unseen[0]
            raise DataError(
                f"{where}: marker {m} of recording {names[r]} is at (0, 0, 0) in frame {f} "
                f"({len(unseen)} such markers in all); give NaN where a marker was not seen"
            )
        r, f, k = np.unravel_index(np.argmax(jump > _JUMP), jump.shape)
        before, after = 1e3 * edge[r, f : f + 2, k + 1]
        raise DataError(
            f"{where}: markers {k + 1} and {k + 2} of recording {names[r]} are {before:.0f} mm "
            f"apart in frame {f} and {after:.0f} mm in the next, which no rod does "
            f"({(jump > _JUMP).sum()} such jumps in all); sort the markers of every frame along "
            "the rod, or leave the recording out"
        )
    noise = _noise(x)
    if noise > _RESTLESS * length:
        raise DataError(
            f"{where}: markers jump to and fro by {1e3 * noise:.0f} mm from frame to frame; give "
            "markers and frames in their order"
        )
    _check_ends(x, names, where)
    _check_order(x, where)
    lag, size = _lag(x, noise)
    hurry = size * (rate / lag) ** 2
    if hurry > _HURRIED:
        raise DataError(
            f"{where}: markers are accelerated by {hurry:.0f} m/s^2 in the median, which no grip "
            f"does to a rod; is rate_hz, {rate:g}, the rate of these frames?"
        )


def _check_different(x: np.ndarray, names, where: str) -> None:
    """Whether every recording is there once."""
    first: dict[bytes, int] = {}
    for r, recording in enumerate(x):
        same = first.setdefault(recording.tobytes(), r)
        if same != r:
            raise DataError(
                f"{where}: recordings {names[same]} and {names[r]} are the same; give each once, "
                "for one that was fitted is no test"
            )


def _check_moving(x: np.ndarray, step: np.ndarray, length: float, names, where: str) -> None:
    """Whether recordings move, frame by frame and marker by marker, given their steps [m]."""
    travel = np.linalg.norm(x.std(axis=1), axis=2)
    if travel.max() < _STILL * length:
        raise DataError(
            f"{where}: no marker moves by more than {2e3 * travel.max():.3f} mm in any recording; "
            "give recordings in which the grips move the rod"
        )
    stands = step.max(axis=2) == 0.0
    if stands.any():
        r, f = np.argwhere(stands)[0]
        raise DataError(
            f"{where}: frame {f + 1} of recording {names[r]} repeats the one before it "
            f"({stands.sum()} such frames in all); give each frame once, with rate_hz as the rate "
            "of these, or NaN where markers were not seen for a few frames"
        )
    beside = np.minimum(travel[:, 1:-3], travel[:, 3:-1])
    stuck = (travel[:, 2:-2] < _STUCK * beside) & (beside > _STILL * length)
    if stuck.any():
        r, m = np.argwhere(stuck)[0]
        raise DataError(
            f"{where}: marker {m + 2} of recording {names[r]} stands still while its neighbours "
            f"move by {2e3 * beside[r, m]:.0f} mm; leave it out, or the recording"
        )
    # In one frame each grip goes to where the other was.
    grip = np.stack([x[:, :, :2].mean(axis=2), x[:, :, -2:].mean(axis=2)], axis=2)
    stays, changes = (
        np.linalg.norm(grip[:, 1:] - before[:, :-1], axis=3) for before in (grip, grip[:, :, ::-1])
    )
    turned = np.argwhere((stays > _FARTHER * changes).all(axis=2))
    if len(turned):
        r, f = turned[0]
        raise DataError(
            f"{where}: in frame {f + 1} of recording {names[r]} each grip is where the other one "
            "was in the frame before; reverse the markers of the frames from there on"
        )


def _noise(x: np.ndarray) -> float:
    """Standard deviation of the markers' coordinates from a smooth motion [m]."""
    return float(np.median(np.abs(np.diff(x, 4, axis=1))) * 1.4826 / np.sqrt(70.0))


def _lag(x: np.ndarray, noise: float) -> tuple[int, float]:
    """Frames between which second differences are seen above the noise, and their median [m]."""
    most = (x.shape[1] - 1) // 2
    for lag in (1, 2, 4, 8, 16, 32, 64, most):
        lag = min(lag, most)
        second = x[:, 2 * lag :] - 2.0 * x[:, lag:-lag] + x[:, : -2 * lag]
        size = float(np.median(np.linalg.norm(second, axis=3)))
        if size > 100.0 * noise:
            break
    return lag, size


def inertia_share(x: np.ndarray, rate: float, gravity: float) -> tuple[float, float]:
    """Inertia over gravity, of their moments about the line of the grips, and their correlation.

    About that line the forces of the grips have no moment, so that the moment of gravity is that of
    inertia, but for the couples of the grips and the drag of the air. Where the rod hangs, couples
    act as gravity does, and the share is more than 1.

    Args:
        x: (R, F, M, 3) positions [m].
        rate: frames per second [Hz].
        gravity: [m/s^2].
    """
    lag, _ = _lag(x, _noise(x))
    at = x[:, lag:-lag, 1:-1]
    moved = x[:, 2 * lag :, 1:-1] - 2.0 * at + x[:, : -2 * lag, 1:-1]
    line = unit(at[:, :, -1] - at[:, :, 0])
    edge = np.linalg.norm(np.diff(at, axis=2), axis=-1)
    weight = np.zeros(at.shape[:3])
    weight[:, :, :-1] += 0.5 * edge
    weight[:, :, 1:] += 0.5 * edge

    def moment(force):
        about = np.cross(at - at[:, :, :1], np.broadcast_to(force, at.shape))
        total = np.einsum("rfm,rfmi,rfi->rf", weight, about, line)
        return total - total.mean(axis=1, keepdims=True)

    weighs, moves = moment([0.0, 0.0, -gravity]), moment((rate / lag) ** 2 * moved)
    both = (weighs * moves).sum()
    size = np.sqrt((weighs**2).sum() * (moves**2).sum())
    return both / max((weighs**2).sum(), 1e-300), both / max(size, 1e-300)


def doubt_slow_motion(x: np.ndarray, rate: float, gravity: float, where: str) -> None:
    """Warn where a hanging rod swings more slowly than gravity lets it; arguments as those of
    `inertia_share`.

    Three real cables had shares of 1.2 to 1.9, with correlations of 0.95 to 0.98; at a fifth of the
    rate they would be 25 times less. A stiff rod that its grips turn slowly has a small share at
    any rate, and markers do not tell it from a cable: hence no refusal.

    Warns:
        WrodWarning: names how many times faster the frames came at least.
    """
    share, together = inertia_share(x, rate, gravity)
    if together > _TOGETHER and share < _SLOW:
        warnings.warn(
            f"{where}: the rod swings as one whose frames come {share**-0.5:.1f} times faster than "
            f"rate_hz, {rate:g}, or more; check it (a stiff rod that its grips turn also does)",
            WrodWarning,
            stacklevel=4,
        )


def doubt_gravity(x: np.ndarray, names, where: str) -> None:
    """Warn where rods hang another way than down: z is up, which not all cameras' axes have.

    Args:
        x: (R, F, M, 3) positions [m].
        names: (R,) of the recordings.

    Warns:
        WrodWarning: names the way, and the first recording that is alone with it. A stiff rod that
            its grips push up hangs so, too.
    """
    start, end = x[:, :, 1], x[:, :, -2]
    line = unit(end - start)
    sag = x[:, :, 2:-2].mean(axis=2) - 0.5 * (start + end)
    sag = (sag - np.sum(sag * line, axis=-1, keepdims=True) * line).mean(axis=1)
    length = np.linalg.norm(np.diff(x, axis=2), axis=3).mean(axis=(0, 1)).sum()

    def aside(hangs) -> bool:
        size = np.linalg.norm(hangs)
        return size > _SAGS * length and -hangs[2] < _DOWN * size

    which, way = "", sag.mean(axis=0)
    if not aside(way):
        alone = [r for r in range(len(x)) if aside(sag[r])]
        if not alone:
            return
        which, way = f"in recording {names[alone[0]]}", sag[alone[0]]
        which += f" ({len(alone)} such recordings in all) " if len(alone) > 1 else " "
    told = ", ".join(f"{v:.2f}" for v in way / np.linalg.norm(way))
    warnings.warn(
        f"{where}: {which}between its grips the rod hangs towards ({told}) on average, not down "
        "along -z; are positions those of axes with z up?",
        WrodWarning,
        stacklevel=4,
    )


def doubt_rate(x: np.ndarray, rate: float, where: str) -> bool:
    """Whether the grips' step from a frame to the next is another one by more than `_COARSE` of
    itself, in the median, when the next comes; with a warning.

    Three real cables at 100 Hz: 0.09 to 0.12, at 33 Hz 0.24 to 0.27.

    Args:
        x: (R, F, M, 3) positions [m].
        rate: frames per second [Hz].

    Warns:
        WrodWarning: names the share.
    """
    grips = x[:, :, [0, 1, -2, -1]]

    def share(lag: int) -> float:
        step = grips[:, lag:] - grips[:, :-lag]
        size, change = (
            np.median(np.linalg.norm(v, axis=3)) for v in (step, step[:, lag:] - step[:, :-lag])
        )
        return float(change / max(size, 1e-300))

    # Of noise the share is less over two frames, of motion it is more.
    coarse = _COARSE < share(1) < share(2)
    if coarse:
        warnings.warn(
            f"{where}: the grips' steps change by {100 * share(1):.0f} % from "
            f"frame to frame in the median, too much to tell what they do between frames, or "
            f"whether some were lost; record at more than rate_hz, {rate:g}, or more slowly",
            WrodWarning,
            stacklevel=4,
        )
    return coarse


def _check_order(x: np.ndarray, where: str) -> None:
    """Whether some piece of the row of markers, turned round, would make a shorter rod."""
    apart = np.linalg.norm(x[:, :, :, None] - x[:, :, None], axis=4).mean(axis=(0, 1))
    count = len(apart)
    length = sum(apart[i, i + 1] for i in range(count - 1))
    for i in range(count - 2):
        for j in range(i + 1, count - 1):
            now = apart[i, i + 1] + apart[j, j + 1]
            if apart[i, j] + apart[i + 1, j + 1] < now - _SHORTER * length:
                raise DataError(
                    f"{where}: markers {i + 1} to {j} in the opposite order would lie nearer to "
                    "their neighbours; give the markers in their order along the rod"
                )


def _check_ends(x: np.ndarray, names, where: str) -> None:
    """Whether the two grips are told apart, in all recordings and in each."""
    edge = np.median(np.linalg.norm(np.diff(x, axis=2), axis=3), axis=(0, 1))
    for order in (
        [-1, -2, *range(2, x.shape[2] - 2), 1, 0],
        [-2, -1, *range(2, x.shape[2] - 2), 0, 1],
    ):
        other = np.median(np.linalg.norm(np.diff(x[:, :, order], axis=2), axis=3), axis=(0, 1))
        if other[1:-1].max() < edge[1:-1].max() / _FARTHER:
            raise DataError(
                f"{where}: markers 1 and 2 are {1e3 * edge[1]:.0f} mm apart, the next ones "
                f"{1e3 * edge[2]:.0f} mm; are the markers of the two grips exchanged?"
            )
    # Where each grip is on average, against the middling recording.
    grip = np.stack([x[:, :, :2].mean(axis=(1, 2)), x[:, :, -2:].mean(axis=(1, 2))], axis=1)
    usual = np.median(grip, axis=0)
    here = np.linalg.norm(grip - usual, axis=2)
    there = np.linalg.norm(grip - usual[::-1], axis=2)
    wrong = (here > _FARTHER * there).all(axis=1)
    if wrong.any():
        r = int(np.argmax(wrong))
        raise DataError(
            f"{where}: in recording {names[r]} each grip is where the others have the other one; "
            "reverse its markers or leave the recording out"
        )
