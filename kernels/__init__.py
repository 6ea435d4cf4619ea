"""Warp device code: one physics term a file. No allocation, no launch, no policy."""
