"""Factorisation and solution of banded and skyline systems."""
