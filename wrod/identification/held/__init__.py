"""Identification of cables held in a hand or hung between two clamps."""
