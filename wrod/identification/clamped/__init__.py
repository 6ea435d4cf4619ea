"""Identification from rods held at rest between two clamps."""
