"""Scenes: USD export and headless rendering."""
