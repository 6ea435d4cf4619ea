"""Rods: what a rod is, and batches of discrete elastic rods on a device."""
