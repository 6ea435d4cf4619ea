"""The rate of a rod's loads while its blocks move, from its second derivatives."""

import warp as wp

_cache: dict[int, wp.Function] = {}


def make_motion_load(size: int) -> wp.Function:
    """For blocks of `size`, 3 or 4, of `kernels.linear.frontal`."""
    if size not in _cache:
        _cache[size] = _motion_load(size)
    return _cache[size]


def _motion_load(size: int) -> wp.Function:
    vector = wp.types.vector(length=size, dtype=wp.float64)
    first = size - 3
    # Of the upper triangle's rows.
    width = wp.constant(4 * size - 1)

    @wp.func
    def stencil_rate(
        stiffness: wp.array3d(dtype=wp.float64),
        slot: int,
        j: int,
        after: int,
        de: vector,
        df: vector,
    ) -> vector:
        """Of the derivative by the edge before node j or after it, when these edges change by `de`
        and `df`: their angles, then their vectors."""
        rate = vector()
        for a in range(size):
            for b in range(size):
                p = wp.min(after * size + a, b)
                q = wp.max(after * size + a, b)
                rate[a] += stiffness[slot, j, p * (width - p) // 2 + q] * de[b]
                p = wp.min(after * size + a, size + b)
                q = wp.max(after * size + a, size + b)
                rate[a] += stiffness[slot, j, p * (width - p) // 2 + q] * df[b]
        return rate

    @wp.func
    def motion_load(
        stiffness: wp.array3d(dtype=wp.float64),
        motion: wp.array3d(dtype=wp.float64),
        slot: int,
        edges: int,
        # Out:
        load: wp.array3d(dtype=wp.float64),
    ):
        """Fill `load` with the gradient's rate when the blocks move by `motion`, from the
        differences of neighbours: what rounding leaves of it is as small as these."""
        de = vector()
        before = vector()
        here = vector()
        for j in range(edges):
            df = vector()
            for c in range(size):
                df[c] = motion[slot, j + 1, c]
                if c >= first:
                    df[c] = df[c] - motion[slot, j, c]
            e = stencil_rate(stiffness, slot, j, 0, de, df)
            f = stencil_rate(stiffness, slot, j, 1, de, df)
            for c in range(size):
                # An edge pulls the node at its beginning back; its angle is the next block's.
                if c >= first:
                    load[slot, wp.max(j - 1, 0), c] = before[c] - e[c]
                    before[c] = here[c] + e[c] - f[c]
                else:
                    load[slot, j, c] = here[c] + e[c]
                here[c] = f[c]
            de = df
        for c in range(size):
            if c >= first:
                load[slot, edges - 1, c] = before[c]
            load[slot, edges, c] = here[c]

    return motion_load
