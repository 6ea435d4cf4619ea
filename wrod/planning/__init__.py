"""Planning: from a pattern and a rod to the trajectory of the grip."""
