"""Frames, strains, energies, and their derivatives."""
