"""Solvers of batches of rods: linear systems, equilibria, stability, motion, contact."""
