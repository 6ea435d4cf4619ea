"""What a device holds, read without waiting for more than has to be waited for."""

import numpy as np
import warp as wp


def read(array: wp.array) -> np.ndarray:
    """What an array holds; waits for the present stream alone, where `array.numpy()` would wait for
    all."""
    if array.device.is_cpu:
        return array.numpy().copy()
    here = array.to("cpu")
    wp.synchronize_stream(wp.get_stream(array.device))
    return here.numpy()
