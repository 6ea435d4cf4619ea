"""Arrays with a row for each rod of a batch, as kernels copy all of them at once."""

from collections.abc import Sequence

import warp as wp

from wrod.kernels.stepping import trace as kernels


class StepParts:
    """Arrays (rod, ...), whatever they hold, as words of four bytes.

    Args:
        arrays: contiguous; those without numbers are left out.

    Attributes:
        part: of `wrod.kernels.stepping.trace.Part`.
        words: of a row in all.
    """

    def __init__(self, arrays: Sequence[wp.array]):
        self._arrays = [a for a in arrays if a.size]
        parts, self.words = [], 0
        for array in self._arrays:
            rods, size = len(array), wp.types.type_size_in_bytes(array.dtype)
            part = kernels.Part()
            part.words = wp.array(
                ptr=array.ptr, dtype=wp.int32, shape=(rods, array.size * size // (4 * rods)),
                device=array.device,
            )  # fmt: skip
            part.first = self.words
            parts.append(part)
            self.words += part.words.shape[1]
        self.part = wp.array(parts, dtype=kernels.Part, device=self._arrays[0].device)
        self._dim = len(self._arrays[0]), len(parts), max(p.words.shape[1] for p in parts)

    def room(self, steps: int) -> wp.array:
        """(step, rod, word) of nothing yet."""
        shape = (steps, self._dim[0], self.words)
        return wp.zeros(shape, dtype=wp.int32, device=self.part.device)

    def launch(self, kernel: wp.Kernel, inputs: list, outputs: list) -> None:
        """Launch a kernel over (rod, part, word)."""
        wp.launch(kernel, self._dim, inputs, outputs, device=self.part.device)

    def clear(self) -> None:
        for array in self._arrays:
            array.zero_()

    def clone(self) -> list[wp.array]:
        return [wp.clone(array) for array in self._arrays]

    def assign(self, arrays: list[wp.array]) -> None:
        """What `clone` has returned."""
        for own, other in zip(self._arrays, arrays, strict=True):
            wp.copy(own, other)
