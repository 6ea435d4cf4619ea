"""Skyline factorisations and solutions against dense ones, on a CPU and on a GPU."""

import numpy as np
import pytest
import warp as wp
from wrod.kernels.lanes import TEAM, lanes
from wrod.kernels.linear import skyline, skyline_ends, skyline_lanes, skyline_order

from wrod.solvers.coupled import skyline_of

needs_gpu = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")
WAYS = [
    pytest.param(skyline, "cpu", id="thread-cpu"),
    pytest.param(skyline_lanes, "cpu", id="lanes-cpu"),
    pytest.param(skyline_lanes, "cuda:0", id="lanes-gpu", marks=needs_gpu),
]
# Nodes, and pairs of edges that touch.
SIZES = ((3, 1), (9, 2), (40, 0), (40, 6), (41, 60), (133, 10), (210, 30))
RODS = 4


def touching_pairs(rng, nodes, count):
    """(count, 2) edges i < j that touch, as strands that lie beside each other do."""
    i = rng.integers(0, nodes - 1, count)
    j = rng.integers(0, nodes - 1, count)
    near = rng.random(count) < 0.5
    if count:
        i[near] = np.clip(i[0] + rng.integers(-3, 4, count), 0, nodes - 2)[near]
        j[near] = np.clip(j[0] - rng.integers(-3, 4, count), 0, nodes - 2)[near]
    return np.stack([np.minimum(i, j), np.maximum(i, j)], axis=1)


def problem(nodes, count, seed=0):
    """Indefinite matrices (rod, 4 node - 1, same) of rods with contacts, and who couples whom."""
    rng = np.random.default_rng([seed, nodes, count])
    pairs = [touching_pairs(rng, nodes, count) for _ in range(RODS)]
    matrices = []
    for chosen in pairs:
        coupled = np.abs(np.subtract.outer(np.arange(nodes), np.arange(nodes))) <= 2
        for i, j in chosen:
            corners = [i, i + 1, j, j + 1]
            coupled[np.ix_(corners, corners)] = True
        full = np.kron(coupled, np.ones((4, 4)))[:-1, :-1]
        m = rng.normal(size=full.shape) * full
        m = m + m.T
        m[np.diag_indices_from(m)] += rng.uniform(-20, 40, len(m))
        matrices.append(m)
    free = rng.random((RODS, 4 * nodes - 1)) > 0.15
    free[0] = True
    return np.array(matrices), pairs, free, rng.normal(size=(RODS, 1, 4 * nodes - 1))


