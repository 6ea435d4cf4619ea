"""Iterations, continuation and time steps."""
