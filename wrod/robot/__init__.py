"""Robots: URDF, kinematics, joint paths and their timing."""