class System:
    """The kernels on matrices of given pairs."""

    def __init__(self, kernels, device, nodes, pairs, capacity=None, most_reach=None):
        self.kernels, self.device, self.nodes = kernels, device, nodes
        self.most = max(1, *(len(p) for p in pairs))
        self.capacity = nodes * (nodes + 1) // 2 if capacity is None else capacity
        coupled, overflow = (self.array(np.full(RODS, k), wp.int32) for k in (1, 0))
        self.skyline = skyline_of(coupled, overflow, nodes)
        table = np.zeros((RODS, self.most, 3))
        for r, chosen in enumerate(pairs):
            table[r, : len(chosen), :2] = chosen
        self.count = self.array([len(p) for p in pairs], wp.int32)
        self.touching = self.array(table, wp.vec3i)
        scratch = [self.zeros(wp.int32) for _ in range(2)]
        self.launch(
            skyline_order.renumber,
            [
                coupled,
                self.zeros(wp.int32),  # pieces: edges
                self.count,
                self.touching,
                self.capacity,
                nodes if most_reach is None else most_reach,
                *scratch,
            ],
            [self.skyline],
        )

    def array(self, values, dtype):
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def zeros(self, dtype, width=1):
        return wp.zeros((RODS, width * self.nodes), dtype=dtype, device=self.device)

    def launch(self, kernel, inputs, outputs, ends=None):
        count = lanes(self.device, TEAM)
        wp.launch(
            kernel,
            (RODS, count) if ends is None else (RODS, ends, count),
            inputs=inputs,
            outputs=outputs,
            device=self.device,
            block_dim=count,
        )

    def fill(self, matrices, free):
        """Store matrices; prescribed rows and columns are those of the identity."""
        m = self.skyline
        rank, first, row = (a.numpy() for a in (m.rank, m.first, m.row))
        block = np.zeros((RODS, self.capacity, 4, 4))
        for r, (m, f) in enumerate(zip(matrices, free, strict=True)):
            padded = np.eye(4 * self.nodes)
            padded[:-1, :-1] = np.where(np.outer(f, f), m, np.eye(len(m)))
            padded = padded.reshape(self.nodes, 4, self.nodes, 4).swapaxes(1, 2)
            order = np.argsort(rank[r])
            for p in range(self.nodes):
                columns = np.arange(first[r, p], p + 1)
                block[r, row[r, p] + columns] = padded[order[p], order[columns]]
        self.block = self.array(block.reshape(RODS, -1, 4), wp.vec4d)
        self.free = self.array(free, wp.int32)

    def eliminate(self, right):
        """(rod,) negative pivots, or -1, and solutions."""
        negative = wp.full(RODS, -1, dtype=wp.int32, device=self.device)
        x = self.array(np.zeros_like(right), wp.float64)
        chosen = [self.skyline, skyline_ends.reach_of(self.nodes)]
        gradient = self.array(right[:, 0], wp.float64)
        width = skyline_ends.scratch_of(self.nodes)
        factor = wp.full((RODS, width), np.nan, dtype=wp.float64, device=self.device)
        halves = wp.zeros((RODS, 2), dtype=wp.int32, device=self.device)
        self.launch(
            skyline_ends.eliminate,
            [*chosen, self.free, gradient, self.block],
            [self.zeros(wp.int32), self.zeros(wp.float64, 4), factor, halves],
            ends=2,
        )
        inputs = [*chosen, gradient, halves, factor]
        self.launch(skyline_ends.go_back, inputs, [x, negative], ends=2)
        return negative.numpy().copy(), x.numpy().copy()

    def factorise(self, matrices, free):
        """(rod,) negative pivots."""
        self.fill(matrices, free)
        negative = wp.full(RODS, -1, dtype=wp.int32, device=self.device)
        inputs = self.chosen
        if self.kernels is skyline_lanes:
            widths = (4, skyline_lanes.STRIDE, skyline_lanes.STRIDE)
            inputs += [self.zeros(wp.float64, width) for width in widths]
        self.launch(self.kernels.factorise, inputs, [self.stored, negative])
        return negative.numpy().copy()

    @property
    def chosen(self):
        """Which rods: all, of any reach."""
        by_lanes = self.kernels is skyline_lanes
        return [self.skyline, *([0] if by_lanes else [])]

    @property
    def stored(self):
        """The blocks, as lines or whole."""
        if self.kernels is skyline_lanes:
            return self.block
        shape = (RODS, self.block.shape[1] // 4)
        return wp.array(ptr=self.block.ptr, shape=shape, dtype=wp.mat44d, device=self.device)

    def factor(self):
        """(rod, block, 4, 4), diagonal blocks without what is above their pivots."""
        out = self.block.numpy().reshape(RODS, -1, 4, 4).copy()
        diagonal = self.skyline.row.numpy() + np.arange(self.nodes)
        for r in range(RODS):
            out[r, diagonal[r]] = np.tril(out[r, diagonal[r]])
        return out

    def solve(self, right):
        x = self.array(right, wp.float64)
        by_lanes = self.kernels is skyline_lanes
        y = self.zeros(wp.float64, 4) if by_lanes else self.zeros(wp.vec4d)
        self.launch(self.kernels.solve, [*self.chosen, self.free, self.stored, y], [x])
        return x.numpy().copy()


@pytest.mark.parametrize(("nodes", "count"), SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_inertia_and_solutions_are_those_of_dense_matrices(kernels, device, nodes, count):
    matrices, pairs, free, right = problem(nodes, count)
    system = System(kernels, device, nodes, pairs)
    negative = system.factorise(matrices, free)
    x = system.solve(right)
    for r in range(RODS):
        f = free[r]
        dense = matrices[r][np.ix_(f, f)]
        assert negative[r] == (np.linalg.eigvalsh(dense) < 0).sum()
        # Without pivoting rounding grows with the pivots' inverses.
        expected = np.linalg.solve(dense, right[r, 0, f])
        assert np.allclose(x[r, 0, f], expected, rtol=0, atol=1e-8 * np.abs(expected).max())
        assert (x[r, 0, ~f] == 0).all()


@pytest.mark.parametrize(("nodes", "count"), SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_definite_systems_are_solved_to_rounding(kernels, device, nodes, count):
    matrices, pairs, free, right = problem(nodes, count, seed=1)
    shift = 0.1 + np.abs(matrices).sum(axis=2).max()
    matrices = matrices + shift * np.eye(matrices.shape[1])
    system = System(kernels, device, nodes, pairs)
    assert (system.factorise(matrices, free) == 0).all()
    x = system.solve(right)
    for r in range(RODS):
        f = free[r]
        expected = np.linalg.solve(matrices[r][np.ix_(f, f)], right[r, 0, f])
        assert np.allclose(x[r, 0, f], expected, rtol=0, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize(("nodes", "count"), SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS[1:])
def test_lanes_find_what_a_thread_finds(kernels, device, nodes, count):
    matrices, pairs, free, right = problem(nodes, count, seed=2)
    # Indefinite, but dominated by the diagonal: rounding does not grow without pivoting.
    signs = np.random.default_rng(nodes).choice([-1.0, 1.0], (RODS, 4 * nodes - 1))
    diagonal = np.arange(4 * nodes - 1)
    matrices[:, diagonal, diagonal] += signs * np.abs(matrices).sum(axis=2)
    results = []
    for way in ((skyline, "cpu"), (kernels, device)):
        system = System(*way, nodes, pairs)
        negative = system.factorise(matrices, free)
        results.append((negative, system.factor(), system.solve(right)))
    (negative, factor, x), (lanes_negative, lanes_factor, lanes_x) = results
    assert (negative == lanes_negative).all()
    assert np.abs(factor - lanes_factor).max() < 1e-12 * np.abs(factor).max()
    assert np.abs(x - lanes_x).max() < 1e-12 * np.abs(x).max()


@pytest.mark.parametrize(("nodes", "count"), SIZES)
@pytest.mark.parametrize(("kernels", "device"), WAYS[1:])
def test_order_goes_by_the_distance_from_an_end(kernels, device, nodes, count):
    _, pairs, _, _ = problem(nodes, count)
    expected = [[order_from(end, nodes, chosen) for end in (0, nodes - 1)] for chosen in pairs]
    reach = np.array([[(last - np.arange(nodes)).max() for _, _, last in two] for two in expected])
    # Whatever the reach, and so that one of many pairs is narrow enough only from its last node.
    for most in (nodes, reach[:, 1].min()):
        system = System(kernels, device, nodes, pairs, most_reach=int(most))
        turned = (reach[:, 0] > most) & (reach[:, 1] <= most)
        assert turned.any() == (most < nodes and count > 5)
        for r, end in enumerate(turned.astype(int)):
            order, first, last = expected[r][end]
            assert (system.skyline.order.numpy()[r] == order).all()
            assert (system.skyline.rank.numpy()[r][order] == np.arange(nodes)).all()
            assert (system.skyline.first.numpy()[r] == first).all()
            assert (system.skyline.last.numpy()[r] == last).all()
            assert system.skyline.reach.numpy()[r] == reach[r, end]
            # Rows of blocks follow each other without a gap.
            ends = np.cumsum(np.arange(nodes) - first + 1)
            assert (system.skyline.row.numpy()[r] + np.arange(nodes) + 1 == ends).all()


def order_from(end, nodes, pairs):
    """The nodes by their distance from an end, the farthest first; the first column of every row,
    and the last row that reaches a column, or one before it."""
    coupled = np.abs(np.subtract.outer(np.arange(nodes), np.arange(nodes))) <= 2
    for i, j in pairs:
        corners = [i, i + 1, j, j + 1]
        coupled[np.ix_(corners, corners)] = True
    distance = np.full(nodes, nodes)
    reached = np.arange(nodes) == end
    for d in range(nodes):
        distance[reached & (distance == nodes)] = d
        reached = coupled[reached].any(axis=0)
    order = np.lexsort((-np.arange(nodes), -distance))
    first = coupled[np.ix_(order, order)].argmax(axis=1)
    return order, first, np.array([np.flatnonzero(first <= b).max() for b in range(nodes)])


@pytest.mark.parametrize(("nodes", "count"), [*SIZES, (1, 0), (2, 0), (133, 3), (411, 4)])
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=needs_gpu)])
def test_both_ends_find_what_lanes_find_who_do_not_reach_too_far(device, nodes, count):
    matrices, pairs, free, right = problem(nodes, count, seed=3)
    signs = np.random.default_rng(nodes).choice([-1.0, 1.0], (RODS, 4 * nodes - 1))
    diagonal = np.arange(4 * nodes - 1)
    matrices[:, diagonal, diagonal] += signs * np.abs(matrices).sum(axis=2)
    lanes_system = System(skyline_lanes, device, nodes, pairs)
    lanes_negative = lanes_system.factorise(matrices, free)
    lanes_x = lanes_system.solve(right)
    system = System(skyline_lanes, device, nodes, pairs)
    system.fill(matrices, free)
    near = system.skyline.reach.numpy() <= skyline_ends.REACH
    negative, x = system.eliminate(right)
    assert near.any() or count > 9
    assert (negative[near] == lanes_negative[near]).all()
    assert (negative[~near] == -1).all() and (x[~near] == right[~near]).all()
    for r in np.flatnonzero(near):
        assert np.abs(x[r] - lanes_x[r]).max() < 1e-12 * np.abs(lanes_x[r]).max()


@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_profile_beyond_the_capacity_is_told_and_left_alone(kernels, device):
    _, pairs, _, right = problem(40, 6)
    system = System(kernels, device, 40, pairs, capacity=10)
    assert (system.skyline.overflow.numpy() == 1).all()
    system.block = system.array(np.ones((RODS, 40, 4)), wp.vec4d)
    system.free = system.array(np.ones(right[:, 0].shape), wp.int32)
    assert (system.solve(right) == right).all()


@pytest.mark.parametrize(("kernels", "device"), WAYS)
def test_a_pivot_that_cancels_keeps_a_size(kernels, device):
    """The second row of [[1, 1], [1, 1]] has the pivot 0; its factor is tiny and finite."""
    nodes = 9
    matrices, pairs, free, right = problem(nodes, 2)
    matrices[:] = np.eye(matrices.shape[1])
    matrices[:, 17, 16] = matrices[:, 16, 17] = 1.0
    free[:] = True
    system = System(kernels, device, nodes, pairs)
    assert (system.factorise(matrices, free) == 0).all()
    assert np.isfinite(system.solve(right)).all()
