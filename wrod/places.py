"""What `device` may be given: a name, or a device of Warp or torch."""

from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import torch
    import warp

# What `device` takes: "cpu", "cuda:0", "auto", or such an object of Warp or torch.
DeviceLike: TypeAlias = "str | warp.Device | torch.device | None"


def place(value: Any) -> str | None:
    """Where to compute; what is computed there is given its `device_name`."""
    good = value is None or isinstance(device_name(value), str)
    return None if good else 'must be "cpu", "cuda:0", "auto", or such a device of Warp or torch'


def device_name(value: Any) -> Any:
    """The name of a device of Warp or torch ("cuda:0"); anything else as it is."""
    room, kind = type(value).__module__.partition(".")[0], type(value).__name__
    if (room, kind) in (("warp", "Device"), ("torch", "device")):
        return "cpu" if str(value).startswith("cpu") else str(value)
    return value
