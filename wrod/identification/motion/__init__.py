"""Identification from recordings of a held rod in motion."""
