"""Contact with shapes and between rods, with friction."""
