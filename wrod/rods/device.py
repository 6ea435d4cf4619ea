"""Where rods are computed."""

import warp as wp

import wrod.kernels  # noqa: F401  # starts Warp without its banner, which would be in --json
from wrod import arguments
from wrod.errors import RodError


def resolve_device(device: arguments.DeviceLike) -> str:
    """`None` and "auto" mean the first CUDA device if there is one, else the CPU.

    Raises:
        RodError: the device does not exist on this machine, or has no memory left to begin with.
    """
    device = arguments.device_name(device)
    if device in (None, "auto"):
        device = "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        found = wp.get_device(device)
    except Exception as error:
        raise RodError(
            f"device {device!r} is not on this machine; use cpu, auto or one of "
            f"{', '.join(str(d) for d in wp.get_devices())}"
        ) from error
    if found.is_cuda:
        try:
            _ = found.context
        except RuntimeError as error:
            raise RodError(
                f"device {found} cannot be used ({error}); see whether others fill its memory, "
                "wait, or use cpu"
            ) from error
    return str(found)


class OnDevice:
    """What holds arrays on a device and kernels: it is neither pickled nor copied."""

    def __reduce_ex__(self, protocol):
        raise RodError(
            f"a {type(self).__name__} holds arrays on a device and is neither pickled nor copied; "
            "keep what it was made of and its state, read by .numpy(), and make another of them"
        )
