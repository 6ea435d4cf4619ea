"""Identification from rods that lie on a table."""
