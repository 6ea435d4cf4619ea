"""The manifold of grasps: every grip from which a pattern can be laid."""
