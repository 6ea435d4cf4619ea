"""Rods that are let go come to lie on the table."""

import numpy as np

import wrod
from wrod.deployment.left_alone import Fall
from wrod.scene.phases import falling, film, let_go, whole_rod

TIME = np.array([0.0, 0.05, 0.1, 0.6, 0.8])


def test_a_straight_rod_falls_straight_ahead_and_lies():
    """Half of it lies, half bends up as a cantilever's heavy elastica would; it comes to lie where
    a drawing straight ahead has it, since nothing pushes it aside."""
    rod = wrod.rod("green-vps")
    s = np.linspace(0.0, 0.3, 121)
    rise = np.clip(s - 0.15, 0.0, None)
    angle = 0.9 * (1.0 - np.exp(-((rise / 0.08) ** 2)))
    step = np.diff(s)[:, None] * np.column_stack([np.cos(angle), 0 * s, np.sin(angle)])[1:]
    shape = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    shapes = Fall.of(rod, shape, TIME[-1], 0.4).at(shape, TIME)
    np.testing.assert_allclose(shapes[0], shape, atol=5e-4)
    tops = shapes[:, -1, 2]
    assert tops[0] > 0.05 and tops[2] < 0.7 * tops[0]
    assert np.abs(shapes[-1][:, 2]).max() < 1e-3
    assert np.abs(shapes[-1] - shapes[-2]).max() < 1e-4
    lengths = np.linalg.norm(np.diff(shapes[-1], axis=0), axis=1).sum()
    assert abs(lengths - 0.3) < 1e-3
    drawn = let_go(shape, 1.0)
    assert np.abs(shapes[-1] - drawn).max() < 0.012  # it slides back a little as it unbends


def test_the_film_of_a_path_ends_with_the_rod_at_rest(letter, letter_path):
    shapes = whole_rod(letter)
    falls = falling(letter)
    held = shapes[-1]
    simulated = falls(held, np.array([0.0, 0.3, 2.5]))
    assert np.abs(simulated[-1][:, 2]).max() < 2e-3
    played = film(letter_path, shapes, None, falls)
    assert len(played.shapes) == len(played.code)
