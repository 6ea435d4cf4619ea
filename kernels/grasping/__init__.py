"""Bordered systems of grasps."""
